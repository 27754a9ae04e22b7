"""The hard cases as a table to compute with, a page of the report, and lines to read."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sweepopt.io import replacing
from sweepopt.study.hard import FAMILIES
from sweepopt.study.hard.table import TARGET, HardRow


def write_hard(rows: Sequence[HardRow], path: Path) -> None:
    """Write the table as CSV."""
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([HardRow._fields, *rows])


def hard_page(rows: Sequence[HardRow]) -> dict[str, Any]:
    """What the report's page of hard cases is drawn from."""
    return {
        "target": TARGET,
        "about": {name: FAMILIES[name].__doc__ for name in _families(rows) if name in FAMILIES},
        "rows": [_entry(row) for row in rows],
    }


def _entry(row: HardRow) -> dict[str, Any]:
    """What was not measured is None, not 0."""
    entry = row._asdict() | {"good": row.good, "milliseconds": 1e3 * row.seconds}
    return entry | ({} if row.rung else {"rung": "none", "attempts": None})


def hard_summary(rows: Sequence[HardRow]) -> str:
    """A line a family, and each row with a wrong answer."""
    lines = [f"{'family':<20}{'runs':>6}{'true error':>12}{'certificate':>13}  found by"]
    for name, mine in _families(rows).items():
        errors = [row.error for row in mine if row.rung]
        stated = [row.certificate for row in mine if row.rung]
        rungs = ", ".join(sorted({row.rung or "refused" for row in mine}))
        numbers = f"{max(errors):12.1e}{max(stated):13.1e}" if errors else f"{'-':>12}{'-':>13}"
        lines.append(f"{name:<20}{len(mine):6}{numbers}  {rungs}")
    wrong = [row for row in rows if not row.good]
    lines += ["", f"{len(rows)} runs, {len(wrong)} wrong"]
    lines += [f"  {row.family} {row.seed} {row.path} {row.solver}: {row.verdict}" for row in wrong]
    return "\n".join(lines)


def _families(rows: Sequence[HardRow]) -> dict[str, list[HardRow]]:
    found: dict[str, list[HardRow]] = {}
    for row in rows:
        found.setdefault(row.family, []).append(row)
    return found
