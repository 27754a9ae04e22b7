"""One cell of a study: a problem, scheme, solver and size, and the function that makes it a row."""

from __future__ import annotations

import contextlib
import gc
import time as clock
import warnings
from math import nan
from typing import Any, NamedTuple

import numpy as np

from sweepopt.errors import SweepoptError, SweepoptWarning
from sweepopt.results import ErrorBound, Solution
from sweepopt.solve import solve
from sweepopt.study.machine import machine, one_thread
from sweepopt.study.reference_states import Reference, largest_norm
from sweepopt.study.sources import Source, from_coarser, open_source
from sweepopt.velocity import Cvxpy

THROUGH_CVXPY = "cvxpy:"  # such as cvxpy:piqp


class Cell(NamedTuple):
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

    def __str__(self) -> str:
        return f"{self.problem} {self.scheme} {self.solver} {self.steps} steps tol {self.tol}"

    @property
    def id(self) -> str:
        """What defines the cell: the settings and a digest of the problem's data, not its place."""
        return f"{self} repeats {self.repeats} {self.problem.digest}"

    def row(self, **results: Any) -> CellRow:
        """The cell's row with these results."""
        name, _, _, refinements, element = self.problem
        return CellRow(name, refinements, element, *self[1:], self.id, **results)

    def failed(self, error: BaseException) -> CellRow:
        """The row of a cell that ended with an exception."""
        return self.row(status=type(error).__name__, message=str(error))


class CellRow(NamedTuple):
    """A row of the study's table; nan, 0 or "" where there is nothing to say.

    Attributes
    ----------
    problem, refinements, element, scheme, solver, steps, tol, repeats
        As asked; the element is "" where it is the scene's own.
    cell : str
        The cell's id.
    status : str
        Name of the run's `Status`, or of the exception's class.
    success : bool
    message : str
        The status or the exception in words, and the library's warnings.
    error : float
        sup over the nodes of |u_i - u(t_i)|_A (|.|_B where A = 0). u is exact on the cell's own
        mesh; in a study of several meshes or elements it is the solution on a finer one, and u_i is
        compared as a function on that (`Study.reference`).
    reference_error : float
        0 if the error is against exact states; else the estimate of its own error in time of the
        fine run, which is 20 times smaller or more. The error of a finest mesh is not in it.
    size : float
        sup over the nodes of |u_i|_A: what errors are small against.
    bound : float
        Guaranteed bound of sup_t |u - u_n|_A, u exact on the cell's own mesh.
    certificate : float
        The worst one of the run, relative: what tol bounds.
    wall, cpu : float
        Seconds, medians over the repeats.
    steps_done, solver_calls, unknowns : int
    path : str
        Of the plan.
    machine : str
        Where the cell ran: processor, threads and versions.
    """

    problem: str
    refinements: int
    element: str
    scheme: str
    solver: str
    steps: int
    tol: float
    repeats: int
    cell: str
    status: str = ""
    success: bool = False
    message: str = ""
    error: float = nan
    reference_error: float = nan
    size: float = nan
    bound: float = nan
    certificate: float = nan
    wall: float = nan
    cpu: float = nan
    steps_done: int = 0
    solver_calls: int = 0
    unknowns: int = 0
    path: str = ""
    machine: str = ""


def run_cell(cell: Cell, reference: Reference, finest: Source | None = None) -> CellRow:
    """Run a cell. What goes wrong is a row as well.

    A pure function of plain data, times apart: it runs in workers.

    Parameters
    ----------
    cell : Cell
    reference : Reference
        Of the cell's problem and steps.
    finest : Source, optional
        What the reference is of, if it has another mesh than the cell.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            solution_of(cell)  # packages are imported, the problem is assembled, caches are filled
            with one_thread():
                row = _timed(cell, reference, finest or cell.problem)
        except Exception as error:  # whatever it is, the table has it
            return cell.failed(error)._replace(machine=machine())
    ours = [f"{one.message}." for one in caught if issubclass(one.category, SweepoptWarning)]
    missing = [f"No reference: {reference.message}."] if reference.message else []
    return row._replace(message=" ".join([row.message, *dict.fromkeys(ours), *missing]))


def solution_of(cell: Cell) -> Solution:
    """The cell's trajectory, solved anew."""
    process, t_end = open_source(cell.problem)
    return solve(
        process,
        t_end=t_end,
        steps=cell.steps,
        scheme=cell.scheme,
        solver=named_solver(cell.solver),
        tol=cell.tol,
        on_failure="stop",
    )


def named_solver(name: str) -> Any:
    """What `sweepopt.solve` is given for the name of a solver."""
    through_cvxpy = name.startswith(THROUGH_CVXPY)
    return Cvxpy(name.removeprefix(THROUGH_CVXPY).upper()) if through_cvxpy else name


def _timed(cell: Cell, reference: Reference, finest: Source) -> CellRow:
    """The last of several equal runs, the medians of their times, its error and its bound."""
    gc.collect()
    times = []
    for _ in range(cell.repeats):
        wall, cpu = clock.perf_counter(), clock.process_time()
        solution = solution_of(cell)
        times.append((clock.perf_counter() - wall, clock.process_time() - cpu))
    wall, cpu = np.median(times, axis=0).tolist()
    process, stats = solution.process, solution.stats
    bound = guaranteed_bound(solution)
    return cell.row(
        status=solution.status.name,
        success=solution.success,
        message=solution.message,
        error=_error(reference, finest, cell.problem, solution),
        reference_error=reference.uncertainty,
        size=largest_norm(process, solution.u),
        bound=nan if bound is None else float(bound),
        certificate=stats["relative"].max() if len(stats) else nan,
        wall=wall,
        cpu=cpu,
        steps_done=len(stats),
        solver_calls=stats["attempts"].sum(),
        unknowns=solution.plan.unknowns,
        path=solution.plan.path,
        machine=machine(),
    )


def _error(reference: Reference, finest: Source, source: Source, solution: Solution) -> float:
    """The error of a run, as a function on the mesh of the reference."""
    if finest == source:
        return reference.error(solution.process, solution.u)
    u = solution.u @ from_coarser(finest, source).T
    return reference.error(open_source(finest)[0], u)


def guaranteed_bound(solution: Solution) -> ErrorBound | None:
    """The bound of the error; None if there is none, or only samples of C(t) are known."""
    with contextlib.suppress(SweepoptError):
        bound = solution.error_bound()
        return bound if bound.guaranteed else None
    return None
