"""Refine a run until its guaranteed error bound (MATH 4) is small enough."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from sweepopt.errors import AccuracyError, InputError, Status
from sweepopt.integrate import divided
from sweepopt.results.solution import Solution

GROWTH = 8  # at most this many times the steps, from one run to the next: the rate is estimated
LEAST_GAIN = 0.9  # a bound that falls by less has come down to what programs and sums round
STEPS = 1_000_000  # of the finest grid: its states of one unknown take 16 MB
HOPELESS = 100 * STEPS  # needed by the order of the scheme, from a grid that may be too coarse


def refine(run: Callable[[np.ndarray], Solution], times: np.ndarray, error: float) -> Solution:
    """Run on finer and finer grids; each contains the one before.

    Ctrl-C during a run returns its steps, Ctrl-C during a bound the run that it is of.

    Parameters
    ----------
    run : callable
        Times -> Solution.
    times : ndarray, shape (n+1,)
        The first grid.
    error : float
        The bound that is asked for.

    Raises
    ------
    InputError
        If no bound is guaranteed for this process.
    AccuracyError
        If finer grids do not help any more.
    """
    last: float | None = None
    solution: Any = None
    while len(times) <= STEPS:
        try:
            solution = run(times)
            if not solution.success:
                return solution
            bound = solution._bound  # without the warning
        except KeyboardInterrupt:  # the loop over time takes those that arrive during its steps
            if solution is None:
                raise
            return replace(solution, status=Status.INTERRUPTED)
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
        times = divided(times, max(math.ceil(min(factor, GROWTH)), 2))
    raise AccuracyError(
        f"error = {error:g} was asked for, but the bound is {float(bound):.3g} with "
        f"{len(solution.t) - 1} steps and finer grids do not help or take more than {STEPS:g} "
        "steps. Ask for less, take a scheme of second order, or tighten tol",
        solution,
    )
