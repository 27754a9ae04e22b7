"""The Minkowski sum:  sigma(C + D, z) = sigma(C, z) + sigma(D, z)."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from sweepopt.checks import vector
from sweepopt.sets.base import ROUNDING, ConvexSet, Features, NormalPair
from sweepopt.sets.flat import Flat
from sweepopt.sets.iteration import QUICK, fixed_point, project_by_program
from sweepopt.sets.pairs import Pair
from sweepopt.sets.splitting import Near, rounded

if TYPE_CHECKING:
    import cvxpy as cp


class Sum(Pair):
    """The Minkowski sum C + D."""

    def support(self, z: np.ndarray) -> float:
        return self.first.support(z) + self.second.support(z)

    def project(self, w: np.ndarray) -> np.ndarray:
        w = vector("w", w, self.dim)
        found = self._nearest(w)
        return project_by_program(self, w) if found is None else found.w

    def normal(self, v: np.ndarray) -> np.ndarray:
        found = self._nearest(v)
        return v - self.project(v) if found is None else found.p

    def _normal(self, v: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """The common normal of the parts as the part computes it in whose domain it must be."""
        p = self.second.normal(v - first)
        if not np.isfinite(self.support(p)):
            return self.first.normal(v - second)
        noise = (p != 0) & (np.abs(p) <= ROUNDING * np.abs(p).max())
        if not noise.any():
            return p
        # what one part holds is 0.0, and rounding of the other
        still = np.where(noise & (self.first.normal(v - second) == 0), 0.0, p)
        return still if np.isfinite(self.support(still)) else p

    def _nearest(self, v: np.ndarray) -> NormalPair | None:
        """P(v) and its normal; None if no points of C and D meet to rounding."""
        if not self.certifiable:
            return None  # projections that are programs themselves never do
        near = self.near(v)
        parts = self._swept(v, self.sweeps) if near is None else self._parts(near)
        if parts is None:
            return None
        if near is None:
            return NormalPair(self._normal(v, *parts), parts[0] + parts[1], 0.0)
        p = self._normal(v, *parts) if (near.w != v).any() else np.zeros(self.dim)
        return NormalPair(p, near.w.copy(), 0.0)

    def _parts(self, near: Near) -> tuple[np.ndarray, np.ndarray]:
        (one, two), s = self._flats, near.parts
        own = one.E.shape[1]
        return one.point(s[:own]), two.point(s[own:])

    @cached_property
    def _flats(self) -> tuple[Flat, Flat]:
        one, two = Flat.of(self.first), Flat.of(self.second)
        assert one is not None  # asked where the sum is flat
        assert two is not None
        return one, two

    def quick(self, v: np.ndarray) -> Near | None:
        parts = self._swept(v, QUICK)
        if parts is None:
            return None
        p = self._normal(v, *parts)
        return self.pair(v, np.concatenate(parts), np.concatenate([p, p]))

    def _swept(self, w: np.ndarray, sweeps: int) -> tuple[np.ndarray, np.ndarray] | None:
        """By alternating projections."""

        def sweep(second: np.ndarray) -> np.ndarray:
            return self.second.project(w - self.first.project(w - second))

        start = self.second.project(np.zeros(self.dim))
        rounding = 10.0 if self.nested else 1.0
        like = rounding * np.concatenate([w, start, self.first.project(w - start)])
        found = fixed_point(sweep, start, like, sweeps)
        return None if found is None else (self.first.project(w - found), found)

    def flat(self) -> Flat | None:
        both = Flat.beside((self.first, self.second))
        return both and both.pushed(np.hstack([np.eye(self.dim)] * 2))

    def features(self, p: cp.Expression) -> Features:
        y, constraints = self.first.features(p)
        more, others = self.second.features(p)
        return Features([*y, *more], [*constraints, *others])

    def _pair_near(self, w: np.ndarray, p: np.ndarray, y: np.ndarray) -> NormalPair:
        v = w + p
        found = self._nearest(v)
        if found is not None:
            near = self.near(v)
            return found._replace(
                perturbation=rounded(v) if near is None else near.perturbation(found.p)
            )
        # no split to rounding: exposed parts, and the gap of the best normal at hand
        first = self.first.project(w)
        second = self.second.project(v - first)
        first = self.first.project(v - second)
        normals = (p, self.first.normal(v - second), self.second.normal(v - first))
        gaps = [self.support(n) - float(n @ (first + second)) for n in normals]
        best = int(np.argmin(gaps))
        return NormalPair(normals[best], first + second, max(gaps[best], 0.0))

    def magnitude(self) -> float:
        return self.first.magnitude() + self.second.magnitude()

    def _distance(self, other: ConvexSet) -> float | None:
        if not isinstance(other, Sum):
            return None
        one = self.first.distance_bound(other.first)
        two = self.second.distance_bound(other.second)
        return None if one is None or two is None else one + two

    @property
    def anchor(self) -> np.ndarray:
        return self.first.anchor + self.second.anchor

    def polar(self) -> ConvexSet:
        return self.first.polar() & self.second.polar()
