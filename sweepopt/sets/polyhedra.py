"""Polyhedra: { w : G w <= h } and half-spaces, projected by active sets."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.linalg
import scipy.optimize
import scipy.sparse as sp

from sweepopt.checks import divisor, matrix, number, vector
from sweepopt.errors import EmptySetError, InputError, SweepoptError
from sweepopt.linalg import EPS, dense, row_lengths
from sweepopt.sets.active_set import Near, least_distance, projector
from sweepopt.sets.base import (
    ROUNDING,
    ConvexSet,
    Features,
    NormalPair,
    binary,
    same_array,
)
from sweepopt.sets.moving import MovingOffsets
from sweepopt.sets.programs import normal_by_program
from sweepopt.sets.shapes import Orthant

if TYPE_CHECKING:
    import cvxpy as cp

REFINEMENTS = 3  # of a face, and of its nearest point: a long way there rounds
ACTIVE_DIM = 1000  # up to here the active-set projection is used, beyond a sparse QP


class _Normal(NamedTuple):
    """A normal of a polyhedron, and the rows that it is made of."""

    normal: np.ndarray
    active: np.ndarray


class _Face:
    """Independent rows with equality, in the metric of 1 / tau, `units` the root of tau."""

    def __init__(self, rows: np.ndarray, h: np.ndarray, units: np.ndarray) -> None:
        self.rows, self._h, self._units = rows, h, units
        self._Q, self._R = np.linalg.qr((rows * units).T)

    def nearest(self, w: np.ndarray) -> np.ndarray:
        """The point of the face nearest to w."""
        missed = scipy.linalg.solve_triangular(self._R, self.missed(w), trans=1)
        return w - self._units * (self._Q @ missed)

    def missed(self, w: np.ndarray) -> np.ndarray:
        """By how much w misses the face."""
        return np.asarray(self.rows @ w - self._h)

    def multipliers(self, p: np.ndarray) -> np.ndarray:
        """y with the sum of y_k times the rows nearest to p."""
        return scipy.linalg.solve_triangular(self._R, self._Q.T @ (self._units * p))


class Polyhedron(ConvexSet):
    """{ w : G w <= h }:  sigma(z) = min { <h, y> : G^T y = z, y >= 0 }.

    Parameters
    ----------
    G : array_like or sparse, shape (m, dim)
    h : array_like, shape (m,), or callable t -> (m,)
        With a callable the set moves: C(t) = { w : G w <= h(t) }.

    Raises
    ------
    InputError
        If G or h is not finite, or h does not have a number for each row of G.
    EmptySetError
        From `project`, `support` and `require_nonempty`, if no w satisfies G w <= h.

    Examples
    --------
    >>> triangle = Polyhedron([[-1, 0], [0, -1], [1, 1]], [0, 0, 1])
    >>> triangle.project([1.0, 1.0])
    array([0.5, 0.5])
    """

    polyhedral = True

    def __new__(cls, G: Any, h: Any) -> Any:
        if callable(h):
            G = matrix("G", G)
            return MovingOffsets(cls(G, np.zeros(G.shape[0])), h)
        return super().__new__(cls)

    def __init__(self, G: Any, h: Any) -> None:
        self.G = matrix("G", G)
        self.dim = self.G.shape[1]
        if not self.dim:
            raise InputError("G must have at least one column")
        self.exact = self.certifiable = self.dim <= ACTIVE_DIM
        largest = abs(self.G).max(axis=1)
        largest = (largest.toarray() if sp.issparse(self.G) else largest).ravel()
        rows = np.flatnonzero(largest)
        if rows.size:
            i = int(rows[np.argmin(largest[rows])])
            divisor(f"the largest entry of row {i} of G", largest[i])
        # programs see rows of numbers near 1
        self._units = np.array([binary(row) for row in largest])
        self._set_offsets(h)

    def __getnewargs__(self) -> tuple[Any, Any]:
        return self.G, self.h  # for copy and pickle

    def _set_offsets(self, h: Any) -> None:
        self.h = vector("h", h, self.G.shape[0], finite=False)
        self.offsets = self.h / self._units
        if np.isinf(self.h).any():
            i = int(np.flatnonzero(np.isinf(self.h))[0])
            raise InputError(f"h[{i}] is {self.h[i]}; leave out rows without a bound")

    def with_offsets(self, h: Any) -> Polyhedron:
        """{ w : G w <= h } with the same matrix object, so that `same_cone` is free."""
        other = object.__new__(Polyhedron)
        other.G, other.dim = self.G, self.dim
        other.exact, other.certifiable = self.exact, self.certifiable
        other._units = self._units
        other._set_offsets(h)
        return other

    def support(self, z: np.ndarray) -> float:
        z = vector("z", z, self.dim)
        size = float(np.abs(z).max(initial=0.0))
        if not size or not self.h.size:
            return 0.0 if not size else float("inf")
        # seen from a point of the set: h - G x >= 0 is as large as the set, wherever that is
        inside = self.project(np.zeros(self.dim))
        slack = np.maximum(self.h - self.G @ inside, 0.0)
        # rows of length 1: HiGHS looks at absolute numbers
        lengths = row_lengths(self.G)
        weights = 1 / np.where(lengths > 0, lengths, 1.0)
        slack = weights * slack
        rows = self.G.T * weights
        scale = float(slack.max()) or 1.0
        result = scipy.optimize.linprog(
            slack / scale,
            A_eq=rows,
            b_eq=z / size,
            method="highs",
            options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
        )
        if result.status == 2:
            return float("inf")
        if result.fun is None:
            raise SweepoptError(f"HiGHS failed on the support function: {result.message}")
        return float(inside @ z) + size * scale * float(result.fun)

    def normal(self, v: np.ndarray) -> np.ndarray:
        v = vector("v", v, self.dim)
        exact = self._exact_normal(v, np.ones(self.dim))
        return normal_by_program(self, v).p if exact is None else exact.normal

    def _exact_normal(
        self, v: np.ndarray, tau: np.ndarray, near: np.ndarray | None = None
    ) -> _Normal | None:
        """(v - w) / tau from the active rows, w the nearest point in the metric of 1 / tau.

        None in large dimensions and where the rows are not found. Where v is far away, a point
        `near` w tells rows that rounding of v hides.
        """
        slack = self.h - self.G @ v
        if (slack >= 0).all():
            return _Normal(np.zeros(self.dim), np.zeros(0, dtype=int))
        if self.dim > ACTIVE_DIM:
            return None
        units = np.sqrt(tau)
        G = self.G @ sp.diags_array(units) if sp.issparse(self.G) else self.G * units
        beside = None if near is None else Near(self.h - self.G @ near, self._rounding(near))
        found = least_distance(G, slack, self._rounding(v), beside)
        return None if found is None else _Normal(0.0 - found.u / units, found.active)

    def project(self, w: np.ndarray) -> np.ndarray:
        w = vector("w", w, self.dim)
        return w - self.normal(w)

    def derivative(self, v: np.ndarray) -> np.ndarray | None:
        found = self._exact_normal(v, np.ones(self.dim))
        if found is None:
            return None
        return np.eye(self.dim) - projector(dense(self.G[found.active]))

    def normal_pair(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray | None = None
    ) -> NormalPair | None:
        v, near = w + tau * p, w
        for _ in range(REFINEMENTS):
            found = self._exact_normal(v, tau, near)
            if found is None:
                return None
            inside = v - tau * found.normal
            if not found.active.size:
                return NormalPair(found.normal, w if self._has(w, found.active, w) else inside, 0.0)
            # v is rounded where tau * p is large beside w: on the face of the normal w and p are,
            # once more
            face = _Face(dense(self.G[found.active]), self.h[found.active], np.sqrt(tau))
            multipliers = face.multipliers(p)
            if (multipliers < 0).any():
                multipliers = np.maximum(face.multipliers(found.normal), 0.0)
            normal = face.rows.T @ multipliers
            for start in (w, inside):
                near = start
                for _ in range(REFINEMENTS):
                    near = face.nearest(near)
                    if self._has(near, found.active, start):
                        return NormalPair(normal, near, 0.0)
        return NormalPair(normal, inside, float(multipliers @ np.abs(face.missed(inside))))

    def _has(self, w: np.ndarray, active: np.ndarray, start: np.ndarray) -> bool:
        """Whether w is in C, and on the rows that are active, but for rounding on the way there."""
        slack = self.h - self.G @ w
        rounding = self._rounding(np.abs(w) + EPS * np.abs(start))
        return bool((slack >= -rounding).all() and (slack <= rounding)[active].all())

    def _rounding(self, w: np.ndarray) -> np.ndarray:
        return ROUNDING * (np.abs(self.h) + abs(self.G) @ np.abs(w))

    def nearest(self, w: np.ndarray, tau: np.ndarray) -> np.ndarray:
        found = self._exact_normal(w, tau)
        return self.project(w) if found is None else w - tau * found.normal

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        y = cp.Variable(self.h.size)
        rows = (
            self.G.T @ sp.diags_array(1 / self._units)
            if sp.issparse(self.G)
            else (self.G.T / self._units)
        )
        return Features([y], [rows @ y == p, y >= 0])

    def same_cone(self, other: ConvexSet) -> bool:
        return isinstance(other, Polyhedron) and same_array(self.G, other.G)

    def rows(self) -> tuple[Any, np.ndarray] | None:
        return self.G, self.h

    def require_nonempty(self, where: str = "C") -> None:
        try:
            self.project(np.zeros(self.dim))
        except EmptySetError as error:
            raise EmptySetError(f"{where} is empty: no w satisfies G w <= h") from error

    def polar(self) -> ConvexSet:
        if self.h.any():
            return super().polar()
        return self.algebra.image(self.G.T, Orthant(self.h.size))


class HalfSpace(Polyhedron):
    """{ w : <normal, w> <= offset }:  sigma(s normal) = s offset for s >= 0, +inf elsewhere.

    Parameters
    ----------
    normal : array_like, shape (dim,), not zero
    offset : float

    Raises
    ------
    InputError
        If normal is zero, or an entry is not finite.

    Examples
    --------
    >>> HalfSpace([3.0, 4.0], 5.0).project([3.0, 4.0])
    array([0.6, 0.8])
    """

    def __new__(cls, normal: Any, offset: Any) -> Any:
        return object.__new__(cls)  # the offset is a number: this set does not move

    def __init__(self, normal: Any, offset: float) -> None:
        row = vector("normal", normal)
        self.offset = number("offset", offset)
        if not row.any():
            raise InputError("normal must not be zero")
        super().__init__(row[None, :], [self.offset])
        self.exact = self.certifiable = True

    def support(self, z: np.ndarray) -> float:
        z = vector("z", z, self.dim)
        row, length = self.G[0], float(np.linalg.norm(self.G[0]))
        factor = float(row @ (z / length)) / length
        # z must be a multiple of the row up to rounding
        if factor < 0 or np.linalg.norm(z - factor * row) > ROUNDING * np.linalg.norm(z):
            return float("inf")
        return factor * self.offset

    def _exact_normal(
        self, v: np.ndarray, tau: np.ndarray, near: np.ndarray | None = None
    ) -> _Normal:
        row = self.G[0]
        length = float(np.linalg.norm(row * np.sqrt(tau)))
        excess = float(row @ v) - self.offset
        return _Normal(max(excess, 0.0) / length * (row / length), np.flatnonzero([excess > 0]))

    def _distance(self, other: ConvexSet) -> float | None:
        if not (isinstance(other, HalfSpace) and same_array(self.G, other.G)):
            return None
        return abs(self.offset - other.offset) / float(np.linalg.norm(self.G))
