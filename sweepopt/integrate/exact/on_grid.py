"""The exact trajectory on the grid of a run, the inclusion checked at each node."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from sweepopt.errors import InputError, Status, shown
from sweepopt.integrate.exact.rows import rows_of
from sweepopt.integrate.exact.trajectory import Trajectory, exact_trajectory
from sweepopt.integrate.record import Run
from sweepopt.integrate.step import Step
from sweepopt.linalg import Factor
from sweepopt.problem import SweepingProcess
from sweepopt.velocity import Plan, certify_point, matrix

FLOOR = 0.01  # share of the largest forces so far that counts as the size of their sum
BLOCK = 1000  # nodes that are computed at once: one by one they take twice as long


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

    @lru_cache(maxsize=1)
    def block(exact: Trajectory, first: int) -> tuple[np.ndarray, np.ndarray]:
        nodes = np.minimum(times[first + 1 : first + BLOCK + 1], exact.end)
        return exact(nodes), exact.velocity(nodes)

    def take(t: float, mu: float, u: np.ndarray) -> Step | None:
        nonlocal largest
        exact, i = run.exact, run.done
        end, k = float(times[i + 1]), i % BLOCK
        if exact is None:
            exact = exact_trajectory(rows, process.u0, float(times[0]), float(times[-1]))
            run.exact = exact
        if end > exact.end:
            run.status = Status.SWITCHING
            run.cause = f"That was at t = {exact.end:g}, after {len(exact.phases)} phases."
            return None
        after, z = (values[k] for values in block(exact, i - k))
        C, M = process.C.at(end), factor(mu)
        forces = M.norm(z) + M.dual_norm(process.times_B(after)) + M.dual_norm(C.anchor)
        largest = max(largest, forces)
        at_end = certify_point(M, process.times_B(after - mu * z), C, z, FLOOR * largest)
        phases = int(np.diff(np.searchsorted(exact.starts, [t, end]))[0])
        velocity = at_end._replace(
            z=(after - u) / mu, solver="closed form", iterations=phases, attempts=1
        )
        return Step(velocity, True, end=after)

    return take
