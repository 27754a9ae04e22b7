"""The linear image of a set:  sigma(M C, z) = sigma(C, M^T z)."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import divisor, matrix, vector
from sweepopt.errors import InputError
from sweepopt.linalg import dense
from sweepopt.sets.base import (
    DENSE,
    ROUNDING,
    ConvexSet,
    Features,
    NormalPair,
    Perturbation,
    Selection,
    binary,
    require_same_dim,
    same_array,
)
from sweepopt.sets.columns import column_sizes, gathered, selected, with_own_columns
from sweepopt.sets.composed import Composed
from sweepopt.sets.flat import Flat
from sweepopt.sets.iteration import fixed_point, project_by_program
from sweepopt.sets.moving import MovingSet
from sweepopt.sets.nearest import nearest_in_box
from sweepopt.sets.polyhedra import Polyhedron
from sweepopt.sets.polytope import Polytope
from sweepopt.sets.shapes import Box, Point

if TYPE_CHECKING:
    import cvxpy as cp


class Image(Composed):
    """{ M s : s in C }, C in R^m, M of shape (dim, m).

    With M = E^T selecting a few of many unknowns this is how contact enters a large body: the
    set acts on m unknowns only, and a plan can eliminate the others. `image` makes it.

    Raises
    ------
    InputError
        If M is not a finite matrix with C.dim columns; if a column that is not zero has no entry of
        1e-75 or more.
    """

    def __init__(self, M: Any, part: ConvexSet) -> None:
        self.M = matrix("M", M)
        self.dim, columns = self.M.shape
        if not self.dim:
            raise InputError("M must have at least one row")
        if columns != part.dim:
            raise InputError(f"image(M, C): M has {columns} columns but C has dim {part.dim}")
        for j, entry in enumerate(column_sizes(self.M)):
            if entry:
                divisor(f"the largest entry of column {j} of M", entry)
        self._selected = selected(self.M)
        # made once: a transpose costs a sparse matrix each time
        self._transposed = self.M.T.tocsr() if sp.issparse(self.M) else self.M.T
        # programs see a matrix of numbers near 1
        self._unit = binary(abs(self.M).max())
        self._squares = self._transposed * self._transposed
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
            self.injective = bool((self._diagonal > 0).all())
        else:
            full = dense(self.M)
            self._pinv = np.linalg.pinv(full)
            self._square_norm = float(np.linalg.norm(full, 2)) ** 2
            self.injective = bool(np.linalg.matrix_rank(full) == columns)
        self._set_part(part)

    def _set_part(self, part: ConvexSet) -> None:
        for cached in ("_plain", "_rows", "_splittings", "_last"):  # those of another part
            self.__dict__.pop(cached, None)
        self.part, self.offsets = part, self._unit * part.offsets
        self.polyhedral, self.certifiable = part.polyhedral, part.certifiable
        self.nested = not part.exact
        separable = isinstance(part, Box) or self._uniform
        self._closed_form = self._orthogonal and self.injective and separable
        self.exact = self._closed_form and part.exact
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
        if self._selected is not None:
            return w[self._selected]
        safe = np.where(self._diagonal > 0, self._diagonal, 1.0)
        return (self._transposed @ w) / safe

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

    def _pulled_back(self, z: np.ndarray) -> np.ndarray:
        """M^T z; an entry that is nothing but rounding is 0, so that it meets sigma's domain."""
        inner = self._pull(z)
        if self._selected is None:
            inner[np.abs(inner) <= 2 * ROUNDING * (abs(self._transposed) @ np.abs(z))] = 0.0
        return inner

    def support(self, z: np.ndarray) -> float:
        return self.part.support(self._pulled_back(vector("z", z, self.dim)))

    def project(self, w: np.ndarray) -> np.ndarray:
        w = vector("w", w, self.dim)
        if self._dual is not None:
            return w - self._dual.project(w)
        s = self._nearest(w)
        return project_by_program(self, w) if s is None else self._push(s)

    def normal(self, v: np.ndarray) -> np.ndarray:
        near = self.near(v) if self._dual is None and not self._closed_form else None
        if near is not None:
            p = near.splitting.normal(near).p
        else:
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
            change = inner - self._pull(p)
            p = p + (
                self._push(change / self._diagonal) if self._pinv is None else self._pinv.T @ change
            )
        return p if np.abs(p).max() > ROUNDING * size else np.zeros(self.dim)

    def _nearest(self, w: np.ndarray) -> np.ndarray | None:
        """s in C with M s nearest to w, to rounding."""
        s = self.part.project(self._solve(w))
        if self._closed_form or not self._square_norm:
            return s
        near, form = self.near(w), Flat.of(self.part)
        if near is not None and form is not None:
            return form.point(near.parts)
        if self.nested:
            return None  # projections that iterate in projections
        found = self._gradients(w, s)
        if found is None and isinstance(self.part, Box):
            found = self._gradients(w, nearest_in_box(dense(self.M), self.part, w))
        return found

    def _gradients(self, w: np.ndarray, s: np.ndarray) -> np.ndarray | None:
        """By projected gradients: they crawl where M hardly sees a direction that C leaves open."""
        return fixed_point(lambda s: self.part.project(self._descended(s, w)), s, s)

    def _descended(self, s: np.ndarray, w: np.ndarray) -> np.ndarray:
        """The gradient step whose projection leaves s where it is if M s is nearest to w."""
        return s - self.M.T @ (self.M @ s - w) / self._square_norm

    def derivative(self, v: np.ndarray) -> np.ndarray | None:
        """That of P(v); None for a selection, whose part has one."""
        if self._dual is not None:
            normal = self._dual.derivative(v)
            return None if normal is None else np.eye(self.dim) - normal
        return None if self._selected is not None else super().derivative(v)

    def features(self, p: cp.Expression) -> Features:
        return self.part.features((self._transposed / self._unit) @ p)

    def normal_pair(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray
    ) -> NormalPair | None:
        if not self.certifiable:
            return None
        if not self.injective:
            step = float(np.mean(tau))
            return self._pair_of_nearest(w + step * p).over(step)
        inner = self._pull(p)
        weights = (self._squares @ tau) / self._diagonal**2  # tau in the units of s
        found = self.part.normal_pair(inner, self._solve(w), weights, self._unit * y)
        assert found is not None  # the part is certifiable
        perturbation = found.perturbation
        if perturbation is not None:
            size = abs(self.M)
            back = size / self._diagonal if self._pinv is None else np.abs(self._pinv.T)
            perturbation = Perturbation(size @ perturbation.w, back @ perturbation.p)
        return NormalPair(self._lifted(p, found.p), self._push(found.w), found.gap, perturbation)

    def _pair_of_nearest(self, v: np.ndarray) -> NormalPair:
        """The normal pair of the projection of v."""
        if self._dual is not None:
            normal = self.normal(v)
            return NormalPair(normal, v - normal, 0.0)
        near = self.near(v)
        if near is not None:
            normal = near.splitting.normal(near).p
            return NormalPair(normal, near.w.copy(), 0.0, near.perturbation(normal))
        s = self._nearest(v)
        if s is not None:
            return NormalPair(v - self.M @ s, self.M @ s, 0.0)
        # not to rounding: the parameters nearest to the program's answer, and what they miss
        normal = v - project_by_program(self, v)
        w = v - normal

        def meet(s: np.ndarray) -> np.ndarray:
            return self.part.project(s + self._solve(w - self.M @ s))

        s = meet(np.zeros(self.part.dim))
        better = fixed_point(meet, s, s, self.sweeps)
        s = s if better is None else better
        inner = self._pulled_back(normal)
        gap = self.part.support(inner) - float(inner @ s)
        return NormalPair(normal, self.M @ s, max(gap, 0.0))

    def flat(self) -> Flat | None:
        found = Flat.of(self.part) if self.dim <= DENSE else None
        return found and found.pushed(dense(self.M))

    def same_cone(self, other: ConvexSet) -> bool:
        return (
            isinstance(other, Image)
            and same_array(self.M, other.M)
            and self.part.same_cone(other.part)
        )

    def require_nonempty(self, where: str = "C") -> None:
        self.part.require_nonempty(where)

    def magnitude(self) -> float:
        norm = np.sqrt(self._diagonal.max()) if self._orthogonal else np.linalg.norm(dense(self.M))
        return float(norm) * self.part.magnitude() if norm else 0.0

    def _distance(self, other: ConvexSet) -> float | None:
        if not (isinstance(other, Image) and same_array(self.M, other.M)):
            return None
        found = self.part.distance_bound(other.part)
        return None if found is None else float(np.sqrt(self._square_norm)) * found

    @property
    def nonsmooth_dim(self) -> int:
        return self.part.nonsmooth_dim

    @property
    def selection(self) -> Selection | None:
        return None if self._selected is None else Selection(self._selected, self.part, None)

    def __neg__(self) -> Image:
        return self.with_part(-self.part)

    def polar(self) -> ConvexSet:
        self.part.polar()  # says so if this is no cone at all
        if not isinstance(self.part, Box):
            raise self._polar_unknown()
        return self._polar_rows()

    def _polar_rows(self) -> ConvexSet:
        """<p, M s> <= 0 for all s of the cone: M^T p is in its polar, row by row."""
        rows = self.part.polar().rows()
        assert rows is not None  # the polar of a box is a box
        return Polyhedron(rows[0] @ self.M.T, rows[1])


def image(M: Any, C: Any) -> Any:
    """{ M s : s in C }; moving sets too.

    Parameters
    ----------
    M : array_like or sparse, shape (dim, C.dim)
        With M = E^T selecting unknowns the set acts on these alone.
    C : ConvexSet or MovingSet

    Raises
    ------
    InputError
        If M is not a finite matrix with C.dim columns, or C no set; if a column that is not zero
        has no entry of 1e-75 or more.

    Examples
    --------
    >>> image([[1.0], [1.0]], Box([-1], [1])).support([2.0, 3.0])
    5.0
    """
    if isinstance(C, MovingSet):
        # all that depends on M alone is computed once, with a part of the right dim
        template = Image(M, Point(np.zeros(C.dim)))
        return MovingSet(lambda t: template.with_part(C.at(t)), template.dim)
    if not isinstance(C, ConvexSet):
        raise InputError(f"image(M, C): C must be a set, got {type(C).__name__}")
    M = matrix("M", M)
    if isinstance(C, Box) and M.shape[0] and C.dim == M.shape[1]:
        M, C = with_own_columns(M, C)
        M, C = gathered(M, C) or (M, C)
    found = Image(M, C)
    if isinstance(C, Point):
        return Point(found.M @ C.offsets)
    if isinstance(C, Polytope) and not found.injective:
        return Polytope((found.M @ C.vertices.T).T)
    return found
