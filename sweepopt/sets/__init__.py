"""Convex sets, their algebra and their motion (MATH: D, K and C(t))."""

from __future__ import annotations

from typing import Any

import numpy as np

from sweepopt.checks import matrix
from sweepopt.errors import InputError
from sweepopt.sets.algebra import Product
from sweepopt.sets.balls import Ball, Balls
from sweepopt.sets.base import ConvexSet, Features, Witness
from sweepopt.sets.cones import SecondOrderCone
from sweepopt.sets.constraints import Constraints
from sweepopt.sets.ellipsoid import Ellipsoid
from sweepopt.sets.image import Image, gathered, with_own_columns
from sweepopt.sets.moving import Moving, MovingOffsets, MovingSet
from sweepopt.sets.polyhedra import HalfSpace, Polyhedron
from sweepopt.sets.polytope import Polytope
from sweepopt.sets.shapes import Box, Orthant, Point, WholeSpace

AnySet = ConvexSet | MovingSet


def product(*sets: Any) -> Any:
    """C x D x ..., one after the other in the vector; moving sets too.

    Examples
    --------
    >>> product(Ball([0.0, 0.0], 1.0), Box([-1], [1])).support([3.0, 4.0, 2.0])
    7.0
    """
    if not sets or not all(isinstance(C, (ConvexSet, MovingSet)) for C in sets):
        raise InputError("product(C, D, ...) takes one or more sets")
    if any(isinstance(C, MovingSet) for C in sets):
        return MovingSet(lambda t: product(*(C.at(t) for C in sets)), sum(C.dim for C in sets))
    if all(isinstance(C, Box) for C in sets):
        return Box(np.concatenate([C.lower for C in sets]), np.concatenate([C.upper for C in sets]))
    if all(isinstance(C, Point) for C in sets):
        return Point(np.concatenate([C.offsets for C in sets]))
    return Product(tuple(sets))


def image(M: Any, C: Any) -> Any:
    """{ M s : s in C } for a dense or sparse matrix M of shape (dim, C.dim); moving sets too.

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
    if isinstance(C, Box) and C.dim == M.shape[1]:
        M, C = with_own_columns(M, C)
        M, C = gathered(M, C) or (M, C)
    found = Image(M, C)
    if isinstance(C, Point):
        return Point(found.M @ C.offsets)
    if isinstance(C, Polytope) and not found.injective:
        return Polytope((found.M @ C.vertices.T).T)
    return found


__all__ = [
    "AnySet",
    "Ball",
    "Balls",
    "Box",
    "Constraints",
    "ConvexSet",
    "Ellipsoid",
    "Features",
    "HalfSpace",
    "Moving",
    "MovingOffsets",
    "MovingSet",
    "Orthant",
    "Point",
    "Polyhedron",
    "Polytope",
    "SecondOrderCone",
    "WholeSpace",
    "Witness",
    "image",
    "product",
]
