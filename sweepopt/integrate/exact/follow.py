"""The exact trajectory on the grid of a run, each node judged by the sets themselves."""

from __future__ import annotations

import time as clock
from functools import cached_property, partial
from typing import NamedTuple, Protocol

import numpy as np

from sweepopt.errors import InputError, Status, shown
from sweepopt.integrate.exact.rows import Rows, rows_of
from sweepopt.integrate.exact.trajectory import Phase, Trajectory, integrate
from sweepopt.integrate.loop import FullCertificate, Observer, Restarts
from sweepopt.integrate.loop import integrate as integrate_steps
from sweepopt.integrate.record import Run, Summary
from sweepopt.linalg import Factor
from sweepopt.problem import SweepingProcess
from sweepopt.velocity import Plan, Velocity, VelocityProgram, matrix, rate

FLOOR = 0.01
GOLDEN = 0.381966  # no usual load has this share of a step as its period
BLOCK = 1000  # nodes that are computed at once


class Move(Protocol):
    """Moves a process through a grid: what the loop does with its first two arguments given."""

    def __call__(
        self,
        times: np.ndarray,
        mus: np.ndarray,
        run: Run,
        observer: Observer | None = None,
        full_certificate: FullCertificate | None = None,
    ) -> None: ...


def mover(process: SweepingProcess, plan: Plan, restarts: Restarts | None = None) -> Move:
    """What moves a process through a grid: the scheme's steps, or the exact trajectory.

    `restarts` are for steps only.

    Raises
    ------
    InputError
        If the scheme is "exact" and the process is not one of polyhedra and loads as data.
    """
    if not plan.scheme.exact:
        return partial(integrate_steps, process, plan, restarts=restarts)
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
    run: Run,
    observer: Observer | None = None,
    full_certificate: FullCertificate | None = None,
) -> None:
    """As the loop does, with nodes of the exact trajectory."""
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
            if full_certificate is not None:
                step = full_certificate(i, before, z, step)
            if step.relative > tol:
                run.cause, run.relative = _cause(i, times, step.relative, tol), step.relative
                run.status = Status.INEXACT
                return
            if step.relative != step.relative:
                run.status = Status.UNCERTIFIED
            run.add(u, z, step, clock.perf_counter() - started + share)
            before = u
            if observer is not None and observer(i, u, z, step.certificate):
                run.status = Status.STOPPED if run.done < len(mus) else run.status
                return
        if not exact.complete:
            run.status = Status.SWITCHING
            run.cause = f"That was at t = {exact.end:g}, after {len(exact.phases)} phases."
    except KeyboardInterrupt:
        run.status = Status.INTERRUPTED


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
        found = VelocityProgram(M, C).certify(q, C, z, np.zeros(C.offsets.size))
        certificate = found.certificate + M.norm(z - found.z)
        inside = process.C.at(t - GOLDEN * mu).anchor  # a load may vanish at both nodes
        apart = M.norm(terms) + M.dual_norm(np.abs(C.anchor)) + M.dual_norm(np.abs(inside))
        if process.B is not None:
            apart += M.dual_norm(abs(process.B) @ (self._extent + mu * terms))
        return rate(z, certificate, M.norm(z), max(M.dual_norm(q - C.anchor), FLOOR * apart))


def _cause(i: int, times: np.ndarray, relative: float, tol: float) -> str:
    return (
        f"step {i} from t = {times[i]:g}: the closed form misses the inclusion by {relative:.2g} "
        f"of the velocity's size at its end, tol is {tol:g}. The data are scaled too badly for "
        "double precision; loosen tol or use implicit-euler or sdirk2"
    )
