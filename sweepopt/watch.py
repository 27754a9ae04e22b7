"""What a pass over the run tells of its own error, without one more program.

The differences of the velocities are the derivatives of u, from which `Flow` knows what each step
misses. The error is carried along from step to step, with its sign: what cancels or is forgotten
does not count.

Where the velocity has a kink the leading order holds in the mean over the place of the kink only.
By how much it misses is estimated from the differences of neighbours and summed as a variance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sweepopt.flow import Flow

STIFF = 1e6  # h times a rate that is as good as infinite
SPREAD = 0.9  # standard deviations that are added to the error carried along
BLOCK, BESIDE = 65536, 4  # numbers of the steps that are looked at together, and steps beside them


class PassNodes(NamedTuple):
    """States of a pass, a row each, and the errors they are thought to have."""

    t: np.ndarray
    u: np.ndarray
    error: np.ndarray


class Watch:
    """Sees the velocities of a pass and carries the error along; keeps a few nodes of it.

    Steps are looked at in blocks, when those that follow them are known.

    Parameters
    ----------
    times, cuts : ndarray
        The grid; the start, the breakpoints and the end.
    flow : Flow
    before : PassNodes, optional
        Of the pass before: where this one is compared with it.
    kept : int
        So many nodes are kept.

    Attributes
    ----------
    jumps : dict
        From a step that ends at a breakpoint, or at the end, to the jump of the velocity there: it
        has none, so that something happened between that time and the middle of a step beside it.
    error, spread : float
        The largest error on the way, and the largest standard deviation.
    apart, expected : float
        The largest distance to the pass before, and what the errors of both let expect.
    length, size : float
        Of the way that u goes; the largest |u|.
    """

    def __init__(
        self, times: np.ndarray, cuts: np.ndarray, flow: Flow, before: PassNodes | None, kept: int
    ) -> None:
        self._flow, self._times, self._mus = flow, times, np.diff(times)
        self._middle = 0.5 * (times[1:] + times[:-1])
        self._segment = np.searchsorted(cuts[1:-1], times[:-1], side="right")
        self._window = _windows(self._segment, flow.order)
        # some nodes more where the steps are short: what is wrong there may soon be forgotten
        self._kept = np.unique(np.linspace(0, len(times) - 2, kept).astype(int))
        self._before = before
        self._z = self._u = self._carried = self._last = np.zeros(0)
        self._first = self._done = 0  # the step in the first row; how many were looked at
        self._deviation = 0.0
        self._sizes: list[np.ndarray] = []
        self._nodes: list[PassNodes] = []
        self.jumps: dict[int, float] = {}
        self.error = self.spread = self.apart = self.expected = self.length = self.size = 0.0

    @property
    def sizes(self) -> np.ndarray:
        """Of the r-th difference quotient of r + 1 steps, the first steps first."""
        return np.concatenate(self._sizes)

    @property
    def nodes(self) -> PassNodes:
        """The nodes that are kept."""
        return PassNodes(*(np.concatenate(parts) for parts in zip(*self._nodes, strict=True)))

    def see(self, i: int, u: np.ndarray, z: np.ndarray) -> None:
        """Take the state after step i and its velocity."""
        if i == 0:
            rows = min(len(self._mus), max(BLOCK // u.size, 1) + BESIDE)
            self._z, self._u = np.empty((rows, u.size)), np.empty((rows + 1, u.size))
            self._u[0] = u - self._mus[0] * z
            self._carried = self._last = np.zeros_like(u)
        row = i - self._first
        self._z[row], self._u[row + 1] = z, u
        if i + 1 == len(self._mus):
            self._look(i + 1)
        elif row + 1 == len(self._z):
            self._look(i - 1)
            self._z[:BESIDE] = self._z[-BESIDE:]
            self._u[: BESIDE + 1] = self._u[-BESIDE - 1 :]
            self._first = i + 1 - BESIDE

    def _look(self, stop: int) -> None:
        """Carry the error over the steps that nobody has looked at, up to step `stop`."""
        flow, r = self._flow, self._flow.order
        steps = np.arange(self._done, stop)
        rows = steps - self._first
        z, h = self._z[rows], self._mus[steps]
        first, high = self._derivatives(steps)
        size = flow.norms(z)
        self.length += float(h @ size)
        x = np.minimum(h * flow.rates(z, size), STIFF)
        rest, own = flow.decay(x)
        following = self._z[np.minimum(rows + 1, len(self._mus) - 1 - self._first)]
        if flow.continuous:
            missed = flow.missed(h, x, own, first if r == 2 else z, high)
        else:
            missed = flow.missed_without_A(h, following == 0, high)

        first_of_segment = np.append(True, self._segment[1:] != self._segment[:-1])
        apart = flow.scatter(following == 0) * (high - np.vstack([self._last, high[:-1]]))
        shorter = np.minimum(h, self._mus[steps - 1]) ** (r + 1)
        scatter = np.where(first_of_segment[steps], 0.0, shorter * flow.norms(apart))

        moves, old = z != 0, self._carried
        carried = _recursion(np.where(moves, rest[:, None], 1.0), missed, old)
        deviation = self._deviations(np.where(moves.any(axis=1), rest, 1.0), scatter)
        self.error = max(self.error, float((flow.norms(carried) + SPREAD * deviation).max()))
        for i in steps[np.append(first_of_segment[1:], True)[steps]].tolist():
            self._end(i)
        self._compare(steps, np.vstack([old, carried]), first)
        self._keep(steps, carried)
        self._carried, self._last, self._done = carried[-1], high[-1], stop

    def _derivatives(self, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The first and the r-th derivative of the velocity in these steps."""
        flow, r, start = self._flow, self._flow.order, max(int(steps[0]) - 2, 0)
        slopes = self._slopes(start, min(int(steps[-1]) + 2, len(self._mus) - 1))
        windows = slopes
        if r == 2:
            width = 0.5 * (self._middle[2:] - self._middle[:-2])[start : start + len(slopes) - 1]
            windows = (slopes[1:] - slopes[:-1]) / width[:, None]
        known = sum(map(len, self._sizes)) - start
        self._sizes.append(flow.norms(windows[known:]) / r)
        window = self._window[steps]
        left, right = np.maximum(steps - 1, window), np.minimum(steps, window + r - 1)
        first = 0.5 * (slopes[left - start] + slopes[right - start])
        return first, windows[window - start]

    def _keep(self, steps: np.ndarray, carried: np.ndarray) -> None:
        kept = self._kept[(self._kept >= steps[0]) & (self._kept <= steps[-1])]
        if kept.size:
            u = self._u[kept - self._first + 1]
            self._nodes.append(PassNodes(self._times[kept + 1], u, carried[kept - steps[0]]))
            self.size = max(self.size, float(self._flow.norms(u).max()))

    def _slopes(self, start: int, stop: int) -> np.ndarray:
        z = self._z[start - self._first : stop + 1 - self._first]
        return np.diff(z, axis=0) / np.diff(self._middle[start : stop + 1])[:, None]

    def _deviations(self, left: np.ndarray, scatter: np.ndarray) -> np.ndarray:
        """Of the error after each step: what the steps scatter adds up as a variance."""
        found, last = [], self._deviation
        for factor, own in zip(left.tolist(), scatter.tolist(), strict=True):
            last = math.hypot(factor * last, own)
            found.append(last)
        self._deviation = last
        self.spread = max(self.spread, *found)
        return np.array(found)

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
            jump = flow.unheld(float(self._times[i + 1]), u, z)
            self.jumps[i] = max(self.jumps.get(i, 0.0), jump)

    def _gap(self, i: int) -> float:
        """How far the velocities apart are that both sides have at a breakpoint."""
        segment, middle, cut = self._segment, self._middle, self._times[i + 1]
        z = self._z[i - self._first :]
        gap = z[1] - z[0]
        if i and segment[i - 1] == segment[i]:
            gap = gap - (cut - middle[i]) * self._slopes(i - 1, i)[0]
        if segment[i + 2] == segment[i + 1]:
            gap = gap - (middle[i + 1] - cut) * self._slopes(i + 1, i + 2)[0]
        return float(self._flow.norms(gap[None])[0])

    def _compare(self, steps: np.ndarray, carried: np.ndarray, first: np.ndarray) -> None:
        """Look at the nodes of the pass before in these steps; the parabola has its slopes."""
        if self._before is None:
            return
        start, stop = steps[0], steps[-1] + 1
        known = slice(*np.searchsorted(self._before.t, self._times[[start, stop]], side="right"))
        t, v, error = (part[known] for part in self._before)
        if not t.size:
            return
        i = np.searchsorted(self._times[1:], t)
        begin, end = self._times[i], self._times[i + 1]
        share = ((t - begin) / (end - begin))[:, None]
        row, u = i - start, self._u[i - self._first]
        u = (1 - share) * u + share * self._u[i + 1 - self._first]
        u += (0.5 * (t - begin) * (t - end))[:, None] * first[row]
        expected = (1 - share) * carried[row] + share * carried[row + 1] - error
        self.apart = max(self.apart, float(self._flow.norms(u - v).max()))
        self.expected = max(self.expected, float(self._flow.norms(expected).max()))


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


def _recursion(factors: np.ndarray, added: np.ndarray, start: np.ndarray) -> np.ndarray:
    """x_k = factor_k x_(k-1) + added_k, a row each."""
    x, rows = start, np.empty_like(added)
    for k, factor in enumerate(factors):
        x = factor * x + added[k]
        rows[k] = x
    return rows
