"""Translates and multiples of a set: whatever is known of C is known of T C, T a similarity.

sigma(C + v, z) = sigma(C, z) + <v, z>          sigma(r C, z) = |r| sigma(C, sign(r) z)

The set itself stays as it is, with all that was computed for it: a step changes v, or r.
"""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.checks import vector
from sweepopt.sets.base import (
    ConvexSet,
    CurveGap,
    Features,
    Form,
    Halfspaces,
    NormalPair,
    Perturbation,
    Selection,
)
from sweepopt.sets.shapes import Point

if TYPE_CHECKING:
    import cvxpy as cp


class Similar(ConvexSet):
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

    def weights(self, tau: np.ndarray) -> np.ndarray:
        return self.part.weights(tau)

    def require_nonempty(self, where: str = "C") -> None:
        self.part.require_nonempty(where)

    @property
    def ends(self) -> np.ndarray:
        return self.part.ends

    @property
    def nonsmooth_dim(self) -> int:
        return self.part.nonsmooth_dim

    @cached_property  # a step asks for that of the shape that it moves
    def selection(self) -> Selection | None:
        found = self.part.selection
        if found is None:
            return None
        shift = self.v if found.shift is None else self._to(found.shift)
        return Selection(found.unknowns, self._turned(found.part), shift)


class Translation(Similar):
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

    def rounding_scale(self, x: np.ndarray) -> float:
        return max(
            super().rounding_scale(x),
            self.part.rounding_scale(x - self.v),
            float(np.abs(self.v).max()),
        )

    def features(self, p: cp.Expression) -> Features:
        y, constraints = self.part.features(p)
        return Features([p, *y], constraints)

    def normal_pair(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray | None = None
    ) -> NormalPair | None:
        found = self.part.normal_pair(p, w - self.v, tau)
        return found and found._replace(w=found.w + self.v)

    def factors(self, ends: np.ndarray) -> list[ConvexSet]:
        each = zip(self.part.factors(ends), np.split(self.v, ends[:-1]), strict=True)
        return [C + v for C, v in each]

    def same_cone(self, other: ConvexSet) -> bool:
        return isinstance(other, Translation) and _same(self.part, other.part)

    def rows(self) -> tuple[Any, np.ndarray] | None:
        found = self.part.rows()
        return found and (found[0], found[1] + found[0] @ self.v)

    def halfspaces(self) -> Halfspaces:
        return self.part.halfspaces().translated(self.v)

    def form(self) -> Form:
        inner = self.part.form()
        return Form.alone(self) if inner.parts == (self.part,) else inner.translated(self.v)

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


class Scaling(Similar):
    """r C for r != 0."""

    def __init__(self, factor: float, part: ConvexSet) -> None:
        super().__init__(part)
        self.factor, self.offsets = factor, abs(factor) * part.offsets
        self._sign = 1.0 if factor > 0 else -1.0

    def _to(self, x: np.ndarray) -> np.ndarray:
        return self.factor * x

    def _back(self, w: np.ndarray) -> np.ndarray:
        return w / self.factor

    def _turned(self, C: ConvexSet) -> ConvexSet:
        return self.factor * C

    def support(self, z: np.ndarray) -> float:
        return abs(self.factor) * self.part.support(self._sign * vector("z", z, self.dim))

    def normal(self, v: np.ndarray) -> np.ndarray:
        return self.factor * self.part.normal(v / self.factor)

    def rounding_scale(self, x: np.ndarray) -> float:
        return abs(self.factor) * self.part.rounding_scale(self._back(x))

    def gap(self, p: np.ndarray, w: np.ndarray) -> float:
        return abs(self.factor) * self.part.gap(self._sign * p, w / self.factor)

    def gap_along_curve(self, p: np.ndarray, w: np.ndarray, ratio: float) -> CurveGap:
        r = abs(self.factor)
        found = self.part.gap_along_curve(self._sign * p, w / self.factor, r * ratio)
        return CurveGap(r * found.gap, r * found.distance)

    def features(self, p: cp.Expression) -> Features:
        return self.part.features(p if self.factor > 0 else -p)

    def normal_pair(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray | None = None
    ) -> NormalPair | None:
        r, sign = abs(self.factor), self._sign
        found = self.part.normal_pair(sign * p, w / self.factor, tau / r)
        if found is None:
            return None
        moved = found.perturbation and Perturbation(r * found.perturbation.w, found.perturbation.p)
        return NormalPair(sign * found.p, self.factor * found.w, r * found.gap, moved)

    def factors(self, ends: np.ndarray) -> list[ConvexSet]:
        return [self.factor * C for C in self.part.factors(ends)]

    def same_cone(self, other: ConvexSet) -> bool:
        return (
            isinstance(other, Scaling)
            and self._sign == other._sign
            and _same(self.part, other.part)
        )

    def rows(self) -> tuple[Any, np.ndarray] | None:
        found = self.part.rows()
        return found and (self._sign * found[0], abs(self.factor) * found[1])

    def halfspaces(self) -> Halfspaces:
        N, d, E, e = self.part.halfspaces()
        r, sign = abs(self.factor), self._sign
        return Halfspaces(sign * N, r * d, sign * E, r * e)

    def form(self) -> Form:
        inner = self.part.form()
        return Form.alone(self) if inner.parts == (self.part,) else inner.scaled(self.factor)

    def magnitude(self) -> float:
        return abs(self.factor) * self.part.magnitude()

    def _distance(self, other: ConvexSet) -> float | None:
        # r C and s D are |r - s| sup |C| + s d(C, D) apart at most; {0} is 0 C
        factor, part = 1.0, other
        if isinstance(other, Scaling):
            factor, part = other.factor, other.part
        elif isinstance(other, Point) and not other.offsets.any():
            factor, part = 0.0, self.part
        found, change = self.part.distance_bound(part), abs(self.factor - factor)
        moved = change * self.part.magnitude() if change else 0.0
        return None if found is None or np.isinf(moved) else moved + abs(factor) * found

    def polar(self) -> ConvexSet:
        return self._sign * self.part.polar()


def _same(one: ConvexSet, two: ConvexSet) -> bool:
    return one is two or one.same_cone(two)
