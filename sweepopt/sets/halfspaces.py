"""Rows of the sets that are polyhedra: C = { w : N w <= d, E w = e }."""

from __future__ import annotations

from functools import singledispatch
from typing import NamedTuple

import numpy as np
import scipy.linalg
from scipy.spatial import ConvexHull, QhullError

from sweepopt.linalg import dense
from sweepopt.sets.algebra import Negation, Scaling, Translation
from sweepopt.sets.balls import Ball
from sweepopt.sets.base import ConvexSet
from sweepopt.sets.polytope import Polytope
from sweepopt.sets.product import Product

FLAT = 1e-12  # extent, relative to the largest one, below which a polytope is flat
HULL = 8  # dimensions up to which a hull is computed


class Halfspaces(NamedTuple):
    """N w <= d and E w = e."""

    N: np.ndarray
    d: np.ndarray
    E: np.ndarray
    e: np.ndarray

    @classmethod
    def below(cls, N: np.ndarray, d: np.ndarray) -> Halfspaces:
        """N w <= d alone."""
        return cls(N, d, np.zeros((0, N.shape[1])), np.zeros(0))

    def translated(self, v: np.ndarray) -> Halfspaces:
        """Of C + v."""
        return self._replace(d=self.d + self.N @ v, e=self.e + self.E @ v)


class NoHalfspacesError(Exception):
    """A set, named by its part, that is no polyhedron or whose rows are not known."""


def halfspaces(C: ConvexSet) -> Halfspaces:
    """The rows of a set.

    Raises
    ------
    NoHalfspacesError

    Examples
    --------
    >>> halfspaces(Polytope([[0.0], [2.0]])).d
    array([2., 0.])
    """
    if C.singleton:
        return Halfspaces(np.zeros((0, C.dim)), np.zeros(0), np.eye(C.dim), C.anchor)
    found = C.rows()
    return _found(C) if found is None else Halfspaces.below(dense(found[0]), found[1])


@singledispatch
def _found(C: ConvexSet) -> Halfspaces:
    """The rows of a set that is not written as rows; beside the few unknowns it acts on w is 0."""
    selection = C.selection
    if selection is None:
        raise NoHalfspacesError(type(C).__name__)
    inner, unit = halfspaces(selection.part), np.eye(C.dim)
    few, rest = unit[selection.unknowns], np.delete(unit, selection.unknowns, axis=0)
    E, e = np.vstack([inner.E @ few, rest]), np.concatenate([inner.e, np.zeros(len(rest))])
    shift = np.zeros(C.dim) if selection.shift is None else selection.shift
    return Halfspaces(inner.N @ few, inner.d, E, e).translated(shift)


@_found.register
def _(C: Translation) -> Halfspaces:
    return halfspaces(C.part).translated(C.v)


@_found.register
def _(C: Scaling) -> Halfspaces:
    inner = halfspaces(C.part)
    return inner._replace(d=C.factor * inner.d, e=C.factor * inner.e)


@_found.register
def _(C: Negation) -> Halfspaces:
    inner = halfspaces(C.part)
    return inner._replace(N=-inner.N, E=-inner.E)


@_found.register
def _(C: Product) -> Halfspaces:
    parts = [halfspaces(part) for part in C.parts]
    return Halfspaces(
        scipy.linalg.block_diag(*(part.N for part in parts)),
        np.concatenate([part.d for part in parts]),
        scipy.linalg.block_diag(*(part.E for part in parts)),
        np.concatenate([part.e for part in parts]),
    )


@_found.register
def _(C: Ball) -> Halfspaces:
    if C.dim > 1:
        raise NoHalfspacesError(type(C).__name__)
    c, r = float(C.center[0]), C.radius
    return Halfspaces.below(np.array([[1.0], [-1.0]]), np.array([c + r, r - c]))


@_found.register
def _(C: Polytope) -> Halfspaces:
    """The facets of a hull, in its affine span where it is flat."""
    vertices, centre = C.vertices, C.vertices.mean(axis=0)
    _, extents, axes = np.linalg.svd(vertices - centre)
    flat = int((extents > FLAT * extents.max(initial=0.0)).sum())
    span, E = axes[:flat], axes[flat:]
    e = E @ centre
    if flat == 0:
        return Halfspaces(np.zeros((0, E.shape[1])), np.zeros(0), E, e)
    N, d = _hull((vertices - centre) @ span.T)
    return Halfspaces(N @ span, d + N @ span @ centre, E, e)


def _hull(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """N and d of the hull of points that is not flat."""
    dim = points.shape[1]
    if dim > HULL:
        raise NoHalfspacesError(
            f"a Polytope in {dim} dimensions, whose facets are not computed beyond {HULL}"
        )
    if dim == 1:
        return np.array([[1.0], [-1.0]]), np.array([points.max(), -points.min()])
    try:
        planes = ConvexHull(points / np.abs(points).max()).equations
    except QhullError as error:
        raise NoHalfspacesError("a Polytope whose facets are not found") from error
    N = planes[np.unique(planes.round(12), axis=0, return_index=True)[1], :-1]
    return N, (N @ points.T).max(axis=1)  # through the vertices to rounding
