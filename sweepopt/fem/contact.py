"""The contact boundary: which unknowns rub, how strongly, and where along the boundary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import skfem
from numpy.typing import NDArray

from sweepopt.errors import InputError
from sweepopt.fem.discretisation import Discretisation
from sweepopt.fem.fields import Datum
from sweepopt.fem.forms import edge_groups, friction_weights, refuse_overflow
from sweepopt.fem.mesh import Indices, cross, opposite
from sweepopt.sets import Box, ConvexSet, image

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Contact:
    """Unknowns with friction, in the order in which one walks along the boundary.

    Walked with the body on the left; pieces of a boundary follow one another. Clamped nodes and
    nodes with g = 0 are left out: there is nothing nonsmooth at them.

    Attributes
    ----------
    unknown : ndarray, shape (m,)
        Index of each among the unknowns of the problem.
    points : ndarray, shape (m, 2)
    boundary : ndarray of str, shape (m,)
        Name of the boundary it is on.
    arc : ndarray, shape (m,)
        Arc length from the start of that boundary.
    weight, bound : ndarray, shape (m,)
        w_k (a length) and g_k of ``J_h(v) = sum_k w_k g_k |v_k|``.
    """

    unknown: Indices
    points: Array
    boundary: NDArray[np.str_]
    arc: Array
    weight: Array
    bound: Array

    def __len__(self) -> int:
        return int(self.unknown.size)

    @property
    def threshold(self) -> Array:
        """Friction forces ``w_k g_k`` at which the nodes slip, shape (m,)."""
        return self.weight * self.bound

    def dissipation(self, dim: int) -> ConvexSet:
        """D = E^T [-w g, w g], E selecting the contact unknowns: J_h is its support function."""
        m = len(self)
        select = sp.csc_array((np.ones(m), (self.unknown, np.arange(m))), shape=(dim, m))
        return image(select, Box(-self.threshold, self.threshold))


def contact_on(body: Discretisation, on: Sequence[str], g: Datum) -> Contact:
    """Contact of the boundaries `on` with friction bound `g`.

    Raises
    ------
    InputError
        If all of it is clamped.
    """
    facets, weights, bounds = friction_weights(body, "g", on, g)
    nodes = _edge_nodes(body, facets)
    size = body.basis.N
    weight = np.bincount(nodes.ravel(), weights.ravel(), size)
    with np.errstate(over="ignore"):
        threshold = np.bincount(nodes.ravel(), (weights * bounds).ravel(), size)
    glued = np.bincount(nodes.ravel(), np.isinf(bounds).ravel(), size) > 0
    refuse_overflow("g", threshold[~glued])

    walks, arcs, names = [], [], []
    for name, mine in edge_groups(body, on, facets).items():
        order, forward = _walk(body.mesh, facets[mine])
        length = weights[mine[order]].sum(axis=1)
        along = np.where(forward[:, None], nodes[mine[order]], nodes[mine[order], ::-1])
        end = np.cumsum(length)
        walks.append(along.ravel())
        arcs.append(np.linspace(end - length, end, along.shape[1], axis=1).ravel())
        names.append(np.full(along.size, name))
    walk, arc, boundary = map(np.concatenate, (walks, arcs, names))

    _, first = np.unique(walk, return_index=True)
    rubbing = np.isin(walk, body.free) & (threshold[walk] > 0.0)
    keep = np.sort(first[rubbing[first]])
    k = walk[keep]
    if not np.any(np.isin(walk, body.free)):
        raise InputError(f"on: all of {', '.join(on)} is clamped; nothing can slip there")
    return Contact(
        unknown=np.searchsorted(body.free, k),
        points=body.points[k],
        boundary=boundary[keep],
        arc=arc[keep],
        weight=weight[k],
        bound=threshold[k] / weight[k],
    )


def _edge_nodes(body: Discretisation, facets: Indices) -> Indices:
    """Degrees of freedom of each edge, start, (middle,) end, shape (m, 2 or 3)."""
    start, end = body.basis.nodal_dofs[0, body.mesh.facets[:, facets]]
    middle = [body.basis.facet_dofs[0, facets]] if body.element == "P2" else []
    return np.stack([start, *middle, end], axis=1).astype(np.int64)


def _walk(mesh: skfem.MeshTri, facets: Indices) -> tuple[Indices, NDArray[np.bool_]]:
    """Order in which to walk boundary edges with the body on the left.

    Returns
    -------
    order : ndarray, shape (m,)
        Positions in `facets`: open pieces first, then closed ones from their largest x.
    forward : ndarray of bool, shape (m,)
        Whether the edge is walked from its first to its second node.
    """
    start, end = mesh.facets[:, facets].astype(np.int64)
    left = cross(mesh.p[:, end] - mesh.p[:, start], opposite(mesh, facets, 0) - mesh.p[:, start])
    forward = left > 0.0
    tail, head = np.where(forward, start, end), np.where(forward, end, start)
    leaving: dict[int, list[int]] = {}
    for k in range(facets.size):
        leaving.setdefault(int(tail[k]), []).append(k)
    open_ends = np.flatnonzero(~np.isin(tail, head))
    closed = np.lexsort((np.abs(mesh.p[1, tail]), -mesh.p[0, tail]))
    order: list[int] = []
    for k in np.concatenate([open_ends, closed]):
        at = int(tail[k])
        while leaving.get(at):
            order.append(leaving[at].pop(0))
            at = int(head[order[-1]])
    walked = np.array(order, dtype=np.int64)
    return walked, forward[walked]
