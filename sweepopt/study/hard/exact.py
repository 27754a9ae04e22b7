"""The exact velocity of a small program in 80 digits, to judge what double precision answers.

-z in N_C(M z + q) for C = c + E^T S, S a polyhedron or balls: the unknowns beside E z are
eliminated, the rest is solved by the dual active-set method that polyhedra have for rational
numbers. It needs no start, and its answer is taken only if it satisfies the optimality conditions,
so that no solver is favoured. The solution is unique.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from decimal import Decimal, localcontext
from typing import Any, NamedTuple

import numpy as np

from sweepopt.checks import Array, Matrix
from sweepopt.errors import InputError, SweepoptError
from sweepopt.linalg import EPS, dense
from sweepopt.sets import (
    Balls,
    Box,
    ConvexSet,
    Polyhedron,
    exact_multipliers,
    exact_solution,
    shape_of,
)
from sweepopt.velocity import untranslated

STEPS = 500  # of a method that converges fast: this ends what does not
NOISE = Decimal("1e-70")  # relative: of 80 digits, the rest is for what elimination adds
ZERO = Decimal("1e-35")
"""Relative: what normals that differ by 1e-7 leave of each other at condition 1e12 is larger."""
ENOUGH = Decimal("1e-25")  # relative, of a step; the next one would be its square
ROUNDING = 16 * EPS
"""Relative to the forces: a load above its threshold by no more counts as stuck."""

# ---- numbers of 80 digits ---------------------------------------------------------------------


@contextmanager
def precise() -> Iterator[None]:
    """All that is computed within has 80 digits; also a decorator.

    Of radii from 1 to 1e24 at condition 4e9, 60 left 4e-25 of the smallest: more than is enough.
    """
    with localcontext(prec=80):
        yield


def exactly(x: Any) -> Any:
    """Doubles as decimal numbers, without rounding; what is one stays as it is."""
    return np.frompyfunc(Decimal, 1, 1)(x)


def norm(M: Array, z: Array) -> float:
    """sqrt(<z, M z>)."""
    return float((z @ M @ z).sqrt())


def inverse(M: Array) -> Array:
    """M^-1, M symmetric positive definite."""
    return exact_solution(M, exactly(np.eye(len(M))))


# ---- programs ---------------------------------------------------------------------------------


def velocity(C: ConvexSet, N: Array, q: Array) -> Array:
    """z with -z in N_C(N z + q).

    Raises
    ------
    InputError
        If C is neither a polyhedron that states its rows nor made of balls.
    """
    if isinstance(C, Balls):
        return _in_balls(N, q, exactly(C.radii))
    C = Box(C.anchor, C.anchor) if C.singleton else C
    if not isinstance(shape_of(C), (Box, Polyhedron)):
        raise InputError(f"no exact velocity is known for a {type(C).__name__}")
    rows = C.halfspaces()
    G = exactly(dense(rows.N))
    return -_multipliers(N, q, G, exactly(rows.d)) @ G


def _multipliers(P: Array, q: Array, G: Array, h: Array) -> Array:
    """y >= 0 of the rows G w <= h, at w = q - P G^T y nearest to q in the metric of P^-1.

    In the metric of P all rows have about the same length, and faces of width 0 are made as wide as
    their rounding.
    """
    lengths = np.sqrt((G @ P * G).sum(axis=1))
    scale = lengths + (lengths == 0)
    G = G / scale[:, None]
    forces = G @ q
    slack = h / scale - forces
    noise = NOISE * max(abs(forces).max(), -slack.min())
    y = exact_multipliers(G, slack + noise, P.dot, noise, ZERO)
    if y is None:
        raise SweepoptError("C has no point")
    # it is the solution whatever found it: y >= 0, G w <= h, and one of them is 0 in each row
    residual = abs(np.minimum(y, slack + noise + G @ P @ (y @ G)))
    if residual.max() > ENOUGH * max(abs(slack).max(), abs(y).max()):
        raise SweepoptError("the exact velocity was not found")
    return y / scale


def _in_balls(N: Array, q: Array, radii: Array) -> Array:
    """The velocity for balls |w_k| <= r_k side by side, by sequential quadratic programming.

    At a point of C each ball is replaced by the half-space that touches it in this direction; its
    multiplier y_k / r_k bends the objective along the sphere. Where multipliers fall their bend
    falls by no more than 4 a step: without it some steps go round in circles.
    """
    owner = np.repeat(np.arange(len(radii)), len(q) // len(radii))
    ball = exactly(owner == np.arange(len(radii))[:, None])
    V, w, bend = inverse(N), q, 0 * radii
    for _ in range(STEPS):
        size = np.sqrt(ball @ (w * w))  # of objects: their own method, in 80 digits
        normal = w / (size + (size == 0))[owner]
        w, G = normal * np.minimum(size, radii)[owner], ball * normal
        K = np.diag(bend[owner]) - G.T @ (bend[:, None] * G)
        P = inverse(V + K)
        center = q + P @ (K @ (w - q))
        y = _multipliers(P, center, G, radii)
        step = center - P @ (y @ G) - w
        if (abs(step) <= ENOUGH * radii[owner]).all():
            return -y @ G
        w, bend = w + step, np.maximum(y / radii, bend / 4)
    raise SweepoptError("the exact velocity was not found")


# ---- the judge --------------------------------------------------------------------------------


class Exact(NamedTuple):
    """The velocity as decimal numbers, shape (dim,), and sizes in |.|_M.

    Attributes
    ----------
    size : float
        max(|z|_M, |M^-1 q|_M), q the full linear term.
    forces : float
        |M^-1 q|_M + |M^-1 c|_M of C = c + S, which cancel in the full linear term: rounding of
        the two is rounding of the data.
    """

    z: Array
    size: float
    forces: float


class Program:
    """-z in N_C(M z + B u) for many states u and sets C, M = A + gamma B in 80 digits.

    Parameters
    ----------
    A, B : ndarray or sparse, shape (dim, dim)
        Small: the inverse takes dim^3 operations of a microsecond. B may be None.
    gamma : float
    """

    @precise()
    def __init__(self, A: Matrix, B: Matrix | None = None, gamma: float = 0.0) -> None:
        A = exactly(dense(A))
        self._B = 0 * A if B is None else exactly(dense(B))
        self.M = A + exactly(gamma) * self._B
        self._inverse = inverse(self.M)

    @precise()
    def solve(self, u: Array, C: ConvexSet) -> Exact:
        """The velocity at a state: nothing is rounded, not even B u.

        Raises
        ------
        InputError
            If C is none of the kinds that `velocity` knows.
        """
        # C = shift + a set on the unknowns `few`; nothing holds the forces on the others
        if C.selection is not None:
            few, part, shift = C.selection
        else:
            (shift, part), few = untranslated(C), np.arange(C.dim)
        q = self._B @ exactly(u)
        force = q if shift is None else q - exactly(shift)
        W, free = self._inverse, self._inverse @ force
        N = inverse(W[np.ix_(few, few)])
        moves = velocity(part, N, N @ free[few])
        z = W[:, few] @ (N @ (moves + free[few])) - free
        z[few] = moves
        forces = norm(W, q) + norm(W, q - force)
        return Exact(z, max(norm(self.M, z), norm(W, force)), forces)

    @precise()
    def error(self, z: Any, exact: Exact) -> float:
        """|z - z*|_M."""
        return norm(self.M, exactly(z) - exact.z)

    def compare(self, exact: Exact, z: Array, certificate: float) -> tuple[float, float, float]:
        """Error and certificate of a velocity relative to `size`, and their excess.

        The excess is error - certificate in the unit of the forces, less ROUNDING where nothing
        moves.
        """
        error, size = self.error(z, exact), exact.size or 1.0
        allowed = 0.0 if z.any() else ROUNDING
        excess = (error - certificate) / (exact.forces or 1.0) - allowed
        return error / size, certificate / size, excess
