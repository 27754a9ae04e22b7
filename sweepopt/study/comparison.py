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
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sweepopt.checks import count
from sweepopt.errors import InputError
from sweepopt.sets import ConvexSet
from sweepopt.solve import solve
from sweepopt.study.machine import one_thread
from sweepopt.study.sources import Source
from sweepopt.velocity import (
    DAQP,
    OSQP,
    Answer,
    Clarabel,
    Cvxpy,
    Newton,
    Solve,
    Solver,
    VelocityProgram,
    certify,
    installed,
)

if TYPE_CHECKING:
    from pandas import DataFrame

ACCURACIES = {"low": 1e-3, "mid": 1e-6, "high": 1e-9}
TOLERANCES: dict[str, tuple[str, ...]] = {
    "CLARABEL": ("tol_gap_abs", "tol_gap_rel", "tol_feas"),
    "OSQP": ("eps_abs", "eps_rel"),
    "PIQP": ("eps_abs", "eps_rel"),
    "PROXQP": ("eps_abs", "eps_rel"),
    "DAQP": ("primal_tol", "dual_tol"),
    "SCS": ("eps_abs", "eps_rel"),
    "QOCO": ("abstol", "reltol"),
    "MOSEK": ("eps",),
}
"""What each solver calls its tolerances in cvxpy's interface."""
LIMITS: dict[str, dict[str, Any]] = {
    "OSQP": {"max_iter": 20_000},
    "SCS": {"max_iters": 20_000},
    "PROXQP": {"max_iter": 10_000},
}
"""Iterations, for methods of first order."""
SHIFT = 1e-3
"""Seconds: means are of log(time + SHIFT), so that what takes no time does not decide them."""


class Program(NamedTuple):
    """A velocity program of a run."""

    statement: VelocityProgram
    q: np.ndarray
    C: ConvexSet


class Contestant(NamedTuple):
    """A solver with the settings of one accuracy."""

    name: str
    setting: str
    accuracy: float
    solver: Solver


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
    programs: int = 0
    solved: float = 0.0
    time: float = nan
    ratio: float = nan
    certificate: float = inf
    worst: float = inf
    message: str = ""


def compare(
    source: Source, *, steps: int = 50, progress: Callable[[str], object] = lambda words: None
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

    programs = record(source, count("steps", steps))
    progress(f"{source.name}: {len(programs)} programs of {programs[0].q.size} unknowns")
    trials = []
    for contestant in contestants_for(programs[0].C):
        progress(f"{contestant.name} {contestant.setting}")
        trials.append((contestant, try_all(contestant, programs)))
    longest = max((each.seconds.max(initial=0.0) for _, each in trials), default=nan)
    rows = [_row(contestant, each, longest) for contestant, each in trials]
    table = pd.DataFrame(rows, columns=list(ComparedRow._fields)).assign(programs=len(programs))
    best = table[table.solved == 1.0].groupby("accuracy").time.min()
    table["ratio"] = table.time / table.accuracy.map(best)
    return table.sort_values(
        ["accuracy", "solved", "time"], ascending=[False, False, True], ignore_index=True
    )


def contestants_for(C: ConvexSet) -> list[Contestant]:
    """The library's own solvers and those installed for cvxpy, as far as they treat the set."""
    exact: list[Solver] = [Newton(), DAQP()]
    contestants = [Contestant(one.name, "high", ACCURACIES["high"], one) for one in exact]
    for setting, tol in ACCURACIES.items():
        solvers: list[Solver] = [Clarabel(tol=tol), OSQP(tol=tol)]
        for name, keys in TOLERANCES.items():
            if name in installed():
                solvers.append(Cvxpy(name, {**dict.fromkeys(keys, tol), **LIMITS.get(name, {})}))
        contestants += [Contestant(one.name, setting, tol, one) for one in solvers]
    return [contestant for contestant in contestants if contestant.solver.treats(C)]


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


def record(source: Source, steps: int) -> list[Program]:
    """The programs of a run of a problem, those of steps at rest apart."""
    process, t_end = source.open()
    recorder = Recorder()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solve(process, t_end=t_end, steps=steps, solver=recorder, on_failure="stop")
    if not recorder.programs:
        raise InputError(f"{source.name} has no program to compare solvers on: no step needs one")
    return recorder.programs


class Trials(NamedTuple):
    """Seconds and relative certificate of each program; none if the solver broke, and how."""

    seconds: np.ndarray
    certificates: np.ndarray
    message: str = ""


def try_all(contestant: Contestant, programs: Sequence[Program]) -> Trials:
    """Every program in the order of time, a call that is not timed before the first one."""
    compiled: dict[int, Solve] = {}
    seconds, certificates = [], []
    quiet = contextlib.redirect_stdout(io.StringIO())
    with quiet, warnings.catch_warnings(), one_thread():
        warnings.simplefilter("ignore")
        try:
            for statement, q, C in programs:
                if id(statement) not in compiled:
                    compiled[id(statement)] = contestant.solver.compile(statement)
                    compiled[id(statement)](q, C)  # warm
                started = clock.perf_counter()
                answer = compiled[id(statement)](q, C)
                seconds.append(clock.perf_counter() - started)
                certificates.append(_certificate(statement, q, C, answer))
        except Exception as error:  # a solver that breaks is a row of the table
            return Trials(np.empty(0), np.empty(0), f"{type(error).__name__}: {error}")
    return Trials(np.array(seconds), np.array(certificates))


def _certificate(statement: VelocityProgram, q: np.ndarray, C: ConvexSet, answer: Answer) -> float:
    """The relative certificate of an answer, inf if there is none."""
    if not np.isfinite(answer.z).all():
        return inf
    relative = certify(statement.M, q, C, answer.z).relative
    return inf if math.isnan(relative) else relative


def _row(contestant: Contestant, trials: Trials, longest: float) -> ComparedRow:
    row = ComparedRow(*contestant[:3], time=longest, message=trials.message)
    if not trials.seconds.size:
        return row
    solved = trials.certificates <= contestant.accuracy
    return row._replace(
        solved=float(solved.mean()),
        time=shifted_mean(np.where(solved, trials.seconds, longest)),
        certificate=float(np.median(trials.certificates)),
        worst=float(trials.certificates.max()),
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
    shown = table.assign(time=1e3 * table.time, message=table.message.str[:60])
    names = {"time": "ms", "ratio": "x best", "certificate": "median", "message": ""}
    formats = {
        "accuracy": "{:g}",
        "solved": "{:.0%}",
        "ms": "{:.3g}",
        "x best": "{:.2f}",
        "median": "{:.0e}",
        "worst": "{:.0e}",
    }
    text = (
        shown.drop(columns="programs")
        .rename(columns=names)
        .to_string(index=False, formatters={name: form.format for name, form in formats.items()})
    )
    legend = (
        "solved   share of programs with a relative certificate within the accuracy\n"
        "ms       shifted geometric mean; unsolved programs count with the longest time of all\n"
        "x best   of those that solved all programs at that accuracy\n"
        "median, worst   relative certificates of the solver's own answers, unpolished"
    )
    return f"{text}\n{legend}"
