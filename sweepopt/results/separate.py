"""Curves in a C(t) that is made of sets that move separately, and bounds of their G (MATH 4).

Sums, images, products and intersections of sets c_i + r_i S_i and { w : G w <= h_i } are concave,
for inclusion, in their data phi = (c_i, r_i, h_i): for weights b_k >= 0 of sum 1 all sum_k b_k w_k
with w_k in C(phi_k) are in C(sum_k b_k phi_k). So the curve with Bernstein coefficients w_k is in
C(t) if phi is the parabola with coefficients phi_k, and also where phi(t) is off that parabola, if
all sets of the middle phi_k are smaller for it. And for weights b >= 0 with int b = 1,
int b sigma(C(t), p) is at most sigma(C(int b phi), p) (Jensen), where int b phi is that of the
cubics of phi, and the sets are larger by what phi is off these.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
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


def has_curves(part: MovingSet) -> bool:
    """Whether it has smaller sets for what its data, continuous and bounded, are off parabolas."""
    of = motion(part)
    known = all(hasattr(x, "piece") and not isinstance(x, Slope) for x in histories_of(part))
    inside = of.offsets or (known and ball_inside(of.summands[0][1])[1])
    return moves_straight(part) or bool(known and inside)


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
    aims, w, gaps = TO_PARABOLA @ aim, np.empty(directions.shape), 0 * begin

    def member(i: int, k: int) -> Any:
        return C.member({part: _member(part, *of[:, i, k]) for part, of in data.items()})

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
    """What a set moves by, center and scale or h, and how far, with a sign, it may be off that.

    Bernstein coefficients of the parabola through its ends and its middle on each interval, and the
    MEANS, both of shape (m, 9, k). A history with its cubic p is off the parabola by the third
    derivative / 6 x (x - 1/2) (x - 1), at most a quarter of that / 6 times 2 x (1 - x): that of p
    is known, and phi - p has at most |phi^(4)| / 2, 12 * 70 times the error of p (Shadrin, as in
    `interpolate`).
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
        of_all.append([np.append(parabolas, MEANS @ cubics, axis=1), off])
    values, off = np.concatenate(of_all, axis=3)
    off[np.abs(off) <= 10 * ROUNDING * np.abs(values).max()] = 0.0
    return np.stack([values, off])


def _member(part: Any, values: Array, off: Array) -> Any:
    """A set that contains all whose data are so far from these; one in them if off < 0.

    With y + B(0, rho) in S and s >= |e| + (|d| + |e| |y|) / rho, c + d + (r + e) S is in
    c - s y + (r + s) S, and (c + s y) + (r - s) S is in it.
    """
    if not hasattr(part, "scale"):
        return part.shape.member(values + off)
    center, scale = values[:-1], float(values[-1])
    if off.any():
        (y, rho), d, e = ball_inside(part.shape), np.linalg.norm(off[:-1]), abs(off[-1])
        s = float(np.copysign(e + (d + e * np.linalg.norm(y)) / rho, off.sum()))
        center, scale = center - s * y, scale + s
    if scale < 0:
        raise EmptySetError("no smaller set")
    return scale * part.shape + center


@lru_cache(16)
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
