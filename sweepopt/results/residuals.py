"""The residual of a curve through the nodes of a run, step by step (MATH 4).

For the curve v and a selection w(t) in C(t) this gives int 2 G and int |r|^2 on every step,
r = A v' + B v - w and G = sigma(C(t), -v') + <v', w>. Where C(t) = center(t) + scale(t) S is data,
w(t) = center(t) + scale(t) s(t) with s a curve in S between projections, and both integrals are
bounds: G by the convexity of sigma, r as a polynomial plus the interpolation error of the
histories. Where C(t) = { w : G w <= h(t) } is data, w is a curve whose Bernstein coefficients are
projections on the sets of h's Bernstein coefficients, and weak duality bounds sigma. For any other
C(t) whose variation is known, S is the set at the middle of a part of the step: the distance d of
w(t) to s(t) is at most the variation on half of the part, and adds 2 |v'| d to the bound of G, so
that the bound falls as sqrt(d). Otherwise both integrals are sampled, and are no bounds.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from sweepopt.errors import EmptySetError
from sweepopt.problem import Motion, Norms, SweepingProcess, TimeFunction, motion
from sweepopt.results.interpolation import (
    GAUSS,
    TO_BERNSTEIN,
    WEIGHTS,
    Interpolated,
    Intervals,
    Nodes,
    force_along,
    increments,
    interpolate,
    smooth_intervals,
)
from sweepopt.sets import ROUNDING, Aligned, ConvexSet, Polyhedron, basis, to_bernstein

HALVES = np.array([0.0, 0.5, 1.0])
HALVES_TO_BERNSTEIN = to_bernstein(HALVES)
THIRDS = np.arange(4) / 3

_BUBBLE = GAUSS * (1 - GAUSS)
LOBATTO = np.stack([1 - GAUSS, GAUSS, _BUBBLE, _BUBBLE * (1 - 2 * GAUSS)], axis=1)
LOBATTO *= np.sqrt([3, 3, 30, 210])
"""Four functions of norm 1 in L^2(0, 1), whose sums with vectors r_k are the cubics r. r_0 and r_1,
its values at the ends, are next to 0 where v satisfies the inclusion at nodes."""
TO_LOBATTO = np.linalg.inv(LOBATTO)
ROOTS = np.sqrt(WEIGHTS)[:, None]
MEAN_SQUARE, MEAN = ROOTS * LOBATTO, WEIGHTS[None] @ LOBATTO
SLOPES = ROOTS * (3 * basis(2, GAUSS) @ np.diff(TO_BERNSTEIN @ LOBATTO, axis=0))
"""Weights with which `Products.of_sum` is |r|, the mean of r and |r'| in L^2(0, 1)."""

PARTS = 3
"""Parts of a step, on each of which w is a chord of a curved set. With 2 (4) parts bounds were 0.7
(1.3) times as close and took 0.8 (1.3) times as long."""
SETS = 8
"""Sets of a function t -> C on each step: four times as many give half the bound. With 8 a bound
takes 6 times as long as the run of a box."""
VARIES = 8
"""int |r'| is computed on steps with a larger mu Lam only. On others it does not make the bound of
|e|_B smaller if r vanishes somewhere on the step: then int |r'| >= sup |r|, and with y >= sqrt(S)
the step adds at least sqrt(8 / (mu Lam)) times as much to the bound as with int |r|^2 / 2."""
SAME = 1e-12  # relative to the largest force: points nearer than that are projected as one
CHUNK = 2_000_000  # numbers that intervals treated at once may hold: 16 MB


class Residuals(NamedTuple):
    """Integrals over each step, shape (c, n), of c curves.

    Attributes
    ----------
    gaps, squares : ndarray
        int 2 G and int |r|^2; squares are infinite where A is singular.
    turning : ndarray
        int |r'|, in the dual norm of B; infinite where mu Lam is at most VARIES.
    size : ndarray
        sup |r|, in the same way.
    begin, end : ndarray, shape (c, n, dim)
        r at the ends of each step.
    error : ndarray
        A bound of the error of begin and end, in the dual norm of B.
    """

    gaps: np.ndarray
    squares: np.ndarray
    turning: np.ndarray
    size: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    error: np.ndarray


class _Model(NamedTuple):
    """C(t) on intervals, where its distance to center(t) + scale(t) shape is at most `distance`.

    There is one distance for each interval, and one shape for each or for all. Without a shape C(t)
    is known at sampled times only. `members` are points of the shape at all nodes but the first, if
    they are known: then s(t) is straight between them, and the first one until there.
    """

    motion: Motion
    intervals: Intervals
    shapes: list[ConvexSet]
    distance: np.ndarray
    members: np.ndarray | None = None

    def each(self, function: Callable[..., np.ndarray], *arrays: np.ndarray) -> np.ndarray:
        """function(shape, rows of the arrays) of every shape; of one shape all rows at once."""
        if len(self.shapes) == 1:
            return function(self.shapes[0], *arrays)
        rows = (function(S, *(x[k : k + 1] for x in arrays)) for k, S in enumerate(self.shapes))
        return np.concatenate(list(rows))


def residuals(
    process: SweepingProcess,
    norms: Norms,
    nodes: Nodes,
    curves: np.ndarray,
    variation: Callable[[float], float] | None,
    members: np.ndarray | None = None,
) -> tuple[Residuals, str]:
    """The residuals of curves through the nodes, and why they are no bounds; "" if they are.

    Parameters
    ----------
    curves : ndarray, shape (c, n, 3, dim)
        Bernstein coefficients of v' of each curve.
    variation : callable or None
        v with d_H(C(t), C(s)) <= v(t) - v(s) for s <= t.
    members : ndarray, shape (n, dim), optional
        Points of C(t), a Moving set, at all nodes but the first.
    """
    data = motion(process.C)
    reason = _unknown(data)
    if members is not None:
        scale = data.scale.at(nodes.t[1:])
        members = (members - data.center.at(nodes.t[1:])) / scale if scale.all() else None
    model = _model(process, data, reason, norms, nodes, variation, members)
    try:
        moving = model.motion
        known = bool(model.shapes) and model.shapes[0].certifiable
        known = known and moving.center.bounded and moving.scale.bounded
        return _bounds(process, norms, nodes, curves, model), "" if known else reason
    # coefficients of a polynomial may be no offsets of a set that is nearly a point
    except EmptySetError as error:
        reason = f"C(t) is nearly empty at times ({error})"
        return _bounds(process, norms, nodes, curves, _on_steps(process, nodes)), reason


def _unknown(data: Motion) -> str:
    """What is not known of C(t) between the times of a grid; "" if nothing is missing."""
    if data.shape is None:
        return "C(t) is a function of time: write it as a Moving set, or give variation="
    if not data.shape.certifiable:
        return f"nothing is proved of {type(data.shape).__name__}"
    parts = {data.name: data.offsets or data.center, "scale": data.scale}
    for name, f in parts.items():
        if not f.bounded:
            return (
                f"{name}(t) is a function, known at some times only: give it as so.Separable or "
                "so.Table, or give variation="
            )
    if data.offsets is not None and not data.shape.exact:
        return f"the {data.offsets.dim} rows of G that move are too many for exact projections"
    return ""


def _model(
    process: SweepingProcess,
    data: Motion,
    reason: str,
    norms: Norms,
    nodes: Nodes,
    variation: Callable[[float], float] | None,
    members: np.ndarray | None,
) -> _Model:
    """What is known of C(t) on intervals that cover the steps."""
    moving: Motion | None = None if reason and data.offsets else data
    if variation is not None and not data.center.bounded:
        moving = _with_variation(data, variation)
    if moving is not None and moving.shape is not None and moving.scale.function is None:
        parts = 1 if moving.shape.sharp_gaps or members is not None else PARTS
        intervals = smooth_intervals(moving, nodes.t, parts)
        return _Model(moving, intervals, [moving.shape], np.zeros(len(intervals.step)), members)
    model = _on_steps(process, nodes)
    if variation is None or norms.weak:  # members in the middle have no int |r'|
        return model
    intervals = smooth_intervals(model.motion, nodes.t, SETS)
    middles = 0.5 * (intervals.begin + intervals.end)
    shapes = [process.C.at(t) for t in middles.tolist()]
    halves = np.sort(np.concatenate([nodes.t[:1], middles, intervals.end]))
    distance = increments(variation, halves).reshape(-1, 2).max(axis=1)
    return model._replace(intervals=intervals, shapes=shapes, distance=distance)


def _on_steps(process: SweepingProcess, nodes: Nodes) -> _Model:
    """That of a C(t) of which nothing is known between samples."""
    n = len(nodes.velocity)
    steps = Intervals(np.arange(n), nodes.t[:-1], nodes.t[1:])
    return _Model(Motion(None, TimeFunction((), process.dim)), steps, [], np.zeros(n))


def _with_variation(moving: Motion, variation: Callable[[float], float]) -> Motion | None:
    """Translates of a bounded set are as far apart as their centers."""
    shape, scale = moving.shape, moving.scale
    if shape is None or not scale.constant or not math.isfinite(shape.magnitude()):
        return None
    center = moving.center
    value = center.function or (lambda t: center.at(np.array([t]))[0])

    def between(a: float, b: float) -> float:
        return float(increments(variation, np.array([a, b]))[0])

    return replace(moving, center=TimeFunction((), center.dim, value, between))


def _bounds(
    process: SweepingProcess, norms: Norms, nodes: Nodes, curves: np.ndarray, model: _Model
) -> Residuals:
    """Those of all curves, from intervals treated at once."""
    count, moving, step = len(curves), model.motion, model.intervals.step
    width = process.dim if moving.offsets is None else max(process.dim, moving.offsets.dim)
    many = max(CHUNK // (30 * count * width), 1)
    terms = _sizes_of_terms(norms, moving.center)
    parts = []
    for start in range(0, len(step), many):
        part = slice(start, start + many)
        i, begin, end = (x[part] for x in model.intervals)
        # the intervals of the first curve, then those of the second
        functions: list[Any] = [
            f and Interpolated(*(np.concatenate([x] * count) for x in interpolate(f, begin, end)))
            for f in (moving.center, moving.scale, moving.offsets)
        ]
        some = _Model(
            moving,
            Intervals(*(np.tile(x, count) for x in (i, begin, end))),
            model.shapes if len(model.shapes) == 1 else model.shapes[part] * count,
            np.tile(model.distance[part], count),
            model.members,
        )
        slopes = np.concatenate(curves[:, i])
        each = _on_intervals(process, norms, nodes, slopes, some, terms, *functions)
        parts.append([x.reshape(count, len(i), *x.shape[1:]) for x in each])
    of_all = (np.concatenate(some, axis=1) for some in zip(*parts, strict=True))
    gaps, squares, turning, size, begin, end, error = of_all
    first = np.searchsorted(step, np.arange(len(nodes.velocity)))
    cuts = np.setdiff1d(np.arange(1, len(step)), first)  # inside of steps, where r may jump
    jumps = norms.dual_B(begin[:, cuts] - end[:, cuts - 1])
    turning[:, cuts] += jumps + error[:, cuts] + error[:, cuts - 1]
    gaps, squares, turning = (np.add.reduceat(x, first, axis=1) for x in (gaps, squares, turning))
    last = np.append(first[1:], len(step)) - 1
    size, error = (np.maximum.reduceat(x, first, axis=1) for x in (size, error))
    return Residuals(gaps, squares, turning, size, begin[:, first], end[:, last], error)


def _on_intervals(
    process: SweepingProcess,
    norms: Norms,
    nodes: Nodes,
    slopes: np.ndarray,
    model: _Model,
    terms: list[np.ndarray],
    center: Interpolated,
    scale: Interpolated,
    offsets: Interpolated | None,
) -> Residuals:
    """Those of curves on intervals, each with its slopes of shape (3, dim)."""
    i, a, b = model.intervals
    h, length = nodes.t[i + 1] - nodes.t[i], b - a
    stiff = (h * norms.Lam > VARIES) | norms.weak
    begin, share = ((a - nodes.t[i]) / h)[:, None], (length / h)[:, None]
    theta = begin + share * GAUSS
    force = force_along(process, nodes, slopes, i, theta) - center.values
    velocity = basis(2, theta) @ slopes
    aim = force - norms.coercivity * velocity
    directions = -HALVES_TO_BERNSTEIN @ (basis(2, begin + share * HALVES) @ slopes)
    moved = error = error_B = turning = np.zeros(len(a))
    if not model.shapes:
        w, gaps = _sampled(process, a[:, None] + length[:, None] * GAUSS, aim, -velocity)
    elif offsets is None:
        s = None
        if model.members is not None:
            first, last = model.members[np.maximum(i - 1, 0), None], model.members[i, None]
            s = first + (begin + share * THIRDS)[:, :, None] * (last - first)
        # a curve that is moved has no bound of int |r'|
        s, w, gaps, moved = _within_shape(norms, model, s, scale, aim, directions, ~stiff)
        error, error_B, turning = _interpolation_errors(
            norms, model.motion, terms, s, center, scale
        )
        error = error + moved / math.sqrt(norms.beta)
    else:
        w, gaps = _within_rows(model, aim, directions, offsets)
    r = TO_LOBATTO @ (force - w)
    squares, varies, size = np.full((3, len(a)), np.inf)
    if not norms.weak:  # Minkowski: the interpolation error adds up in the norm
        of_r = norms.dual_products(r, np.sqrt(2 * gaps))
        squares = length * (of_r.of_sum(MEAN_SQUARE) + error) ** 2
    of_r = norms.dual_products_B(r[stiff], np.sqrt(2 * length * gaps)[stiff])
    varies[stiff] = of_r.of_sum(SLOPES)
    # |r - its mean|^2 <= int |r'|^2 / 3
    size[stiff] = of_r.of_sum(MEAN) + varies[stiff] / math.sqrt(3)
    size += error_B
    varies[stiff] += turning[stiff]
    varies[moved > 0] = np.inf
    first, last = math.sqrt(3) * r[:, 0], math.sqrt(3) * r[:, 1]
    return Residuals(2 * length * gaps, squares, varies, size, first, last, error_B)


def _within_shape(
    norms: Norms,
    model: _Model,
    s: np.ndarray | None,
    scale: Interpolated,
    aim: np.ndarray,
    directions: np.ndarray,
    may_move: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A curve s in S, scale s at GAUSS, the mean of a bound of its G, how far it is moved for that.

    s = sum_k b_k size_k s_k / sum_k b_k size_k, size_k > 0 the coefficients of the scale, so that
    scale s is a cubic; where they may be 0 s is constant. G is at most the largest scale times
    sigma(S, -v') + <v', sum_k b_k s_k>.
    """
    sizes = TO_BERNSTEIN @ scale.values
    error = scale.error @ np.abs([f for _, f in model.motion.scale.terms])
    if s is None:
        s = _curve_in_shape(model, TO_BERNSTEIN @ aim, sizes)
    least, most = sizes.min(axis=1), sizes.max(axis=1)
    vanishing = (least <= error).any(axis=1)
    s[vanishing] = s[vanishing].mean(axis=1, keepdims=True)
    least[vanishing] = most[vanishing]
    most += np.divide(most * error, least, out=error, where=least > error)
    largest = most.max(axis=1)
    ratios = np.where(may_move, largest**2 / norms.beta, np.inf)
    gaps, distance = model.each(_gaps, directions * most[:, None], s, ratios).T
    speed = np.linalg.norm(directions, axis=2).mean(axis=1)
    gaps, moved = gaps + 2 * speed * model.distance, largest * distance + model.distance
    return s, basis(3, GAUSS) @ (sizes * s), gaps, moved


def _within_rows(
    model: _Model, aim: np.ndarray, directions: np.ndarray, h: Interpolated
) -> tuple[np.ndarray, np.ndarray]:
    """A curve w in C(t) = { w : G w <= h(t) } at GAUSS, and the mean of a bound of its G.

    Where each Bernstein coefficient of w satisfies the rows for that of h's polynomial less its
    error, w is in C(t). By weak duality sigma(C(t), -v') <= <h(t), y> for y >= 0, G^T y = -v'.
    """
    S, f = model.shapes[0], model.motion.offsets
    if isinstance(S, Aligned):  # w = 0 beside its unknowns
        w, few = np.zeros_like(aim), S.unknowns
        model = model._replace(shapes=list(S.parts))
        w[..., few], gaps = _within_rows(model, aim[..., few], directions[..., few], h)
        return w, gaps
    assert isinstance(S, Polyhedron)
    assert f is not None
    error = h.error @ np.abs([shape for _, shape in f.terms] or np.ones((1, f.dim)))
    limits = TO_BERNSTEIN @ h.values - error[:, None]
    rows = S.project_rows((TO_BERNSTEIN @ aim).reshape(-1, S.dim), limits.reshape(-1, f.dim))
    w = rows.reshape(aim.shape)
    slack = np.maximum(
        limits - (S.G @ w.reshape(-1, S.dim).T).T.reshape(limits.shape), 0.0
    ) + ROUNDING * np.abs(limits)
    of_each = np.repeat(slack.mean(axis=1), directions.shape[1], axis=0)
    y = S.multiplier_rows(directions.reshape(-1, S.dim), of_each)
    y = basis(2, GAUSS) @ y.reshape(*directions.shape[:2], f.dim)
    gaps = (((basis(3, GAUSS) @ slack) + 2 * error[:, None]) * y).sum(axis=2) @ WEIGHTS
    return basis(3, GAUSS) @ w, np.where(np.isnan(gaps), np.inf, gaps)


def _sizes_of_terms(norms: Norms, center: TimeFunction) -> list[np.ndarray]:
    """The vectors of a center(t) in both dual norms; what a function varies is Euclidean."""
    roots = np.sqrt([norms.beta, norms.beta_B])
    if not center.terms:
        return [np.array([1 / root if root else math.inf]) for root in roots]
    vectors = np.array([f for _, f in center.terms])
    return [norms.dual(vectors), norms.dual_B(vectors)]


def _interpolation_errors(
    norms: Norms,
    moving: Motion,
    terms: list[np.ndarray],
    s: np.ndarray,
    center: Interpolated,
    scale: Interpolated,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What interpolated histories add to |r|, in both dual norms, and to int |r'| in that of B."""
    both = []
    for norm, sizes in zip((norms.dual, norms.dual_B), terms, strict=True):
        error, turning = (
            np.where(e > 0, e * sizes, 0.0).sum(axis=1) for e in (center.error, center.slope_error)
        )
        if scale.error.any():
            each = np.array([norm(f * s).max(axis=1) for _, f in moving.scale.terms]).T
            error = error + (scale.error * each).sum(axis=1)
            # var(s) <= sum_k |s_(k+1) - s_k| <= 6 max |s_k|
            turning = turning + ((scale.slope_error + 6 * scale.error) * each).sum(axis=1)
        both.append((error, turning))
    (error, _), (error_B, turning) = both
    return error, error_B, turning


def _curve_in_shape(model: _Model, force: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Bernstein coefficients of a curve in S, shape (m, 4, dim).

    Those of the force / scale, projected on S: S is convex, so the curve stays in it.
    """
    size = np.broadcast_to(sizes, force.shape)
    aim = np.divide(force, size, out=np.zeros_like(force), where=size > 0)
    S, ends = model.shapes[0], aim[:, [0, -1]]
    if (S.exact and S.sharp_gaps) or len(model.shapes) > 1:
        return model.each(_projections, aim)
    # projections one by one take most of the time, and chords lose little; where the force is in S
    # the curve is the force itself
    line = _projections(S, ends)
    inside = (np.abs(line - ends) <= SAME * np.abs(ends).max()).all(axis=(1, 2))
    s: np.ndarray = line[:, :1] + THIRDS[:, None] * (line[:, 1:] - line[:, :1])
    if inside.any():
        s[inside, 1:-1] = _projections(S, aim[inside, 1:-1])
    return s


def _projections(S: ConvexSet, curves: np.ndarray) -> np.ndarray:
    """Points of S next to those of curves."""
    return S.project_rows(curves.reshape(-1, S.dim)).reshape(curves.shape)


def _gaps(S: ConvexSet, p: np.ndarray, s: np.ndarray, ratios: np.ndarray) -> np.ndarray:
    """The mean of G along each curve in S, and how far it is moved for it, shape (m, 2)."""
    if S.selection is not None:
        few, S, shift = S.selection
        p, s = p[..., few], s[..., few] - (0.0 if shift is None else shift[few])
    return np.column_stack(S.gaps_along_curves(p, s, ratios))


def _sampled(
    process: SweepingProcess, times: np.ndarray, aim: np.ndarray, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The projection of the aim on C(t) at GAUSS, and the mean of G by Gauss's rule; no bound."""
    w, gaps = np.empty(aim.shape), np.empty(times.shape)
    for at in np.ndindex(*times.shape):
        C = process.C.at(float(times[at]))
        w[at] = C.project(aim[at])
        gaps[at] = C.gap(directions[at], w[at])
    return w, gaps @ WEIGHTS
