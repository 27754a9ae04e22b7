"""Refine a run until its guaranteed error bound is small enough."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from sweepopt.errors import AccuracyError, InputError
from sweepopt.integrate import divided
from sweepopt.results.solution import Solution

MOST = 8  # times the steps, from one run to the next
LEAST_GAIN = 0.9  # a bound that falls by less does not come closer to what was asked for
STEPS = 1_000_000  # of the finest grid
HOPELESS = 100 * STEPS  # that would be needed: coarse grids may promise less than they keep


def refine(run: Callable[[np.ndarray], Solution], times: np.ndarray, error: float) -> Solution:
    """Run on finer and finer grids; each contains the one before.

    Parameters
    ----------
    run : callable
        Times -> Solution.
    times : ndarray, shape (n+1,)
        The first grid.
    error : float
        What the bound shall reach.

    Raises
    ------
    InputError
        If no bound is guaranteed for this process.
    AccuracyError
        If finer grids do not help any more.
    """
    last: float | None = None
    while len(times) <= STEPS:
        solution = run(times)
        if not solution.success:
            return solution
        bound = solution.error_bound()
        if not bound.guaranteed:
            raise InputError(
                "error= needs a guaranteed bound, but only samples are known of this C(t): give "
                "the load as so.Separable of tables and waveforms (offsets h(t) with one entry a "
                "row of G), or look at sol.error_bound(variation=v)"
            )
        if bound <= error:
            return solution
        if last is not None and not bound < LEAST_GAIN * last:
            break
        last = float(bound)
        factor = (1.1 * bound / error) ** (1 / solution.plan.scheme.order)
        if math.isfinite(bound) and factor * len(times) > HOPELESS:
            break
        times = divided(times, max(math.ceil(min(factor, MOST)), 2))
    raise AccuracyError(
        f"error = {error:g} was asked for, but the bound is {float(bound):.3g} with "
        f"{len(solution.t) - 1} steps and finer grids do not help or take more than {STEPS:g} "
        "steps. Ask for less, take a scheme of second order, or tighten tol",
        solution,
    )
