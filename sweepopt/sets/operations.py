"""The algebra of sets: sums, multiples, intersections, products and images.

    C + v, C + D, r C, -C, C & D, so.product(C, D, ...), so.image(M, C)

What stays a point, a box, a ball, an ellipsoid, a polyhedron or a polytope is one; every other
composed set is a lifted form (lifted.py), or a product, translate or multiple (aligned.py) of
others. Operators of `ConvexSet` call these functions.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from functools import partial, reduce, wraps
from typing import Any

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import HUGE, Array, Matrix, matrix, number, vector
from sweepopt.errors import InputError, shown
from sweepopt.linalg import dense
from sweepopt.loads import Constant, Separable
from sweepopt.sets.aligned import Aligned, Similar, shape_of
from sweepopt.sets.balls import Ball, BallImage, Balls, Ellipsoid
from sweepopt.sets.base import (
    DENSE,
    Algebra,
    ConvexSet,
    Form,
    NoHalfspacesError,
    Operators,
    is_vector,
    nested,
    once,
    placed,
    require_same_dim,
    row_units,
)
from sweepopt.sets.epigraph import epigraph
from sweepopt.sets.lifted import Intersection, Lifted, Sum
from sweepopt.sets.moving import (
    WITHOUT_STATE,
    Moving,
    MovingOffsets,
    MovingSet,
    StateDependent,
    Summands,
)
from sweepopt.sets.polyhedra import ACTIVE_DIM, Polyhedron
from sweepopt.sets.polytope import Polytope
from sweepopt.sets.shapes import Box, Point

COLUMN = "column {} of M"
MANY_ROWS = 150  # of a polyhedron: so many take as long as active sets, 290 four times


def over_time(operation: Callable[..., Any], linear: bool = False) -> Callable[..., Any]:
    """The operation, which for sets that move is done at every time.

    Points in their place tell at once whether the operands fit, and the dim of the result. Where
    all sets move by data so does the result, if the operation is linear, or if its result has
    rows, which do not move.
    """

    @wraps(operation)
    def on_all(*operands: Any) -> Any:
        if not any(isinstance(C, MovingSet) for C in operands):
            return operation(*operands)
        if any(isinstance(C, StateDependent) for C in operands):
            raise InputError(WITHOUT_STATE)
        summands = _summands(operation, operands) if linear else None
        if summands and (translated := _translated(summands)):
            return translated
        made: Any = _with_rows(operation, operands, linear)
        if made is None:
            fixed = [copy.copy(x) if is_vector(x) else x for x in operands]
            points = (Ball(np.zeros(x.dim), 0.0) if isinstance(x, MovingSet) else x for x in fixed)
            made = MovingSet(partial(_operation_at, on_all, fixed), operation(*points).dim)
        made.summands = summands
        made.operands = tuple(C for C in operands if isinstance(C, MovingSet))
        return nested(made, *(C for C in operands if isinstance(C, Operators)))

    return on_all


def _operation_at(operation: Callable[..., Any], operands: list[Any], at: Any) -> ConvexSet:
    """What an operation makes of its operands at a time, or of sets given for their parts."""
    each = (x.member(at) if isinstance(x, MovingSet) else x for x in operands)
    made: ConvexSet = operation(*each)
    return made


def _summands(operation: Callable[..., Any], operands: Sequence[Any]) -> Summands | None:
    """What a linear operation makes of sums: op(C_1, C_2, ...) = op(C_1, 0, ...) + op(0, C_2, ...).

    None where another thing moves.
    """
    constant = list(operands)
    zeros = [Point(np.zeros(x.dim)) if isinstance(x, Operators) else x for x in operands]
    vectors = operation(*zeros).anchor  # those that it adds

    def of_one(k: int, S: ConvexSet) -> ConvexSet:
        made: ConvexSet = operation(*zeros[:k], S, *zeros[k + 1 :])
        return made - vectors if vectors.any() else made

    center: list[Any] = []
    scaled: list[Any] = []
    for k, C in enumerate(operands):
        if isinstance(C, MovingSet):
            own = C.summands
            if own is None:
                return None
            constant[k] = own.constant
            center += [(phi, of_one(k, Point(f)).anchor) for phi, f in own.center]
            scaled += [(r, _on_few(of_one(k, S))) for r, S in own.scaled]
    rest = operation(*constant)
    return Summands(tuple(center), _on_few(rest) if scaled else rest, tuple(scaled))


def _on_few(S: ConvexSet) -> ConvexSet:
    """A product beside points 0 as a set on few unknowns."""
    if isinstance(S, Box) and not S.singleton:
        few = np.flatnonzero(S.lower.astype(bool) | S.upper.astype(bool))
        if not few.size:
            return S
        return Aligned(Box(S.lower[few], S.upper[few]), unknowns=few, dim=S.dim)
    if type(S) is not Aligned or S.unknowns is not None:
        return S
    kept = [(C, at) for C, at in placed(S.parts) if not C.singleton or C.anchor.any()]
    parts, where = zip(*kept, strict=True)
    return Aligned(*parts, unknowns=np.r_[where], dim=S.dim)


def _translated(of: Summands) -> Moving | None:
    """c(t) + r(t) S, where there is one set."""
    if not of.scaled:
        return Moving(of.constant, Separable(of.center) if of.center else None)
    if len(of.scaled) > 1 or not isinstance(of.constant, Point):
        return None
    ((r, S),) = of.scaled
    return Moving(S, Separable([(Constant(), of.constant.anchor), *of.center]), r)


def _with_rows(
    operation: Callable[..., Any], operands: Sequence[Any], linear: bool
) -> MovingOffsets | None:
    """The rows of what is made of sets with rows that move: their offsets are linear in those.

    None where a set has no rows, or another thing moves.
    """
    bases, moves, scales = list(operands), [], []
    try:
        for k, C in enumerate(operands):
            if isinstance(C, MovingSet):
                bases[k], terms = _moving_rows(C, linear)
                moves += [(k, phi, S) for phi, S in terms]
                scales += [_terms(C.scale)] if isinstance(C, Moving) and C.scale else []
        made = operation(*bases)
        if type(made) is Aligned and made.unknowns is not None and made.parts[0] is bases[-1]:
            return MovingOffsets(made, operands[1].offsets)  # an image on some unknowns
        if made.dim > DENSE:
            return None
        G, d = made.halfspaces().inequalities()
        terms = [(Constant(), d)]
        for k, phi, S in moves:
            made = operation(*bases[:k], S, *bases[k + 1 :])
            terms.append((phi, made.halfspaces().inequalities()[1] - d))
    except NoHalfspacesError:
        return None
    # the last rows say that no scale is negative
    rows = np.eye(len(G) + len(scales))
    terms = [(phi, h @ rows[: d.size]) for phi, h in terms]
    of_scales = zip(scales, rows[d.size :], strict=True)
    terms += [(phi, r * row) for scale, row in of_scales for phi, r in scale]
    return MovingOffsets(Polyhedron(rows[:, : d.size] @ G, 0 * rows[0]), Separable(terms))


def _moving_rows(C: Any, linear: bool) -> tuple[Any, list[tuple[Any, Any]]]:
    """A set with rows, all offsets 0, and what to put in its place for each history of C(t).

    A linear operation makes boxes of boxes.
    """
    if isinstance(C, MovingOffsets) and hasattr(C.offsets, "terms"):
        return C.shape, [(phi, C.shape.with_offsets(h)) for phi, h in C.offsets.terms]
    if not isinstance(C, Moving) or C.summands is None or C.dim > DENSE:
        raise NoHalfspacesError
    S: Any = C.shape
    d = S.offsets
    if not (linear and isinstance(S, Box)):
        N, d = S.halfspaces().inequalities()
        S = Polyhedron(N, d)
    base, G = S.with_offsets(0 * d), np.eye(S.dim) if S.singleton else S.halfspaces().N
    moved = [(phi, S.with_offsets(G @ f)) for phi, f in C.summands.center]
    scaled = _terms(C.scale or Constant())
    return base, [*((phi, S.with_offsets(r * d)) for phi, r in scaled), *moved]


def _terms(scale: Any) -> list[tuple[Any, float]]:
    """Histories and numbers that a scale is the sum of."""
    return [(phi, r.item()) for phi, r in scale.terms] if hasattr(scale, "terms") else [(scale, 1)]


@partial(over_time, linear=True)
def add(C: ConvexSet, other: Any) -> Any:
    """C + v or C + D; the sum with a point is a translation."""
    if is_vector(other):
        v = vector("v", other, C.dim)
        if isinstance(C, Point):
            return Point(C.anchor + v)
        if isinstance(C, Similar):
            return Similar(C.parts[0], v if C.v is None else C.v + v, C.factor)
        return nested(Similar(C, v), C)
    _require_set("C + D", C, other)
    if isinstance(other, Point):
        return C + other.anchor
    if isinstance(C, Point):
        return other + C.anchor
    if isinstance(C, Box) and isinstance(other, Box):
        return Box(C.lower + other.lower, C.upper + other.upper)
    if isinstance(C, Ball) and isinstance(other, Ball):
        return Ball(C.center + other.center, C.radius + other.radius)
    C = Sum(Form.added(C.form(), other.form()), C, other)
    return nested(C, *C.operands)


@partial(over_time, linear=True)
def scale(factor: Any, C: ConvexSet) -> ConvexSet:
    """r C for any finite r; 0 C is {0} and asks for a bounded C; where |r| < 1e-75 r is 0."""
    if isinstance(factor, Operators):
        raise InputError("C * D is not defined; use so.product(C, D) or C & D")
    r = number("scale", factor)
    if isinstance(C, Point):
        return Point(r * C.anchor)
    if abs(r) < 1 / HUGE:  # what it divides would overflow
        if not np.isfinite(C.magnitude()):
            raise InputError(
                "scale 0 of an unbounded set is not closed in the limit; use scale > 0"
            )
        return Point(np.zeros(C.dim))
    if isinstance(C, Box):
        ends = (C.lower, C.upper) if r > 0 else (C.upper, C.lower)
        return Box(*(r * end for end in ends))  # nothing is divided by r, however small it gets
    if isinstance(C, Similar) and 1 / HUGE <= abs(r * C.factor) <= HUGE:
        return Similar(C.parts[0], None if C.v is None else r * C.v, r * C.factor)
    return nested(Similar(C, None, r), C)


@over_time
def intersect(C: ConvexSet, D: Any) -> Any:
    """C & D; rows under rows are again a polyhedron, with its exact projection."""
    _require_set("C & D", C, D)
    if isinstance(C, Box) and isinstance(D, Box):
        return Box(np.maximum(C.lower, D.lower), np.minimum(C.upper, D.upper))
    have_rows = (isinstance(shape_of(S), (Box, Polyhedron)) and not S.singleton for S in (C, D))
    if C.dim > ACTIVE_DIM or not all(have_rows):
        C = Intersection(_common(C, D), C, D)
        return nested(C, *C.operands)
    (G, h, *_), (F, k, *_) = C.halfspaces(), D.halfspaces()
    stack = sp.vstack if sp.issparse(G) or sp.issparse(F) else np.vstack
    return Polyhedron(stack([G, F]), np.concatenate([h, k]))


def _common(C: ConvexSet, D: ConvexSet) -> Form:
    """C & D; rows of a polyhedron cut C: Newton's method finds the active ones with the rest."""
    if isinstance(C, Polyhedron):
        C, D = D, C
    if isinstance(C, Polyhedron) or not isinstance(D, Polyhedron):
        return Form.common(C.form(), D.form())
    if not 0 < len(D.offsets) <= MANY_ROWS:
        return Form.common(C.form(), D.form())
    rows, one = _with_slacks(D.rows)
    below = Box(np.full(D.offsets.size, -np.inf), D.offsets)
    return Form.beside(C.form(), Form.alone(below)).cut(rows).image(one)


@once
def _with_slacks(G: Matrix) -> tuple[sp.csr_array, sp.csr_array]:
    """(w, r) -> G w - r, and w."""
    m, n = G.shape
    one = sp.eye_array(n, n + m, format="csr")
    return sp.csr_array(sp.hstack([G, -sp.eye_array(m)])), one


@partial(over_time, linear=True)
def product(*sets: Any) -> Any:
    """C x D x ..., one after the other in the vector; moving sets too.

    Parameters
    ----------
    *sets : ConvexSet or MovingSet
        One or more.

    Raises
    ------
    InputError
        If there is none, or one is no set.

    Examples
    --------
    >>> from sweepopt.sets import Ball
    >>> product(Ball([0.0, 0.0], 1.0), Box(-1, 1)).support([3.0, 4.0, 2.0])
    7.0
    """
    if not sets or not all(isinstance(C, ConvexSet) for C in sets):
        raise InputError(
            "product(C, D, ...) takes one or more sets; give them one by one: so.product(*sets)"
        )
    if all(isinstance(C, Point) for C in sets):
        return Point(np.concatenate([C.anchor for C in sets]))
    if all(isinstance(C, Box) for C in sets):
        return Box(np.concatenate([C.lower for C in sets]), np.concatenate([C.upper for C in sets]))
    # the factors of a product, as they are
    flat = [
        S for C in sets for S in (C.parts if type(C) is Aligned and C.unknowns is None else [C])
    ]
    return nested(Aligned(*flat), *flat)


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
    >>> image([[1.0], [1.0]], Box(-1, 1)).support([2.0, 3.0])
    5.0
    >>> (np.array([[1.0], [1.0]]) @ Box(-1, 1)).support([2.0, 3.0])  # the same
    5.0
    """
    if not isinstance(C, (ConvexSet, MovingSet)):
        raise InputError(f"image(M, C): C must be a set, got {shown(C)}")
    return images(M)(C)


def images(M: Any) -> Callable[[Any], Any]:
    """C -> `image(M, C)`, for many sets: M is checked once."""
    M = matrix("M", M)
    if not M.shape[0]:
        raise InputError("M must have at least one row")
    return partial(_image, M)


@once
def _columns(M: Matrix) -> tuple[Array, Array, Array, bool]:
    """Rows and numbers of all entries, the rows with an entry, and if each column has just one."""
    row_units(COLUMN, M.T)
    columns = sp.csc_array(M, copy=True)
    columns.eliminate_zeros()
    rows = columns.indices
    single = rows.size > 0 and bool((np.diff(columns.indptr) == 1).all())
    return rows, columns.data, np.unique(rows), single


@partial(over_time, linear=True)
def _image(M: Matrix, C: ConvexSet) -> ConvexSet:
    """The image as what it is: a point, polytope, cone or ellipsoid, on few unknowns, or more."""
    if M.shape[1] != C.dim:
        hint = "; did you mean its transpose?" if M.shape[0] == C.dim else ""
        raise InputError(f"image(M, C): M has {M.shape[1]} columns but C has dim {C.dim}{hint}")
    unknowns, factors, few, single = _columns(M)
    distinct = few.size == unknowns.size
    if isinstance(C, Point):
        return Point(M @ C.offsets)
    if single:
        if isinstance(C, Box):
            # a contact node that is named several times has the sum of its bounds
            ends = np.zeros((M.shape[0], 2))
            np.add.at(ends, unknowns, np.sort(factors * [C.lower, C.upper], axis=0).T)
            unknowns = unknowns if distinct else few
            return Aligned(Box(*ends[unknowns].T), unknowns=unknowns, dim=M.shape[0])
        if distinct and (factors == factors[0]).all():
            part = C if factors[0] == 1 else scale(factors[0], C)
            return nested(Aligned(part, unknowns=unknowns, dim=M.shape[0]), C)
    # a dense program of few pays where those that are eliminated are more than those that stay
    if sp.issparse(M) and 0 < few.size < M.shape[0] / 2:
        part = _image(sp.csr_array(M)[few], C)
        return nested(Aligned(part, unknowns=few, dim=M.shape[0]), C)
    if isinstance(C, Similar):
        moved = C.factor * _image(M, C.parts[0])
        return moved if C.v is None else moved + M @ C.v
    if not sp.issparse(M) and (type(C) is Balls or (type(C) is Aligned and C.unknowns is None)):
        parts = C.factors() if isinstance(C, Balls) else C.parts
        if 1 < len(parts) <= DENSE // M.shape[0]:
            # one by one: the image of a ball is exact, with columns of any sizes
            return reduce(add, (_image(M[:, at], S) for S, at in placed(parts)))
    if isinstance(C, Polytope):
        return Polytope((M @ C.vertices.T).T)
    if 1 < C.dim <= DENSE >= M.shape[0]:
        if isinstance(C, Ball):
            return BallImage(0.0, dense(M), C)
        if isinstance(C, Ellipsoid):
            root = C.root.T
            return BallImage(M @ C.center, dense(M @ root), Ball(np.zeros(root.shape[1]), 1.0))
    if isinstance(C, Polyhedron):
        # columns of numbers near 1: their units, powers of two, go to the set
        units = sp.diags_array(1 / row_units(COLUMN, M.T))
        M, C = M @ units, Polyhedron(C.G @ units, C.h)
    return Lifted(C.form().image(M), C)


def _require_set(what: str, C: ConvexSet, D: Any) -> None:
    if not isinstance(D, ConvexSet):
        remedy = "a set that a function of t moves is so.Moving(C, center=f)"
        raise InputError(f"{what}: D must be a set, got {shown(D)}; {remedy}")
    require_same_dim(what, C, D)


def with_moving_offsets(G: Any, h: Any) -> MovingOffsets:
    """{ w : G w <= h(t) }."""
    G = matrix("G", G)
    return MovingOffsets(Polyhedron(G, np.zeros(G.shape[0])), h)


Operators.algebra = Algebra(add, scale, intersect, image, with_moving_offsets, epigraph)
