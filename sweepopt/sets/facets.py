"""The rows of sums, images, products and intersections of polyhedra: polyhedra again.

An intersection has the rows of both sets, a product those of its factors, the image M P under a
one-to-one M those of P at M^-1 w. Other images, and sums, are the hulls of their vertices, which
add up: the facets come from Qhull, in few dimensions.
"""

from __future__ import annotations

import copy

import numpy as np
import scipy.linalg
import scipy.optimize

from sweepopt.linalg import dense, row_lengths
from sweepopt.sets.aligned import Aligned, product_of
from sweepopt.sets.base import RANK, ConvexSet, Halfspaces, NoHalfspacesError, places
from sweepopt.sets.lifted import Intersection
from sweepopt.sets.polyhedra import Polyhedron
from sweepopt.sets.polytope import Polytope, convex_hull, hull_vertices
from sweepopt.sets.shapes import Box

UNBOUNDED = "a sum or an image of an unbounded set; state its rows as so.Polyhedron(G, h)"
VERTICES = 2000  # of a sum or an image: as many rows make a phase take seconds
FLAT = 1e-12  # of a set's offsets: a smaller radius is rounding


def facets(C: ConvexSet) -> Halfspaces:
    """The rows of a polyhedron, also of one that is made of others.

    Raises
    ------
    NoHalfspacesError
        If a part is curved; if a sum, or an image that is not one-to-one, is unbounded or has too
        many dimensions or vertices.

    Examples
    --------
    >>> from sweepopt.sets import Box, image
    >>> N, d, *_ = facets(Box([-1, -1], [1, 1]) + image([[1.0], [1.0]], Box([-1], [1])))
    >>> len(N), d.max().round(3)
    (6, np.float64(2.0))
    """
    try:
        return C.halfspaces()
    except NoHalfspacesError:
        E, F, parts = C.form()
        if parts == (C,):
            raise
    if isinstance(C, Aligned):
        with_rows = copy.copy(C)
        with_rows.parts = tuple(_polyhedron(facets(S)) for S in C.parts)
        return with_rows.halfspaces()
    if isinstance(C, Intersection):
        return _stacked(*map(facets, C.operands))
    E = dense(E)
    if F.shape[0] or np.linalg.matrix_rank(E, RANK * np.linalg.norm(E, 2)) < E.shape[1]:
        return Polytope(_vertices(C)).halfspaces()
    N, d, equations, e = facets(product_of(parts))
    back, rest = np.linalg.pinv(E), scipy.linalg.null_space(E.T).T
    zero = np.zeros(len(rest))
    return Halfspaces(N @ back, d, np.vstack([equations @ back, rest]), np.append(e, zero))


def _polyhedron(rows: Halfspaces) -> Polyhedron:
    N, d, E, e = rows
    return Polyhedron(np.vstack([dense(N), E, -E]), np.concatenate([d, e, -e]))


def _stacked(*sets: Halfspaces) -> Halfspaces:
    N, d, E, e = zip(*sets, strict=True)
    return Halfspaces(
        np.vstack([dense(rows) for rows in N]), np.concatenate(d), np.vstack(E), np.concatenate(e)
    )


def _vertices(C: ConvexSet) -> np.ndarray:
    """Those of a bounded polyhedron: of { s in S, F s = 0 }, or sums of those of the parts."""
    E, F, parts = C.form()
    if F.shape[0]:
        fixed = Halfspaces(np.zeros((0, F.shape[1])), np.zeros(0), dense(F), np.zeros(F.shape[0]))
        return _corners(_stacked(facets(product_of(parts)), fixed)) @ E.T
    points = np.zeros((1, C.dim))
    for part, at in zip(parts, places(parts), strict=True):
        for ends in _summands(part):
            each = points[:, None] + ends @ dense(E[:, at]).T
            points = hull_vertices(each.reshape(-1, C.dim))
            if len(points) > VERTICES:
                raise NoHalfspacesError(f"a sum or an image of more than {VERTICES} vertices")
    return points


def _summands(part: ConvexSet) -> list[np.ndarray]:
    """Vertices of sets whose sum is the part: a box is one of segments."""
    if isinstance(part, Polytope):
        return [part.vertices]
    if not isinstance(part, Box):
        return [_corners(facets(part))]
    if not np.isfinite(part.magnitude()):
        raise NoHalfspacesError(UNBOUNDED)
    unit = np.eye(part.dim)
    return [
        np.outer(np.unique([a, b]), e) for a, b, e in zip(part.lower, part.upper, unit, strict=True)
    ]


def _corners(rows: Halfspaces) -> np.ndarray:
    """The vertices of { w : N w <= d, E w = e }, if it is bounded.

    From an inner point, the centre of the largest ball: where that has no radius, rows with a
    multiplier in its program are equations.
    """
    N, d, E, e = rows
    start = np.linalg.lstsq(E, e, rcond=RANK)[0] if len(E) else np.zeros(N.shape[1])
    span = scipy.linalg.null_space(E, RANK) if len(E) else np.eye(N.shape[1])
    if not span.shape[1]:
        return start[None]
    A, b = dense(N) @ span, d - N @ start
    lengths = np.linalg.norm(A, axis=1)
    real = np.flatnonzero(lengths > RANK * row_lengths(N))
    A, b = A[real] / lengths[real, None], b[real] / lengths[real]
    size = float(np.abs(b).max(initial=0.0)) or 1.0
    goal = np.append(np.zeros(span.shape[1]), -1.0)
    ball = scipy.optimize.linprog(
        goal, np.column_stack([A, np.ones(len(A))]), b / size, bounds=(None, None)
    )
    if ball.status == 2 or ball.x is None:
        raise NoHalfspacesError(UNBOUNDED)
    centre, radius = size * ball.x[:-1], ball.x[-1]
    if radius <= FLAT:
        more = real[ball.ineqlin.marginals < 0]
        return _corners(Halfspaces(N, d, np.vstack([E, dense(N)[more]]), np.append(e, d[more])))
    # around the centre each facet of the hull of the rows is polar to a vertex
    polar = A * (radius * size / (b - A @ centre))[:, None]
    if span.shape[1] == 1:
        planes = np.array([[1.0, -polar.max()], [-1.0, polar.min()]])
    else:
        planes = convex_hull(polar).equations
    if (planes[:, -1] > -FLAT).any():  # the centre is not inside of that hull
        raise NoHalfspacesError(UNBOUNDED)
    corners = centre - radius * size * planes[:, :-1] / planes[:, -1:]
    return start + np.unique(corners, axis=0) @ span.T
