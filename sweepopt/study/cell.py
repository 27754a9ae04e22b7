"""One cell of a study: a problem, scheme, solver and size, and the function that makes it a row."""

from __future__ import annotations

import gc
import hashlib
import json
import time as clock
import warnings
from dataclasses import astuple, dataclass
from math import isnan, nan
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from sweepopt.errors import SweepoptError, SweepoptWarning
from sweepopt.results import Solution
from sweepopt.solve import solve
from sweepopt.study.machine import one_thread, processor, versions
from sweepopt.study.reference_states import Reference, absent, distance, error_of
from sweepopt.study.sources import Source
from sweepopt.velocity import Cvxpy

THROUGH_CVXPY = "cvxpy:"  # such as cvxpy:piqp


@dataclass(frozen=True)
class Cell:
    """A run of a study as plain data.

    Attributes
    ----------
    problem : Source
    scheme : str
    solver : str
        A name that `sweepopt.solve` knows, or "cvxpy:NAME" for any solver installed for cvxpy.
    steps : int
    tol : float
    repeats : int
        Timed runs, after one that is not.
    """

    problem: Source
    scheme: str
    solver: str
    steps: int
    tol: float
    repeats: int

    @property
    def id(self) -> str:
        """A hash of what defines the cell: the settings and the problem's data, not its place."""
        name, _, digest = self.problem
        text = json.dumps([name, digest, *astuple(self)[1:]])
        return hashlib.sha256(text.encode()).hexdigest()[:24]

    def __str__(self) -> str:
        return (
            f"{self.problem.name} {self.scheme} {self.solver} {self.steps} steps tol {self.tol:g}"
        )


class CellRow(NamedTuple):
    """A row of the study's table; nan, 0 or "" where there is nothing to say.

    Attributes
    ----------
    problem, scheme, solver, steps, tol
        As asked.
    status : str
        Name of the run's `Status`, or of the exception's class.
    success : bool
    message : str
        The status or the exception in words, and the library's warnings.
    error : float
        sup over the nodes of |u_i - u(t_i)|_A (|.|_B where A = 0).
    error_is : {"exact", "certified", ""}
        Against exact states, or against a fine run whose own error is 20 times smaller or more.
    reference_error : float
        The reference's estimate of its own error, 0 if exact.
    size : float
        sup over the nodes of |u_i|_A: what errors are small against.
    bound : float
        Guaranteed bound of sup_t |u - u_n|_A.
    guaranteed : bool
    certificate : float
        The worst one of the run, relative: what tol bounds.
    wall, cpu : float
        Seconds, medians over the repeats.
    repeats, steps_done, solver_calls, unknowns : int
    path : str
        Of the plan.
    sweepopt, python, numpy, scipy, cvxpy, clarabel, osqp : str
        Versions where the cell ran.
    machine : str
    cell : str
        The cell's id.
    """

    problem: str
    scheme: str
    solver: str
    steps: int
    tol: float
    status: str = ""
    success: bool = False
    message: str = ""
    error: float = nan
    error_is: str = ""
    reference_error: float = nan
    size: float = nan
    bound: float = nan
    guaranteed: bool = False
    certificate: float = nan
    wall: float = nan
    cpu: float = nan
    repeats: int = 0
    steps_done: int = 0
    solver_calls: int = 0
    unknowns: int = 0
    path: str = ""
    sweepopt: str = ""
    python: str = ""
    numpy: str = ""
    scipy: str = ""
    cvxpy: str = ""
    clarabel: str = ""
    osqp: str = ""
    machine: str = ""
    cell: str = ""


def run_cell(cell: Cell, reference: Reference) -> CellRow:
    """Run a cell. What goes wrong is a row as well.

    A pure function of plain data, times apart: it runs in workers.

    Parameters
    ----------
    cell : Cell
    reference : Reference
        Of the cell's problem and steps.
    """
    place: dict[str, Any] = {"machine": processor(), **versions()}
    row = blank(cell)._replace(repeats=cell.repeats, **place)
    with one_thread(), warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            solution, times = _timed(cell)
            row = row._replace(**times, **_measured(cell, solution, reference))
        except Exception as error:  # whatever it is, the table has it
            return failed(row, error)
    ours = [f"{one.message}." for one in caught if issubclass(one.category, SweepoptWarning)]
    missing = [f"No reference: {reference.message}."] if reference.message else []
    return row._replace(message=" ".join([solution.message, *dict.fromkeys(ours), *missing]))


def blank(cell: Cell) -> CellRow:
    """The row of a cell that has not run."""
    return CellRow(cell.problem.name, cell.scheme, cell.solver, cell.steps, cell.tol, cell=cell.id)


def failed(row: CellRow, error: BaseException) -> CellRow:
    """The row of a cell that ended with an exception."""
    return row._replace(status=type(error).__name__, message=str(error))


def solution_of(cell: Cell) -> Solution:
    """The cell's trajectory, solved anew."""
    process, t_end = cell.problem.open()
    solver: Any = cell.solver
    if cell.solver.startswith(THROUGH_CVXPY):
        solver = Cvxpy(cell.solver.removeprefix(THROUGH_CVXPY).upper())
    return solve(
        process,
        t_end=t_end,
        steps=cell.steps,
        scheme=cell.scheme,
        solver=solver,
        tol=cell.tol,
        on_failure="stop",
    )


def _timed(cell: Cell) -> tuple[Solution, dict[str, Any]]:
    """The last of several equal runs, and the medians of their times."""
    cell.problem.open()  # assembled outside of the time, once in each worker
    solution = solution_of(cell)  # warm: packages are imported, caches are filled
    gc.collect()
    times = []
    with one_thread():  # also for what the first run imported
        for _ in range(cell.repeats):
            wall, cpu = clock.perf_counter(), clock.process_time()
            solution = solution_of(cell)
            times.append((clock.perf_counter() - wall, clock.process_time() - cpu))
    wall, cpu = map(median, zip(*times, strict=True))
    return solution, {"wall": wall, "cpu": cpu}


def _measured(cell: Cell, solution: Solution, reference: Reference) -> dict[str, Any]:
    """What a run says of itself, its error and the guaranteed bound, where there is one."""
    if cell.scheme == reference.kind == "exact":
        reference = absent("")  # it would be the run itself
    error = error_of(cell.problem, solution.u, reference)
    stats, done = solution.stats, len(solution.stats)
    row = {
        "status": solution.status.name,
        "success": solution.success,
        "error": error,
        "error_is": "" if isnan(error) else reference.kind,
        "reference_error": reference.uncertainty,
        "size": distance(cell.problem, solution.u, np.zeros_like(solution.u)),
        "certificate": float(stats["relative"].max()) if done else nan,
        "steps_done": done,
        "solver_calls": int(stats["attempts"].sum()),
        "unknowns": solution.plan.unknowns,
        "path": solution.plan.path,
    }
    try:
        bound = solution.error_bound()
    except SweepoptError:
        return row
    return row | {"bound": float(bound), "guaranteed": bound.guaranteed}
