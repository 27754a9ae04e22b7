"""The residual of a curve through the nodes of a run, step by step (MATH 4).

For the curve v and a selection w(t) in C(t) this gives int 2 G and int |r|^2 on every step,
r = A v' + B v - w and G = sigma(C(t), -v') + <v', w>. Where C(t) = center(t) + scale(t) S is data,
w(t) = center(t) + scale(t) s(t) with s a curve in S between projections, and both integrals are
bounds: G by the convexity of sigma, r as a polynomial plus the interpolation error of the
histories. Of any other C(t) the member in the middle of a step is S if its variation v is known, as
w(t) is then no further from s(t) than v grows on the step, which costs 2 |v'| times that in G;
otherwise both are sampled.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

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
from sweepopt.results.nodes import Nodes, force_along, slopes_of_curves
from sweepopt.sets import ConvexSet, basis, to_bernstein
from sweepopt.velocity import VelocityOf

HALVES = np.array([0.0, 0.5, 1.0])
HALVES_TO_BERNSTEIN = to_bernstein(HALVES)
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


class _Model(NamedTuple):
    """C(t) on intervals: within `distance` of center(t) + scale(t) shape, one of each for each."""

    motion: Motion
    intervals: Intervals
    shapes: list[ConvexSet]
    distance: np.ndarray


def residuals(
    process: SweepingProcess,
    phi: VelocityOf,
    norms: Norms,
    nodes: Nodes,
    variation: Callable[[float], float] | None,
) -> Residuals:
    """The residuals of the better of two curves through the nodes, step by step.

    Parameters
    ----------
    phi : callable (q, C) -> Velocity
        The velocity for M = A (B where A = 0); its answers are not trusted.
    variation : callable or None
        v with d_H(C(t), C(s)) <= v(t) - v(s) for s <= t.
    """
    curves = slopes_of_curves(process, phi, nodes)
    model = _model(process, norms, nodes, variation)
    if model is None:
        totals, guaranteed = np.array([_sampled(process, norms, nodes, v) for v in curves]), False
    else:
        totals = _bounds(process, norms, nodes, curves, model)
        guaranteed = model.motion.center.bounded and model.motion.scale.bounded
    cost = totals[:, 0] + totals[:, 1]
    if norms.rate_independent:  # the bound is about sum turning + sqrt(sum gaps)
        least = float(totals[:, 0].min(axis=0).sum())
        cost = totals[:, 3] + totals[:, 0] / (math.sqrt(least) or 1.0)
    best, step = np.argmin(cost, axis=0), np.arange(len(nodes.velocity))
    gaps, squares, largest, turning = totals[best, :, step].T
    slopes = np.array(curves)[best, step]
    return Residuals(gaps, squares, largest, turning, slopes, guaranteed)


def _model(
    process: SweepingProcess, norms: Norms, nodes: Nodes, variation: Callable[[float], float] | None
) -> _Model | None:
    """What is known of C(t) on intervals that cover the steps; None if nothing is."""
    moving = motion(process.C).translated()
    if moving is not None and variation is not None and not moving.center.bounded:
        moving = _with_variation(moving, variation)
    if moving is not None and moving.shape is not None and moving.scale.function is None:
        intervals = smooth_intervals(moving, nodes.t)
        count = len(intervals.step)
        return _Model(moving, intervals, [moving.shape] * count, np.zeros(count))
    if variation is None or norms.rate_independent:  # a curve that jumps has no int |r'|
        return None
    steps = Intervals(np.arange(len(nodes.velocity)), nodes.t[:-1], nodes.t[1:])
    members = [process.C.at(t) for t in (0.5 * (steps.begin + steps.end)).tolist()]
    still = Motion(None, TimeFunction((), process.dim))
    return _Model(still, steps, members, increments(variation, nodes.t))


def _with_variation(moving: Motion, variation: Callable[[float], float]) -> Motion | None:
    """Translates of a bounded set are as far apart as their centers."""
    assert moving.shape is not None
    if not moving.scale.constant or not math.isfinite(moving.shape.magnitude()):
        return None
    center = moving.center
    value = center.function or (lambda t: center.at(np.array([t]))[0])

    def between(a: float, b: float) -> float:
        return float(increments(variation, np.array([a, b]))[0])

    return replace(moving, center=TimeFunction((), center.dim, value, between))


def _bounds(
    process: SweepingProcess, norms: Norms, nodes: Nodes, curves: list[np.ndarray], model: _Model
) -> np.ndarray:
    """int 2 G, int |r|^2, sup |r| and int |r'| of each curve on each step: bounds."""
    n, dim = nodes.velocity.shape
    totals = np.zeros((len(curves), 4, n))
    count = max(CHUNK // (30 * dim), 1)
    for start in range(0, len(model.shapes), count):
        part = slice(start, start + count)
        intervals = Intervals(*(x[part] for x in model.intervals))
        some = model._replace(
            intervals=intervals, shapes=model.shapes[part], distance=model.distance[part]
        )
        center, scale = (
            interpolate(f, intervals.begin, intervals.end)
            for f in (model.motion.center, model.motion.scale)
        )
        for total, slopes in zip(totals, curves, strict=True):
            bounds = _on_intervals(process, norms, nodes, slopes, some, center, scale)
            for k, add in enumerate((np.add, np.add, np.maximum, np.add)):
                add.at(total[k], intervals.step, bounds[k])
    return totals


def _on_intervals(
    process: SweepingProcess,
    norms: Norms,
    nodes: Nodes,
    slopes: np.ndarray,
    model: _Model,
    center: Interpolated,
    scale: Interpolated,
) -> np.ndarray:
    """The four bounds of one curve on each interval, shape (4, intervals)."""
    moving, (i, a, b) = model.motion, model.intervals
    h, length, root = nodes.t[i + 1] - nodes.t[i], b - a, math.sqrt(norms.beta)
    begin, share = ((a - nodes.t[i]) / h)[:, None], (length / h)[:, None]
    theta = begin + share * GAUSS
    force = force_along(process, nodes, slopes, i, theta) - center.values
    units = model.shapes[0].weights(process.metric.diagonal)
    if norms.rate_independent:
        units = h[:, None, None] * units
    s = _curve_in_shape(norms, model, force, units * (basis(2, theta) @ slopes[i]), scale.values)
    r = force - scale.values * (basis(s.shape[1] - 1, GAUSS) @ s)

    sizes = np.array([float(norms.dual(f)) for _, f in moving.center.terms])
    if moving.center.function is not None:
        sizes = np.array([1 / root])  # its variation is a Euclidean one
    error, turning = center.error @ sizes, center.slope_error @ sizes
    most = (TO_BERNSTEIN @ scale.values).max(axis=1)
    if scale.error.any():
        each = np.array([norms.dual(f * s).max(axis=1) for _, f in moving.scale.terms]).T
        error = error + (scale.error * each).sum(axis=1)
        turning = turning + (scale.slope_error * each).sum(axis=1)
        most = most + scale.error @ np.abs([f for _, f in moving.scale.terms])

    # G <= sup scale * (sigma(S, -v') + <v', s>), a scale of several entries inside the parentheses
    directions = HALVES_TO_BERNSTEIN @ (basis(2, begin + share * HALVES) @ slopes[i])
    largest = most.max(axis=1)
    # where A = 0 the curve must be continuous: it is not moved
    ratios = np.full(len(i), math.inf) if norms.rate_independent else largest**2 / norms.beta
    along = zip(model.shapes, -directions * most[:, None], s, ratios.tolist(), strict=True)
    gaps, distance = np.array([_gap(*one) for one in along]).T
    speed = np.linalg.norm(directions, axis=2).mean(axis=1)
    gaps = gaps + 2 * speed * model.distance
    error = error + (largest * distance + model.distance) / root

    # Minkowski: the interpolation error adds up in the norm
    squares = length * (np.sqrt(norms.dual(r) ** 2 @ WEIGHTS) + error) ** 2
    highest, slope = np.zeros((2, len(i)))
    if norms.rate_independent:
        highest = norms.dual(TO_BERNSTEIN @ r).max(axis=1) + error
        # at the ends the curve in S jumps by the interpolation error
        slope = np.sqrt(norms.dual(DERIVATIVE @ r) ** 2 @ WEIGHTS) + turning + 2 * error
    return np.array([2 * length * gaps, squares, highest, slope])


def _curve_in_shape(
    norms: Norms, model: _Model, force: np.ndarray, push: np.ndarray, scale: np.ndarray
) -> np.ndarray:
    """Bernstein coefficients of a curve in S, shape (m, k, dim).

    Those of (A v' + B v - center - tau v') / scale, projected on S: S is convex, so the curve stays
    in it. Any tau > 0 will do: where v rests and the force is in C(t) the residual is zero, and
    where v moves s is pushed to where it is normal.
    """

    def over_scale(x: np.ndarray, size: np.ndarray) -> np.ndarray:
        size = np.broadcast_to(size, x.shape)
        return np.divide(x, size, out=np.zeros_like(x), where=size > 0)

    aim = TO_BERNSTEIN @ over_scale(force - push, scale)
    if norms.rate_independent:
        # at the ends without tau v', which jumps there: r must be continuous
        ends = TO_BERNSTEIN[[0, -1]]
        aim[:, [0, -1]] = over_scale(ends @ force, ends @ scale)
    if not model.motion.scale.constant:  # a moving scale times a line has degree 5
        aim = aim[:, [0, -1]]
    return np.array([[S.project(w) for w in x] for S, x in zip(model.shapes, aim, strict=True)])


def _gap(S: ConvexSet, p: np.ndarray, s: np.ndarray, ratio: float) -> Any:
    """The mean of G along a curve in S, and how far the curve is moved for it."""
    if S.selection is not None:
        few, S, shift = S.selection
        p, s = p[..., few], s[..., few] - (0.0 if shift is None else shift[few])
    return S.gap_along_curve(p, s, ratio)


def _sampled(
    process: SweepingProcess, norms: Norms, nodes: Nodes, slopes: np.ndarray
) -> np.ndarray:
    """The four integrals on each step by Gauss's rule, shape (4, n); no bounds."""
    h, n = np.diff(nodes.t), len(nodes.velocity)
    theta = np.broadcast_to(GAUSS, (n, len(GAUSS)))
    velocity = basis(2, theta) @ slopes
    force = force_along(process, nodes, slopes, np.arange(n), theta)
    push = velocity * (0.0 if norms.rate_independent else process.metric.diagonal.mean())
    gaps, r = np.zeros(theta.shape), np.zeros(force.shape)
    for i, j in np.ndindex(*theta.shape):
        C = process.C.at(float(nodes.t[i] + h[i] * theta[i, j]))
        w = C.project(force[i, j] - push[i, j])
        gaps[i, j], r[i, j] = C.gap(-velocity[i, j], w), force[i, j] - w
    squares = norms.dual(r) ** 2 @ WEIGHTS
    highest, turning = np.zeros((2, n))
    if norms.rate_independent:
        highest, turning = norms.dual(r).max(axis=1), norms.dual(np.diff(r, axis=1)).sum(axis=1)
    return np.array([2 * h * (gaps @ WEIGHTS), h * squares, highest, turning])
