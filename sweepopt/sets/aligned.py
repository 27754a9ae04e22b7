"""Sets on some of the unknowns, products of sets, translates and multiples: one law.

C = v + r { w : w[at_i] in S_i, all other entries 0 }, no unknown in two at_i, has

    sigma(C, z) = <v, z> + |r| sum_i sigma(S_i, sign(r) z[at_i]),
    P_C(w)      = v + r { P_{S_i}(x[at_i]) on at_i, 0 elsewhere },     x = (w - v) / r

The sets S_i stay as they are, with all that was computed for them: a step changes v, or r.
"""

from __future__ import annotations

import math
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from sweepopt.checks import Array
from sweepopt.linalg import dense
from sweepopt.sets.balls import Ball, features_of_balls
from sweepopt.sets.base import (
    Blocks,
    ConvexSet,
    Features,
    Form,
    Halfspaces,
    NormalPair,
    Perturbation,
    Selection,
    placed,
)
from sweepopt.sets.shapes import Box, Point

if TYPE_CHECKING:
    import cvxpy as cp


class Aligned(ConvexSet):
    """v + r { w : w[unknowns] in S_1 x S_2 x ..., all other entries 0 }, r != 0.

    This is how contact enters a large body: the set acts on a few unknowns only, and a plan can
    eliminate the others.

    Parameters
    ----------
    *parts : ConvexSet
        S_1, S_2, ...
    unknowns : ndarray, optional
        Where the parts are; without it they are the whole vector, one after the other.
    dim : int, optional
        As many as the parts have.
    """

    parts: tuple[ConvexSet, ...]
    unknowns: Any = None
    v: Array | None = None
    factor = 1.0
    # without the check of Brief: some are made at each time, and users set none of its attributes
    __setattr__ = object.__setattr__  # type: ignore[assignment]

    def __init__(
        self, *parts: ConvexSet, unknowns: Array | None = None, dim: int | None = None
    ) -> None:
        self.parts, self.unknowns = parts, unknowns
        self.dim = sum(S.dim for S in parts) if dim is None else dim
        self.polyhedral = all(S.polyhedral for S in parts)
        self.certifiable = all(S.certifiable for S in parts)
        self.exact = all(S.exact for S in parts)

    # ---- the two maps between C and its parts ---------------------------------------------------

    @property
    def whole(self) -> bool:
        """Whether there is one part, on all unknowns."""
        return self.unknowns is None and len(self.parts) == 1

    @cached_property
    def _places(self) -> list[Any]:
        """Where each part is."""
        each = [at for _, at in placed(self.parts)]
        return each if self.unknowns is None else [self.unknowns[at] for at in each]

    def _split(self, *vectors: Any) -> Any:
        """The parts, each with its entries of the vectors, in rows or not."""
        if self.whole:
            return [(self.parts[0], *vectors)]
        each = zip(self.parts, self._places, strict=True)
        return [(S, *(x[..., at] for x in vectors)) for S, at in each]

    def _joined(self, blocks: list[Any], rest: Array | None = None) -> Array:
        """The vectors that have a block for each part, 0 or the rest beside them."""
        if self.whole:
            return np.asarray(blocks[0])
        w = np.zeros((*blocks[0].shape[:-1], self.dim)) if rest is None else rest.copy()
        for at, block in zip(self._places, blocks, strict=True):
            w[..., at] = block
        return w

    def _to(self, x: Array) -> Array:
        x = x if self.factor == 1 else self.factor * x
        return x if self.v is None else x + self.v

    def _back(self, w: Array) -> Array:
        w = w if self.v is None else w - self.v
        return w if self.factor == 1 else w / self.factor

    @property
    def _scale(self) -> tuple[float, float]:
        """|r| and the sign of r."""
        return abs(self.factor), math.copysign(1.0, self.factor)

    # ---- the laws -------------------------------------------------------------------------------

    @cached_property
    def offsets(self) -> Array:  # type: ignore[override]
        inner = abs(self.factor) * np.concatenate([S.offsets for S in self.parts])
        return inner if self.v is None else np.concatenate([self.v, inner])

    def features(self, p: cp.Expression) -> Features:
        own, p = [] if self.v is None else [p], p if self.factor > 0 else -p
        dims = {S.dim if isinstance(S, Ball) else 0 for S in self.parts}
        if self.unknowns is None and len(dims) == 1 and all(dims):
            # cvxpy takes 20 s for 500 balls one by one
            y, constraints = features_of_balls(p, *dims)
            return Features([*own, *y], constraints)
        each = [S.features(p[at]) for S, at in zip(self.parts, self._places, strict=True)]
        y, constraints = (list(chain(*lists)) for lists in zip(*each, strict=True))
        return Features(own + y, constraints)

    def support(self, z: Array) -> float:
        r, sign = self._scale
        sigma = r * sum(S.support(x) for S, x in self._split(sign * z))
        return sigma if self.v is None else sigma + float(self.v @ z)

    def project(self, w: Array) -> Array:
        x = self._back(w)
        y = self._joined([S.project(x) for S, x in self._split(x)])
        return w if np.array_equal(x, y) else self._to(y)

    def is_inside(self, w: Array, distance: float) -> bool:
        if self._few:
            return super().is_inside(w, distance)
        r, _ = self._scale
        return all(S.is_inside(x, distance / r) for S, x in self._split(self._back(w)))

    def project_quickly(self, w: Array) -> Array | None:
        each: list[Any] = [S.project_quickly(x) for S, x in self._split(self._back(w))]
        return None if any(x is None for x in each) else self._to(self._joined(each))

    def project_rows(self, rows: Array) -> Array:
        return self._to(self._joined([S.project_rows(x) for S, x in self._split(self._back(rows))]))

    def normal(self, v: Array) -> Array:
        v = self._back(v)
        p = self._joined([S.normal(x) for S, x in self._split(v)], v)
        return p if self.factor == 1 else self.factor * p

    def weights(self, tau: Array) -> Array:
        return self._joined([S.weights(x) for S, x in self._split(tau)], tau)

    @property
    def _few(self) -> bool:
        return self.unknowns is not None and self.unknowns.size < self.dim

    @property
    def differentiable(self) -> bool:
        return not self._few and all(S.differentiable for S in self.parts)

    @property
    def block(self) -> int:
        return max(S.block for S in self.parts)

    def blocks(self, v: Array) -> list[Blocks] | None:
        """None for few of the unknowns: their set has them."""
        each = [S.blocks(x) for S, x in self._split(self._back(v))]
        if self._few or any(blocks is None for blocks in each):
            return None
        if self.whole:
            return each[0]
        every, where = np.arange(self.dim), zip(self._places, each, strict=True)
        return [one._replace(unknowns=every[at][one.unknowns]) for at, of in where for one in of]

    @cached_property
    def sharp_gaps(self) -> bool:
        return all(S.sharp_gaps for S in self.parts)

    @property
    def nonsmooth_dim(self) -> int:
        return sum(S.nonsmooth_dim for S in self.parts)

    def exchange(self, diagonal: Array) -> Array:
        return self._joined([S.exchange(x) for S, x in self._split(diagonal)])

    def exchanges(self, force: Array) -> bool:
        return all(S.exchanges(x) for S, x in self._split(self._back(force)))

    def normal_pair(self, p: Array, w: Array, tau: Array) -> NormalPair | None:
        r, sign = self._scale
        p = sign * p
        each = self._split(p, self._back(w), tau / r)
        pairs: list[Any] = [S.normal_pair(*x) for S, *x in each]
        if any(pair is None for pair in pairs):
            return None
        off = None
        if any(pair.perturbation for pair in pairs):
            moved = [pair.perturbation or Perturbation(0 * pair.w, 0 * pair.p) for pair in pairs]
            of_w, of_p = (self._joined(list(x)) for x in zip(*moved, strict=True))
            off = Perturbation(r * of_w, of_p)
        p = sign * self._joined([pair.p for pair in pairs], p)
        w = self._to(self._joined([pair.w for pair in pairs]))
        return NormalPair(p, w, r * sum(pair.gap for pair in pairs), off)

    def gaps_along_curves(self, p: Array, w: Array, sizes: Array) -> Array:
        r, sign = self._scale
        each = self._split(sign * p, self._back(w))
        gaps: Array = sum(S.gaps_along_curves(*curves, r * sizes) for S, *curves in each)
        return gaps

    def curves_within(self, curves: Array, sizes: Array) -> Array:
        each = self._split(self._back(curves))
        return self._to(self._joined([S.curves_within(x, sizes) for S, x in each]))

    def supports_along(self, p: Array, w: Array) -> Array:
        r, sign = self._scale
        each = self._split(sign * p, self._back(w))
        sigma = r * np.sum([S.supports_along(*curves) for S, *curves in each], axis=0)
        return sigma if self.v is None else sigma + p @ self.v

    def _alike(self, other: ConvexSet) -> TypeGuard[Aligned]:
        """Whether other has parts on the same unknowns."""
        return (
            isinstance(other, Aligned)
            and self.dim == other.dim
            and [S.dim for S in self.parts] == [S.dim for S in other.parts]
            and (self.unknowns is other.unknowns or np.array_equal(self.unknowns, other.unknowns))
        )

    def same_cone(self, other: ConvexSet) -> bool:
        return (
            self._alike(other)
            and (self.v is None, self.factor > 0) == (other.v is None, other.factor > 0)
            and all(S is D or S.same_cone(D) for S, D in zip(self.parts, other.parts, strict=True))
        )

    def form(self) -> Form:
        form = Form.beside(*(S.form() for S in self.parts))
        if self.whole and form.parts == self.parts:
            return Form.alone(self)
        if self.unknowns is not None:
            form = form.image(sp.eye_array(self.dim, format="csc")[:, self.unknowns])
        if self.factor != 1:
            r, sign = self._scale  # r goes to the parts, so that only offsets know it
            form = form._replace(E=sign * form.E, parts=tuple(r * S for S in form.parts))
        return form if self.v is None else Form.added(form, Point(self.v).form())

    def halfspaces(self) -> Halfspaces:
        each = [S.halfspaces() for S in self.parts]
        N, d, E, e = each[0]
        if not self.whole:
            axes = np.eye(self.dim)
            own = axes if self.unknowns is None else axes[self.unknowns]
            rest = axes[~own.any(axis=0)]  # w = 0 there
            Ns, ds, Es, es = zip(*each, strict=True)
            N, E = (scipy.linalg.block_diag(*map(dense, Ms)) @ own for Ms in (Ns, Es))
            d, E = np.concatenate(ds), np.vstack([E, rest])
            e = np.concatenate([*es, np.zeros(len(rest))])
        r, sign = self._scale
        N, d, E, e = sign * N, r * d, sign * E, r * e
        v = np.zeros(self.dim) if self.v is None else self.v
        return Halfspaces(N, d + N @ v, E, e + E @ v)

    def factors(self) -> list[ConvexSet]:
        return super().factors() if self.whole else [C for S in self.parts for C in S.factors()]

    def require_nonempty(self, where: str = "C") -> None:
        for S in self.parts:
            S.require_nonempty(where)

    @property
    def is_bounded(self) -> bool:
        return all(S.is_bounded for S in self.parts)

    def magnitude(self) -> float:
        away = 0.0 if self.v is None else float(np.linalg.norm(self.v))
        return abs(self.factor) * self._extent() + away

    def _extent(self) -> float:
        return math.hypot(*(S.magnitude() for S in self.parts))

    def _distance(self, other: ConvexSet) -> float | None:
        # r C and s D are |r - s| sup |C| + |s| d(C, D) apart at most; a point is v + 0 C
        parts: tuple[ConvexSet, ...] = (other,)
        v, factor = None, 1.0
        if self._alike(other):
            parts, v, factor = other.parts, other.v, other.factor
        elif isinstance(other, Point):
            parts, v, factor = self.parts, other.offsets, 0.0
        elif not self.whole:
            return None
        each = [S.distance_bound(D) for S, D in zip(self.parts, parts, strict=True)]
        known = [distance for distance in each if distance is not None]
        change = abs(self.factor - factor)
        of_scale = change * self._extent() if change else 0.0
        if len(known) < len(each) or np.isinf(of_scale):
            return None
        away = np.linalg.norm((0 if self.v is None else self.v) - (0 if v is None else v))
        return of_scale + abs(factor) * math.hypot(*known) + float(away)

    def with_offsets(self, h: Array) -> Aligned:
        """That of a polyhedron { w : G w <= h } on some of the unknowns, with another h."""
        part: Any = self.parts[0]
        return Aligned(part.with_offsets(h), unknowns=self.unknowns, dim=self.dim)

    def member(self, h: Array) -> Aligned:
        """As that of the polyhedron."""
        part: Any = self.parts[0]
        return Aligned(part.member(h), unknowns=self.unknowns, dim=self.dim)

    @property
    def exact_rows(self) -> bool:
        """As that of the polyhedron."""
        part: Any = self.parts[0]
        return bool(part.exact_rows)

    @property
    def anchor(self) -> Array:
        return self._to(self._joined([S.anchor for S in self.parts]))

    @property
    def shift_sizes(self) -> Array:
        sizes = abs(self.factor) * self._joined([S.shift_sizes for S in self.parts])
        return sizes if self.v is None else sizes + np.abs(self.v)

    @cached_property  # a step asks for that of the shape that it moves
    def selection(self) -> Selection | None:
        if self.unknowns is not None:
            return Selection(self.unknowns, product_of(self.parts), None)
        inner = self.parts[0].selection if self.whole else None
        if inner is None:
            return None
        r, part = self.factor, inner.part
        shift = self.v if inner.shift is None else self._to(inner.shift)
        return Selection(inner.unknowns, part if r == 1 else self.algebra.scale(r, part), shift)

    def polar(self) -> ConvexSet:
        if self.v is not None and self.v.any():
            return super().polar()
        polars = [S.polar() for S in self.parts]
        if self.unknowns is None:
            polar = product_of(tuple(polars))
            return polar if self.factor > 0 else -polar
        boxes = [P for P in polars if isinstance(P, Box)]
        if len(boxes) < len(polars):
            return super().polar()
        free = np.full(self.dim, np.inf)
        lower = self._joined([P.lower for P in boxes], -free)
        return Box(lower, self._joined([P.upper for P in boxes], free))


def product_of(parts: tuple[ConvexSet, ...]) -> ConvexSet:
    """The parts one after the other in the vector."""
    return parts[0] if len(parts) == 1 else Aligned(*parts)


class Similar(Aligned):
    """v + r C for r != 0; v None is 0."""

    def __init__(self, part: ConvexSet, v: Array | None = None, factor: float = 1.0) -> None:
        super().__init__(part)
        self.v, self.factor = v, factor

    @cached_property
    def centred(self) -> ConvexSet:
        """r C."""
        part = self.parts[0]
        return part if self.factor == 1 else Similar(part, None, self.factor)


def shape_of(C: ConvexSet) -> ConvexSet:
    """C without its translation and scale."""
    return shape_of(C.parts[0]) if isinstance(C, Similar) else C


def kind_without_certificate(C: ConvexSet) -> str:
    """The kind of a part of which nothing is proved."""
    part = next(part for part in C.form().parts if not part.certifiable)
    return type(shape_of(part)).__name__
