"""The program  -z in N_C(N z + q)  in 80 digits, by linear complementarity problems.

It needs no start, so that no solver's answer is favoured.
"""

from __future__ import annotations

from decimal import Decimal

import numpy as np

from sweepopt.errors import InputError, SweepoptError
from sweepopt.linalg import dense
from sweepopt.sets import Balls, Box, ConvexSet, Polyhedron, shape_of
from sweepopt.study.hard import digits

STEPS = 500  # of a method that is finite or converges fast: this ends what is not
ROUNDING = Decimal("1e-70")  # relative: of 80 digits, the rest is for what elimination adds
ZERO = Decimal(
    "1e-35"
)  # relative: pivots of normals that differ by 1e-7 at condition 1e12 are larger
ENOUGH = Decimal("1e-25")  # relative, of a step; the next one would be its square


def velocity(C: ConvexSet, N: np.ndarray, q: np.ndarray) -> np.ndarray:
    """z with -z in N_C(N z + q).

    Raises
    ------
    InputError
        If C is neither a polyhedron that states its rows nor made of balls.
    """
    if isinstance(C, Balls):
        return _in_balls(N, q, digits.exactly(C.radii))
    C = Box(C.anchor, C.anchor) if C.singleton else C
    if not isinstance(shape_of(C), (Box, Polyhedron)):
        raise InputError(f"no exact velocity is known for a {type(C).__name__}")
    rows = C.halfspaces()
    G = digits.exactly(dense(rows.N))
    return -_multipliers(N, q, G, digits.exactly(rows.d)) @ G


def _multipliers(P: np.ndarray, q: np.ndarray, G: np.ndarray, h: np.ndarray) -> np.ndarray:
    """y >= 0 of the rows G w <= h, at w = q - P G^T y nearest to q in the metric of P^-1.

    Rows that are violated join the problem until there are none. In the metric of P all rows have
    about the same length, and faces of width 0 are made as wide as their rounding.
    """
    lengths = np.sqrt(np.einsum("ij,jk,ik->i", *(x.astype(float) for x in (G, P, G))))
    scale = digits.exactly(lengths + (lengths == 0))
    G = G / scale[:, None]
    noise = ROUNDING * abs(G @ q).max()
    slack = h / scale - G @ q + noise
    y, active = 0 * h, np.zeros(len(h), dtype=bool)
    for _ in range(STEPS):
        violated = (slack + G @ (P @ (y @ G)) < -noise) & ~active
        if not violated.any():
            return y / scale
        active |= violated
        y[active] = _complementary(G[active] @ P @ G[active].T, slack[active])
    raise SweepoptError("the exact active set was not found")


def _complementary(H: np.ndarray, b: np.ndarray) -> np.ndarray:
    """y >= 0 with s = H y + b >= 0 and <s, y> = 0, some b < 0 and H semidefinite.

    Lemke's method (Cottle, Pang and Stone, The Linear Complementarity Problem, 4.4): y and s stay
    complementary in s = H y + b + e y_0 while y_0 falls to 0. The columns of the tableau are those
    of s, y and y_0, the last one is the value of the basis.
    """
    m = len(b)
    unit, ones = digits.exactly(np.eye(m)), digits.exactly(np.ones(m))
    table = np.column_stack([unit, -H, -ones, b])
    basis, row, column = np.arange(m), b.argmin(), 2 * m
    for _ in range(STEPS):
        leaving, basis[row] = int(basis[row]), column
        digits.eliminate(table, row, column)
        values = 0 * table[0]
        values[basis] = table[:, -1]
        if values[2 * m] <= ROUNDING * abs(b).max():
            return values[m : 2 * m]
        column = (leaving + m) % (2 * m)
        falls = table[:, column]
        rows = np.flatnonzero(falls > ZERO * abs(falls).max())
        if not rows.size:
            break
        row = rows[(table[rows, -1] / falls[rows]).argmin()]
    raise SweepoptError("C has no point")


def _in_balls(N: np.ndarray, q: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """The velocity for balls |w_k| <= r_k side by side, by sequential quadratic programming.

    At a point of C each ball is replaced by the half-space that touches it in this direction; its
    multiplier y_k / r_k bends the objective along the sphere. Where multipliers fall their bend
    falls by no more than 4 a step: without it some steps go round in circles.
    """
    owner = np.repeat(np.arange(len(radii)), len(q) // len(radii))
    ball = digits.exactly(owner == np.arange(len(radii))[:, None])
    V, w, bend = digits.inverse(N), q, 0 * radii
    for _ in range(STEPS):
        size = digits.sqrt(ball @ (w * w))
        normal = w / (size + (size == 0))[owner]
        w, G = normal * np.minimum(size, radii)[owner], ball * normal
        K = np.diag(bend[owner]) - G.T @ (bend[:, None] * G)
        P = digits.inverse(V + K)
        center = q + P @ (K @ (w - q))
        y = _multipliers(P, center, G, radii)
        step = center - P @ (y @ G) - w
        if (abs(step) <= ENOUGH * radii[owner]).all():
            return -y @ G
        w, bend = w + step, np.maximum(y / radii, bend / 4)
    raise SweepoptError("the exact velocity was not found")
