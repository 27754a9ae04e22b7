"""Curves in a C(t) that is made of sets that move separately, and bounds of their G (MATH 4).

Sums, images, products and intersections of sets c_i + r_i S_i and { w : G w <= h_i } that have data
of their own are concave, for inclusion, in these data phi = (c_i, r_i, h_i): if b_k >= 0,
sum_k b_k = 1 and w_k in C(phi_k), then sum_k b_k w_k is in C(sum_k b_k phi_k). So the curve with
Bernstein coefficients w_k is in C(t) if phi is the cubic with coefficients phi_k. Where phi(t)
differs from that cubic, the sets of the coefficients inside are shrunk by a bound of the
difference. It is of fourth order: of 54 runs of 3 to 6 steps 2 met an empty set, with parabolas,
whose difference is of third order, 13. And for b >= 0
with int b = 1, int b sigma(C(t), p) <= sigma(C(int b phi), p) (Jensen): int b phi is computed from
the cubic interpolants of phi, and the sets are enlarged by a bound of the interpolation error.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np

from sweepopt.checks import Array
from sweepopt.errors import EmptySetError
from sweepopt.linalg import row_lengths
from sweepopt.loads import Polynomial, Slope
from sweepopt.problem import histories_of, motion
from sweepopt.results.interpolation import TO_BERNSTEIN, interpolate, is_straight
from sweepopt.sets import (
    GAUSS,
    ROUNDING,
    THIRDS,
    WEIGHTS,
    ConvexSet,
    MovingSet,
    NoHalfspacesError,
    basis,
    to_bernstein,
)

THIRDS_TO_BERNSTEIN = to_bernstein(THIRDS)
MEANS = np.concatenate([(k + 1) * (WEIGHTS[:, None] * basis(k, GAUSS)).T for k in range(3)])
"""Weights at GAUSS of the means by Bernstein polynomials of degree 0, 1 and 2."""


def moves_straight(C: Any) -> bool:
    """Whether the data of all parts are straight between breakpoints."""
    return all(is_straight(phi) for part in C.moving_parts for phi in motion(part).histories)


def has_curves(part: MovingSet) -> bool:
    """Whether curves in it are known: its data are cubics between breakpoints, or it has a ball."""
    of = motion(part)
    if of.offsets is not None or all(map(_is_cubic, of.histories)):
        return True
    return ball_inside(of.summands[0][1])[1] > 0


def _is_cubic(phi: Any) -> bool:
    """Whether a history is a cubic, at most, between breakpoints."""
    few = isinstance(phi, Polynomial) and phi.coefficients.size <= 4
    return few or is_straight(phi) or isinstance(phi, Slope)


def is_smooth(part: MovingSet) -> bool:
    """Whether all data have derivatives between breakpoints, and do not jump there."""
    return all(hasattr(x, "piece") and not isinstance(x, Slope) for x in histories_of(part))


def within_separate(
    C: Any, begin: Array, end: Array, aim: Array, directions: Array, points: dict[Any, Any]
) -> tuple[Array, Array]:
    """A curve w near the aim in C(t) at GAUSS, and the mean of a bound of its G.

    Intervals share ends of w, which are `points` of C(t) where one is known, if C(t) has no jumps.
    These and those inside are kept there; None where a smaller set is empty, or nearly so.
    Directions are the Bernstein coefficients of -v'. Where the data are straight w is, too.

    Raises
    ------
    EmptySetError, TouchingError
        If a smaller set has no point.
    """
    data = {part: _data(part, begin, end) for part in C.moving_parts}
    balls = {
        part: ball_inside(part.shape)
        for part, (_, off) in data.items()
        if off.any() and not motion(part).offsets
    }
    aims, w, gaps = TO_BERNSTEIN @ aim, np.empty(aim.shape), 0 * begin

    def member(i: int, k: int) -> Any:
        sets = {
            part: _member(part, values[i, k], off[i, k], balls.get(part))
            for part, (values, off) in data.items()
        }
        return C.member(sets)

    def point(i: int, k: int, of: Any) -> Any:
        if of not in points:
            S, points[of] = member(i, k), None
            points[of] = (S.project if shared and k in (0, 3) else S.project_quickly)(aims[i, k])
        if points[of] is None:
            raise EmptySetError("no smaller set")
        return points[of]

    chords, shared = moves_straight(C), all(map(is_smooth, C.moving_parts))
    for i, (a, b) in enumerate(zip(begin.tolist(), end.tolist(), strict=True)):
        w[i, 0], w[i, 3] = (point(i, k, t if shared else (a, b, k)) for k, t in ((0, a), (3, b)))
        line = w[i, 0] + THIRDS[1:3, None] * (w[i, 3] - w[i, 0])
        w[i, 1:3] = line if chords else [point(i, k, (a, b, k)) for k in (1, 2)]
    w = basis(3, GAUSS) @ w
    for i, each in enumerate(directions):
        rounding = ROUNDING * np.abs(each).max()
        if np.ptp(each, axis=0).max() <= rounding:
            each = each[1:2]
        elif np.abs(each[0] - 2 * each[1] + each[2]).max() <= rounding:
            each = each[::2]
        for k, p in enumerate(each, start=len(each) * (len(each) - 1) // 2):
            gaps[i] += gap(member(i, 4 + k), p, MEANS[k] @ w[i]) / len(each)
    return w, gaps


def gap(S: ConvexSet, p: Array, w: Array) -> float:
    """A bound of sigma(S, p) - <p, w>; of C & D by a projection, as its program takes 17 ms."""
    sigma = float(S.supports_along(p[None, None], w[None, None])[0, 0])
    return max(sigma - float(p @ w), 0.0) + ROUNDING * abs(sigma) if p.any() else 0.0


def _data(part: MovingSet, begin: Array, end: Array) -> Array:
    """Coefficients of the data, center and scale or h, and bounds of their interpolation errors.

    Bernstein coefficients of the cubic through four points of each interval, and the MEANS; both of
    shape (m, 10, k). Bounds with a negative sign shrink the set, others enlarge it. A history phi
    differs from the cubic by phi^(4) / 24 x (x - 1/3) (x - 2/3) (x - 1) at some time, at most 2/27
    of that times 3 x (1 - x); |phi^(4)| / 24 is 70 times the error of `interpolate`. Where data
    are not smooth the cubic is that of `interpolate`, and all of its coefficients are shrunk.
    """
    moving, of_all = motion(part), []
    times = begin[:, None] + (end - begin)[:, None] * THIRDS
    times[:, -1] = end
    for f in [moving.offsets] if moving.offsets else [moving.center, moving.summands[0][0]]:
        cubics = interpolate(f, begin, end)
        sizes = np.abs([v for _, v in f.terms] or np.zeros((len(f.histories), f.dim)))
        error = cubics.error @ sizes
        off = np.repeat(error[:, None], 10, axis=1)
        if is_smooth(part):
            curves = THIRDS_TO_BERNSTEIN @ f.at(times.ravel()).reshape(-1, 4, f.dim)
            off[:, :4] *= -70 * 2 / 27 * np.array([0, 1, 1, 0])[:, None]
        else:
            curves = TO_BERNSTEIN @ cubics.values
            off[:, :4] *= -1
        # rounding of each row of h, of all of a vector
        size = np.abs(curves).max(axis=(0, 1) if moving.offsets else None)
        off[np.abs(off) <= 10 * ROUNDING * size] = 0.0
        of_all.append([np.append(curves, MEANS @ cubics.values, axis=1), off])
    return np.concatenate(of_all, axis=3)


def _member(part: Any, values: Array, off: Array, ball: tuple[Array, float] | None) -> Any:
    """A set around all whose data differ by at most off from these; if off < 0, one in all.

    With y + B(0, rho) in S and s >= |e| + (|d| + |e| |y|) / rho, c + d + (r + e) S is in
    c - s y + (r + s) S, and (c + s y) + (r - s) S is in it.
    """
    if not hasattr(part, "scale"):
        return part.shape.member(values + off)
    center, scale = values[:-1], float(values[-1])
    if ball and off.any():
        (y, rho), d, e = ball, np.linalg.norm(off[:-1]), abs(off[-1])
        s = float(np.copysign(e + (d + e * np.linalg.norm(y)) / rho, off.sum()))
        center, scale = center - s * y, scale + s
    if scale < 0:
        raise EmptySetError("no smaller set")
    return scale * part.shape + center


@lru_cache(64)  # asked for again by every part of a bound
def ball_inside(S: ConvexSet) -> tuple[Array, float]:
    """y and rho with y + B(0, rho) in S; rho <= 0 if flat.

    From rows of S, or from octahedra with corners near S.
    """
    G, far = np.empty((0, S.dim)), np.empty(0)
    with suppress(NoHalfspacesError):
        G, h = S.halfspaces().inequalities()
        some = (lengths := row_lengths(G)) > 0
        G, far = G[some] / lengths[some, None], h[some] / lengths[some]
    size = float(np.abs(far).max(initial=0.0)) or S.magnitude()
    size = size if size < np.inf else 1.0 + float(np.linalg.norm(S.anchor))

    def corners(center: Array, share: float) -> Iterator[Array]:
        for k, sign in product(range(S.dim), (-1, 1)):
            yield center + share * size * sign * (np.arange(S.dim) == k)

    rho, total = 0.0, sum(map(S.project, corners(S.anchor, 1.0)), start=np.zeros(S.dim))
    y = total / (2 * S.dim)
    if far.size:
        return y, float((far - G @ y).min())
    for share in 0.5 ** np.arange(12):
        off = max(float(np.linalg.norm(S.project(x) - x)) for x in corners(y, share))
        radius = share * size / math.sqrt(S.dim) - off
        if radius < rho > 0:  # it is concave in the share
            break
        rho = max(rho, radius)
    return y, rho
