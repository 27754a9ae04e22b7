"""Suites of cases: what each takes from a study's file, its runs as rows with a verdict.

A suite is a function of its options that yields named tuples with the fields seed, seconds and
verdict; its docstring is shown in the report.
"""

import time
import warnings
from collections.abc import Callable, Iterable, Sequence
from inspect import signature
from pathlib import Path
from typing import Any

from pandas import DataFrame

from sweepopt.checks import choice, count, listed, number
from sweepopt.driver import solve
from sweepopt.errors import (
    InputError,
    PathError,
    SolverRefusedError,
    StabilityWarning,
    SweepoptError,
    shown,
)
from sweepopt.results import Solution

TARGET = 1e-8
"""Relative error that every step has to meet, in units of max(|z*|_M, |M^-1 q|_M); and what a run
may add to the error of its scheme, in units of the way that the bodies go."""
GOOD = ("met", "warned", "refused")
"""Verdicts of right answers; a run that warns says that its scheme may be wrong."""
Judgement = tuple[dict[str, Any], dict[str, Any]]
"""Entries of a run's row, and faults: what is wrong with it in words, and whether it is."""


def each(name: str, values: Any, check: Callable[..., Any], *limits: Any) -> tuple[Any, ...]:
    """A list with one entry or more, each checked under its own name and none there twice."""
    entries: dict[str, Any] = {}
    for k, entry in enumerate(listed(name, values, check, *limits)):
        if str(entry) in entries:
            raise InputError(f"{name}[{k}]: {shown(values[k])} is there twice")
        entries[str(entry)] = entry
    return tuple(entries.values())


def option(suite: Callable[..., Any], where: str, key: str, value: Any) -> Any:
    """An option of a suite, checked by its default.

    One whose default is a list of names takes some of these names, one of whole numbers such
    numbers (0 if the default has it), one of other numbers such > 0.

    Raises
    ------
    InputError
        Naming the key and the entry.
    """
    default = signature(suite).parameters[key].default
    several = isinstance(default, tuple)
    kind = type(default[0] if several else default)
    least = int(several and 0 not in default)
    checks: Any = {str: (choice, default), int: (count, least), bool: (lambda _, value: value,)}
    check, *limits = checks.get(kind, (number, 0.0, True, False))
    name = f"{where}{key}"
    return each(name, value, check, *limits) if several else check(name, value, *limits)


def run_case(
    row: Any,
    process: Callable[[], Any],
    judge: Callable[[Solution, bool], Judgement],
    refused: str = "",
    allowed: str = "",
    **settings: Any,
) -> Any:
    """A run's row: what a judge finds in it, or how it ended; None if a solver cannot treat it.

    Parameters
    ----------
    row : named tuple with the fields seconds and verdict
    process : callable
        Makes the process.
    judge : callable
        Takes a solution, and whether its run warned.
    refused, allowed : str
        Names of errors: the one that is the right answer, and one that is an answer.
    **settings
        Of `sweepopt.solve`.
    """
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            started = time.perf_counter()
            solution = solve(process(), **settings)
            row = row._replace(seconds=time.perf_counter() - started)
            if refused:
                return row._replace(verdict=f"not refused with {refused}")
            warned = any(issubclass(one.category, StabilityWarning) for one in caught)
            entries, faults = judge(solution, warned)
    except (SolverRefusedError, PathError):
        return None
    except SweepoptError as error:
        name = type(error).__name__
        right = name == (refused or allowed)
        return row._replace(verdict="refused" if right else f"{name}: {error}")
    verdict = next((words for words, fault in faults.items() if fault), GOOD[warned])
    return row._replace(verdict=verdict, **entries)


def run_suite(suite: Iterable[Any], path: Path, progress: Callable[[str], object]) -> list[Any]:
    """The rows of a suite, each in the file as soon as it is there: an interrupt leaves them."""
    path.unlink(missing_ok=True)
    rows: list[Any] = []
    for row in suite:
        DataFrame([row]).to_csv(path, mode="a", header=not rows, index=False)
        rows.append(row)
        progress(f"{path.stem}: {row[:4]}")
    return rows


def suite_summary(rows: Sequence[Any]) -> str:
    """The largest numbers of rows that differ by their seed, and a line for each that is not good.

    What makes a case stands in front of its seed.
    """
    table = DataFrame(rows)
    by = [*table.columns[: table.columns.get_loc("seed")]]
    groups = table.drop(columns="seed").groupby(by, sort=False)
    table = groups.max(numeric_only=True).assign(runs=groups.size())
    wrong = [row for row in rows if row.verdict not in GOOD]
    lines = [table.to_string(float_format="{:.2g}".format), "", f"{len(rows)} runs"]
    lines += [f"{len(wrong)} wrong", *(f"  {row[:4]}: {row.verdict}" for row in wrong)]
    return "\n".join(lines)
