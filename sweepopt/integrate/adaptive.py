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
from collections.abc import Callable
from dataclasses import InitVar, dataclass, replace
from typing import Any

import numpy as np

from sweepopt.checks import TIME_SLACK, axes, meaning, number, vector
from sweepopt.errors import InputError, Status
from sweepopt.integrate.error_estimator import ErrorEstimator
from sweepopt.integrate.grid import breakpoints_to_meet, evaluation_times, time_grid
from sweepopt.integrate.loop import integrate
from sweepopt.integrate.record import Grid, Pass, Run, Saving
from sweepopt.integrate.schemes import Scheme, rings
from sweepopt.integrate.step import Velocities
from sweepopt.linalg import EPS
from sweepopt.loads import History, Sine, Triangle
from sweepopt.problem import SweepingProcess, histories_of

STEPS = 1_000_000  # of the finest pass: hours
FIRST = 16  # steps of the first pass, twice as many where nothing but values of the load are known
GOLDEN = 0.5 * (math.sqrt(5) - 1)  # steps cut in this ratio fall into step with no period
PER_PIECE = 3  # steps between breakpoints and in half a period, at least: for second differences
AIM = 0.75  # estimate that the next pass should have, in units of tol: it scatters by a third
FARTHEST = 6.0  # times the steps of a pass to which its differences say where they are needed
HIDDEN = 1 / 12  # of jump times step: mean error of a switch anywhere in the half step beside it
PROGRAM_SHARE = 0.05  # of tol that residuals of programs, which no estimate sees, may take
EXACT = 1e-9  # no certificate below it is asked for: programs reach it on every scene
ADVICE = (
    "does the load jump there? Give it as data (a Table has no jumps, and its breakpoints are "
    "met exactly) or loosen the tolerance"
)
COMPLETE = (Status.SUCCESS, Status.UNCERTIFIED)


@meaning(
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
        Longest step, t_end / 16 by default, t_end / 32 where the load is a function. An event of
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
        first = steps.first or end / (FIRST if known else 2 * FIRST)
        waves = [one for one in histories if isinstance(one, (Sine, Triangle)) and one.amplitude]
        period = min((wave.period for wave in waves), default=math.inf)
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
        if axes(save) == 1:
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
        """Each segment in equal steps that are not too long.

        Where the load is a function they are cut in the golden ratio, the longer part first and
        last by turns: stages at the same phase of a load in all steps would see nothing move.
        """
        share = 1.0 if self.known else GOLDEN
        counts = np.ceil(share * np.diff(self.cuts) / self.longest * (1 - 1e-9)).astype(int)
        pieces = zip(self.cuts, self.cuts[1:], counts.tolist(), strict=False)
        times = [np.linspace(a, b, k, endpoint=False) for a, b, k in pieces]
        if not self.known:
            sizes = np.repeat(np.diff(self.cuts) / counts, counts)
            odd = np.arange(sizes.size) % 2
            times.append(np.concatenate(times) + np.where(odd, 1 - share, share) * sizes)
        return np.sort(np.append(np.concatenate(times), self.cuts[-1]))

    def refined(self, estimator: ErrorEstimator, total: float, least: int) -> np.ndarray:
        """A grid of at least so many steps whose local errors are `total` in sum.

        The first grid, its steps halved until no local error is above the largest allowed one.
        """
        times, largest = self.equal(), total
        while True:
            errors = estimator.local_errors(times)
            coarse = errors > largest
            if coarse.any():
                middle = 0.5 * (times[1:] + times[:-1])
                times = np.sort(np.append(times, middle[coarse]))
            elif len(times) > least and errors.sum() <= total:
                return times
            else:
                largest *= 0.8  # small enough that hardly a grid is passed over


@dataclass
class _AdaptiveDriver:
    """Integrates over one grid after the other, and estimates the error of each pass."""

    _segments: Segments
    _process: SweepingProcess
    grid: InitVar[Grid]
    _saved: Callable[[np.ndarray], Saving]
    _tick: Callable[[], Any]

    def __post_init__(self, grid: Grid) -> None:
        self._plan, self.run = grid.plan, Run(grid, self._process.u0)
        self._programs = Velocities(self._process, grid.plan)

    def refine(self, steps: Adaptive) -> Run:
        """The passes, two at least: the first estimate has none to be compared with.

        Their errors are about in proportion to the sums of their local errors.
        """
        segments, tol = self._segments, steps.tol
        # breakpoints are met anyway
        shortest = float(np.diff(segments.cuts).min())
        shortest = min(steps.minimum or 2.0**-40 * segments.cuts[-1], shortest)
        times = segments.equal()
        while True:
            estimator = self._pass(times)
            run, n = self.run, len(times) - 1
            passes, error = run.grid.passes, run.grid.passes[-1].error
            if run.status not in COMPLETE or (error <= tol and len(passes) > 1):
                return run
            if len(passes) == 1 and estimator.length > 0:
                self._certify(PROGRAM_SHARE * tol / estimator.length)
            goal = float(estimator.local_errors(times).sum())
            if error > AIM * tol:
                goal *= AIM * tol / error
            wanted = estimator.steps(goal)
            cause = self._failure(tol, EPS * estimator.length, wanted)
            if cause:
                run.grid = run.grid._replace(cause=cause)
                return run
            if wanted > FARTHEST * n:  # one pass between
                goal *= (wanted / n) ** (estimator.order / 2)
            times = segments.refined(estimator, goal, n + 1)
            h = np.diff(times)
            if h.min() < shortest:
                cause = f"a step shorter than minimum = {shortest:g} is needed; {ADVICE}"
                return self._until(float(np.median(times[1:][h < 2 * h.min()])), cause)

    def _pass(self, times: np.ndarray) -> ErrorEstimator:
        """One pass, the same as a run with steps=times to the last bit."""
        began, process, plan = clock.perf_counter(), self._process, self._plan
        _, mus = time_grid(None, times)
        process.check(evaluation_times(times, mus, plan.scheme))
        grid = Grid(times, mus, plan, self._saved(times), self.run.grid.passes)
        self._programs.forget()
        run = Run(grid, process.u0)
        estimator = ErrorEstimator(process, plan.scheme, times, self._segments.breakpoints)
        starts: list[tuple[int, np.ndarray, np.ndarray]] = []

        def observe(i: int, u: np.ndarray, z: np.ndarray, _: float) -> None:
            self._tick()
            estimator.add_step(i, z)
            if i in estimator.starts:
                starts.append((i, u - mus[i] * z, z))

        integrate(process, plan, run, observe, velocities=self._programs)
        this = Pass(run.done, math.nan, clock.perf_counter() - began)
        run.grid = grid._replace(passes=(*grid.passes, this))
        self.run = run
        if run.status in COMPLETE:
            for i, u, z in starts:
                self._look_at_start(estimator, i, u, z)
            this = this._replace(error=estimator.error, seconds=clock.perf_counter() - began)
            run.grid = grid._replace(passes=(*grid.passes, this))
        return estimator

    def _look_at_start(
        self, estimator: ErrorEstimator, i: int, u: np.ndarray, z: np.ndarray
    ) -> None:
        """The error of a stop in the first step of a segment, before its first stage.

        A velocity that falls to 0 within a step is at its start about twice its mean z; what is
        above that shows a stop that no difference of velocities sees.
        """
        process, mu = self._process, float(self.run.grid.mus[i])
        gamma = mu * self._plan.scheme.a[-1][-1] if process.B is not None else 0.0
        start = self._programs(gamma)(u, process.C.at(float(estimator.times[i])))
        if not start.relative <= self._plan.tol:  # sets without a proof have certificate nan
            return
        excess = np.maximum(np.abs(start.z) - 2 * np.abs(z), 0.0)
        jump = HIDDEN * process.metric.norm(excess)
        estimator.leading[i] = max(estimator.leading[i], jump / mu**estimator.order)
        estimator.error = max(estimator.error, mu * jump)

    def _certify(self, tol: float) -> None:
        """Ask programs for certificates of tol, as their residuals add up along the trajectory."""
        if tol < self._plan.tol:
            self._plan = replace(self._plan, tol=max(tol, EXACT))
            self._programs = Velocities(self._process, self._plan)

    def _until(self, end: float, cause: str) -> Run:
        """A run with no step yet over the grid of the last pass until about that time."""
        last = self.run.grid
        n = max(int(np.searchsorted(last.times, end, side="right")) - 1, 1)
        kept = last.saving.steps
        saved = last.saving._replace(steps=np.append(kept[kept < n - 1], n - 1))
        grid = last._replace(times=last.times[: n + 1], mus=last.mus[:n], saving=saved, cause=cause)
        return Run(grid, self._process.u0)

    def _failure(self, tol: float, rounding: float, wanted: float) -> str:
        """Why it makes no sense to go on to so many steps, or nothing."""
        if tol < rounding:
            return f"tol = {tol:g} is less than the rounding of u, {rounding:.2g}; loosen it"
        grid, scheme = self.run.grid, self._plan.scheme
        (n, error, _), before = grid.passes[-1], [one.error for one in grid.passes[:-1]]
        found = f"{error:.2g} with {n} steps"
        # errors rise now and then, but not over so many passes
        if before[-2:-1] and error > before[-2]:
            if rings(self._process, scheme, float(grid.mus.min())):
                remedy = "they overshoot; take implicit-euler, which never does"
                return f"the estimated error, {found}, rises with shorter steps: {remedy}"
            if before[-6:-5] and error > before[-6]:
                return f"the estimated error, {found}, rises with shorter steps: {ADVICE}"
        if wanted > STEPS:
            return (
                f"tol = {tol:g} would take about {wanted:.2g} steps, more than {STEPS:g}; the run "
                f"has {n} and an estimated error of {error:.2g}. Loosen the tolerance or take a "
                "scheme of higher order"
            )
        return ""


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
        return driver.refine(steps)
    except KeyboardInterrupt:  # `integrate` takes those that arrive during its steps
        driver.run.status = Status.INTERRUPTED
        return driver.run


def _apart(cuts: np.ndarray) -> np.ndarray:
    """Increasing; breakpoints that differ by rounding are one."""
    cuts = np.unique(cuts)
    distinct = cuts[np.append(True, np.diff(cuts) > TIME_SLACK * cuts[-1])]
    distinct[-1] = cuts[-1]
    return distinct
