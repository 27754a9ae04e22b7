"""Two sets made one: the Minkowski sum and the intersection.

sigma(C + D, z) = sigma(C, z) + sigma(D, z)
sigma(C & D, z) = min { sigma(C, p) + sigma(D, z - p) }   (and its closure)
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from sweepopt.alone import in_turn
from sweepopt.checks import vector
from sweepopt.errors import EmptySetError
from sweepopt.sets.base import (
    ROUNDING,
    ConvexSet,
    Features,
    Witness,
    binary,
)
from sweepopt.sets.composed import Composed
from sweepopt.sets.flat import Flat
from sweepopt.sets.iteration import (
    QUICK,
    SWEEPS,
    fixed_point,
    normal_by_program,
    project_by_program,
    solve_tightly,
    support_by_program,
)
from sweepopt.sets.splitting import Near, rounded

if TYPE_CHECKING:
    import cvxpy as cp


class _Pair(Composed):
    """What a sum and an intersection have in common."""

    exact = False

    def __init__(self, first: ConvexSet, second: ConvexSet) -> None:
        self.first, self.second, self.dim = first, second, first.dim
        self.offsets = np.concatenate([first.offsets, second.offsets])
        self.polyhedral = first.polyhedral and second.polyhedral
        self.certifiable = first.certifiable and second.certifiable
        self.nested = not (first.exact and second.exact)

    def same_cone(self, other: ConvexSet) -> bool:
        return (
            isinstance(other, _Pair)
            and type(self) is type(other)
            and self.first.same_cone(other.first)
            and self.second.same_cone(other.second)
        )

    def require_nonempty(self, where: str = "C") -> None:
        self.first.require_nonempty(where)
        self.second.require_nonempty(where)


class Sum(_Pair):
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

    def _nearest(self, v: np.ndarray) -> Witness | None:
        """P(v) and its normal; None if no points of C and D meet to rounding."""
        if not self.certifiable:
            return None  # projections that are programs themselves never do
        near = self.near(v)
        parts = self._swept(v, self.sweeps) if near is None else self._parts(near)
        if parts is None:
            return None
        if near is None:
            return Witness(self._normal(v, *parts), parts[0] + parts[1], 0.0)
        p = self._normal(v, *parts) if (near.w != v).any() else np.zeros(self.dim)
        return Witness(p, near.w.copy(), 0.0)

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

    def witness(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray
    ) -> Witness | None:
        if not self.certifiable:
            return None
        step = float(np.mean(tau))
        v = w + step * p
        found = self._nearest(v)
        if found is not None:
            near = self.near(v)
            lost = rounded(v, step) if near is None else near.lost(found.p, step)
            return Witness(found.p / step, found.w, 0.0, lost)
        # no split to rounding: exposed parts, and the gap of the best normal at hand
        first = self.first.project(w)
        second = self.second.project(v - first)
        first = self.first.project(v - second)
        normals = (
            p,
            self.first.normal(v - second) / step,
            self.second.normal(v - first) / step,
        )
        gaps = [self.support(n) - float(n @ (first + second)) for n in normals]
        best = int(np.argmin(gaps))
        return Witness(normals[best], first + second, max(gaps[best], 0.0))

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


class Intersection(_Pair):
    """C & D, non-empty."""

    def __init__(self, first: ConvexSet, second: ConvexSet) -> None:
        super().__init__(first, second)
        # y starts with p_1 of the split p = p_1 + p_2, at no cost: its offsets are zero
        self.offsets = np.concatenate([np.zeros(self.dim), self.offsets])

    def support(self, z: np.ndarray) -> float:
        return support_by_program(self, vector("z", z, self.dim))

    def project(self, w: np.ndarray) -> np.ndarray:
        return self._decompose(vector("w", w, self.dim), np.zeros(self.dim)).w

    def normal(self, v: np.ndarray) -> np.ndarray:
        found = self._decompose(v, np.zeros(self.dim))
        return v - found.w if found.gap else found.p

    def quick(self, v: np.ndarray) -> Near | None:
        split = self._split(v, np.zeros(self.dim), QUICK)
        if split is None:
            return None
        w = v - split[0] - split[1]
        return self.pair(v, np.concatenate([w, w]), np.concatenate(split))

    def _decompose(self, v: np.ndarray, one: np.ndarray) -> Witness:
        """w = P(v) and p near v - w, with the gap of p in w: 0 if alternation gets to rounding.

        Alternation starts from the part `one` of the normal. If it comes to no end, or would
        iterate what iterates, it starts from a program's answer; if that does not help, the
        program's answer is made feasible.
        """
        for part, other in ((self.first, self.second), (self.second, self.first)):
            alone = part.normal(v) if self.certifiable else v
            if self.certifiable and not other.normal(v - alone).any():
                return Witness(alone, v - alone, 0.0, rounded(v, 1.0))
        near = self.near(v)
        if near is not None:
            return self._pair(near)
        split = None if self.nested else self._split(v, one, SWEEPS)
        if split is None:
            p, y = normal_by_program(self, v)
            one, two = y[: self.dim], p - y[: self.dim]
            split = self._split(v, one, self.sweeps)
        if split is not None:
            return Witness(split[0] + split[1], v - split[0] - split[1], 0.0, rounded(v, 1.0))
        w = v - p
        for _ in range(self.sweeps if self.certifiable else 0):
            before, w = w, self.second.project(self.first.project(w))
            if np.abs(w - before).max() <= ROUNDING * np.abs(w).max():
                break
        gap, p = 0.0, np.zeros(self.dim)
        for part, normal in ((self.first, one), (self.second, two)):
            # exact normals of the parts nearby, at points that miss w by little
            exact = part.normal(w + normal)
            gap += float(exact @ (part.project(w + normal) - w))
            p = p + exact
        return Witness(p, w, max(gap, np.finfo(float).tiny))

    def _pair(self, near: Near) -> Witness:
        """w and v - w as the sum of the parts' normals: what none of them holds is exactly 0."""
        v = near.v
        p, multipliers = near.splitting.normal(near)
        two = self.second.normal(v - p + multipliers[-self.dim :])
        split = self.first.normal(v - two) + two
        if np.abs(split - p).max() <= 10 * ROUNDING * np.abs(v).max():
            p = split
        return Witness(p, near.w.copy(), 0.0, near.lost(p, 1.0))

    def _split(
        self, v: np.ndarray, one: np.ndarray, sweeps: int
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """p_1 in N_C(w), p_2 in N_D(w) with w = v - p_1 - p_2, by Dykstra's alternation from p_1.

        Boyle and Dykstra (1986); each half sweep minimises the dual in one of the two.
        """
        if not self.certifiable:
            return None

        def sweep(one: np.ndarray) -> np.ndarray:
            return self.first.normal(v - self.second.normal(v - one))

        found = fixed_point(sweep, one, v, sweeps)
        return None if found is None else (found, self.second.normal(v - found))

    def flat(self) -> Flat | None:
        both, one = Flat.beside((self.first, self.second)), np.eye(self.dim)
        return both and both.met(np.hstack([one, -one])).pushed(np.hstack([one, 0 * one]))

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        one = cp.Variable(self.dim)
        y, constraints = self.first.features(one)
        more, others = self.second.features(p - one)
        return Features([one, *y, *more], [*constraints, *others])

    def witness(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray
    ) -> Witness | None:
        if not self.certifiable:
            return None
        step = float(np.mean(tau))
        v = w + step * p
        near = self.near(v)
        found = self._decompose(v, step * y[: self.dim]) if near is None else self._pair(near)
        lost = found.lost and found.lost._replace(p=found.lost.p / step)
        return Witness(found.p / step, found.w, found.gap / step, lost)

    def require_nonempty(self, where: str = "C") -> None:
        super().require_nonempty(where)
        if not self._parts_meet():
            raise EmptySetError(f"{where} is empty: the two sets of C & D do not meet")

    @in_turn
    def _parts_meet(self) -> bool:
        """Whether alternating projections find a common point, or no plane separates the parts."""
        import cvxpy as cp

        tol, inaccurate = (ROUNDING, 1e-10) if self.certifiable else (1e-7, 1e-6)
        unit = np.abs(self.offsets).max(initial=0.0)
        b = self.second.project(self.first.project(np.zeros(self.dim)))
        if self.certifiable:
            nearest = fixed_point(lambda b: self.second.project(self.first.project(b)), b, b)
            b = b if nearest is None else nearest
        a = self.first.project(b)
        size = binary(max(np.abs(a).max(), np.abs(b).max(), unit))
        if np.abs(a - b).max() <= tol * size:
            return True
        # a plane between the nearest points a and b proves that there is none
        p = b - a
        between = -self.first.support(p) - self.second.support(-p)
        if between > 0.1 * (p @ p):
            return False
        # max over |p| <= 1 of -sigma(C, p) - sigma(D, -p) is the distance of the parts
        plane = cp.Variable(self.dim)
        one, constraints = self.first.epigraph(plane)
        two, more = self.second.epigraph(-plane)
        limits = [*constraints, *more, cp.norm(plane) <= 1]
        problem = cp.Problem(cp.Maximize(-(one + two) / size), limits)
        solve_tightly(problem)
        return problem.value is not None and problem.value <= inaccurate

    def magnitude(self) -> float:
        return min(self.first.magnitude(), self.second.magnitude())

    def polar(self) -> ConvexSet:
        """(C & D)° = closure of C° + D°; projections on a sum are those on its closure."""
        return self.first.polar() + self.second.polar()
