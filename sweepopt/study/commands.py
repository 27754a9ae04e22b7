"""The commands ``sweepopt study`` and ``sweepopt compare``, behind the parser of `cli`."""

from __future__ import annotations

import argparse
import sys
import warnings
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sweepopt.errors import SweepoptWarning
from sweepopt.io import find_study, folder_at
from sweepopt.results import Solution
from sweepopt.study.cell import solution_of
from sweepopt.study.comparison import compare, comparison_text
from sweepopt.study.diagram import work_precision
from sweepopt.study.hard import SUITES, suite_summary
from sweepopt.study.problems import find_source
from sweepopt.study.report import TARGETS, advice, summary, write_report
from sweepopt.study.study import Study, read_parts, read_study, run
from sweepopt.study.workers import dask_executor, processes

if TYPE_CHECKING:
    from pandas import DataFrame

TABLE, DIAGRAM, REPORT = "table.csv", "diagram.png", "report.html"


def study_command(options: argparse.Namespace) -> None:
    """Run a study, or go on with it, then its hard and stiff cases, and write what they say."""
    import pandas as pd

    path = find_study(options.study)
    folder = options.out or Path("results") / path.stem
    data, parts = read_parts(path)
    table, solutions, files = None, {}, []
    suites: dict[str, list[Any]] = {}
    folder_at("--out", folder)
    if not parts or data.keys() - {"title"}:
        study = read_study(path)
        executor: Any = nullcontext()
        if options.scheduler is not None:
            executor = dask_executor(options.scheduler)
        elif options.workers is not None:
            executor = processes(options.workers)
        with executor as pool:
            table = run(study, folder, executor=pool, progress=_say)
        table.to_csv(folder / TABLE, index=False)
        work_precision(table).figure.savefig(folder / DIAGRAM)
        solutions = _fastest_runs(study, table)
        print(summary(table))
        files += [TABLE, DIAGRAM]
    for name, suite in parts.items():
        # in this process, from the start: hard cases take some minutes a seed
        (lines := folder / f"{name}.csv").unlink(missing_ok=True)
        rows = suites[name] = []
        for row in suite:
            # as they come: an interrupt leaves those that are there
            pd.DataFrame([row]).to_csv(lines, mode="a", header=not rows, index=False)
            rows.append(row)
            _say(f"{name}: {row[:4]}")
        if rows:
            print(suite_summary(rows, SUITES[name][1]))
            files.append(lines.name)
    title = str(data.get("title", path.stem))
    write_report(table, folder / REPORT, solutions=solutions, title=title, **suites)
    print(f"written: {folder}: {', '.join([*files, REPORT])}")


def _fastest_runs(study: Study, table: DataFrame) -> dict[str, Solution]:
    """The fastest run of each problem that meets the first target, solved again.

    Its relative error is so large that its band can be seen.
    """
    chosen = set(advice(table, TARGETS[:1]).run)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SweepoptWarning)  # the table has them
        return {
            f"{cell.problem.name}: {cell.scheme}, {cell.steps} steps": solution_of(cell)
            for cell in study.runs()
            if cell.id in chosen
        }


def compare_command(options: argparse.Namespace) -> None:
    """Compare all solvers on the programs of a scene."""
    if options.csv is not None:
        options.csv.touch()  # says so now if it cannot be written
    table = compare(find_source(options.scene), steps=options.steps, progress=_say)
    print(comparison_text(table))
    if options.csv is not None:
        table.to_csv(options.csv, index=False)


def _say(words: str) -> None:
    print(words, file=sys.stderr, flush=True)
