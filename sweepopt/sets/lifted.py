"""Sets made of others, in one form:  C = { E s : s in S, F s = 0 },  S a product of parts.

    sigma(C, z) = min over lam of  sigma(S, E^T z - F^T lam)

and without rows F there is no lam. A product stacks forms, a sum adds columns to E, an intersection
rows to F, an image by M has M E for E; a translation is the sum with a point. Support function,
features, projection and normal pairs read this form and nothing else.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, TypeGuard

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from sweepopt.checks import Matrix, vector
from sweepopt.errors import EmptySetError, InputError
from sweepopt.sets.base import (
    ROUNDING,
    ConvexSet,
    CurveGap,
    Features,
    Form,
    NormalPair,
    Perturbation,
    Selection,
    binary,
    same_array,
    total_gap,
)
from sweepopt.sets.polyhedra import GeneratedCone
from sweepopt.sets.polytope import Polytope
from sweepopt.sets.programs import normal_by_program, support_by_program
from sweepopt.sets.projection import Projection, Projector, Splitting, fixed_point, places
from sweepopt.sets.shapes import Box, Point

if TYPE_CHECKING:
    import cvxpy as cp


# Alternating projections crawl where sets nearly touch: 3,000 settle an ellipsoid and a polytope
# that are 5e-5 apart, 500 do not.
SWEEPS_BETWEEN = 3000


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

    def _joined(self, method: str, *vectors: np.ndarray) -> np.ndarray:
        return np.concatenate([getattr(part, method)(*x) for part, *x in self._split(*vectors)])

    def project(self, w: np.ndarray) -> np.ndarray:
        return self._joined("project", vector("w", w, self.dim))

    def normal(self, v: np.ndarray) -> np.ndarray:
        return self._joined("normal", v)

    def weights(self, tau: np.ndarray) -> np.ndarray:
        return self._joined("weights", tau)

    def derivative(self, v: np.ndarray) -> np.ndarray | None:
        each = [part.derivative(x) for part, x in self._split(v)]
        if any(D is None for D in each):
            return None
        return scipy.linalg.block_diag(*(D if D.ndim == 2 else np.diag(D) for D in each))

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

    def normal_pair(self, p: np.ndarray, w: np.ndarray, tau: np.ndarray) -> NormalPair | None:
        pairs: list[Any] = [part.normal_pair(*x) for part, *x in self._split(p, w, tau)]
        if any(pair is None for pair in pairs):
            return None
        perturbation = None
        if any(pair.perturbation for pair in pairs):
            each = [pair.perturbation or Perturbation(0 * pair.w, 0 * pair.p) for pair in pairs]
            perturbation = Perturbation(*map(np.concatenate, zip(*each, strict=True)))
        p, w = (np.concatenate(xs) for xs in zip(*((q.p, q.w) for q in pairs), strict=True))
        return NormalPair(p, w, sum(pair.gap for pair in pairs), perturbation)

    def gap_along_curve(self, p: np.ndarray, w: np.ndarray, ratio: float) -> CurveGap:
        return total_gap(
            part.gap_along_curve(a.T, b.T, ratio) for part, a, b in self._split(p.T, w.T)
        )

    def form(self) -> Form:
        return Form.beside(*self.parts)

    def factors(self) -> list[ConvexSet]:
        return [C for part in self.parts for C in part.factors()]

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
        distances = [a.distance_bound(b) for a, b in zip(self.parts, other.parts, strict=True)]
        return None if None in distances else float(np.linalg.norm(distances))  # type: ignore[arg-type]

    @property
    def anchor(self) -> np.ndarray:
        return np.concatenate([part.anchor for part in self.parts])

    def polar(self) -> ConvexSet:
        return Product(tuple(part.polar() for part in self.parts))


def product_of(parts: tuple[ConvexSet, ...]) -> ConvexSet:
    return parts[0] if len(parts) == 1 else Product(parts)


class Lifted(ConvexSet):
    """{ E s : s in S, F s = 0 }, S the product of exact parts."""

    exact = False
    _last: Projection | None = None

    def __init__(self, form: Form) -> None:
        if form.F.nnz:  # programs see rows of numbers near 1
            form = form._replace(F=form.F / binary(float(abs(form.F).max())))
        self.lifted, self.dim, self.part = form, form.E.shape[0], product_of(form.parts)
        self.polyhedral, self.certifiable = self.part.polyhedral, self.part.certifiable
        self._unit = binary(float(abs(form.E).max())) if form.E.nnz else 1.0

    def form(self) -> Form:
        return self.lifted

    def __getstate__(self) -> dict[str, Any]:
        # factorisations cannot be pickled, and are made again when they are needed
        return {name: x for name, x in self.__dict__.items() if name not in ("_projector", "_last")}

    # ---- support function -----------------------------------------------------------------------

    @cached_property
    def offsets(self) -> np.ndarray:  # type: ignore[override]
        return np.append(np.zeros(self.lifted.F.shape[0]), self._unit * self.part.offsets)

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        inner, F = (self.lifted.E.T / self._unit) @ p, self.lifted.F
        if not F.shape[0]:
            return self.part.features(inner)
        multipliers = cp.Variable(F.shape[0])
        y, constraints = self.part.features(inner - F.T @ multipliers)
        return Features([multipliers, *y], constraints)

    def support(self, z: np.ndarray) -> float:
        z, E = vector("z", z, self.dim), self.lifted.E
        if self.lifted.F.shape[0]:
            return support_by_program(self, z)
        # an entry that is nothing but rounding is 0, so that it meets the domain of S
        inner, rounding = E.T @ z, 2 * ROUNDING * (abs(E.T) @ np.abs(z))
        return self.part.support(np.where(np.abs(inner) <= rounding, 0.0, inner))

    def same_cone(self, other: ConvexSet) -> bool:
        return (
            isinstance(other, Lifted)
            and all(map(same_array, self.lifted[:2], other.lifted[:2]))
            and self.part.same_cone(other.part)
        )

    def magnitude(self) -> float:
        if self.lifted.F.shape[0]:
            return super().magnitude()
        each = zip(self._norms, self.lifted.parts, strict=True)
        return sum(norm * part.magnitude() for norm, part in each if norm)

    def _distance(self, other: ConvexSet) -> float | None:
        if self.lifted.F.shape[0] or not (isinstance(other, Lifted) and self.same_cone(other)):
            return None
        each = zip(self.lifted.parts, other.lifted.parts, strict=True)
        distances = [C.distance_bound(D) for C, D in each]
        known = [norm * d for norm, d in zip(self._norms, distances, strict=True) if d is not None]
        return sum(known) if len(known) == len(distances) else None

    @property
    def _norms(self) -> list[float]:
        """Bounds of |E_i| for each part."""
        blocks = [abs(self.lifted.E[:, at]) for at in places(self.lifted)]
        sums = [(E.sum(axis=0).max(), E.sum(axis=1).max(), (E * E).sum()) for E in blocks]
        return [float(np.sqrt(min(columns * rows, square))) for columns, rows, square in sums]

    # ---- projection -----------------------------------------------------------------------------

    @cached_property
    def _blocks(self) -> Embedding | None:
        """The same set as a product of independent ones, each in its own units; None if it is one.

        80 discs cut with a box are 80 small sets; as one set, their steps miss tol = 1e-9.
        """
        blocks = independent(self.lifted)
        if len(blocks) < 2:
            return None
        unknowns = np.concatenate([block.unknowns for block in blocks])
        return Embedding(product_of(tuple(Lifted(b.form) for b in blocks)), unknowns, self.dim)

    @cached_property
    def _projector(self) -> Projector:
        return Projector(self.lifted)

    def near(self, v: np.ndarray) -> Projection:
        """The projection of v, as exactly as it is found."""
        if self._last is None or not np.array_equal(self._last.v, v):
            # a projection, its normal and the pair are asked for one after the other
            v, project = v.copy(), self._projector
            near = project(v, project.start(v))
            if not near.exact and self.lifted.small:
                # an interior point method comes to the right faces where sweeps crawl
                p, y = normal_by_program(self, v)
                multipliers = self._unit * y[: self.lifted.F.shape[0]]
                again = project(v, project.start_beside(v, p, multipliers))
                near = again if again.exact else near
            self._last = near
        return self._last

    def _pair(self, v: np.ndarray) -> NormalPair | None:
        """The projection of v and its normal, exact to rounding; None if they are not found."""
        near = self.near(v) if self.certifiable else None
        if near is None or not near.exact:
            return None
        p = near.splitting.normal(near)
        size = np.abs(p).max()
        noise = np.abs(p) <= ROUNDING * (size if size > ROUNDING * np.abs(v).max() else np.inf)
        return NormalPair(np.where(noise, 0.0, p), near.w.copy(), 0.0)

    def project(self, w: np.ndarray) -> np.ndarray:
        w = vector("w", w, self.dim)
        if self._blocks is not None:
            return self._blocks.project(w)
        pair = self._pair(w)
        return w - normal_by_program(self, w).p if pair is None else pair.w

    def normal(self, v: np.ndarray) -> np.ndarray:
        if self._blocks is not None:
            return self._blocks.normal(v)
        pair = self._pair(v)
        return v - self.project(v) if pair is None else pair.p

    def weights(self, tau: np.ndarray) -> np.ndarray:
        return super().weights(tau) if self._blocks is None else self._blocks.weights(tau)

    def derivative(self, v: np.ndarray) -> np.ndarray | None:
        if self._blocks is not None:
            return self._blocks.derivative(v)
        near = self.near(v) if self.certifiable else None
        return near.splitting.derivative(near) if near is not None and near.exact else None

    def normal_pair(self, p: np.ndarray, w: np.ndarray, tau: np.ndarray) -> NormalPair | None:
        if self._blocks is not None:
            return self._blocks.normal_pair(p, w, tau)
        step = float(np.mean(tau))
        v = w + step * p
        pair = self._pair(v)
        if pair is None:
            pair = self._pair_nearby(v)
        elif pair.perturbation is None:
            near = self.near(v)
            perturbation = near.splitting.perturbation(near, pair.p) or _rounded(v)
            pair = pair._replace(perturbation=perturbation)
        if pair is None or pair.perturbation is None:
            return None
        perturbation = pair.perturbation._replace(p=pair.perturbation.p / step)
        return NormalPair(pair.p / step, pair.w, pair.gap / step, perturbation)

    def _pair_nearby(self, v: np.ndarray) -> NormalPair | None:
        """A point of C, and the better one of two normals, where no projection is exact."""
        if self.lifted.F.shape[0] or not self.certifiable:
            return None
        w = self.near(v).w
        pairs = [
            NormalPair(p, w, self.gap(p, w), _rounded(v))
            for p in (v - w, normal_by_program(self, v).p)
        ]
        return min(pairs, key=lambda pair: pair.gap)

    def require_nonempty(self, where: str = "C") -> None:
        self.part.require_nonempty(where)
        if not self.lifted.F.shape[0]:
            return
        try:
            self.project(np.zeros(self.dim))
            empty = self.certifiable and self._separated()
        except EmptySetError:
            empty = True
        if empty:
            raise EmptySetError(f"{where} is empty: the two sets of C & D do not meet")

    def _separated(self) -> bool:
        """Whether the shortest vector from S to { F s = 0 } separates the two."""
        form, project, zero = self.lifted, self._projector, np.zeros(self.dim)
        if project(zero, project.start(zero)).exact:
            return False
        size, zero = float(np.abs(self.part.offsets).max(initial=0.0)), np.zeros(form.E.shape[1])
        ties = Splitting(form._replace(E=0 * form.E), 1 + zero).K
        s, fixed = fixed_point(lambda s: self.part.project(ties(s)), zero, size, SWEEPS_BETWEEN)
        n = self.part.normal(ties(s))
        size = max(size, float(np.abs(s).max()))
        rounding = 10 * ROUNDING * np.linalg.norm(n) + np.linalg.norm(ties(n))
        if fixed:
            return bool(np.abs(n).max() > 10 * ROUNDING * size)
        return self.part.support(n) < -size * float(rounding)

    def polar(self) -> ConvexSet:
        for part in self.lifted.parts:
            part.polar()  # says so if this is no cone at all
        raise self._polar_unknown()


def _rounded(v: np.ndarray) -> Perturbation:
    """A pair's perturbation where nothing is known but v, of which w and p are parts."""
    return Perturbation(*np.full((2, v.size), 10 * ROUNDING * np.abs(v).max()))


class Sum(Lifted):
    """The Minkowski sum C + D:  sigma(C + D, z) = sigma(C, z) + sigma(D, z)."""

    def __init__(self, first: ConvexSet, second: ConvexSet) -> None:
        self.operands = first, second
        super().__init__(Form.added(first, second))

    @property
    def anchor(self) -> np.ndarray:
        return self.operands[0].anchor + self.operands[1].anchor

    def polar(self) -> ConvexSet:
        both: ConvexSet = self.operands[0].polar() & self.operands[1].polar()
        return both


class Intersection(Lifted):
    """C & D, non-empty:  sigma(C & D, z) = min over p of  sigma(C, p) + sigma(D, z - p)."""

    def __init__(self, first: ConvexSet, second: ConvexSet) -> None:
        self.operands = first, second
        one = sp.eye_array(first.dim)  # E_1 s_1, and rows E_1 s_1 - E_2 s_2 = 0
        both = Form.beside(first, second)
        super().__init__(both.cut(sp.hstack([one, -one])).image(sp.hstack([one, 0 * one])))

    def _pair(self, v: np.ndarray) -> NormalPair | None:
        # that of one of the two sets, if its point lies in the other: exact from any v
        for part, other in (self.operands, self.operands[::-1]):
            if part.exact and self.certifiable:
                w = part.project(v)
                if not other.normal(w).any():
                    return NormalPair(part.normal(v), w, 0.0, _rounded(v))
        return super()._pair(v)

    def magnitude(self) -> float:
        return min(C.magnitude() for C in self.operands)

    def polar(self) -> ConvexSet:
        """(C & D)° = closure of C° + D°; projections on a sum are those on its closure."""
        closure: ConvexSet = self.operands[0].polar() + self.operands[1].polar()
        return closure


class Block(NamedTuple):
    """What a form says of some unknowns, whatever the others are."""

    unknowns: np.ndarray
    form: Form


def independent(form: Form) -> list[Block]:
    """The blocks that a form consists of: parts that no row of E or F ties to each other."""
    parts = [C for part in form.parts for C in part.factors()]
    owner = np.repeat(np.arange(len(parts)), [C.dim for C in parts])
    member = sp.csr_array((np.ones(owner.size), (owner, np.arange(owner.size))))
    table = sp.vstack([abs(form.E), abs(form.F), member])
    count, label = connected_components(sp.block_array([[None, table], [table.T, None]]), False)
    sizes = [form.E.shape[0], form.F.shape[0], len(parts)]
    of_w, of_F, of_part, of_s = np.split(label, np.cumsum(sizes))
    blocks = []
    for group in np.unique(of_s) if count > 1 else ():
        unknowns, rows, at = (np.flatnonzero(x == group) for x in (of_w, of_F, of_s))
        own = tuple(parts[i] for i in np.flatnonzero(of_part == group))
        if unknowns.size:
            E, F = form.E[unknowns][:, at], form.F[rows][:, at]
            blocks.append(Block(unknowns, Form(E, F, own)))
    return blocks


# ---- images -------------------------------------------------------------------------------------


def image_of(M: Matrix, C: ConvexSet) -> ConvexSet:
    """{ M s : s in C } as what it is: a point, a polytope, a cone, a set of few unknowns, or more.

    Raises
    ------
    InputError
        If C has another dim than M has columns.
    """
    if M.shape[1] != C.dim:
        raise InputError(f"image(M, C): M has {M.shape[1]} columns but C has dim {C.dim}")
    if isinstance(C, Point):
        return Point(M @ C.offsets)
    unknowns = _selected(M)
    if unknowns is not None:
        return Embedding(C, unknowns, M.shape[0])
    if isinstance(C, Polytope):
        return Polytope((M @ C.vertices.T).T)
    if isinstance(C, GeneratedCone):
        return GeneratedCone(C.G @ M.T)
    if isinstance(C, Box) and not C.offsets.any():
        # <p, M s> <= 0 for all s of the cone
        return GeneratedCone(C.polar().halfspaces().N @ M.T)
    return Lifted(C.form().image(M))


class Embedding(ConvexSet):
    """{ w : w[unknowns] in part, all other entries 0 }.

    This is how contact enters a large body: the set acts on a few unknowns only, and a plan can
    eliminate the others.
    """

    def __init__(self, part: ConvexSet, unknowns: np.ndarray, dim: int) -> None:
        self.part, self.unknowns, self.dim = part, unknowns, dim
        self.polyhedral, self.certifiable = part.polyhedral, part.certifiable
        self.exact, self.offsets = part.exact, part.offsets

    def _within(self, s: np.ndarray, rest: np.ndarray | None = None) -> np.ndarray:
        """s on the few unknowns, 0 or the rest beside them."""
        w = np.zeros(self.dim) if rest is None else rest.copy()
        w[self.unknowns] = s
        return w

    def support(self, z: np.ndarray) -> float:
        return self.part.support(vector("z", z, self.dim)[self.unknowns])

    def features(self, p: cp.Expression) -> Features:
        return self.part.features(p[self.unknowns])

    def project(self, w: np.ndarray) -> np.ndarray:
        return self._within(self.part.project(vector("w", w, self.dim)[self.unknowns]))

    def normal(self, v: np.ndarray) -> np.ndarray:
        return self._within(self.part.normal(v[self.unknowns]), v)

    def weights(self, tau: np.ndarray) -> np.ndarray:
        if self.unknowns.size < self.dim:
            return super().weights(tau)
        return self._within(self.part.weights(tau[self.unknowns]))

    def derivative(self, v: np.ndarray) -> np.ndarray | None:
        """None for few of the unknowns: their set has one."""
        own = self.part.derivative(v[self.unknowns]) if self.unknowns.size == self.dim else None
        if own is None or own.ndim == 1:
            return own if own is None else self._within(own)
        back = np.argsort(self.unknowns)
        return own[np.ix_(back, back)]

    def normal_pair(self, p: np.ndarray, w: np.ndarray, tau: np.ndarray) -> NormalPair | None:
        pair = self.part.normal_pair(*(x[self.unknowns] for x in (p, w, tau)))
        if pair is None:
            return None
        off = pair.perturbation and Perturbation(*map(self._within, pair.perturbation))
        return NormalPair(self._within(pair.p, p), self._within(pair.w), pair.gap, off)

    def form(self) -> Form:
        unit = sp.eye_array(self.dim, format="csc")
        return self.part.form().image(unit[:, self.unknowns])

    def same_cone(self, other: ConvexSet) -> bool:
        return self._acts_like(other) and self.part.same_cone(other.part)

    def _acts_like(self, other: ConvexSet) -> TypeGuard[Embedding]:
        return (
            isinstance(other, Embedding)
            and self.dim == other.dim
            and np.array_equal(self.unknowns, other.unknowns)
        )

    def require_nonempty(self, where: str = "C") -> None:
        self.part.require_nonempty(where)

    def magnitude(self) -> float:
        return self.part.magnitude()

    def _distance(self, other: ConvexSet) -> float | None:
        return self.part.distance_bound(other.part) if self._acts_like(other) else None

    @property
    def selection(self) -> Selection:
        return Selection(self.unknowns, self.part, None)

    def polar(self) -> ConvexSet:
        polar, ends = self.part.polar(), np.full((self.dim, 2), [-np.inf, np.inf])
        if not isinstance(polar, Box):
            raise self._polar_unknown()
        ends[self.unknowns] = np.column_stack([polar.lower, polar.upper])
        return Box(*ends.T)


def _selected(M: Matrix) -> np.ndarray | None:
    """The rows that M picks, if its columns are distinct unit vectors."""
    entries = sp.coo_array(M)
    entries.eliminate_zeros()
    order = np.argsort(entries.col)
    columns, rows = entries.col[order], entries.row[order]
    picks = np.array_equal(columns, np.arange(M.shape[1])) and (entries.data == 1).all()
    return rows if picks and np.unique(rows).size == rows.size else None
