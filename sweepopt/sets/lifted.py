"""Sets made of others, in one form:  C = { c + E s : s in S, F s = g },  S a product of parts.

    sigma(C, z) = <c, z> + min over lam of  sigma(S, E^T z - F^T lam) + <g, lam>

and without rows F there is no lam. A product stacks forms, a sum adds columns to E, an intersection
rows to F, an image by M has M E for E. Support function, features, projection and normal pairs read
this form; what a sum, an intersection or an image knows beyond it stands in its class.
"""

from __future__ import annotations

import copy
from abc import abstractmethod
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from sweepopt.checks import Matrix, divisor, matrix, vector
from sweepopt.errors import EmptySetError, InputError
from sweepopt.linalg import dense
from sweepopt.sets.base import (
    DENSE,
    RANK,
    ROUNDING,
    ConvexSet,
    CurveGap,
    Features,
    Form,
    Halfspaces,
    NormalPair,
    Perturbation,
    Selection,
    binary,
    require_same_dim,
    same_array,
)
from sweepopt.sets.polyhedra import Polyhedron
from sweepopt.sets.programs import distance_by_program, normal_by_program, support_by_program
from sweepopt.sets.projection import (
    FIRST,
    LATER,
    ON_FACES,
    SPARSE,
    Projection,
    Projector,
    fixed_point,
    places,
    rounded,
)
from sweepopt.sets.shapes import Box

if TYPE_CHECKING:
    import cvxpy as cp


class Product(ConvexSet):
    """C_1 x C_2 x ...: the parts one after the other in the vector.

    sigma(C x D, (y, z)) = sigma(C, y) + sigma(D, z), and so it is with all else.
    """

    def __init__(self, parts: tuple[ConvexSet, ...]) -> None:
        self.parts = parts
        self.dim = sum(part.dim for part in parts)
        self.polyhedral = all(part.polyhedral for part in parts)
        self.certifiable = all(part.certifiable for part in parts)
        self.exact = all(part.exact for part in parts)
        self._cuts = np.cumsum([part.dim for part in parts])[:-1]

    @cached_property
    def offsets(self) -> np.ndarray:  # type: ignore[override]
        return np.concatenate([part.offsets for part in self.parts])

    def _split(self, *vectors: np.ndarray) -> Any:
        """The parts, each with its blocks of the vectors."""
        return zip(self.parts, *(np.split(v, self._cuts) for v in vectors), strict=True)

    def support(self, z: np.ndarray) -> float:
        return sum(part.support(x) for part, x in self._split(vector("z", z, self.dim)))

    def project(self, w: np.ndarray) -> np.ndarray:
        each = self._split(vector("w", w, self.dim))
        return np.concatenate([part.project(x) for part, x in each])

    def normal(self, v: np.ndarray) -> np.ndarray:
        return np.concatenate([part.normal(x) for part, x in self._split(v)])

    def weights(self, tau: np.ndarray) -> np.ndarray:
        return np.concatenate([part.weights(x) for part, x in self._split(tau)])

    def nearest(self, w: np.ndarray, tau: np.ndarray) -> np.ndarray:
        return np.concatenate([part.nearest(x, t) for part, x, t in self._split(w, tau)])

    def derivative(self, v: np.ndarray) -> np.ndarray | None:
        known = []
        for part, x in self._split(v):
            D = part.derivative(x)
            if D is None:
                return None
            known.append(D)
        if all(D.ndim == 1 for D in known):
            return np.concatenate(known)
        return scipy.linalg.block_diag(*(D if D.ndim == 2 else np.diag(D) for D in known))

    def features(self, p: cp.Expression) -> Features:
        y: list[Any] = []
        constraints: list[Any] = []
        start = 0
        for part in self.parts:
            more, others = part.features(p[start : start + part.dim])
            y += more
            constraints += others
            start += part.dim
        return Features(y, constraints)

    def normal_pair(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray | None = None
    ) -> NormalPair | None:
        known = []
        for part, *blocks in self._split(p, w, tau):
            pair = part.normal_pair(*blocks)
            if pair is None:
                return None
            known.append(pair)
        moved = None
        if any(pair.perturbation for pair in known):
            each = [pair.perturbation or Perturbation(0 * pair.w, 0 * pair.p) for pair in known]
            moved = Perturbation(*map(np.concatenate, zip(*each, strict=True)))
        return NormalPair(
            np.concatenate([pair.p for pair in known]),
            np.concatenate([pair.w for pair in known]),
            sum(pair.gap for pair in known),
            moved,
        )

    def gap(self, p: np.ndarray, w: np.ndarray) -> float:
        return sum(part.gap(*blocks) for part, *blocks in self._split(p, w))

    def gap_along_curve(self, p: np.ndarray, w: np.ndarray, ratio: float) -> CurveGap:
        return CurveGap.beside(
            part.gap_along_curve(a.T, b.T, ratio) for part, a, b in self._split(p.T, w.T)
        )

    def halfspaces(self) -> Halfspaces:
        N, d, E, e = zip(*(part.halfspaces() for part in self.parts), strict=True)
        block, stack = scipy.linalg.block_diag, np.concatenate
        return Halfspaces(block(*N), stack(d), block(*E), stack(e))

    def form(self) -> Form:
        return Form.beside([part.form() for part in self.parts])

    @property
    def ends(self) -> np.ndarray:
        starts = [0, *self._cuts]
        parts = zip(starts, self.parts, strict=True)
        return np.concatenate([start + part.ends for start, part in parts])

    def factors(self, ends: np.ndarray) -> list[ConvexSet]:
        pieces: list[ConvexSet] = []
        starts = [0, *self._cuts]
        for start, part in zip(starts, self.parts, strict=True):
            inner = ends[(ends > start) & (ends < start + part.dim)] - start
            pieces += part.factors(np.append(inner, part.dim))
        # of several pieces where a part ends and the factor does not
        reached = np.cumsum([piece.dim for piece in pieces])
        last = (np.searchsorted(reached, ends) + 1).tolist()
        groups = [tuple(pieces[i:j]) for i, j in pairwise([0, *last])]
        return [group[0] if len(group) == 1 else Product(group) for group in groups]

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

    def _distance(self, other: ConvexSet) -> float | None:
        if not isinstance(other, Product) or not np.array_equal(self._cuts, other._cuts):
            return None
        found = [a.distance_bound(b) for a, b in zip(self.parts, other.parts, strict=True)]
        known = [distance for distance in found if distance is not None]
        return float(np.linalg.norm(known)) if len(known) == len(found) else None

    @property
    def anchor(self) -> np.ndarray:
        return np.concatenate([part.anchor for part in self.parts])

    @property
    def nonsmooth_dim(self) -> int:
        return sum(part.nonsmooth_dim for part in self.parts)

    def polar(self) -> ConvexSet:
        return Product(tuple(part.polar() for part in self.parts))


class Lifted(ConvexSet):
    """{ c + E s : s in S, F s = g }, S the product of exact parts."""

    exact = False
    product: Product | None = None  # the same set, where it is projected on factor by factor
    _last: tuple[np.ndarray, Projection | None] | None = None

    def __init__(self, dim: int, *operands: ConvexSet) -> None:
        self.dim, self.operands = dim, operands
        self.polyhedral = all(C.polyhedral for C in operands)
        self.certifiable = all(C.certifiable for C in operands)

    @cached_property
    def lifted(self) -> Form:
        """c, E, F, g and the parts."""
        raise NotImplementedError

    def form(self) -> Form:
        return self.lifted

    def __getstate__(self) -> dict[str, Any]:
        # factorisations cannot be pickled, and are made again when they are needed
        return {name: x for name, x in self.__dict__.items() if name not in ("_projector", "_last")}

    @cached_property
    def part(self) -> ConvexSet:
        """S."""
        parts = self.lifted.parts
        return parts[0] if len(parts) == 1 else Product(parts)

    # ---- support function -----------------------------------------------------------------------

    @cached_property
    def _units(self) -> tuple[float, float]:
        """Of E and F, powers of two: programs see matrices of numbers near 1."""
        E, F = (binary(float(abs(M).max())) if M.nnz else 1.0 for M in self.lifted[1:3])
        return E, F

    @cached_property
    def offsets(self) -> np.ndarray:  # type: ignore[override]
        form, (unit, row) = self.lifted, self._units
        c = () if form.c is None else (form.c,)
        return np.concatenate([*c, unit / row * form.g, unit * self.part.offsets])

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        form, (unit, row) = self.lifted, self._units
        inner, first = (form.E.T / unit) @ p, [] if form.c is None else [p]
        if form.g.size:
            multipliers = cp.Variable(form.g.size)
            inner = inner - (form.F.T / row) @ multipliers
            first.append(multipliers)
        y, constraints = self.part.features(inner)
        return Features([*first, *y], constraints)

    def support(self, z: np.ndarray) -> float:
        z, form = vector("z", z, self.dim), self.lifted
        if form.g.size:
            return support_by_program(self, z)
        return self.part.support(self._pulled(z)) + (0.0 if form.c is None else float(form.c @ z))

    def _pulled(self, z: np.ndarray) -> np.ndarray:
        """E^T z; an entry that is nothing but rounding is 0, so that it meets sigma's domain."""
        E = self.lifted.E
        inner = np.asarray(E.T @ z)
        inner[np.abs(inner) <= 2 * ROUNDING * (abs(E).T @ np.abs(z))] = 0.0
        return inner

    def same_cone(self, other: ConvexSet) -> bool:
        return (
            isinstance(other, Lifted)
            and type(self) is type(other)
            and len(self.operands) == len(other.operands)
            and all(C.same_cone(D) for C, D in zip(self.operands, other.operands, strict=True))
        )

    # ---- projection -----------------------------------------------------------------------------

    @cached_property
    def _projector(self) -> Projector:
        return Projector(self.lifted)

    def near(self, v: np.ndarray) -> Projection | None:
        """The projection of v, exact to rounding, and its parts; None if it is not found."""
        last = self._last
        if last is None or not np.array_equal(last[0], v):
            # a projection, its normal and the pair are asked for one after the other
            last = self._last = (v.copy(), self._found(v) if self.certifiable else None)
        return last[1]

    def _found(self, v: np.ndarray) -> Projection | None:
        own = self._projector.start(v)
        for effort in FIRST if self._projector.small else (SPARSE,):
            found = self._projector(v, own, effort)
            if found is not None:
                return found
        if not self._projector.small:
            return None
        p, y = normal_by_program(self, v)
        first = 0 if self.lifted.c is None else self.dim
        unit, row = self._units
        multipliers = unit / row * y[first : first + self.lifted.g.size]
        starts = [self._projector.from_program(v, p, multipliers), own]
        for effort in (*FIRST, *LATER, *((ON_FACES,) if self.polyhedral else ())):
            for start in starts:
                found = self._projector(v, start, effort)
                if found is not None:
                    return found
        return None

    def weights(self, tau: np.ndarray) -> np.ndarray:
        return super().weights(tau) if self.product is None else self.product.weights(tau)

    def project(self, w: np.ndarray) -> np.ndarray:
        w = vector("w", w, self.dim)
        if self.product is not None:
            return self.product.project(w)
        near = self.near(w)
        return w - normal_by_program(self, w).p if near is None else near.w.copy()

    def normal(self, v: np.ndarray) -> np.ndarray:
        if self.product is not None:
            return self.product.normal(v)
        near = self.near(v)
        if near is None:
            return v - self.project(v)
        p = self._normal(near)
        return np.zeros(self.dim) if np.abs(p).max() <= ROUNDING * np.abs(v).max() else p

    def _normal(self, near: Projection) -> np.ndarray:
        """v - w, as a part computes it in whose domain E^T p must be."""
        p = near.splitting.normal(near)
        if (near.w == near.v).all():
            return np.zeros(self.dim)
        if self.lifted.g.size or not near.splitting.small:
            return p
        known = self._common(near, p)
        best = next((one for one in known if np.isfinite(self.support(one))), p)
        noise = (best != 0) & (np.abs(best) <= ROUNDING * np.abs(best).max())
        # what one part holds is 0.0, and rounding of the others
        still = np.where(noise & np.any([one == 0 for one in known], axis=0), 0.0, best)
        return still if np.isfinite(self.support(still)) else best

    def _common(self, near: Projection, p: np.ndarray) -> list[np.ndarray]:
        """The vectors near p whose image E_i^T p is the normal of part i, part by part."""
        n, E = near.splitting.units * near.splitting.normals(near), self.lifted.E
        blocks = [(dense(E[:, at]), n[at]) for at in reversed(places(self.lifted))]
        known = [_with_image(block, p, inner) for block, inner in blocks]
        return [one for one in known if one is not None]

    def derivative(self, v: np.ndarray) -> np.ndarray | None:
        if self.product is not None:
            return self.product.derivative(v)
        near = self.near(v)
        return None if near is None else near.splitting.derivative(near)

    def normal_pair(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray | None = None
    ) -> NormalPair | None:
        if not self.certifiable:
            return None
        if self.product is not None:
            return self.product.normal_pair(p, w, tau)
        step = float(np.mean(tau))
        pair = self._pair_of(w + step * p)
        return pair and pair.over(step)

    def _pair_of(self, v: np.ndarray) -> NormalPair | None:
        """The normal pair of the projection of v; None if there is no proof."""
        near = self.near(v)
        if near is not None:
            p = self._normal(near)
            return NormalPair(p, near.w.copy(), 0.0, near.perturbation(p))
        if self.lifted.g.size:
            return None
        # not to rounding: a point of C nearby, and the normal that is the nearer one of two
        s = self._projector.approximate(v)
        w = self.lifted.image_of_zero() + self.lifted.E @ s
        normals = (v - w, normal_by_program(self, v).p)
        pairs = [NormalPair(p, w, self._gap_of_parts(p, s)) for p in normals]
        return min(pairs, key=lambda pair: pair.gap)

    def _gap_of_parts(self, p: np.ndarray, s: np.ndarray) -> float:
        """At least sigma(C, p) - <p, c + E s> for s in S, no rows F: what is rounded counts."""
        inner = self._pulled(p)
        sigma, rest = self.part.support(inner), self.lifted.E.T @ p - inner
        gap = max(sigma - float(inner @ s), 0.0)
        gap += ROUNDING * (abs(sigma) + float(np.abs(inner) @ np.abs(s)))
        # entries of E^T p that count as 0; where S is unbounded along them, p is rounded
        more = self.part.support(rest) - float(rest @ s)
        return gap + (max(more, 0.0) if np.isfinite(more) else float(np.abs(rest) @ np.abs(s)))

    def require_nonempty(self, where: str = "C") -> None:
        for C in self.operands:
            C.require_nonempty(where)


def _with_image(E: np.ndarray, p: np.ndarray, inner: np.ndarray) -> np.ndarray | None:
    """The vector nearest to p with E^T p = inner, for an E of full column rank."""
    if E.shape == (p.size, p.size) and (np.eye(p.size) == E).all():
        return inner
    if np.linalg.matrix_rank(E) < E.shape[1]:
        return None
    back = np.linalg.pinv(E.T, rcond=RANK)
    for _ in range(2):
        p = p + back @ (inner - E.T @ p)
    return p


class Pair(Lifted):
    """C + D or C & D. Of products alike both are products:

    (C_1 x C_2) & (D_1 x D_2) = (C_1 & D_1) x (C_2 & D_2), and so it is with +.
    """

    def __init__(self, first: ConvexSet, second: ConvexSet) -> None:
        super().__init__(first.dim, first, second)
        self.first, self.second = first, second

    @abstractmethod
    def _of(self, C: ConvexSet, D: ConvexSet) -> ConvexSet:
        """C + D, or C & D."""

    @property
    def ends(self) -> np.ndarray:
        return np.intersect1d(self.first.ends, self.second.ends)

    def factors(self, ends: np.ndarray) -> list[ConvexSet]:
        each = zip(self.first.factors(ends), self.second.factors(ends), strict=True)
        return [self._of(C, D) for C, D in each]

    @cached_property
    def product(self) -> Product | None:  # type: ignore[override]
        if self.lifted.small or self.ends.size == 1:
            return None
        return Product(tuple(self.factors(self.ends)))


class Sum(Pair):
    """The Minkowski sum C + D:  sigma(C + D, z) = sigma(C, z) + sigma(D, z)."""

    def _of(self, C: ConvexSet, D: ConvexSet) -> ConvexSet:
        total: ConvexSet = C + D
        return total

    @cached_property
    def lifted(self) -> Form:  # c + d + [E_1, E_2] s
        one = sp.eye_array(self.dim)
        both = Form.beside([self.first.form(), self.second.form()])
        return both.image(sp.hstack([one, one]))

    def _common(self, near: Projection, p: np.ndarray) -> list[np.ndarray]:
        # sets that are projected on exactly compute their own normals
        forms = [C.form() for C in self.operands]
        cut = np.split(near.parts, [forms[0].E.shape[1]])
        x, y = (form.image_of_zero() + form.E @ s for form, s in zip(forms, cut, strict=True))
        each = ((self.second, near.v - x), (self.first, near.v - y))
        own = [C.normal(v) for C, v in each if C.exact or (isinstance(C, Image) and C.dual)]
        return [*own, *super()._common(near, p)]

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


class Intersection(Pair):
    """C & D, non-empty:  sigma(C & D, z) = min over p of  sigma(C, p) + sigma(D, z - p)."""

    def _of(self, C: ConvexSet, D: ConvexSet) -> ConvexSet:
        common: ConvexSet = C & D
        return common

    @cached_property
    def lifted(self) -> Form:  # c + E_1 s_1, and rows E_1 s_1 - E_2 s_2 = d - c
        one = sp.eye_array(self.dim)
        both = Form.beside([self.first.form(), self.second.form()])
        return both.cut(sp.hstack([one, -one])).image(sp.hstack([one, 0 * one]))

    def _decided(self, v: np.ndarray) -> NormalPair | None:
        """The pair of one of the two sets, if its point lies in the other: exact from any v."""
        if self.product is not None:
            return None  # so it is with each factor
        for part, other in ((self.first, self.second), (self.second, self.first)):
            if part.exact and self.certifiable:
                w = part.project(v)
                if not other.normal(w).any():
                    return NormalPair(part.normal(v), w, 0.0, rounded(v))
        return None if self.lifted.small else self._alternated(v)

    def _alternated(self, v: np.ndarray) -> NormalPair | None:
        """Normals p of C and q of D at w = v - p - q by Dykstra's alternation, for large sets.

        J. P. Boyle, R. L. Dykstra, Advances in Order Restricted Statistical Inference, 1986.
        """
        if not (self.certifiable and self.first.exact and self.second.exact):
            return None

        def step(p: np.ndarray) -> np.ndarray:
            return self.first.normal(v - self.second.normal(v - p))

        p = fixed_point(step, np.zeros(self.dim), float(np.abs(v).max()))
        if p is None:
            return None
        q = self.second.normal(v - p)
        return NormalPair(p + q, v - p - q, 0.0, rounded(v))

    def project(self, w: np.ndarray) -> np.ndarray:
        w = vector("w", w, self.dim)
        decided = self._decided(w)
        return super().project(w) if decided is None else decided.w

    def normal(self, v: np.ndarray) -> np.ndarray:
        decided = self._decided(v)
        return super().normal(v) if decided is None else decided.p

    def _pair_of(self, v: np.ndarray) -> NormalPair | None:
        return self._decided(v) or super()._pair_of(v)

    def _normal(self, near: Projection) -> np.ndarray:
        p, form = super()._normal(near), self.lifted
        if not p.any() or [part.dim for part in form.parts] != 2 * [self.dim]:
            return p
        # the normals of two parts add up: what none of them holds is exactly 0
        total = np.sum(np.split(near.splitting.units * near.splitting.normals(near), 2), axis=0)
        within = np.abs(total - p).max() <= 10 * ROUNDING * np.abs(near.v).max()
        return total if within else p

    def require_nonempty(self, where: str = "C") -> None:
        super().require_nonempty(where)
        if not self._parts_meet():
            raise EmptySetError(f"{where} is empty: the two sets of C & D do not meet")

    def _parts_meet(self) -> bool:
        """Whether alternating projections find a common point, or no plane separates the parts."""
        tol, inaccurate = (ROUNDING, 1e-10) if self.certifiable else (1e-7, 1e-6)

        def step(b: np.ndarray) -> np.ndarray:
            return self.second.project(self.first.project(b))

        b = step(np.zeros(self.dim))
        if self.certifiable:
            nearest = fixed_point(step, b, float(np.abs(b).max()))
            b = b if nearest is None else nearest
        a = self.first.project(b)
        size = max(np.abs(a).max(), np.abs(b).max(), np.abs(self.offsets).max(initial=0.0))
        if np.abs(a - b).max() <= tol * size:
            return True
        # a plane between the nearest points a and b proves that there is none
        p = b - a
        between = -self.first.support(p) - self.second.support(-p)
        if between > 0.1 * (p @ p):
            return False
        distance = distance_by_program(self.first, self.second, binary(float(size)))
        return distance is not None and distance <= inaccurate

    def magnitude(self) -> float:
        return min(self.first.magnitude(), self.second.magnitude())

    def polar(self) -> ConvexSet:
        """(C & D)° = closure of C° + D°; projections on a sum are those on its closure."""
        return self.first.polar() + self.second.polar()


class Image(Lifted):
    """{ M s : s in C }:  sigma(M C, z) = sigma(C, M^T z).

    With M = E^T selecting a few of many unknowns this is how contact enters a large body: the
    set acts on m unknowns only, and a plan can eliminate the others. `image` makes it.

    Where the columns of M are orthogonal and their lengths weights of the projection on C, the
    projection has a closed form; where M is injective and small, normal pairs of C are lifted.

    Raises
    ------
    InputError
        If M is not a finite matrix with C.dim columns; if a column that is not zero has no entry of
        1e-75 or more.
    """

    def __init__(self, M: Any, part: ConvexSet) -> None:
        self.M = matrix("M", M)
        dim, columns = self.M.shape
        if not dim:
            raise InputError("M must have at least one row")
        if columns != part.dim:
            raise InputError(f"image(M, C): M has {columns} columns but C has dim {part.dim}")
        for j, entry in enumerate(column_sizes(self.M)):
            if entry:
                divisor(f"the largest entry of column {j} of M", entry)
        self._selected = selected(self.M)
        # made once: a transpose costs a sparse matrix each time
        self._transposed = self.M.T.tocsr() if sp.issparse(self.M) else self.M.T
        self._squares = self._transposed * self._transposed
        self._diagonal = np.asarray(self._squares.sum(axis=1), dtype=float).ravel()
        self._orthogonal = _orthogonal(self.M, self._diagonal)
        self._pinv = None
        self.injective = self._orthogonal and bool((self._diagonal > 0).all())
        if not self._orthogonal and max(self.M.shape) <= DENSE:
            full = dense(self.M)
            self.injective = bool(np.linalg.matrix_rank(full) == columns)
            self._pinv = np.linalg.pinv(full) if self.injective else None
        self._set_operand(dim, part)

    def _set_operand(self, dim: int, operand: ConvexSet) -> None:
        for cached in ("lifted", "part", "offsets", "_units", "_projector", "_last"):
            self.__dict__.pop(cached, None)  # those of another operand
        super().__init__(dim, operand)
        self.operand = operand
        weights = operand.weights(self._diagonal)
        even = np.abs(weights - self._diagonal) <= ROUNDING * weights
        self._closed_form = self._orthogonal and self.injective and bool(even.all())
        self.exact = self._closed_form and operand.exact
        # a cone of generators: by Moreau its normals are the projections on the polar polyhedron
        cone = isinstance(operand, Box) and not operand.offsets.any()
        self.dual = self._polar_rows() if cone and not self._closed_form else None

    def with_operand(self, operand: ConvexSet) -> Image:
        """{ M s : s in operand } with all that depends on M alone taken over."""
        require_same_dim("image(M, C)", self.operand, operand)
        other = copy.copy(self)
        other._set_operand(self.dim, operand)
        return other

    @cached_property
    def lifted(self) -> Form:
        return self.operand.form().image(self.M)

    def _solve(self, w: np.ndarray) -> np.ndarray:
        """The s with M s nearest to w, for an injective M."""
        if self._pinv is not None:
            return self._pinv @ w
        return w[self._selected] if self._selected is not None else self._pull(w) / self._diagonal

    def _push(self, s: np.ndarray) -> np.ndarray:
        """M s."""
        if self._selected is None:
            return self.M @ s
        w = np.zeros(self.dim)
        w[self._selected] = s
        return w

    def _pull(self, z: np.ndarray) -> np.ndarray:
        """M^T z."""
        return self._transposed @ z if self._selected is None else z[self._selected]

    def _with_image(self, p: np.ndarray, inner: np.ndarray) -> np.ndarray:
        """The vector nearest to p with M^T p = inner, for an injective M."""
        size = np.abs(p).max()
        for _ in range(2):
            change = inner - self._pull(p)
            p = p + (
                self._push(change / self._diagonal) if self._pinv is None else self._pinv.T @ change
            )
        return p if np.abs(p).max() > ROUNDING * size else np.zeros(self.dim)

    def support(self, z: np.ndarray) -> float:
        if self._selected is None:
            return super().support(z)
        return self.operand.support(self._pull(vector("z", z, self.dim)))

    def project(self, w: np.ndarray) -> np.ndarray:
        w = vector("w", w, self.dim)
        if self.dual is not None:
            return w - self.dual.project(w)
        if self._closed_form:
            return self._push(self.operand.project(self._solve(w)))
        return super().project(w)

    def normal(self, v: np.ndarray) -> np.ndarray:
        if self.dual is None and not self._closed_form:
            return super().normal(v)
        p = v - self.project(v) if self.dual is None else self.dual.project(v)
        if np.abs(p).max() <= ROUNDING * np.abs(v).max():
            return np.zeros(self.dim)
        # p holds rounding of v; a second look leaves that of p, as the domain of sigma needs it
        if self.dual is not None:
            return self.dual.project(p)
        return self._with_image(p, self._diagonal * self.operand.normal(self._solve(v)))

    def derivative(self, v: np.ndarray) -> np.ndarray | None:
        """That of P(v); None for a selection, whose part has one."""
        if self.dual is not None:
            normal = self.dual.derivative(v)
            return None if normal is None else np.eye(self.dim) - normal
        return None if self._selected is not None else super().derivative(v)

    def normal_pair(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray | None = None
    ) -> NormalPair | None:
        if not (self.injective and self.certifiable):
            return super().normal_pair(p, w, tau)
        inner = self._pull(p)
        weights = (self._squares @ tau) / self._diagonal**2  # tau in the units of s
        found = self.operand.normal_pair(inner, self._solve(w), weights)
        if found is None:
            return None
        moved = found.perturbation
        if moved is not None:
            size = abs(self.M)
            back = size / self._diagonal if self._pinv is None else np.abs(self._pinv.T)
            moved = Perturbation(size @ moved.w, back @ moved.p)
        return NormalPair(self._with_image(p, found.p), self._push(found.w), found.gap, moved)

    def _pair_of(self, v: np.ndarray) -> NormalPair | None:
        if self.dual is None:
            return super()._pair_of(v)
        normal = self.normal(v)
        return NormalPair(normal, v - normal, 0.0)

    def same_cone(self, other: ConvexSet) -> bool:
        return isinstance(other, Image) and same_array(self.M, other.M) and super().same_cone(other)

    def magnitude(self) -> float:
        total = self._diagonal.max() if self._orthogonal else self._diagonal.sum()
        return float(np.sqrt(total)) * self.operand.magnitude() if total else 0.0

    def _distance(self, other: ConvexSet) -> float | None:
        if not (isinstance(other, Image) and same_array(self.M, other.M)):
            return None
        found = self.operand.distance_bound(other.operand)
        square = self._diagonal.max() if self._orthogonal else self._diagonal.sum()
        return None if found is None else float(np.sqrt(square)) * found

    def halfspaces(self) -> Halfspaces:
        """Beside the few unknowns that a selection acts on w is 0."""
        if self._selected is None:
            return super().halfspaces()
        inner, unit = self.operand.halfspaces(), np.eye(self.dim)
        few, rest = unit[self._selected], np.delete(unit, self._selected, axis=0)
        E, e = np.vstack([inner.E @ few, rest]), np.append(inner.e, np.zeros(len(rest)))
        return Halfspaces(inner.N @ few, inner.d, E, e)

    @property
    def nonsmooth_dim(self) -> int:
        return self.operand.nonsmooth_dim

    @property
    def selection(self) -> Selection | None:
        found = self._selected
        return None if found is None else Selection(found, self.operand, None)

    def polar(self) -> ConvexSet:
        self.operand.polar()  # says so if this is no cone at all
        if not isinstance(self.operand, Box):
            raise self._polar_unknown()
        return self._polar_rows()

    def _polar_rows(self) -> ConvexSet:
        """<p, M s> <= 0 for all s of the cone: M^T p is in its polar, row by row."""
        rows = self.operand.polar().rows()
        assert rows is not None  # the polar of a box is a box
        return Polyhedron(rows[0] @ self.M.T, rows[1])


def _orthogonal(M: Matrix, diagonal: np.ndarray) -> bool:
    """Whether the columns of M are orthogonal; more columns than rows never are."""
    if (diagonal > 0).sum() > M.shape[0]:
        return False
    rest = sp.csr_array(M.T @ M) - sp.diags_array(diagonal)
    return bool(abs(rest).max() <= ROUNDING * diagonal.max())


def selected(M: Matrix) -> np.ndarray | None:
    """The rows that M picks, if its columns are distinct unit vectors."""
    entries = sp.coo_array(M)
    entries.eliminate_zeros()
    rows = np.zeros(M.shape[1], dtype=int)
    rows[entries.col] = entries.row
    if entries.nnz != M.shape[1] or not (entries.data == 1).all():
        return None
    distinct = np.unique(entries.col).size == np.unique(entries.row).size == entries.nnz
    return rows if distinct else None


def column_sizes(M: Matrix) -> list[float]:
    """The largest entry of each column, its sign apart."""
    largest = abs(M).max(axis=0)
    found: list[float] = (largest.toarray() if sp.issparse(M) else largest).tolist()
    return found
