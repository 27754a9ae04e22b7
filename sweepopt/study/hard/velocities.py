"""The program  -z in N_C(N z + q)  in 60 digits: an active set for polyhedra, smoothing for balls.

Neither needs a start, so that no solver's answer is favoured.
"""

from __future__ import annotations

from decimal import Decimal
from typing import Any

import numpy as np

from sweepopt.errors import InputError, SweepoptError
from sweepopt.linalg import dense
from sweepopt.sets import Ball, Balls, Box, ConvexSet, Point, Polyhedron, shape_of
from sweepopt.study.hard import digits

CHANGES = 2000  # of the active set: it is finite, and this ends what is not
ROUNDING = Decimal("1e-45")  # relative: of 60 digits, the rest is for condition numbers
NEWTON = 200  # steps at each smoothing, of which some 20 are needed
SMOOTHING = [Decimal(10) ** -k for k in range(2, 36, 4)]  # velocities have then some 25 digits


def velocity(C: ConvexSet, N: np.ndarray, q: np.ndarray) -> np.ndarray:
    """z with -z in N_C(N z + q).

    Raises
    ------
    InputError
        If C is neither a polyhedron that states its rows nor made of balls.
    """
    if isinstance(C, Ball):
        return in_balls(N, q - digits.exactly(C.center), np.array([C.radius]))
    if isinstance(C, Balls):
        return in_balls(N, q, C.radii)
    if isinstance(C, Point):
        point = C.project(np.zeros(C.dim))
        C = Box(point, point)
    if not isinstance(shape_of(C), (Box, Polyhedron)):
        raise InputError(f"no exact velocity is known for a {type(C).__name__}")
    rows = C.halfspaces()
    return in_polyhedron(N, q, dense(rows.N), rows.d)


def in_polyhedron(N: np.ndarray, q: np.ndarray, G: np.ndarray, h: np.ndarray) -> np.ndarray:
    """The velocity for C = { w : G w <= h }, by rows w = q - N G^T y in C with y >= 0.

    The most violated row enters, rows with y < 0 leave (Goldfarb and Idnani's dual method, Math.
    Programming 27, 1983, in the metric of N^-1: finite, whatever the rows, as those that hold w
    stay independent).
    """
    lengths = digits.exactly(np.sqrt(np.einsum("ij,jk,ik->i", G, N.astype(float), G)))
    start = digits.exactly(h) - _product(G, q)
    active: list[int] = []
    # of the active rows: columns of H = G N G^T, the inverse of their block of it, multipliers
    H, inverse, y = digits.exactly(np.zeros((len(G), 0))), N[:0, :0], q[:0]
    for _ in range(CHANGES):
        slack = start + H @ y
        noise = ROUNDING * (abs(start) + abs(H) @ abs(y))
        violated = [k for k, s in enumerate(slack) if s < -noise[k] and k not in active]
        if not violated:
            return -_product(G[active].T, y)
        new = min(violated, key=lambda k: slack[k] / lengths[k])
        column, multiplier = _product(G, _product(G[new : new + 1], N)[0]), 0 * start[new]
        while True:
            shares = inverse @ H[new]
            free = column[new] - H[new] @ shares
            steps = [(y[i] / share, i) for i, share in enumerate(shares) if share > 0]
            if free > ROUNDING * column[new]:
                steps.append((-slack[new] / free, len(active)))
            if not steps:
                raise SweepoptError("C has no point")
            length, last = min(steps)
            y, multiplier = y - length * shares, multiplier + length
            if last == len(active):
                break
            active.pop(last)
            inverse = inverse - np.outer(inverse[last], inverse[last]) / inverse[last, last]
            inverse = np.delete(np.delete(inverse, last, axis=0), last, axis=1)
            H, y = np.delete(H, last, axis=1), np.delete(y, last)
            slack = start + H @ y + multiplier * column
        active.append(new)
        H, y = np.column_stack([H, column]), np.append(y, multiplier)
        bordered = np.append(-shares, 1)
        inverse = np.pad(inverse, (0, 1)) + np.outer(bordered, bordered) / free
    raise SweepoptError("the exact active set was not found")


def _product(G: np.ndarray, X: np.ndarray) -> np.ndarray:
    """G X by the entries of G that are not 0: most rows are those of boxes."""
    terms = ((row[places], places) for row in G for places in [np.flatnonzero(row)])
    return np.array([digits.exactly(row) @ X[places] for row, places in terms], dtype=object)


def in_balls(N: np.ndarray, q: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """The velocity for balls |w_k| <= r_k side by side: the limit of smoother and smoother ones.

    z minimises 1/2 <N z, z> + <q, z> + sum r_k rho_k, rho_k = sqrt(|z_k|^2 + e_k^2) for |z_k|, and
    e_k is a share of the velocity that the forces on the ball alone would cause. Newton's method on
    z and s_k = r_k z_k / rho_k with a line search: with z alone it crawls where e is small
    (Andersen, Christiansen, Conn and Overton, SIAM J. Sci. Comput. 22, 2000).
    """
    radii, block = digits.exactly(radii), len(q) // len(radii)
    places = [slice(k, k + block) for k in range(0, len(q), block)]
    traces = np.array([N[at, at].trace() for at in places])
    unit, z, s = digits.exactly(np.eye(block)), 0 * q, 0 * q

    def lengths(x: np.ndarray, e: Any = 0) -> np.ndarray:
        return digits.sqrt((x * x).reshape(-1, block).sum(axis=1) + e * e)

    def value(z: np.ndarray, e: np.ndarray) -> Any:
        return z @ (N @ z) / 2 + q @ z + radii @ lengths(z, e)

    for share in SMOOTHING:
        e = share * (radii + lengths(q)) / traces
        for _ in range(NEWTON):
            rho, bend = lengths(z, e), 0 * N
            for at, r, root in zip(places, radii, rho, strict=True):
                turn = np.outer(s[at], z[at]) / root**2
                bend[at, at] = r / root * unit - (turn + turn.T) / 2
            pull = np.repeat(radii / rho, block) * z
            slope = N @ z + q + pull
            if (abs(slope) <= share * (abs(N) @ abs(z) + abs(q) + abs(pull))).all():
                break
            dz = -digits.solve(N + bend, slope)
            now, length = value(z, e), Decimal(1)
            while value(z + length * dz, e) > now + length / 10 * (slope @ dz) + share * abs(now):
                length /= 2
            s = pull + bend @ dz
            s *= np.repeat(
                [
                    min(1, r / size) if size else 1
                    for r, size in zip(radii, lengths(s), strict=True)
                ],
                block,
            )
            z = z + length * dz
        else:
            raise SweepoptError("the exact velocity was not found")
    return np.repeat(lengths(z) > 1000 * e, block) * z  # the others are stuck
