"""Sets made of others, in one form:  C = { c + E s : s in S, F s = g },  S a product of parts.

    sigma(C, z) = <c, z> + min over lam of  sigma(S, E^T z - F^T lam) + <g, lam>

and without rows F there is no lam. A product stacks forms, a sum adds columns to E, an intersection
rows to F, an image by M has M E for E. Support function, features, projection and normal pairs read
this form; what a sum, an intersection or an image knows beyond it stands in its class.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from sweepopt.checks import Matrix, divisor, matrix, vector
from sweepopt.errors import EmptySetError, InputError
from sweepopt.linalg import dense
from sweepopt.sets.base import (
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
    same_array,
    total_gap,
)
from sweepopt.sets.polyhedra import GeneratedCone
from sweepopt.sets.polytope import Polytope
from sweepopt.sets.programs import normal_by_program, separation_by_program, support_by_program
from sweepopt.sets.projection import Projection, Projector, Splitting, fixed_point, places
from sweepopt.sets.shapes import Box, Point
from sweepopt.sets.similar import Similar

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

    def normal_pair(self, p: np.ndarray, w: np.ndarray, tau: np.ndarray) -> NormalPair | None:
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
        return total_gap(
            part.gap_along_curve(a.T, b.T, ratio) for part, a, b in self._split(p.T, w.T)
        )

    def halfspaces(self) -> Halfspaces:
        N, d, E, e = zip(*(part.halfspaces() for part in self.parts), strict=True)
        block, stack = scipy.linalg.block_diag, np.concatenate
        return Halfspaces(block(*N), stack(d), block(*E), stack(e))

    def form(self) -> Form:
        return Form.beside([part.form() for part in self.parts])

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


def _product(parts: tuple[ConvexSet, ...]) -> ConvexSet:
    return parts[0] if len(parts) == 1 else Product(parts)


class Lifted(ConvexSet):
    """{ c + E s : s in S, F s = g }, S the product of exact parts."""

    exact = False
    _last: Projection | None = None

    def __init__(self, form: Form) -> None:
        self.lifted, self.dim = form, form.E.shape[0]
        self.part = _product(form.parts)
        self.polyhedral, self.certifiable = self.part.polyhedral, self.part.certifiable

    def form(self) -> Form:
        return self.lifted

    def __getstate__(self) -> dict[str, Any]:
        # factorisations cannot be pickled, and are made again when they are needed
        return {name: x for name, x in self.__dict__.items() if name not in ("_projector", "_last")}

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
        shift = 0.0 if form.c is None else float(form.c @ z)
        return self.part.support(_pulled(form.E.T, z)) + shift

    def same_cone(self, other: ConvexSet) -> bool:
        return (
            isinstance(other, Lifted)
            and (self.lifted.c is None) == (other.lifted.c is None)
            and all(map(same_array, self.lifted[1:3], other.lifted[1:3]))
            and self.part.same_cone(other.part)
        )

    def magnitude(self) -> float:
        if self.lifted.g.size:
            return super().magnitude()
        each = zip(self._norms, self.lifted.parts, strict=True)
        size = sum(norm * part.magnitude() for norm, part in each if norm)
        return float(np.linalg.norm(self.lifted.image_of_zero())) + size

    def _distance(self, other: ConvexSet) -> float | None:
        if self.lifted.g.size or not (isinstance(other, Lifted) and self.same_cone(other)):
            return None
        each = zip(self.lifted.parts, other.lifted.parts, strict=True)
        distances = [C.distance_bound(D) for C, D in each]
        known = [norm * d for norm, d in zip(self._norms, distances, strict=True) if d is not None]
        c = self.lifted.image_of_zero() - other.lifted.image_of_zero()
        return sum(known) + float(np.linalg.norm(c)) if len(known) == len(distances) else None

    @property
    def _norms(self) -> list[float]:
        """Bounds of |E_i| for each part."""
        blocks = [abs(self.lifted.E[:, at]) for at in places(self.lifted)]
        sums = [(E.sum(axis=0).max(), E.sum(axis=1).max(), (E * E).sum()) for E in blocks]
        return [float(np.sqrt(min(columns * rows, square))) for columns, rows, square in sums]

    # ---- projection -----------------------------------------------------------------------------

    @cached_property
    def product(self) -> ConvexSet | None:
        """The same set as a product of independent ones, if it is: each has its own units."""
        blocks = _independent(self.lifted)
        if len(blocks) < 2:
            return None
        rows = np.concatenate([block.rows for block in blocks])
        place = (np.ones(self.dim), (rows, np.arange(self.dim)))
        order = sp.csc_array(place, shape=(self.dim, self.dim))
        return Embedding(Columns.of(order), Product(tuple(_of_form(form) for _, form in blocks)))

    @cached_property
    def _projector(self) -> Projector:
        return Projector(self.lifted)

    def near(self, v: np.ndarray) -> Projection | None:
        """The projection of v, exact to rounding, and its parts; None if it is not found."""
        near = self._nearest(v) if self.certifiable else None
        return near if near is not None and near.exact else None

    def _nearest(self, v: np.ndarray) -> Projection:
        last = self._last
        if last is None or not np.array_equal(last.v, v):
            # a projection, its normal and the pair are asked for one after the other
            v, project = v.copy(), self._projector
            last = project(v, project.start(v))
            if not last.exact and self.lifted.small:
                # an interior point method comes to the right faces where sweeps crawl
                p, y = normal_by_program(self, v)
                first = 0 if self.lifted.c is None else self.dim
                unit, row = self._units
                multipliers = unit / row * y[first : first + self.lifted.g.size]
                again = project(v, project.start_beside(v, p, multipliers))
                last = again if again.exact else last
            self._last = last
        return last

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
        if (near.w == near.v).all():
            return np.zeros(self.dim)
        p = near.splitting.normal(near)
        if self.lifted.g.size or not near.splitting.small:
            return p
        # the vectors near p whose image E_i^T p is the normal of part i, part by part
        normals, known = near.normals, []
        for at, E, back in self._blocks:
            inner, one = normals[at], p
            for _ in range(2):
                one = one + back @ (inner - E.T @ one)
            known.append(one)
        best = next((one for one in known if np.isfinite(self.support(one))), p)
        noise = (best != 0) & (np.abs(best) <= ROUNDING * np.abs(best).max())
        # what one part holds is 0.0, and rounding of the others
        noise &= np.any([one == 0 for one in known], axis=0)
        still = np.where(noise, 0.0, best)
        return still if noise.any() and np.isfinite(self.support(still)) else best

    @cached_property
    def _blocks(self) -> list[tuple[slice, np.ndarray, np.ndarray]]:
        """E_i and the inverse of E_i^T of each part whose E_i has full rank, the last first."""
        blocks = [(at, dense(self.lifted.E[:, at])) for at in reversed(places(self.lifted))]
        full = [(at, E) for at, E in blocks if np.linalg.matrix_rank(E) == E.shape[1]]
        return [(at, E, np.linalg.pinv(E.T, rcond=RANK)) for at, E in full]

    def derivative(self, v: np.ndarray) -> np.ndarray | None:
        if self.product is not None:
            return self.product.derivative(v)
        near = self.near(v)
        return None if near is None else near.splitting.derivative(near)

    def normal_pair(self, p: np.ndarray, w: np.ndarray, tau: np.ndarray) -> NormalPair | None:
        if not self.certifiable:
            return None
        if self.product is not None:
            return self.product.normal_pair(p, w, tau)
        step = float(np.mean(tau))
        pair = self._pair_of(w + step * p)
        return pair and pair.over(step)

    def _pair_of(self, v: np.ndarray) -> NormalPair | None:
        """The normal pair of the projection of v; None if there is no proof."""
        near = self._nearest(v)
        if near.exact:
            p = self._normal(near)
            moved = near.splitting.perturbation(near, p) or _rounded(v)
            return NormalPair(p, near.w.copy(), 0.0, moved)
        if self.lifted.g.size:
            return None
        # not to rounding: a point of C nearby, and the normal that is the nearer one of two
        s = near.parts
        w = self.lifted.image_of_zero() + self.lifted.E @ s
        normals = (v - w, normal_by_program(self, v).p)
        pairs = [NormalPair(p, w, self._gap_of_parts(p, s)) for p in normals]
        return min(pairs, key=lambda pair: pair.gap)

    def _gap_of_parts(self, p: np.ndarray, s: np.ndarray) -> float:
        """At least sigma(C, p) - <p, c + E s> for s in S, no rows F: what is rounded counts."""
        inner = _pulled(self.lifted.E.T, p)
        sigma, rest = self.part.support(inner), self.lifted.E.T @ p - inner
        gap = max(sigma - float(inner @ s), 0.0)
        gap += ROUNDING * (abs(sigma) + float(np.abs(inner) @ np.abs(s)))
        # entries of E^T p that count as 0; where S is unbounded along them, p is rounded
        more = self.part.support(rest) - float(rest @ s)
        return gap + (max(more, 0.0) if np.isfinite(more) else float(np.abs(rest) @ np.abs(s)))

    def require_nonempty(self, where: str = "C") -> None:
        self.part.require_nonempty(where)
        if self.lifted.g.size and not self._has_point():
            raise EmptySetError(f"{where} is empty: the two sets of C & D do not meet")

    def _has_point(self) -> bool:
        """Whether F s = g for some s of S: alternating projections find one, or a program does."""
        form, size = self.lifted, float(np.abs(self.offsets).max(initial=0.0))
        if self.certifiable:
            ties = Splitting(form._replace(c=None, E=0 * form.E), np.ones(form.E.shape[1]))
            tied = ties.near(np.zeros(self.dim))
            s, fixed = fixed_point(lambda s: self.part.project(tied(s)), ties.start, size)
            size = max(size, float(np.abs(s).max()))
            distance = np.abs(s - tied(s)).max()
            if fixed or distance <= 10 * ROUNDING * size:
                # nearest points of S and { F s = g }: what is between them separates the two
                return bool(distance <= 10 * ROUNDING * size)
        F, g, unit = form.F / self._units[1], form.g / self._units[1], binary(size)
        distance = separation_by_program(self.part, F, g, unit)
        return distance <= (1e-10 if self.certifiable else 1e-6)


def _pulled(transposed: Any, z: np.ndarray) -> np.ndarray:
    """E^T z; an entry that is nothing but rounding is 0, so that it meets sigma's domain."""
    inner = np.asarray(transposed @ z)
    inner[np.abs(inner) <= 2 * ROUNDING * (abs(transposed) @ np.abs(z))] = 0.0
    return inner


def _rounded(v: np.ndarray) -> Perturbation:
    """A pair's perturbation where nothing is known but v, of which w and p are parts."""
    size = np.full(v.size, 10 * ROUNDING * np.abs(v).max())
    return Perturbation(size, size)


class _Block(NamedTuple):
    """What a form says of some entries of its vectors, whatever the others are."""

    rows: np.ndarray
    form: Form


def _independent(form: Form) -> list[_Block]:
    """The blocks that a form consists of: parts that no row of E or F ties to each other."""
    parts = [C for part in form.parts for C in part.factors()]
    owner = np.repeat(np.arange(len(parts)), [C.dim for C in parts])
    member = sp.csr_array((np.ones(owner.size), (owner, np.arange(owner.size))))
    table = sp.vstack([abs(form.E), abs(form.F), member])
    graph = sp.block_array([[None, table], [table.T, None]])
    label = connected_components(graph, directed=False)[1]
    counts = [form.E.shape[0], form.g.size, len(parts)]
    of_w, of_F, of_part, of_s = np.split(label, np.cumsum(counts))
    groups = np.unique(of_s)
    # rows without entries go with the first
    of_w, of_F = (np.where(np.isin(x, groups), x, groups[0]) for x in (of_w, of_F))
    blocks = []
    for group in groups if groups.size > 1 else ():
        rows, ties, at = (np.flatnonzero(x == group) for x in (of_w, of_F, of_s))
        own = tuple(parts[i] for i in np.flatnonzero(of_part == group))
        c = None if form.c is None else form.c[rows]
        E, F = form.E[rows][:, at], form.F[ties][:, at]
        if rows.size:
            blocks.append(_Block(rows, Form(c, E, F, form.g[ties], own)))
    return blocks


def _of_form(form: Form) -> ConvexSet:
    """The set of a form, as the image of a part if it is no more than that."""
    if len(form.parts) > 1 or form.g.size:
        return Lifted(form)
    image = image_of(Columns.of(form.E), form.parts[0])
    return image if form.c is None else Similar(image, form.c)


class Sum(Lifted):
    """The Minkowski sum C + D:  sigma(C + D, z) = sigma(C, z) + sigma(D, z)."""

    def __init__(self, first: ConvexSet, second: ConvexSet) -> None:
        self.operands = first, second
        one = sp.eye_array(first.dim)  # c + d + [E_1, E_2] s
        super().__init__(Form.beside([first.form(), second.form()]).image(sp.hstack([one, one])))

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
        one = sp.eye_array(first.dim)  # c + E_1 s_1, and rows E_1 s_1 - E_2 s_2 = d - c
        both = Form.beside([first.form(), second.form()])
        super().__init__(both.cut(sp.hstack([one, -one])).image(sp.hstack([one, 0 * one])))

    def _decided(self, v: np.ndarray) -> NormalPair | None:
        """The pair of one of the two sets, if its point lies in the other: exact from any v."""
        if self.product is not None or not self.certifiable:
            return None  # so it is with each factor
        for part, other in (self.operands, self.operands[::-1]):
            if part.exact:
                w = part.project(v)
                if not other.normal(w).any():
                    return NormalPair(part.normal(v), w, 0.0, _rounded(v))
        return None

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
        total = np.sum(np.split(near.normals, 2), axis=0)
        within = np.abs(total - p).max() <= 10 * ROUNDING * np.abs(near.v).max()
        return total if within else p

    def magnitude(self) -> float:
        return min(C.magnitude() for C in self.operands)

    def polar(self) -> ConvexSet:
        """(C & D)° = closure of C° + D°; projections on a sum are those on its closure."""
        closure: ConvexSet = self.operands[0].polar() + self.operands[1].polar()
        return closure


# ---- images -------------------------------------------------------------------------------------


class Columns(NamedTuple):
    """A matrix M, and what depends on it alone.

    Attributes
    ----------
    transposed : ndarray or sparse
    squares : ndarray, shape (k,)
        The squared lengths of the columns.
    orthogonal : bool
        Whether the columns are orthogonal, none of them 0.
    selected : ndarray or None
        The rows that M picks, if its columns are distinct unit vectors.
    """

    M: Matrix
    transposed: Matrix
    squares: np.ndarray
    orthogonal: bool
    selected: np.ndarray | None

    @classmethod
    def of(cls, M: Any) -> Columns:
        """Raises InputError if M is no finite matrix that things can be divided by."""
        M = matrix("M", M)
        if not M.shape[0]:
            raise InputError("M must have at least one row")
        for j, entry in enumerate(column_sizes(M)):
            if entry:
                divisor(f"the largest entry of column {j} of M", entry)
        # made once: a transpose costs a sparse matrix each time
        transposed = M.T.tocsr() if sp.issparse(M) else M.T
        squares = np.asarray((transposed * transposed).sum(axis=1), dtype=float).ravel()
        return cls(M, transposed, squares, _orthogonal(M, squares), _selected(M))


def image_of(columns: Columns, C: ConvexSet) -> ConvexSet:
    """{ M s : s in C } as what it is: a point, a polytope, a cone, a set of few unknowns, or more.

    Raises
    ------
    InputError
        If C has another dim than M has columns.
    """
    M = columns.M
    if M.shape[1] != C.dim:
        raise InputError(f"image(M, C): M has {M.shape[1]} columns but C has dim {C.dim}")
    if isinstance(C, Point):
        return Point(M @ C.offsets)
    weights = C.weights(columns.squares)
    if columns.orthogonal and (abs(weights - columns.squares) <= ROUNDING * weights).all():
        return Embedding(columns, C)
    if isinstance(C, Polytope):
        return Polytope((M @ C.vertices.T).T)
    if isinstance(C, Box) and not C.offsets.any():
        rows = C.polar().rows()  # <p, M s> <= 0 for all s of the cone
        assert rows is not None
        return GeneratedCone(rows[0] @ M.T)
    if isinstance(C, GeneratedCone):
        return GeneratedCone(C.G @ M.T)
    return Image(M, C)


class Image(Lifted):
    """{ M s : s in C }:  sigma(M C, z) = sigma(C, M^T z)."""

    def __init__(self, M: Matrix, operand: ConvexSet) -> None:
        super().__init__(operand.form().image(M))
        self.operand = operand

    @property
    def nonsmooth_dim(self) -> int:
        return self.operand.nonsmooth_dim

    def require_nonempty(self, where: str = "C") -> None:
        self.operand.require_nonempty(where)

    def polar(self) -> ConvexSet:
        self.operand.polar()  # says so if this is no cone at all
        raise self._polar_unknown()


class Embedding(Lifted):
    """{ M s : s in C } for an M with orthogonal columns whose lengths are weights of C.

    With M = E^T selecting a few of many unknowns this is how contact enters a large body: the
    set acts on m unknowns only, and a plan can eliminate the others.
    """

    def __init__(self, columns: Columns, operand: ConvexSet) -> None:
        self.columns, self.operand, self.dim = columns, operand, columns.M.shape[0]
        self.polyhedral, self.certifiable = operand.polyhedral, operand.certifiable
        self.exact, self._selected = operand.exact, columns.selected

    @cached_property
    def lifted(self) -> Form:  # type: ignore[override]
        return self.operand.form().image(self.columns.M)

    @cached_property
    def part(self) -> ConvexSet:  # type: ignore[override]
        return _product(self.lifted.parts)

    def _push(self, s: np.ndarray) -> np.ndarray:
        """M s."""
        if self._selected is None:
            return self.columns.M @ s
        w = np.zeros(self.dim)
        w[self._selected] = s
        return w

    def _pull(self, z: np.ndarray) -> np.ndarray:
        """M^T z."""
        return self.columns.transposed @ z if self._selected is None else z[self._selected]

    def _solve(self, w: np.ndarray) -> np.ndarray:
        """The s with M s nearest to w."""
        s = self._pull(w)
        return s if self._selected is not None else s / self.columns.squares

    def _with_image(self, p: np.ndarray, inner: np.ndarray) -> np.ndarray:
        """The vector nearest to p with M^T p = inner."""
        size = np.abs(p).max()
        for _ in range(2):
            p = p + self._push((inner - self._pull(p)) / self.columns.squares)
        return p if np.abs(p).max() > ROUNDING * size else np.zeros(self.dim)

    def project(self, w: np.ndarray) -> np.ndarray:
        return self._push(self.operand.project(self._solve(vector("w", w, self.dim))))

    def normal(self, v: np.ndarray) -> np.ndarray:
        p = v - self.project(v)
        if np.abs(p).max() <= ROUNDING * np.abs(v).max():
            return np.zeros(self.dim)
        # p holds rounding of v; a second look leaves that of p, as the domain of sigma needs it
        return self._with_image(p, self.columns.squares * self.operand.normal(self._solve(v)))

    def weights(self, tau: np.ndarray) -> np.ndarray:
        if self._selected is None or self._selected.size < self.dim:
            return ConvexSet.weights(self, tau)
        return self._push(self.operand.weights(self._pull(tau)))

    def derivative(self, v: np.ndarray) -> np.ndarray | None:
        """That of P(v); None for a selection, whose part has one."""
        if self._selected is not None and self._selected.size < self.dim:
            return None
        D = self.operand.derivative(self._solve(v))
        if D is None or (D.ndim == 1 and self._selected is not None):
            return None if D is None else self._push(D)
        M = dense(self.columns.M)
        return M @ ((np.diag(D) if D.ndim == 1 else D) / self.columns.squares) @ M.T

    def normal_pair(self, p: np.ndarray, w: np.ndarray, tau: np.ndarray) -> NormalPair | None:
        squares, transposed = self.columns.squares, self.columns.transposed
        weights = (transposed * transposed) @ tau / squares**2  # tau in the units of s
        pair = self.operand.normal_pair(self._pull(p), self._solve(w), weights)
        if pair is None:
            return None
        moved = pair.perturbation
        if moved is not None:
            size = abs(self.columns.M)
            moved = Perturbation(size @ moved.w, size @ (moved.p / squares))
        return NormalPair(self._with_image(p, pair.p), self._push(pair.w), pair.gap, moved)

    def require_nonempty(self, where: str = "C") -> None:
        self.operand.require_nonempty(where)

    def magnitude(self) -> float:
        return float(np.sqrt(self.columns.squares.max())) * self.operand.magnitude()

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
        if self._selected is None:
            return None
        return Selection(self._selected, self.operand, None)

    def polar(self) -> ConvexSet:
        self.operand.polar()  # says so if this is no cone at all
        if not isinstance(self.operand, Box):
            raise self._polar_unknown()
        rows = self.operand.polar().rows()
        assert rows is not None
        return GeneratedCone(rows[0] @ self.columns.transposed).polar()


def _orthogonal(M: Matrix, diagonal: np.ndarray) -> bool:
    """Whether the columns of M are orthogonal and none is 0; more of them than rows never are."""
    if not (diagonal > 0).all() or diagonal.size > M.shape[0]:
        return False
    rest = sp.csr_array(M.T @ M) - sp.diags_array(diagonal)
    return bool(abs(rest).max() <= ROUNDING * diagonal.max())


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


def column_sizes(M: Matrix) -> list[float]:
    """The largest entry of each column, its sign apart."""
    largest = abs(M).max(axis=0)
    found: list[float] = (largest.toarray() if sp.issparse(M) else largest).tolist()
    return found
