"""What a pass over the run tells of its own error, without one more program.

A step of order r in u' = Phi(t, u) misses h^(r+1) (p u^(r+1) + (q - p) J u^(r)) to leading order, J
the derivative of Phi by u; p and q follow from the tableau. The differences of the velocities are
the derivatives of u. J is not known; along the velocity z it is -<Bz, z> / <Az, z> where unknowns
move and nothing where they stick (an unknown that sticks has the velocity 0 exactly). So the error
is carried along from step to step, with its sign: what cancels or is forgotten does not count.

Where the velocity has a kink the leading order holds in the mean over the place of the kink only.
By how much it misses is estimated from the differences of neighbours and summed as a variance.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from sweepopt.process import SweepingProcess
from sweepopt.schemes import Scheme

STIFF = 1e6  # h times a rate that is as good as infinite
# at A = 0: what turns misses more than what goes on to move, which its last stage corrects
TURNS, STARTS = 1.5, 0.5
SPREAD = 0.9  # standard deviations that are added to the error carried along


class Flow:
    """How a scheme's errors in a process arise and decay.

    Attributes
    ----------
    order : int
    mean, chain : float
        p and q - p.
    spread : float
        Standard deviation of the error over the place of a kink; its mean is p.
    """

    def __init__(self, process: SweepingProcess, scheme: Scheme) -> None:
        self.norm = process.metric.norm
        # at A = 0 a scheme that does not end with its last stage is of order 1
        stiff = scheme.a[-1] == scheme.b
        self.order = int(scheme.order) if stiff or not process.rate_independent else 1
        self.continuous = not process.rate_independent  # the velocity, where the load has a kink
        self._process = process
        n = len(scheme.b)
        self._rows, self._weights = scheme.a, scheme.b
        self._a = np.array([[*row, *[0.0] * (n - len(row))] for row in scheme.a])
        self._b, c = np.array(scheme.b), np.array(scheme.c)
        # the Peano kernel of the scheme's quadrature
        s = (np.arange(1000) + 0.5) / 1000
        late = np.maximum(c[:, None] - s, 0.0) ** (self.order - 1) * (c[:, None] > s)
        kernel = self._b @ late - (1 - s) ** self.order / self.order
        self.mean, self.spread = float(kernel.mean()), float(kernel.std())
        delays = self._a @ c if self.order == 2 else self._a.sum(axis=1)
        self.chain = float(self._b @ delays) - 1 / (self.order * (self.order + 1)) - self.mean
        turns = self._turns(c) if process.rate_independent else np.zeros(1)
        self.turn, self.turn_spread = float(turns.mean()), TURNS * float(turns.std())
        if process.rate_independent:
            self.spread *= STARTS

    def _turns(self, c: np.ndarray) -> np.ndarray:
        """How far u goes too far at A = 0 where a load turns within a step, in h^2 times its z'."""
        turn = (np.arange(100) + 0.5) / 100
        z = np.zeros((len(c), 100))
        for k in range(len(c)):
            free = turn * c[k] - 0.5 * c[k] ** 2 - self._a[k, :k] @ z[:k]
            z[k] = np.maximum(free / self._a[k, k], 0.0)
        return self._b @ z - 0.5 * turn**2

    def rate(self, z: np.ndarray) -> float:
        """How fast an error along the velocity decays."""
        size = self.norm(z)
        if not size:
            return 0.0
        if self._process.rate_independent:
            return math.inf
        direction = z / size
        return float(direction @ self._process.times_B(direction))

    def unheld(self, t: float, u: np.ndarray, z: np.ndarray) -> float:
        """About the velocity that unknowns have at time t which rested in the step before."""
        A = self._process.A
        force = A @ z + self._process.times_B(u)
        diagonal = A.diagonal()
        missed = force - self._process.C.at(t).nearest(force, diagonal)
        missed[z != 0] = 0.0
        return math.sqrt(missed @ (missed / diagonal))

    def decay(self, x: float) -> tuple[float, float]:
        """What is left after a step of an error, and of what the step itself misses."""
        stages: list[float] = []
        own = 1.0
        for row in self._rows:
            known = sum(weight * stage for weight, stage in zip(row, stages, strict=False))
            own /= 1 + x * row[-1]
            stages.append((1 - x * known) / (1 + x * row[-1]))
        return 1 - x * sum(b * stage for b, stage in zip(self._weights, stages, strict=True)), own


class Node(NamedTuple):
    """A state of a pass, and the error it is thought to have."""

    t: float
    u: np.ndarray
    error: np.ndarray


class Watch:
    """Sees the velocities of a pass and carries the error along; keeps a few nodes of it.

    Parameters
    ----------
    times, cuts : ndarray
        The grid; the start, the breakpoints and the end.
    flow : Flow
    before : list of Node
        Of the pass before: where this one is compared with it.
    kept : int
        So many nodes are kept.

    Attributes
    ----------
    sizes : list of float
        Of the r-th difference quotient of r + 1 steps, the first steps first.
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
        self, times: np.ndarray, cuts: np.ndarray, flow: Flow, before: list[Node], kept: int
    ) -> None:
        self._flow, self._times, self._mus = flow, times.tolist(), np.diff(times).tolist()
        self._middle = (0.5 * (times[1:] + times[:-1])).tolist()
        self._segment = np.searchsorted(cuts[1:-1], times[:-1], side="right").tolist()
        # some nodes more where the steps are short: what is wrong there may soon be forgotten
        self._kept = set(np.linspace(0, len(times) - 2, kept).astype(int).tolist())
        self._before = iter(before)
        self._next = next(self._before, None)
        self._z: dict[int, np.ndarray] = {}
        self._u: dict[int, np.ndarray] = {}
        self._windows: dict[int, np.ndarray] = {}
        self._last = np.zeros(0)
        self._carried, self._deviation = np.zeros(0), 0.0
        self.nodes: list[Node] = []
        self.sizes: list[float] = []
        self.jumps: dict[int, float] = {}
        self.error = self.spread = self.apart = self.expected = self.length = self.size = 0.0

    def see(self, i: int, u: np.ndarray, z: np.ndarray) -> None:
        """Take the state after step i and its velocity."""
        flow, r = self._flow, self._flow.order
        if i == 0:
            self._carried = np.zeros_like(u)
            self._u[0] = u - self._mus[0] * z
        self._z[i], self._u[i + 1] = z, u.copy()
        self.length += self._mus[i] * flow.norm(z)
        if i >= r:
            self._windows[i - r] = self._quotient(i - r)
            self.sizes.append(flow.norm(self._windows[i - r]) / r)
        for k in range(max(i - 2, 0), len(self._mus) if i == len(self._mus) - 1 else i - 1):
            self._step(k)
        for memory in (self._z, self._u, self._windows):
            memory.pop(i - 4, None)

    def _slope(self, k: int) -> np.ndarray:
        return (self._z[k + 1] - self._z[k]) / (self._middle[k + 1] - self._middle[k])

    def _quotient(self, k: int) -> np.ndarray:
        """The r-th derivative of the velocity in the steps from k to k + r."""
        if self._flow.order == 1:
            return self._slope(k)
        width = 0.5 * (self._middle[k + 2] - self._middle[k])
        return (self._slope(k + 1) - self._slope(k)) / width

    def _window(self, i: int) -> int:
        """The window that a step takes its derivatives from: within its segment if there is one."""
        r = self._flow.order
        nearest = [k for k in (i - 1, i, i - 2)[: r + 1] if k in self._windows]
        own = [k for k in nearest if self._segment[k] == self._segment[k + r]]
        return (own or nearest)[0]

    def _step(self, i: int) -> None:
        """Carry the error over step i."""
        flow, r, h, z = self._flow, self._flow.order, self._mus[i], self._z[i]
        k = self._window(i)
        high = self._windows[k]
        slopes = [self._slope(j) for j in (i - 1, i) if k <= j < k + r]
        first = 0.5 * (slopes[0] + slopes[-1])
        x = min(h * flow.rate(z), STIFF)
        rest, own = flow.decay(x)
        mean: Any = flow.mean
        kink: Any = flow.spread
        if flow.continuous:
            chain = flow.chain * x * (first if r == 2 else z)
            missed = own * h**r * (h * mean * high - chain)
        else:
            stops = self._z.get(i + 1, z) == 0
            mean = np.where(stops, flow.turn if r == 2 else mean, mean)
            kink = np.where(stops, flow.turn_spread if r == 2 else kink, kink)
            missed = h ** (r + 1) * mean * high
        old = self._carried
        self._carried = np.where(z != 0, rest * old, old) + missed
        scatter = 0.0
        if i and self._segment[i - 1] == self._segment[i]:
            scatter = min(h, self._mus[i - 1]) ** (r + 1) * flow.norm(kink * (high - self._last))
        self._last = high
        left = rest if z.any() else 1.0
        self._deviation = float(np.hypot(left * self._deviation, scatter))
        self.spread = max(self.spread, self._deviation)
        self.error = max(self.error, flow.norm(self._carried) + SPREAD * self._deviation)
        if flow.continuous and r == 2 and i + 2 < len(self._mus):
            self._meet(i)
        if (
            flow.continuous
            and not z.all()
            and self._segment[i : i + 1] != self._segment[i + 1 : i + 2]
        ):
            # no step of the segment follows, in which it would be seen to move
            jump = flow.unheld(self._times[i + 1], self._u[i + 1], z)
            self.jumps[i] = max(self.jumps.get(i, 0.0), jump)
        self._compare(i, old, first)
        if i in self._kept:
            u = self._u[i + 1]
            self.nodes.append(Node(self._times[i + 1], u, self._carried))
            self.size = max(self.size, flow.norm(u))

    def _meet(self, i: int) -> None:
        """Compare the velocities that both sides have at a breakpoint."""
        segment = self._segment
        if segment[i] == segment[i + 1]:
            return
        cut, gap = self._times[i + 1], self._z[i + 1] - self._z[i]
        if i and segment[i - 1] == segment[i]:
            gap = gap - (cut - self._middle[i]) * self._slope(i - 1)
        if segment[i + 2] == segment[i + 1]:
            gap = gap - (self._middle[i + 1] - cut) * self._slope(i + 1)
        self.jumps[i] = self._flow.norm(gap)

    def _compare(self, i: int, old: np.ndarray, first: np.ndarray) -> None:
        """Look at the nodes of the pass before within step i; the parabola has its slopes."""
        start, end = self._times[i : i + 2]
        while self._next is not None and self._next.t <= end:
            t, v, error = self._next
            share = (t - start) / (end - start)
            u = (1 - share) * self._u[i] + share * self._u[i + 1]
            u += 0.5 * (t - start) * (t - end) * first
            carried = (1 - share) * old + share * self._carried
            self.apart = max(self.apart, self._flow.norm(u - v))
            self.expected = max(self.expected, self._flow.norm(carried - error))
            self._next = next(self._before, None)
