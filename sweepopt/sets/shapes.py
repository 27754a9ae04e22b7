"""Points and boxes, cones and the whole space among them: projected entry by entry."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Array, dimension, entries, read_only, vector
from sweepopt.errors import EmptySetError
from sweepopt.sets.base import (
    DENSE,
    ConvexSet,
    Features,
    Halfspaces,
    Selection,
    difference,
)
from sweepopt.sets.curves import products

if TYPE_CHECKING:
    import cvxpy as cp

FEW = 1000
"""Unknowns of a box, and a quarter of all, up to which the others are worth eliminating. In a plane
body 1,000 of 10,000 take 1.6 s so and 2.8 s whole, 625 of 2,500 0.6 and 0.8, 1,250 2.3 and 0.8."""


class Box(ConvexSet):
    """{ w : lower <= w <= upper }, entries may be infinite:  sigma(z) = sum max(lower z, upper z).

    Parameters
    ----------
    lower, upper : array_like, shape (dim,)

    Raises
    ------
    InputError
        If the bounds are empty, nan or of two lengths.
    EmptySetError
        If lower > upper in an entry.

    Examples
    --------
    >>> Box([-1, -2], [1, 2]).support([1, 1])
    3.0
    """

    polyhedral, fixed = True, ("_low", "_up")
    block = 1

    def __init__(self, lower: Any, upper: Any) -> None:
        self.lower = entries("lower", lower, finite=False)
        self.upper = read_only(vector("upper", upper, self.lower.size, finite=False))
        self.dim = self.lower.size
        bad = (self.lower > self.upper) | (self.lower == np.inf) | (self.upper == -np.inf)
        if bad.any():
            i = int(np.flatnonzero(bad)[0])
            raise EmptySetError(
                f"Box is empty: lower[{i}] = {self.lower[i]:g}, upper[{i}] = {self.upper[i]:g}; "
                "lower must not be above upper, as in Box(-g, g) with g >= 0"
            )
        self._low, self._up = np.isfinite(self.lower), np.isfinite(self.upper)
        self.offsets = np.concatenate([self.upper[self._up], -self.lower[self._low]])

    def with_offsets(self, h: Array) -> Box:
        """The box with other finite bounds, in the order of `offsets`."""
        lower, upper = self.lower.copy(), self.upper.copy()
        upper[self._up], negative = np.split(h, [self._up.sum()])
        lower[self._low] = -negative
        return Box(lower, upper)

    @cached_property
    def selection(self) -> Selection | None:
        few = np.flatnonzero(self.lower < self.upper)
        if not 0 < few.size <= min(self.dim / 4, FEW):
            return None
        shift = np.where(self.lower < self.upper, 0.0, self.lower)
        part = Box(self.lower[few], self.upper[few])
        return Selection(few, part, shift if shift.any() else None)

    def support(self, z: Array) -> float:
        moving = z != 0
        side = np.where(z > 0, self.upper, self.lower)
        return float(side[moving] @ z[moving])

    def project(self, w: Array) -> Array:
        return np.minimum(np.maximum(w, self.lower), self.upper)

    def project_rows(self, rows: Array) -> Array:
        return np.minimum(np.maximum(rows, self.lower), self.upper)

    def is_inside(self, w: Array, distance: float) -> bool:
        return bool(((w - self.lower >= distance) & (self.upper - w >= distance)).all())

    def gaps_along_curves(self, p: Array, w: Array, sizes: Array) -> Array:
        # entry by entry: what cancels cancels to 0.0
        p, w = p[:, :, None], w[:, None]
        side = np.where(p > 0, self.upper, self.lower)
        slack = np.subtract(side, w, out=np.zeros(side.shape[:2] + w.shape[2:]), where=p != 0)
        each = np.maximum((slack * p).sum(axis=3), 0.0)
        gaps: Array = (products(2, 3) * sizes[:, None] * each).sum(axis=(1, 2))
        return gaps

    def features(self, p: cp.Expression) -> Features:
        return rows_features(self._matrix, p)

    def weights(self, tau: Array) -> Array:
        return tau

    def derivative(self, v: Array) -> Array:
        free = (v >= self.lower) & (v <= self.upper) & (self.lower < self.upper)
        return free.astype(float)

    def factors(self) -> list[ConvexSet]:
        bounds = zip(self.lower[:, None], self.upper[:, None], strict=True)
        return [Box(*each) for each in bounds]

    def magnitude(self) -> float:
        return float(np.linalg.norm(np.maximum(abs(self.lower), abs(self.upper))))

    def _distance(self, other: ConvexSet) -> float | None:
        if not isinstance(other, Box):
            return None
        below, above = difference(other.lower, self.lower), difference(self.upper, other.upper)
        ways = ((below, above), (-below, -above))  # from one box to the other and back
        return max(float(np.linalg.norm(np.maximum(0.0, np.maximum(*way)))) for way in ways)

    @cached_property
    def _matrix(self) -> Any:
        """G of { w : G w <= offsets }."""
        if self.dim <= DENSE:  # sparse ones take half of what compiling a program takes
            identity = np.eye(self.dim)
            return np.concatenate([identity[self._up], -identity[self._low]])
        identity = sp.eye_array(self.dim, format="csr")
        return sp.vstack([identity[self._up], -identity[self._low]], format="csr")

    def halfspaces(self) -> Halfspaces:
        return Halfspaces.below(self._matrix, self.offsets)

    def polar(self) -> ConvexSet:
        if self.offsets.any():
            return super().polar()
        # componentwise: {0} <-> R, [0, inf) <-> (-inf, 0]
        return Box(np.where(self._low, -np.inf, 0.0), np.where(self._up, np.inf, 0.0))


class Point(Box):
    """The single point {p}:  sigma(z) = <p, z>.  Its process is linear.

    Parameters
    ----------
    p : array_like, shape (dim,)

    Raises
    ------
    InputError
        If p is empty or not finite.

    Examples
    --------
    >>> Point([1.0, 2.0]).support([3.0, 4.0])
    11.0
    """

    singleton = True

    def __init__(self, p: Any) -> None:
        self.p = self.lower = self.upper = self.offsets = entries("p", p)
        self.dim = self.offsets.size
        self._low = self._up = np.ones(self.dim, bool)

    def with_offsets(self, h: Array) -> Point:
        return Point(h)

    def features(self, p: cp.Expression) -> Features:
        return Features([p], [])

    def halfspaces(self) -> Halfspaces:
        return Halfspaces(np.zeros((0, self.dim)), np.zeros(0), np.eye(self.dim), self.offsets)

    @property
    def anchor(self) -> Array:
        return self.offsets


class Orthant(Box):
    """The cone { w : w >= 0 }:  sigma is the indicator of { z <= 0 }.

    Parameters
    ----------
    dim : int

    Raises
    ------
    InputError
        If dim is not a positive whole number.

    Examples
    --------
    >>> Orthant(2).project([1.0, -1.0])
    array([1., 0.])
    """

    def __init__(self, dim: int) -> None:
        dim = dimension(dim)
        super().__init__(np.zeros(dim), np.full(dim, np.inf))


class WholeSpace(Box):
    """R^dim:  sigma(z) = 0 at z = 0 and +inf elsewhere; a body that it governs never moves.

    Parameters
    ----------
    dim : int

    Raises
    ------
    InputError
        If dim is not a positive whole number.

    Examples
    --------
    >>> WholeSpace(2).support([0.0, 1.0])
    inf
    """

    def __init__(self, dim: int) -> None:
        dim = dimension(dim)
        super().__init__(np.full(dim, -np.inf), np.full(dim, np.inf))


def rows_features(G: Any, p: cp.Expression) -> Features:
    """Those of { w : G w <= h } with offsets h:  sigma(p) = min { <h, y> : G^T y = p, y >= 0 }."""
    import cvxpy as cp

    y = cp.Variable(G.shape[0])
    return Features([y], [G.T @ y == p, y >= 0])
