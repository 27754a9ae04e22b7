"""What a pass over the run tells of its own error, without one more program.

Its velocities are looked at as they come: in blocks where states are large, so that no more than a
few are held at a time. Where a limit is given, the error is looked at every few steps, and a step
after which it is beyond the limit is the last one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sweepopt.integrate.error_model import Carried, Course, Missed, carry, chain
from sweepopt.integrate.error_propagation import Flow
from sweepopt.integrate.local_refinement import Mended, mended
from sweepopt.integrate.switching_times import NONE, find_kinks, find_stops

WHOLE = 1 << 20  # numbers of the velocities of a pass that are kept all
BLOCK = 65536  # numbers of the steps that are looked at together where they are more
AHEAD, BESIDE = 3, 10  # steps after and before one that its kinks are told from
LOOKS = 25  # at the error while a pass with a limit goes on


class PassNodes(NamedTuple):
    """States of a pass, a row each."""

    t: np.ndarray
    u: np.ndarray


class Limit(NamedTuple):
    """The error that a pass may have, the one it is mended for, and the shortest step there is."""

    error: float
    goal: float
    shortest: float


class Watch:
    """Sees the velocities of a pass and carries the error along; keeps a few nodes of it.

    Steps are looked at when those that follow them are known.

    Parameters
    ----------
    times, cuts : ndarray
        The grid; the start, the breakpoints and the end.
    flow : Flow
    before : PassNodes, optional
        Of the pass before: where this one is compared with it.
    kept : int
        So many nodes are kept.
    known : int
        So many of the steps were seen before, in a pass that is mended.
    limit : Limit, optional
        An error beyond it stops the pass if it can be mended.

    Attributes
    ----------
    jumps : dict
        From a step that ends at a breakpoint, or at the end, to the jump of the velocity there: it
        has none, so that something happened between that time and the middle of a step beside it.
    error : float
        The largest error on the way.
    apart : float
        The largest distance to the pass before.
    mended : Mended or None
        The grid to go on with, of a pass that was stopped.
    length, size : float
        Of the way that u goes; the largest |u|.
    whole, mendable : bool
        Whether all velocities are kept; whether the pass may end for it to be mended.
    """

    def __init__(
        self,
        times: np.ndarray,
        cuts: np.ndarray,
        flow: Flow,
        before: PassNodes | None,
        kept: int,
        known: int = 0,
        limit: Limit | None = None,
    ) -> None:
        self.times, self._flow, self._mus = times, flow, np.diff(times)
        self._middle = 0.5 * (times[1:] + times[:-1])
        self._segment = np.searchsorted(cuts[1:-1], times[:-1], side="right")
        self._window = _windows(self._segment, flow.order)
        # some nodes more where the steps are short: what is wrong there may soon be forgotten
        self._kept = np.unique(np.linspace(0, len(times) - 2, kept).astype(int))
        self._before = before
        self._z = self._u = np.zeros(0)
        self._first = self._done = 0  # the step in the first row; how many were looked at
        self._error, self._last, self._deviation = np.zeros(0), np.zeros(0), 0.0
        self._sizes: list[np.ndarray] = []
        self._nodes: list[PassNodes] = []
        self._courses: list[Course] = []
        self._missed: list[Missed] = []
        self._carried: list[Carried] = []
        self._known, self._limit = known, limit
        self.whole = self.mendable = False
        self.mended: Mended | None = None
        self.jumps: dict[int, float] = {}
        self.error = self.apart = self.length = self.size = 0.0

    @property
    def sizes(self) -> np.ndarray:
        """Of the r-th difference quotient of r + 1 steps, the first steps first."""
        return np.concatenate(self._sizes)

    @property
    def nodes(self) -> PassNodes:
        """The nodes that are kept."""
        return PassNodes(*(np.concatenate(parts) for parts in zip(*self._nodes, strict=True)))

    @property
    def course(self) -> Course:
        """How the velocity went, of a pass that is kept whole."""
        return chain(self._courses)

    def see(self, i: int, u: np.ndarray, z: np.ndarray) -> bool:
        """Take the state after step i and its velocity; whether the pass shall end with it."""
        n = len(self._mus)
        if i == 0:
            self.whole = n * u.size <= WHOLE
            self.mendable = self.whole and self._limit is not None
            rows = n if self.whole else min(n, BLOCK // u.size + AHEAD + BESIDE + 1)
            self._z, self._u = np.empty((rows, u.size)), np.empty((rows + 1, u.size))
            self._u[0] = u - self._mus[0] * z
            self._error = self._last = np.zeros_like(u)
        row = i - self._first
        self._z[row], self._u[row + 1] = z, u
        if i + 1 == n:
            self._look(n, n)
        elif row + 1 == len(self._z):
            self._look(i + 1 - AHEAD, i + 1)
            kept = AHEAD + BESIDE
            self._z[:kept] = self._z[-kept:]
            self._u[: kept + 1] = self._u[-kept - 1 :]
            self._first = i + 1 - kept
        elif self.mendable and i >= self._known and (i + 1) % max(n // LOOKS, 2) == 0:
            self._look(i + 1 - AHEAD, i + 1)
        if self.mendable and self._limit and self.error > self._limit.error:
            self._mend(self._limit)
        return self.mended is not None

    def _mend(self, limit: Limit) -> None:
        """Choose the grid to go on with; if there is none, the pass goes on as it is."""
        missed = Missed(*(np.concatenate(parts) for parts in zip(*self._missed, strict=True)))
        carried = Carried(*(np.concatenate(parts) for parts in zip(*self._carried, strict=True)))
        self.mended = mended(self._flow, self.times, missed, carried, *limit)
        self._limit = None

    def _look(self, stop: int, seen: int) -> None:
        """Carry the error over the steps that nobody has looked at, up to step `stop`."""
        if stop <= self._done:
            return
        flow = self._flow
        steps = np.arange(self._done, stop)
        rows = steps - self._first
        z, h = self._z[rows], self._mus[steps]
        self.length += float(h @ flow.norms(z))
        course, slopes = self._course(steps, seen)
        missed = course.own(flow, self._mus[max(self._done - 1, 0)])
        carried = carry(missed, self._error, self._deviation)
        self.error = max(self.error, float(carried.sizes(flow).max()))
        if self.whole:
            self._courses.append(course)
            self._missed.append(missed)
            self._carried.append(carried)
        ends = np.append(self._segment[1:] != self._segment[:-1], True)[steps]
        for i in steps[ends].tolist():
            self._end(i)
        self._compare(steps, slopes)
        self._keep(steps)
        self._error, self._deviation = carried.errors[-1], float(carried.deviations[-1])
        self._last, self._done = course.high[-1], stop

    def _course(self, steps: np.ndarray, seen: int) -> tuple[Course, np.ndarray]:
        """How the velocity goes in these steps, from those beside them; its slopes."""
        flow, r = self._flow, self._flow.order
        start = max(int(steps[0]) - BESIDE, self._first)
        end = min(int(steps[-1]) + 1 + AHEAD, seen)
        times, segment = self.times[start : end + 1], self._segment[start:end]
        z = self._z[start - self._first : end - self._first]
        slopes = self._slopes(start, end - 1)
        windows = slopes
        if r == 2:
            width = 0.5 * (self._middle[2:] - self._middle[:-2])[start : start + len(slopes) - 1]
            windows = (slopes[1:] - slopes[:-1]) / width[:, None]
        known = sum(map(len, self._sizes)) - start
        self._sizes.append(flow.norms(windows[known:]) / r)

        here = steps - start
        kinks, curvature = NONE, windows
        if flow.locates and flow.continuous:
            kinks, curvature = find_kinks(times, z, segment, flow.parts)
        elif flow.locates:
            kinks = find_stops(times, z, segment)
        kinks = kinks.within(int(here[0]), int(here[-1]) + 1)
        moves, following = z[here] != 0, z[np.minimum(here + 1, len(z) - 1)]
        # what turns from one step to the next has stopped and has started again
        stops = following * z[here] <= 0 if flow.locates else following == 0
        window = self._window[steps]
        left, right = np.maximum(steps - 1, window), np.minimum(steps, window + r - 1)
        slope = 0.5 * (slopes[left - start] + slopes[right - start])
        high = curvature[window - start]
        if flow.locates and not flow.continuous:
            # but for stops that were not found, what moves is where it should be
            high = np.where(moves & stops, high, 0.0)
            high[kinks.step, kinks.unknown] = 0.0
            bends = high.copy()
            open_ = np.where(kinks.sure, 0.0, kinks.jump) / self._mus[steps][kinks.step]
            bends[kinks.step, kinks.unknown] = open_
        else:
            begins = np.append(True, self._segment[1:] != self._segment[:-1])[steps]
            bends = np.where(begins[:, None], 0.0, high - np.vstack([self._last, high[:-1]]))
        course = Course(
            times=self.times[steps[0] : steps[-1] + 2],
            rates=flow.rates(z[here], flow.norms(z[here])),
            lower=slope if r == 2 else z[here],
            high=high,
            bends=bends,
            moves=moves,
            stops=stops,
            kinks=kinks,
        )
        return course, slope

    def _keep(self, steps: np.ndarray) -> None:
        kept = self._kept[(self._kept >= steps[0]) & (self._kept <= steps[-1])]
        if kept.size:
            u = self._u[kept - self._first + 1]
            self._nodes.append(PassNodes(self.times[kept + 1], u))
            self.size = max(self.size, float(self._flow.norms(u).max()))

    def _slopes(self, start: int, stop: int) -> np.ndarray:
        z = self._z[start - self._first : stop + 1 - self._first]
        return np.diff(z, axis=0) / np.diff(self._middle[start : stop + 1])[:, None]

    def _end(self, i: int) -> None:
        """Look at the velocities where a segment ends: at a breakpoint, or at the end."""
        flow = self._flow
        if not flow.continuous:
            return
        if flow.order == 2 and i + 2 < len(self._mus):
            self.jumps[i] = self._gap(i)
        z, u = self._z[i - self._first], self._u[i + 1 - self._first]
        if not z.all():
            # no step of the segment follows, in which it would be seen to move
            jump = flow.unheld(float(self.times[i + 1]), u, z)
            self.jumps[i] = max(self.jumps.get(i, 0.0), jump)

    def _gap(self, i: int) -> float:
        """How far the velocities apart are that both sides have at a breakpoint."""
        segment, middle, cut = self._segment, self._middle, self.times[i + 1]
        z = self._z[i - self._first :]
        gap = z[1] - z[0]
        if i and segment[i - 1] == segment[i]:
            gap = gap - (cut - middle[i]) * self._slopes(i - 1, i)[0]
        if segment[i + 2] == segment[i + 1]:
            gap = gap - (middle[i + 1] - cut) * self._slopes(i + 1, i + 2)[0]
        return float(self._flow.norms(gap[None])[0])

    def _compare(self, steps: np.ndarray, slopes: np.ndarray) -> None:
        """Look at the nodes of the pass before in these steps; the parabola has its slopes."""
        if self._before is None:
            return
        start, stop = steps[0], steps[-1] + 1
        known = slice(*np.searchsorted(self._before.t, self.times[[start, stop]], side="right"))
        t, v = (part[known] for part in self._before)
        if not t.size:
            return
        i = np.searchsorted(self.times[1:], t)
        begin, end = self.times[i], self.times[i + 1]
        share = ((t - begin) / (end - begin))[:, None]
        row, u = i - start, self._u[i - self._first]
        u = (1 - share) * u + share * self._u[i + 1 - self._first]
        u += (0.5 * (t - begin) * (t - end))[:, None] * slopes[row]
        self.apart = max(self.apart, float(self._flow.norms(u - v).max()))


def _windows(segment: np.ndarray, r: int) -> np.ndarray:
    """The window that each step takes its derivatives from: within its segment if there is one.

    Window k has the velocities of the steps from k to k + r.
    """
    steps = np.arange(len(segment))
    chosen = np.full(len(steps), -1)
    last = len(steps) - 1 - r
    for same in (True, False):
        for k in (steps - 1, steps, steps - 2)[: r + 1]:
            there = (k >= 0) & (k <= last) & (chosen < 0)
            inner = np.clip(k, 0, last)
            fits = segment[inner] == segment[inner + r] if same else True
            chosen = np.where(there & fits, k, chosen)
    return chosen
