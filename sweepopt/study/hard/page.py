"""The hard cases as files: a table to read, one to compute with."""

from __future__ import annotations

import csv
import html
from collections.abc import Sequence
from pathlib import Path

import sweepopt
from sweepopt.store import replacing
from sweepopt.study.hard import FAMILIES
from sweepopt.study.hard.table import TARGET, HardRow

TABLE, PAGE = "hard.csv", "hard.html"
STYLE = """
body { font: 14px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 75rem; padding: 0 1rem }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums }
th, td { border-bottom: 1px solid #ddd; padding: .2rem .6rem; text-align: left }
thead th { position: sticky; top: 0; background: #fff } .wrong { background: #fdd }
tbody th { padding-top: 1rem }
"""
COLUMNS = ("seed", "path", "solver", "true error", "certificate", "found by", "attempts", "ms", "")


def write_hard(rows: Sequence[HardRow], folder: Path) -> list[str]:
    """Write the table as CSV and as a page without scripts; their names."""
    with replacing(folder / TABLE) as part, part.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([HardRow._fields, *rows])
    with replacing(folder / PAGE) as part:
        part.write_text(_page(rows), encoding="utf-8")
    return [TABLE, PAGE]


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


def _page(rows: Sequence[HardRow]) -> str:
    body = []
    for name, mine in _families(rows).items():
        title = html.escape(f"{name}: {FAMILIES[name].__doc__}")
        body.append(f'<tr><th colspan="{len(COLUMNS)}">{title}</th></tr>')
        body += [_row(row) for row in mine]
    head = "".join(f"<th>{name}</th>" for name in COLUMNS)
    wrong = sum(not row.good for row in rows)
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8">'
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
        "style-src 'unsafe-inline'\">"
        f"<title>Hard cases</title><style>{STYLE}</style><h1>Hard cases</h1>"
        f"<p>{len(rows)} runs, {wrong} wrong; sweepopt {sweepopt.__version__}. Errors are "
        "|z - z*|_M / max(|z*|_M, |M<sup>-1</sup> q|_M) of the worst step, z* in 60 digits; right "
        f"is at most {TARGET:g} with a certificate that is not below it, or the right refusal.</p>"
        f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table></html>\n"
    )


def _row(row: HardRow) -> str:
    cells = (
        row.seed,
        row.path,
        row.solver,
        f"{row.error:.1e}" if row.rung else "",
        f"{row.certificate:.1e}" if row.rung else "",
        row.rung,
        row.attempts or "",
        f"{1e3 * row.seconds:.3g}" if row.rung else "",
        row.verdict,
    )
    shown = "".join(f"<td>{html.escape(str(cell))}</td>" for cell in cells)
    return f"<tr{'' if row.good else ' class=wrong'}>{shown}</tr>"
