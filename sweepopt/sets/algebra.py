"""Operations on sets, lazy: each node states its law for sigma, for the projection and for y.

    sigma(C + v, z) = sigma(C, z) + <v, z>          sigma(C + D, z) = sigma(C, z) + sigma(D, z)
    sigma(r C, z)   = r sigma(C, z),  r >= 0        sigma(-C, z)    = sigma(C, -z)
    sigma(C x D)    = sum of the parts              sigma(M C, z)   = sigma(C, M^T z)
    sigma(C & D, z) = min { sigma(C, p) + sigma(D, z - p) }   (and its closure)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import matrix, number, vector
from sweepopt.errors import EmptySetError, InputError
from sweepopt.sets.base import (
    ROUNDING,
    ConvexSet,
    Features,
    Witness,
    project_by_program,
    same_array,
    support_by_program,
)
from sweepopt.sets.shapes import Box, Point

if TYPE_CHECKING:
    import cvxpy as cp

SWEEPS = 500  # alternating projections before a program takes over


class Translation(ConvexSet):
    """C + v."""

    def __init__(self, part: ConvexSet, v: Any) -> None:
        self.part, self.v, self.dim = part, vector("v", v, part.dim), part.dim
        self.offsets = np.concatenate([self.v, part.offsets])
        self.polyhedral = part.polyhedral

    def support(self, z: np.ndarray) -> float:
        return self.part.support(z) + float(self.v @ z)

    def project(self, w: np.ndarray) -> np.ndarray:
        return self.part.project(vector("w", w, self.dim) - self.v) + self.v

    def features(self, p: cp.Expression) -> Features:
        y, constraints = self.part.features(p)
        return Features([p, *y], constraints)

    def witness(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray
    ) -> Witness | None:
        found = self.part.witness(p, w - self.v, tau, y[self.dim :])
        return found and found._replace(w=found.w + self.v)

    def same_cone(self, other: ConvexSet) -> bool:
        return isinstance(other, Translation) and self.part.same_cone(other.part)

    def require_nonempty(self, where: str = "C") -> None:
        self.part.require_nonempty(where)

    def magnitude(self) -> float:
        return self.part.magnitude() + float(np.linalg.norm(self.v))

    @property
    def anchor(self) -> np.ndarray:
        return self.v + self.part.anchor

    @property
    def nonsmooth_dim(self) -> int:
        return self.part.nonsmooth_dim


class Scaling(ConvexSet):
    """r C for r > 0."""

    def __init__(self, factor: float, part: ConvexSet) -> None:
        self.factor, self.part, self.dim = factor, part, part.dim
        self.offsets = factor * part.offsets
        self.polyhedral = part.polyhedral

    def support(self, z: np.ndarray) -> float:
        return self.factor * self.part.support(z)

    def project(self, w: np.ndarray) -> np.ndarray:
        return self.factor * self.part.project(vector("w", w, self.dim) / self.factor)

    def features(self, p: cp.Expression) -> Features:
        return self.part.features(p)

    def witness(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray
    ) -> Witness | None:
        found = self.part.witness(p, w / self.factor, tau / self.factor, y)
        return found and Witness(found.p, self.factor * found.w, self.factor * found.gap)

    def same_cone(self, other: ConvexSet) -> bool:
        return isinstance(other, Scaling) and self.part.same_cone(other.part)

    def require_nonempty(self, where: str = "C") -> None:
        self.part.require_nonempty(where)

    def magnitude(self) -> float:
        return self.factor * self.part.magnitude()

    @property
    def nonsmooth_dim(self) -> int:
        return self.part.nonsmooth_dim

    def polar(self) -> ConvexSet:
        return self.part.polar()


class Negation(ConvexSet):
    """-C."""

    def __init__(self, part: ConvexSet) -> None:
        self.part, self.dim, self.offsets = part, part.dim, part.offsets
        self.polyhedral = part.polyhedral

    def support(self, z: np.ndarray) -> float:
        return self.part.support(-np.asarray(z, dtype=float))

    def project(self, w: np.ndarray) -> np.ndarray:
        return -self.part.project(-np.asarray(w, dtype=float))

    def features(self, p: cp.Expression) -> Features:
        return self.part.features(-p)

    def witness(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray
    ) -> Witness | None:
        found = self.part.witness(-p, -w, tau, y)
        return found and Witness(-found.p, -found.w, found.gap)

    def same_cone(self, other: ConvexSet) -> bool:
        return isinstance(other, Negation) and self.part.same_cone(other.part)

    def require_nonempty(self, where: str = "C") -> None:
        self.part.require_nonempty(where)

    def magnitude(self) -> float:
        return self.part.magnitude()

    @property
    def nonsmooth_dim(self) -> int:
        return self.part.nonsmooth_dim

    def polar(self) -> ConvexSet:
        return -self.part.polar()

    def __neg__(self) -> ConvexSet:
        return self.part


class Sum(ConvexSet):
    """The Minkowski sum C + D."""

    def __init__(self, first: ConvexSet, second: ConvexSet) -> None:
        require_same_dim("C + D", first, second)
        self.first, self.second, self.dim = first, second, first.dim
        self.offsets = np.concatenate([first.offsets, second.offsets])
        self.polyhedral = first.polyhedral and second.polyhedral

    def support(self, z: np.ndarray) -> float:
        return self.first.support(z) + self.second.support(z)

    def project(self, w: np.ndarray) -> np.ndarray:
        w = vector("w", w, self.dim)
        parts = self._nearest(w)
        return project_by_program(self, w) if parts is None else parts[0] + parts[1]

    def _nearest(self, w: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Points of C and D whose sum is nearest to w, by alternating projections."""
        second = self.second.project(np.zeros(self.dim))
        for _ in range(SWEEPS):
            first = self.first.project(w - second)
            moved = self.second.project(w - first) - second
            second = second + moved
            if np.abs(moved).max() <= ROUNDING * max(np.abs(w).max(), np.abs(second).max()):
                return first, second
        return None

    def features(self, p: cp.Expression) -> Features:
        y, constraints = self.first.features(p)
        more, others = self.second.features(p)
        return Features([*y, *more], [*constraints, *others])

    def witness(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray
    ) -> Witness | None:
        k = self.first.offsets.size
        step = float(np.mean(tau))
        v = w + step * p
        parts = self._nearest(v)
        first = self.first.project(w) if parts is None else parts[0]
        one = self.first.witness(p, first, tau, y[:k])
        if one is None or self.second.witness(p, w - first, tau, y[k:]) is None:
            return None
        if parts is not None:
            return Witness((v - parts[0] - parts[1]) / step, parts[0] + parts[1], 0.0)
        # no split to rounding: keep p, take exposed parts and pay the gap
        second = self.second.project(w - first)
        gap = self.support(p) - float(p @ (first + second))
        return Witness(p, first + second, max(gap, 0.0))

    def same_cone(self, other: ConvexSet) -> bool:
        return (
            isinstance(other, Sum)
            and self.first.same_cone(other.first)
            and self.second.same_cone(other.second)
        )

    def require_nonempty(self, where: str = "C") -> None:
        self.first.require_nonempty(where)
        self.second.require_nonempty(where)

    def magnitude(self) -> float:
        return self.first.magnitude() + self.second.magnitude()

    @property
    def anchor(self) -> np.ndarray:
        return self.first.anchor + self.second.anchor


class Intersection(ConvexSet):
    """C & D, non-empty."""

    def __init__(self, first: ConvexSet, second: ConvexSet) -> None:
        require_same_dim("C & D", first, second)
        self.first, self.second, self.dim = first, second, first.dim
        # y starts with p_1 of the split p = p_1 + p_2, at no cost: its offsets are zero
        self.offsets = np.concatenate([np.zeros(self.dim), first.offsets, second.offsets])
        self.polyhedral = first.polyhedral and second.polyhedral

    def support(self, z: np.ndarray) -> float:
        z = vector("z", z, self.dim)
        size = float(np.abs(z).max())
        return size * support_by_program(self, z / size) if size else 0.0

    def project(self, w: np.ndarray) -> np.ndarray:
        w = vector("w", w, self.dim)
        split = self._split(w, np.zeros(self.dim))
        return project_by_program(self, w) if split is None else w - split[0] - split[1]

    def _split(self, v: np.ndarray, one: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """p_1 in N_C(w), p_2 in N_D(w) with w = v - p_1 - p_2, by Dykstra's alternation from p_1.

        Boyle and Dykstra (1986); each half sweep minimises the dual in one of the two.
        """
        two = v - one - self.second.project(v - one)
        for _ in range(SWEEPS):
            moved = v - two - self.first.project(v - two) - one
            one = one + moved
            two = v - one - self.second.project(v - one)
            if np.abs(moved).max() <= ROUNDING * max(np.abs(v).max(), np.abs(one).max()):
                return one, two
        return None

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        one = cp.Variable(self.dim)
        y, constraints = self.first.features(one)
        more, others = self.second.features(p - one)
        return Features([one, *y, *more], [*constraints, *others])

    def witness(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray
    ) -> Witness | None:
        hint, k = y[: self.dim], self.dim + self.first.offsets.size
        step = float(np.mean(tau))
        one = self.first.witness(hint, w, tau, y[self.dim : k])
        two = self.second.witness(p - hint, w, tau, y[k:])
        if one is None or two is None:
            return None
        v = w + step * p
        split = self._split(v, step * hint)
        if split is not None:
            return Witness((split[0] + split[1]) / step, v - split[0] - split[1], 0.0)
        # no split to rounding: the parts' own normals at a common point, and their gap
        inside = project_by_program(self, w)
        gap = one.gap + two.gap + one.p @ (one.w - inside) + two.p @ (two.w - inside)
        return Witness(one.p + two.p, inside, max(float(gap), 0.0))

    def same_cone(self, other: ConvexSet) -> bool:
        return (
            isinstance(other, Intersection)
            and self.first.same_cone(other.first)
            and self.second.same_cone(other.second)
        )

    def require_nonempty(self, where: str = "C") -> None:
        self.first.require_nonempty(where)
        self.second.require_nonempty(where)
        try:
            w = self.project(self.first.project(np.zeros(self.dim)))
        except EmptySetError as error:
            raise EmptySetError(f"{where} is empty: the two sets of C & D do not meet") from error
        size = max(np.linalg.norm(w), np.abs(self.offsets).max(initial=0.0))
        for part in (self.first, self.second):
            if not part.contains(w, 1e-7 * size):
                raise EmptySetError(f"{where} is empty: the two sets of C & D do not meet")

    def magnitude(self) -> float:
        return min(self.first.magnitude(), self.second.magnitude())


class Product(ConvexSet):
    """C_1 x C_2 x ...: the parts one after the other in the vector."""

    def __init__(self, parts: tuple[ConvexSet, ...]) -> None:
        self.parts = parts
        self.dim = sum(part.dim for part in parts)
        self.offsets = np.concatenate([part.offsets for part in parts])
        self.polyhedral = all(part.polyhedral for part in parts)
        self._cuts = np.cumsum([part.dim for part in parts])[:-1]
        self._offset_cuts = np.cumsum([part.offsets.size for part in parts])[:-1]

    def support(self, z: np.ndarray) -> float:
        blocks = np.split(vector("z", z, self.dim), self._cuts)
        return sum(part.support(block) for part, block in zip(self.parts, blocks, strict=True))

    def project(self, w: np.ndarray) -> np.ndarray:
        blocks = np.split(vector("w", w, self.dim), self._cuts)
        projected = [part.project(block) for part, block in zip(self.parts, blocks, strict=True)]
        return np.concatenate(projected)

    def features(self, p: cp.Expression) -> Features:
        y: list[Any] = []
        constraints: list[Any] = []
        start = 0
        for part in self.parts:
            more, others = part.features(p[start : start + part.dim])
            y, constraints, start = y + more, constraints + others, start + part.dim
        return Features(y, constraints)

    def witness(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray
    ) -> Witness | None:
        cut = [np.split(x, self._cuts) for x in (p, w, tau)]
        found = [
            part.witness(*blocks)
            for part, *blocks in zip(self.parts, *cut, np.split(y, self._offset_cuts), strict=True)
        ]
        known = [one for one in found if one is not None]
        if len(known) < len(found):
            return None
        return Witness(
            np.concatenate([one.p for one in known]),
            np.concatenate([one.w for one in known]),
            sum(one.gap for one in known),
        )

    def same_cone(self, other: ConvexSet) -> bool:
        return (
            isinstance(other, Product)
            and len(self.parts) == len(other.parts)
            and all(a.same_cone(b) for a, b in zip(self.parts, other.parts, strict=True))
        )

    def require_nonempty(self, where: str = "C") -> None:
        for part in self.parts:
            part.require_nonempty(where)

    def magnitude(self) -> float:
        return float(np.linalg.norm([part.magnitude() for part in self.parts]))

    @property
    def anchor(self) -> np.ndarray:
        return np.concatenate([part.anchor for part in self.parts])

    @property
    def nonsmooth_dim(self) -> int:
        return sum(part.nonsmooth_dim for part in self.parts)

    def polar(self) -> ConvexSet:
        return Product(tuple(part.polar() for part in self.parts))


class Image(ConvexSet):
    """{ M s : s in C }, C in R^m, M of shape (dim, m).

    With M = E^T selecting a few of many unknowns this is how contact enters a large body: the
    set acts on m unknowns only, and a plan can eliminate the others.
    """

    def __init__(self, M: Any, part: ConvexSet) -> None:
        self.M = matrix("M", M)
        self.dim, columns = self.M.shape
        if columns != part.dim:
            raise InputError(f"image(M, C): M has {columns} columns but C has dim {part.dim}")
        self.part, self.offsets, self.polyhedral = part, part.offsets, part.polyhedral
        gram = self.M.T @ self.M
        gram = gram.toarray() if sp.issparse(gram) and columns <= 2000 else gram
        self._diagonal = gram.diagonal()
        away = abs(gram - sp.diags_array(self._diagonal))
        self._orthogonal = bool(away.max() <= ROUNDING * self._diagonal.max())
        self._uniform = bool(np.ptp(self._diagonal) <= ROUNDING * self._diagonal.max())
        # rank decides whether M^T z reaches every direction of R^m
        self._pinv = None if self._orthogonal else np.linalg.pinv(_dense(self.M))
        self._injective = bool(
            (self._diagonal > 0).all()
            if self._orthogonal
            else np.linalg.matrix_rank(_dense(self.M)) == columns
        )

    def _solve(self, w: np.ndarray) -> np.ndarray:
        """The s of least norm with M s nearest to w."""
        if self._pinv is not None:
            return self._pinv @ w
        safe = np.where(self._diagonal > 0, self._diagonal, 1.0)
        return (self.M.T @ w) / safe

    def support(self, z: np.ndarray) -> float:
        return self.part.support(self.M.T @ vector("z", z, self.dim))

    def project(self, w: np.ndarray) -> np.ndarray:
        w = vector("w", w, self.dim)
        separable = isinstance(self.part, Box) or self._uniform
        if self._orthogonal and self._injective and separable:
            return self.M @ self.part.project(self._solve(w))
        return project_by_program(self, w)

    def features(self, p: cp.Expression) -> Features:
        return self.part.features(self.M.T @ p)

    def witness(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray
    ) -> Witness | None:
        inner = self.M.T @ p
        weights = np.maximum(abs(self.M).T @ tau, np.finfo(float).tiny)
        found = self.part.witness(inner, self._solve(w), weights, y)
        if found is None:
            return None
        if self._injective:
            # the p nearest to the given one whose M^T p is the proven normal of the part
            change = found.p - inner
            if self._pinv is None:
                p = p + self.M @ (change / self._diagonal)
            else:
                p = p + self._pinv.T @ change
            return Witness(p, self.M @ found.w, found.gap)
        gap = self.part.support(inner) - float(inner @ found.w)
        return Witness(p, self.M @ found.w, max(gap, 0.0))

    def same_cone(self, other: ConvexSet) -> bool:
        return (
            isinstance(other, Image)
            and same_array(self.M, other.M)
            and self.part.same_cone(other.part)
        )

    def require_nonempty(self, where: str = "C") -> None:
        self.part.require_nonempty(where)

    def magnitude(self) -> float:
        norm = np.sqrt(self._diagonal.max()) if self._orthogonal else np.linalg.norm(_dense(self.M))
        return float(norm) * self.part.magnitude()

    @property
    def nonsmooth_dim(self) -> int:
        return self.part.nonsmooth_dim

    def polar(self) -> ConvexSet:
        # <p, M s> <= 0 for all s of the cone  <=>  M^T p in its polar
        polar = self.part.polar()
        if not isinstance(polar, Box):
            raise InputError("polar of an image is known for images of orthants only")
        rows = _dense(self.M).T
        above, below = np.isfinite(polar.upper), np.isfinite(polar.lower)
        from sweepopt.sets.polyhedra import Polyhedron

        G = np.vstack([rows[above], -rows[below]])
        return Polyhedron(G, np.zeros(len(G)))


def add(C: ConvexSet, other: Any) -> Any:
    """C + v or C + D."""
    if is_vector(other):
        return Translation(C, other)
    if isinstance(other, ConvexSet):
        if isinstance(other, Point):
            return Translation(C, other.offsets)
        return Sum(C, other)
    return NotImplemented


def scale(factor: Any, C: ConvexSet) -> ConvexSet:
    """r C for any finite r; 0 C is {0} and asks for a bounded C."""
    if isinstance(factor, ConvexSet):
        raise InputError("C * D is not defined; use so.product(C, D) or C & D")
    r = number("scale", factor)
    if r < 0:
        return scale(-r, -C)
    if r == 0:
        if not np.isfinite(C.magnitude()):
            raise InputError("scale 0 of an unbounded set is not closed under limits; use scale > 0")
        return Point(np.zeros(C.dim))
    return Scaling(r, C)


def intersect(C: ConvexSet, D: Any) -> Any:
    """C & D."""
    return Intersection(C, D) if isinstance(D, ConvexSet) else NotImplemented


def is_vector(value: Any) -> bool:
    """Whether value can be a translation."""
    return isinstance(value, (np.ndarray, list, tuple, int, float, np.number))


def require_same_dim(what: str, C: ConvexSet, D: ConvexSet) -> None:
    """Raise InputError if the two sets live in different spaces."""
    if C.dim != D.dim:
        raise InputError(f"{what}: the sets have dim {C.dim} and {D.dim}; they must be equal")


def _dense(M: Any) -> np.ndarray:
    return M.toarray() if sp.issparse(M) else M
