"""Adaptive steps for a process: its breakpoints, its passes, and the run they end with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sweepopt.checks import TIME_SLACK, axes, number, vector
from sweepopt.errors import InputError, Status
from sweepopt.integrate.adaptive import CHECKED, FIRST, STEPS, Adaptive, Refined, refine
from sweepopt.integrate.error_estimator import Watch
from sweepopt.integrate.error_propagation import Flow
from sweepopt.integrate.grid import evaluation_times, time_grid
from sweepopt.integrate.loop import RestartPoint, integrate
from sweepopt.integrate.mesh_density import first_grid
from sweepopt.integrate.record import Run, Saving, saving
from sweepopt.integrate.schemes import Scheme
from sweepopt.integrate.step import Velocities
from sweepopt.linalg import EPS
from sweepopt.problem import SweepingProcess
from sweepopt.sets import MovingSet
from sweepopt.velocity import Plan

SHARE = 0.05  # of the tolerance that inexact programs may take
TIME_ROUNDING = 4 * EPS  # of the end: sizes of equal steps
EXACT = 1e-9  # no certificate below it is asked for


@dataclass(eq=False)
class Walked:
    """A grid, what is kept of it, and the run over it if there is one already."""

    times: np.ndarray
    mus: np.ndarray
    plan: Plan
    wanted: Saving
    run: Run | None = None


class Frame:
    """What every grid of adaptive steps has in common.

    Attributes
    ----------
    cuts : ndarray
        0, the breakpoints of C(t), the times that are to be saved, and t_end.
    longest : float
        Longest step.
    """

    def __init__(
        self, steps: Adaptive, process: SweepingProcess, t_end: Any, scheme: Scheme, save: Any
    ) -> None:
        if t_end is None:
            raise InputError("t_end is missing; Adaptive steps need it")
        end = number("t_end", t_end, minimum=0.0, strict=True)
        cuts = [np.array([0.0, end])]
        if isinstance(process.C, MovingSet):
            cuts.append(process.C.breakpoints(0.0, end))
        if is_times(save):
            times = vector("save", save)
            cuts.append(times[(times > 0.0) & (times < end)])  # `saving` refuses the others
        self.steps, self.cuts = steps, _apart(np.unique(np.concatenate(cuts)))
        self.longest = min(end / FIRST if steps.first is None else steps.first, end / 4)
        if scheme.explicit and process.B is not None and process.Lam > 0:
            self.longest = min(self.longest, 1 / process.Lam)
        if end / self.longest > STEPS:
            raise InputError(
                f"Adaptive: steps of at most {self.longest:.3g} up to t_end = {end:g} are more "
                f"than {STEPS:g}; make first longer"
            )
        self.flow = Flow(process, scheme)

    def grid(self) -> tuple[np.ndarray, np.ndarray]:
        """The times and steps of the first pass."""
        return time_grid(None, first_grid(self.cuts, self.longest))


def is_times(save: Any) -> bool:
    """Whether `save` is an array of times."""
    return not isinstance(save, str) and not callable(save) and axes(save) == 1


def adapt(
    frame: Frame,
    process: SweepingProcess,
    plan: Plan,
    save: Any,
    memory: float,
    tick: Callable[[], Any],
) -> tuple[Walked, Refined]:
    """Choose the steps and move u along them.

    Returns
    -------
    Walked
        The last pass; without its run where the steps became too short.
    Refined
    """
    walk = _Walk(frame, process, plan, save, memory, tick)
    # two passes' worth of states and errors, a tenth of the memory
    checked = max(min(CHECKED, int(memory / (320.0 * process.dim))), 16)
    refined = refine(frame.steps, frame.cuts, frame.longest, frame.flow, walk, checked)
    last, plan = walk.last, walk.plan
    assert last is not None
    if refined.failed is None:
        return last, refined
    reached = max(int(np.searchsorted(last.times, refined.failed, side="right")) - 1, 1)
    times, mus = last.times[: reached + 1], last.mus[:reached]
    if is_times(save):
        save = np.append([t for t in np.ravel(save) if t <= times[-1]], times[-1])
    return Walked(times, mus, plan, saving(save, times, plan.entering, memory)), refined


class _Trail:
    """The steps of a walk, from any of which another walk can go on."""

    def __init__(
        self, places: list[RestartPoint], velocities: list[np.ndarray], before: Run | None = None
    ) -> None:
        self.places, self.velocities, self._before = places, velocities, before
        self.run: Run | None = None

    def until(self, known: int) -> _Trail:
        """So many steps of it."""
        return _Trail(self.places[:known], self.velocities[:known], self.run)

    def begin(self, run: Run, start: RestartPoint) -> RestartPoint:
        """Give the run the steps that are known."""
        if not self.places or self._before is None:
            return start
        before, known = self._before, len(self.places)
        columns = {name: column[:known] for name, column in before.log.columns.items()}
        run.log.restore(columns, before.log.solvers)
        if np.isnan(columns["relative"]).any():
            run.status = Status.UNCERTIFIED
        if before.overshot is not None and before.overshot < known:
            run.overshot = before.overshot
        for place, z in zip(self.places, self.velocities, strict=True):
            run.add_state(place.u, z)
        return self.places[-1]

    def after_step(self, run: Run, place: RestartPoint) -> bool:
        """Take the step that is done, if its velocity was taken."""
        if len(self.velocities) > len(self.places):
            self.places.append(place)
        return False


class _Walk:
    """Moves u along one grid after the other; the first one says what tol the programs need."""

    def __init__(
        self,
        frame: Frame,
        process: SweepingProcess,
        plan: Plan,
        save: Any,
        memory: float,
        tick: Callable[[], Any],
    ) -> None:
        self._frame, self._process, self._tick = frame, process, tick
        self._save, self._memory = save, memory
        self._use(plan)
        self._trail = _Trail([], [])
        self._sizes = np.zeros(0)
        self.last: Walked | None = None

    def _use(self, plan: Plan) -> None:
        self.plan, self._programs = plan, Velocities(self._process, plan)

    def __call__(self, times: np.ndarray, watch: Watch, known: int) -> Run:
        process, plan = self._process, self.plan
        times, mus = time_grid(None, times)
        mus = self._sizes = _alike(mus, self._sizes, times)
        process.check(evaluation_times(times, mus, plan.scheme))
        wanted = saving(self._save, times, plan.entering, self._memory)
        run = Run(len(mus), wanted.steps, process.u0)

        trail = self._trail = self._trail.until(known)
        for i, (place, z) in enumerate(zip(trail.places, trail.velocities, strict=True)):
            watch.see(i, place.u, z)

        def look(i: int, u: np.ndarray, z: np.ndarray, _: float) -> bool:
            self._tick()
            stop = watch.see(i, u, z)
            if watch.mendable:
                trail.velocities.append(z)
            return stop

        integrate(process, plan, times, mus, run, look, None, trail, self._programs)
        trail.run = run
        if self.last is None and watch.length > 0:
            # what the programs miss adds up along the way of u
            asked = max(SHARE * self._frame.steps.tol / watch.length, EXACT)
            if asked < plan.tol:
                self._use(replace(plan, tol=asked))
        self.last = Walked(times, mus, plan, wanted, run)
        return run


def _alike(mus: np.ndarray, known: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Steps that differ from known ones by rounding only have their size: they share a program."""
    if not known.size:
        return mus
    known = np.unique(known)
    right = np.clip(np.searchsorted(known, mus), 1, max(len(known) - 1, 1))
    sides = known[right - 1], known[np.minimum(right, len(known) - 1)]
    nearest = np.where(mus - sides[0] <= sides[1] - mus, *sides)
    return np.where(np.abs(nearest - mus) <= TIME_ROUNDING * times[-1], nearest, mus)


def _apart(cuts: np.ndarray) -> np.ndarray:
    """Breakpoints that differ by rounding are one."""
    far = np.append(True, np.diff(cuts) > TIME_SLACK * cuts[-1])
    far[-1] = True
    kept = cuts[far]
    return kept if kept[-1] - kept[-2] > TIME_SLACK * cuts[-1] else np.delete(kept, -2)
