"""The exact trajectory on the grid of a run, each node judged by the sets themselves."""

from __future__ import annotations

import time as clock
from functools import cached_property, partial
from typing import NamedTuple, Protocol

import numpy as np

from sweepopt.errors import InputError, Status, shown
from sweepopt.integrate.exact.rows import Rows, rows_of
from sweepopt.integrate.exact.trajectory import Phase, Trajectory, integrate
from sweepopt.integrate.loop import Look, Marks, Prove, Run, march
from sweepopt.integrate.states import Keeper
from sweepopt.integrate.statistics import Log
from sweepopt.integrate.step import Summary
from sweepopt.linalg import Factor
from sweepopt.problem import SweepingProcess
from sweepopt.velocity import Plan, Velocity, certify_point, matrix

FLOOR = 0.01
GOLDEN = 0.381966  # no usual load has this share of a step as its period
BLOCK = 1000  # nodes that are computed at once


class Move(Protocol):
    """Moves a process through a grid: what `march` does with its first two arguments given."""

    def __call__(
        self,
        times: np.ndarray,
        mus: np.ndarray,
        keeper: Keeper,
        look: Look | None = None,
        prove: Prove | None = None,
    ) -> Run: ...


def mover(process: SweepingProcess, plan: Plan, marks: Marks | None = None) -> Move:
    """What moves a process through a grid: the scheme's steps, or the exact trajectory.

    `marks` are for steps only.

    Raises
    ------
    InputError
        If the scheme is "exact" and the process is not one of polyhedra and loads as data.
    """
    if not plan.scheme.exact:
        return partial(march, process, plan, marks=marks)
    if plan.solver != "auto":
        raise InputError(
            f"scheme 'exact' has no use for solver={shown(plan.solver)}; leave one of them out"
        )
    return partial(follow, rows_of(process), process, plan.tol)


def follow(
    rows: Rows,
    process: SweepingProcess,
    tol: float,
    times: np.ndarray,
    mus: np.ndarray,
    keeper: Keeper,
    look: Look | None = None,
    prove: Prove | None = None,
) -> Run:
    """As `march` does, with nodes of the exact trajectory."""
    run = Run(Log(len(mus)))
    try:
        started = clock.perf_counter()
        exact = run.exact = integrate(rows, process.u0, float(times[0]), float(times[-1]))
        known = int(np.searchsorted(times, exact.end, side="right")) - 1
        share = (clock.perf_counter() - started) / len(mus)
        nodes = _Nodes(exact, times)
        inclusion = _Inclusion(process, exact)
        before = process.u0
        for i in range(known):
            started = clock.perf_counter()
            u, derivative, terms, phases = nodes(i + 1)
            z = (u - before) / mus[i]
            found = inclusion(float(times[i + 1]), float(mus[i]), u, derivative, terms)
            step = Summary(phases, 1, found.certificate, found.relative, "closed form")
            step = step if prove is None else prove(i, before, z, step)
            if step.relative > tol:
                run.cause, run.relative = _cause(i, times, step.relative, tol), step.relative
                run.status = Status.INEXACT
                return run
            if step.relative != step.relative:
                run.status = Status.UNCERTIFIED
            keeper.put(i, u, z)
            run.log.add(i, step, clock.perf_counter() - started + share)
            run.done, before = i + 1, u
            if look is not None and look(i, u, z, step.certificate):
                run.status = Status.STOPPED if run.done < len(mus) else run.status
                return run
        if not exact.complete:
            run.status = Status.SWITCHING
            run.cause = f"That was at t = {exact.end:g}, after {len(exact.phases)} phases."
    except KeyboardInterrupt:
        run.status = Status.INTERRUPTED
    return run


class _Node(NamedTuple):
    """u, u', its terms and the number of phases that begin in the step that ends there."""

    u: np.ndarray
    derivative: np.ndarray
    terms: np.ndarray
    phases: int


class _Nodes:
    """States and left derivatives at the nodes of a grid, a block of them at once."""

    def __init__(self, exact: Trajectory, times: np.ndarray) -> None:
        self._exact, self._times, self._first = exact, times, -BLOCK
        self._phases = np.searchsorted(times, exact.starts, side="right")

    def __call__(self, i: int) -> _Node:
        if not 0 <= i - self._first < BLOCK:
            self._first = i
            block = self._times[i : i + BLOCK]
            block = block[block <= self._exact.end]
            self._u, self._z = self._exact(block), self._exact.velocity(block)
            self._terms = self._exact.seen(block, Phase.terms)
        j = i - self._first
        return _Node(self._u[j], self._z[j], self._terms[j], self._counts[i])

    @cached_property
    def _counts(self) -> list[int]:
        return np.bincount(self._phases, minlength=len(self._times)).tolist()


class _Inclusion:
    """How far -u' in N_C(A u' + B u) is missed, from A, B and the set's own projection.

    u' solves the program of an implicit Euler step that ends in u, M = A + mu B and
    q = B (u - mu u'); the certificate is that of this program. Where u, u' and the load cancel to
    what rounding leaves of them, that is no measure: a size counts as FLOOR of their terms.
    """

    def __init__(self, process: SweepingProcess, exact: Trajectory) -> None:
        self._process = process
        self._extent = np.max([np.abs(phase.u) for phase in exact.phases], axis=0)
        self._factors: dict[float, Factor] = {}

    def __call__(
        self, t: float, mu: float, u: np.ndarray, z: np.ndarray, terms: np.ndarray
    ) -> Velocity:
        process, C = self._process, self._process.C.at(t)
        if mu not in self._factors:
            self._factors = {mu: Factor(matrix(process, mu))}
        M = self._factors[mu]
        q = process.times_B(u - mu * z)
        inside = process.C.at(t - GOLDEN * mu).anchor  # a load may vanish at both nodes
        apart = M.norm(terms) + M.dual_norm(np.abs(C.anchor)) + M.dual_norm(np.abs(inside))
        if process.B is not None:
            apart += M.dual_norm(abs(process.B) @ (self._extent + mu * terms))
        return certify_point(M, q, C, z, FLOOR * apart)


def _cause(i: int, times: np.ndarray, relative: float, tol: float) -> str:
    return (
        f"step {i} from t = {times[i]:g}: the closed form misses the inclusion by {relative:.2g} "
        f"of the velocity's size at its end, tol is {tol:g}. The data are scaled too badly for "
        "double precision; loosen tol or use implicit-euler or sdirk2"
    )
