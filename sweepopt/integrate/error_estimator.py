"""Estimate of the global error of a pass, from nothing but its states and velocities.

A step h of a scheme of order r has the local error

    d = h^(r+1) (p u^(r+1) + q J u^(r)),        J the derivative of Phi by u,

with p and q from the tableau; a switch after a share s of the step adds h^2 [u''] k(s), where k is
the Peano kernel of the tableau's quadrature and [u''] the jump of the velocity's slope. Derivatives
are difference quotients of the mean velocities z of the steps. Along z, J is about
-<Bz, z> / <Az, z>, and 0 for unknowns that rest. The error is propagated with its sign,

    e_{i+1} = R(h J) e_i + d_i,                 R the stability function,

so that what cancels or is damped does not count.

At A = 0 with flat faces what moves is where it should be after each step of a stiffly accurate
scheme: the error before is forgotten, and only what stops within a step errs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sweepopt.integrate.schemes import Scheme
from sweepopt.problem import SweepingProcess, squares

BLOCK = 1 << 17  # numbers of the velocities that are processed together: a megabyte
AHEAD = 3  # steps after one that its derivatives and switches are taken from
BESIDE = 10  # steps before it
STIFF = 1e6  # h |J| that is as good as infinite: R has its limit to six digits
CURVED = 1.5  # a switch changes the slope by more than so many times what curvature beside it does
OUTSIDE = 0.1  # of a gap that a switch may seem to be outside of it: velocities have errors too
EARLY = 0.5  # of a step that a stop may seem to be before it, for the same reason
STAGES = 1.5  # an error counts for more where z is the mean of stages, not the velocity half way:
# switches are located less well, and without it a fifth of the runs kept back missed the tolerance
TURN = 0.25  # of jump times step: the largest error of a motion that stops or turns at once
GOLDEN = 0.5 * (math.sqrt(5) - 1)  # its multiples modulo 1 fall into step with no period


class LocalErrors(NamedTuple):
    """What each of m steps does to the error.

    Attributes
    ----------
    local, damping : ndarray, shape (m, dim)
        e_{i+1} = damping_i e_i + local_i.
    leading : ndarray, shape (m,)
        |d| / h^(r+1) in the mean over all places of a switch.
    jumps : ndarray, shape (m,)
        Of the velocity between a step and the next one, where there is a breakpoint: the exact one
        has none, so that there is a switch in the half of a step beside it.
    """

    local: np.ndarray
    damping: np.ndarray
    leading: np.ndarray
    jumps: np.ndarray


class Probe(NamedTuple):
    """A time at which no step has evaluated C, u and the unknowns that seem to rest there."""

    step: int
    t: float
    u: np.ndarray
    rest: np.ndarray


class ErrorModel:
    """Local errors of a scheme for a process; `order` is that of the error at the nodes."""

    def __init__(self, process: SweepingProcess, scheme: Scheme) -> None:
        self._process, self._scheme = process, scheme
        n = len(scheme.b)
        self._a = np.array([[*row, *[0.0] * (n - len(row))] for row in scheme.a])
        self._b, self._c = np.array(scheme.b), np.array(scheme.c)
        stiffly_accurate = scheme.a[-1] == scheme.b
        self._continuous = not process.rate_independent  # the velocity
        self._flat = not self._continuous and stiffly_accurate and process.C.at(0.0).polyhedral
        self.order = int(scheme.order) if stiffly_accurate or self._continuous else 1
        if self._flat:
            self.order = 2
        shares = (np.arange(1000) + 0.5) / 1000
        kernel = self._kernel(shares)
        self._p, self._largest = float(kernel.mean()), float(kernel[np.argmax(np.abs(kernel))])
        if not self._continuous and not stiffly_accurate:
            self._p = float(np.sqrt(np.mean(kernel**2)))  # midpoint's mean is 0, its errors are not
        delays = self._a @ self._c if self.order == 2 else self._a.sum(axis=1)
        self._q = float(self._b @ delays) - 1 / (self.order * (self.order + 1)) - self._p
        self.safety = STAGES if n > 1 and not self._flat else 1.0

    def _kernel(self, s: np.ndarray) -> np.ndarray:
        """The Peano kernel of the quadrature."""
        late = np.maximum(self._c[:, None] - s, 0.0) ** (self.order - 1) * (self._c[:, None] > s)
        kernel: np.ndarray = self._b @ late - (1 - s) ** self.order / self.order
        return kernel

    def norms(self, rows: np.ndarray) -> np.ndarray:
        """|u|_A of each row, |u|_B where A = 0."""
        return np.sqrt(np.maximum(squares(self._process.metric.M, rows), 0.0))

    def local_errors(self, times: np.ndarray, z: np.ndarray, segment: np.ndarray) -> LocalErrors:
        """Of consecutive steps with mean velocities z; `segment` says between which breakpoints."""
        r, h, middle = self.order, np.diff(times), 0.5 * (times[1:] + times[:-1])
        slopes = np.diff(z, axis=0) / np.diff(middle)[:, None]
        quotients, window = slopes, _windows(segment, r)
        if r == 2:
            quotients = np.diff(slopes, axis=0) / (0.5 * (middle[2:] - middle[:-2]))[:, None]
        leading = abs(self._p) * self.norms(quotients)[window]
        rates = self._rates(z)
        damping, own = self._stability(np.minimum(h * rates, STIFF))
        damping = np.where(z != 0, damping[:, None], 1.0)
        if not self._continuous:
            local = (h ** (r + 1))[:, None] * quotients[window]
            if self._flat:
                local = _stops(times, z, segment, TURN * local)
            else:
                local *= self._p
            return LocalErrors(local, damping, leading, np.zeros(len(z)))

        lower, jumps = z, np.zeros(len(z))
        if r == 2:
            jumps[:-1] = self._jumps(h, z, slopes, segment)
            steps = np.arange(len(z))
            left, right = np.maximum(steps - 1, window), np.minimum(steps, window + 1)
            lower = 0.5 * (slopes[left] + slopes[right])
        drift = np.minimum(rates, STIFF / h) * self._q
        leading = own * (leading + np.abs(drift * self.norms(lower)))
        local = np.zeros_like(z)
        if r == 2:
            local, quotients = self._switches(times, z, quotients, segment)
        local += (h**3 if r == 2 else h**2)[:, None] * (
            self._p * quotients[window] - drift[:, None] * lower
        )
        return LocalErrors(own[:, None] * local, damping, leading, jumps)

    def _rates(self, z: np.ndarray) -> np.ndarray:
        """-J along the velocities."""
        sizes = self.norms(z)
        if not self._continuous:
            return np.where(sizes > 0, math.inf, 0.0)
        if self._process.B is None:
            return np.zeros(len(z))
        return squares(self._process.B, z / np.where(sizes > 0, sizes, 1.0)[:, None])

    def _stability(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """R(-x), and what steps leave of the error that arises in them."""
        stages: list[np.ndarray] = []
        own = np.ones_like(x)
        for row in self._scheme.a:
            known = sum(weight * stage for weight, stage in zip(row, stages, strict=False))
            own /= 1 + x * row[-1]
            stages.append((1 - x * known) / (1 + x * row[-1]))
        return 1 - x * sum(b * stage for b, stage in zip(self._b, stages, strict=True)), own

    def _jumps(
        self, h: np.ndarray, z: np.ndarray, slopes: np.ndarray, segment: np.ndarray
    ) -> np.ndarray:
        """Of the velocity at breakpoints, as the lines through both sides continue to there."""
        same = segment[1:] == segment[:-1]
        inner, none = np.where(same[:, None], slopes, 0.0), np.zeros_like(z[:1])
        before = z + 0.5 * h[:, None] * np.vstack([none, inner])
        after = z - 0.5 * h[:, None] * np.vstack([inner, none])
        return np.where(same, 0.0, self.norms(after[1:] - before[:-1]))

    def _switches(
        self, times: np.ndarray, z: np.ndarray, quotients: np.ndarray, segment: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The local errors of switches, and the second difference quotients without them.

        A switch between two midpoints is in the two second differences there alone: their sum is
        the jump of the slope, their ratio the place. One is assumed where their sum is a maximum
        and more than the curvature beside it. Unknowns that the norm couples have theirs together.
        """
        h, middle = np.diff(times), 0.5 * (times[1:] + times[:-1])
        width = (0.5 * (middle[2:] - middle[:-2]))[:, None]
        inner = (segment[2:] == segment[:-2])[:, None]
        separate = self._process.metric.is_diagonal
        parts = np.abs if separate else lambda rows: self.norms(rows)[:, None]
        # between the midpoints k + 1 and k + 2 are the differences k and k + 1
        differences = quotients * width
        sizes = parts(differences)
        sums = np.where(inner[1:] & inner[:-1], parts(differences[1:] + differences[:-1]), 0.0)
        none, edge = np.zeros((1, sums.shape[1])), np.full((1, sums.shape[1]), np.inf)
        outer = np.where(inner, sizes / width, np.inf)
        beside = np.minimum(np.vstack([edge, outer[:-2]]), np.vstack([outer[2:], edge]))
        there = (sums >= np.vstack([none, sums[:-1]])) & (sums > np.vstack([sums[1:], none]))
        there &= np.isfinite(beside) & (sums > CURVED * beside * (width[:-1] + width[1:]))
        there &= np.abs(_share(sizes, sums) - 0.5) <= 0.5 + OUTSIDE
        k, unknown = np.nonzero(np.broadcast_to(there, (len(sums), z.shape[1])))

        # in both differences of a switch the curvature is that beside it on their side, or none
        clean = np.where(inner, quotients, 0.0)
        clean[k, unknown] = clean[k + 1, unknown] = 0.0
        clean = np.pad(clean, ((1, 1), (0, 0)))
        smooth = quotients.copy()
        smooth[k, unknown], smooth[k + 1, unknown] = clean[k, unknown], clean[k + 3, unknown]
        excess = (quotients - smooth) * width
        jumps = excess[:-1] + excess[1:]
        shares = np.clip(_share(parts(excess), parts(jumps)), 0.0, 1.0)
        place = np.nan_to_num(np.broadcast_to(shares, jumps.shape)[k, unknown], nan=0.5)
        t = (1 - place) * middle[k + 1] + place * middle[k + 2]
        step = k + 1 + (t >= times[k + 2])
        # a mean of velocities at both ends says in which step a switch is, but not where
        at = self._kernel((t - times[step]) / h[step]) if self._c[0] else self._largest
        local = np.zeros_like(z)
        np.add.at(local, (step, unknown), h[step] ** 2 * jumps[k, unknown] * at)
        return local, smooth


class ErrorEstimator:
    """Takes the steps of a pass as they come, and propagates the error.

    Parameters
    ----------
    model : ErrorModel
    times, cuts : ndarray
        The grid; the start, the breakpoints and the end: no difference is taken across them.
    probing : bool
        Whether there are probes within steps, not only at the ends of segments.

    Attributes
    ----------
    error : float
        The largest error so far.
    length, size : float
        Arc length of u; the largest |u|.
    leading, jumps : ndarray
        As in `LocalErrors`, of the whole pass.
    probes : list of Probe
    """

    def __init__(
        self, model: ErrorModel, times: np.ndarray, cuts: np.ndarray, probing: bool
    ) -> None:
        self.times, self.model, self._probing = times, model, probing
        self._segment = np.searchsorted(cuts[1:-1], times[:-1], side="right")
        self._z: list[np.ndarray] = []
        self._u: list[np.ndarray] = []
        self._first = self._done = 0  # the step in the first row; how many are processed
        self.error = self.length = self.size = 0.0
        self.leading, self.jumps = np.zeros((2, len(times) - 1))
        self.probes: list[Probe] = []

    def add_step(self, i: int, u: np.ndarray, z: np.ndarray) -> None:
        """Take the state after step i and its velocity."""
        if i == 0:
            self._u = [u - (self.times[1] - self.times[0]) * z]
            self._error = np.zeros_like(u)
        self._z.append(z)
        self._u.append(u)
        if i + 1 == len(self._segment):
            self._propagate(i + 1, i + 1)
        elif len(self._z) >= AHEAD + BESIDE + max(BLOCK // u.size, AHEAD):
            self._propagate(i + 1 - AHEAD, i + 1)
            kept = AHEAD + BESIDE
            self._z, self._u, self._first = self._z[-kept:], self._u[-kept - 1 :], i + 1 - kept

    def _propagate(self, stop: int, available: int) -> None:
        """Propagate the error over the next steps, up to step `stop` of the available ones."""
        model, steps = self.model, np.arange(self._done, stop)
        rows = steps - self._first
        z, u, times = np.array(self._z), np.array(self._u), self.times[self._first : available + 1]
        step_errors = model.local_errors(times, z, self._segment[self._first : available])
        errors = step_errors.local[rows]
        for k, damping in enumerate(step_errors.damping[rows]):
            self._error = errors[k] = damping * self._error + errors[k]
        self.error = max(self.error, model.safety * float(model.norms(errors).max()))
        self.length += float(np.diff(times)[rows] @ model.norms(z[rows]))
        self.size = max(self.size, float(model.norms(u[rows + 1]).max()))
        self.leading[steps], self.jumps[steps] = step_errors.leading[rows], step_errors.jumps[rows]
        rests = np.vstack([z[:1] == 0, z == 0, z[-1:] == 0])
        for i, k in zip(steps.tolist(), rows.tolist(), strict=True):
            ends = i + 1 == len(self._segment) or self._segment[i] != self._segment[i + 1]
            if ends and (rest := rests[k + 1] & rests[k + 2]).any():
                self.probes.append(Probe(i, self.times[i + 1], u[k + 1], rest))
            if self._probing and (rest := rests[k] & rests[k + 1] & rests[k + 2]).any():
                since = (i * GOLDEN) % 1.0 * (self.times[i + 1] - self.times[i])
                self.probes.append(Probe(i, self.times[i] + since, u[k] + since * z[k], rest))
        self._done = stop


def _windows(segment: np.ndarray, r: int) -> np.ndarray:
    """For each step the first one of r + 1 steps, within its segment if there are so many."""
    steps = np.arange(len(segment))
    chosen = np.full(len(steps), -1)
    for same in (True, False):
        for k in (steps - 1, steps, steps - 2)[: r + 1]:
            inner = np.clip(k, 0, len(steps) - 1 - r)
            fits = segment[inner] == segment[inner + r] if same else True
            chosen = np.where((k == inner) & (chosen < 0) & fits, k, chosen)
    return chosen


def _share(sizes: np.ndarray, sums: np.ndarray) -> np.ndarray:
    """The second one's share of the sum of two vectors, from the norms; nan where there is none."""
    shares = np.full_like(sums, np.nan)
    second = sizes[1:] ** 2 + sums**2 - sizes[:-1] ** 2
    np.divide(second, 2 * sums**2, out=shares, where=sums > 0)
    return shares


def _stops(times: np.ndarray, z: np.ndarray, segment: np.ndarray, most: np.ndarray) -> np.ndarray:
    """Local errors at A = 0 with flat faces: only where unknowns stop or turn, else 0.

    The velocities of the two steps before it say where: there the line through them is 0, and u has
    gone the way until there. Where they do not say it, it is `most`, the error at the worst place.
    """
    stops = z != 0
    stops[:-1] &= z[1:] * z[:-1] <= 0
    stops[-1] = False
    local = np.where(stops, most, 0.0)
    k, j = np.nonzero(stops[2:])
    k += 2
    middle, h = 0.5 * (times[1:] + times[:-1]), np.diff(times)
    last, slope = z[k - 1, j], (z[k - 1, j] - z[k - 2, j]) / (middle[k - 1] - middle[k - 2])
    usable = (segment[k - 2] == segment[k]) & (last * z[k - 2, j] > 0) & (slope * last < 0)
    k, j, last, slope = k[usable], j[usable], last[usable], slope[usable]
    start = last + slope * (times[k] - middle[k - 1])
    tau = -start / slope
    usable = (tau >= -EARLY * h[k]) & (tau <= h[k] + h[np.minimum(k + 1, len(h) - 1)])
    k, j, tau, start, slope = (column[usable] for column in (k, j, tau, start, slope))
    tau = np.maximum(tau, 0.0)
    local[k, j] = h[k] * z[k, j] - tau * (start + 0.5 * slope * tau)
    return local
