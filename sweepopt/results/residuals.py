"""The residual of a curve through the nodes of a run, step by step (MATH 4).

For the curve v and a selection w(t) in C(t) this gives int 2 G and int |r|^2 on every step,
r = A v' + B v - w and G = sigma(C(t), -v') + <v', w>. Where C(t) = center(t) + scale(t) S is data,
w(t) = center(t) + scale(t) s(t) with s a curve in S between projections, and both integrals are
bounds: G by the convexity of sigma, r as a polynomial plus the interpolation error of the
histories. A C(t) of which only its variation is known costs 2 |v'| times that more in G; for any
other C(t) both are sampled.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sweepopt.problem import (
    DERIVATIVE,
    GAUSS,
    TO_BERNSTEIN,
    WEIGHTS,
    Interpolated,
    Intervals,
    Motion,
    Norms,
    SweepingProcess,
    TimeFunction,
    increments,
    interpolate,
    motion,
    smooth_intervals,
)
from sweepopt.results.nodes import Nodes, cubic, force_along, slopes_of_curves
from sweepopt.sets import basis, products, to_bernstein
from sweepopt.velocity import VelocityOf

HALVES = np.array([0.0, 0.5, 1.0])
THIRDS = to_bernstein(HALVES)
CHUNK = 2_000_000  # numbers that intervals treated at once may hold: 16 MB


class Residuals(NamedTuple):
    """Integrals over each step, shape (n,).

    Attributes
    ----------
    gaps, squares : ndarray
        int 2 G and int |r|^2.
    largest, turning : ndarray
        sup |r| and int |r'|, where A = 0; else zero.
    slopes : ndarray, shape (n, 3, dim)
        Bernstein coefficients of v'.
    guaranteed : bool
        Whether the integrals are bounds and not sampled values.
    """

    gaps: np.ndarray
    squares: np.ndarray
    largest: np.ndarray
    turning: np.ndarray
    slopes: np.ndarray
    guaranteed: bool


def residuals(
    process: SweepingProcess,
    phi: VelocityOf,
    norms: Norms,
    near: Nodes,
    variation: Callable[[float], float] | None,
) -> Residuals:
    """The residuals of the curve through the nodes of `near`.

    Parameters
    ----------
    phi : callable (q, C) -> Velocity
        The velocity for M = A (B where A = 0); its answers are not trusted.
    variation : callable or None
        v with d_H(C(t), C(s)) <= v(t) - v(s) for s <= t.
    """
    moved = motion(process.C).translated()
    if moved is not None and variation is not None and not moved.center.bounded:
        moved = _with_variation(moved, variation)
    curves = slopes_of_curves(process, phi, near)
    if moved is not None and moved.scale.function is None:
        return _of_data(process, norms, near, curves, moved)
    if variation is not None and not norms.rate_independent:
        return _of_variation(process, norms, near, curves[-1], variation)
    return _sampled(process, phi, norms, near, curves[0 if norms.rate_independent else -1])


def _with_variation(moved: Motion, variation: Callable[[float], float]) -> Motion | None:
    """Translates of a bounded set are as far apart as their centers."""
    assert moved.shape is not None
    if not moved.scale.constant or not math.isfinite(moved.shape.magnitude()):
        return None
    center = moved.center
    value = center.function or (lambda t: center.at(np.array([t]))[0])
    return replace(moved, center=TimeFunction((), center.dim, value, variation))


# ---- C(t) is data -----------------------------------------------------------------------------


def _of_data(
    process: SweepingProcess, norms: Norms, near: Nodes, curves: list[np.ndarray], moved: Motion
) -> Residuals:
    """Bounds between breakpoints, many intervals at once; on each step the best of the curves."""
    n, dim = near.velocity.shape
    totals = np.zeros((len(curves), 4, n))
    whole = smooth_intervals(moved, near.t)
    count = max(CHUNK // (30 * dim), 1)
    bound = _BoundsOnIntervals(process, norms, near, moved)
    for start in range(0, len(whole.step), count):
        intervals = Intervals(*(part[start : start + count] for part in whole))
        center, scale = (
            interpolate(f, intervals.begin, intervals.end) for f in (moved.center, moved.scale)
        )
        for total, slopes in zip(totals, curves, strict=True):
            gaps, squares, largest, turning = bound(slopes, intervals, center, scale)
            np.add.at(total[0], intervals.step, gaps)
            np.add.at(total[1], intervals.step, squares)
            np.maximum.at(total[2], intervals.step, largest)
            np.add.at(total[3], intervals.step, turning)
    cost = totals[:, 0] + totals[:, 1]
    if norms.rate_independent:  # the bound is about sum turning + sqrt(sum gaps)
        least = float(totals[:, 0].min(axis=0).sum())
        cost = totals[:, 3] + totals[:, 0] / (math.sqrt(least) or 1.0)
    best, step = np.argmin(cost, axis=0), np.arange(n)
    guaranteed = moved.center.bounded and moved.scale.bounded
    gaps, squares, largest, turning = totals[best, :, step].T
    slopes = np.array(curves)[best, step]
    return Residuals(gaps, squares, largest, turning, slopes, guaranteed)


class _BoundsOnIntervals:
    """int 2 G, int |r|^2, sup |r| and int |r'| on intervals inside the steps of a run."""

    def __init__(self, process: SweepingProcess, norms: Norms, near: Nodes, moved: Motion) -> None:
        self._process, self._norms, self._near, self._moved = process, norms, near, moved
        assert moved.shape is not None
        self._S, self._units = moved.shape, moved.shape.weights(process.metric.diagonal)
        self._sizes = np.array([norms.dual(f) for _, f in moved.center.terms])
        if moved.center.function is not None:
            self._sizes = np.array([1 / math.sqrt(norms.beta)])  # its variation is a Euclidean one

    def __call__(
        self, slopes: np.ndarray, intervals: Intervals, center: Interpolated, scale: Interpolated
    ) -> np.ndarray:
        """The four of them for one curve, shape (4, intervals)."""
        norms = self._norms
        i, a, b = intervals
        h, length = self._near.t[i + 1] - self._near.t[i], b - a
        begin, share = (a - self._near.t[i]) / h, length / h
        theta = begin[:, None] + share[:, None] * GAUSS
        force = force_along(self._process, self._near, slopes, i, theta) - center.values
        s = self._points(force, basis(2, theta) @ slopes[i], scale, h)
        r = force - scale.values * (basis(s.shape[1] - 1, GAUSS) @ s)

        error, turning = center.error @ self._sizes, center.slope_error @ self._sizes
        most = (TO_BERNSTEIN @ scale.values).max(axis=1)
        if scale.error.any():
            each = [norms.dual(f * s).max(axis=1) for _, f in self._moved.scale.terms]
            error = error + (scale.error * np.array(each).T).sum(axis=1)
            turning = turning + (scale.slope_error * np.array(each).T).sum(axis=1)
            most = most + scale.error @ np.abs([f for _, f in self._moved.scale.terms])
        directions = slopes[i]
        inside = share < 1
        ends = basis(2, begin[:, None] + share[:, None] * HALVES) @ directions
        directions = np.where(inside[:, None, None], THIRDS @ ends, directions)
        gaps, distance = self._gaps(-directions * most[:, None], s, most.max(axis=1))
        error = error + distance / math.sqrt(norms.beta)
        # Minkowski: the interpolation error adds up in the norm
        squares = length * (np.sqrt(norms.dual(r) ** 2 @ WEIGHTS) + error) ** 2
        largest, slope = np.zeros((2, len(i)))
        if norms.rate_independent:
            largest = norms.dual(TO_BERNSTEIN @ r).max(axis=1) + error
            # at the ends the curve in S jumps by the interpolation error
            slope = np.sqrt(norms.dual(DERIVATIVE @ r) ** 2 @ WEIGHTS) + turning + 2 * error
        return np.array([2 * length * gaps, squares, largest, slope])

    def _points(
        self, force: np.ndarray, velocity: np.ndarray, scale: Interpolated, h: np.ndarray
    ) -> np.ndarray:
        """Bernstein coefficients of a curve in S, shape (m, k, dim).

        Those of (A v' + B v - center - tau v') / scale, projected on S: S is convex, so the curve
        stays in it. Any tau > 0 will do: where v rests and the force is in C(t) the residual is
        zero, and where v moves s is pushed to where it is normal.
        """

        def over_scale(x: np.ndarray, size: np.ndarray) -> np.ndarray:
            size = np.broadcast_to(size, x.shape)
            return np.divide(x, size, out=np.zeros_like(x), where=size > 0)

        rate_independent = self._norms.rate_independent
        tau = np.outer(h if rate_independent else np.ones_like(h), self._units)[:, None]
        aim = TO_BERNSTEIN @ over_scale(force - tau * velocity, scale.values)
        if rate_independent:
            # at the ends without tau v', which jumps there: r must be continuous
            ends = TO_BERNSTEIN[[0, -1]]
            aim[:, [0, -1]] = over_scale(ends @ force, ends @ scale.values)
        if not self._moved.scale.constant:  # a moving scale times a line has degree 5
            aim = aim[:, [0, -1]]
        points = [self._S.project(w) for w in aim.reshape(-1, aim.shape[-1])]
        return np.array(points).reshape(aim.shape)

    def _gaps(self, p: np.ndarray, s: np.ndarray, most: np.ndarray) -> np.ndarray:
        """The mean of G on each interval, and how far the curve in C(t) moves for it, shape (2, m).

        G <= sup scale * (sigma(S, -v') + <v', s>), a scale of several entries inside the
        parentheses: it is in p.
        """
        S = self._S
        if S.selection is not None:
            few, S, shift = S.selection
            p, s = p[..., few], s[..., few] - (0.0 if shift is None else shift[few])
        # where A = 0 the curve must be continuous: it is not moved
        fixed = self._norms.rate_independent
        ratios = np.full(len(p), math.inf) if fixed else most**2 / self._norms.beta
        gaps, distance = np.array(list(map(S.gap_along_curve, p, s, ratios.tolist()))).T
        return np.array([gaps, most * distance])


# ---- C(t) is a function of time ---------------------------------------------------------------


def _of_variation(
    process: SweepingProcess,
    norms: Norms,
    near: Nodes,
    slopes: np.ndarray,
    variation: Callable[[float], float],
) -> Residuals:
    """w(t) is the point of C(t) nearest to the chord of two projections."""
    h, n = np.diff(near.t), len(near.t) - 1
    sets = [process.C.at(t) for t in near.t.tolist()]
    ends = np.broadcast_to(np.array([0.0, 1.0]), (n, 2))
    force = force_along(process, near, slopes, np.arange(n), ends)
    nodal = np.append(force[:, 0], force[-1:, 1], axis=0)
    w = np.array([C.project(f) for C, f in zip(sets, nodal, strict=True)])
    v = increments(variation, near.t)
    gaps = np.zeros(n)
    for i in range(n):
        each = [[sets[k].gap(-x, w[k]) for k in (i, i + 1)] for x in slopes[i]]
        # moving by v changes sigma(C, x) and <x, w> by |x| v at most
        speed = np.linalg.norm(slopes[i], axis=1).mean()
        gaps[i] = np.sum(products(2, 1) * np.array(each)) + 2 * speed * v[i]
    theta = np.broadcast_to(GAUSS, (n, len(GAUSS)))
    chord = (1 - theta)[..., None] * w[:-1, None] + theta[..., None] * w[1:, None]
    r = norms.dual(force_along(process, near, slopes, np.arange(n), theta) - chord)
    squares = h * (np.sqrt(r**2 @ WEIGHTS) + v / math.sqrt(norms.beta)) ** 2
    return Residuals(2 * h * gaps, squares, np.zeros(n), np.zeros(n), slopes, True)


def _sampled(
    process: SweepingProcess, phi: VelocityOf, norms: Norms, near: Nodes, slopes: np.ndarray
) -> Residuals:
    """One program at each Gauss point: the residual is A (Phi(t, v) - v')."""
    h, n = np.diff(near.t), len(near.t) - 1
    gaps, squares, largest, turning = np.zeros((4, n))
    curves = cubic(near.u[:-1], near.u[1:], h[:, None, None] * slopes)
    for i in range(n):
        velocity, v = basis(2, GAUSS) @ slopes[i], basis(3, GAUSS) @ curves[i]
        q = [process.times_B(x) for x in v]
        sets = [process.C.at(t) for t in (near.t[i] + h[i] * GAUSS).tolist()]
        z = np.array([phi(*one).z for one in zip(q, sets, strict=True)])
        if not norms.rate_independent:
            squares[i] = h[i] * (norms.A(z - velocity) ** 2 @ WEIGHTS)
            continue
        # phi projects B v on C(t): w = B v + B z, so that r = -B z
        each = zip(sets, velocity, q, z, strict=True)
        G = [C.gap(-x, f + process.times_B(y)) for C, x, f, y in each]
        gaps[i] = 2 * h[i] * float(np.array(G) @ WEIGHTS)
        largest[i] = norms.A(z).max()
        turning[i] = norms.A(np.diff(z, axis=0)).sum()
    return Residuals(gaps, squares, largest, turning, slopes, False)
