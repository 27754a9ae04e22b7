"""Solvers compared on the velocity programs that a run really has, each program alone.

The programs of a run are recorded, and each solver is given all of them in turn, at a low, a middle
and a high accuracy. Nothing repairs or refines its answers. A program counts as solved if the
certificate of the answer, computed from the data, is within the accuracy asked for; what the solver
says of itself does not count.
"""

import contextlib
import io
import time as clock
import warnings
from collections.abc import Callable, Iterator, Sequence
from math import inf, nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pandas import DataFrame, concat
from threadpoolctl import threadpool_limits

from sweepopt.checks import Array, count, require_columns
from sweepopt.display import FORMAT
from sweepopt.driver import solve
from sweepopt.errors import InputError
from sweepopt.io import read_toml
from sweepopt.sets import ConvexSet
from sweepopt.study.cell import open_source
from sweepopt.study.problems import Source, find_source
from sweepopt.velocity import (
    DAQP,
    OSQP,
    Clarabel,
    Cvxpy,
    Newton,
    Solve,
    Solver,
    VelocityProgram,
    certify,
    installed,
)

ACCURACIES = {"low": 1e-3, "mid": 1e-6, "high": 1e-9}
CVXPY = read_toml(Path(__file__).with_suffix(".toml"))
"""Names of the tolerances, and limits, of the solvers of cvxpy."""
LEGEND = """\
solved   share of programs with a relative certificate within the accuracy
ms       shifted geometric mean; unsolved programs count with the longest time of all
x best   of those that solved all programs at that accuracy
median, worst   relative certificates of the solver's own answers, not refined"""


Program = tuple[VelocityProgram, Array, ConvexSet]
"""A velocity program of a run, with its q and C."""


class Trial(NamedTuple):
    """A call of a solver, and how its answer is certified, or how the solver broke."""

    seconds: float = nan
    certificate: float = inf
    message: str = ""


def compare(
    source: str | Path | Source,
    *,
    steps: int = 50,
    progress: Callable[[str], object] = lambda words: None,
) -> DataFrame:
    """Give the programs of a run to every solver that is installed.

    Parameters
    ----------
    source : str, Path or Source
        A problem: a name, as `find_source` takes it, or a process of one's own by `own_source`.
    steps : int
        Of the run whose programs are compared.
    progress : callable, optional

    Returns
    -------
    pandas DataFrame
        A row a solver ("cvxpy:..." through cvxpy's interface, the others are the library's own) and
        setting, with the columns ``accuracy`` (asked of the solver, and what the relative
        certificate is judged by), ``programs``, ``solved`` (share of the programs within the
        accuracy), ``time`` (seconds a program, shifted geometric mean; one that was not solved
        counts with the longest time that any solver took), ``ratio`` (of time to the smallest at
        that accuracy among those that solved all), ``certificate`` and ``worst`` (median and
        largest of the relative ones; inf where there is none) and ``message`` (a failure in words).

    Raises
    ------
    InputError
        If no step of the run has a program: nothing moves, there is a formula, or it is linear.
    """
    source = find_source(source)
    progress(f"{source.name}: a run of {count('steps', steps)} steps records its programs")
    programs = record(source, steps)
    _, q, C = programs[0]
    solvers = list(solvers_for(C))
    progress(f"{len(programs)} programs of {q.size} unknowns for {len(solvers)} solvers")
    parts = []
    for k, (setting, solver) in enumerate(solvers, start=1):
        part = DataFrame(trials(solver, programs))
        parts.append(part.assign(solver=solver.name, setting=setting, accuracy=ACCURACIES[setting]))
        solved = (part.certificate <= ACCURACIES[setting]).mean()
        progress(f"{k} of {len(solvers)}: {solver.name} {setting}: solved {solved:.3g}")
    rows = concat(parts)
    rows["solved"] = rows.certificate <= rows.accuracy
    rows["time"] = rows.seconds.where(rows.solved, rows.seconds.max())
    table = rows.groupby(["solver", "setting", "accuracy"], sort=False, as_index=False).agg(
        programs=("certificate", "size"),
        solved=("solved", "mean"),
        time=("time", shifted_mean),
        certificate=("certificate", "median"),
        worst=("certificate", "max"),
        message=("message", "max"),
    )
    best = table[table.solved == 1.0].groupby("accuracy").time.min()
    table.insert(6, "ratio", table.time / table.accuracy.map(best))
    return table.sort_values(
        ["accuracy", "solved", "time"], ascending=[False, False, True], ignore_index=True
    )


def solvers_for(C: ConvexSet) -> Iterator[tuple[str, Solver]]:
    """The library's own solvers and those installed for cvxpy, with a setting, for a set."""
    everyone: list[tuple[str, Solver]] = [("high", Newton()), ("high", DAQP())]
    for setting, tol in ACCURACIES.items():
        everyone += [(setting, Clarabel(tol=tol)), (setting, OSQP(tol=tol))]
        for name in filter(CVXPY.get, installed()):
            settings = dict.fromkeys(CVXPY[name]["tolerances"], tol)
            everyone.append((setting, Cvxpy(name, settings | CVXPY[name].get("limits", {}))))
    return ((setting, solver) for setting, solver in everyone if solver.treats(C))


def record(source: Source, steps: int) -> list[Program]:
    """The programs of a run of a problem, without those of steps at rest."""
    programs: list[Program] = []

    class Recorder(Clarabel):
        def compile(self, program: VelocityProgram) -> Solve:
            answer = super().compile(program)

            def noted(q: Array, C: ConvexSet) -> Any:
                programs.append((program, q.copy(), C))
                return answer(q, C)

            return noted

    process, t_end, *_ = open_source(source)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solve(process, t_end=t_end, steps=steps, solver=Recorder(), on_failure="stop")
    if not programs:
        raise InputError(f"{source.name} has no program to compare solvers on: no step needs one")
    return programs


def trials(solver: Solver, programs: Sequence[Program]) -> list[Trial]:
    """Every program in the order of time, a call that is not timed before the first one."""
    compiled: dict[int, Solve] = {}
    results = []
    quiet = contextlib.redirect_stdout(io.StringIO())
    with quiet, warnings.catch_warnings(), threadpool_limits(1):
        warnings.simplefilter("ignore")
        for statement, q, C in programs:
            try:
                if id(statement) not in compiled:
                    compiled[id(statement)] = solver.compile(statement)
                    compiled[id(statement)](q, C)  # warm
                started = clock.perf_counter()
                z = compiled[id(statement)](q, C).z
                seconds = clock.perf_counter() - started
                relative = certify(statement.M, q, C, z).relative if np.isfinite(z).all() else inf
                results.append(Trial(seconds, relative))
            except Exception as error:  # a solver that breaks is a row of the table
                results.append(Trial(message=f"{type(error).__name__}: {error}"))
    return results


def shifted_mean(seconds: Any) -> float:
    """The geometric mean, shifted by a millisecond: what takes no time does not decide it.

    Examples
    --------
    >>> round(shifted_mean([1e-3, 3e-3]), 6)
    0.001828
    """
    return float(np.exp(np.log(np.asarray(seconds) + 1e-3).mean()) - 1e-3)


def comparison_text(table: DataFrame) -> str:
    """The comparison as text."""
    require_columns(table, ("time", "ratio", "programs", "message"))
    names = {"time": "ms", "ratio": "x best", "certificate": "median", "message": ""}
    shown = table.assign(time=1e3 * table.time, message=table.message.str[:60])
    shown = shown.drop(columns="programs").rename(columns=names)
    return f"{shown.to_string(**FORMAT)}\n{LEGEND}"
