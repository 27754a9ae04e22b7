"""The algebra of sets: sums, multiples, intersections, products and images.

    C + v, C + D, r C, -C, C & D, so.product(C, D, ...), so.image(M, C)

What stays a point, a box, a polyhedron or a polytope is one; every other composed set is a lifted
form (lifted.py), or a translate or multiple (similar.py) of what it was. Operators of `ConvexSet`
call these functions.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import HUGE, Matrix, divisor, matrix, number, vector
from sweepopt.errors import InputError
from sweepopt.sets.base import (
    Algebra,
    ConvexSet,
    Operators,
    binary,
    is_vector,
    require_same_dim,
)
from sweepopt.sets.lifted import Embedding, Intersection, Product, Sum, image_of
from sweepopt.sets.moving import MovingSet, over_time
from sweepopt.sets.polyhedra import ACTIVE_DIM, Polyhedron
from sweepopt.sets.shapes import Box, Point
from sweepopt.sets.similar import Similar, shape_of


@over_time
def add(C: ConvexSet, other: Any) -> Any:
    """C + v or C + D; the sum with a point is a translation."""
    if is_vector(other):
        v = vector("v", other, C.dim)
        return Point(C.anchor + v) if isinstance(C, Point) else Similar(C, v)
    _require_set("C + D", C, other)
    if isinstance(other, Point):
        return C + other.anchor
    if isinstance(C, Point):
        return other + C.anchor
    if isinstance(C, Box) and isinstance(other, Box):
        return Box(C.lower + other.lower, C.upper + other.upper)
    return Sum(C, other)


@over_time
def scale(factor: Any, C: ConvexSet) -> ConvexSet:
    """r C for any finite r; 0 C is {0} and asks for a bounded C; where |r| < 1e-75 r is 0."""
    if hasattr(factor, "at"):
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
    if isinstance(C, Similar) and C.v is None and r * C.factor == 1:
        return C.part
    return Similar(C, None, r)


@over_time
def intersect(C: ConvexSet, D: Any) -> Any:
    """C & D; rows under rows are again a polyhedron, with its exact projection."""
    _require_set("C & D", C, D)
    if isinstance(C, Box) and isinstance(D, Box):
        return Box(np.maximum(C.lower, D.lower), np.minimum(C.upper, D.upper))
    have_rows = (isinstance(shape_of(S), (Box, Polyhedron)) and not S.singleton for S in (C, D))
    if C.dim > ACTIVE_DIM or not all(have_rows):
        return Intersection(C, D)
    (G, h, *_), (F, k, *_) = C.halfspaces(), D.halfspaces()
    stack = sp.vstack if sp.issparse(G) or sp.issparse(F) else np.vstack
    return Polyhedron(stack([G, F]), np.concatenate([h, k]))


@over_time
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
    >>> product(Ball([0.0, 0.0], 1.0), Box([-1], [1])).support([3.0, 4.0, 2.0])
    7.0
    """
    if not sets or not all(isinstance(C, ConvexSet) for C in sets):
        raise InputError("product(C, D, ...) takes one or more sets")
    if all(isinstance(C, Point) for C in sets):
        return Point(np.concatenate([C.anchor for C in sets]))
    if all(isinstance(C, Box) for C in sets):
        return Box(np.concatenate([C.lower for C in sets]), np.concatenate([C.upper for C in sets]))
    return Product(tuple(sets))


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
    moving = isinstance(C, MovingSet)
    if not moving and not isinstance(C, ConvexSet):
        raise InputError(f"image(M, C): C must be a set, got {type(C).__name__}")
    M = matrix("M", M)
    if not M.shape[0]:
        raise InputError("M must have at least one row")
    largest = abs(M).max(axis=0)
    sizes = (largest.toarray() if sp.issparse(M) else largest).tolist()
    for j, size in enumerate(sizes):
        if size:
            divisor(f"the largest entry of column {j} of M", size)
    if moving:
        image_of(M, Point(np.zeros(C.dim)))  # refuses another width now
        return MovingSet(lambda t: image_of(M, C.at(t)), M.shape[0])
    if isinstance(C, Box) and not C.singleton and C.dim == M.shape[1]:
        # columns of numbers near 1: their units, powers of two, go to the box
        units = np.array([binary(size) for size in sizes])
        M, C = M @ sp.diags_array(1 / units), Box(units * C.lower, units * C.upper)
        return _gathered(M, C) or image_of(M, C)
    return image_of(M, C)


def _gathered(M: Matrix, box: Box) -> ConvexSet | None:
    """A contact node that is named several times has the sum of its bounds; None if none is."""
    columns = sp.csc_array(M)
    columns.eliminate_zeros()
    unknowns, place = np.unique(columns.indices, return_inverse=True)
    single = (columns.data == 1).all() and (np.diff(columns.indptr) <= 1).all()
    if not (single and 0 < unknowns.size < place.size):
        return None
    ends = [(columns @ side)[unknowns] for side in (box.lower, box.upper)]
    return Embedding(Box(*ends), unknowns, M.shape[0])


def _require_set(what: str, C: ConvexSet, D: Any) -> None:
    if not isinstance(D, ConvexSet):
        raise InputError(f"{what}: D must be a set, got {type(D).__name__}")
    require_same_dim(what, C, D)


Operators.algebra = Algebra(add, scale, intersect, image)
