"""Adaptive steps: passes over the whole run, each on a better grid, until the error is small.

The flow damps errors and stops them (MATH.md section 3): at a step the effect of its local error on
later u is not known. So the grid is chosen for the run as a whole. A pass moves u along a grid; the
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
from typing import Any, NamedTuple

import numpy as np

from sweepopt.checks import TIME_SLACK, arguments, axes, number, vector
from sweepopt.errors import InputError, Status
from sweepopt.integrate.error_estimator import ErrorEstimator
from sweepopt.integrate.grid import breakpoints_to_meet, evaluation_times, time_grid
from sweepopt.integrate.loop import integrate
from sweepopt.integrate.record import Grid, Pass, Run, Saving
from sweepopt.integrate.schemes import Scheme, rings
from sweepopt.integrate.step import Velocities
from sweepopt.linalg import EPS
from sweepopt.loads import History
from sweepopt.problem import SweepingProcess, histories_of

STEPS = 1_000_000  # of the finest pass: hours
FIRST = 16  # steps of the first pass
FIRST_UNKNOWN = 40  # the same where the load is a function: nothing but its values is known
GRADING = 2.0  # of neighbours where the load is a function: an aliased step has fine ones beside it
PER_PIECE = 3  # steps between breakpoints and in half a period, at least: for second differences
AIM = 0.75  # estimate that the next pass should have, in units of tol: it scatters by a third
FARTHEST = 6.0  # times the steps of a pass to which its differences say where they are needed
HIDDEN = 1 / 12  # of jump times step: mean error of a switch anywhere in the half step beside it
GOLDEN = 0.5 * (math.sqrt(5) - 1)  # its multiples modulo 1 fall into step with no period
PROGRAM_SHARE = 0.05  # of tol that residuals of programs, which no estimate sees, may take
EXACT = 1e-9  # no certificate below it is asked for: programs reach it on every scene
ADVICE = (
    "does the load jump there? Give it as data (a Table has no jumps, and its breakpoints are "
    "met exactly) or loosen the tolerance"
)
COMPLETE = (Status.SUCCESS, Status.UNCERTIFIED)


@arguments(
    rtol="; give tol, the error itself in the units of |u|_A",
    atol="; give tol, the error in the units of |u|_A",
    max_step="; give first, the longest step",
)
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
        0, the breakpoints of C(t), the times that are to be saved, and t_end; of dense tables only
        the points where they turn.
    breakpoints : ndarray
        The same without the times to be saved.
    longest : ndarray, shape (k,)
    known : bool
        Whether all loads are data of the library, which say where they turn.
    """

    cuts: np.ndarray
    breakpoints: np.ndarray
    longest: np.ndarray
    known: bool

    @classmethod
    def of(
        cls, steps: Adaptive, process: SweepingProcess, t_end: Any, scheme: Scheme, save: Any
    ) -> Segments:
        """Those of a run, from its breakpoints, the periods of its data and its scheme."""
        if t_end is None:
            raise InputError("t_end is missing; Adaptive steps need it")
        end = number("t_end", t_end, minimum=0.0, strict=True)
        histories = histories_of(process.C)
        known = all(isinstance(history, History) for history in histories)
        first = end / (FIRST if known else FIRST_UNKNOWN) if steps.first is None else steps.first
        period = min(map(_period, histories), default=math.inf)
        stable = math.inf
        if scheme.explicit and process.B is not None and process.Lam > 0:
            stable = 1 / process.Lam
        limits = {
            "make first longer": first,
            f"the data have a period of {period:.3g} and need {2 * PER_PIECE} steps in each: take "
            "a shorter t_end or leave out the term of that period": period / (2 * PER_PIECE),
            f"{scheme.name} is stable up to about 1 / Lam = {stable:.3g}: take an implicit scheme "
            "or a shorter t_end": stable,
        }
        remedy = min(limits, key=limits.__getitem__)
        longest = min(limits[remedy], end / 4)
        inner = breakpoints_to_meet(histories, 0.0, end)
        segments = cuts = _apart(np.concatenate([[0.0], inner, [end]]))
        if not isinstance(save, str) and not callable(save) and axes(save) == 1:
            times = vector("save", save)  # `saving` refuses those that are not between 0 and end
            cuts = _apart(np.append(segments, times[(times > 0.0) & (times < end)]))
        if end / longest > STEPS:
            raise InputError(
                f"Adaptive: steps of at most {longest:.3g} up to t_end = {end:g} are more "
                f"than {STEPS:g}; {remedy}"
            )
        piece = np.searchsorted(segments, 0.5 * (cuts[1:] + cuts[:-1])) - 1
        return cls(cuts, segments, np.minimum(longest, np.diff(segments)[piece] / PER_PIECE), known)

    def equal(self) -> np.ndarray:
        """Each segment in equal steps that are not too long."""
        counts = np.ceil(np.diff(self.cuts) / self.longest * (1 - 1e-9)).astype(int)
        pieces = zip(self.cuts, self.cuts[1:], counts.tolist(), strict=False)
        inner = [np.linspace(a, b, k, endpoint=False) for a, b, k in pieces]
        return np.append(np.concatenate(inner), self.cuts[-1])

    def refined(self, estimator: ErrorEstimator, total: float, least: int) -> np.ndarray:
        """A grid of at least so many steps whose local errors are `total` in sum.

        The first grid, its steps halved until no local error is above the largest allowed one.
        """
        times, largest = self.equal(), total
        while True:
            errors, h = estimator.local_errors(times), np.diff(times)
            coarse = errors > largest
            if not self.known:
                before, after = np.append(math.inf, h[:-1]), np.append(h[1:], math.inf)
                coarse |= h > (1 + 1e-9) * GRADING * np.minimum(before, after)
            if coarse.any():
                middle = 0.5 * (times[1:] + times[:-1])
                times = np.sort(np.append(times, middle[coarse]))
            elif len(times) > least and errors.sum() <= total:
                return times
            else:
                largest *= 0.8  # small enough that hardly a grid is passed over


class Probe(NamedTuple):
    """A time in a step at which no stage has evaluated C, u there and the step's velocity.

    `before` is the velocity of the step before, where the probe's can differ by as much only.
    """

    step: int
    t: float
    u: np.ndarray
    z: np.ndarray
    before: np.ndarray | None


class _AdaptiveDriver:
    """Integrates over one grid after the other, and estimates the error of each pass."""

    def __init__(
        self,
        segments: Segments,
        process: SweepingProcess,
        grid: Grid,
        saved: Callable[[np.ndarray], Saving],
        tick: Callable[[], Any],
    ) -> None:
        self._segments, self._process, self._plan = segments, process, grid.plan
        self._saved, self._tick = saved, tick
        self._programs = Velocities(process, grid.plan)
        self.run = Run(grid, process.u0)

    def run_pass(self, times: np.ndarray, resting: bool) -> ErrorEstimator:
        """One pass, the same as a run with steps=times to the last bit.

        The velocity is asked for at times at which no step has evaluated C too: at the ends of
        segments; within each step if all unknowns rested in the pass before; and where the load
        is a function, which may have turned between two stages, within the longest steps.
        """
        began, process, plan = clock.perf_counter(), self._process, self._plan
        _, mus = time_grid(None, times)
        process.check(evaluation_times(times, mus, plan.scheme))
        grid = Grid(times, mus, plan, self._saved(times), self.run.grid.passes)
        run = Run(grid, process.u0)
        estimator = ErrorEstimator(process, plan.scheme, times, self._segments.breakpoints)
        probes, before = list[Probe](), np.zeros(process.dim)
        known = self._segments.known
        count = len(mus) if resting else 0 if known else FIRST_UNKNOWN
        inside = set(np.argsort(-mus, kind="stable")[:count].tolist())
        smooth = not (known or process.rate_independent)

        def observe(i: int, u: np.ndarray, z: np.ndarray, _: float) -> None:
            nonlocal before
            self._tick()
            estimator.add_step(i, z)
            looks: list[Any] = [(share, None) for share in estimator.ends.get(i, [])]
            if i in inside:
                looks.append((i * GOLDEN % 1.0, before if smooth else None))
            for share, near in looks:
                since, left = share * mus[i], (1 - share) * mus[i]
                probes.append(Probe(i, times[i] + since, u - left * z, z, near))
            before = z

        def add_pass(error: float) -> None:
            this = Pass(run.done, error, clock.perf_counter() - began)
            run.grid = grid._replace(passes=(*grid.passes, this))

        self._programs.forget()
        integrate(process, plan, run, observe, velocities=self._programs)
        add_pass(math.nan)  # until all of it is estimated
        self.run = run
        if run.status in COMPLETE:
            self._add_hidden_switches(estimator, mus, probes)
            add_pass(estimator.error)
        return estimator

    def _add_hidden_switches(
        self, estimator: ErrorEstimator, mus: np.ndarray, probes: list[Probe]
    ) -> None:
        """Errors of switches that no step shows, from the velocities at the probes."""
        hidden = 0.0
        for i, t, u, z, before in probes:
            mu = float(mus[i])
            if (velocity := self._velocity(t, u, mu)) is None:
                continue
            if before is None:  # one that falls to 0 within the step is twice its mean
                excess = np.abs(velocity) - 2 * np.abs(z)
            else:
                excess = np.abs(velocity - z) - 2 * np.abs(z - before)
            jump = HIDDEN * self._process.metric.norm(np.maximum(excess, 0.0))
            estimator.leading[i] = max(estimator.leading[i], jump / mu**estimator.order)
            hidden = max(hidden, mu * jump)
        estimator.error += hidden

    def _velocity(self, t: float, u: np.ndarray, mu: float) -> np.ndarray | None:
        """The velocity at any time, if it is known."""
        process, plan = self._process, self._plan
        gamma = mu * plan.scheme.a[-1][-1] if process.B is not None else 0.0
        try:
            velocity = self._programs(gamma)(u, process.C.at(t))
        except Exception:  # C(t) may have no value between the times of the grid
            return None
        # sets without a proof have certificate nan
        return None if velocity.relative > plan.tol else velocity.z

    def rings(self) -> bool:
        """Whether even the shortest step of the last pass is too long for the scheme."""
        return rings(self._process, self._plan.scheme, float(self.run.grid.mus.min()))

    def certify(self, tol: float) -> None:
        """Ask programs for certificates of tol, where that is less than what they have."""
        if tol < self._plan.tol:
            self._plan = replace(self._plan, tol=max(tol, EXACT))
            self._programs = Velocities(self._process, self._plan)

    def until(self, end: float, cause: str) -> Run:
        """A run with no step yet over the grid of the last pass until about that time."""
        last = self.run.grid
        n = max(int(np.searchsorted(last.times, end, side="right")) - 1, 1)
        kept = last.saving.steps
        saved = last.saving._replace(steps=np.append(kept[kept < n - 1], n - 1))
        grid = last._replace(times=last.times[: n + 1], mus=last.mus[:n], saving=saved, cause=cause)
        return Run(grid, self._process.u0)


def adapt(
    steps: Adaptive,
    segments: Segments,
    process: SweepingProcess,
    grid: Grid,
    saved: Callable[[np.ndarray], Saving],
    tick: Callable[[], Any],
) -> Run:
    """The run over the last of better and better grids, the first with a small estimated error.

    It has no step yet where that grid ends before t_end, as steps became too short there.
    Ctrl-C during a pass returns its steps, Ctrl-C between two passes the one before.

    Parameters
    ----------
    grid : Grid
        The first one.
    saved : callable
        Times -> what is kept of a run over them.
    tick : callable
        Called after each step.
    """
    driver = _AdaptiveDriver(segments, process, grid, saved, tick)
    try:
        return _refine(steps, segments, driver)
    except KeyboardInterrupt:  # `integrate` takes those that arrive during its steps
        driver.run.status = Status.INTERRUPTED
        return driver.run


def _refine(steps: Adaptive, segments: Segments, driver: _AdaptiveDriver) -> Run:
    """The passes, two at least: the first estimate has none to be compared with.

    Their errors are about in proportion to the sums of their local errors.
    """
    cuts, tol = segments.cuts, steps.tol
    minimum = 2.0**-40 * cuts[-1] if steps.minimum is None else steps.minimum
    shortest = min(minimum, float(np.diff(cuts).min()))  # breakpoints are met anyway
    times, resting = segments.equal(), True
    while True:
        n = len(times) - 1
        estimator = driver.run_pass(times, resting)
        run, resting = driver.run, estimator.length == 0
        passes = run.grid.passes
        error = passes[-1].error
        if run.status not in COMPLETE or (error <= tol and len(passes) > 1):
            return run
        if len(passes) == 1 and not resting:
            # residuals of programs add up along the trajectory
            driver.certify(PROGRAM_SHARE * tol / estimator.length)
        goal = float(estimator.local_errors(times).sum())
        if error > AIM * tol:
            goal *= AIM * tol / error
        wanted = estimator.steps(goal)
        cause = _failure(tol, EPS * estimator.length, passes, wanted, driver.rings)
        if cause:
            run.grid = run.grid._replace(cause=cause)
            return run
        if wanted > FARTHEST * n:  # one pass between
            goal *= (wanted / n) ** (estimator.order / 2)
        times = segments.refined(estimator, goal, n + 1)
        h = np.diff(times)
        if h.min() < shortest:
            cause = f"a step shorter than minimum = {shortest:g} is needed; {ADVICE}"
            return driver.until(float(np.median(times[1:][h < 2 * h.min()])), cause)


def _period(history: Any) -> float:
    """The period of a history, infinite where it has none; it may be a user's own object."""
    period, amplitude = getattr(history, "period", None), getattr(history, "amplitude", None)
    if isinstance(amplitude, Real) and amplitude == 0:
        return math.inf
    return float(period) if isinstance(period, Real) and float(period) > 0 else math.inf


def _apart(cuts: np.ndarray) -> np.ndarray:
    """Increasing; breakpoints that differ by rounding are one."""
    cuts = np.unique(cuts)
    distinct = cuts[np.append(True, np.diff(cuts) > TIME_SLACK * cuts[-1])]
    distinct[-1] = cuts[-1]
    return distinct


def _failure(
    tol: float, rounding: float, passes: Sequence[Pass], wanted: float, rings: Callable[[], bool]
) -> str:
    """Why it makes no sense to go on to so many steps, or nothing."""
    if tol < rounding:
        return f"tol = {tol:g} is less than the rounding of u, {rounding:.2g}; loosen it"
    n, error, _ = passes[-1]
    # errors rise now and then, but not over so many passes
    overshot = len(passes) > 2 and error > passes[-3].error and rings()
    if overshot or (len(passes) > 6 and error > passes[-7].error):
        why = "they overshoot; take implicit-euler, which never does" if overshot else ADVICE
        return f"the estimated error, {error:.2g} with {n} steps, rises with shorter steps: {why}"
    if wanted > STEPS:
        return (
            f"tol = {tol:g} would take about {wanted:.2g} steps, more than {STEPS:g}; the run has "
            f"{n} and an estimated error of {error:.2g}. Loosen the tolerance or take a scheme of "
            "higher order"
        )
    return ""
