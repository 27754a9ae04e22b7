"""The exact trajectory on the grid of a run, the inclusion checked at each node."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache

import numpy as np

from sweepopt.errors import InputError, Status, shown
from sweepopt.integrate.exact.rows import Rows, rows_of
from sweepopt.integrate.exact.trajectory import Phase, Trajectory, phases_of
from sweepopt.integrate.record import Run
from sweepopt.integrate.step import Step
from sweepopt.linalg import Factor
from sweepopt.problem import SweepingProcess
from sweepopt.velocity import Plan, Velocity, certify_point, matrix

FLOOR = 0.01  # share of the largest forces so far that counts as the size of their sum


def exact_steps(
    process: SweepingProcess, plan: Plan, run: Run
) -> Callable[[float, float, np.ndarray], Step | None]:
    """What takes the next step along the exact trajectory, of length mu from t, u; None where the
    switches accumulate.

    The certificate is that of -u' in N_C(A u' + B u) at the end of the step, from A, B and the
    set's own projection: u' solves the program of an implicit Euler step that ends in u,
    M = A + mu B and q = B (u - mu u'). B u and the load may cancel: then it is compared to their
    sizes, not to that of their sum.

    Raises
    ------
    InputError
        If the process is not one of polyhedra and loads as data.
    """
    if plan.solver != "auto":
        raise InputError(
            f"scheme 'exact' has no use for solver={shown(plan.solver)}; leave one of them out"
        )
    rows, times = rows_of(process), run.grid.times
    factor = lru_cache(maxsize=1)(lambda mu: Factor(matrix(process, mu)))
    largest = 0.0
    nodes = _nodes(rows, process.u0, times, run)

    def take(t: float, mu: float, u: np.ndarray) -> Step | None:
        nonlocal largest
        node = next(nodes, None)
        if node is None:
            assert run.exact is not None
            run.status = Status.SWITCHING
            run.cause = f"That was at t = {run.exact.end:g}, after {len(run.exact.phases)} phases."
            return None
        after, z, phases = node
        C, M = process.C.at(float(times[run.done + 1])), factor(mu)
        force = process.times_B(after)
        largest = max(largest, M.norm(z) + M.dual_norm(force) + M.dual_norm(C.anchor))
        at_end = Velocity(z, 0.0, 0.0)  # at rest in C
        if z.any() or C.normal(force).any():
            q = process.times_B(after - mu * z)
            at_end = certify_point(M, q, C, z, FLOOR * largest)
            if plan.reduction is not None:
                at_end = plan.reduction.certified(mu, after - mu * z, at_end)
        velocity = at_end._replace(
            z=(after - u) / mu, solver="closed form", iterations=phases, attempts=1
        )
        return Step(velocity, end=after)

    return take


def _nodes(
    rows: Rows, u0: np.ndarray, times: np.ndarray, run: Run
) -> Iterator[tuple[np.ndarray, np.ndarray, int]]:
    """u, u' and the phases that were new at each node, as far as phases go; `run` gets them."""
    phases: list[Phase] = []
    done, before = 1, 0
    for phase in phases_of(rows, u0, float(times[0]), float(times[-1])):
        phases.append(phase)
        run.exact = run.exact or Trajectory(phases, run.grid.plan)
        end = int(np.searchsorted(times, phase.end, side="right"))
        block = times[done:end]  # one by one they take twice as long
        for u, z in zip(phase.state(block), phase.velocity(block), strict=True):
            yield u, z, len(phases) - before
            before = len(phases)
        done = max(done, end)
