"""Adaptive steps: passes over the whole run, each on a better grid, until the error is small.

The flow forgets and forgives (MATH.md section 3): what a step's error does to u later, nobody knows
at the step. So the grid is chosen for the run as a whole. A pass moves u along a grid of times; the
differences of its velocities say where the steps must be short, and, carried along, how large the
error is and so how many steps there must be. Two passes whose distance their errors do not explain
know less than they think. To the loop over time an adaptive grid is a grid as any other.

Each segment between breakpoints is in equal parts that are halved again and again, so that steps
share the compiled programs.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sweepopt.checks import number
from sweepopt.errors import InputError, Status
from sweepopt.flow import Flow
from sweepopt.grids import density, finer_grid, first_grid
from sweepopt.linalg import EPS
from sweepopt.march import Run
from sweepopt.solution import Pass
from sweepopt.watch import Watch

PASSES = 24
STEPS = 1_000_000  # of the finest pass
CHECKED = 256  # nodes at which passes are compared, fewer where states are large
AIM, FIRST_AIM = 1.7, 1.15  # the error that a pass is made for, in units of tol; the second pass
ACCEPTED = 2.7  # the error that it may have
ALONE = 1.9  # what the first one may have,
RESOLVED = 0.02  # and in units of the way that u goes: the steps have seen it move
GROWTH, LEAST = 4.0, 1.35  # a pass has at most, and at least, so many times the steps before
LAST = 0.33  # of the steps that are wanted, in the pass before
RISES = 4  # passes one after the other that overshoot, each with a greater error, lead nowhere
APART = 4.0  # times as far apart as their errors let expect two passes may be
MISTRUST = 2.0  # the most that an error counts for where they are further apart
FIRST = 16  # steps of the first pass
HIDDEN = 1 / 16  # of a jump of the velocity times the steps beside it: the error of a kink there


@dataclass(frozen=True)
class Adaptive:
    """Steps that are chosen such that max_i |u_i - u(t_i)|_A is about tol (|.|_B where A = 0).

    Parameters
    ----------
    tol : float
        The global error aimed at, in the units of |u|_A. It is estimated, not proved.
    first : float, optional
        Longest step, t_end / 16 by default. An event of a callable load that is shorter than the
        steps can pass unseen between them: make `first` as short as it.
    minimum : float, optional
        Shortest step, t_end 2^-40 by default.

    Raises
    ------
    InputError
        If a number is not positive, or minimum is longer than first.

    Examples
    --------
    >>> import sweepopt as so
    >>> C = so.Moving(so.Box([-1], [1]), center=lambda t: [1.5 * t])
    >>> process = so.SweepingProcess(A=[[0.5]], B=[[2.0]], C=C, u0=[0.0])
    >>> sol = so.solve(process, t_end=5.0, steps=so.Adaptive(1e-4))
    >>> sol.passes[-1].error < 3e-4, round(float(sol(5.0)[0]), 3)
    (True, 3.063)
    """

    tol: float
    first: float | None = None
    minimum: float | None = None

    def __post_init__(self) -> None:
        for name in ("tol", "first", "minimum"):
            value = getattr(self, name)
            if value is not None or name == "tol":
                object.__setattr__(self, name, number(name, value, 0.0, strict=True))
        if self.first is not None and self.minimum is not None and self.minimum > self.first:
            raise InputError(f"minimum, {self.minimum:g}, is longer than first, {self.first:g}")


class Refined(NamedTuple):
    """The passes, and where and why they did not suffice."""

    passes: tuple[Pass, ...]
    failed: float | None = None
    cause: str = ""


def refine(
    steps: Adaptive,
    cuts: np.ndarray,
    longest: float,
    flow: Flow,
    walk: Callable[[np.ndarray, Watch], Run],
    checked: int = CHECKED,
) -> Refined:
    """Walk over better and better grids until the error of a pass is small.

    Parameters
    ----------
    cuts : ndarray
        The start, the breakpoints and the end.
    longest : float
        Longest step.
    flow : Flow
        Of the scheme.
    walk : callable
        (times, watch) -> Run: moves u along the grid and shows each step to the watch.
    checked : int
        At how many nodes passes are compared.

    Notes
    -----
    A pass carries its error along (see `Watch`). Where two passes are much further apart than their
    errors let expect, the error counts for more. For order p the next pass has n (E / tol)^(1/p)
    steps.
    """
    tol, span = steps.tol, float(cuts[-1] - cuts[0])
    minimum = 2.0**-40 * span if steps.minimum is None else steps.minimum
    times = first_grid(cuts, longest)
    passes: list[Pass] = []
    watch: Watch | None = None
    while True:
        began, n, before = clock.perf_counter(), len(times) - 1, watch
        watch = Watch(times, cuts, flow, before.nodes if before else None, checked)
        run = walk(times, watch)
        walked = run.status in (Status.SUCCESS, Status.UNCERTIFIED)
        error = _error(times, watch, before) if walked else math.nan
        passes.append(Pass(run.done, error, clock.perf_counter() - began))
        doubtful = before is None and not error < RESOLVED * watch.length
        enough = error <= (ALONE if before is None else ACCEPTED) * tol and not doubtful
        if not walked or enough:
            return Refined(tuple(passes))
        if tol < EPS * watch.size:
            return Refined(tuple(passes), None, _below_rounding(tol, EPS * watch.size))
        aim = AIM if before else FIRST_AIM
        # where hardly anything was seen to move, steps twice as short look again
        least = 2.0 * n if doubtful else LEAST * n
        next_n = max(n * (error / (aim * tol)) ** (1 / flow.order), least)
        if next_n > 1.2 * GROWTH * n:
            # one pass between: as few steps as the last one can come after
            next_n = max(min(LAST * next_n, GROWTH * n), least)
        if next_n > STEPS:
            return Refined(tuple(passes), None, _too_many(passes[-1], next_n, tol))
        wanted = density(times, cuts, watch.sizes, flow.order, watch.jumps)
        times = finer_grid(wanted, cuts, longest, next_n)
        failure = _failure(times, cuts, minimum, passes, run.overshot is not None)
        if failure:
            return Refined(tuple(passes), float(times[np.argmin(np.diff(times))]), failure)


def _error(times: np.ndarray, watch: Watch, before: Watch | None) -> float:
    """The error of a pass: what it carried along, and what its distance to another one adds."""
    mus = np.diff(times)
    # a kink just beside a breakpoint: a jump of the velocity over a part of a step
    jump = max((size * mus[i : i + 2].sum() for i, size in watch.jumps.items()), default=0.0)
    error = watch.error + HIDDEN * float(jump)
    if before is None or not watch.apart:
        return error
    expected = watch.expected + 0.5 * (watch.spread + before.spread)
    if not expected:
        return watch.apart
    # the root: the coarser one of both may be to blame
    return error * min(max(math.sqrt(watch.apart / (APART * expected)), 1.0), MISTRUST)


def _below_rounding(tol: float, rounding: float) -> str:
    return f"tol = {tol:g} is less than the rounding of u, {rounding:.2g}; loosen it"


def _too_many(last: Pass, n: float, tol: float) -> str:
    estimate = "" if math.isnan(last.error) else f" and an estimated error of {last.error:.2g}"
    return (
        f"tol = {tol:g} would take about {n:.2g} steps, more than {STEPS:g}; the run has "
        f"{last.steps}{estimate}. Loosen the tolerance or take a scheme of higher order"
    )


def _failure(
    times: np.ndarray, cuts: np.ndarray, minimum: float, passes: list[Pass], overshot: bool
) -> str:
    """Why it makes no sense to go on, or nothing."""
    shortest = float(np.diff(times).min())
    advice = (
        "does the load jump there? Give it as data (a Table has no jumps, and its kinks are met "
        "exactly) or loosen the tolerance"
    )
    if shortest < min(minimum, float(np.diff(cuts).min())):
        return f"a step shorter than minimum = {minimum:g} is needed; {advice}"
    errors = [one.error for one in passes]
    if overshot and len(passes) > RISES and all(a < b for a, b in pairwise(errors[-RISES - 1 :])):
        return (
            f"the estimated error, {errors[-1]:.2g} with {passes[-1].steps} steps, rises with "
            "shorter steps: they overshoot; take implicit-euler, which never does"
        )
    if len(passes) == PASSES or (len(passes) > 7 and errors[-1] > errors[-7]):
        return (
            f"the estimated error, {errors[-1]:.2g}, does not fall any more with "
            f"{passes[-1].steps} steps; {advice}"
        )
    return ""
