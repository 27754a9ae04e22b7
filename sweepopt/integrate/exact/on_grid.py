"""The exact trajectory on the grid of a run, the inclusion checked at each node."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from functools import partial

import numpy as np

from sweepopt.errors import InputError, Status, shown
from sweepopt.integrate.exact.rows import Rows, rows_of
from sweepopt.integrate.exact.trajectory import exact_trajectory
from sweepopt.integrate.loop import FullCertificate, Observer, Restarts, integrate
from sweepopt.integrate.record import Run
from sweepopt.linalg import Factor
from sweepopt.problem import SweepingProcess
from sweepopt.velocity import Plan, Velocity, certify_point, matrix

FLOOR = 0.01  # share of the largest forces so far that counts as the size of their sum
BLOCK = 1000  # nodes that are computed at once


def mover(
    process: SweepingProcess, plan: Plan, restarts: Restarts | None = None
) -> Callable[..., None]:
    """What moves a process through a grid: the scheme's steps, or the exact trajectory.

    It takes what `integrate` takes beside the process and the plan; `restarts` are for steps only.

    Raises
    ------
    InputError
        If the scheme is "exact" and the process is not one of polyhedra and loads as data.
    """
    if not plan.scheme.exact:
        return partial(integrate, process, plan, restarts=restarts)
    if plan.solver != "auto":
        raise InputError(
            f"scheme 'exact' has no use for solver={shown(plan.solver)}; leave one of them out"
        )
    return partial(_on_grid, rows_of(process), process, plan.tol)


def _on_grid(
    rows: Rows,
    process: SweepingProcess,
    tol: float,
    run: Run,
    observer: Observer | None = None,
    full_certificate: FullCertificate | None = None,
) -> None:
    """As the loop does, with nodes of the exact trajectory."""
    times, mus = run.grid.times, run.grid.mus
    try:
        started = clock.perf_counter()
        exact = run.exact = exact_trajectory(rows, process.u0, float(times[0]), float(times[-1]))
        share = (clock.perf_counter() - started) / len(mus)
        count = int(np.searchsorted(times, exact.end, side="right")) - 1
        begun = np.searchsorted(times, exact.starts, side="right")
        phases = np.bincount(begun, minlength=len(times)).tolist()  # that begin in each step
        certificate, before = _certificate(process), process.u0
        for i in range(count):
            started = clock.perf_counter()
            k = i % BLOCK
            if k == 0:
                block = times[i + 1 : min(i + BLOCK, count) + 1]
                states, derivatives = exact(block), exact.velocity(block)
            u, mu = states[k], float(mus[i])
            z = (u - before) / mu
            at_end = certificate(float(times[i + 1]), mu, u, derivatives[k])
            step = at_end._replace(z=z, solver="closed form", iterations=phases[i + 1], attempts=1)
            if full_certificate is not None:
                step = full_certificate(i, before, step)
            if step.relative > tol:
                run.status, run.relative = Status.INEXACT, step.relative
                run.cause = (
                    f"step {i} from t = {times[i]:g}: the closed form misses the inclusion by "
                    f"{step.relative:.2g} of the velocity's size at its end, tol is {tol:g}. The "
                    "data are scaled too badly for double precision; loosen tol or use "
                    "implicit-euler or sdirk2"
                )
                return
            if np.isnan(step.relative):
                run.status = Status.UNCERTIFIED
            run.add(u, step, clock.perf_counter() - started + share)
            before = u
            if observer is not None and observer(i, u, z, step.certificate):
                run.status = Status.STOPPED if run.done < len(mus) else run.status
                return
        if not exact.complete:
            run.status = Status.SWITCHING
            run.cause = f"That was at t = {exact.end:g}, after {len(exact.phases)} phases."
    except KeyboardInterrupt:
        run.status = Status.INTERRUPTED


def _certificate(
    process: SweepingProcess,
) -> Callable[[float, float, np.ndarray, np.ndarray], Velocity]:
    """The certificate of -u' in N_C(A u' + B u) at a node, from A, B and the set's own projection.

    u' solves the program of an implicit Euler step that ends in u, M = A + mu B and
    q = B (u - mu u'); the certificate is that of this program. B u and the load may cancel: then
    it is compared to their sizes, not to that of their sum.
    """
    factors: dict[float, Factor] = {}
    largest = 0.0

    def certificate(t: float, mu: float, u: np.ndarray, z: np.ndarray) -> Velocity:
        nonlocal factors, largest
        if mu not in factors:
            factors = {mu: Factor(matrix(process, mu))}
        C, M = process.C.at(t), factors[mu]
        forces = M.norm(z) + M.dual_norm(process.times_B(u)) + M.dual_norm(C.anchor)
        largest = max(largest, forces)
        return certify_point(M, process.times_B(u - mu * z), C, z, FLOOR * largest)

    return certificate
