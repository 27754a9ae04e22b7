"""One cell of a study: a problem, scheme, solver and size, and the function that makes it a row.

An error is measured against exact states, or against a fine run that knows its own error.
"""

from __future__ import annotations

import gc
import os
import platform
import re
import time as clock
import warnings
from contextlib import suppress
from functools import cache, lru_cache, partial
from math import inf, nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from sweepopt.checks import Array
from sweepopt.driver import solve
from sweepopt.errors import SweepoptError, SweepoptWarning
from sweepopt.io import read_toml, versions_of
from sweepopt.problem import SweepingProcess
from sweepopt.results import Solution, guaranteed_bound
from sweepopt.study.problems import PROBLEMS, Source, digest_of

REFINED = 16
"""A fine run has so many times the steps: of order 2, its error is far below the one measured."""


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
        one = self.problem
        return CellRow(one.name, one.refinements, one.element, *self[1:], self.id, **results)

    def failed(self, error: BaseException) -> CellRow:
        """The row of a cell that ended with an exception."""
        return self.row(status=type(error).__name__, message=str(error))


class CellRow(NamedTuple):
    """A row of the study's table; nan, 0 or "" where there is nothing to say.

    Attributes
    ----------
    problem, refinements, element, scheme, solver, steps, tol, repeats
        As asked; the element is "" where it is the scene's own.
    run : str
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
    run: str
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


@lru_cache(8)
def open_source(source: Source) -> tuple[SweepingProcess, float, Any, str]:
    """The process, how long it runs, a scene's discretisation and path, once in each worker.

    Raises
    ------
    SweepoptError
        If the files are not those the digest was taken of.
    """
    if source.own is not None:
        return *source.own, None, "auto"
    path = Path(source.path)
    if digest_of(path) != source.digest:
        raise SweepoptError(f"{path} is not as it was when the study started; start it again")
    if source.small:
        small = PROBLEMS[source.name]
        return small.process(), small.t_end, None, "auto"
    from sweepopt.fem import read_scene

    changes: dict[str, Any] = {"domain.element": source.element} if source.element else {}
    if source.refinements:
        own = read_toml(path).get("domain", {}).get("refinements", 0)
        changes["domain.refinements"] = own + source.refinements
    scene = read_scene(path, changes=changes)
    return scene.problem.as_sweeping(), scene.t_end, scene.discretisation, scene.path


@lru_cache(8)
def from_coarser(source: Source, coarse: Source) -> Any:
    """The matrix that turns states on a coarser mesh of a scene into states on a finer one."""
    return open_source(source)[2].from_coarser(open_source(coarse)[2])


class Reference(NamedTuple):
    """States on the nodes of a cell, shape (steps+1, dim).

    Attributes
    ----------
    u : ndarray
        Empty if there are none.
    uncertainty : float
        Of u, sup over the nodes in |.|_A: the distance from the run with half the steps, which for
        a run of order p is 2^p - 1 times its own error; 0 if exact, inf if there are none.
    message : str
        Why there are none, a sentence.
    """

    u: Array = np.empty(0)
    uncertainty: float = inf
    message: str = ""

    def error(self, process: SweepingProcess, u: Array) -> float:
        """The error of states on the nodes; nan if the reference's own is not 20 times less."""
        if len(u) != len(self.u):
            return nan
        error = largest_norm(process, u - self.u)
        return error if error >= 20 * self.uncertainty else nan


@lru_cache(8)
def find_reference(source: Source, steps: int) -> Reference:
    """The states of a problem on a grid of equal steps; what goes wrong leaves none.

    They are computed once in each process, of the last problems.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SweepoptWarning)
        try:
            return reference_states(*open_source(source)[:2], steps)
        except Exception as error:
            return Reference(message=f" No reference: {type(error).__name__}: {error}.")


def reference_states(
    process: SweepingProcess, t_end: float, steps: int, save: int = REFINED
) -> Reference:
    """States as well as the library knows them, by the event-exact integrator or by a fine run.

    Parameters
    ----------
    steps, save : int
        The states are those of every `save`-th of REFINED * steps equal steps.
    """
    run = partial(solve, process, t_end=t_end)
    with suppress(SweepoptError):  # the event-exact integrator does not apply
        return Reference(run(steps=steps * REFINED // save, scheme="exact").u, 0.0)
    run = partial(run, tol=1e-8, on_unstable="ignore")  # a hundredth of the default of a study
    fine = run(steps=steps * REFINED, save=save).u
    coarse = run(steps=steps * REFINED // 2, save=max(save // 2, 1)).u
    return Reference(fine, largest_norm(process, fine[:: 2 // min(save, 2)] - coarse))


def largest_norm(process: SweepingProcess, u: Array) -> float:
    """sup over the nodes of |u_i|_A, of |.|_B where A = 0."""
    return max(map(process.metric.norm, u))


def run_cell(cell: Cell, finest: Source) -> CellRow:
    """Run a cell. What goes wrong is a row as well.

    A pure function of plain data, times apart: it runs in workers.

    Parameters
    ----------
    cell : Cell
    finest : Source
        What errors are against: the cell's own problem, or that on a finer mesh.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            solution_of(cell)  # packages are imported, the problem is assembled, caches are filled
            with threadpool_limits(1):
                row = _measure(cell, finest)
        except Exception as error:  # whatever it is, the table has it
            return cell.failed(error)._replace(machine=machine())
    ours = [f"{one.message}." for one in caught if issubclass(one.category, SweepoptWarning)]
    return row._replace(message=" ".join([row.message, *dict.fromkeys(ours)]))


def solution_of(cell: Cell) -> Solution:
    """The cell's trajectory, solved anew."""
    process, t_end, _, path = open_source(cell.problem)
    return solve(
        process,
        t_end=t_end,
        steps=cell.steps,
        scheme=cell.scheme,
        solver=cell.solver,
        tol=cell.tol,
        path=path,
        on_failure="stop",
    )


def _measure(cell: Cell, finest: Source) -> CellRow:
    """The last of several equal runs, with the medians of their times.

    Its error is that of a function on the finest mesh.
    """
    gc.collect()
    times = []
    for _ in range(cell.repeats):
        wall, cpu = clock.perf_counter(), clock.process_time()
        solution = solution_of(cell)
        times.append((clock.perf_counter() - wall, clock.process_time() - cpu))
    wall, cpu = np.median(times, axis=0).tolist()
    reference = find_reference(finest, cell.steps)
    stats, process, u = solution.stats, solution.process, solution.u
    size = largest_norm(process, u)
    if finest != cell.problem:
        process, u = open_source(finest)[0], u @ from_coarser(finest, cell.problem).T
    return cell.row(
        status=solution.status.name,
        success=solution.success,
        message=solution.message + reference.message,
        error=reference.error(process, u),
        reference_error=reference.uncertainty,
        size=size,
        bound=float(guaranteed_bound(solution)),
        certificate=stats["relative"].max() if len(stats) else nan,
        wall=wall,
        cpu=cpu,
        steps_done=len(stats),
        solver_calls=stats["attempts"].sum(),
        unknowns=solution.plan.unknowns,
        path=solution.plan.path,
        machine=machine(),
    )


# ---- what computes ----


@cache
def machine() -> str:
    """Processor, threads and versions, in one line.

    Examples
    --------
    >>> "numpy" in machine()
    True
    """
    cpuinfo = Path("/proc/cpuinfo")
    names = re.findall(r"model name\s*: (.*)", cpuinfo.read_text() if cpuinfo.exists() else "")
    name, *_ = *names, platform.processor()
    threads = os.environ.get("OMP_NUM_THREADS", "unset")
    packages = ", ".join(map(" ".join, versions_of().items()))
    system = f"{os.cpu_count()} cores, {platform.system()}, OMP_NUM_THREADS {threads}"
    return f"{name}, {system}; {packages}"
