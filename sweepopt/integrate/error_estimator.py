"""Estimate of the global error of a pass, from nothing but its velocities.

A step h of a scheme of order r has the local error

    d = h^(r+1) (p u^(r+1) + q J u^(r)),        J the derivative of Phi by u,

with p and q from the tableau: p is the mean of the Peano kernel of its quadrature, and as a switch
of the velocity may be anywhere within a step, its standard deviation is that of d. At A = 0 stops
leave errors too, whose size follows from the tableau as well.
Derivatives are difference quotients of the mean velocities z of the steps. Along z, J is about
-<Bz, z> / <Az, z>, and 0 for unknowns that rest. The mean error e and its variance v are
propagated,

    e_{i+1} = R e_i + d_i,    v_{i+1} = R^2 v_i + var(d_i),      R(h J) the stability function,

so that what cancels or is damped does not count; the estimate is |e| + |sqrt v|.
"""

from __future__ import annotations

import math

import numpy as np

from sweepopt.integrate.schemes import Scheme
from sweepopt.problem import SweepingProcess, squares

BLOCK = 1 << 17  # numbers of the velocities that are processed together: a megabyte
STIFF = 1e6  # h |J| that is as good as infinite: R has its limit to six digits


class ErrorEstimator:
    """Takes the velocities of a pass as they come, and propagates the error.

    Parameters
    ----------
    process : SweepingProcess
    scheme : Scheme
    times, breakpoints : ndarray
        The grid; the start, the breakpoints and the end: no difference is taken across them.

    Attributes
    ----------
    order : int
        Of the error at the nodes.
    error : float
        The largest error so far.
    length : float
        Arc length of u.
    starts : set of int
        The first steps of segments.
    leading : ndarray, shape (n,)
        |d| / h^(r+1) of each step.
    """

    def __init__(
        self, process: SweepingProcess, scheme: Scheme, times: np.ndarray, breakpoints: np.ndarray
    ) -> None:
        self._process, self._scheme, self.times = process, scheme, times
        jumps, b, c = process.rate_independent, np.array(scheme.b), np.array(scheme.c)
        stiffly_accurate = scheme.a[-1] == scheme.b
        r = int(scheme.order) if stiffly_accurate or not jumps else 1
        if jumps and stiffly_accurate and process.C.at(0.0).polyhedral:
            r = 2  # on flat faces unknowns that move are exact after each step
        self.order = r
        s = ((np.arange(1000) + 0.5) / 1000)[:, None]  # where in a step a switch is
        kernel = _after(c - s, r) @ b - (1 - s[:, 0]) ** r / r
        self._mean, self._spread = float(kernel.mean()), float(kernel.std())
        if jumps and r == 2:
            rms = float(np.sqrt((_stops(scheme, s) ** 2).mean()))
            self._mean, self._spread = 0.0, math.hypot(self._spread, rms)
        else:
            # what each difference of velocities sees of a switch
            samples = _after(np.arange(-r, r + 1)[:, None, None] + c - s, r) @ b
            shares = np.diff(samples, r, axis=0)
            self._spread /= float(np.sqrt((shares**2).sum(0).mean()))
        delays = [sum(a * x ** (r - 1) for a, x in zip(row, c, strict=False)) for row in scheme.a]
        self._q = 0.0 if jumps else float(b @ delays) - 1 / (r * (r + 1)) - self._mean
        # the first of the r + 1 steps whose velocities tell of each step's derivatives
        segment = np.searchsorted(breakpoints[1:-1], times[:-1], side="right")
        first, after = (np.searchsorted(segment, segment, side) for side in ("left", "right"))
        window = np.clip(np.arange(len(segment)) - 1, first, after - 1 - r)
        self._window = np.maximum(window, 0)
        self.starts = set(first.tolist())
        self._z: list[np.ndarray] = []
        self._done, self._error, self._variance = 0, *np.zeros((2, process.dim))
        self.error = self.length = 0.0
        self.leading = np.zeros(len(times) - 1)

    def norms(self, rows: np.ndarray) -> np.ndarray:
        """|u|_A of each row, |u|_B where A = 0."""
        return np.sqrt(np.maximum(squares(self._process.metric.M, rows), 0.0))

    def add_step(self, i: int, z: np.ndarray) -> None:
        """Take the velocity of step i."""
        self._z.append(z)
        known = i + 1 if i + 1 == len(self.leading) else i + 1 - self.order
        if known > i or (known - self._done) * z.size > BLOCK:
            self._propagate(known, i + 1 - len(self._z))
            self._z = self._z[-2 * self.order :]

    def _propagate(self, stop: int, first: int) -> None:
        """Propagate the error to step `stop`, by velocities from step `first` on."""
        r, steps, velocities = self.order, np.arange(self._done, stop), np.array(self._z)
        times = self.times[first : first + len(velocities) + 1]
        middle, j = 0.5 * (times[1:] + times[:-1]), self._window[steps] - first
        z, h = velocities[steps - first], np.diff(self.times)[steps]
        slopes = highest = np.diff(velocities, axis=0) / np.diff(middle)[:, None]
        lower = z
        if r == 2:
            highest = np.diff(slopes, axis=0) / (0.5 * (middle[2:] - middle[:-2]))[:, None]
            lower = 0.5 * (slopes[j] + slopes[j + 1])
        x = np.minimum(h * self._rates(z), STIFF)
        drift, powers = self._q * (x / h)[:, None] * lower, (h ** (r + 1))[:, None]
        errors = powers * (self._mean * highest[j] - drift)
        variances = (powers * self._spread * highest[j]) ** 2
        dampings = np.where(z != 0, self._scheme.amplification(-x)[:, None], 1.0)
        for k, damping in enumerate(dampings):
            self._error = errors[k] = damping * self._error + errors[k]
            self._variance = variances[k] = damping**2 * self._variance + variances[k]
        sizes = self.norms(errors) + self.norms(np.sqrt(variances))
        self.error = max(self.error, float(sizes.max()))
        self.length += float(h @ self.norms(z))
        p = math.hypot(self._mean, self._spread)
        self.leading[steps] = p * self.norms(highest[j]) + self.norms(drift)
        self._done = stop

    def _rates(self, z: np.ndarray) -> np.ndarray:
        """-J along the velocities."""
        sizes = self.norms(z)
        if self._process.rate_independent:
            return np.where(sizes > 0, math.inf, 0.0)
        if self._process.B is None:
            return np.zeros(len(z))
        return squares(self._process.B, z / np.where(sizes > 0, sizes, 1.0)[:, None])

    # ---- what the steps of another grid would do ------------------------------------------------

    def local_errors(self, times: np.ndarray) -> np.ndarray:
        """Of each step of a grid."""
        leading = self.leading if self.leading.any() else np.ones_like(self.leading)
        sums = np.append(0.0, np.cumsum(leading * np.diff(self.times)))
        return np.diff(np.interp(times, self.times, sums)) * np.diff(times) ** self.order

    def steps(self, total: float) -> float:
        """How many there are about in a grid with this sum of local errors."""
        r = self.order
        density = float(self.leading ** (1 / (r + 1)) @ np.diff(self.times))
        return density * (density / total) ** (1 / r)


def _after(t: np.ndarray, r: int) -> np.ndarray:
    """t^(r - 1) after a switch at t = 0, and 0 before it."""
    return np.where(t > 0, np.abs(t) ** (r - 1), 0.0)


def _stops(scheme: Scheme, s: np.ndarray) -> np.ndarray:
    """The error of a unit step in which the load turns back at s, where A = 0."""
    start = -0.5 * s**2
    velocities: list[np.ndarray] = []
    for weights, c in zip(scheme.a, scheme.c, strict=True):
        u = start + sum(a * z for a, z in zip(weights, velocities, strict=False))
        velocities.append(np.maximum(-0.5 * (c - s) ** 2 - u, 0.0) / weights[-1])
    return start + sum(b * z for b, z in zip(scheme.b, velocities, strict=True))
