"""The commands ``sweepopt study`` and ``sweepopt compare``, behind the parser of `cli`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sweepopt.errors import InputError, shown
from sweepopt.io import find_study, read_toml
from sweepopt.study.advice import summary
from sweepopt.study.comparison import compare, comparison_text
from sweepopt.study.executors import Processes, Serial, dask_executor
from sweepopt.study.files import read_study
from sweepopt.study.hard.files import HardStudy, hard_study
from sweepopt.study.hard.page import hard_summary
from sweepopt.study.hard.table import HardRow, rows
from sweepopt.study.outputs import write_hard_outputs, write_outputs
from sweepopt.study.sources import find_source
from sweepopt.study.study import run


def study_command(chosen: argparse.Namespace) -> None:
    """Run a study, or go on with it, and write what it found; a table [hard] is run after it."""
    path = find_study(chosen.study)
    folder = chosen.out or Path("results") / path.stem
    data = read_toml(path)
    wanted = _hard_of(path, data)
    hard: list[HardRow] = []
    if wanted is not None and set(data) <= {"hard", "title"}:
        title = data.get("title", "")
        if not isinstance(title, str):
            raise InputError(f"{path}: title must be a string, got {shown(title)}")
        folder.mkdir(parents=True, exist_ok=True)
        hard = _run_hard(wanted)
        files = write_hard_outputs(hard, folder, title)
    else:
        study = read_study(path)
        with _executor(chosen) as executor:
            table = run(study, folder, executor=executor, progress=_say)
        hard = [] if wanted is None else _run_hard(wanted)
        files = write_outputs(study, table, folder, hard)
        print(summary(table))
    if hard:
        print(hard_summary(hard))
    print(f"written: {folder}: {', '.join(files)}")


def _hard_of(path: Path, data: dict[str, Any]) -> HardStudy | None:
    """What the table [hard] of a study file asks for, checked."""
    if "hard" not in data:
        return None
    try:
        return hard_study(data["hard"])
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _run_hard(study: HardStudy) -> list[HardRow]:
    """In this process, from the start: they take a minute a seed."""
    return list(rows(**vars(study), progress=_say))


def compare_command(chosen: argparse.Namespace) -> None:
    """Compare all solvers on the programs of a scene."""
    if chosen.csv is not None:
        chosen.csv.touch()  # says so now if it cannot be written
    source = find_source(chosen.scene)
    table = compare(source, steps=chosen.steps, progress=_say)
    print(comparison_text(table))
    if chosen.csv is not None:
        table.to_csv(chosen.csv, index=False)


@contextmanager
def _executor(chosen: argparse.Namespace) -> Iterator[Executor]:
    if chosen.scheduler is not None:
        with dask_executor(chosen.scheduler) as executor:
            yield executor
    else:
        with Processes(chosen.workers) if chosen.workers else Serial() as executor:
            yield executor


def _say(words: str) -> None:
    print(words, file=sys.stderr, flush=True)
