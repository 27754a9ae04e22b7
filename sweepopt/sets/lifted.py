"""Sets made of others, in one form:  C = { E s : s in S, F s = 0 },  S a product of parts.

    sigma(C, z) = min over lam of  sigma(S, E^T z - F^T lam)

and without rows F there is no lam. A product stacks forms, a sum adds columns to E, an intersection
rows to F, an image by M has M E for E; a translation is the sum with a point. Support function,
features, projection and normal pairs read this form and nothing else.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from functools import cached_property, reduce
from operator import add, and_
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import norm

from sweepopt.checks import Array
from sweepopt.errors import EmptySetError, TouchingError
from sweepopt.sets.aligned import Aligned, product_of, shape_of
from sweepopt.sets.balls import Ball, Balls
from sweepopt.sets.base import (
    ROUNDING,
    Blocks,
    ConvexSet,
    Features,
    Form,
    NormalPair,
    Perturbation,
    binary,
    once,
    placed,
    same_array,
)
from sweepopt.sets.curves import basis
from sweepopt.sets.polyhedra import Polyhedron
from sweepopt.sets.programs import normal_by_program, support_by_program
from sweepopt.sets.projection import Projection, Projector, Start
from sweepopt.sets.separation import is_separated
from sweepopt.sets.shapes import Box

if TYPE_CHECKING:
    import cvxpy as cp


# From so far away bounded parts of a set are less than rounding, and the square is no overflow.
REMOTE = 2.0**200
REMEDY = (
    "give what they share as a set of its own, a Point for example, or let them overlap by 1e-8 of "
    "their size"
)
REFLECTIONS = 10  # in each of two sets: they end in 199 of 211 random C & D, many nearly touching
AHEAD = 1e3  # times the size of C & D: how far along p the point is that is projected


@once
def _size(E: sp.csr_array) -> float:
    """A bound of the spectral norm."""
    return float(min(np.sqrt(norm(E, 1) * norm(E, np.inf)), norm(E)))


class Lifted(ConvexSet):
    """{ E s : s in S, F s = 0 }, S the product of exact parts; the operands are what made it."""

    exact = False

    def __init__(self, lifted: Form, *operands: ConvexSet) -> None:
        # (C + D) + E is made of three: 2,000 operations are no deeper than one
        self.operands: tuple[ConvexSet, ...] = sum(
            (C.operands if type(C) is type(self) else (C,) for C in operands), ()
        )
        self.lifted, self.dim, self.part = lifted, lifted.E.shape[0], product_of(lifted.parts)
        self.polyhedral, self.certifiable = self.part.polyhedral, self.part.certifiable
        self._cut = lifted.F.shape[0] > 0

    def form(self) -> Form:
        return self.lifted

    def __getstate__(self) -> dict[str, Any]:
        # factorisations cannot be pickled, and are made again when they are needed
        made_again = ("_projector", "_last")
        return {name: x for name, x in self.__dict__.items() if name not in made_again}

    # ---- support function -----------------------------------------------------------------------

    @cached_property
    def _units(self) -> list[float]:
        """Of each part, near the numbers in its columns: in them a program sees numbers near 1."""
        sizes = abs(sp.vstack(self.lifted[:2])).max(axis=0).toarray().ravel()
        return [binary(float(sizes[at].max())) for _, at in placed(self.lifted.parts)]

    @cached_property
    def offsets(self) -> Array:  # type: ignore[override]
        units = np.repeat(self._units, [part.offsets.size for part in self.lifted.parts])
        return np.append(np.zeros(self.lifted.F.shape[0]), units * self.part.offsets)

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        units = np.repeat(self._units, [part.dim for part in self.lifted.parts])
        E, F = (M @ sp.diags_array(1 / units) for M in self.lifted[:2])
        inner = E.T @ p
        if not F.shape[0]:
            return self.part.features(inner)
        multipliers = cp.Variable(F.shape[0])
        y, constraints = self.part.features(inner - F.T @ multipliers)
        return Features([multipliers, *y], constraints)

    def support(self, z: Array) -> float:
        if self._cut:
            return support_by_program(self, z)
        return self.part.support(self._seen(z))

    def support_rows(self, rows: Array) -> Array:
        if self._cut:
            return super().support_rows(rows)
        return self.part.support_rows(self._seen(rows.T).T)

    def _seen(self, z: Array) -> Array:
        """E^T z; an entry that is nothing but rounding is 0, so that it meets the domain of S."""
        E, sizes, _ = _transposed(self.lifted.E)
        inner, rounding = E @ z, 2 * ROUNDING * (sizes @ np.abs(z))
        return np.where(np.abs(inner) <= rounding, 0.0, inner)

    def same_cone(self, other: ConvexSet) -> bool:
        return (
            isinstance(other, Lifted)
            and all(map(same_array, self.lifted[:2], other.lifted[:2]))
            and self.part.same_cone(other.part)
        )

    def magnitude(self) -> float:
        without_cuts = sum(size * part.magnitude() for part, size in self._norms if size)
        # programs for each axis took a fifth of the time of a bound of a mapped cut ball
        return super().magnitude() if self._cut and without_cuts == math.inf else without_cuts

    def _distance(self, other: ConvexSet) -> float | None:
        if self._cut or not (isinstance(other, Lifted) and self.same_cone(other)):
            return None
        each = zip(self._norms, other.lifted.parts, strict=True)
        bounds = [(size, C.distance_bound(D)) for (C, size), D in each]
        known = [size * distance for size, distance in bounds if distance is not None]
        return sum(known) if len(known) == len(bounds) else None

    @property
    def _norms(self) -> list[tuple[ConvexSet, float]]:
        """The parts, each with a bound of |E_i|."""
        return [(part, _size(self.lifted.E[:, at])) for part, at in placed(self.lifted.parts)]

    @cached_property
    def shift_sizes(self) -> Array:
        return np.asarray(_transposed(self.lifted.E)[2] @ self.part.shift_sizes)

    # ---- projection -----------------------------------------------------------------------------

    @cached_property
    def _blocks(self) -> Aligned | None:
        """The same set as a product of independent ones, each in its own units; None if it is one.

        80 discs cut with a box are 80 small sets; as one set, their steps miss tol = 1e-9. Parts
        that E only puts in their places, as nodes that rub beside one at a corner, are one set.
        """
        E, F, stacked = self.lifted
        # to make the intervals of a box takes longer than to see that they are one set
        sizes = [
            np.ones(part.dim, dtype=int)
            if isinstance(part, Box)
            else [C.dim for C in part.factors()]
            for part in stacked
        ]
        groups, labels = _components(E, F, np.concatenate(sizes)[None])
        of_w, of_F, of_part, of_placed, of_s = labels
        if groups.size < 2:
            return None
        parts = [C for part in stacked for C in part.factors()]
        blocks, unknowns = [], []
        for group in groups:
            some, rows, own, at = (np.flatnonzero(x == group) for x in (of_w, of_F, of_part, of_s))
            form = Form(E[some][:, at], F[rows][:, at], tuple(parts[i] for i in own))
            blocks.append(_placed(form) if group in of_placed else Lifted(form))
            unknowns.append(some)
        return Aligned(*blocks, unknowns=np.concatenate(unknowns), dim=self.dim)

    @cached_property
    def _projector(self) -> Projector:
        return Projector(self.lifted)

    def near(self, v: Array) -> Projection:
        """The projection of v, as exactly as it is found."""
        near: Projection = self._memo(v, self._projection)
        return near

    def _projection(self, v: Array, start: Start | None = None, patient: bool = True) -> Projection:
        near = self._projector(v.copy(), start, patient)
        cut = self._cut and self.lifted.small
        sure = near.exact and np.array_equal(near.w, v)
        if cut and not sure and near.splitting.is_tense(near):
            raise TouchingError(
                f"C & D: the two sets only touch, or miss each other, so that rounding hides the "
                f"projection; {REMEDY}"
            )
        return near

    def _pair_of_one(self, v: Array) -> NormalPair | None:
        """That which another set knows: one that C is made of, or by Moreau the polar cone."""
        if self.polar_cone is None or not self.polar_cone.exact:
            return None
        w = self.polar_cone.normal(v)
        p = v - w
        # p holds rounding of v; a second look leaves that of p, as the domain of sigma needs it
        beside = np.abs(p).max() > ROUNDING * np.abs(v).max()
        p = self.polar_cone.project(p) if beside else 0 * p
        return NormalPair(p, w, 0.0, _rounded(v))

    def _point_of_one(self, v: Array) -> Array | None:
        """The point next to v of one set, if it is in the others as they round."""
        pair = self._pair_of_one(v)
        return pair and pair.w

    def _pair(self, v: Array) -> NormalPair | None:
        """The projection of v and its normal, exact to rounding; None if they are not found.

        Without rows F a point of C, and what is left of v, where no projection is exact.
        """
        pair = self._pair_of_one(v)
        if pair is not None:
            return pair
        near = self.near(v) if self.certifiable else None
        if near is None or (self._cut and not near.exact):
            return None
        p = near.p
        if not near.exact:
            return NormalPair(p, near.w.copy(), self.gap(p, near.w), _rounded(v))
        if not self._cut and np.isinf(self.support(p)):
            # the rounding of v has left the domain of sigma, where all p - P_{rC}(p) are
            far = self._projection(REMOTE * p)
            p = (REMOTE * p - far.w) / REMOTE if far.exact else p
        size = np.abs(p).max()
        noise = np.abs(p) <= ROUNDING * (size if size > ROUNDING * np.abs(v).max() else np.inf)
        clean = np.where(noise, 0.0, p)
        if self._cut or np.isfinite(self.support(clean)):
            p = clean
        return NormalPair(p, near.w.copy(), 0.0)

    def _nearest(self, v: Array) -> NormalPair:
        """The projection of v and its normal, as exact as they are found, of a set that is one."""
        pair = self._pair(v)
        if pair is None:
            p = normal_by_program(self, v)
            pair = NormalPair(p, v - p, 0.0)
        return pair

    def project(self, w: Array) -> Array:
        if self._blocks is not None:
            return self._blocks.project(w)
        pair = self._pair_of_one(w)
        # a normal takes a second projection where sigma is infinite
        if pair is None and self.certifiable and (near := self.near(w)).exact:
            return near.w
        return (pair or self._nearest(w)).w

    def project_rows(self, rows: Array) -> Array:
        """Rows are points of curves: each projection starts from the one before."""
        if self._blocks is not None:
            return self._blocks.project_rows(rows)
        start, points = None, []
        for v in rows:
            point = self._point_of_one(v)
            if point is None and self.certifiable:
                near = self.near(v) if start is None else self._projection(v, start)
                start, point = (near.start, near.w) if near.exact else (None, None)
            points.append(self._nearest(v).w if point is None else point)
        return np.array(points)

    def project_quickly(self, w: Array) -> Array | None:
        if self._blocks is not None:
            return self._blocks.project_quickly(w)
        if not self._cut:
            return self.project(w)
        if (point := self._point_of_one(w)) is not None:
            return point
        near = self._projector(w.copy(), patient=False)
        return near.w if near.exact else None

    def supports_along(self, p: Array, w: Array) -> Array:
        """Of C & D by projections: the program of sigma takes 17 ms for each direction.

        For w* = P_C(w + t p) the vector w + t p - w* is normal at w*, so that sigma(C, p) is at
        most <p, w*> + (|w* - w| sup |C| - <w* - w, w*>) / t, which is exact where w* = w.
        """
        size = self.magnitude() if self._cut else math.inf
        if not math.isfinite(size):
            return super().supports_along(p, w)
        begin = basis(w.shape[1] - 1, np.linspace(0.0, 1.0, p.shape[1])) @ w
        lengths = np.linalg.norm(p, axis=2)
        t = AHEAD * size / np.where(lengths > 0, lengths, 1.0)
        far = self.project_rows((begin + t[:, :, None] * p).reshape(-1, self.dim)).reshape(p.shape)
        way = far - begin
        excess = np.linalg.norm(way, axis=2) * size - (way * far).sum(axis=2)
        rounding = 10 * ROUNDING * AHEAD * size * lengths
        return np.asarray((p * far).sum(axis=2) + excess / t + rounding)

    def normal(self, v: Array) -> Array:
        return self._nearest(v).p if self._blocks is None else self._blocks.normal(v)

    def weights(self, tau: Array) -> Array:
        return super().weights(tau) if self._blocks is None else self._blocks.weights(tau)

    def derivative(self, v: Array) -> Array | None:
        near = self.near(v) if self.certifiable else None
        return near.splitting.derivative(near) if near is not None and near.exact else None

    @property
    def differentiable(self) -> bool:
        return self.certifiable and self.lifted.small and self.part.differentiable

    @property
    def block(self) -> int:
        return self.dim if self._blocks is None else self._blocks.block

    def blocks(self, v: Array) -> list[Blocks] | None:
        return super().blocks(v) if self._blocks is None else self._blocks.blocks(v)

    def normal_pair(self, p: Array, w: Array, tau: Array) -> NormalPair | None:
        if self._blocks is not None:
            return self._blocks.normal_pair(p, w, tau)
        step = float(np.mean(tau))
        v = w + step * p
        pair = self._pair(v)
        if pair is None:
            return None
        off = pair.perturbation
        if off is None:
            near = self.near(v)
            off = near.splitting.perturbation(near, pair.p) or _rounded(v)
        return NormalPair(pair.p / step, pair.w, pair.gap / step, off._replace(p=off.p / step))

    @cached_property
    def polar_cone(self) -> Polyhedron | None:
        """{ p : E^T p in S° } for a cone S that is a box: active sets project on it."""
        E, F, _ = self.lifted
        if F.shape[0] or not isinstance(self.part, Box) or self.part.offsets.any():
            return None
        N, d, *_ = self.part.polar().halfspaces()
        return Polyhedron(N @ E.T, d)

    def polar(self) -> ConvexSet:
        return self.polar_cone or super().polar()

    def require_nonempty(self, where: str = "C") -> None:
        self.part.require_nonempty(where)
        if self._blocks is not None:
            self._blocks.require_nonempty(where)
        elif self.operands and not isinstance(self, Intersection):
            for C in self.operands:
                C.require_nonempty(where)
        elif self._cut and self.certifiable:
            self._require_point(where)

    def _require_point(self, where: str) -> None:
        """Refuse C if it is proved to be empty, or if no point of it is found either."""
        origin = np.zeros(self.dim)
        with contextlib.suppress(TouchingError):  # or do not meet
            if self._projection(origin, patient=False).exact:
                return
        separated = is_separated(Form.alone(self.part).image(self.lifted.F))
        if separated:
            raise EmptySetError(f"{where} is empty: the two sets of C & D do not meet")
        if separated is not None:
            return
        with contextlib.suppress(TouchingError):
            if self.near(origin).exact:
                return
        raise TouchingError(
            f"{where}: whether the sets of C & D meet is lost in rounding; {REMEDY}"
        )


@once
def _transposed(E: sp.csr_array) -> tuple[sp.csr_array, sp.csr_array, sp.csr_array]:
    """E^T, its absolute values, and those of E."""
    transposed = sp.csr_array(E.T)
    return transposed, abs(transposed), abs(E)


@once
def _components(E: sp.csr_array, F: sp.csr_array, dims: Array) -> tuple[Array, list[Array]]:
    """The components of w, and which one each w, row of F and part of these dims, a row, is in, the
    parts that are only put in their places, and each s."""
    owner = np.repeat(np.arange(dims.size), dims[0])
    member = sp.csr_array((np.ones(owner.size), (owner, np.arange(owner.size))))
    alone = sp.vstack([E, F]).count_nonzero(axis=0) == 1
    alone &= E.T @ (np.diff(E.indptr) == 1) == 1
    placed_only = (np.bincount(owner, ~alone) == 0)[owner]
    table = sp.vstack([abs(E), abs(F), member, sp.csr_array(placed_only[None])])
    _, label = connected_components(sp.block_array([[None, table], [table.T, None]]), False)
    labels = np.split(label, np.cumsum([E.shape[0], F.shape[0], dims.size, 1]))
    return np.intersect1d(labels[0], labels[-1]), labels


def _rounded(v: Array, offsets: Array | float = 0.0) -> Perturbation:
    """A pair's perturbation where no more is known than v, and offsets of the set beside it."""
    size = max(np.abs(v).max(), np.abs(offsets).max(initial=0.0))
    return Perturbation(*np.full((2, v.size), 10 * ROUNDING * size))


class Sum(Lifted):
    """The Minkowski sum C + D:  sigma(C + D, z) = sigma(C, z) + sigma(D, z)."""

    @property
    def anchor(self) -> Array:
        return np.sum([C.anchor for C in self.operands], axis=0)

    def magnitude(self) -> float:
        return sum(C.magnitude() for C in self.operands)

    def polar(self) -> ConvexSet:
        return reduce(and_, (C.polar() for C in self.operands))


def points_of_sum(sets: Sequence[ConvexSet], sizes: Array, rows: Array) -> list[Array]:
    """Points s_i of each S_i, with sum_i r_i s_i the point of sum_i r_i S_i that is next to v.

    For each row r of the sizes, shape (n, k), and v of the rows, shape (n, dim); each projection
    starts from the one before.
    """
    forms, start, points = [C.form() for C in sets], None, []
    E, F, parts = reduce(Form.added, forms)
    counts = [form.E.shape[1] for form in forms]
    for r, v in zip(sizes, rows, strict=True):
        scaled = Form(sp.csr_array(E @ sp.diags_array(np.repeat(r, counts))), F, parts)
        start = Projector(scaled)(v, start).start
        points.append(start.s)
    each = np.split(np.array(points).T, np.cumsum(counts)[:-1])
    return [(form.E @ s).T for form, s in zip(forms, each, strict=True)]


class Intersection(Lifted):
    """C & D, non-empty:  sigma(C & D, z) = min over p of  sigma(C, p) + sigma(D, z - p).

    Where a curved set only touches another one the point they share moves by the square root of
    what rounds in the data, 1e-8 of their size; a projection that is lost so raises TouchingError.
    """

    def _pair_of_one(self, v: Array) -> NormalPair | None:
        # where its point is known to be in the others: exact from any v. Without it steps at rest
        # in a ball cut by a box take 4 times as long, bounds of them 2 to 6 times
        if all(C.exact for C in self.operands):
            for part in self.operands:
                w, off = part.project(v), _rounded(v, part.offsets)
                distance = 0.0 if np.array_equal(w, v) else float(off.w[0])
                if all(C.is_inside(w, distance) for C in self.operands if C is not part):
                    return NormalPair(part.normal(v), w, 0.0, off)
        return None

    def _point_of_one(self, v: Array) -> Array | None:
        for part in self.operands if all(C.exact for C in self.operands) else ():
            w = part.project(v)
            if not any(C.normal(w).any() for C in self.operands if C is not part):
                return w
        return None

    def _require_point(self, where: str) -> None:
        for C in self.operands:  # one that is empty by itself says so
            if C.exact:
                C.require_nonempty(where)
        # projections, then reflections, in one set after the other: a common point proves more than
        # a projection on C & D does from afar, which takes 4 ms for two balls and these 0.1
        v = self.operands[0].anchor
        for k in range(REFLECTIONS if all(C.exact for C in self.operands) else 0):
            for C in self.operands:
                w = C.project(v)
                if all(D.is_inside(w, 0.0) for D in self.operands if D is not C):
                    return
                v = (2 if k else 1) * (w - v) + v
        super()._require_point(where)

    @property
    def is_bounded(self) -> bool:
        return any(C.is_bounded for C in self.operands)

    def magnitude(self) -> float:
        # the 2 dim supports of a polyhedron take longer than a projection
        quick = [C for C in self.operands if not isinstance(shape_of(C), Polyhedron)]
        size = min((C.magnitude() for C in quick), default=math.inf)
        return size if size < math.inf else min(C.magnitude() for C in self.operands)

    def polar(self) -> ConvexSet:
        """(C & D)° = closure of C° + D°; projections on a sum are those on its closure."""
        return reduce(add, (C.polar() for C in self.operands))


def _placed(form: Form) -> ConvexSet:
    """E s, where E only puts the parts in their places."""
    balls = [C for C in form.parts if isinstance(C, Ball) and not np.any(C.center)]
    part = product_of(form.parts)
    if len(balls) == len(form.parts) and len({C.dim for C in balls}) == 1:
        part = Balls([C.radius for C in balls], balls[0].dim)
    return ConvexSet.algebra.image(form.E, part)
