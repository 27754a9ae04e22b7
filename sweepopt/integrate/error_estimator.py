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
scheme: the error before is forgotten, and only steps within which an unknown starts or stops err.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sweepopt.integrate.schemes import Scheme
from sweepopt.problem import SweepingProcess, squares

BLOCK = 1 << 17  # numbers of the velocities that are processed together: a megabyte
AHEAD, BESIDE = 3, 10  # steps after and before one that its derivatives and switches depend on
STIFF = 1e6  # h |J| that is as good as infinite: R has its limit to six digits
CURVED = 1.5  # curvature of the steps beside it alone gives 1, a switch more
STAGES = 1.3  # an error counts for more where z is the mean of stages, not the velocity half way:
# switches are located less well, and without it a fifth of the tuning runs missed the tolerance
TURN = 1 / 8  # of [u''] h^2: what a motion that turns half way between two times goes unseen
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
        self._b, self._c = np.array(scheme.b), np.array(scheme.c)
        stiffly_accurate, continuous = scheme.a[-1] == scheme.b, not process.rate_independent
        self._flat = not continuous and stiffly_accurate and process.C.at(0.0).polyhedral
        self.order = int(scheme.order) if stiffly_accurate or continuous else 1
        if self._flat:
            self.order = 2
        kernel = self._kernel((np.arange(1000) + 0.5) / 1000)
        self._p, self._largest = float(kernel.mean()), float(kernel[np.argmax(np.abs(kernel))])
        if not continuous:  # velocities jump anywhere in a step: the mean of errors may be 0
            self._p = float(np.sqrt(np.mean(kernel**2)))
        powers = scheme.c if self.order == 2 else [1.0] * len(self._b)
        delays = [sum(a * c for a, c in zip(row, powers, strict=False)) for row in scheme.a]
        self._q = float(self._b @ delays) - 1 / (self.order * (self.order + 1)) - self._p
        self.safety = STAGES if len(self._b) > 1 and not self._flat else 1.0

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
        slopes = quotients = np.diff(z, axis=0) / np.diff(middle)[:, None]
        window = _windows(segment, r)
        if r == 2:
            quotients = np.diff(slopes, axis=0) / (0.5 * (middle[2:] - middle[:-2]))[:, None]
        leading = abs(self._p) * self.norms(quotients)[window]
        jumps, powers = np.zeros(len(z)), (h ** (r + 1))[:, None]
        x = np.minimum(h * self._rates(z), STIFF)
        damping = np.where(z != 0, self._scheme.amplification(-x)[:, None], 1.0)
        if self._process.rate_independent:
            local = powers * quotients[window]
            local = np.where(_switching(z), TURN * local, 0.0) if self._flat else self._p * local
            return LocalErrors(local, damping, leading, jumps)

        drift = self._q * (x / h)[:, None] * z
        switches = np.zeros_like(z)
        if r == 2:
            drift = self._q * (x / h)[:, None] * 0.5 * (slopes[window] + slopes[window + 1])
            jumps[:-1] = self._jumps(h, z, slopes, segment)
            switches, quotients = self._switches(times, z, quotients, segment)
        local = switches + powers * (self._p * quotients[window] - drift)
        return LocalErrors(local, damping, leading + self.norms(drift), jumps)

    def _rates(self, z: np.ndarray) -> np.ndarray:
        """-J along the velocities."""
        sizes = self.norms(z)
        if self._process.rate_independent:
            return np.where(sizes > 0, math.inf, 0.0)
        if self._process.B is None:
            return np.zeros(len(z))
        return squares(self._process.B, z / np.where(sizes > 0, sizes, 1.0)[:, None])

    def _jumps(
        self, h: np.ndarray, z: np.ndarray, slopes: np.ndarray, segment: np.ndarray
    ) -> np.ndarray:
        """Of the velocity at breakpoints, as the lines through both sides continue to there."""
        same = segment[1:] == segment[:-1]
        inner = np.pad(np.where(same[:, None], slopes, 0.0), ((1, 1), (0, 0)))
        before, after = z + 0.5 * h[:, None] * inner[:-1], z - 0.5 * h[:, None] * inner[1:]
        return np.where(same, 0.0, self.norms(after[1:] - before[:-1]))

    def _switches(
        self, times: np.ndarray, z: np.ndarray, quotients: np.ndarray, segment: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The local errors of switches, and the second difference quotients without them.

        A switch between two midpoints is in the two second differences there alone: their sum is
        the jump of the slope, their ratio the place. One is assumed where their sum is a maximum
        and more than the curvature beside it, which is then taken from there.
        """
        h, middle = np.diff(times), 0.5 * (times[1:] + times[:-1])
        width = 0.5 * (middle[2:] - middle[:-2])
        inner = segment[2:] == segment[:-2]
        # between the midpoints k + 1 and k + 2 are the differences k and k + 1
        differences = quotients * width[:, None]
        sums = self.norms(differences[1:] + differences[:-1]) * (inner[1:] & inner[:-1])
        around = np.pad(sums, 1)
        curvature = np.pad(
            np.where(inner, self.norms(quotients), np.inf), 1, constant_values=np.inf
        )
        beside = np.minimum(curvature[:-3], curvature[3:])
        there = (sums >= around[:-2]) & (sums > around[2:]) & np.isfinite(beside)
        k = np.flatnonzero(there & (sums > CURVED * beside * (width[:-1] + width[1:])))
        smooth = quotients.copy()
        known = np.pad(np.where(inner[:, None], quotients, 0.0), ((1, 1), (0, 0)))
        smooth[k], smooth[k + 1] = known[k], known[k + 3]
        excess = (quotients - smooth) * width[:, None]
        jumps = excess[k] + excess[k + 1]
        first, second, whole = self.norms(excess[k]), self.norms(excess[k + 1]), self.norms(jumps)
        # what the second vector contributes to the sum
        place = 0.5 + 0.5 * (second**2 - first**2) / np.where(whole > 0, whole, np.inf) ** 2
        t = middle[k + 1] + np.clip(place, 0.0, 1.0) * (middle[k + 2] - middle[k + 1])
        step = k + 1 + (t >= times[k + 2])
        # a mean of velocities at both ends says in which step a switch is, but not where
        at = self._kernel((t - times[step]) / h[step]) if self._c[0] else self._largest
        local = np.zeros_like(z)
        np.add.at(local, step, (h[step] ** 2 * at)[:, None] * jumps)
        return local, smooth


class ErrorEstimator:
    """Takes the steps of a pass as they come, and propagates the error.

    Parameters
    ----------
    model : ErrorModel
    times, breakpoints : ndarray
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
        self, model: ErrorModel, times: np.ndarray, breakpoints: np.ndarray, probing: bool
    ) -> None:
        self.times, self.model, self._probing = times, model, probing
        self._segment = np.searchsorted(breakpoints[1:-1], times[:-1], side="right")
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
        kept = AHEAD + BESIDE
        if i + 1 == len(self._segment):
            self._propagate(i + 1, i + 1)
        elif len(self._z) >= kept + max(BLOCK // u.size, AHEAD):
            self._propagate(i + 1 - AHEAD, i + 1)
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
        rests = np.pad(z == 0, ((1, 1), (0, 0)), mode="edge")
        for i, k in zip(steps.tolist(), rows.tolist(), strict=True):
            t, h, ends = self.times[i], self.times[i + 1] - self.times[i], self._segment[i : i + 2]
            if len(ends) == 1 or ends[0] != ends[1]:
                self._probe(i, t + h, u[k + 1], rests[k + 1 : k + 3])
            if self._probing:
                since = (i * GOLDEN) % 1.0 * h
                self._probe(i, t + since, u[k] + since * z[k], rests[k : k + 3])
        self._done = stop

    def _probe(self, i: int, t: float, u: np.ndarray, rests: np.ndarray) -> None:
        """Ask for the velocity at t, if some unknowns rest in all of the steps around it."""
        rest: np.ndarray = np.asarray(rests.all(axis=0))
        if rest.any():
            self.probes.append(Probe(i, t, u, rest))


def _windows(segment: np.ndarray, r: int) -> np.ndarray:
    """For each step the first one of r + 1 steps around it within its segment."""
    first, after = (np.searchsorted(segment, segment, side) for side in ("left", "right"))
    window = np.minimum(np.maximum(np.arange(len(segment)) - 1, first), after - 1 - r)
    return np.maximum(window, 0)


def _switching(z: np.ndarray) -> np.ndarray:
    """Where unknowns move in a step in which one of them, perhaps another, starts, stops or turns.

    A stage may take one that starts for resting, and one that it carries along for moving on.
    """
    moves, signs = z != 0, np.pad(np.sign(z), ((1, 1), (0, 0)), mode="edge")
    changes = (signs[1:-1] != signs[:-2]) | (signs[1:-1] != signs[2:])
    return moves & (moves & changes).any(axis=1, keepdims=True)
