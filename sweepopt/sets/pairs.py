"""Two sets made one: the Minkowski sum and the intersection.

sigma(C + D, z) = sigma(C, z) + sigma(D, z)
sigma(C & D, z) = min { sigma(C, p) + sigma(D, z - p) }   (and its closure)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy.linalg

from sweepopt.alone import in_turn
from sweepopt.checks import vector
from sweepopt.errors import EmptySetError
from sweepopt.sets.base import (
    DENSE,
    ROUNDING,
    ConvexSet,
    Features,
    Lifted,
    Witness,
    binary,
)
from sweepopt.sets.iteration import (
    CONFIRMING,
    QUICK,
    SWEEPS,
    fixed_point,
    normal_by_program,
    project_by_program,
    solve_tightly,
    support_by_program,
)
from sweepopt.sets.nearest import nearest_on_rows

if TYPE_CHECKING:
    import cvxpy as cp


class _Slopes(NamedTuple):
    """Derivatives of two maps f and g, for the pair  a = f(v - b),  b = g(v - a)."""

    first: np.ndarray
    second: np.ndarray

    @property
    def of_both(self) -> np.ndarray:
        """d(a + b)/dv, the same for all such pairs."""
        one = np.eye(len(self.first))
        mixed, alone = one - self.first @ self.second, self.first @ (one - self.second)
        a = np.linalg.lstsq(mixed, alone, rcond=1e-13)[0]
        return self.second + (one - self.second) @ a


def _slopes(first: np.ndarray | None, second: np.ndarray | None) -> _Slopes | None:
    if first is None or second is None:
        return None
    return _Slopes(*(np.diag(D) if D.ndim == 1 else D for D in (first, second)))


class _Pair(ConvexSet):
    """What a sum and an intersection have in common."""

    exact = False

    def __init__(self, first: ConvexSet, second: ConvexSet) -> None:
        self.first, self.second, self.dim = first, second, first.dim
        self.offsets = np.concatenate([first.offsets, second.offsets])
        self.polyhedral = first.polyhedral and second.polyhedral
        self.certifiable = first.certifiable and second.certifiable
        self._nested = not (first.exact and second.exact)

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

    @property
    def _sweeps(self) -> int:
        """Where a part iterates too, the work and what it rounds multiply: a program is near."""
        return SWEEPS // 10 if self._nested else SWEEPS


class Sum(_Pair):
    """The Minkowski sum C + D."""

    def support(self, z: np.ndarray) -> float:
        return self.first.support(z) + self.second.support(z)

    def project(self, w: np.ndarray) -> np.ndarray:
        w = vector("w", w, self.dim)
        parts = self._nearest(w)
        return project_by_program(self, w) if parts is None else parts[0] + parts[1]

    def normal(self, v: np.ndarray) -> np.ndarray:
        parts = self._nearest(v)
        return v - self.project(v) if parts is None else self._normal(v, *parts)

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

    def _nearest(self, w: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Points of C and D whose sum is nearest to w, by alternating projections."""
        if not self.certifiable:
            return None  # projections that are programs themselves never meet to rounding

        def sweep(second: np.ndarray) -> np.ndarray:
            return self.second.project(w - self.first.project(w - second))

        def slope(second: np.ndarray) -> np.ndarray | None:
            first = self.first.project(w - second)
            slopes = self._slopes(w, first, second)
            return slopes and slopes.second @ slopes.first

        start = self.second.project(np.zeros(self.dim))
        rounding = 10.0 if self._nested else 1.0
        like = rounding * np.concatenate([w, start, self.first.project(w - start)])

        # many iterations come last, and iterations of iterations
        second = None if self._nested else fixed_point(sweep, start, like, QUICK, slope)
        if second is None:
            near = self._direct(w)
            if near is None:
                second = fixed_point(sweep, start, like, self._sweeps, slope)
            else:
                second = fixed_point(sweep, near, like, CONFIRMING)
        return None if second is None else (self.first.project(w - second), second)

    def _direct(self, w: np.ndarray) -> np.ndarray | None:
        """A start from the rows that the parts are made of: the fixed point itself, as a rule."""
        lift, second = self.lifted(), self.second.lifted()
        if lift is None or second is None or lift.E.shape[1] > DENSE:
            return None
        s = nearest_on_rows(lift, w)
        own = second.E.shape[1]
        return None if s is None else self.second.project(second.point(s[s.size - own :]))

    def lifted(self) -> Lifted | None:
        one, two = self.first.lifted(), self.second.lifted()
        if one is None or two is None:
            return None
        return Lifted(
            one.c + two.c,
            np.hstack([one.E, two.E]),
            scipy.linalg.block_diag(one.G, two.G),
            np.concatenate([one.h, two.h]),
        )

    def _slopes(self, w: np.ndarray, first: np.ndarray, second: np.ndarray) -> _Slopes | None:
        return _slopes(self.first.derivative(w - second), self.second.derivative(w - first))

    def derivative(self, v: np.ndarray) -> np.ndarray | None:
        """That of a + b for a = P_C(v - b), b = P_D(v - a)."""
        parts = None if self.dim > DENSE else self._nearest(v)
        slopes = None if parts is None else self._slopes(v, *parts)
        return slopes and slopes.of_both

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
        parts = self._nearest(v)
        if parts is not None:
            return Witness(self._normal(v, *parts) / step, parts[0] + parts[1], 0.0)
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

    def _decompose(self, v: np.ndarray, one: np.ndarray) -> Witness:
        """w = P(v) and p near v - w, with the gap of p in w: 0 if alternation gets to rounding.

        Alternation starts from the part `one` of the normal. If it comes to no end, it starts again
        from a program's answer; if that does not help, the program's answer is made feasible.
        """
        split = self._split(v, one)
        if split is None:
            p, y = normal_by_program(self, v)
            one, two = y[: self.dim], p - y[: self.dim]
            split = self._split(v, one)
        if split is not None:
            return Witness(split[0] + split[1], v - split[0] - split[1], 0.0)
        w = v - p
        for _ in range(SWEEPS if self.certifiable else 0):
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

    def _split(self, v: np.ndarray, one: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """p_1 in N_C(w), p_2 in N_D(w) with w = v - p_1 - p_2, by Dykstra's alternation from p_1.

        Boyle and Dykstra (1986); each half sweep minimises the dual in one of the two.
        """
        if not self.certifiable:
            return None
        alone = self.first.normal(v)
        if not self.second.normal(v - alone).any():
            return alone, np.zeros(self.dim)

        def sweep(one: np.ndarray) -> np.ndarray:
            return self.first.normal(v - self.second.normal(v - one))

        def slope(one: np.ndarray) -> np.ndarray | None:
            slopes = self._slopes(v, one, self.second.normal(v - one))
            return slopes and slopes.first @ slopes.second

        found = fixed_point(sweep, one, v, self._sweeps, slope)
        return None if found is None else (found, self.second.normal(v - found))

    def _slopes(self, v: np.ndarray, one: np.ndarray, two: np.ndarray) -> _Slopes | None:
        """Those of the normals: I - derivative of the projection."""
        found = _slopes(self.first.derivative(v - two), self.second.derivative(v - one))
        return found and _Slopes(*(np.eye(self.dim) - D for D in found))

    def derivative(self, v: np.ndarray) -> np.ndarray | None:
        """That of v - p_1 - p_2 for normals p_1 of C at v - p_2 and p_2 of D at v - p_1."""
        split = None if self.dim > DENSE else self._split(v, np.zeros(self.dim))
        slopes = None if split is None else self._slopes(v, *split)
        return slopes and np.eye(self.dim) - slopes.of_both

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
        found = self._decompose(w + step * p, step * y[: self.dim])
        return Witness(found.p / step, found.w, found.gap / step)

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
