"""Adaptive steps: passes over the whole run, each on a better grid, until the error is small.

The flow damps errors and stops them (MATH.md section 3): at a step the effect of its local error on
later u is not known. So the grid is chosen for the run as a whole. A grid contains the one before;
the difference of the two passes at the common nodes is what the finer grid has gained, and with it
known how much smaller the sum of local errors is, the global error is known too (Richardson). The
next grid is the coarsest one whose local errors add up to a share of those of the last one.

A step h of a scheme of order r has a local error of h^(r+1) |z^(r)|_A but for a constant, z^(r)
from differences of the velocities. To it a part is added that is the same in all steps, so large
that it alone asks for half of them (a monitor function with a floor: de Boor, Huang): what no
difference of velocities shows is then seen by the next grid.

To the loop over time an adaptive grid is a grid as any other. Each segment between breakpoints is
in equal parts that are halved again and again, so that steps share their programs.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from sweepopt.checks import TIME_SLACK, Array
from sweepopt.errors import InputError, Status
from sweepopt.integrate.grid import (
    PER_PIECE,
    Adaptive,
    breakpoints_to_meet,
    divided,
    shortest_period,
)
from sweepopt.integrate.record import Pass, States
from sweepopt.integrate.schemes import Scheme
from sweepopt.linalg import EPS
from sweepopt.loads import History
from sweepopt.problem import SweepingProcess, histories_of, squares

STEPS = 1_000_000  # of the finest pass, or grid: hours, and 16 MB of states of one unknown
GOLDEN = 0.5 * (math.sqrt(5) - 1)  # steps cut in this ratio fall into step with no period
ADVICE = (
    "does the load jump there? Give it as data (a Table has no jumps, and its breakpoints are "
    "met exactly) or loosen the tolerance"
)

Runs = Callable[[Array, float], Any]
"""Times and a bound of the programs' tol -> Solution."""


def first_grid(steps: Adaptive, process: SweepingProcess, times: Array, scheme: Scheme) -> Array:
    """The coarsest grid of a run: it contains these times, the first and the last are its ends.

    It contains breakpoints, of dense tables only the points where they turn; the segments between
    them are in equal steps. Where the load is a function these are cut in the golden ratio, the
    longer part first and last by turns: stages at the same phase of a load in all steps would see
    nothing move.
    """
    begin, end = float(times[0]), float(times[-1])
    histories = histories_of(process.C)
    known = all(isinstance(history, History) for history in histories)
    period, stable = shortest_period(process), math.inf
    if scheme.explicit and process.Lam > 0:
        stable = 1 / process.Lam
    # enough for a second pass to see where errors are; twice as many where nothing is known between
    first = steps.first or (end - begin) / (16 if known else 32)
    longest = min(first, period / (2 * PER_PIECE), stable)
    if (end - begin) / longest > STEPS:
        raise InputError(
            f"Adaptive: steps of at most {longest:.3g} up to t_end = {end:g} are more than "
            f"{STEPS:g}. First is {first:.3g}, the data have a period of {period:.3g} and need "
            f"{2 * PER_PIECE} steps in each, and {scheme.name} is stable up to about {stable:.3g}: "
            "make first longer, leave out the term of that period, take an implicit scheme or a "
            "shorter t_end"
        )
    breakpoints = _apart(np.r_[begin, breakpoints_to_meet(histories, begin, end), end])
    cuts = _apart(np.append(breakpoints, times))
    piece = np.searchsorted(breakpoints, 0.5 * (cuts[1:] + cuts[:-1]))
    longest = np.minimum(longest, np.diff(breakpoints)[piece - 1] / PER_PIECE)
    share = 1.0 if known else GOLDEN
    counts = np.ceil(share * np.diff(cuts) / longest * (1 - 1e-9)).astype(int)
    grid = divided(cuts, counts)
    if not known:
        sizes = np.diff(grid)
        odd = np.arange(sizes.size) % 2
        grid = np.sort(np.append(grid, grid[:-1] + np.where(odd, 1 - share, share) * sizes))
    return grid


def with_breakpoints(process: SweepingProcess, times: Array) -> Array:
    """The grid with the breakpoints of the load, in steps enough for differences of velocities."""
    points = breakpoints_to_meet(histories_of(process.C), float(times[0]), float(times[-1]))
    grid = _apart(np.append(times, points))
    return grid if len(grid) > PER_PIECE else divided(grid, np.full(len(grid) - 1, PER_PIECE))


def adapt(
    run: Runs,
    process: SweepingProcess,
    steps: Adaptive,
    sol: Any,
    error: float = math.inf,
) -> tuple[Any, str]:
    """The run over the first grid with a small estimated error, and why there is none.

    Ctrl-C during a pass returns its steps, Ctrl-C between two passes the one before.

    Parameters
    ----------
    sol : Solution
        The first run.
    error : float
        A bound of its error, if one is known; from the second run on it is estimated.
    """
    before, share, tol, passes, shortest = None, math.nan, math.inf, list(sol.passes), math.nan
    while sol.success:
        sizes, r = np.diff(sol.t), int(sol.plan.scheme.order)
        leading = _leading(process, sol)
        errors = leading * sizes ** (r + 1)
        if before is None:  # breakpoints are met anyway
            shortest = min(steps.minimum or 2.0**-40 * sizes.sum(), sizes.min())
        else:
            error = _estimate(process, before, sol, share, errors)
            passes[-1] = passes[-1]._replace(error=error)
        sol = replace(sol, passes=tuple(passes))
        if error <= steps.tol:
            return sol, ""
        speeds = np.maximum(squares(process.metric.M, sol.velocity), 0.0)
        length = float(sizes @ np.sqrt(speeds))
        # a share for residuals of programs, which no difference sees; all programs reach 1e-9
        tol = max(0.05 * steps.tol / length, 1e-9) if length else tol
        goal = 0.7 * steps.tol / error  # estimates scatter by a third
        density = float(leading ** (1 / (r + 1)) @ sizes)
        wanted = (
            density * (density / (errors.sum() * goal)) ** (1 / r) if before is not None else 0.0
        )
        rounding = EPS * (length + process.metric.norm(process.u0))
        if cause := _failure(steps.tol, rounding, wanted, passes):
            return sol, cause
        # two to four times the steps: farther its differences do not say where they are needed
        share = min(max(goal, 4.0**-r), 2.0**-r)
        times = _refined(sol.t, leading, r, share * float(errors.sum()))
        h = np.diff(times)
        if h.min() < shortest:
            at = times[h.argmin()]
            cause = f"a step shorter than minimum = {shortest:g} is needed at t = {at:g}; {ADVICE}"
            return _first_steps(sol, int(np.searchsorted(sol.t, at, "right")) - 1), cause
        before = sol
        try:
            sol = run(times, tol)
        except KeyboardInterrupt:  # the loop over time takes those that arrive during its steps
            return replace(before, status=Status.INTERRUPTED), ""
        passes += sol.passes
    return replace(sol, passes=tuple(passes)), ""


def _estimate(
    process: SweepingProcess, before: Any, sol: Any, share: float, errors: Array
) -> float:
    """Of the error of a run, by the one before, the local errors and their share of that one's."""
    common = np.isin(sol.t, before.t, assume_unique=True)
    change = squares(process.metric.M, sol.u[common] - before.u).max()
    error = math.sqrt(max(change, 0.0)) * share / (1 - share)
    # of switches, with signs by chance: where z' jumps at the share x of a step, the error of order
    # 2 is x (1 - x) / 2 of h^3 z'', in the mean over x a twelfth
    return error + math.sqrt((errors**2).sum()) / 12


def _first_steps(sol: Any, k: int) -> Any:
    """The first k steps of a run that kept all of them."""
    rows = sol.statistics.rows[:k]
    states = States(sol.steps[:k], sol.u[: k + 1].__getitem__, sol.velocity[:k].__getitem__)
    statistics = sol.statistics._replace(rows=rows)
    return replace(sol, t=sol.t[: k + 1], states=states, statistics=statistics)


def _leading(process: SweepingProcess, sol: Any) -> Array:
    """|z^(r)| in each step and its floor.

    Differences are taken across breakpoints too: a motion that stops in the first step after one,
    or before its first stage, is seen by nothing else.
    """
    middle, r = 0.5 * (sol.t[1:] + sol.t[:-1]), int(sol.plan.scheme.order)
    slopes = sol.velocity
    for k in range(1, r + 1):
        slopes = k * np.diff(slopes, axis=0) / (middle[k:] - middle[:-k])[:, None]
    squared = np.pad(squares(process.metric.M, slopes), (1, r - 1), "edge")
    leading = np.sqrt(np.maximum(squared, 1e-200))  # all steps of a body at rest count alike
    mean = np.average(leading ** (1 / (r + 1)), weights=np.diff(sol.t))
    return leading + mean ** (r + 1)


def _refined(times: Array, leading: Array, r: int, total: float) -> Array:
    """The grid, its steps halved until no local error is above the largest allowed one, where these
    are `total` in sum.
    """
    sums = np.append(0.0, np.cumsum(leading * np.diff(times)))
    grid, largest = times, total
    while True:
        errors = np.diff(np.interp(grid, times, sums)) * np.diff(grid) ** r
        coarse = errors > largest
        if coarse.any():
            middle = 0.5 * (grid[1:] + grid[:-1])
            grid = np.sort(np.append(grid, middle[coarse]))
        elif errors.sum() <= (1 + TIME_SLACK) * total:
            return grid
        else:
            largest *= 0.8  # small enough that hardly a grid is passed over


def _failure(tol: float, rounding: float, wanted: float, passes: list[Pass]) -> str:
    """Why it makes no sense to go on to so many steps, or nothing."""
    if tol < rounding:
        return f"{tol:g} is less than the rounding of u, {rounding:.2g}; ask for less accuracy"
    last = f"{passes[-1].error:.2g} with {passes[-1].steps} steps"
    # estimates scatter by a factor of two, but not three of them to one side; the first is nan
    if passes[-4:-3] and min(one.error for one in passes[-3:]) > passes[-4].error:
        return (
            f"the estimated error, {last}, rises with shorter steps: where they overshoot take "
            f"implicit-euler, which never does. Or {ADVICE}"
        )
    if wanted > STEPS:
        return (
            f"{tol:g} would take about {wanted:.2g} steps, more than {STEPS:g}; the run has an "
            f"estimated error of {last}. Ask for less accuracy, or take a scheme of higher order, "
            'or "exact" where C(t) has flat faces and the load is data'
        )
    return ""


def _apart(cuts: Array) -> Array:
    """Increasing; breakpoints that differ by rounding are one."""
    cuts = np.unique(cuts)
    distinct = cuts[np.append(True, np.diff(cuts) > TIME_SLACK * np.abs(cuts).max())]
    distinct[-1] = cuts[-1]
    return distinct
