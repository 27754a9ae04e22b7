"""Solvers compared on the velocity programs that a run really has, each program alone.

The programs of a run are recorded, and each solver is given all of them in turn, at a low, a middle
and a high accuracy. Nothing repairs or polishes its answers. A program counts as solved if the
certificate of the answer, computed from the data, is within the accuracy asked for; what the solver
says of itself does not count.
"""

from __future__ import annotations

import contextlib
import io
import math
import time as clock
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import inf, nan
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from sweepopt.checks import count
from sweepopt.errors import InputError
from sweepopt.sets import ConvexSet
from sweepopt.solve import solve
from sweepopt.study.rows import aligned
from sweepopt.study.settings import ACCURACIES, Contestant, contestants
from sweepopt.study.sources import Source
from sweepopt.study.threads import one_thread
from sweepopt.velocity import Answer, Clarabel, Solve, Solver, VelocityProgram, certify

if TYPE_CHECKING:
    from pandas import DataFrame

SHIFT = 1e-3
"""Seconds: means are of log(time + SHIFT), so that what takes no time does not decide them."""


class Program(NamedTuple):
    """A velocity program of a run."""

    statement: VelocityProgram
    q: np.ndarray
    C: ConvexSet


class Trial(NamedTuple):
    """How a contestant did on one program: inf certifies nothing."""

    seconds: float
    certificate: float


class Tried(NamedTuple):
    """How a contestant did on all programs, none of them if it broke, and how it broke."""

    contestant: Contestant
    trials: list[Trial]
    message: str = ""


class ComparedRow(NamedTuple):
    """A row of the comparison.

    Attributes
    ----------
    solver, setting : str
        "cvxpy:..." goes through cvxpy's interface, the others are the library's own.
    accuracy : float
        Asked of the solver, and what the relative certificate is judged by.
    programs : int
    solved : float
        Share of programs whose certificate is within the accuracy.
    time : float
        Seconds a program, shifted geometric mean. A program that was not solved counts with the
        longest time that any contestant took for one.
    ratio : float
        time / the smallest time of that accuracy among those that solved all.
    certificate, worst : float
        Median and largest of the relative certificates; inf where there is none.
    message : str
        The first failure in words.
    """

    solver: str
    setting: str
    accuracy: float
    programs: int
    solved: float = 0.0
    time: float = nan
    ratio: float = nan
    certificate: float = inf
    worst: float = inf
    message: str = ""


def compare(
    source: Source, *, steps: int = 50, progress: Callable[[str], object] | None = None
) -> DataFrame:
    """Give the programs of a run to every solver that is installed.

    Parameters
    ----------
    source : Source
        A problem, as `find_source` finds it.
    steps : int
        Of the run whose programs are compared.
    progress : callable, optional

    Returns
    -------
    pandas DataFrame
        A row a solver and accuracy, with the columns of `ComparedRow`.

    Raises
    ------
    InputError
        If no step of the run has a program: nothing moves, there is a formula, or it is linear.
    """
    import pandas as pd

    say = progress or (lambda _: None)
    programs = recorded(source, count("steps", steps))
    say(f"{source.name}: {len(programs)} programs of {programs[0].q.size} unknowns")
    found = []
    for contestant in contestants(programs[0].C):
        say(f"{contestant.name} {contestant.setting}")
        found.append(tried(contestant, programs))
    return pd.DataFrame(_rows(found, len(programs)), columns=list(ComparedRow._fields))


@dataclass(frozen=True)
class Recorder:
    """Clarabel, which notes what it is asked."""

    programs: list[Program] = field(default_factory=list)
    name = "recorder"

    def treats(self, C: ConvexSet) -> bool:
        """Every set."""
        return True

    def refined(self) -> Solver | None:
        """Clarabel alone: a program is noted once."""
        return Clarabel()

    def compile(self, program: VelocityProgram) -> Solve:
        """Clarabel's, with a note of each call."""
        answer = Clarabel().compile(program)

        def solve_(q: np.ndarray, C: ConvexSet) -> Answer:
            self.programs.append(Program(program, q.copy(), C))
            return answer(q, C)

        return solve_


def recorded(source: Source, steps: int) -> list[Program]:
    """The programs of a run of a problem, those of steps at rest apart."""
    process, t_end = source.open()
    recorder = Recorder()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solve(process, t_end=t_end, steps=steps, solver=recorder, on_failure="stop")
    if not recorder.programs:
        raise InputError(f"{source.name} has no program to compare solvers on: no step needs one")
    return recorder.programs


def tried(contestant: Contestant, programs: Sequence[Program]) -> Tried:
    """Every program in the order of time, a call that is not timed before the first one."""
    compiled: dict[int, Solve] = {}
    trials = []
    quiet = contextlib.redirect_stdout(io.StringIO())
    with quiet, warnings.catch_warnings(), one_thread():
        warnings.simplefilter("ignore")
        try:
            for statement, q, C in programs:
                if id(statement) not in compiled:
                    compiled[id(statement)] = contestant.solver.compile(statement)
                    compiled[id(statement)](q, C)  # warm
                trials.append(_trial(compiled[id(statement)], statement, q, C))
        except Exception as error:  # a solver that breaks is a row of the table
            return Tried(contestant, [], f"{type(error).__name__}: {error}")
    return Tried(contestant, trials)


def _trial(answered: Solve, statement: VelocityProgram, q: np.ndarray, C: ConvexSet) -> Trial:
    started = clock.perf_counter()
    answer = answered(q, C)
    seconds = clock.perf_counter() - started
    if not (np.isfinite(answer.z).all() and np.isfinite(answer.y).all()):
        return Trial(seconds, inf)
    relative = certify(statement.M, q, C, answer.z, answer.y).relative
    return Trial(seconds, inf if math.isnan(relative) else relative)


def _rows(found: Sequence[Tried], programs: int) -> list[ComparedRow]:
    longest = max((one.seconds for each in found for one in each.trials), default=nan)
    rows = [_row(each, programs, longest) for each in found]
    best = {
        accuracy: min(
            (row.time for row in rows if row.accuracy == accuracy and row.solved == 1.0),
            default=nan,
        )
        for accuracy in ACCURACIES.values()
    }
    rows = [row._replace(ratio=row.time / best[row.accuracy]) for row in rows]
    return sorted(rows, key=lambda row: (-row.accuracy, -row.solved, row.time))


def _row(each: Tried, programs: int, longest: float) -> ComparedRow:
    name, setting, accuracy, _ = each.contestant
    row = ComparedRow(name, setting, accuracy, programs, message=each.message)
    if not each.trials:
        return row._replace(time=longest)
    certificates = np.array([one.certificate for one in each.trials])
    solved = certificates <= accuracy
    seconds = np.where(solved, [one.seconds for one in each.trials], longest)
    return row._replace(
        solved=float(solved.mean()),
        time=shifted_mean(seconds),
        certificate=float(np.median(certificates)),
        worst=float(certificates.max()),
    )


def shifted_mean(seconds: Sequence[float] | np.ndarray) -> float:
    """The shifted geometric mean exp(mean log(x + SHIFT)) - SHIFT.

    Examples
    --------
    >>> round(shifted_mean([1e-3, 3e-3]), 6)
    0.001828
    """
    return float(np.exp(np.log(np.asarray(seconds) + SHIFT).mean()) - SHIFT)


def comparison_text(table: DataFrame) -> str:
    """The comparison as text."""
    lines = [["solver", "setting", "accuracy", "solved", "ms", "x best", "median", "worst", ""]]
    for row in table.itertuples():
        lines.append(
            [
                row.solver,
                row.setting,
                f"{row.accuracy:g}",
                f"{row.solved:.0%}",
                f"{1e3 * row.time:.3g}",
                f"{row.ratio:.2f}",
                f"{row.certificate:.0e}",
                f"{row.worst:.0e}",
                row.message[:60],
            ]
        )
    legend = (
        "solved   share of programs with a relative certificate within the accuracy\n"
        "ms       shifted geometric mean; unsolved programs count with the longest time of all\n"
        "x best   of those that solved all programs at that accuracy\n"
        "median, worst   relative certificates of the solver's own answers, unpolished"
    )
    return f"{aligned(lines)}\n{legend}"
