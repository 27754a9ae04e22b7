"""Translates and multiples of a set: whatever is known of C is known of v + r C.

sigma(v + r C, z) = <v, z> + |r| sigma(C, sign(r) z),      P_{v + r C}(w) = v + r P_C((w - v) / r)

The set itself stays as it is, with all that was computed for it: a step changes v, or r.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

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


def shape_of(C: ConvexSet) -> ConvexSet:
    """C without its translation and scale."""
    return shape_of(C.part) if isinstance(C, Similar) else C


class Similar(ConvexSet):
    """v + r C for r != 0; v None is 0."""

    def __init__(self, part: ConvexSet, v: np.ndarray | None = None, factor: float = 1.0) -> None:
        # one is made each step: v was checked, and the offsets wait until a program asks
        self.part, self.v, self.factor, self.dim = part, v, factor, part.dim
        self.polyhedral, self.certifiable = part.polyhedral, part.certifiable
        self.exact = part.exact

    @cached_property
    def centred(self) -> ConvexSet:
        """r C."""
        return self.part if self.factor == 1 else Similar(self.part, None, self.factor)

    @property
    def _sign(self) -> float:
        return 1.0 if self.factor > 0 else -1.0

    def _to(self, x: np.ndarray) -> np.ndarray:
        x = x if self.factor == 1 else self.factor * x
        return x if self.v is None else x + self.v

    def _back(self, w: np.ndarray) -> np.ndarray:
        w = w if self.v is None else w - self.v
        return w if self.factor == 1 else w / self.factor

    @cached_property
    def offsets(self) -> np.ndarray:  # type: ignore[override]
        offsets = abs(self.factor) * self.part.offsets
        return offsets if self.v is None else np.concatenate([self.v, offsets])

    def features(self, p: cp.Expression) -> Features:
        y, constraints = self.part.features(p if self.factor > 0 else -p)
        return Features(y if self.v is None else [p, *y], constraints)

    def support(self, z: np.ndarray) -> float:
        z = vector("z", z, self.dim)
        sigma = abs(self.factor) * self.part.support(self._sign * z)
        return sigma if self.v is None else sigma + float(self.v @ z)

    def project(self, w: np.ndarray) -> np.ndarray:
        return self._to(self.part.project(self._back(vector("w", w, self.dim))))

    def normal(self, v: np.ndarray) -> np.ndarray:
        p = self.part.normal(self._back(v))
        return p if self.factor == 1 else self.factor * p

    def derivative(self, v: np.ndarray) -> np.ndarray | None:
        return self.part.derivative(self._back(v))

    def weights(self, tau: np.ndarray) -> np.ndarray:
        return self.part.weights(tau)

    def normal_pair(self, p: np.ndarray, w: np.ndarray, tau: np.ndarray) -> NormalPair | None:
        if self.factor == 1:
            pair = self.part.normal_pair(p, self._back(w), tau)
            return pair and pair._replace(w=self._to(pair.w))
        r, sign = abs(self.factor), self._sign
        pair = self.part.normal_pair(sign * p, self._back(w), tau / r)
        if pair is None:
            return None
        off = pair.perturbation and Perturbation(r * pair.perturbation.w, pair.perturbation.p)
        return NormalPair(sign * pair.p, self._to(pair.w), r * pair.gap, off)

    def gap_along_curve(self, p: np.ndarray, w: np.ndarray, ratio: float) -> CurveGap:
        r = abs(self.factor)
        gap, distance = self.part.gap_along_curve(self._sign * p, self._back(w), r * ratio)
        return CurveGap(r * gap, r * distance)

    def same_cone(self, other: ConvexSet) -> bool:
        return (
            isinstance(other, Similar)
            and (self.v is None, self._sign) == (other.v is None, other._sign)
            and (self.part is other.part or self.part.same_cone(other.part))
        )

    def form(self) -> Form:
        inner = self.part.form()
        if inner.parts == (self.part,):
            return Form.alone(self)
        if self.v is not None:
            return Form.added(self.centred, Point(self.v))
        r = abs(self.factor)  # of the parts, so that only offsets know it
        return inner._replace(E=self._sign * inner.E, parts=tuple(r * C for C in inner.parts))

    def halfspaces(self) -> Halfspaces:
        N, d, E, e = self.part.halfspaces()
        r, sign = abs(self.factor), self._sign
        N, d, E, e = sign * N, r * d, sign * E, r * e
        return (
            Halfspaces(N, d, E, e)
            if self.v is None
            else Halfspaces(N, d + N @ self.v, E, e + E @ self.v)
        )

    def require_nonempty(self, where: str = "C") -> None:
        self.part.require_nonempty(where)

    def magnitude(self) -> float:
        magnitude = abs(self.factor) * self.part.magnitude()
        return magnitude if self.v is None else magnitude + float(np.linalg.norm(self.v))

    def _distance(self, other: ConvexSet) -> float | None:
        # r C and s D are |r - s| sup |C| + |s| d(C, D) apart at most; a point is v + 0 C
        part, v, factor = other, None, 1.0
        if isinstance(other, Similar):
            part, v, factor = other.part, other.v, other.factor
        elif isinstance(other, Point):
            part, v, factor = self.part, other.offsets, 0.0
        distance, change = self.part.distance_bound(part), abs(self.factor - factor)
        of_scale = change * self.part.magnitude() if change else 0.0
        if distance is None or np.isinf(of_scale):
            return None
        apart = np.linalg.norm((0 if self.v is None else self.v) - (0 if v is None else v))
        return of_scale + abs(factor) * distance + float(apart)

    @property
    def anchor(self) -> np.ndarray:
        return self._to(self.part.anchor)

    @cached_property  # a step asks for that of the shape that it moves
    def selection(self) -> Selection | None:
        inner = self.part.selection
        if inner is None:
            return None
        r, part = self.factor, inner.part
        shift = self.v if inner.shift is None else self._to(inner.shift)
        return Selection(inner.unknowns, part if r == 1 else self.algebra.scale(r, part), shift)

    def polar(self) -> ConvexSet:
        if self.v is not None and self.v.any():
            return super().polar()
        return self.part.polar() if self.factor > 0 else -self.part.polar()
