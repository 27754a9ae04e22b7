"""The commands ``sweepopt study`` and ``sweepopt compare``, behind the parser of `cli`."""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import AbstractContextManager
from pathlib import Path

from sweepopt.errors import InputError, shown
from sweepopt.io import find_study, read_toml
from sweepopt.study.advice import summary
from sweepopt.study.band import fastest_runs
from sweepopt.study.comparison import compare, comparison_text
from sweepopt.study.diagram import work_precision
from sweepopt.study.executors import Processes, dask_executor
from sweepopt.study.hard.table import HardRow, HardStudy, hard_study, hard_summary, rows
from sweepopt.study.report import write_report
from sweepopt.study.sources import find_source
from sweepopt.study.study import read_study, run

TABLE, DIAGRAM, HARD, REPORT = "table.csv", "diagram.png", "hard.csv", "report.html"


def study_command(chosen: argparse.Namespace) -> None:
    """Run a study, or go on with it, then its hard cases, and write what they say."""
    import pandas as pd

    path = find_study(chosen.study)
    folder = chosen.out or Path("results") / path.stem
    data = read_toml(path)
    hard = _hard_of(path, data.get("hard")) if "hard" in data else None
    title, table, solutions, files = data.get("title", ""), None, {}, []
    if hard is None or not set(data) <= {"hard", "title"}:
        study = read_study(path)
        with _executor(chosen) as executor:
            table = run(study, folder, executor=executor, progress=_say)
        table.to_csv(folder / TABLE, index=False)
        work_precision(table).figure.savefig(folder / DIAGRAM)
        solutions = fastest_runs(study, table)
        print(summary(table))
        files += [TABLE, DIAGRAM]
    elif not isinstance(title, str):
        raise InputError(f"{path}: title must be a string, got {shown(title)}")
    judged: list[HardRow] = []
    if hard is not None:
        # in this process, from the start: they take a minute a seed
        judged = list(rows(**vars(hard), progress=_say))
        folder.mkdir(parents=True, exist_ok=True)
        pd.DataFrame(judged, columns=list(HardRow._fields)).to_csv(folder / HARD, index=False)
        print(hard_summary(judged))
        files.append(HARD)
    title = title or ("Hard cases" if table is None else "What accuracy costs")
    write_report(table, folder / REPORT, solutions=solutions, hard=judged, title=title)
    print(f"written: {folder}: {', '.join([*files, REPORT])}")


def compare_command(chosen: argparse.Namespace) -> None:
    """Compare all solvers on the programs of a scene."""
    if chosen.csv is not None:
        chosen.csv.touch()  # says so now if it cannot be written
    table = compare(find_source(chosen.scene), steps=chosen.steps, progress=_say)
    print(comparison_text(table))
    if chosen.csv is not None:
        table.to_csv(chosen.csv, index=False)


def _hard_of(path: Path, data: object) -> HardStudy:
    """What the table [hard] of a study file asks for, checked."""
    try:
        return hard_study(data)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _executor(chosen: argparse.Namespace) -> AbstractContextManager[Executor]:
    if chosen.scheduler is not None:
        return dask_executor(chosen.scheduler)
    return Processes(chosen.workers) if chosen.workers else ThreadPoolExecutor(1)


def _say(words: str) -> None:
    print(words, file=sys.stderr, flush=True)
