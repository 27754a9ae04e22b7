"""Rows of the sets that are polyhedra: C = { w : N w <= d, E w = e }."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.linalg
from scipy.spatial import ConvexHull, QhullError

from sweepopt.linalg import dense
from sweepopt.sets import Ball, ConvexSet, Polytope
from sweepopt.sets.algebra import Negation, Scaling, Translation
from sweepopt.sets.product import Product

FLAT = 1e-12  # extent, relative to the largest one, below which a polytope is flat
HULL = 8  # dimensions up to which a hull is computed


class Halfspaces(NamedTuple):
    """N w <= d and E w = e."""

    N: np.ndarray
    d: np.ndarray
    E: np.ndarray
    e: np.ndarray


def halfspaces(C: ConvexSet) -> Halfspaces | str:
    """The rows of a set, or the name of the part that has none."""
    dim = C.dim
    if C.singleton:
        return Halfspaces(np.zeros((0, dim)), np.zeros(0), np.eye(dim), C.anchor)
    found = C.rows()
    if found is not None:
        G, h = dense(found[0]), found[1]
        return Halfspaces(G, h, np.zeros((0, dim)), np.zeros(0))
    if isinstance(C, (Translation, Scaling, Negation)):
        inner = halfspaces(C.part)
        if isinstance(inner, str):
            return inner
        if isinstance(C, Negation):
            return inner._replace(N=-inner.N, E=-inner.E)
        if isinstance(C, Scaling):
            return inner._replace(d=C.factor * inner.d, e=C.factor * inner.e)
        return inner._replace(d=inner.d + inner.N @ C.v, e=inner.e + inner.E @ C.v)
    if isinstance(C, Product):
        return _product(C)
    if isinstance(C, Polytope):
        return _facets(C.vertices)
    if isinstance(C, Ball) and dim == 1:
        c, r = float(C.center[0]), C.radius
        return Halfspaces(np.array([[1.0], [-1.0]]), np.array([c + r, r - c]),
                          np.zeros((0, 1)), np.zeros(0))  # fmt: skip
    selection = C.selection
    if selection is None:
        return type(C).__name__
    inner = halfspaces(selection.part)
    if isinstance(inner, str):
        return inner
    unit = np.eye(dim)
    few, rest = unit[selection.unknowns], np.delete(unit, selection.unknowns, axis=0)
    shift = np.zeros(dim) if selection.shift is None else selection.shift
    N, E = inner.N @ few, np.vstack([inner.E @ few, rest])
    e = np.concatenate([inner.e, np.zeros(len(rest))])
    return Halfspaces(N, inner.d + N @ shift, E, e + E @ shift)


def _product(C: Product) -> Halfspaces | str:
    parts = []
    for part in C.parts:
        found = halfspaces(part)
        if isinstance(found, str):
            return found
        parts.append(found)
    return Halfspaces(
        scipy.linalg.block_diag(*(part.N for part in parts)),
        np.concatenate([part.d for part in parts]),
        scipy.linalg.block_diag(*(part.E for part in parts)),
        np.concatenate([part.e for part in parts]),
    )


def _facets(vertices: np.ndarray) -> Halfspaces | str:
    """The facets of a hull, in its affine span where it is flat."""
    centre = vertices.mean(axis=0)
    _, extents, axes = np.linalg.svd(vertices - centre)
    flat = int((extents > FLAT * extents.max(initial=0.0)).sum())
    span, E = axes[:flat], axes[flat:]
    e = E @ centre
    if flat == 0:
        return Halfspaces(np.zeros((0, E.shape[1])), np.zeros(0), E, e)
    if flat > HULL:
        return f"a Polytope in {flat} dimensions, whose facets are not computed beyond {HULL}"
    inner = (vertices - centre) @ span.T
    if flat == 1:
        N, d = np.array([[1.0], [-1.0]]), np.array([inner.max(), -inner.min()])
    else:
        size = np.abs(inner).max()
        try:
            planes = ConvexHull(inner / size).equations
        except QhullError:
            return "a Polytope whose facets are not found"
        planes = planes[np.unique(planes.round(12), axis=0, return_index=True)[1]]
        N = planes[:, :-1]
        d = (N @ inner.T).max(axis=1)  # through the vertices to rounding
    return Halfspaces(N @ span, d + N @ span @ centre, E, e)
