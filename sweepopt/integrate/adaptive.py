"""Adaptive steps: passes over the whole run, each on a better grid, until the error is small.

The flow forgets and forgives (MATH.md section 3): what a step's error does to u later, nobody knows
at the step. So the grid is chosen for the run as a whole. A pass moves u along a grid of times; the
differences of its velocities say where the steps must be short, and, carried along, how large the
error is and what another grid would have: the coarsest one whose error is small is next. Where its
error becomes too large after all, the steps that are to blame are halved, and the pass goes on from
the first of them. Two passes whose distance their errors do not explain know less than they think.
To the loop over time an adaptive grid is a grid as any other.

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
from sweepopt.integrate.error_estimator import Limit, PassNodes, Watch
from sweepopt.integrate.error_propagation import Flow
from sweepopt.integrate.mesh_density import Density, density, finer_grid, first_grid
from sweepopt.integrate.record import Run
from sweepopt.linalg import EPS

PASSES = 24
STEPS = 1_000_000  # of the finest pass
CHECKED = 256  # nodes at which passes are compared, fewer where states are large
AIM = 1.9  # the error that a pass is made for, in units of tol,
CAREFUL = 1.4  # and where it is estimated without the places of kinks
ACCEPTED = 2.5  # the error that it may have,
MENDED = 2.2  # the one that it is mended for,
ALONE = 1.9  # what the first one may have,
RESOLVED = 0.02  # and in units of the way that u goes: the steps have seen it move
TOLD = 40  # steps from which on a pass can tell what another grid would miss
FARTHEST, FARTHEST_TOLD = 4.8, 8.0  # times the steps of a pass that the last one may have
BETWEEN, GROWTH = 0.2, (2.0, 4.0)  # of the last one's steps, and times those before, one between
LEAST = 1.35  # times the steps before that a pass has
TRIED, NEAR = 6, (0.6, 1.5)  # so many grids are tried, around the steps that the order suggests
MENDS = 40  # times that a pass goes on from halved steps
RISES = 4  # passes one after the other that overshoot, each with a greater error, lead nowhere
APART = 2.0  # times as far apart as their errors let expect two passes may be
MISTRUST = 2.0  # the most that an error counts for where they are further apart
FIRST = 16  # steps of the first pass
HIDDEN = 1 / 24  # of a jump of the velocity times the steps beside it: the error of a kink there


class Pass(NamedTuple):
    """One pass of adaptive steps over the run.

    Attributes
    ----------
    steps : int
        That were made: more than the pass has where it went on from halved ones.
    error : float
        Estimate of max_i |u_i - u(t_i)|_A, |.|_B where A = 0; nan if the pass was stopped.
    seconds : float
    """

    steps: int
    error: float
    seconds: float


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
    walk: Callable[[np.ndarray, Watch, int], Run],
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
        (times, watch, known) -> Run: moves u along the grid and shows each step to the watch, after
        the first ones that are known from the walk before; it ends where the watch sees too much.
    checked : int
        At how many nodes passes are compared.

    Notes
    -----
    A pass carries its error along (see `Course`). Where two passes are much further apart than
    their errors let expect, the error counts for more. For order p the next pass has about
    n (E / tol)^(1/p) steps.
    """
    tol, span = steps.tol, float(cuts[-1] - cuts[0])
    minimum = 2.0**-40 * span if steps.minimum is None else steps.minimum
    shortest = min(minimum, float(np.diff(cuts).min()))  # breakpoints are met all the same
    times, limit = first_grid(cuts, longest), None
    passes: list[Pass] = []
    watch: Watch | None = None
    while True:
        began, before = clock.perf_counter(), watch
        nodes = before.nodes if before else None

        def seen(
            times: np.ndarray, known: int, limit: Limit | None, nodes: PassNodes | None = nodes
        ) -> Watch:
            return Watch(times, cuts, flow, nodes, checked, known, limit)

        watch, run, made = _walked(times, limit, seen, walk)
        times, n = watch.times, len(watch.times) - 1
        walked = run.status in (Status.SUCCESS, Status.UNCERTIFIED)
        error, trust = _error(watch, before) if walked else (math.nan, 1.0)
        passes.append(Pass(made, error, clock.perf_counter() - began))
        doubtful = before is None and not 0 < error < RESOLVED * watch.length
        enough = error <= (ALONE if before is None else ACCEPTED) * tol and not doubtful
        if not walked or enough:
            return Refined(tuple(passes))
        if tol < EPS * watch.size:
            return Refined(tuple(passes), None, _below_rounding(tol, EPS * watch.size))
        # where hardly anything was seen to move, steps twice as short look again
        least = (2.0 if doubtful else LEAST) * n
        aim = (AIM if flow.locates else CAREFUL) * tol
        next_n = max(n * (error / aim) ** (1 / flow.order), least)
        wanted = density(times, cuts, watch.sizes, flow.order, watch.jumps)
        told = flow.locates and watch.whole and n >= TOLD
        limit = None
        if next_n <= (FARTHEST_TOLD if told else FARTHEST) * n:
            limit = Limit(ACCEPTED * tol, MENDED * tol, shortest) if flow.locates else None
        else:
            # one pass between: as few steps as the last one can come after
            next_n = min(max(BETWEEN * next_n, GROWTH[0] * n), GROWTH[1] * n)
        if next_n > STEPS:
            return Refined(tuple(passes), None, _too_many(n, error, next_n, tol))
        if limit and told:
            around = max(NEAR[0] * next_n, least), max(NEAR[1] * next_n, least)
            times = _fewest(watch, flow, wanted, cuts, longest, around, aim / trust)
        else:
            times = finer_grid(wanted, cuts, longest, next_n)
        failure = _failure(times, shortest, n, passes, run.overshot is not None)
        if failure:
            return Refined(tuple(passes), float(times[np.argmin(np.diff(times))]), failure)


def _walked(
    times: np.ndarray,
    limit: Limit | None,
    seen: Callable[[np.ndarray, int, Limit | None], Watch],
    walk: Callable[[np.ndarray, Watch, int], Run],
) -> tuple[Watch, Run, int]:
    """A pass, mended where its error is too large; how many steps were made for it."""
    known, made, mends = 0, 0, 0
    while True:
        watch = seen(times, known, limit if mends < MENDS else None)
        run = walk(times, watch, known)
        made += run.done - known
        if watch.mended is None or run.status in (Status.INTERRUPTED, Status.INEXACT):
            return watch, run, made
        (times, known), mends = watch.mended, mends + 1


def _fewest(
    watch: Watch,
    flow: Flow,
    wanted: Density,
    cuts: np.ndarray,
    longest: float,
    around: tuple[float, float],
    error: float,
) -> np.ndarray:
    """The coarsest one of some grids that would have no more than this error.

    They follow the density or are of equal steps: where many kinks are close together, what the
    density gains is less than what it loses by halving.
    """
    course, span = watch.course, cuts[-1] - cuts[0]

    def small(times: np.ndarray) -> bool:
        return bool(course.on(flow, times).sizes(flow).max() <= error)

    numbers = np.geomspace(*around, TRIED).tolist()
    few, many, found = 0, TRIED - 1, None
    while few <= many:
        middle = (few + many) // 2
        n = numbers[middle]
        times = first_grid(cuts, min(span / n, longest))
        if small(times) or small(times := finer_grid(wanted, cuts, longest, n)):
            found, many = times, middle - 1
        else:
            few = middle + 1
    return finer_grid(wanted, cuts, longest, numbers[-1]) if found is None else found


def _error(watch: Watch, before: Watch | None) -> tuple[float, float]:
    """The error of a pass, and how much more it counts than it seems.

    It is what the pass carried along, and what may be hidden beside breakpoints.
    """
    mus = np.diff(watch.times)
    # a kink just beside a breakpoint: a jump of the velocity over a part of a step
    jump = max((size * mus[i : i + 2].sum() for i, size in watch.jumps.items()), default=0.0)
    error = watch.error + HIDDEN * float(jump)
    if before is None or not watch.apart:
        return error, 1.0
    expected = error + before.error
    if not expected:
        return watch.apart, 1.0
    # the root: the coarser one of both may be to blame
    trust = min(max(math.sqrt(watch.apart / (APART * expected)), 1.0), MISTRUST)
    return trust * error, trust


def _below_rounding(tol: float, rounding: float) -> str:
    return f"tol = {tol:g} is less than the rounding of u, {rounding:.2g}; loosen it"


def _too_many(n: int, error: float, next_n: float, tol: float) -> str:
    estimate = "" if math.isnan(error) else f" and an estimated error of {error:.2g}"
    return (
        f"tol = {tol:g} would take about {next_n:.2g} steps, more than {STEPS:g}; the run has "
        f"{n}{estimate}. Loosen the tolerance or take a scheme of higher order"
    )


def _failure(times: np.ndarray, shortest: float, n: int, passes: list[Pass], overshot: bool) -> str:
    """Why it makes no sense to go on from n steps, or nothing."""
    step = float(np.diff(times).min())
    advice = (
        "does the load jump there? Give it as data (a Table has no jumps, and its kinks are met "
        "exactly) or loosen the tolerance"
    )
    if step < shortest:
        return f"a step shorter than minimum = {shortest:g} is needed; {advice}"
    errors = [one.error for one in passes]
    if overshot and len(passes) > RISES and all(a < b for a, b in pairwise(errors[-RISES - 1 :])):
        return (
            f"the estimated error, {errors[-1]:.2g} with {n} steps, rises with "
            "shorter steps: they overshoot; take implicit-euler, which never does"
        )
    if len(passes) == PASSES or (len(passes) > 7 and errors[-1] > errors[-7]):
        return (
            f"the estimated error, {errors[-1]:.2g}, does not fall any more with "
            f"{n} steps; {advice}"
        )
    return ""
