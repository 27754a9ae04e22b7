"""Curves in a C(t) that is made of sets that move separately, and bounds of their G (MATH 4).

Sums, images, products and intersections of sets c_i + r_i S_i and { w : G w <= h_i } that have data
of their own are concave, for inclusion, in these data phi = (c_i, r_i, h_i): if b_k >= 0,
sum_k b_k = 1 and w_k in C(phi_k), then sum_k b_k w_k is in C(sum_k b_k phi_k). So the curve with
Bernstein coefficients w_k is in C(t) if phi is the parabola with coefficients phi_k. Where phi(t)
differs from that parabola, the sets of the middle coefficient are shrunk by a bound of the
difference. And for b >= 0 with int b = 1, int b sigma(C(t), p) <= sigma(C(int b phi), p) (Jensen):
int b phi is computed from the cubic interpolants of phi, and the sets are enlarged by a bound of
the interpolation error.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np

from sweepopt.checks import Array
from sweepopt.errors import EmptySetError
from sweepopt.loads import Slope
from sweepopt.problem import histories_of, motion
from sweepopt.results.interpolation import GAUSS, TO_BERNSTEIN, WEIGHTS, interpolate, is_straight
from sweepopt.sets import ROUNDING, ConvexSet, MovingSet, basis, to_bernstein

HALVES = np.array([0.0, 0.5, 1.0])
HALVES_TO_BERNSTEIN = to_bernstein(HALVES)
TO_PARABOLA = np.array([[4, 0, 0, 0], [-1, 3, 3, -1], [0, 0, 0, 4]]) / 4 @ TO_BERNSTEIN
MEANS = np.concatenate([(k + 1) * (WEIGHTS[:, None] * basis(k, GAUSS)).T for k in range(3)])
"""Weights at GAUSS of the means by Bernstein polynomials of degree 0, 1 and 2."""


def moves_straight(C: Any) -> bool:
    """Whether the data of all parts are straight between breakpoints."""
    return all(is_straight(phi) for part in C.moving_parts for phi in motion(part).histories)


def has_curves(part: MovingSet, t: float) -> bool:
    """Whether curves in it are known: its data are straight, or it can be shrunk at the time t."""
    of = motion(part)
    if moves_straight(part):
        return True
    known = all(hasattr(x, "piece") and not isinstance(x, Slope) for x in histories_of(part))
    return known and ball_inside(part.at(t) if of.offsets else of.summands[0][1])[1] > 0


def within_separate(
    C: Any, begin: Array, end: Array, aim: Array, directions: Array, points: dict[float, Array]
) -> tuple[Array, Array]:
    """A curve w near the aim in C(t) at GAUSS, and the mean of a bound of its G.

    Intervals follow each other, and share ends of w, which are `points` of C(t) where one is known.
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
    aims, w, gaps = TO_PARABOLA @ aim, np.empty(directions.shape), 0 * begin

    def member(i: int, k: int) -> Any:
        sets = {
            part: _member(part, values[i, k], off[i, k], balls.get(part))
            for part, (values, off) in data.items()
        }
        return C.member(sets)

    def point(i: int, k: int) -> Any:
        return member(i, k).project(aims[i, k])

    chords = moves_straight(C)
    for i, last in enumerate(end.tolist()):
        w[i, 0] = w[i - 1, 2] if i else point(i, 0)
        w[i, 2] = points[last] if last in points else point(i, 2)
        w[i, 1] = (w[i, 0] + w[i, 2]) / 2 if chords else point(i, 1)
    w = basis(2, GAUSS) @ w
    for i, each in enumerate(directions):
        rounding = ROUNDING * np.abs(each).max()
        if np.ptp(each, axis=0).max() <= rounding:
            each = each[1:2]
        elif np.abs(each[0] - 2 * each[1] + each[2]).max() <= rounding:
            each = each[::2]
        for k, p in enumerate(each, start=len(each) * (len(each) - 1) // 2):
            gaps[i] += gap(member(i, 3 + k), p, MEANS[k] @ w[i]) / len(each)
    return w, gaps


def gap(S: ConvexSet, p: Array, w: Array) -> float:
    """A bound of sigma(S, p) - <p, w>; of C & D by a projection, as its program takes 17 ms."""
    sigma = float(S.supports_along(p[None, None], w[None, None])[0, 0])
    return max(sigma - float(p @ w), 0.0) + ROUNDING * abs(sigma) if p.any() else 0.0


def _data(part: MovingSet, begin: Array, end: Array) -> Array:
    """Coefficients of the data, center and scale or h, and bounds of their interpolation errors.

    Bernstein coefficients of the parabola through ends and middle of each interval, and the MEANS;
    both of shape (m, 9, k). Bounds with a negative sign shrink the set, others enlarge it. A
    history phi differs from the parabola by its third derivative / 6 x (x - 1/2) (x - 1), at most a
    quarter of that / 6 times 2 x (1 - x). The third derivative of its cubic p is known, that of
    phi - p is at most |phi^(4)| / 2, 12 * 70 times the error of p (Shadrin, as in `interpolate`).
    """
    moving, of_all = motion(part), []
    times = np.stack([begin, 0.5 * (begin + end), end], axis=1)
    for f in [moving.offsets] if moving.offsets else [moving.center, moving.summands[0][0]]:
        parabolas = HALVES_TO_BERNSTEIN @ f.at(times.ravel()).reshape(-1, 3, f.dim)
        cubics, errors, _ = interpolate(f, begin, end)
        error = errors @ np.abs([v for _, v in f.terms] or np.zeros((errors.shape[1], f.dim)))
        off = np.repeat(error[:, None], 9, axis=1)
        off[:, :3] = 0.0
        off[:, 1] = -35 * error - np.abs(np.diff(TO_BERNSTEIN @ cubics, 3, axis=1))[:, 0] / 4
        # rounding of each row of h, of all of a vector
        size = np.abs(parabolas).max(axis=(0, 1) if moving.offsets else None)
        off[np.abs(off) <= 10 * ROUNDING * size] = 0.0
        of_all.append([np.append(parabolas, MEANS @ cubics, axis=1), off])
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


def ball_inside(S: ConvexSet) -> tuple[Array, float]:
    """y and rho with y + B(0, rho) in S, from octahedra with corners near S; rho = 0 if flat."""
    size = S.magnitude()
    size = size if size < np.inf else 1.0 + float(np.linalg.norm(S.anchor))

    def corners(center: Array, share: float) -> Iterator[Array]:
        for k, sign in product(range(S.dim), (-1, 1)):
            yield center + share * size * sign * (np.arange(S.dim) == k)

    rho, total = 0.0, sum(map(S.project, corners(S.anchor, 1.0)), start=np.zeros(S.dim))
    y = total / (2 * S.dim)
    for share in 0.5 ** np.arange(12):
        far = max(float(np.linalg.norm(S.project(x) - x)) for x in corners(y, share))
        radius = share * size / math.sqrt(S.dim) - far
        if radius < rho > 0:  # it is concave in the share
            break
        rho = max(rho, radius)
    return y, rho
