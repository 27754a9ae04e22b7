"""Adaptive steps: passes over the whole run, each on a better grid, until the error is small.

The flow forgets and forgives (MATH.md section 3): what a step's error does to u later, nobody knows
at the step. So the grid is chosen for the run as a whole. A pass moves u along a grid of times; the
differences of its velocities say where the steps must be short, the distance to the pass before it
says how many there must be. Passes that come before the last one are coarse and cheap. To the loop
over time an adaptive grid is a grid as any other.

Each segment between breakpoints is halved again and again: steps are H / 2^k, so that the compiled
programs are shared, and every pass has the nodes of the first one, where passes are compared.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sweepopt.checks import number
from sweepopt.errors import InputError, Status
from sweepopt.grids import Density, density, finer_grid, first_grid
from sweepopt.march import Run
from sweepopt.solution import Pass

PASSES = 24
STEPS = 1_000_000  # of the finest pass
CHECKED = 256  # nodes at which passes are compared, fewer where states are large
AIM = 1.4  # the error that a pass is made for, in units of tol
ACCEPTED, DOUBTED = 2.7, 1.9  # what it may have after a pass that was nearly as fine, or was not
GROWTH = 4.0  # a pass has at most so many times the steps of the one before
LAST = 3.0  # so many times the steps are believed of one estimate
FIRST = 16  # steps of the first pass
HIDDEN = 2.0  # times its local error a step may be wrong that two passes have in common
GUESS = 0.2  # error in units of the sum of the local ones, before two passes can tell


EPS = float(np.finfo(float).eps)

Norm = Callable[[np.ndarray], float]


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


class Watch:
    """Sees the velocities of a pass and keeps the size of their differences only.

    The second difference of three steps for a scheme of order 2, the first one of two steps for
    order 1: times the step to the power order + 1 it is the local error, up to a factor.
    """

    def __init__(self, times: np.ndarray, nodes: set[float], order: int, norm: Norm) -> None:
        self._middle, self._mus = 0.5 * (times[1:] + times[:-1]), np.diff(times).tolist()
        self._order, self._norm = order, norm
        self._nodes = {i: t for i, t in enumerate(times[1:].tolist()) if t in nodes}
        self._last: list[np.ndarray] = []
        self.states: dict[float, np.ndarray] = {}  # at those nodes that the grid has
        self.sizes: list[float] = []
        self.length = 0.0  # of the way that u goes

    def see(self, i: int, u: np.ndarray, z: np.ndarray) -> None:
        """Take the state after step i and its velocity."""
        if i in self._nodes:
            self.states[self._nodes[i]] = u.copy()
        self.length += self._mus[i] * self._norm(z)
        self._last = [*self._last[-self._order :], z]
        if len(self._last) == self._order + 1:
            self.sizes.append(self._norm(self._difference(self._middle[i - self._order : i + 1])))

    def _difference(self, t: np.ndarray) -> np.ndarray:
        slopes = [
            (b - a) / dt for a, b, dt in zip(self._last, self._last[1:], np.diff(t), strict=False)
        ]
        if self._order == 1:
            return slopes[0]
        return (slopes[1] - slopes[0]) / (t[2] - t[0])


class Before(NamedTuple):
    """What is remembered of the pass before."""

    steps: int
    wanted: Density
    states: dict[float, np.ndarray]


class Refined(NamedTuple):
    """The passes, and where and why they did not suffice."""

    passes: tuple[Pass, ...]
    failed: float | None = None
    cause: str = ""


def refine(
    steps: Adaptive,
    cuts: np.ndarray,
    longest: float,
    order: int,
    norm: Norm,
    walk: Callable[[np.ndarray, Watch], Run],
    checked: int = CHECKED,
) -> Refined:
    """Walk over better and better grids until two passes agree.

    Parameters
    ----------
    cuts : ndarray
        The start, the breakpoints and the end.
    longest : float
        Longest step.
    order : int
        Of the scheme.
    norm : callable
        The norm of u.
    walk : callable
        (times, watch) -> Run: moves u along the grid and shows each step to the watch.
    checked : int
        At how many nodes passes are compared.

    Notes
    -----
    With n steps after n' < n ones the error is E = r / (1 - r) max |u - u'|, where r is what an
    order promises, (n' / n)^order, or what the local errors say, in the geometric mean;
    twice the largest local error of a step that both passes have is added. For order p the next
    pass has n (E / tol)^(1/p) steps.
    """
    tol, span = steps.tol, float(cuts[-1] - cuts[0])
    minimum = 2.0**-40 * span if steps.minimum is None else steps.minimum
    times = first_grid(cuts, longest)
    passes: list[Pass] = []
    before: Before | None = None
    while True:
        began, n = clock.perf_counter(), len(times) - 1
        # some nodes more where the steps are short: what is wrong there may soon be forgotten
        own = times[1:][np.unique(np.linspace(0, n - 1, checked).astype(int))].tolist()
        watch = Watch(times, {*own, *(before.states if before else ())}, order, norm)
        run = walk(times, watch)
        error = math.nan
        if run.status in (Status.SUCCESS, Status.UNCERTIFIED):
            wanted = density(times, cuts, np.array(watch.sizes), order)
            if before is not None:
                error = _error(n, wanted, watch.states, before, order, norm)
            size = max(map(norm, watch.states.values()))
        passes.append(Pass(run.done, error, clock.perf_counter() - began))
        # a much coarser pass has too few nodes where the steps are short now
        near = before is not None and n <= 1.1 * LAST * before.steps
        enough = error <= (ACCEPTED if near else DOUBTED) * tol
        if run.status not in (Status.SUCCESS, Status.UNCERTIFIED) or enough:
            return Refined(tuple(passes))
        if tol < EPS * size:
            return Refined(tuple(passes), None, _below_rounding(tol, EPS * size))
        guess = GUESS * wanted.errors if before is None else error
        next_n = n * (guess / (AIM * tol)) ** (1 / order)
        next_n = max(next_n / LAST if next_n > 1.5 * LAST * n else next_n, 1.3 * n)
        if min(next_n, GROWTH * n) > STEPS:
            return Refined(tuple(passes), None, _too_many(passes[-1], next_n, tol))
        before = Before(n, wanted, {t: watch.states[t] for t in own})
        times = finer_grid(wanted, cuts, longest, min(next_n, GROWTH * n))
        failure = _failure(times, cuts, minimum, passes)
        if failure:
            return Refined(tuple(passes), float(times[np.argmin(np.diff(times))]), failure)


def _error(
    n: int,
    wanted: Density,
    states: dict[float, np.ndarray],
    before: Before,
    order: int,
    norm: Norm,
) -> float:
    """The error of a pass from its distance to the one before."""
    promised = min((before.steps / n) ** order, 0.7)
    local = wanted.errors / before.wanted.errors if before.wanted.errors > 0 else 1.0
    ratio = min(math.sqrt(promised * local), 0.7)
    # what both passes miss in a step that they share, their distance does not show
    hidden = HIDDEN * wanted.shared(before.wanted.times)
    common = states.keys() & before.states.keys()
    return hidden + ratio / (1 - ratio) * max(norm(states[t] - before.states[t]) for t in common)


def _below_rounding(tol: float, rounding: float) -> str:
    return f"tol = {tol:g} is less than the rounding of u, {rounding:.2g}; loosen it"


def _too_many(last: Pass, n: float, tol: float) -> str:
    estimate = "" if math.isnan(last.error) else f" and an estimated error of {last.error:.2g}"
    return (
        f"tol = {tol:g} would take about {n:.2g} steps, more than {STEPS:g}; the run has "
        f"{last.steps}{estimate}. Loosen the tolerance or take a scheme of higher order"
    )


def _failure(times: np.ndarray, cuts: np.ndarray, minimum: float, passes: list[Pass]) -> str:
    """Why it makes no sense to go on, or nothing."""
    shortest = float(np.diff(times).min())
    advice = (
        "does the load jump there? Give it as data (a Table has no jumps, and its kinks are met "
        "exactly) or loosen the tolerance"
    )
    if shortest < min(minimum, float(np.diff(cuts).min())):
        return f"a step shorter than minimum = {minimum:g} is needed; {advice}"
    if len(passes) == PASSES or (len(passes) > 7 and passes[-1].error > passes[-7].error):
        return (
            f"the estimated error, {passes[-1].error:.2g}, does not fall any more with "
            f"{passes[-1].steps} steps; {advice}"
        )
    return ""
