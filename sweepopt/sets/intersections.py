"""The intersection:  sigma(C & D, z) = min { sigma(C, p) + sigma(D, z - p) }  and its closure."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sweepopt.checks import vector
from sweepopt.errors import EmptySetError
from sweepopt.sets.base import ROUNDING, ConvexSet, Features, NormalPair, binary
from sweepopt.sets.cvxpy_lock import in_turn
from sweepopt.sets.flat import Flat
from sweepopt.sets.iteration import (
    QUICK,
    SWEEPS,
    fixed_point,
    normal_by_program,
    solve_tightly,
    support_by_program,
)
from sweepopt.sets.pairs import Pair
from sweepopt.sets.splitting import Near, rounded

if TYPE_CHECKING:
    import cvxpy as cp


class Intersection(Pair):
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

    def _decompose(self, v: np.ndarray, one: np.ndarray) -> NormalPair:
        """w = P(v) and p near v - w, with the gap of p in w: 0 if alternation gets to rounding.

        Alternation starts from the part `one` of the normal. If it comes to no end, or would
        iterate what iterates, it starts from a program's answer; if that does not help, the
        program's answer is made feasible.
        """
        each = ((self.first, self.second), (self.second, self.first)) if self.certifiable else ()
        for part, other in each:
            w = part.project(v)
            if not other.normal(w).any():
                return NormalPair(part.normal(v), w, 0.0, rounded(v))
        near = self.near(v)
        if near is not None:
            return self._joined(near)
        split = None if self.nested else self._split(v, one, SWEEPS)
        if split is None:
            p, y = normal_by_program(self, v)
            one, two = y[: self.dim], p - y[: self.dim]
            split = self._split(v, one, self.sweeps)
        if split is not None:
            return NormalPair(split[0] + split[1], v - split[0] - split[1], 0.0, rounded(v))
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
        return NormalPair(p, w, max(gap, np.finfo(float).tiny))

    def _joined(self, near: Near) -> NormalPair:
        """w and v - w as the sum of the parts' normals: what none of them holds is exactly 0."""
        v = near.v
        p, multipliers = near.splitting.normal(near)
        two = self.second.normal(v - p + multipliers[-self.dim :])
        split = self.first.normal(v - two) + two
        if np.abs(split - p).max() <= 10 * ROUNDING * np.abs(v).max():
            p = split
        return NormalPair(p, near.w.copy(), 0.0, near.perturbation(p))

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

    def _pair_near(self, w: np.ndarray, p: np.ndarray, y: np.ndarray) -> NormalPair:
        near = self.near(w + p)
        return self._decompose(w + p, y[: self.dim]) if near is None else self._joined(near)

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
