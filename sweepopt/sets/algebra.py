"""Operations on sets, lazy: each node states its law for sigma, for the projection and for y.

sigma(C + v, z) = sigma(C, z) + <v, z>          sigma(C + D, z) = sigma(C, z) + sigma(D, z)
sigma(r C, z)   = r sigma(C, z),  r >= 0        sigma(-C, z)    = sigma(C, -z)
sigma(C x D)    = sum of the parts              sigma(M C, z)   = sigma(C, M^T z)
sigma(C & D, z) = min { sigma(C, p) + sigma(D, z - p) }   (and its closure)
"""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import HUGE, number, vector
from sweepopt.errors import InputError
from sweepopt.sets.base import (
    ConvexSet,
    CurveGap,
    Features,
    NormalPair,
    Selection,
    Sphere,
    require_same_dim,
)
from sweepopt.sets.intersections import Intersection
from sweepopt.sets.polyhedra import ACTIVE_DIM, Polyhedron
from sweepopt.sets.shapes import Box, Point
from sweepopt.sets.sums import Sum

if TYPE_CHECKING:
    import cvxpy as cp

    from sweepopt.sets.flat import Flat


class _Similar(ConvexSet):
    """T C for a similarity T: the point of T C nearest to T x is T P_C(x)."""

    v: np.ndarray | None = None  # T 0; None is 0

    def __init__(self, part: ConvexSet) -> None:
        self.part, self.dim = part, part.dim
        self.polyhedral, self.certifiable = part.polyhedral, part.certifiable
        self.exact = part.exact

    @abstractmethod
    def _to(self, x: np.ndarray) -> np.ndarray:
        """T x."""

    @abstractmethod
    def _back(self, w: np.ndarray) -> np.ndarray:
        """T^-1 w."""

    @abstractmethod
    def _turned(self, C: ConvexSet) -> ConvexSet:
        """T C - T 0 for a set C of any dimension."""

    def project(self, w: np.ndarray) -> np.ndarray:
        return self._to(self.part.project(self._back(vector("w", w, self.dim))))

    def nearest(self, w: np.ndarray, tau: np.ndarray) -> np.ndarray:
        return self._to(self.part.nearest(self._back(w), tau))

    def derivative(self, v: np.ndarray) -> np.ndarray | None:
        return self.part.derivative(self._back(v))

    def rounding_scale(self, x: np.ndarray) -> float:
        moved = 0.0 if self.v is None else float(np.abs(self.v).max())
        return max(super().rounding_scale(x), self.part.rounding_scale(self._back(x)), moved)

    def weights(self, tau: np.ndarray) -> np.ndarray:
        return self.part.weights(tau)

    def same_cone(self, other: ConvexSet) -> bool:
        if not isinstance(other, _Similar) or type(self) is not type(other):
            return False
        return self.part is other.part or self.part.same_cone(other.part)

    def require_nonempty(self, where: str = "C") -> None:
        self.part.require_nonempty(where)

    @property
    def nonsmooth_dim(self) -> int:
        return self.part.nonsmooth_dim

    @property
    def selection(self) -> Selection | None:
        found = self.part.selection
        if found is None:
            return None
        shift = self.v if found.shift is None else self._to(found.shift)
        return Selection(found.unknowns, self._turned(found.part), shift)

    @property
    def sphere(self) -> Sphere | None:
        found = self.part.sphere
        return found and found._replace(center=self._to(found.center))


class Translation(_Similar):
    """C + v."""

    v: np.ndarray

    def __init__(self, part: ConvexSet, v: np.ndarray) -> None:
        # one is made each step, in half the time without a call: v was checked, and the offsets
        # wait until a program asks
        self.part, self.v, self.dim = part, v, part.dim
        self.polyhedral, self.certifiable = part.polyhedral, part.certifiable
        self.exact = part.exact

    def _to(self, x: np.ndarray) -> np.ndarray:
        return x + self.v

    def _back(self, w: np.ndarray) -> np.ndarray:
        return w - self.v

    def _turned(self, C: ConvexSet) -> ConvexSet:
        return C

    @cached_property
    def offsets(self) -> np.ndarray:  # type: ignore[override]
        return np.concatenate([self.v, self.part.offsets])

    def support(self, z: np.ndarray) -> float:
        z = vector("z", z, self.dim)
        return self.part.support(z) + float(self.v @ z)

    def normal(self, v: np.ndarray) -> np.ndarray:
        return self.part.normal(v - self.v)

    def features(self, p: cp.Expression) -> Features:
        y, constraints = self.part.features(p)
        return Features([p, *y], constraints)

    def normal_pair(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray
    ) -> NormalPair | None:
        found = self.part.normal_pair(p, w - self.v, tau, y[self.dim :])
        return found and found._replace(w=found.w + self.v)

    def rows(self) -> tuple[Any, np.ndarray] | None:
        found = self.part.rows()
        return found and (found[0], found[1] + found[0] @ self.v)

    def flat(self) -> Flat | None:
        found = self.part.flat()
        return found and found._replace(c=found.c + self.v)

    def magnitude(self) -> float:
        return self.part.magnitude() + float(np.linalg.norm(self.v))

    def _distance(self, other: ConvexSet) -> float | None:
        v, part = np.zeros(self.dim), other
        if isinstance(other, Translation):
            v, part = other.v, other.part
        elif isinstance(other, Point):
            v, part = other.offsets, Point(v)
        found = self.part.distance_bound(part)
        return None if found is None else found + float(np.linalg.norm(self.v - v))

    def polar(self) -> ConvexSet:
        return super().polar() if self.v.any() else self.part.polar()

    @property
    def anchor(self) -> np.ndarray:
        return self.v + self.part.anchor


class Scaling(_Similar):
    """r C for r > 0."""

    def __init__(self, factor: float, part: ConvexSet) -> None:
        super().__init__(part)
        self.factor, self.offsets = factor, factor * part.offsets

    def _to(self, x: np.ndarray) -> np.ndarray:
        return self.factor * x

    def _back(self, w: np.ndarray) -> np.ndarray:
        return w / self.factor

    def _turned(self, C: ConvexSet) -> ConvexSet:
        return scale(self.factor, C)

    def support(self, z: np.ndarray) -> float:
        return self.factor * self.part.support(z)

    def normal(self, v: np.ndarray) -> np.ndarray:
        return self.factor * self.part.normal(v / self.factor)

    def features(self, p: cp.Expression) -> Features:
        return self.part.features(p)

    def normal_pair(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray
    ) -> NormalPair | None:
        found = self.part.normal_pair(p, w / self.factor, tau / self.factor, y)
        if found is None:
            return None
        perturbation = found.perturbation and found.perturbation._replace(
            w=self.factor * found.perturbation.w
        )
        return NormalPair(found.p, self.factor * found.w, self.factor * found.gap, perturbation)

    def rounding_scale(self, x: np.ndarray) -> float:
        return self.factor * self.part.rounding_scale(self._back(x))

    def rows(self) -> tuple[Any, np.ndarray] | None:
        found = self.part.rows()
        return found and (found[0], self.factor * found[1])

    def flat(self) -> Flat | None:
        found = self.part.flat()
        return found and found._replace(c=self.factor * found.c, E=self.factor * found.E)

    def magnitude(self) -> float:
        return self.factor * self.part.magnitude()

    def _distance(self, other: ConvexSet) -> float | None:
        # r C and s D are |r - s| sup |C| + s d(C, D) apart at most; {0} is 0 C
        factor, part = 1.0, other
        if isinstance(other, Scaling):
            factor, part = other.factor, other.part
        elif isinstance(other, Point) and not other.offsets.any():
            factor, part = 0.0, self.part
        found, change = self.part.distance_bound(part), abs(self.factor - factor)
        moved = change * self.part.magnitude() if change else 0.0
        return None if found is None or np.isinf(moved) else moved + factor * found

    @property
    def sphere(self) -> Sphere | None:
        found = self.part.sphere
        return found and Sphere(self.factor * found.center, self.factor * found.radius)

    def polar(self) -> ConvexSet:
        return self.part.polar()


class Negation(_Similar):
    """-C."""

    def __init__(self, part: ConvexSet) -> None:
        super().__init__(part)
        self.offsets = part.offsets

    def _to(self, x: np.ndarray) -> np.ndarray:
        return -x

    def _back(self, w: np.ndarray) -> np.ndarray:
        return -w

    def _turned(self, C: ConvexSet) -> ConvexSet:
        return -C

    def support(self, z: np.ndarray) -> float:
        return self.part.support(-vector("z", z, self.dim))

    def normal(self, v: np.ndarray) -> np.ndarray:
        return -self.part.normal(-v)

    def gap(self, p: np.ndarray, w: np.ndarray) -> float:
        return self.part.gap(-p, -w)

    def gap_along_curve(self, p: np.ndarray, w: np.ndarray, ratio: float) -> CurveGap:
        return self.part.gap_along_curve(-p, -w, ratio)

    def features(self, p: cp.Expression) -> Features:
        return self.part.features(-p)

    def normal_pair(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray
    ) -> NormalPair | None:
        found = self.part.normal_pair(-p, -w, tau, y)
        return found and found._replace(p=-found.p, w=-found.w)

    def rows(self) -> tuple[Any, np.ndarray] | None:
        found = self.part.rows()
        return found and (-found[0], found[1])

    def flat(self) -> Flat | None:
        found = self.part.flat()
        return found and found._replace(c=-found.c, E=-found.E)

    def magnitude(self) -> float:
        return self.part.magnitude()

    def _distance(self, other: ConvexSet) -> float | None:
        return self.part.distance_bound(other.part) if isinstance(other, Negation) else None

    def polar(self) -> ConvexSet:
        return -self.part.polar()

    def __neg__(self) -> ConvexSet:
        return self.part


def add(C: ConvexSet, other: Any) -> Any:
    """C + v or C + D; the sum with a point is a translation."""
    if is_vector(other):
        return (
            Point(C.offsets + vector("v", other, C.dim))
            if isinstance(C, Point)
            else Translation(C, vector("v", other, C.dim))
        )
    if not _is_set("C + D", other):
        return NotImplemented
    require_same_dim("C + D", C, other)
    if isinstance(other, Point):
        return C + other.offsets
    return other + C.offsets if isinstance(C, Point) else Sum(C, other)


def scale(factor: Any, C: ConvexSet) -> ConvexSet:
    """r C for any finite r; 0 C is {0} and asks for a bounded C; below 1e-75 r is 0."""
    if hasattr(factor, "at"):
        raise InputError("C * D is not defined; use so.product(C, D) or C & D")
    r = number("scale", factor)
    if r < 0:
        return scale(-r, -C)
    if isinstance(C, Point):
        return Point(r * C.offsets)
    if r < 1 / HUGE:  # what it divides would overflow
        if not np.isfinite(C.magnitude()):
            raise InputError(
                "scale 0 of an unbounded set is not closed in the limit; use scale > 0"
            )
        return Point(np.zeros(C.dim))
    return C.scaled(r) if isinstance(C, Box) else Scaling(r, C)


def intersect(C: ConvexSet, D: Any) -> Any:
    """C & D."""
    if not _is_set("C & D", D):
        return NotImplemented
    require_same_dim("C & D", C, D)
    above, below = C.rows(), D.rows()
    if above is None or below is None or C.dim > ACTIVE_DIM:
        return Intersection(C, D)
    # rows under rows: again a polyhedron, with its exact projection
    (G, h), (F, k) = above, below
    stack = sp.vstack if sp.issparse(G) or sp.issparse(F) else np.vstack
    return Polyhedron(stack([G, F]), np.concatenate([h, k]))


def _is_set(what: str, D: Any) -> bool:
    """True for a set, False for a moving set (which then takes over), an error otherwise."""
    if not isinstance(D, ConvexSet) and not hasattr(D, "at"):
        raise InputError(f"{what}: D must be a set, got {type(D).__name__}")
    return isinstance(D, ConvexSet)


def is_vector(value: Any) -> bool:
    """Whether value can be a translation."""
    return isinstance(value, (np.ndarray, list, tuple, int, float, np.number))
