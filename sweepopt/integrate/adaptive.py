"""Adaptive steps: passes over the whole run, each on a better grid, until the error is small.

The flow forgets and forgives (MATH.md section 3): what a step's error does to u later, nobody knows
at the step. So the grid is chosen for the run as a whole. A pass moves u along a grid of times; the
differences of its velocities say where the steps must be short and, carried along the flow, how
large its error is (`ErrorEstimator`). The next grid is the coarsest one whose local errors add up
to a share of those of the last one. To the loop over time an adaptive grid is a grid as any other.

Each segment between breakpoints is in equal parts that are halved again and again, so that steps
share the compiled programs.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

import numpy as np

from sweepopt.checks import TIME_SLACK, axes, number, vector
from sweepopt.errors import IndefiniteError, InputError, Status
from sweepopt.integrate.error_estimator import ErrorEstimator, ErrorModel, Probe
from sweepopt.integrate.grid import evaluation_times, time_grid
from sweepopt.integrate.loop import integrate
from sweepopt.integrate.record import Grid, Pass, Run, saving
from sweepopt.integrate.schemes import Scheme
from sweepopt.integrate.step import Velocities
from sweepopt.linalg import EPS
from sweepopt.loads import breakpoints
from sweepopt.problem import SweepingProcess, motion
from sweepopt.velocity import Plan

STEPS = 1_000_000  # of the finest pass: hours
FIRST = 16  # steps of the first pass
FIRST_UNKNOWN = 40  # the same where the load is a function: nothing but its values is known
PER_PERIOD = 5  # steps in each period of the data, at least
PER_PIECE = 3  # steps between breakpoints, at least: for a second difference
AIM = 0.75  # estimate that the next pass should have, in units of tol: it scatters by a third
FARTHEST = 6.0  # times the steps of a pass to which its differences say where they are needed
GROWTH = 1.1  # times the steps of a pass that the next one has
HIDDEN = 1 / 12  # of jump times step: mean error of a switch anywhere in the half step beside it
GRADED = 0.4  # no step is longer than 1 / 0.4 of the mean one: events there may be unresolved
PROGRAM_SHARE = 0.05  # of tol that inexact programs may take
EXACT = 1e-9  # no certificate below it is asked for: programs reach it on every scene
ADVICE = (
    "does the load jump there? Give it as data (a Table has no jumps, and its breakpoints are "
    "met exactly) or loosen the tolerance"
)
COMPLETE = (Status.SUCCESS, Status.UNCERTIFIED)


@dataclass(frozen=True)
class Adaptive:
    """Steps that are chosen such that max_i |u_i - u(t_i)|_A is at most tol (|.|_B where A = 0).

    Parameters
    ----------
    tol : float
        The global error, in the units of |u|_A. It is estimated, not proved.
    first : float, optional
        Longest step, t_end / 16 by default, t_end / 40 where the load is a function. An event of
        such a load that is shorter than the steps can pass unseen: make `first` as short as it.
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
    >>> sol.passes[-1].error < 1e-4, round(float(sol(5.0)[0]), 3)
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


@dataclass(frozen=True, eq=False)
class Segments:
    """What all grids of a run have in common: the times that they hit, the longest steps between.

    Attributes
    ----------
    cuts : ndarray, shape (k+1,)
        0, the breakpoints of C(t), the times that are to be saved, and t_end.
    breakpoints : ndarray
        The same without the times to be saved.
    longest : ndarray, shape (k,)
    """

    cuts: np.ndarray
    breakpoints: np.ndarray
    longest: np.ndarray

    @classmethod
    def of(
        cls, steps: Adaptive, process: SweepingProcess, t_end: Any, scheme: Scheme, save: Any
    ) -> Segments:
        """Those of a run, from its breakpoints, the periods of its data and its scheme."""
        if t_end is None:
            raise InputError("t_end is missing; Adaptive steps need it")
        end = number("t_end", t_end, minimum=0.0, strict=True)
        histories = motion(process.C).histories
        known = all(hasattr(history, "breakpoints") for history in histories)
        first = end / (FIRST if known else FIRST_UNKNOWN) if steps.first is None else steps.first
        period = min(map(_period, histories), default=math.inf)
        stable = math.inf
        if scheme.explicit and process.B is not None and process.Lam > 0:
            stable = 1 / process.Lam
        limits = {
            "make first longer": first,
            f"the data have a period of {period:.3g} and need {PER_PERIOD} steps in each: take a "
            "shorter t_end or leave out the term of that period": period / PER_PERIOD,
            f"{scheme.name} is stable up to about 1 / Lam = {stable:.3g}: take an implicit scheme "
            "or a shorter t_end": stable,
        }
        remedy = min(limits, key=limits.__getitem__)
        longest = min(limits[remedy], end / 4)
        inner = breakpoints(histories, 0.0, end)
        segments = cuts = _apart(np.concatenate([[0.0], inner, [end]]))
        if is_times(save):
            times = vector("save", save)  # `saving` refuses those that are not between 0 and end
            cuts = _apart(np.append(segments, times[(times > 0.0) & (times < end)]))
        if end / longest > STEPS:
            raise InputError(
                f"Adaptive: steps of at most {longest:.3g} up to t_end = {end:g} are more "
                f"than {STEPS:g}; {remedy}"
            )
        piece = np.searchsorted(segments, 0.5 * (cuts[1:] + cuts[:-1])) - 1
        return cls(cuts, segments, np.minimum(longest, np.diff(segments)[piece] / PER_PIECE))

    def equal(self, longest: float = math.inf) -> np.ndarray:
        """Each segment in equal steps that are not too long."""
        counts = np.ceil(np.diff(self.cuts) / np.minimum(self.longest, longest) * (1 - 1e-9))
        pieces = zip(self.cuts, self.cuts[1:], counts.astype(int).tolist(), strict=False)
        inner = [np.linspace(a, b, k, endpoint=False) for a, b, k in pieces]
        return np.append(np.concatenate(inner), self.cuts[-1])

    def refined(self, density: Density, goal: float, least: float) -> np.ndarray:
        """A grid of at least so many steps whose local errors are `goal` in sum.

        The coarsest of those that halve steps of the first pass until no local error is too large,
        or of equal steps, which can be fewer where nearly all are halved.
        """
        r = density.order
        equal = self.equal((goal / density.integral(r + 1)) ** (1 / r))
        largest = 4 * goal / max(density.steps(goal), least)
        while True:
            times = density.halved(self.equal(), largest)
            if len(times) > least and not density.local_errors(times).sum() > goal:
                return min(times, equal, key=len) if len(equal) > least else times
            largest *= 0.8


@dataclass(frozen=True, eq=False)
class Density:
    """Steps that a unit of time needs between `edges`: h has a local error of (h rho)^(r+1)."""

    edges: np.ndarray
    rho: np.ndarray
    order: int

    @classmethod
    def of(cls, estimator: ErrorEstimator) -> Density:
        """From the local errors of each step."""
        r, h = estimator.model.order, np.diff(estimator.times)
        rho = estimator.leading ** (1 / (r + 1))
        mean = float(rho @ h) / float(h.sum())
        return cls(estimator.times, np.maximum(rho, GRADED * mean) if mean > 0 else 0 * h + 1, r)

    def integral(self, power: int) -> float:
        """Of rho^power."""
        return float(self.rho**power @ np.diff(self.edges))

    def steps(self, goal: float) -> float:
        """How many there are about in a grid whose local errors are `goal` in sum."""
        return self.integral(1) * (self.integral(1) / goal) ** (1 / self.order)

    def local_errors(self, times: np.ndarray) -> np.ndarray:
        """Of each step of a grid."""
        parts = np.append(0.0, np.cumsum(self.rho ** (self.order + 1) * np.diff(self.edges)))
        return np.diff(np.interp(times, self.edges, parts)) * np.diff(times) ** self.order

    def halved(self, times: np.ndarray, largest: float) -> np.ndarray:
        """The grid, its steps halved until no local error is above the largest allowed one."""
        while True:
            middle = 0.5 * (times[1:] + times[:-1])
            coarse = (self.local_errors(times) > largest) & (middle > times[:-1])
            if not coarse.any():
                return times
            times = np.sort(np.append(times, middle[coarse & (middle < times[1:])]))


class _AdaptiveDriver:
    """Integrates over one grid after the other, and estimates the error of each pass."""

    def __init__(
        self,
        segments: Segments,
        process: SweepingProcess,
        plan: Plan,
        save: Any,
        memory: float,
        tick: Callable[[], Any],
    ) -> None:
        self._segments, self._process, self._plan = segments, process, plan
        self._save, self._memory, self._tick = save, memory, tick
        self._programs, self._model = Velocities(process, plan), ErrorModel(process, plan.scheme)
        self.run = self._start(segments.equal())

    def _start(self, times: np.ndarray, passes: tuple[Pass, ...] = ()) -> Run:
        """A run over this grid with no step yet."""
        times, mus = time_grid(None, times)
        saved = saving(self._save, times, self._plan.entering, self._memory)
        return Run(Grid(times, mus, self._plan, saved, passes), self._process.u0)

    def run_pass(self, times: np.ndarray, probing: bool) -> ErrorEstimator:
        """One pass, the same as a run with steps=times to the last bit."""
        began, passes = clock.perf_counter(), self.run.grid.passes
        process, plan = self._process, self._plan
        run = self._start(times, passes)
        grid = run.grid
        process.check(evaluation_times(grid.times, grid.mus, plan.scheme))
        estimator = ErrorEstimator(self._model, grid.times, self._segments.breakpoints, probing)

        def observe(i: int, u: np.ndarray, z: np.ndarray, _: float) -> None:
            self._tick()
            estimator.add_step(i, u, z)

        self._programs.forget()
        integrate(process, plan, run, observe, velocities=self._programs)
        # without an error until all of it is estimated
        this = Pass(run.done, math.nan, clock.perf_counter() - began)
        run.grid = grid._replace(passes=(*passes, this))
        self.run = run
        if run.status in COMPLETE:
            self._add_hidden_switches(estimator, grid.mus)
            this = Pass(run.done, estimator.error, clock.perf_counter() - began)
            run.grid = grid._replace(passes=(*passes, this))
        return estimator

    def _add_hidden_switches(self, estimator: ErrorEstimator, mus: np.ndarray) -> None:
        """Errors of switches that no step shows, from the velocities at the probes."""
        for probe in estimator.probes:
            z = self._velocity(probe, float(mus[probe.step]))
            if z is not None:
                jump = self._model.norms(np.where(probe.rest, z, 0.0)[None])[0]
                estimator.jumps[probe.step] = max(estimator.jumps[probe.step], jump)
        before, after = HIDDEN * estimator.jumps * mus, HIDDEN * estimator.jumps[:-1] * mus[1:]
        estimator.error += float((before + np.append(after, 0.0)).max())
        beside = np.maximum(before, np.append(0.0, after))
        leading = beside / mus ** (self._model.order + 1)
        estimator.leading = np.maximum(estimator.leading, leading)

    def _velocity(self, probe: Probe, mu: float) -> np.ndarray | None:
        """The velocity at a probe; None where C(t) has no value or the certificate misses tol."""
        process, plan = self._process, self._plan
        try:
            process.C.members(np.array([probe.t]))
        except Exception:  # C(t) may have no value between the times of the grid
            return None
        gamma = mu * plan.scheme.a[-1][-1] if process.B is not None else 0.0
        try:
            velocity = self._programs(gamma)(probe.u, process.C.at(probe.t))
        except IndefiniteError:
            return None
        # sets without a proof have certificate nan
        return None if velocity.relative > plan.tol else velocity.z

    def certify(self, tol: float) -> None:
        """Ask programs for certificates of tol, where that is less than what they have."""
        if tol < self._plan.tol:
            self._plan = replace(self._plan, tol=max(tol, EXACT))
            self._programs = Velocities(self._process, self._plan)

    def until(self, end: float, cause: str) -> Run:
        """A run with no step yet over the grid of the last pass until about that time."""
        last, save = self.run.grid, self._save
        reached = max(int(np.searchsorted(last.times, end, side="right")) - 1, 1)
        times = last.times[: reached + 1]
        if is_times(save):
            save = np.append([t for t in np.ravel(save) if t <= times[-1]], times[-1])
        saved = saving(save, times, self._plan.entering, self._memory)
        grid = Grid(times, last.mus[:reached], self._plan, saved, last.passes, cause)
        return Run(grid, self._process.u0)


def adapt(
    steps: Adaptive,
    segments: Segments,
    process: SweepingProcess,
    plan: Plan,
    save: Any,
    memory: float,
    tick: Callable[[], Any],
) -> Run:
    """The run over the last of better and better grids, the first with a small estimated error.

    It has no step yet where that grid ends before t_end, as steps became too short there.
    Ctrl-C during a pass returns its steps, Ctrl-C between two passes the one before.
    """
    driver = _AdaptiveDriver(segments, process, plan, save, memory, tick)
    try:
        return _refine(steps, segments, driver)
    except KeyboardInterrupt:  # `integrate` takes those that arrive during its steps
        driver.run.status = Status.INTERRUPTED
        return driver.run


def _refine(steps: Adaptive, segments: Segments, driver: _AdaptiveDriver) -> Run:
    """The passes; the first one has no other to be better than, so that there are two at least.

    Their errors are about in proportion to the sums of their local errors, but for the places that
    switches happen to have in steps: the next grid is chosen by the geometric mean of two ratios.
    """
    cuts, tol = segments.cuts, steps.tol
    minimum = 2.0**-40 * cuts[-1] if steps.minimum is None else steps.minimum
    shortest = min(minimum, float(np.diff(cuts).min()))  # breakpoints are met anyway
    times, ratios = segments.equal(), []
    resting = True
    while True:
        n = len(times) - 1
        estimator = driver.run_pass(times, probing=resting)
        run, resting = driver.run, estimator.length == 0
        passes = run.grid.passes
        error = passes[-1].error
        if run.status not in COMPLETE or (error <= tol and len(passes) > 1):
            return run
        if len(passes) == 1 and not resting:
            # residuals of programs add up along the trajectory
            driver.certify(PROGRAM_SHARE * tol / estimator.length)
        density = Density.of(estimator)
        total = float(density.local_errors(times).sum())
        ratios.append(error / total)
        ratio = math.sqrt(ratios[-1] * ratios[-2]) if len(ratios) > 2 else ratios[-1]
        goal = min(AIM * tol / ratio if error else math.inf, total)
        wanted = density.steps(goal)
        rounding = EPS * estimator.size
        cause = _failure(tol, rounding, passes, wanted, run.overshot is not None)
        if cause:
            run.grid = run.grid._replace(cause=cause)
            return run
        if wanted > FARTHEST * n:  # one pass between
            goal *= (wanted / n) ** (density.order / 2)
        times = segments.refined(density, goal, GROWTH * n)
        h = np.diff(times)
        if h.min() < shortest:
            cause = f"a step shorter than minimum = {shortest:g} is needed; {ADVICE}"
            return driver.until(float(np.median(times[1:][h < 2 * h.min()])), cause)


def is_times(save: Any) -> bool:
    """Whether `save` is an array of times."""
    return not isinstance(save, str) and not callable(save) and axes(save) == 1


def _period(history: Any) -> float:
    """The period of a history, infinite where it has none; it may be a user's own object."""
    period, amplitude = getattr(history, "period", None), getattr(history, "amplitude", None)
    if isinstance(amplitude, Real) and amplitude == 0:
        return math.inf
    return float(period) if isinstance(period, Real) and float(period) > 0 else math.inf


def _apart(cuts: np.ndarray) -> np.ndarray:
    """Increasing; breakpoints that differ by rounding are one."""
    cuts = np.unique(cuts)
    far = np.append(True, np.diff(cuts) > TIME_SLACK * cuts[-1])
    far[-1] = True
    kept = cuts[far]
    return kept if kept[-1] - kept[-2] > TIME_SLACK * cuts[-1] else np.delete(kept, -2)


def _failure(
    tol: float, rounding: float, passes: Sequence[Pass], wanted: float, overshot: bool
) -> str:
    """Why it makes no sense to go on to so many steps, or nothing."""
    if tol < rounding:
        return f"tol = {tol:g} is less than the rounding of u, {rounding:.2g}; loosen it"
    n, error, _ = passes[-1]
    back = 4 if overshot else 6  # errors rise now and then, but not over so many passes
    rises = error > passes[-1 - back :][0].error
    if rises and overshot and (len(passes) > back or wanted > STEPS):
        return (
            f"the estimated error, {error:.2g} with {n} steps, rises with shorter steps: they "
            "overshoot; take implicit-euler, which never does"
        )
    if rises and len(passes) > back:
        return f"the estimated error, {error:.2g}, does not fall any more with {n} steps; {ADVICE}"
    if wanted > STEPS:
        estimate = "" if math.isnan(error) else f" and an estimated error of {error:.2g}"
        return (
            f"tol = {tol:g} would take about {wanted:.2g} steps, more than {STEPS:g}; the run has "
            f"{n}{estimate}. Loosen the tolerance or take a scheme of higher order"
        )
    return ""
