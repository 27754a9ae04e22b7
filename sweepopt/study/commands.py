"""The commands ``sweepopt study`` and ``sweepopt compare``, behind the parser of `cli`."""

from __future__ import annotations

import argparse
import sys
import warnings
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING

from sweepopt.errors import SweepoptWarning
from sweepopt.io import find_study, read_toml
from sweepopt.results import Solution
from sweepopt.study.advice import TARGETS, advice, summary
from sweepopt.study.cell import solution_of
from sweepopt.study.comparison import compare, comparison_text
from sweepopt.study.diagram import work_precision
from sweepopt.study.executors import Processes, dask_executor
from sweepopt.study.hard.suite import HardRow, hard_study, hard_summary, rows
from sweepopt.study.ledger import append_row
from sweepopt.study.report import write_report
from sweepopt.study.sources import find_source
from sweepopt.study.stiff import rows as stiff_rows
from sweepopt.study.stiff import stiff_study, stiff_summary
from sweepopt.study.study import Study, read_study, run

if TYPE_CHECKING:
    from pandas import DataFrame

TABLE, DIAGRAM, HARD, REPORT = "table.csv", "diagram.png", "hard.csv", "report.html"
STIFF = "stiff.csv"
HARD_ROWS = "hard.jsonl"
"""Rows of hard cases, each as soon as it is finished."""


def study_command(chosen: argparse.Namespace) -> None:
    """Run a study, or go on with it, then its hard and stiff cases, and write what they say."""
    import pandas as pd

    path = find_study(chosen.study)
    folder = chosen.out or Path("results") / path.stem
    data = read_toml(path)
    hard = hard_study(data["hard"], f"{path}: ") if "hard" in data else None
    stiff = stiff_study(data["stiff"], f"{path}: ") if "stiff" in data else None
    judged: list[HardRow] = []
    table, solutions, files = None, {}, []
    if not (hard or stiff) or data.keys() - {"hard", "stiff", "title"}:
        study = read_study(path)
        with _executor(chosen) as executor:
            table = run(study, folder, executor=executor, progress=_say)
        table.to_csv(folder / TABLE, index=False)
        work_precision(table).figure.savefig(folder / DIAGRAM)
        solutions = _fastest_runs(study, table)
        print(summary(table))
        files += [TABLE, DIAGRAM]
    if hard is not None:
        # in this process, from the start: they take a minute a seed
        folder.mkdir(parents=True, exist_ok=True)
        (folder / HARD_ROWS).unlink(missing_ok=True)
        for row in rows(hard, _say):
            append_row(folder / HARD_ROWS, row)
            judged.append(row)
        pd.DataFrame(judged).to_csv(folder / HARD, index=False)
        print(hard_summary(judged))
        files.append(HARD)
    if stiff is not None:
        folder.mkdir(parents=True, exist_ok=True)
        runs = list(stiff_rows(stiff, _say))
        pd.DataFrame(runs).to_csv(folder / STIFF, index=False)
        print(stiff_summary(runs))
        files.append(STIFF)
    if table is not None or judged:
        title = str(data.get("title", path.stem))
        write_report(table, folder / REPORT, solutions=solutions, hard=judged, title=title)
        files.append(REPORT)
    print(f"written: {folder}: {', '.join(files)}")


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
