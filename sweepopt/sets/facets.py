"""The rows of sums, images, products and intersections of polyhedra: polyhedra again.

C = { E s : s in S, F s = 0 } has the rows of S where only one s belongs to each w. Other images,
and sums, are the hulls of their vertices, which add up: the facets come from Qhull, in few
dimensions.
"""

from __future__ import annotations

import copy
from typing import NamedTuple

import numpy as np
import scipy.linalg
import scipy.optimize

from sweepopt.checks import Array
from sweepopt.linalg import NEGLIGIBLE, dense, row_lengths
from sweepopt.sets.aligned import Aligned, product_of
from sweepopt.sets.base import RANK, ConvexSet, Form, Halfspaces, NoHalfspacesError, placed
from sweepopt.sets.polyhedra import Polyhedron
from sweepopt.sets.polytope import Polytope, hull_vertices

UNBOUNDED = "a sum or an image of an unbounded set; state its rows as so.Polyhedron(G, h)"
VERTICES = 2000  # of a sum or an image: as many rows make a phase take seconds


class Affine(NamedTuple):
    """{ origin + span r }, the columns of span orthonormal."""

    origin: Array
    span: Array

    @classmethod
    def solutions(cls, E: Array, e: Array) -> Affine:
        """Those of E w = e."""
        return cls(np.linalg.lstsq(E, e, rcond=RANK)[0], scipy.linalg.null_space(E, RANK))


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
    >>> N, d, *_ = facets(Box([-1, -1], [1, 1]) + image([[1.0], [1.0]], Box(-1, 1)))
    >>> len(N), d.max().round(3)
    (6, np.float64(2.0))
    """
    try:
        return C.halfspaces()
    except NoHalfspacesError:
        form = C.form()
        if form.parts == (C,):
            raise
    if isinstance(C, Aligned):
        with_rows = copy.copy(C)
        with_rows.parts = tuple(Polyhedron(*facets(S).inequalities()) for S in C.parts)
        return with_rows.halfspaces()
    E, F = dense(form.E), dense(form.F)
    N, d, equations, e = facets(product_of(form.parts))
    e = np.append(np.zeros(len(F)), e)
    rows = Halfspaces(N, d, np.vstack([F, equations]), e)
    s, span = Affine.solutions(rows.E, e)
    M, w = E @ span, E @ s
    if np.linalg.matrix_rank(M, RANK * np.linalg.norm(E, 2)) < M.shape[1]:
        return Polytope(_corners(rows) @ E.T if len(F) else _sums(form)).halfspaces()
    N, d = N @ span @ np.linalg.pinv(M), d - N @ s
    rest = scipy.linalg.null_space(M.T).T
    return Halfspaces(N, d + N @ w, rest, rest @ w)


def _sums(form: Form) -> Array:
    """The vertices of E S: sums of those of the factors of S."""
    points = np.zeros((1, form.E.shape[0]))
    for S, at in placed(product_of(form.parts).factors()):
        ends = S.vertices if isinstance(S, Polytope) else _corners(facets(S))
        each = points[:, None] + ends @ dense(form.E[:, at]).T
        points = hull_vertices(each.reshape(-1, form.E.shape[0]))
        if len(points) > VERTICES:
            raise NoHalfspacesError(f"a sum or an image of more than {VERTICES} vertices")
    return points


def _corners(rows: Halfspaces) -> Array:
    """The vertices of { w : N w <= d, E w = e }, if it is bounded.

    Seen from an inner point, the centre of the largest ball, they are the facets of the polar set.
    Where that ball has no radius, rows with a multiplier in its program are equations.
    """
    N, d, E, e = rows
    start, span = Affine.solutions(E, e)
    if not span.shape[1]:
        return start[None]
    A, b = dense(N) @ span, d - N @ start
    lengths = row_lengths(A)
    real = np.flatnonzero(lengths > RANK * row_lengths(N))
    A, b = A[real] / lengths[real, None], b[real] / lengths[real]
    size = float(np.abs(b).max(initial=0.0)) or 1.0
    goal = np.append(np.zeros(span.shape[1]), -1.0)
    ball = scipy.optimize.linprog(
        goal, np.column_stack([A, np.ones(len(A))]), b / size, bounds=(None, None)
    )
    if ball.x is None:
        raise NoHalfspacesError(UNBOUNDED)
    centre, radius = size * ball.x[:-1], size * ball.x[-1]
    if radius <= NEGLIGIBLE * size:
        more = real[ball.ineqlin.marginals < 0]
        return _corners(Halfspaces(N, d, np.vstack([E, dense(N)[more]]), np.append(e, d[more])))
    normals, distances, equal, _ = Polytope(A * (radius / (b - A @ centre))[:, None]).halfspaces()
    if len(equal) or (distances <= NEGLIGIBLE).any():  # the centre is not inside of the polar set
        raise NoHalfspacesError(UNBOUNDED)
    return start + (centre + radius * normals / distances[:, None]) @ span.T
