"""The residual of a curve through the nodes of a run, step by step (MATH 4).

For the curve v and a selection w(t) in C(t) this gives int 2 G and int |r|^2 on every step,
r = A v' + B v - w and G = sigma(C(t), -v') + <v', w>. Where C(t) = center(t) + scale(t) S is data,
w(t) = center(t) + scale(t) s(t) with s a curve in S between projections, and both integrals are
bounds: G by the convexity of sigma, r as a polynomial plus the interpolation error of the
histories; a sum of several S with scales has a curve in each. Where C(t) = { w : G w <= h(t) } is
data, w is a curve whose Bernstein coefficients are projections on the sets of h's Bernstein
coefficients, and weak duality bounds sigma. Where it is made of sets that move separately w is a
cubic, as these sets are concave in their data (`separate`). For any other
C(t) whose variation is known, S is the set at the middle of a part of the step: the distance d of
w(t) to s(t) is at most the variation on half of the part, and adds 2 |v'| d to the bound of G, so
that the bound falls as sqrt(d). Otherwise both integrals are sampled, and are no bounds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from sweepopt.checks import Array
from sweepopt.errors import EmptySetError, TouchingError
from sweepopt.linalg import NEGLIGIBLE, row_lengths
from sweepopt.problem import (
    ONE,
    Motion,
    Norms,
    SweepingProcess,
    TimeFunction,
    applied,
    histories_of,
    motion,
)
from sweepopt.results.interpolation import (
    TO_BERNSTEIN,
    Interpolated,
    Intervals,
    Nodes,
    force_along,
    increments,
    interpolate,
    smooth_intervals,
)
from sweepopt.results.separate import gap, has_curves, within_separate
from sweepopt.sets import (
    GAUSS,
    ROUNDING,
    THIRDS,
    WEIGHTS,
    Aligned,
    AnySet,
    ConvexSet,
    MovingSet,
    Polyhedron,
    basis,
    kind_without_certificate,
    points_of_sum,
    to_bernstein,
)

HALVES = np.array([0.0, 0.5, 1.0])
HALVES_TO_BERNSTEIN = to_bernstein(HALVES)

LOBATTO = np.stack([1 - GAUSS, GAUSS, GAUSS * (1 - GAUSS), GAUSS * (1 - GAUSS)], axis=1)
LOBATTO[:, 3] *= 1 - 2 * GAUSS
LOBATTO *= np.sqrt([3, 3, 30, 210])
"""Four functions of norm 1 in L^2(0, 1), whose sums with vectors r_k are the cubics r. r_0 and r_1,
its values at the ends, are next to 0 where v satisfies the inclusion at nodes."""
TO_LOBATTO = np.linalg.inv(LOBATTO)
ROOTS = np.sqrt(WEIGHTS)[:, None]
MEAN_SQUARE, MEAN = ROOTS * LOBATTO, WEIGHTS[None] @ LOBATTO
SLOPES = ROOTS * (3 * basis(2, GAUSS) @ np.diff(TO_BERNSTEIN @ LOBATTO, axis=0))
"""Weights with which `Products.of_sum` is |r|, the mean of r and |r'| in L^2(0, 1)."""

PARTS_OF_STEP = 3
"""Parts of a step, on each of which w is a chord of a curved set. With 2 (4) parts bounds were 0.7
(1.3) times as close and took 0.8 (1.3) times as long."""
SETS_OF_STEP = 8
"""Sets of a function t -> C on each step: four times as many give half the bound. With 8 a bound
takes 6 times as long as the run of a box."""
LEAST_PART = 1 / 8
"""Of a step: parts on which a set of coefficients is empty are halved until they are that short.
Without halving, 43 of 289 runs with rows that move had no guaranteed bound, with eight parts 14 of
176 others."""
NEARLY_EMPTY = (
    "C(t) is flat or next to empty at times: give a set that closes to a point as so.Moving(set, "
    "center, scale), and to others more steps"
)
LEAST_STIFFNESS = 8
"""int |r'| is computed on steps with a larger step * Lam only. On others it does not make the bound
of |e|_B smaller if r vanishes somewhere on the step: then int |r'| >= sup |r|, and with y >=
sqrt(S) the step adds at least sqrt(8 / (step * Lam)) times as much to the bound as with int |r|^2 /
2."""
LEAST_SCALE = 1e-9  # of its largest: a scale counts as that, so that a closed set has a point too
CHUNK = 2_000_000  # numbers that intervals treated at once may hold: 16 MB


class Residuals(NamedTuple):
    """Integrals over each step, shape (c, n), of c curves.

    Attributes
    ----------
    gaps, squares : ndarray
        int 2 G and int |r|^2; squares are infinite where A is singular.
    turning : ndarray
        int |r'|, in the dual norm of B; infinite where step * Lam is at most LEAST_STIFFNESS.
    size : ndarray
        sup |r|, in the same way.
    begin, end : ndarray, shape (c, n, dim)
        r at the ends of each step.
    error : ndarray
        A bound of the error of begin and end, in the dual norm of B.
    """

    gaps: Array
    squares: Array
    turning: Array
    size: Array
    begin: Array
    end: Array
    error: Array


class _Model(NamedTuple):
    """C(t) on intervals, where its distance to center(t) + sum of scale(t) S is at most `distance`.

    There is one distance for each interval, and of each summand one S for each or for all. Without
    summands C(t) is known at sampled times only, or, if `points` are given, made of sets that move
    separately; these are points of C(t) at some nodes. `members` are points of each S at all nodes
    but the first, if they are known: then s(t) is straight between them, and the first one until
    there.
    """

    motion: Motion
    intervals: Intervals
    summands: list[tuple[TimeFunction, list[ConvexSet]]]
    distance: Array
    members: list[Array] | None = None
    points: dict[Any, Any] | None = None

    def on(self, some: slice, copies: int = 1) -> _Model:
        """The same on some of the intervals, so many times."""
        return self._replace(
            intervals=Intervals(*(np.tile(x[some], copies) for x in self.intervals)),
            summands=[(r, S[some] * copies if len(S) > 1 else S) for r, S in self.summands],
            distance=np.tile(self.distance[some], copies),
        )

    def halved(self) -> _Model:
        """The same on the halves of its one interval."""
        (i,), (a,), (b,) = self.intervals
        ends = np.array([a, 0.5 * (a + b), b])
        intervals = Intervals(np.array([i, i]), ends[:-1], ends[1:])
        return self._replace(intervals=intervals, distance=np.repeat(self.distance, 2))


def _each(shapes: list[ConvexSet], function: Callable[..., Array], *arrays: Array) -> Array:
    """function(shape, rows of the arrays) of every shape; of one shape all rows at once."""
    if len(shapes) == 1:
        return function(shapes[0], *arrays)
    rows = (function(S, *(x[k : k + 1] for x in arrays)) for k, S in enumerate(shapes))
    return np.concatenate(list(rows))


def residuals(
    norms: Norms,
    nodes: Nodes,
    curves: Array,
    variation: Callable[[float], float] | None,
    speed: Array,
    members: Array | None = None,
) -> tuple[Residuals, str]:
    """The residuals of curves through the nodes, and why they are no bounds; "" if they are.

    Parameters
    ----------
    curves : ndarray, shape (c, n, 3, dim)
        Bernstein coefficients of v' of each curve.
    variation : callable or None
        v with d_H(C(t), C(s)) <= v(t) - v(s) for s <= t.
    speed : ndarray, shape (n, dim)
        Velocities at all nodes but the first.
    members : ndarray, shape (n, dim), optional
        Points of C(t), a Moving set, at these.
    """
    data = motion(norms.process.C)
    model, reason = _model(norms, data, nodes, variation, speed, members)
    # coefficients of a polynomial may be offsets of no set on long steps
    with suppress(EmptySetError, TouchingError):
        return _bounds(norms, nodes, curves, model), reason
    return _bounds(norms, nodes, curves, _on_steps(norms.process, nodes)), NEARLY_EMPTY


def _points_of_several(
    process: SweepingProcess, data: Motion, nodes: Nodes, speed: Array
) -> list[Array]:
    """Points of each S at all nodes but the first, where forces are in C(t), normal to -speed.

    They are those that C(t) has at forces - c speed: next to these the points of its boundary are
    known to rounding, which the projection of a point of the boundary itself is not.
    """
    times, forces = nodes.t[1:], applied(process.A, speed)
    if process.B is not None:
        forces += applied(process.B, nodes.u[1:])
    sizes = np.column_stack([scale.at(times)[:, 0] for scale, _ in data.summands])
    sizes = np.maximum(sizes, LEAST_SCALE * sizes.max(axis=0))
    forces = forces - data.center.at(times)
    fastest = np.linalg.norm(speed, axis=1).max(initial=0.0) or 1.0
    outside = forces - np.linalg.norm(forces, axis=1).max() / fastest * speed
    return points_of_sum([S for _, S in data.summands], sizes, outside)


def unknown(C: AnySet, data: Motion, t: float) -> str:
    """What is not known of C(t) between the times of a grid, t one of them; "" if all is."""
    if isinstance(C, MovingSet) and C.operands and not data.summands:
        reason = next(filter(None, (unknown(S, motion(S), t) for S in C.moving_parts)), "")
        S, ask = C.at(t), "write it as a Moving set, or take error_bound(variation=)"
        # of sets that are not cut supports have formulas
        cut = [T for T in S.factors() if not T.exact and T.form().F.shape[0]]
        if reason or not (S.certifiable and all(T.magnitude() < math.inf for T in cut)):
            return reason or f"C(t) is made of sets that move separately and is unbounded: {ask}"
        if not all(has_curves(part) for part in C.moving_parts):
            reason = (
                "a set that C(t) is made of is flat and moves on a curve that is no cubic: give it "
                f"so.Table histories, {ask}"
            )
        return reason
    if not data.summands:
        return (
            "C(t) is a function of time: write it as a Moving set, in a scene with a history in "
            "the place of t in a formula, or take error_bound(variation=)"
        )
    parts = [(data.name, (data.offsets or data.center).bounded)]
    summands: Any = data.summands
    for scale, S in summands:
        parts.append(("scale", scale.function is None and scale.bounded))
        if data.offsets is not None and not S.exact_rows:
            return f"the {data.offsets.dim} rows of G that move are too many for exact projections"
        if data.offsets is None and not S.certifiable:
            return f"nothing is proved of {kind_without_certificate(S)}"
    for name, bounded in parts:
        if not bounded:
            return (
                f"{name}(t) is a function, known at some times only: give it as so.Separable or "
                "so.Table, in a scene by a history, or take error_bound(variation=)"
            )
    return ""


def _model(
    norms: Norms,
    data: Motion,
    nodes: Nodes,
    variation: Callable[[float], float] | None,
    speed: Array,
    members: Array | None,
) -> tuple[_Model, str]:
    """What is known of C(t) on intervals that cover the steps, and what is not."""
    process, points = norms.process, None
    if variation is not None and not data.center.bounded:
        data = _with_variation(data, variation)
    reason = unknown(process.C, data, nodes.t[0])
    if data.summands and data.scales_known and not (reason and data.offsets):
        if not data.disjoint:
            points = _points_of_several(process, data, nodes, speed)
        elif (
            members is not None
            and [S.exact for _, S in data.summands] == [False]
            and (scale := data.summands[0][0].at(nodes.t[1:])).all()
        ):
            points = [(members - data.center.at(nodes.t[1:])) / scale]
        sharp = points is not None or all(S.sharp_gaps for _, S in data.summands)
        intervals = smooth_intervals(data.histories, nodes.t, 1 if sharp else PARTS_OF_STEP)
        summands = [(scale, [S]) for scale, S in data.summands]
        return _Model(data, intervals, summands, np.zeros(len(intervals.step)), points), reason
    model = _on_steps(process, nodes)
    if variation is None or norms.weak:  # members in the middle have no int |r'|
        if variation is None and not reason:
            known = zip(nodes.t[1:].tolist(), [] if members is None else members, strict=False)
            model = model._replace(points=dict(known))
        return model, unknown(process.C, motion(process.C), nodes.t[0])
    intervals = smooth_intervals(model.motion.histories, nodes.t, SETS_OF_STEP)
    middles = 0.5 * (intervals.begin + intervals.end)
    shapes = [process.C.at(t) for t in middles.tolist()]
    halves = np.sort(np.concatenate([nodes.t[:1], middles, intervals.end]))
    distance = increments(variation, halves).reshape(-1, 2).max(axis=1)
    model = model._replace(intervals=intervals, summands=[(ONE, shapes)], distance=distance)
    return model, "" if all(S.certifiable for S in shapes) else reason


def _on_steps(process: SweepingProcess, nodes: Nodes) -> _Model:
    """That of a C(t) of which nothing is known between samples."""
    steps = smooth_intervals(histories_of(process.C, inside=False), nodes.t)
    distance = np.zeros(len(steps.step))
    return _Model(Motion((), TimeFunction((), process.dim)), steps, [], distance)


def _with_variation(moving: Motion, variation: Callable[[float], float]) -> Motion:
    """Translates of a bounded set are as far apart as their centers; of others nothing is known."""
    center, only = moving.center, len(moving.summands) == 1
    if not (only and all(r.constant and S.magnitude() < math.inf for r, S in moving.summands)):
        return Motion((), center)
    value = center.function or (lambda t: center.at(np.array([t]))[0])
    between = partial(increments, variation)
    return replace(moving, center=TimeFunction((), center.dim, value, between))


def _bounds(norms: Norms, nodes: Nodes, curves: Array, model: _Model) -> Residuals:
    """Those of all curves, from intervals treated at once."""
    moving = model.motion
    width = max(norms.process.dim, 0 if moving.offsets is None else moving.offsets.dim)
    many = max(CHUNK // (30 * len(curves) * width), 1)
    sizes = _sizes_of_terms(norms, moving.center)
    steps, parts = zip(*_of_parts(norms, nodes, curves, model, sizes, many), strict=True)
    step = np.concatenate(steps)
    of_all = (np.concatenate(each, axis=1) for each in zip(*parts, strict=True))
    gaps, squares, turning, size, begin, end, error = of_all
    first = np.searchsorted(step, np.arange(len(nodes.velocity)))
    cuts = np.setdiff1d(np.arange(1, len(step)), first)  # inside of steps, where r may jump
    jumps = norms.B.dual(begin[:, cuts] - end[:, cuts - 1])
    turning[:, cuts] += jumps + error[:, cuts] + error[:, cuts - 1]
    gaps, squares, turning = (np.add.reduceat(x, first, axis=1) for x in (gaps, squares, turning))
    last = np.append(first[1:], len(step)) - 1
    size, error = (np.maximum.reduceat(x, first, axis=1) for x in (size, error))
    return Residuals(gaps, squares, turning, size, begin[:, first], end[:, last], error)


def _of_parts(
    norms: Norms, nodes: Nodes, curves: Array, model: _Model, sizes: list[Array], many: int
) -> Iterator[tuple[Array, list[Array]]]:
    """The step of intervals and what all curves have there, of so many intervals at once.

    An interval on which a set of coefficients is empty is halved.
    """
    step, a, b = model.intervals
    middle = len(step) // 2
    if len(step) <= many:
        try:
            of_each = model.on(slice(None), len(curves))
            each = _on_intervals(norms, nodes, np.concatenate(curves[:, step]), of_each, sizes)
        except (EmptySetError, TouchingError):
            if not middle:
                t = nodes.t
                if (b - a)[0] < 1.5 * LEAST_PART * (t[step + 1] - t[step])[0]:
                    raise
                model, middle = model.halved(), 1
        else:
            yield step, [x.reshape(len(curves), -1, *x.shape[1:]) for x in each]
            return
    for half in (slice(middle), slice(middle, None)):
        yield from _of_parts(norms, nodes, curves, model.on(half), sizes, many)


def _on_intervals(
    norms: Norms, nodes: Nodes, slopes: Array, model: _Model, sizes: list[Array]
) -> Residuals:
    """Those of curves on intervals, each with its slopes of shape (3, dim)."""
    i, a, b = model.intervals
    center = interpolate(model.motion.center, a, b)
    h, length = nodes.t[i + 1] - nodes.t[i], b - a
    stiff = (h * norms.Lam > LEAST_STIFFNESS) | norms.weak
    begin, share = ((a - nodes.t[i]) / h)[:, None], (length / h)[:, None]
    theta = begin + share * GAUSS
    force = force_along(norms.process, nodes, slopes, i, theta) - center.values
    velocity = basis(2, theta) @ slopes
    aim = force - norms.coercivity * velocity
    directions = -HALVES_TO_BERNSTEIN @ (basis(2, begin + share * HALVES) @ slopes)
    errors = np.zeros((3, len(a)))
    speed = np.linalg.norm(directions, axis=2).mean(axis=1)
    if model.points is not None:
        w, gaps = within_separate(norms.process.C, a, b, aim, directions, model.points)
    elif not model.summands:
        w, gaps = _sampled(norms.process, a, length, force, aim, directions)
    elif model.motion.offsets is None:
        w, gaps = np.zeros_like(force), 2 * speed * model.distance
        scales = [interpolate(f, a, b) for f, _ in model.summands]
        known = _known_curves(model, scales, begin + share * THIRDS, force, slopes)
        errors = _of_interpolation(center, center.slope_error, sizes)
        for (f, shapes), scale, s in zip(model.summands, scales, known, strict=True):
            s, of_w, gap = _within_shape(f, shapes, s, scale, aim, directions)
            w, gaps = w + of_w, gaps + gap
            if scale.error.any():
                # var(s) <= sum_k |s_(k+1) - s_k| <= 6 max |s_k|
                slope_error = scale.slope_error + 6 * scale.error
                errors += _of_interpolation(scale, slope_error, _sizes_along(norms, f, s))
        errors[0] += model.distance / math.sqrt(norms.A.beta)
    else:
        ((_, (S,)),) = model.summands
        f = model.motion.offsets
        w, gaps = _within_rows(S, f, aim, directions, interpolate(f, a, b))
    (error, error_B, turning), r = errors, TO_LOBATTO @ (force - w)
    squares, varies, size = np.full((3, len(a)), np.inf)
    if not norms.weak:  # Minkowski: the interpolation error adds up in the norm
        of_r = norms.A.dual_products(r, np.sqrt(2 * gaps))
        squares = length * (of_r.of_sum(MEAN_SQUARE) + error) ** 2
    of_r = norms.B.dual_products(r[stiff], np.sqrt(2 * length * gaps)[stiff])
    varies[stiff] = of_r.of_sum(SLOPES)
    # |r - its mean|^2 <= int |r'|^2 / 3
    size[stiff] = of_r.of_sum(MEAN) + varies[stiff] / math.sqrt(3)
    size += error_B
    varies[stiff] += turning[stiff]
    varies[model.distance > 0] = np.inf  # of w(t) only its distance to s(t) is known
    first, last = math.sqrt(3) * r[:, 0], math.sqrt(3) * r[:, 1]
    return Residuals(2 * length * gaps, squares, varies, size, first, last, error_B)


def _known_curves(
    model: _Model, scales: list[Interpolated], theta: Array, force: Array, slopes: Array
) -> list[Any]:
    """A curve in each S through its points at nodes, at the shares theta of the steps, or None.

    They are chords, that of the first step its last point. Then each in turn that has an exact
    projection goes on to the force that the others leave, but not along the mean of v', as G would
    become larger: all the way where v' = 0, where all w have G = 0.
    """
    if not model.members:
        return [None] * len(scales)
    curves = []
    n = slopes.mean(axis=1, keepdims=True)
    n /= np.maximum(np.linalg.norm(n, axis=2, keepdims=True), np.finfo(float).tiny)
    for points in model.members:
        first, last = (points[np.maximum(model.intervals.step - k, 0), None] for k in (1, 0))
        curves.append(first + theta[:, :, None] * (last - first))
    sizes = [TO_BERNSTEIN @ scale.values for scale in scales]
    rest = TO_BERNSTEIN @ force - sum(size * s for size, s in zip(sizes, curves, strict=True))
    for k, (size, (_, shapes)) in enumerate(zip(sizes, model.summands, strict=True)):
        if shapes[0].exact:
            rest -= n * (rest * n).sum(axis=2, keepdims=True)
            rest += size * curves[k]
            curves[k] = _curve_in_shape(shapes, rest, size)
            rest -= size * curves[k]
    return curves


def _within_shape(
    f: TimeFunction,
    shapes: list[ConvexSet],
    s: Array | None,
    scale: Interpolated,
    aim: Array,
    directions: Array,
) -> tuple[Array, Array, Array]:
    """A curve s in S, scale s at GAUSS and the mean of a bound of its G.

    s = sum_k b_k size_k s_k / sum_k b_k size_k, size_k > 0 the coefficients of the scale, so that
    scale s is a cubic; where they may be 0 s is constant.
    """
    sizes = TO_BERNSTEIN @ scale.values
    error = scale.error @ np.abs([size for _, size in f.terms])
    if s is None:
        s = _curve_in_shape(shapes, TO_BERNSTEIN @ aim, sizes)
    least, most = sizes.min(axis=1), sizes.max(axis=1)
    vanishing = (least <= error).any(axis=1)
    larger = sizes[..., 0] * (1 + np.divide(error, least, out=0 * error, where=least > error))
    if vanishing.any():
        constant = _each(shapes, _projections, s.mean(axis=1, keepdims=True))
        s[vanishing], larger[vanishing] = constant[vanishing], (most + error)[vanishing]
    gaps = _each(shapes, _gaps, directions, s, larger)
    return s, basis(3, GAUSS) @ (sizes * s), gaps


def _within_rows(
    S: ConvexSet, f: Any, aim: Array, directions: Array, h: Interpolated
) -> tuple[Array, Array]:
    """A curve w in C(t) = { w : G w <= h(t) } at GAUSS, and the mean of a bound of its G.

    Where each Bernstein coefficient of w satisfies the rows for that of h's polynomial less its
    error, w is in C(t). By weak duality sigma(C(t), -v') <= <h(t), y> for y >= 0, G^T y = -v'.
    """
    if isinstance(S, Aligned):  # w = 0 beside its unknowns
        w, few = np.zeros_like(aim), S.unknowns
        w[..., few], gaps = _within_rows(S.parts[0], f, aim[..., few], directions[..., few], h)
        return w, gaps
    assert isinstance(S, Polyhedron)
    error = h.error @ np.abs([shape for _, shape in f.terms] or np.ones((1, f.dim)))
    limits = TO_BERNSTEIN @ h.values - error[:, None]
    limits += ROUNDING * np.abs(h.values).max(axis=1, keepdims=True)
    of_scales = row_lengths(S.G) == 0  # 0 <= scale(t), which holds
    limits[..., of_scales] = np.maximum(limits[..., of_scales], 0.0)
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


def _sizes_of_terms(norms: Norms, center: TimeFunction) -> list[Array]:
    """The vectors of a center(t) in both dual norms; what a function varies is Euclidean."""
    both = norms.A, norms.B
    if not center.terms:
        return [np.array([1 / math.sqrt(one.beta) if one.beta else math.inf]) for one in both]
    vectors = np.array([f for _, f in center.terms])
    return [one.dual(vectors) for one in both]


def _sizes_along(norms: Norms, scale: TimeFunction, s: Array) -> list[Array]:
    """The largest ones of the vectors that a scale multiplies along a curve s, in both norms."""
    vectors = np.stack([size * s for _, size in scale.terms], axis=2)
    return [norm.dual(vectors).max(axis=1) for norm in (norms.A, norms.B)]


def _of_interpolation(of: Interpolated, slopes: Array, sizes: list[Array]) -> Array:
    """What the errors of a function with vectors of these sizes add to |r|, in both dual norms.

    And to int |r'| in that of B, where the derivative is wrong by `slopes`.
    """
    pairs = (of.error, sizes[0]), (of.error, sizes[1]), (slopes, sizes[1])
    return np.array([np.where(e == 0, 0.0, e * size).sum(axis=1) for e, size in pairs])


def _curve_in_shape(shapes: list[ConvexSet], force: Array, sizes: Array) -> Array:
    """Bernstein coefficients of a curve in S, shape (m, 4, dim).

    Those of the force / scale, projected on S: S is convex, so the curve stays in it.
    """
    size = np.broadcast_to(sizes, force.shape)
    aim = np.divide(force, size, out=np.zeros_like(force), where=size > 0)
    S, ends = shapes[0], aim[:, [0, -1]]
    if len(shapes) > 1:
        return _each(shapes, _projections, aim)
    if projects_at_once(S):
        return S.curves_within(aim, sizes[..., 0])
    # projections one by one take most of the time, and chords lose little; where the force is in S
    # the curve is the force itself
    line = _projections(S, ends)
    inside = (np.abs(line - ends) <= NEGLIGIBLE * np.abs(ends).max()).all(axis=(1, 2))
    s: Array = line[:, :1] + THIRDS[:, None] * (line[:, 1:] - line[:, :1])
    if inside.any():
        s[inside, 1:-1] = _projections(S, aim[inside, 1:-1])
    return s


def projects_at_once(S: ConvexSet) -> bool:
    """Whether S is projected on exactly, by formulas for many points, and its gaps are sharp."""
    rows = [type(part).project_rows for part in S.factors()]
    return S.exact and S.sharp_gaps and ConvexSet.project_rows not in rows


def _projections(S: ConvexSet, curves: Array) -> Array:
    """Points of S next to those of curves."""
    return S.project_rows(curves.reshape(-1, S.dim)).reshape(curves.shape)


def _gaps(S: ConvexSet, p: Array, s: Array, sizes: Array) -> Array:
    """The mean of G along each curve."""
    if S.selection is not None:
        few, S, shift = S.selection
        p, s = p[..., few], s[..., few] - (0.0 if shift is None else shift[few])
    return S.gaps_along_curves(p, s, sizes)


def _sampled(
    process: SweepingProcess,
    begin: Array,
    length: Array,
    force: Array,
    aim: Array,
    directions: Array,
) -> tuple[Array, Array]:
    """w at GAUSS and the mean of G as they are for one projection in each step; no bound.

    At nodes r = G = 0, but where v is straight only at the end of its step. Golden sections make
    the place another one in each step: whatever has a period of the step would be overlooked in the
    middle of all of them.
    """
    golden = (math.sqrt(5) - 1) / 2
    share = 0.3 + 0.3 * (golden * np.arange(len(begin)) % 1)
    velocities = np.einsum("ik,ikn->in", basis(2, share), directions)
    of_basis = basis(3, share) @ TO_BERNSTEIN
    aims, forces = (np.einsum("ik,ikn->in", of_basis, x) for x in (aim, force))
    straight = (directions == directions[:, :1]).all(axis=(1, 2))
    points, gaps = np.empty_like(aims), np.empty(len(begin))
    for i, t in enumerate((begin + share * length).tolist()):
        C = process.C.at(t)
        points[i] = C.project(aims[i])
        gaps[i] = gap(C, velocities[i], points[i])
    share, straight = share[:, None], straight[:, None]
    shape = (1 - GAUSS) / (1 - share) * np.where(straight, 1.0, GAUSS / share)
    return force - shape[:, :, None] * (forces - points)[:, None], gaps
