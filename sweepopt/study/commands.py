"""The commands ``sweepopt study`` and ``sweepopt compare``, behind the parser of `cli`."""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sweepopt.errors import SweepoptWarning
from sweepopt.io import find_study
from sweepopt.results import Solution
from sweepopt.study.advice import TARGETS, advice, summary
from sweepopt.study.cell import solution_of
from sweepopt.study.comparison import compare, comparison_text
from sweepopt.study.diagram import work_precision
from sweepopt.study.executors import Processes, dask_executor
from sweepopt.study.hard.suite import rows as hard_rows
from sweepopt.study.hard.suite import trajectory_rows
from sweepopt.study.hard.verdicts import worst
from sweepopt.study.ledger import append_row
from sweepopt.study.report import write_report
from sweepopt.study.sources import find_source
from sweepopt.study.stiff import rows as stiff_rows
from sweepopt.study.study import Study, read_parts, read_study, run

if TYPE_CHECKING:
    from pandas import DataFrame

TABLE, DIAGRAM, REPORT = "table.csv", "diagram.png", "report.html"


def study_command(chosen: argparse.Namespace) -> None:
    """Run a study, or go on with it, then its hard and stiff cases, and write what they say."""
    path = find_study(chosen.study)
    folder = chosen.out or Path("results") / path.stem
    data, parts = read_parts(path)
    table, solutions, files = None, {}, []
    if not parts or data.keys() - {"title"}:
        study = read_study(path)
        with _executor(chosen) as executor:
            table = run(study, folder, executor=executor, progress=_say)
        table.to_csv(folder / TABLE, index=False)
        work_precision(table).figure.savefig(folder / DIAGRAM)
        solutions = _fastest_runs(study, table)
        print(summary(table))
        files += [TABLE, DIAGRAM]
    # in this process, from the start: hard cases take some minutes a seed
    folder.mkdir(parents=True, exist_ok=True)
    found = {
        name: _kept(rows(parts[part]), folder / name)
        for name, (part, rows) in JUDGED.items()
        if part in parts
    }
    for name, rows in found.items():
        if rows:
            print(worst(rows, GROUPS[name]))
            files.append(f"{name}.csv")
    if table is not None or any(found.values()):
        files.append(REPORT)
        title = str(data.get("title", path.stem))
        write_report(table, folder / REPORT, solutions=solutions, title=title, **found)
    print(f"written: {folder}: {', '.join(files)}")


JUDGED: dict[str, tuple[str, Callable[..., Any]]] = {
    "hard": ("hard", hard_rows),
    "trajectories": ("hard", trajectory_rows),
    "stiff": ("stiff", stiff_rows),
}
"""Files of rows, the table of a study that they are of, and what yields them.

The .jsonl has each row as soon as it is finished, the .csv all of them.
"""
GROUPS = {
    "hard": ["family"],
    "trajectories": ["trajectory"],
    "stiff": ["body", "load", "mu_Lam", "scheme"],
}
"""Columns by which rows are grouped where they are printed."""


def _kept(rows: Iterable[Any], path: Path) -> list[Any]:
    """All rows, each written down as soon as it is finished."""
    import pandas as pd

    lines = path.with_suffix(".jsonl")
    found: list[Any] = []
    lines.unlink(missing_ok=True)
    for row in rows:
        append_row(lines, row)
        if not found or row[:2] != found[-1][:2]:
            _say(f"{path.name}: {row[0]}, {row[1]}")
        found.append(row)
    if found:
        pd.DataFrame(found).to_csv(path.with_suffix(".csv"), index=False)
    return found


def _executor(chosen: argparse.Namespace) -> AbstractContextManager[Executor]:
    if chosen.scheduler is not None:
        return dask_executor(chosen.scheduler)
    return Processes(chosen.workers) if chosen.workers else ThreadPoolExecutor(1)


def _fastest_runs(study: Study, table: DataFrame) -> dict[str, Solution]:
    """The fastest run of each problem that meets the first target, solved again.

    Its relative error is so large that its band can be seen.
    """
    chosen = set(advice(table, TARGETS[:1]).cell)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SweepoptWarning)  # the table has them
        return {
            f"{cell.problem.name}: {cell.scheme}, {cell.steps} steps": solution_of(cell)
            for cell in study.cells()
            if cell.id in chosen
        }


def compare_command(chosen: argparse.Namespace) -> None:
    """Compare all solvers on the programs of a scene."""
    if chosen.csv is not None:
        chosen.csv.touch()  # says so now if it cannot be written
    table = compare(find_source(chosen.scene), steps=chosen.steps, progress=_say)
    print(comparison_text(table))
    if chosen.csv is not None:
        table.to_csv(chosen.csv, index=False)


def _say(words: str) -> None:
    print(words, file=sys.stderr, flush=True)
