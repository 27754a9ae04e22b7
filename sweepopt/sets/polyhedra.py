"""Polyhedra { w : G w <= h }, half-spaces and generated cones, projected by active sets."""

from __future__ import annotations

import copy
import math
from functools import cached_property, partial
from inspect import signature
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.optimize
import scipy.sparse as sp

from sweepopt.checks import Array, matrix, number, read_only, vector
from sweepopt.display import brief
from sweepopt.errors import EmptySetError, InputError, SweepoptError
from sweepopt.linalg import UNIT, dense, product_error, row_lengths
from sweepopt.sets.base import (
    DENSE,
    ROUNDING,
    ConvexSet,
    Features,
    Halfspaces,
    NormalPair,
    Perturbation,
    Selection,
    once,
    row_units,
)
from sweepopt.sets.least_distance import (
    EMPTY,
    Flat,
    Shortest,
    exact_multipliers,
    least_distance,
    nonnegative_least_squares,
    parallel_rows,
    projector,
    rational,
    shortest_on,
)
from sweepopt.sets.programs import normal_by_program
from sweepopt.sets.shapes import FEW, Box, Orthant, rows_features

if TYPE_CHECKING:
    import cvxpy as cp

OUTSIDE = 1e-10  # of |z|: a z that is no further from the domain of the support function is in it
REACHES = 2.0 ** np.arange(0, 65, 8)  # in units of what is seen of the set: to the end of needles
RATIONAL_DIM = 30  # 63 rows in 25 unknowns take 0.14 s in rational numbers, 101 in 40 take 2.5 s
NEAR = 1e-6  # of the size of a row: a point moves by much less to what is nearer
ACTIVE_DIM = 1000  # rows or unknowns up to which active sets are used, beyond a sparse QP


@once
def _of_rows(G: Any) -> tuple[Any, ...]:
    """Units of rows G, rows of numbers near 1, whose right hand sides are the offsets, their
    lengths, which of them are parallel, or opposite but for rounding, and the first such of each.
    """
    units = row_units("row {} of G", G)
    rows = sp.diags_array(1 / units) @ G
    rows = rows if max(rows.shape) > DENSE else dense(rows)
    lengths = row_lengths(rows)
    lead = np.arange(lengths.size)
    lengths = np.where(lengths > 0, lengths, np.inf)
    pairs = parallel_rows(_columns(rows.T, 1 / lengths).T)
    opposite = pairs.opposite_but_for_rounding(rows)
    parallel, wedges = pairs.among(~opposite), pairs.among(opposite)
    np.minimum.at(lead, parallel.j, parallel.i)
    return units, rows, lengths, parallel, wedges, lead


class Polyhedron(ConvexSet):
    """{ w : G w <= h }:  sigma(z) = min { <h, y> : G^T y = z, y >= 0 }.

    Parameters
    ----------
    G : array_like or sparse, shape (m, dim)
    h : array_like, shape (m,), or callable t -> (m,)
        With a callable the set moves: C(t) = { w : G w <= h(t) }.

    Raises
    ------
    InputError
        If G or h is not finite, or h does not have a number for each row of G.
        From `require_nonempty`, if two rows with one side are opposite but for rounding: one has to
        be an exact multiple of the other to make an equation.
    EmptySetError
        From `project`, `support` and `require_nonempty`, if no w satisfies G w <= h.

    Examples
    --------
    >>> triangle = Polyhedron([[-1, 0], [0, -1], [1, 1]], [0, 0, 1])
    >>> triangle.project([1.0, 1.0])
    array([0.5, 0.5])
    """

    h: Array
    polyhedral, fixed = True, ("G",)

    def __new__(cls, *args: Any, **named: Any) -> Any:  # subclasses have their own arguments
        if cls is Polyhedron and any(map(callable, (*args, *named.values()))):
            return cls.algebra.with_moving_offsets(*args, **named)
        return super().__new__(cls)

    def __init__(self, G: Any, h: Any) -> None:
        self.G = matrix("G", G)
        self.dim = self.G.shape[1]
        if not self.dim:
            raise InputError("G must have at least one column")
        self.exact = self.certifiable = min(self.G.shape) <= ACTIVE_DIM
        self._units, self.rows, self._lengths, *more = _of_rows(self.G)
        self._parallel, self._wedges, self._lead = more
        self._set_offsets(h)

    def _set_offsets(self, h: Any) -> None:
        h = read_only(vector("h, one for each row of G,", h, self.G.shape[0], finite=False))
        vars(self).update(h=h, offsets=h / self._units)
        if np.isinf(self.h).any():
            i = int(np.flatnonzero(np.isinf(self.h))[0])
            raise InputError(f"h[{i}] is {self.h[i]}; leave out rows without a bound")

    def with_offsets(self, h: Any) -> Polyhedron:
        """{ w : G w <= h } with the same matrix object, so that `same_cone` is free."""
        other = copy.copy(self)
        for made in ("selection", "_last"):
            other.__dict__.pop(made, None)
        other._set_offsets(h)
        return other

    def member(self, h: Any) -> ConvexSet:
        """As `with_offsets`; a box if each row bounds a single unknown, and none fixes one."""
        bounds, other = self._bounds, self.with_offsets(h)
        ends = bounds and bounds.ends(other.offsets)
        return Box(*ends) if ends and (ends[0] < ends[1]).all() else other

    @property
    def exact_rows(self) -> bool:
        """Whether `project_rows` and `multiplier_rows` know which rows bind."""
        return self.exact or self._bounds is not None

    @cached_property
    def _bounds(self) -> Bounds | None:
        """The rows, if each has one entry, or none."""
        rows = sp.coo_array(self.rows)
        i, j, factor = (x[rows.data != 0] for x in (*rows.coords, rows.data))
        single = np.unique(i).size == i.size
        return Bounds.of_entries(i, j, factor, self.dim) if single else None

    @cached_property
    def selection(self) -> Selection | None:
        """The unknowns beside those that an equation fixes, if that is worth eliminating these."""
        flat = self._flat(np.zeros(self.dim))
        if not flat.equations.any():
            return None
        rows = sp.csr_array(self.rows, copy=True)
        rows.eliminate_zeros()
        fix = np.flatnonzero(flat.equations & (np.diff(rows.indptr) == 1))
        fixed = rows[fix].indices
        few = np.setdiff1d(np.arange(self.dim), fixed)
        if not fix.size or not 0 < few.size <= FEW:
            return None
        shift = np.zeros(self.dim)
        shift[fixed] = self.offsets[fix] / rows[fix].data
        h, rows = self.offsets - rows @ shift, rows[:, few]
        left = np.diff(rows.indptr) > 0
        part = Polyhedron(rows[left], h[left]).member(h[left])
        return Selection(few, part, shift if shift.any() else None)

    def support(self, z: Array) -> float:
        return float(self.support_rows(z[None])[0])

    def support_rows(self, rows: Array) -> Array:
        values = np.where(rows.any(axis=1), np.inf, 0.0)
        if not values.any() or not self.h.size:
            return values
        # seen from a point of the set: h - G x >= 0 is as large as the set, wherever that is
        inside = self.project(np.zeros(self.dim))
        slack = np.maximum(self.h - self.G @ inside, 0.0)
        y = self.multiplier_rows(rows, slack)
        finite = np.isfinite(y).all(axis=1)
        values[finite] = rows[finite] @ inside + y[finite] @ slack
        return values

    def multiplier_rows(self, rows: Array, slack: Array) -> Array:
        """y >= 0 with G^T y = z and the least <slack, y>, shape (k, m); inf where there is none.

        The slack h - G x >= 0 of a point x of the set is one for all rows z, shape (m,), or one for
        each. The rows of G that bind for one z do so for all z of the cone that they generate, and
        for another slack where the point in which they meet satisfies the other rows.
        """
        if self._bounds is not None:
            return self._bounds.multipliers(rows, slack / self._units) / self._units
        multipliers, left = np.zeros((len(rows), self.h.size)), np.flatnonzero(rows.any(axis=1))
        multipliers[left] = np.inf
        slack = np.broadcast_to(slack, multipliers.shape)
        while left.size:
            z, s, serves = rows[left], slack[left] / self._units, np.arange(left.size) == 0
            first = self.with_offsets(slack[left[0]])
            of_first = first._multipliers(z[0])
            if of_first is not None:
                active = np.flatnonzero(of_first)
                normals, inverse = (G := dense(self.rows[active])), np.linalg.pinv(G)
                y, meet = np.maximum(z @ inverse, 0.0), s[:, active] @ inverse.T @ self.rows.T
                rounding = 10 * ROUNDING * (np.abs(z) + np.abs(y) @ np.abs(normals))
                inside = (s == s[0]) | (meet <= s + ROUNDING * (s + np.abs(meet)))
                equal = np.abs(y @ normals - z) <= rounding
                serves |= inside.all(axis=1) & equal.all(axis=1)
                y[0] = of_first[active]
                multipliers[left[serves]] = 0.0
                multipliers[np.ix_(left[serves], active)] = y[serves] / self._units[active]
            left = left[~serves]
        return multipliers

    def _multipliers(self, p: Array) -> Array | None:
        """The y >= 0 with G^T y = p that minimises <h, y>, 0 in C; None if there is none.

        The rows that hold t p back are those of the support function once t is large enough;
        beyond active sets, or where none proves it, HiGHS is asked.
        """
        # rows of length 1 and units of the data: what follows looks at absolute numbers
        weights, size = 1 / self._lengths, float(np.abs(p).max()) or 1.0
        costs, goal = weights * np.maximum(self.offsets, 0.0), p / size
        columns, above = _columns(self.rows.T, weights), list[Array]()
        if self.exact:
            nearest = nonnegative_least_squares(dense(columns), goal).residual
            if nearest > math.sqrt(OUTSIDE):  # NNLS looks at gradients, that are its square
                return None
            extent = float(costs.max()) or 1.0
            for far in REACHES:
                v = far * extent * goal
                normal = self._exact_normal(v)
                if normal is None:
                    break
                if not normal.active.size:
                    continue
                y, some = np.zeros(costs.size), dense(columns[:, normal.active])
                y[normal.active], residual = nonnegative_least_squares(some, goal)
                value, rounding = float(costs @ y), 10 * ROUNDING * (1 + float(y.sum()))
                # from too far away the nearest point, and with it its rows, is rounding
                known = abs(value - goal @ (v - normal.u)) <= NEAR * (value + extent)
                if residual <= min(2 * nearest, OUTSIDE) + rounding:
                    if known:
                        return size * weights * y
                    above.append(y)
        result = scipy.optimize.linprog(
            costs / (float(costs.max()) or 1.0),
            A_eq=columns,
            b_eq=goal,
            method="highs",
            options={
                "primal_feasibility_tolerance": OUTSIDE,
                "dual_feasibility_tolerance": OUTSIDE,
            },
        )
        if result.x is None or not result.success:
            if above:  # needles: each <h, y> is no less than the support function
                return size * weights * min(above, key=costs.dot)
            if result.status == 2:
                return None
            rows = dense(self.rows) / self._lengths[:, None]
            i, j = divmod(int(np.argmin(rows @ rows.T)), len(rows))
            raise SweepoptError(
                f"the support function of a Polyhedron is lost in rounding: rows {i} and {j} of G "
                f"are nearly opposite; leave one out, or make it minus the other ({result.message})"
            )
        return size * weights * result.x

    def normal(self, v: Array) -> Array:
        exact = self._memo(v, self._exact_normal)
        return normal_by_program(self, v) if exact is None else exact.u.copy()

    def _exact_normal(
        self,
        v: Array,
        tau: Array | float = 1.0,
        margin: Array | float = 0.0,
        flat: Flat | None = None,
    ) -> Shortest | None:
        """u = (v - w) / tau from the active rows, w the nearest point in the metric of 1 / tau.

        The set is that of h + margin. The first active rows are equations, if these are given.
        None where there are too many rows and unknowns, and where no active rows prove it.
        """
        offsets, root = self.offsets + margin, np.sqrt(tau * np.ones(self.dim))
        slack = offsets - self.rows @ v
        if flat is None and (slack >= 0).all():
            return Shortest(np.zeros(self.dim), np.zeros(0, dtype=int))
        if not self.exact:
            return None
        G, rounding = _columns(self.rows, root), self._rounding(v)
        normal = (
            least_distance(G, slack, rounding)
            if flat is None
            else shortest_on(flat.equations, flat.others, G, slack, rounding)
        )
        if normal is None:
            return None
        at_apex = normal.active.size == self.dim and not offsets[normal.active].any()  # w is 0
        return Shortest(v / tau if at_apex else 0.0 - normal.u / root, normal.active)

    def project(self, w: Array) -> Array:
        return w - self.normal(w)

    def project_rows(self, rows: Array, offsets: Array | None = None) -> Array:
        """Projections with the h of this set, or with one for each row, shape (k, m).

        The rows of G that bind for one point do so for all points of a polyhedral cone.
        """
        points, h = rows.copy(), self.h if offsets is None else offsets
        h = np.broadcast_to(h / self._units, (len(rows), self.h.size))
        if self._bounds is not None:
            lower, upper = self._bounds.ends(h)
            if (lower <= upper).all():
                return np.clip(rows, lower, upper)
            if not self.exact:
                raise EmptySetError(EMPTY)
        left = np.flatnonzero((rows @ self.rows.T > h).any(axis=1))
        while left.size:
            v, serves = rows[left], np.arange(left.size) == 0
            first = self if offsets is None else self.with_offsets(offsets[left[0]])
            normal = first._exact_normal(v[0])
            if normal is None:
                points[left[0]] = first.project(v[0])
            else:
                normals, inverse = (G := dense(self.rows[normal.active])), np.linalg.pinv(G)
                moves = (v @ normals.T - h[left][:, normal.active]) @ inverse.T
                w = v - moves
                w[0] = v[0] - normal.u
                rounding = ROUNDING * (np.abs(h[left]) + np.abs(v) @ abs(self.rows).T)
                inside = (w @ self.rows.T <= h[left] + rounding).all(axis=1)
                serves |= inside & (moves @ inverse >= 0).all(axis=1)
                points[left[serves]] = w[serves]
            left = left[~serves]
        return points

    def is_inside(self, w: Array, distance: float) -> bool:
        slack = self.offsets - self.rows @ w - self._rounding(w)
        return bool((slack / self._lengths >= distance).all())

    def derivative(self, v: Array) -> Array | None:
        normal = self._memo(v, self._exact_normal)
        if normal is None:
            return None
        return np.eye(self.dim) - projector(dense(self.rows[normal.active]))

    def normal_pair(self, p: Array, w: Array, tau: Array) -> NormalPair | None:
        """On the face that v = w + tau p is nearest to: v gives the rows, p their multipliers."""
        root = np.sqrt(tau)
        # what is empty by no more than the rounding of its rows is not
        flat = self._flat(w)
        normal = self._exact_normal(w + tau * p, tau, self._rounding(w), flat)
        if normal is None:
            return None
        active = normal.active
        inverse = np.linalg.pinv(dense(self.rows[active]) * root)
        multipliers = (root * p) @ inverse
        multipliers = np.where(flat.equations[active], multipliers, np.maximum(multipliers, 0.0))
        normals, h = dense(self.rows[active]), self.offsets[active]
        rounding = UNIT * (1 + active.size) * (np.abs(multipliers) @ abs(normals))
        near = w + tau * (p - normal.u)
        point = near - root * (inverse @ (normals @ near - h))
        slack = self._slack(point)
        # the exact point of the face is as near, and in C where other rows have that much slack
        off = root * (abs(inverse) @ (np.abs(slack) + flat.widths)[active])
        bare = slack < abs(self.rows) @ off
        bare[active] = False
        bare &= flat.others
        if not bare.any():
            return NormalPair(multipliers @ normals, point, 0.0, Perturbation(off, rounding))
        return self._exact_pair(p, w, tau, bare | ~flat.others, active)

    def _exact_pair(
        self, p: Array, w: Array, tau: Array, rows: Array, active: Array
    ) -> NormalPair | None:
        """The pair that the nearest point to w + tau p makes, without any rounding but of itself.

        These rows, and those that turn out to be violated, are all that counts.
        """
        rows[active] = True
        limit = self._rounding(w)  # what is empty by no more than that is not
        weights = rational(tau)
        v = rational(w) + weights * rational(p)
        while min(rows.sum(), self.dim) <= RATIONAL_DIM:
            G, h = rational(dense(self.rows[rows])), rational(self.offsets[rows])
            slack, metric = h - G @ v, partial(np.multiply, weights)
            y = exact_multipliers(G, slack, metric)
            if y is None:
                y = exact_multipliers(G, slack + rational(limit[rows]), metric)
            if y is None:
                return None
            normal = y @ G
            point = (v - weights * normal).astype(float)
            near = self._slack(point) < UNIT * (abs(self.rows) @ np.abs(point))
            if not (near & ~rows).any():
                normal = normal.astype(float)
                rounding = Perturbation(UNIT * np.abs(point), UNIT * np.abs(normal))
                return NormalPair(normal, point, 0.0, rounding)
            rows |= near
        return None

    def _rounding(self, w: Array) -> Array:
        return ROUNDING * (np.abs(self.offsets) + abs(self.rows) @ np.abs(w))

    def _flat(self, w: Array) -> Flat:
        """Opposite rows are equations where, seen from w, rounding is all that is between them."""
        i, j, sign = self._parallel
        slack = (self.offsets - self.rows @ w) / self._lengths
        equal = self._parallel.equal(slack, self._rounding(w) / self._lengths)
        equal = np.flatnonzero((sign < 0) & equal)
        directions, first = np.unique(self._lead[i[equal]], return_index=True)
        i, j = i[equal[first]], j[equal[first]]
        equations, widths = np.zeros(slack.size, dtype=bool), np.zeros(slack.size)
        equations[i], widths[i] = True, np.abs(slack[i] + slack[j]) * self._lengths[i]
        return Flat(equations, widths, ~np.isin(self._lead, directions))

    def _slack(self, w: Array) -> Array:
        """h - G w, rounded once for rows that are near w."""
        products = abs(self.rows) @ np.abs(w)
        slack = self.offsets - self.rows @ w
        near = np.flatnonzero(slack <= NEAR * (np.abs(self.offsets) + products))
        G = dense(self.rows[near])
        terms = np.hstack([self.offsets[near, None], -G * w, -product_error(G, w)])
        slack[near] = [math.fsum(row) for row in terms.tolist()]
        return slack

    def features(self, p: cp.Expression) -> Features:
        return rows_features(self.rows, p)

    def halfspaces(self) -> Halfspaces:
        return Halfspaces.below(self.G, self.h)

    def require_nonempty(self, where: str = "C") -> None:
        d, others = self.offsets / self._lengths, self._flat(np.zeros(self.dim)).others
        equal = self._wedges.equal(d, ROUNDING * np.abs(d)) & others[self._wedges.i]
        if equal.any():  # and no equation tells what is meant
            i, j = (x[equal.argmax()] for x in self._wedges[:2])
            raise InputError(
                f"{where}: rows {i} and {j} of G w <= h are opposite but for rounding: a wedge, "
                f"whose apex may be anywhere, or an equation; for that make row {j} minus row {i}, "
                "for a wedge turn one of them further"
            )
        try:
            self.project(np.zeros(self.dim))
        except EmptySetError:
            raise EmptySetError(f"{where} is empty: no w satisfies G w <= h") from None

    def polar(self) -> ConvexSet:
        if self.h.any():
            return super().polar()
        generated: ConvexSet = self.algebra.image(self.G.T, Orthant(self.h.size))
        return generated


Polyhedron.__new__.__signature__ = signature(Polyhedron.__init__)  # type: ignore[attr-defined]


def _columns(G: Any, units: Array) -> Any:
    """G with its columns in these units; dense rows stay out of sparse products."""
    return G @ sp.diags_array(units) if sp.issparse(G) else G * units


class Bounds(NamedTuple):
    """Rows i of a polyhedron that are bounds of single unknowns, factor w[j] <= h[i].

    They are in the order of their sides 2 j + (factor > 0); of each the first row is at `first`.
    """

    dim: int
    i: Array
    side: Array
    factor: Array
    first: Array

    @classmethod
    def of_entries(cls, i: Array, j: Array, factor: Array, dim: int) -> Bounds:
        side = 2 * j + (factor > 0)
        order = np.argsort(side, kind="stable")
        first = np.unique(side[order], return_index=True)[1]
        return cls(dim, i[order], side[order], factor[order], first)

    def _least(self, of_rows: Array) -> Array:
        """The least number of a row for each side, shape (..., 2 dim)."""
        least = np.full((*of_rows.shape[:-1], 2 * self.dim), np.inf)
        if self.i.size > self.first.size:  # some sides have several
            of_rows = np.minimum.reduceat(of_rows, self.first, axis=-1)
        least[..., self.side[self.first]] = of_rows
        return least

    def ends(self, h: Array) -> tuple[Array, Array]:
        """The bounds of w for an h, or for each of its rows; crossed if a zero row has no point."""
        least = self._least(h[..., self.i] / np.abs(self.factor))
        lower, upper = -least[..., ::2], least[..., 1::2]
        empty = (np.delete(h, self.i, axis=-1) < 0).any(axis=-1)
        lower[empty], upper[empty] = np.inf, -np.inf
        return lower, upper

    def multipliers(self, rows: Array, slack: Array) -> Array:
        """As `Polyhedron.multiplier_rows`: of the rows for one side those with the least slack."""
        y, free = np.zeros((len(rows), slack.shape[-1])), np.ones(2 * self.dim, dtype=bool)
        pull = np.maximum(rows[:, self.side // 2] / self.factor, 0.0)
        if self.i.size > self.first.size:
            of_rows = np.broadcast_to(slack, y.shape)[:, self.i] / np.abs(self.factor)
            nearest = of_rows == self._least(of_rows)[:, self.side]
            count = np.add.reduceat(nearest, self.first, axis=1, dtype=float)
            pull *= nearest / np.repeat(count, np.diff([*self.first, self.i.size]), axis=1)
        y[:, self.i], free[self.side] = pull, False
        y[((rows < 0) & free[::2] | (rows > 0) & free[1::2]).any(axis=1)] = np.inf
        return y


class HalfSpace(Polyhedron):
    """{ w : <normal, w> <= offset }:  sigma(s normal) = s offset for s >= 0, +inf elsewhere.

    Parameters
    ----------
    normal : array_like, shape (dim,), not zero
    offset : float

    Raises
    ------
    InputError
        If normal is zero, or an entry is not finite.

    Examples
    --------
    >>> HalfSpace([3.0, 4.0], 5.0).project([3.0, 4.0])
    array([0.6, 0.8])
    """

    def __init__(self, normal: Any, offset: float) -> None:
        row = vector("normal", normal)
        if not row.any():
            raise InputError(
                "normal must not be zero; give the direction that leads out of the set"
            )
        super().__init__(row[None, :], [number("offset", offset)])

    def __repr__(self) -> str:
        return f"HalfSpace(dim {self.dim}, normal={brief(self.G[0])}, offset={self.offset})"

    @property
    def offset(self) -> float:
        """The h of its row."""
        return float(self.h[0])

    def support(self, z: Array) -> float:
        row, length = self.rows[0], float(np.linalg.norm(self.rows[0]))
        factor = float(row @ (z / length)) / length
        # z must be a multiple of the row up to rounding
        if factor < 0 or np.linalg.norm(z - factor * row) > ROUNDING * np.linalg.norm(z):
            return float("inf")
        return factor * float(self.offsets[0])
