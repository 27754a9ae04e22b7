"""The contract of a convex set: everything else in the library asks only for what stands here.

A set C enters the velocity program through its support function sigma(C, z) = sup_{w in C} <w, z>
and through the projection on C. Two facts make one small contract enough:

* **sigma is linear in the set's offsets.** Every set has a vector h of *offsets* (bounds, centres,
  radii, right hand sides) with  sigma(C, p) = min { <h, y> : (p, y) in a fixed convex cone }.
  Moving C by translation, scaling or h(t) changes h and nothing else, so a program is compiled
  once and a step touches vectors only. `features` states the cone in cvxpy and returns y. Both
  are in the set's own units: where data of several kinds meet, powers of two (`binary`) of their
  sizes are divided out, so that a solver gets the same bits whatever forces are measured in.
* **A projection proves a normal pair.** For any v and tau > 0 put w = P_C(v), p = (v - w) / tau:
  then p is in N_C(w) exactly (Moreau). Started from a solver's answer this gives a pair that
  satisfies the inclusion, has exact zeros where the body is stuck, and carries all of the
  solver's error in a residual that can be measured. `normal_pair` does this.
"""

from __future__ import annotations

import copy
import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache, wraps
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, cast

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Array, Matrix, divisor, number, vector
from sweepopt.display import Brief, brief, svg
from sweepopt.errors import InputError, SweepoptError
from sweepopt.linalg import dense
from sweepopt.sets.curves import products

if TYPE_CHECKING:
    import cvxpy as cp

DENSE = 300  # unknowns up to which matrices of the square of their number are cheap
TINY = np.finfo(float).tiny  # 0 / TINY = 0
ROUNDING = 8 * float(np.finfo(float).eps)  # of a sum of a few products: less is nothing
RANK = 1e-13  # singular values that are no more than this share of the largest are rounding


class Features(NamedTuple):
    """The support function as a program: sigma(C, p) = min { <offsets, y> : constraints }.

    Attributes
    ----------
    y : list or tuple of cvxpy expressions
        Stacked they have one entry for each of the set's offsets.
    constraints : list or tuple of cvxpy constraints
        Of a cone: they hold for s p and s y, s > 0, where they hold for p and y.
    """

    y: Sequence[cp.Expression]
    constraints: Sequence[cp.Constraint]


class Perturbation(NamedTuple):
    """Bounds, entry by entry, of what rounding moves w and p of a pair."""

    w: Array
    p: Array


class NormalPair(NamedTuple):
    """A point w of C, a p with finite sigma(C, p), and gap >= sigma(C, p) - <p, w> >= 0.

    Both may be rounded: then an exact pair is as near as `perturbation` says, to first
    order. None where that is nothing but the last digits of w and p.
    """

    p: Array
    w: Array
    gap: float
    perturbation: Perturbation | None = None


class Selection(NamedTuple):
    """C = shift + { w : w[unknowns] in part, all other entries 0 }; shift None is 0."""

    unknowns: Array
    part: ConvexSet
    shift: Array | None


class Blocks(NamedTuple):
    """Blocks of a derivative on unknowns, shape (k, n), as matrices D, shape (k, n, n).

    They take the memory of k n^2 numbers where the derivative takes (k n)^2.
    """

    unknowns: Array
    D: Array


def neighbours(D: Array) -> Blocks:
    """Blocks one after the other in the vector."""
    return Blocks(np.arange(D.shape[0] * D.shape[1]).reshape(D.shape[:2]), D)


def exchange_matrix(
    M: Any, C: ConvexSet, unknowns: Any = slice(None), force: Array | None = None
) -> sp.dia_array | None:
    """H with `ConvexSet.exchange` of a set on these unknowns, zeros beside them.

    None for 0, or where the set does not exchange stiffness at the force on all unknowns.
    """
    if not (force is None or C.exchanges(force[unknowns])):
        return None
    H = np.zeros(M.shape[0])
    H[unknowns] = C.exchange(np.asarray(M.diagonal(), dtype=float)[unknowns])
    return sp.diags_array(H) if H.any() else None


class Halfspaces(NamedTuple):
    """C = { w : N w <= d, E w = e }, matrices dense or sparse."""

    N: Any
    d: Array
    E: Array
    e: Array

    @classmethod
    def below(cls, N: Any, d: Array) -> Halfspaces:
        """N w <= d alone."""
        return cls(N, d, np.zeros((0, N.shape[1])), np.zeros(0))

    def inequalities(self) -> tuple[Array, Array]:
        """G and h with C = { w : G w <= h }, an equation as two rows."""
        N, d, E, e = self
        return np.vstack([dense(N), E, -E]), np.concatenate([d, e, -e])


class NoHalfspacesError(Exception):
    """A set, named by its part, that is no polyhedron or whose rows are not known."""


@lru_cache(64)
def identity(n: int) -> sp.csr_array:
    """I, the same object for every set that is its own part."""
    return sp.eye_array(n, format="csr")


@lru_cache(64)
def no_rows(n: int) -> sp.csr_array:
    """A matrix without rows."""
    return sp.csr_array((0, n))


class _Entries:
    """A small matrix by its entries."""

    def __init__(self, M: Matrix) -> None:
        self.M = M
        arrays = (M.indptr, M.indices, M.data) if sp.issparse(M) else (M,)
        self._key = M.shape, *(array.tobytes() for array in arrays)

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Entries) and self._key == other._key


def once(operation: Callable[..., Any]) -> Callable[..., Any]:
    """An operation on matrices that is done once for equal small ones, and makes one object.

    Sets that are stated anew at every time have the same matrices; sparse ones of a few entries
    take 0.1 ms for each operation.
    """
    kept = lru_cache(16)(lambda *each: operation(*(one.M for one in each)))

    @wraps(operation)
    def of(*matrices: Matrix) -> Any:
        if any(max(M.shape) > DENSE or getattr(M, "format", "csr") != "csr" for M in matrices):
            return operation(*matrices)
        return kept(*map(_Entries, matrices))

    return of


@once
def _product(M: Matrix, E: sp.csr_array) -> sp.csr_array:
    product = sp.csr_array(M if E is identity(E.shape[0]) else sp.csr_array(M) @ E)
    product.sort_indices()  # in place, which threads that share it must not
    return product


@once
def _rows(E: sp.csr_array, F: sp.csr_array) -> Any:
    """Those of E and of F, dense where that is cheap."""
    if max(*E.shape, *F.shape) <= DENSE:
        return np.vstack([dense(E), dense(F)])
    return sp.csc_array(sp.vstack([E, F]))


@once
def _one_above(E: sp.csr_array, F: sp.csr_array) -> sp.csr_array:
    return sp.csr_array(sp.vstack([E, F]))


@once
def _added(*of: sp.csr_array) -> tuple[sp.csr_array, sp.csr_array]:
    """E and F of C + D, of their E and their F."""
    return sp.csr_array(sp.hstack(of[:2])), _diagonal(*of[2:])


@once
def _common(*of: sp.csr_array) -> tuple[sp.csr_array, sp.csr_array]:
    """Of C & D: (s, r) -> E_C s, and F_C s, F_D r, E_C s - E_D r."""
    (E, D), F = of[:2], _diagonal(*of[2:])
    rows = sp.csr_array(sp.vstack([F, sp.hstack([E, -D])]))
    return sp.csr_array(sp.hstack([E, sp.csr_array(D.shape)])), rows


@once
def _diagonal(*blocks: sp.csr_array) -> sp.csr_array:
    return sp.csr_array(sp.block_diag(blocks, format="csr"))


class Form(NamedTuple):
    """C = { E s : s in parts[0] x parts[1] x ..., F s = 0 }, E and F sparse.

    Sums, intersections, images and products of sets, translated and scaled, all have this form,
    with parts whose projections are known. A translation is the sum with a point.
    """

    E: sp.csr_array
    F: sp.csr_array
    parts: tuple[ConvexSet, ...]

    def __repr__(self) -> str:
        matrix = self.E.toarray().tolist() if self.E.size <= 4 else brief(self.E)
        return f"{matrix} of {', '.join(map(brief, self.parts))}"

    @classmethod
    def alone(cls, part: ConvexSet) -> Form:
        """A set as its own part."""
        return cls(identity(part.dim), no_rows(part.dim), (part,))

    @classmethod
    def beside(cls, *forms: Form) -> Form:
        """C x D x ...: everything is stacked."""
        if len(forms) == 1:
            return forms[0]
        Es, Fs, parts = zip(*forms, strict=True)
        return cls(_diagonal(*Es), _diagonal(*Fs), sum(parts, start=()))

    @classmethod
    def added(cls, C: Form, D: Form) -> Form:
        """C + D."""
        E, F = _added(C.E, D.E, C.F, D.F)
        return cls(E, F, C.parts + D.parts)

    @classmethod
    def common(cls, C: Form, D: Form) -> Form:
        """C & D: the points of C, with rows that say that those of D are the same."""
        E, F = _common(C.E, D.E, C.F, D.F)
        return cls(E, F, C.parts + D.parts)

    @property
    def small(self) -> bool:
        """Whether dense matrices of its size are cheap."""
        return max(*self.E.shape, *self.F.shape) <= DENSE

    @property
    def rows(self) -> Any:
        """Those of E and of F, dense where that is cheap."""
        return _rows(self.E, self.F)

    def image(self, M: Any) -> Form:
        """M C."""
        return self._replace(E=_product(M, self.E))

    def cut(self, D: Any) -> Form:
        """The w of C with D w = 0."""
        return self._replace(F=_one_above(self.F, _product(D, self.E)))


class Algebra(NamedTuple):
    """What is stated of all kinds of sets in one place: operations, rows that move, `epigraph`."""

    add: Callable[[Any, Any], Any]
    scale: Callable[[Any, Any], Any]
    intersect: Callable[[Any, Any], Any]
    image: Callable[[Any, Any], Any]
    with_moving_offsets: Callable[..., Any]
    epigraph: Callable[[Any, Any], tuple[Any, list[Any]]]


class Operators(Brief):
    """The operators on sets, moving ones too; the laws are stated in operations.py."""

    dim: int
    algebra: ClassVar[Algebra]
    # numpy and pandas must leave v + C, r * C and v - C to the operators below
    __array_ufunc__ = None
    __pandas_priority__ = 10000
    depth = 0  # of operations that each ask the set before

    def __add__(self, other: Any) -> Any:
        return self.algebra.add(self, other)

    def __sub__(self, other: Any) -> Any:
        if not is_vector(other):
            raise InputError("C - D is ambiguous; write C + (-D) for the Minkowski sum")
        return self + -vector("v", other, self.dim)

    def __rsub__(self, other: Any) -> Any:
        return -self + other

    def __rmul__(self, factor: float) -> Any:
        return self.algebra.scale(factor, self)

    def __rmatmul__(self, M: Any) -> Any:
        return self.algebra.image(M, self)

    def __truediv__(self, divisor: float) -> Any:
        r = number("C / r: r", divisor)
        if not r:
            raise InputError("C / r: r must not be 0")
        return self.algebra.scale(1 / r, self)

    def __neg__(self) -> Any:
        return self.algebra.scale(-1.0, self)

    def __and__(self, other: Any) -> Any:
        return self.algebra.intersect(self, other)

    def __contains__(self, w: Any) -> bool:
        raise InputError("w in C: write C.contains(w), of a set that moves C.at(t).contains(w)")

    def __or__(self, _: Any) -> Any:
        raise InputError("C | D is not defined: a union is not convex; an intersection is C & D")

    def __matmul__(self, _: Any) -> Any:
        raise InputError("C @ M is not defined; an image is M @ C")

    def __radd__(self, other: Any) -> Any:
        return self if isinstance(other, int) and not other else self + other  # sum() adds to 0

    __mul__ = __rmul__


class _Required:
    """Stands for an attribute that each set gives itself, and says so where one has not."""

    def __init__(self, what: str) -> None:
        self._what = what

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, C: ConvexSet | None, owner: type) -> Any:
        if C is None:
            return self
        what = f"self.{self._name} = {self._what}"
        raise InputError(f"{owner.__name__} has no {self._name}: give it {what}, in its __init__")


class ConvexSet(Operators, ABC):
    """A non-empty closed convex set C in R^dim: the base of all sets, and of your own.

    A set stays as it was made: to change a radius or a bound make a new set, and a new process.

    A set of your own has `dim` and `offsets`, and gives `support`, `project` and `features`; the
    example has all that is needed. If it has more data than its offsets, such as a matrix, name
    them in `fixed`; if it is unbounded give `normal` too, and `derivative` to let Newton's method
    solve its programs to rounding, many times as fast.

    Attributes
    ----------
    dim : int
        Dimension of the space.
    offsets : ndarray, shape (k,)
        The numbers in which the support function is linear: bounds, radii, right hand sides.
    fixed : tuple of str
        Names of attributes, arrays, that are other data: where they and the numbers of offsets are
        the same, one compiled program serves two sets.
    polyhedral : bool
        Whether C is a polyhedron, so that a QP solver can treat it.
    exact : bool
        Whether `project` is exact to rounding: a formula or an active set, no iteration.
    certifiable : bool
        Whether answers can be proved, as a projection does; so it is by default.

    Examples
    --------
    A disc of radius r, as if there were no `Ball`. `features` says in cvxpy that sigma(C, p) is the
    least <offsets, y> under its constraints, here r y with |p| <= y:

    >>> import cvxpy as cp
    >>> import numpy as np
    >>> import sweepopt as so
    >>> from sweepopt.sets import Features
    >>> class Disc(so.ConvexSet):
    ...     def __init__(self, r):
    ...         self.dim, self.r, self.offsets = 2, r, np.array([r])
    ...     def support(self, z):
    ...         return self.r * np.hypot(*z)
    ...     def project(self, w):
    ...         return w * (self.r / max(np.hypot(*w), self.r))
    ...     def features(self, p):
    ...         y = cp.Variable(1)
    ...         return Features([y], [cp.norm(p) <= y[0]])
    >>> load = so.Separable([(so.Sine(3.0, period=4.0), [1.0, 0.5])])
    >>> process = so.EvolutionVI(np.eye(2), None, load=load, dissipation=Disc(1.0), u0=[0, 0])
    >>> so.solve(process, t_end=4.0, steps=40).success
    True
    """

    dim: int = cast(int, _Required("its number of unknowns"))
    offsets: Array = cast(
        Any, _Required("an array of the numbers in which its support function is linear")
    )
    fixed: tuple[str, ...] = ()
    polyhedral: bool = False
    certifiable: bool = True
    exact: bool = True
    _start: Any = None  # of the next projection in the metric of a run
    _last: tuple[bytes, Any] = b"", None

    def __init_subclass__(cls) -> None:
        """Arguments of `support` and `project` are vectors of the space, whoever wrote the set."""
        support, project = (vars(cls).get(name) for name in ("support", "project"))
        if support:

            @wraps(support)
            def checked_support(self: Any, z: Any) -> Any:
                return support(self, vector("z", z, self.dim))

            cls.support = checked_support  # type: ignore[method-assign]
        if project:

            @wraps(project)
            def checked_project(self: Any, w: Any) -> Any:
                return project(self, vector("w", w, self.dim))

            cls.project = checked_project  # type: ignore[method-assign]

    # ---- the contract -------------------------------------------------------------------------

    @abstractmethod
    def support(self, z: Array) -> float:
        """sigma(C, z) = sup of <w, z> over w in C; +inf where C is unbounded in direction z."""

    @abstractmethod
    def project(self, w: Array) -> Array:
        """The point of C nearest to w in the Euclidean norm."""

    @abstractmethod
    def features(self, p: cp.Expression) -> Features:
        """y with sigma(C, p) = min <offsets, y>, and the constraints that tie y to p."""

    def same_cone(self, other: ConvexSet) -> bool:
        """Whether only the offsets differ, so that one compiled program serves both sets."""
        return (
            type(self) is type(other)
            and self.dim == other.dim
            and self.offsets.size == other.offsets.size
            and all(same_array(getattr(self, x), getattr(other, x)) for x in self.fixed)
        )

    # ---- what follows from it -----------------------------------------------------------------

    def copy_for_run(self, before: ConvexSet | None = None) -> ConvexSet:
        """C for one run alone, after another one: where its projections start others do not see."""
        if self.exact:
            return self
        made = copy.copy(self)
        made._start = before and before._start
        return made

    def _memo(self, v: Array, function: Callable[[Array], Any]) -> Any:
        """function(v), kept for the last v: projection, derivative and pair ask in turn.

        Threads may do so at once: each takes what is kept as one, key and value.
        """
        key, last = v.tobytes(), self._last
        if last[0] != key:
            last = self._last = key, function(v)
        return last[1]

    def outline(self) -> Array:
        """Points around the boundary of a bounded set in the plane, shape (k, 2); else none.

        Of a set without certificates they are corners of supporting lines, up to 1e-3 outside.
        """
        if self.dim != 2 or not math.isfinite(self.magnitude()):
            return np.zeros((0, 2))
        angles = np.linspace(0.0, 2 * math.pi, 73)
        normals = np.column_stack([np.cos(angles), np.sin(angles)])
        if self.certifiable:
            return self.project_rows(self.anchor + 100 * self.magnitude() * normals)
        # corners of supporting lines: a projection would take six times as long
        sigma = self.support_rows(normals)
        pairs = zip(pairwise(normals), pairwise(sigma), strict=True)
        corners = [np.linalg.solve(pair, values) for pair, values in pairs]
        return np.array([*corners, corners[0]])

    def _picture(self) -> str:
        try:
            points = self.outline()
        except SweepoptError:  # no point is known: C may be empty
            return ""
        return svg([points], equal=True) if points.size else ""

    def normal(self, v: Array) -> Array:
        """v - P_C(v), exactly 0 in C; sets with an unbounded direction compute it in dom sigma."""
        return v - self.project(v)

    def weights(self, tau: Array) -> Array:
        """Positive weights near tau in whose metric `project` is the projection too.

        One number for the unknowns of each block: every factor of a product keeps its own units.
        """
        return np.repeat(tau.reshape(-1, self.block).mean(axis=1), self.block)

    def derivative(self, v: Array) -> Array | None:
        """A generalised derivative of `project` at v, of a set that has no `blocks` of its own.

        Returns
        -------
        ndarray, shape (dim,) or (dim, dim), or None
            A diagonal as a vector; None where none is known.
        """
        return None

    @cached_property
    def sharp_gaps(self) -> bool:
        """Whether `gaps_along_curves` finds a curve on the boundary whose gap is next to nothing.

        Beside a chord of a curved boundary the gap is of order two in its length.
        """
        return self.polyhedral

    @cached_property
    def block(self) -> int:
        """How many unknowns `blocks` couples at most."""
        return self.dim

    @cached_property
    def differentiable(self) -> bool:
        """Whether `blocks` is known."""
        return self.blocks(self.anchor) is not None

    def blocks(self, v: Array) -> list[Blocks] | None:
        """The blocks of a generalised derivative of `project` at v; None where none is known."""
        D, at = self.derivative(v), np.arange(self.dim)
        if D is None:
            return None
        return [Blocks(at[:, None], D[:, None, None]) if D.ndim == 1 else Blocks(at[None], D[None])]

    def exchange(self, diagonal: Array) -> Array:
        """A diagonal H that may be added to this one, so that `project` knows the metric.

        <H z, z> = 0 where -z is on the boundary of dom sigma: where `exchanges` says that the
        velocity is there, the program with M + H has the same solution as that with M.
        """
        return np.zeros(self.dim)

    def exchanges(self, force: Array) -> bool:
        """Whether -z in N_C(M z + force) puts -z on the boundary of dom sigma, or z = 0."""
        return True

    def normal_pair(self, p: Array, w: Array, tau: Array) -> NormalPair | None:
        """A proven normal pair near the approximate one (p, w); None if the set has no proof.

        Parameters
        ----------
        p, w : ndarray, shape (dim,)
            Approximately p in N_C(w): p = -z and w = M z + q from a solver.
        tau : ndarray, shape (dim,)
            Positive weights that bring p to the units of w (the diagonal of M).
        """
        weights = self.weights(tau)
        v = w + weights * p
        pair = NormalPair(self.normal(v) / weights, self.project(v), 0.0)
        rounding = ROUNDING * self.shift_sizes
        if not (rounding.any() and pair.p.any()):
            return pair
        return pair._replace(perturbation=Perturbation(rounding, rounding / weights))

    def gap(self, p: Array, w: Array) -> float:
        """sigma(C, p) - <p, w> >= 0 for w in C; zero exactly if p is normal to C at w."""
        sigma = self.support(p)
        return max(sigma - float(p @ w), 0.0) + ROUNDING * abs(sigma) if p.any() else 0.0

    def gaps_along_curves(self, p: Array, w: Array, sizes: Array) -> Array:
        """At least the mean of size (sigma(C, p) - <p, w>) >= 0 along curves p and w in C.

        w = sum_k b_k size_k w_k / size with size = sum_k b_k size_k > 0. As sigma is convex, sum_jk
        b_j b_k size_k (sigma(C, p_j) - <p_j, w_k>) is a bound at any time, if all w_k are in C.

        Parameters
        ----------
        p : ndarray, shape (m, 3, dim)
            Bernstein coefficients of quadratic curves on [0, 1].
        w : ndarray, shape (m, 4, dim)
        sizes : ndarray, shape (m, 4)
        """
        sigma = self.supports_along(p, w)[:, :, None]
        each = np.maximum(sigma - p @ np.swapaxes(w, 1, 2), 0.0) + ROUNDING * np.abs(sigma)
        gaps: Array = (products(2, 3) * sizes[:, None] * each).sum(axis=(1, 2))
        return gaps

    def curves_within(self, curves: Array, sizes: Array) -> Array:
        """Curves w in C next to these, all with such sizes (`gaps_along_curves`)."""
        return self.project_rows(curves.reshape(-1, self.dim)).reshape(curves.shape)

    def supports_along(self, p: Array, w: Array) -> Array:
        """sigma(C, p_j) of quadratic curves p, or bounds of it that are close beside curves w."""
        return self.support_rows(p.reshape(-1, self.dim)).reshape(p.shape[:2])

    def support_rows(self, rows: Array) -> Array:
        """`support` of each row, shape (m, dim)."""
        return np.array([self.support(p) if p.any() else 0.0 for p in rows])

    def project_rows(self, rows: Array) -> Array:
        """`project` of each row, shape (m, dim)."""
        return np.array([self.project(w) for w in rows])

    def project_quickly(self, w: Array) -> Array | None:
        """`project`; None where that takes long: C is empty, or so small that it may be."""
        return self.project(w)

    def epigraph(self, p: cp.Expression) -> tuple[cp.Expression, list[cp.Constraint]]:
        """The support function in cvxpy, to be read: minimising `value` gives sigma(C, p).

        Nothing is scaled, data and new variables have names (sweepopt/sets/epigraph.py).

        Returns
        -------
        value : cvxpy.Expression
            Upper bound of sigma(C, p) under the constraints, equal to it at the minimum.
        constraints : list of cvxpy.Constraint
        """
        return self.algebra.epigraph(self, p)

    def is_inside(self, w: Array, distance: float) -> bool:
        """Whether it is known that all points within this distance of w are in C."""
        return not (distance or self.normal(w).any())

    def contains(self, w: Array, tol: float = 1e-9) -> bool:
        """Whether the Euclidean distance of w to C is at most tol."""
        w, tol = vector("w", w, self.dim), number("tol", tol, minimum=0.0)
        return bool(np.linalg.norm(w - self.project(w)) <= tol)

    def magnitude(self) -> float:
        """sup of |w| over C, or an upper bound of it; +inf for unbounded sets."""
        # |w|_2 <= |(sup |w_i|)_i|_2
        axes = np.eye(self.dim)
        return float(np.hypot.reduce([max(self.support(e), self.support(-e)) for e in axes]))

    def distance_bound(self, other: ConvexSet) -> float | None:
        """An upper bound of the Hausdorff distance of two sets of one family.

        |sigma(C, z) - sigma(D, z)| <= |z| * distance_bound (Adly and Haddad, Lemma 2.1).

        Returns
        -------
        float or None
            0 if the sets are equal, exact in one dimension; None if no bound is known.
        """
        require_same_dim("distance_bound", self, other)
        # one cone and one vector of offsets: one support function
        if self.same_cone(other) and np.array_equal(self.offsets, other.offsets):
            return 0.0
        if self.dim == 1:
            axes = np.array([[1.0], [-1.0]])
            return float(
                np.abs(difference(*([C.support(e) for e in axes] for C in (self, other)))).max()
            )
        bounds = [C._distance(D) for C, D in ((self, other), (other, self))]
        return min((distance for distance in bounds if distance is not None), default=None)

    def _distance(self, other: ConvexSet) -> float | None:
        """A bound that the family knows; asked in both orders, the smaller one counts."""
        return None

    def require_nonempty(self, where: str = "C") -> None:
        """Raise EmptySetError if C has no point."""

    @property
    def singleton(self) -> bool:
        """Whether C is one point: then the velocity program is a linear system."""
        return False

    @property
    def is_bounded(self) -> bool:
        """Whether that is seen by its parts: unbounded ones, too, may make a bounded set."""
        return all(math.isfinite(part.magnitude()) for part in self.form().parts)

    @property
    def anchor(self) -> Array:
        """The translation c of C = c + S, zero for a set that is not written as a translate."""
        return np.zeros(self.dim)

    @property
    def shift_sizes(self) -> Array:
        """Sizes of the translations in C, centres and vertices among them: C rounds as they do.

        Without it 19 of 96 balls and 15 of 89 hulls whose boundary is next to 0, of 1e5 times the
        forces and more, had certificates below the error.
        """
        return np.abs(self.anchor)

    @property
    def nonsmooth_dim(self) -> int:
        """How many unknowns C really acts on (fewer than dim for the image of a small set)."""
        if self.selection is not None:
            return self.selection.part.nonsmooth_dim
        return min(self.dim, sum(part.dim for part in self.form().parts if not part.singleton))

    @property
    def selection(self) -> Selection | None:
        """The few unknowns C acts on, if it is the image of a set under a selection of them."""
        return None

    def halfspaces(self) -> Halfspaces:
        """The rows of C, if it is a polyhedron whose rows are known.

        Raises
        ------
        NoHalfspacesError
        """
        raise NoHalfspacesError(type(self).__name__)

    def factors(self) -> list[ConvexSet]:
        """The sets whose product C is, one after the other in the vector."""
        return [self]

    def form(self) -> Form:
        """C in lifted form; a set that is projected on exactly is its own part."""
        return Form.alone(self)

    def polar(self) -> ConvexSet:
        """The polar cone { p : <p, w> <= 0 for all w in C }."""
        raise InputError(
            f"{type(self).__name__} is not a cone whose polar is known, and has no polar(); such "
            "cones are so.Orthant(n), so.SecondOrderCone(n), half-spaces and polyhedra through 0, "
            "products of them, images of orthants, sums and intersections"
        )

    def at(self, t: float) -> ConvexSet:
        """C(t): a set that does not move is the same at every time."""
        return self

    def at_many(self, times: Array) -> list[ConvexSet]:
        """As `MovingSet.at_many`."""
        return [self] * len(times)

    def members(self, times: Array) -> list[tuple[float, ConvexSet]]:
        """As `MovingSet.members`: one member, itself."""
        self.require_nonempty(f"C(t) at t = {times[0]:g}")
        return [(float(times[0]), self)]


def placed(parts: Sequence[ConvexSet]) -> list[tuple[ConvexSet, slice]]:
    """Each part and where it is in the vector of all, one after the other."""
    ends = np.cumsum([0, *(part.dim for part in parts)]).tolist()
    return [(part, slice(*pair)) for part, pair in zip(parts, pairwise(ends), strict=True)]


def is_vector(value: Any) -> bool:
    """Whether value can be a translation: numbers, or what numpy reads, such as a pandas Series."""
    return isinstance(value, (list, tuple, int, float)) or hasattr(value, "__array__")


def nested(C: Any, *operands: Any) -> Any:
    """C, made by an operation that asks its operands; refused if it is too deep for Python."""
    C.depth = 1 + max(S.depth for S in operands)
    deepest = sys.getrecursionlimit() // 20  # each takes up to ten frames
    if C.depth > deepest:
        raise InputError(
            f"more than {deepest} operations on sets are nested; add up the vectors, and multiply "
            "the matrices, before they meet a set"
        )
    return C


def binary(size: float) -> float:
    """The power of two below a size, 1 for none: to divide by it rounds nothing.

    In units that are such powers of the data the numbers are the same, to the last bit, whatever
    powers of two forces and lengths are multiplied by.

    Examples
    --------
    >>> binary(5.0), binary(0.0)
    (4.0, 1.0)
    """
    return math.ldexp(0.5, math.frexp(size)[1]) if size else 1.0


def row_units(name: str, M: Matrix) -> Array:
    """`binary` of the largest entry of each row; refused, as `name` calls it, if that is tiny."""
    largest = abs(M).max(axis=1)
    largest = (largest.toarray() if sp.issparse(M) else largest).ravel()
    for i in np.flatnonzero(largest):
        divisor(f"the largest entry of {name.format(i)}", largest[i])
    return np.array([binary(size) for size in largest.tolist()])


def same_array(a: Any, b: Any) -> bool:
    """Equality of two matrices that is free when they are the same object."""
    if a is b or a.shape != b.shape or sp.issparse(a) != sp.issparse(b):
        return a is b
    if not sp.issparse(a):
        return bool(np.array_equal(a, b))
    arrays = ("indptr", "indices", "data")  # a != b takes 10 times as long
    return a.format == b.format and all(
        np.array_equal(getattr(a, x), getattr(b, x)) for x in arrays
    )


def difference(a: Any, b: Any) -> Array:
    """a - b for bounds that may be infinite: equal infinities differ by 0."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    return np.subtract(a, b, out=np.zeros(a.shape), where=a != b)


def require_same_dim(what: str, C: Any, D: Any) -> None:
    """Raise InputError if the two sets live in different spaces."""
    if C.dim != D.dim:
        raise InputError(f"{what}: the sets have dim {C.dim} and {D.dim}; they must be equal")
