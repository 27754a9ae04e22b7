"""A set in other units of its entries: { units * w : w in C }, of the same kind as C.

Sums, cuts, hulls and ellipsoids are projected on in one metric for all entries. Where the diagonal
of M spans many orders, such a projection rounds away the entries that M makes small; in units that
make the diagonal even it does not.
"""

from __future__ import annotations

from functools import singledispatch

import numpy as np
import scipy.sparse as sp

from sweepopt.sets.algebra import Negation, Scaling, Translation
from sweepopt.sets.base import ConvexSet
from sweepopt.sets.ellipsoid import Ellipsoid
from sweepopt.sets.image import Image
from sweepopt.sets.intersections import Intersection
from sweepopt.sets.polyhedra import HalfSpace, Polyhedron
from sweepopt.sets.polytope import Polytope
from sweepopt.sets.product import Product
from sweepopt.sets.shapes import Box, Point
from sweepopt.sets.sums import Sum


@singledispatch
def in_units(C: ConvexSet, units: np.ndarray) -> ConvexSet | None:
    """{ units * w : w in C }; None where that is a set of another kind.

    Parameters
    ----------
    C : ConvexSet
    units : ndarray, shape (dim,)
        Powers of two: nothing is rounded.

    Examples
    --------
    >>> in_units(Polytope([[0, 0], [1, 1]]), np.array([1.0, 4.0])).vertices
    array([[0., 0.],
           [1., 4.]])
    """
    return None


@in_units.register
def _(C: Point, units: np.ndarray) -> ConvexSet | None:
    return Point(units * C.offsets)


@in_units.register
def _(C: Box, units: np.ndarray) -> ConvexSet | None:
    return Box(units * C.lower, units * C.upper)


@in_units.register
def _(C: Polyhedron, units: np.ndarray) -> ConvexSet | None:
    G = C.G @ sp.diags_array(1 / units, format="csc") if sp.issparse(C.G) else C.G / units
    return Polyhedron(G, C.h)


@in_units.register
def _(C: HalfSpace, units: np.ndarray) -> ConvexSet | None:
    return HalfSpace(C.G[0] / units, C.offset)


@in_units.register
def _(C: Polytope, units: np.ndarray) -> ConvexSet | None:
    return Polytope(units * C.vertices)


@in_units.register
def _(C: Ellipsoid, units: np.ndarray) -> ConvexSet | None:
    shape = np.outer(units, units) * C.shape
    values = np.linalg.eigvalsh(shape)
    # what is long and thin in these units has no axes to rounding
    return Ellipsoid(units * C.center, shape) if values[0] > 1e-12 * values[-1] else None


@in_units.register
def _(C: Translation, units: np.ndarray) -> ConvexSet | None:
    part = in_units(C.part, units)
    return part and Translation(part, units * C.v)


@in_units.register
def _(C: Scaling, units: np.ndarray) -> ConvexSet | None:
    part = in_units(C.part, units)
    return part and Scaling(C.factor, part)


@in_units.register
def _(C: Negation, units: np.ndarray) -> ConvexSet | None:
    part = in_units(C.part, units)
    return part and Negation(part)


@in_units.register
def _(C: Product, units: np.ndarray) -> ConvexSet | None:
    cuts = np.cumsum([part.dim for part in C.parts])[:-1]
    parts = map(in_units, C.parts, np.split(units, cuts))
    known = [part for part in parts if part is not None]
    return Product(tuple(known)) if len(known) == len(C.parts) else None


@in_units.register
def _(C: Sum, units: np.ndarray) -> ConvexSet | None:
    first, second = in_units(C.first, units), in_units(C.second, units)
    return Sum(first, second) if first and second else None


@in_units.register
def _(C: Intersection, units: np.ndarray) -> ConvexSet | None:
    first, second = in_units(C.first, units), in_units(C.second, units)
    return Intersection(first, second) if first and second else None


@in_units.register
def _(C: Image, units: np.ndarray) -> ConvexSet | None:
    if C.selection is not None:
        part = in_units(C.part, units[C.selection.unknowns])
        return part and C.with_part(part)
    M = sp.diags_array(units, format="csc") @ C.M if sp.issparse(C.M) else units[:, None] * C.M
    other = Image(M, C.part)
    return None if C.exact and not other.exact else other
