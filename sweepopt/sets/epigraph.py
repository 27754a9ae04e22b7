"""The support function of a set as a person writes it in cvxpy: atoms, and the set's own data.

`features` states the same for programs that are compiled: linear in the offsets, with matrices of
numbers near 1. Here nothing is scaled, data and variables have names. A set that is made of others,
{ sum_k E_k s_k : s_k in S_k, sum_k F_k s_k = 0 }, has the support function

    sigma(C, p) = min over lam of  sum_k sigma(S_k, E_k^T p + F_k^T lam).
"""

from __future__ import annotations

from operator import eq, ge, le
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from sweepopt.sets.aligned import Aligned
from sweepopt.sets.balls import Ball, Balls, Ellipsoid
from sweepopt.sets.base import ConvexSet, placed, same_array
from sweepopt.sets.polyhedra import Polyhedron
from sweepopt.sets.polytope import Polytope
from sweepopt.sets.shapes import Box, Point

if TYPE_CHECKING:
    import cvxpy as cp


def epigraph(C: ConvexSet, p: cp.Expression) -> tuple[cp.Expression, list[cp.Constraint]]:
    """value and constraints with sigma(C, p) = min { value : constraints }."""
    import cvxpy as cp

    statement = Statement()
    value = cp.Expression.cast_to_const(statement.sigma(C, p))
    return value, statement.constraints


class Statement:
    """What the parts of C add to its support function: constraints, and names that differ."""

    def __init__(self) -> None:
        self.constraints: list[cp.Constraint] = []
        self._names: list[str] = []

    def name(self, letter: str) -> str:
        """g, g_2, ... in the order in which they appear."""
        self._names.append(letter)
        return f"{letter}_{self._names.count(letter)}".removesuffix("_1")

    def data(self, letter: str, value: Any) -> cp.Constant:
        import cvxpy as cp

        return cp.Constant(value, self.name(letter))

    def sigma(self, C: ConvexSet, p: cp.Expression) -> Any:
        """The value; a set that has no line here is stated by its features."""
        import cvxpy as cp

        match C:
            case Point():
                return self.data("c", C.anchor) @ p if C.anchor.any() else 0
            case Box():
                return self.box(C, p)
            case Ball():
                norm = cp.norm(p)
                value = norm if C.radius == 1 else C.radius * norm
                return self.sigma(Point(C.center), p) + value
            case Balls():
                arms = cp.reshape(p, (C.radii.size, C.block), order="C")
                return self.data("g", C.radii) @ cp.norm(arms, min(C.block, 2), axis=1)
            case Ellipsoid():
                return self.sigma(Point(C.center), p) + cp.norm(self.data("R", C.root) @ p)
            case Polytope():
                return cp.max(self.data("V", C.vertices) @ p)
            case Polyhedron():
                y = cp.Variable(C.h.size, self.name("y"), nonneg=True)
                self.constraints.append(self.data("G", C.G).T @ y == p)
                return self.data("h", C.h) @ y
            case Aligned() if C.whole:
                r = abs(C.factor)
                value = self.sigma(C.parts[0], p if C.factor > 0 else -p)
                value = value if r == 1 else r * value
                return value if C.v is None else self.sigma(Point(C.v), p) + value
        E, F, parts = C.form()
        if parts == (C,):
            y, ties = C.features(p)
            self.constraints += ties
            return self.data("h", C.offsets) @ cp.hstack(y) if y else 0
        value, lam = 0, cp.Variable(F.shape[0], self.name("lam")) if F.shape[0] else None
        for S, at in placed(parts):
            x = self.transposed("E", E[:, at], p) + self.transposed("F", F[:, at], lam)
            value += self.sigma(S, x)
        return value

    def transposed(self, letter: str, M: sp.csr_array, p: cp.Expression) -> Any:
        """M^T p; p itself for a unit matrix, 0 for one without entries."""
        if not M.nnz:
            return 0
        unit = same_array(M, sp.eye_array(p.size, format="csr"))
        return p if unit else self.data(letter, M).T @ p

    def box(self, C: Box, p: cp.Expression) -> Any:
        """sum_k g_k |p_k| where C is symmetric; without a bound p has one sign."""
        import cvxpy as cp

        low, up = np.isfinite([C.lower, C.upper])
        for at, sign in ((~up & ~low, eq), (~up & low, le), (~low & up, ge)):
            if at.any():
                self.constraints.append(sign(p if at.all() else p[np.flatnonzero(at)], 0))
        lower = np.where(low, C.lower, np.where(up, C.upper, 0))
        upper = np.where(up, C.upper, lower)
        if np.array_equal(lower, -upper):
            return self.data("g", upper) @ cp.abs(p) if upper.any() else 0
        ends = {"lower": lower, "upper": upper}
        return cp.sum(cp.maximum(*(cp.multiply(self.data(*end), p) for end in ends.items())))
