"""Operations on sets, lazy: each node states its law for sigma, for the projection and for y.

sigma(C + v, z) = sigma(C, z) + <v, z>          sigma(C + D, z) = sigma(C, z) + sigma(D, z)
sigma(r C, z)   = r sigma(C, z),  r >= 0        sigma(-C, z)    = sigma(C, -z)
sigma(C x D)    = sum of the parts              sigma(M C, z)   = sigma(C, M^T z)
sigma(C & D, z) = min { sigma(C, p) + sigma(D, z - p) }   (and its closure)
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from sweepopt.checks import Matrix, matrix, number, vector
from sweepopt.errors import EmptySetError, InputError
from sweepopt.sets.base import (
    ROUNDING,
    ConvexSet,
    Features,
    Selection,
    Witness,
    normal_by_program,
    project_by_program,
    same_array,
    solve_tightly,
    support_by_program,
)
from sweepopt.sets.shapes import Box, Point

if TYPE_CHECKING:
    import cvxpy as cp

SWEEPS = 500  # alternating projections before a program takes over
MEMORY = 10  # steps that Anderson's acceleration looks back
RUNAWAY = 1e3  # the longest step of it, in units of the data


class Translation(ConvexSet):
    """C + v."""

    def __init__(self, part: ConvexSet, v: Any) -> None:
        self.part, self.v, self.dim = part, vector("v", v, part.dim), part.dim
        self.offsets = np.concatenate([self.v, part.offsets])
        self.polyhedral, self.certifiable = part.polyhedral, part.certifiable

    def support(self, z: np.ndarray) -> float:
        return self.part.support(z) + float(self.v @ z)

    def project(self, w: np.ndarray) -> np.ndarray:
        return self.part.project(vector("w", w, self.dim) - self.v) + self.v

    def normal(self, v: np.ndarray) -> np.ndarray:
        return self.part.normal(v - self.v)

    def steps(self, tau: np.ndarray) -> np.ndarray:
        return self.part.steps(tau)

    def derivative(self, v: np.ndarray) -> np.ndarray | None:
        return self.part.derivative(v - self.v)

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

    def selection(self) -> Selection | None:
        found = self.part.selection()
        return found and found._replace(shift=found.shift + self.v)


class Scaling(ConvexSet):
    """r C for r > 0."""

    def __init__(self, factor: float, part: ConvexSet) -> None:
        self.factor, self.part, self.dim = factor, part, part.dim
        self.offsets = factor * part.offsets
        self.polyhedral, self.certifiable = part.polyhedral, part.certifiable

    def support(self, z: np.ndarray) -> float:
        return self.factor * self.part.support(z)

    def project(self, w: np.ndarray) -> np.ndarray:
        return self.factor * self.part.project(vector("w", w, self.dim) / self.factor)

    def normal(self, v: np.ndarray) -> np.ndarray:
        return self.factor * self.part.normal(v / self.factor)

    def steps(self, tau: np.ndarray) -> np.ndarray:
        return self.part.steps(tau)

    def derivative(self, v: np.ndarray) -> np.ndarray | None:
        return self.part.derivative(v / self.factor)

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

    def selection(self) -> Selection | None:
        found = self.part.selection()
        return found and Selection(
            found.unknowns, scale(self.factor, found.part), self.factor * found.shift
        )

    def polar(self) -> ConvexSet:
        return self.part.polar()


class Negation(ConvexSet):
    """-C."""

    def __init__(self, part: ConvexSet) -> None:
        self.part, self.dim, self.offsets = part, part.dim, part.offsets
        self.polyhedral, self.certifiable = part.polyhedral, part.certifiable

    def support(self, z: np.ndarray) -> float:
        return self.part.support(-vector("z", z, self.dim))

    def project(self, w: np.ndarray) -> np.ndarray:
        return -self.part.project(-vector("w", w, self.dim))

    def normal(self, v: np.ndarray) -> np.ndarray:
        return -self.part.normal(-v)

    def steps(self, tau: np.ndarray) -> np.ndarray:
        return self.part.steps(tau)

    def derivative(self, v: np.ndarray) -> np.ndarray | None:
        return self.part.derivative(-v)

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

    def selection(self) -> Selection | None:
        found = self.part.selection()
        return found and Selection(found.unknowns, -found.part, -found.shift)

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
        self.certifiable = first.certifiable and second.certifiable

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
        return p if np.isfinite(self.support(p)) else self.first.normal(v - second)

    def _nearest(self, w: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Points of C and D whose sum is nearest to w, by alternating projections."""
        if not self.certifiable:
            return None  # projections that are programs themselves never meet to rounding

        def sweep(second: np.ndarray) -> np.ndarray:
            return self.second.project(w - self.first.project(w - second))

        second = fixed_point(sweep, self.second.project(np.zeros(self.dim)), w)
        return None if second is None else (self.first.project(w - second), second)

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

    def polar(self) -> ConvexSet:
        return self.first.polar() & self.second.polar()


class Intersection(ConvexSet):
    """C & D, non-empty."""

    def __init__(self, first: ConvexSet, second: ConvexSet) -> None:
        require_same_dim("C & D", first, second)
        self.first, self.second, self.dim = first, second, first.dim
        # y starts with p_1 of the split p = p_1 + p_2, at no cost: its offsets are zero
        self.offsets = np.concatenate([np.zeros(self.dim), first.offsets, second.offsets])
        self.polyhedral = first.polyhedral and second.polyhedral
        self.certifiable = first.certifiable and second.certifiable

    def support(self, z: np.ndarray) -> float:
        z = vector("z", z, self.dim)
        size = float(np.abs(z).max())
        return size * support_by_program(self, z / size) if size else 0.0

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

        found = fixed_point(sweep, one, v)
        return None if found is None else (found, self.second.normal(v - found))

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

    def same_cone(self, other: ConvexSet) -> bool:
        return (
            isinstance(other, Intersection)
            and self.first.same_cone(other.first)
            and self.second.same_cone(other.second)
        )

    def require_nonempty(self, where: str = "C") -> None:
        self.first.require_nonempty(where)
        self.second.require_nonempty(where)
        if not self._parts_meet():
            raise EmptySetError(f"{where} is empty: the two sets of C & D do not meet")

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
        size = max(np.abs(a).max(), np.abs(b).max(), unit)
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


class Product(ConvexSet):
    """C_1 x C_2 x ...: the parts one after the other in the vector."""

    def __init__(self, parts: tuple[ConvexSet, ...]) -> None:
        self.parts = parts
        self.dim = sum(part.dim for part in parts)
        self.offsets = np.concatenate([part.offsets for part in parts])
        self.polyhedral = all(part.polyhedral for part in parts)
        self.certifiable = all(part.certifiable for part in parts)
        self._cuts = np.cumsum([part.dim for part in parts])[:-1]
        self._offset_cuts = np.cumsum([part.offsets.size for part in parts])[:-1]

    def support(self, z: np.ndarray) -> float:
        blocks = np.split(vector("z", z, self.dim), self._cuts)
        return sum(part.support(block) for part, block in zip(self.parts, blocks, strict=True))

    def project(self, w: np.ndarray) -> np.ndarray:
        blocks = np.split(vector("w", w, self.dim), self._cuts)
        projected = [part.project(block) for part, block in zip(self.parts, blocks, strict=True)]
        return np.concatenate(projected)

    def normal(self, v: np.ndarray) -> np.ndarray:
        blocks = np.split(v, self._cuts)
        return np.concatenate(
            [part.normal(block) for part, block in zip(self.parts, blocks, strict=True)]
        )

    def steps(self, tau: np.ndarray) -> np.ndarray:
        blocks = np.split(tau, self._cuts)
        return np.concatenate([part.steps(x) for part, x in zip(self.parts, blocks, strict=True)])

    def derivative(self, v: np.ndarray) -> np.ndarray | None:
        blocks = np.split(v, self._cuts)
        found = [part.derivative(x) for part, x in zip(self.parts, blocks, strict=True)]
        known = [D if D.ndim == 2 else np.diag(D) for D in found if D is not None]
        return scipy.linalg.block_diag(*known) if len(known) == len(found) else None

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
        self._selected = _selected(self.M)
        gram = self.M.T @ self.M
        gram = gram.toarray() if sp.issparse(gram) and columns <= 2000 else gram
        self._diagonal = gram.diagonal()
        largest = float(self._diagonal.max())
        away = abs(gram - sp.diags_array(self._diagonal)).max()
        self._orthogonal = bool(away <= ROUNDING * largest)
        self._uniform = bool(np.ptp(self._diagonal) <= ROUNDING * largest)
        # rank decides whether M^T z reaches every direction of R^m
        if self._orthogonal:
            self._pinv, self._square_norm = None, largest
            self._injective = bool((self._diagonal > 0).all())
        else:
            full = _dense(self.M)
            self._pinv = np.linalg.pinv(full)
            self._square_norm = float(np.linalg.norm(full, 2)) ** 2
            self._injective = bool(np.linalg.matrix_rank(full) == columns)
        self._set_part(part)

    def _set_part(self, part: ConvexSet) -> None:
        self.part, self.offsets = part, part.offsets
        self.polyhedral, self.certifiable = part.polyhedral, part.certifiable
        separable = isinstance(part, Box) or self._uniform
        self._closed_form = self._orthogonal and self._injective and separable
        # a cone of generators: by Moreau its normals are the projections on the polar polyhedron
        cone = isinstance(part, Box) and not part.offsets.any()
        self._dual = self._polar_rows() if cone and not self._closed_form else None

    def with_part(self, part: ConvexSet) -> Image:
        """{ M s : s in part } with all that depends on M alone taken over."""
        require_same_dim("image(M, C)", self.part, part)
        other = copy.copy(self)
        other._set_part(part)
        return other

    def _solve(self, w: np.ndarray) -> np.ndarray:
        """The s of least norm with M s nearest to w."""
        if self._pinv is not None:
            return self._pinv @ w
        safe = np.where(self._diagonal > 0, self._diagonal, 1.0)
        return (self.M.T @ w) / safe

    def _pulled_back(self, z: np.ndarray) -> np.ndarray:
        """M^T z; an entry that is nothing but rounding is 0, so that it meets sigma's domain."""
        inner = self.M.T @ z
        inner[np.abs(inner) <= 2 * ROUNDING * (abs(self.M).T @ np.abs(z))] = 0.0
        return inner

    def support(self, z: np.ndarray) -> float:
        return self.part.support(self._pulled_back(vector("z", z, self.dim)))

    def project(self, w: np.ndarray) -> np.ndarray:
        w = vector("w", w, self.dim)
        if self._dual is not None:
            return w - self._dual.project(w)
        s = self._nearest(w)
        return project_by_program(self, w) if s is None else self.M @ s

    def normal(self, v: np.ndarray) -> np.ndarray:
        p = v - self.project(v) if self._dual is None else self._dual.project(v)
        if np.abs(p).max() <= ROUNDING * np.abs(v).max():
            return np.zeros(self.dim)
        # p holds rounding of v; a second look leaves that of p, as the domain of sigma needs it
        if self._dual is not None:
            return self._dual.project(p)
        if self._closed_form:
            return self._lifted(p, self._diagonal * self.part.normal(self._solve(v)))
        return p

    def _lifted(self, p: np.ndarray, inner: np.ndarray) -> np.ndarray:
        """The vector nearest to p with M^T p = inner, for an injective M."""
        size = np.abs(p).max()
        for _ in range(2):
            change = inner - self.M.T @ p
            p = p + (
                self.M @ (change / self._diagonal) if self._pinv is None else self._pinv.T @ change
            )
        return p if np.abs(p).max() > ROUNDING * size else np.zeros(self.dim)

    def _nearest(self, w: np.ndarray) -> np.ndarray | None:
        """s in C with M s nearest to w, by projected gradients where M mixes."""
        s = self.part.project(self._solve(w))
        if self._closed_form or not self._square_norm:
            return s

        def descend(s: np.ndarray) -> np.ndarray:
            return self.part.project(s - self.M.T @ (self.M @ s - w) / self._square_norm)

        return fixed_point(descend, s, s)

    def features(self, p: cp.Expression) -> Features:
        return self.part.features(self.M.T @ p)

    def witness(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray
    ) -> Witness | None:
        if not self.certifiable:
            return None
        if not self._injective:
            return self._witness_of_nearest(w + float(np.mean(tau)) * p, float(np.mean(tau)))
        inner = self.M.T @ p
        weights = ((self.M * self.M).T @ tau) / self._diagonal**2  # tau in the units of s
        found = self.part.witness(inner, self._solve(w), weights, y)
        assert found is not None  # the part is certifiable
        return Witness(self._lifted(p, found.p), self.M @ found.w, found.gap)

    def _witness_of_nearest(self, v: np.ndarray, step: float) -> Witness:
        """The normal pair of the projection of v."""
        if self._dual is not None:
            normal = self.normal(v)
            return Witness(normal / step, v - normal, 0.0)
        s = self._nearest(v)
        if s is not None:
            return Witness((v - self.M @ s) / step, self.M @ s, 0.0)
        # not to rounding: the parameters nearest to the program's answer, and what they miss
        normal = v - project_by_program(self, v)
        s = self.part.project(self._solve(v - normal))
        inner = self._pulled_back(normal / step)
        gap = self.part.support(inner) - float(inner @ s)
        return Witness(normal / step, self.M @ s, max(gap, 0.0))

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

    def selection(self) -> Selection | None:
        if self._selected is None:
            return None
        return Selection(self._selected, self.part, np.zeros(self.dim))

    def polar(self) -> ConvexSet:
        if not isinstance(self.part, Box) or self.part.offsets.any():
            raise InputError("polar of an image is known for images of orthants only")
        return self._polar_rows()

    def _polar_rows(self) -> ConvexSet:
        """<p, M s> <= 0 for all s of the cone: M^T p is in its polar, row by row."""
        from sweepopt.sets.polyhedra import Polyhedron

        rows = as_rows(self.part.polar())
        assert rows is not None  # the polar of a box is a box
        return Polyhedron(rows[0] @ self.M.T, rows[1])


def fixed_point(
    step: Callable[[np.ndarray], np.ndarray], x: np.ndarray, like: np.ndarray
) -> np.ndarray | None:
    """x = step(x) to rounding for a nonexpansive step; None if SWEEPS do not suffice.

    Anderson's acceleration (Walker and Ni, SIAM J. Numer. Anal. 49, 2011), with the plain
    iteration, whose residual never grows, as the safeguard of Zhang, O'Donoghue and Boyd (2020).

    Parameters
    ----------
    step : callable
    x : ndarray, shape (dim,)
        Start.
    like : ndarray
        Data in the units of x: rounding is relative to the larger of the two.
    """
    images: list[np.ndarray] = []
    residuals: list[np.ndarray] = []
    size = float(max(np.abs(like).max(initial=0.0), np.abs(x).max()))
    for _ in range(SWEEPS):
        image = step(x)
        residual = image - x
        if np.abs(residual).max() <= ROUNDING * max(size, np.abs(image).max()):
            return image
        if residuals and np.linalg.norm(residual) > np.linalg.norm(residuals[-1]):
            x, images, residuals = images[-1], [], []
            continue
        images, residuals = [*images[-MEMORY:], image], [*residuals[-MEMORY:], residual]
        x = image
        if len(images) > 1:
            mix = np.linalg.lstsq(np.diff(residuals, axis=0).T, residual, rcond=1e-12)[0]
            ahead = image - np.diff(images, axis=0).T @ mix
            # no fixed point: the acceleration runs off, and would hide the residual in its size
            x = ahead if np.abs(ahead).max() <= RUNAWAY * size else image
    return None


def add(C: ConvexSet, other: Any) -> Any:
    """C + v or C + D; the sum with a point is a translation."""
    if is_vector(other):
        return (
            Point(C.offsets + vector("v", other, C.dim))
            if isinstance(C, Point)
            else (Translation(C, other))
        )
    if not _is_set("C + D", other):
        return NotImplemented
    require_same_dim("C + D", C, other)
    if isinstance(other, Point):
        return C + other.offsets
    return other + C.offsets if isinstance(C, Point) else Sum(C, other)


def scale(factor: Any, C: ConvexSet) -> ConvexSet:
    """r C for any finite r; 0 C is {0} and asks for a bounded C."""
    if hasattr(factor, "at"):
        raise InputError("C * D is not defined; use so.product(C, D) or C & D")
    r = number("scale", factor)
    if r < 0:
        return scale(-r, -C)
    if isinstance(C, Point):
        return Point(r * C.offsets)
    if r == 0:
        if not np.isfinite(C.magnitude()):
            raise InputError(
                "scale 0 of an unbounded set is not closed in the limit; use scale > 0"
            )
        return Point(np.zeros(C.dim))
    return Scaling(r, C)


def intersect(C: ConvexSet, D: Any) -> Any:
    """C & D."""
    from sweepopt.sets.polyhedra import ACTIVE_DIM, Polyhedron

    if not _is_set("C & D", D):
        return NotImplemented
    require_same_dim("C & D", C, D)
    above, below = as_rows(C), as_rows(D)
    if above is None or below is None or C.dim > ACTIVE_DIM:
        return Intersection(C, D)
    # rows under rows: again a polyhedron, with its exact projection
    (G, h), (F, k) = above, below
    stack = sp.vstack if sp.issparse(G) or sp.issparse(F) else np.vstack
    return Polyhedron(stack([G, F]), np.concatenate([h, k]))


def as_rows(C: ConvexSet) -> tuple[Any, np.ndarray] | None:
    """G and h with C = { w : G w <= h }, for sets that are written so."""
    from sweepopt.sets.polyhedra import Polyhedron

    if isinstance(C, Polyhedron):
        return C.G, C.h
    if isinstance(C, Box):
        above, below = np.isfinite(C.upper), np.isfinite(C.lower)
        identity = sp.eye_array(C.dim, format="csr") if C.dim > 100 else np.eye(C.dim)
        stack = sp.vstack if C.dim > 100 else np.vstack
        G = stack([identity[above], -identity[below]])
        return G, np.concatenate([C.upper[above], -C.lower[below]])
    if not isinstance(C, (Translation, Scaling, Negation)):
        return None
    rows = as_rows(C.part)
    if rows is None:
        return None
    G, h = rows
    if isinstance(C, Translation):
        return G, h + G @ C.v
    return (-G, h) if isinstance(C, Negation) else (G, C.factor * h)


def _is_set(what: str, D: Any) -> bool:
    """True for a set, False for a moving set (which then takes over), an error otherwise."""
    if not isinstance(D, ConvexSet) and not hasattr(D, "at"):
        raise InputError(f"{what}: D must be a set, got {type(D).__name__}")
    return isinstance(D, ConvexSet)


def is_vector(value: Any) -> bool:
    """Whether value can be a translation."""
    return isinstance(value, (np.ndarray, list, tuple, int, float, np.number))


def require_same_dim(what: str, C: Any, D: Any) -> None:
    """Raise InputError if the two sets live in different spaces."""
    if C.dim != D.dim:
        raise InputError(f"{what}: the sets have dim {C.dim} and {D.dim}; they must be equal")


def _selected(M: Matrix) -> np.ndarray | None:
    """The rows that M picks, if its columns are distinct unit vectors."""
    entries = sp.coo_array(M)
    entries.eliminate_zeros()
    rows = np.zeros(M.shape[1], dtype=int)
    rows[entries.col] = entries.row
    if entries.nnz != M.shape[1] or not (entries.data == 1).all():
        return None
    distinct = np.unique(entries.col).size == np.unique(entries.row).size == entries.nnz
    return rows if distinct else None


def _dense(M: Any) -> np.ndarray:
    return M.toarray() if sp.issparse(M) else M
