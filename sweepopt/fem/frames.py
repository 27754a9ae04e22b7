"""Directions of the degrees of freedom at each node: those that are held, the normal, the tangents.

At most nodes they are x, y and z. Where components are held, or unknowns are turned, Gram and
Schmidt's method makes an orthonormal basis of the node from the directions that are held, the
normals, and the axes, in this order; `T` has these bases as blocks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy.sparse as sp

from sweepopt.fem.mesh import sparse_matrix

if TYPE_CHECKING:
    from sweepopt.fem.fields import Array, Indices
    from sweepopt.fem.spaces import Discretisation

AXES = "xyz"
PARALLEL = 1e-6
"""Sine of an angle below which directions are parallel: normals of facets have rounding errors."""
SMOOTH = 0.5
"""Sine of the angle between normals below which boundaries are a smooth one: a curved boundary of
two names is no corner, and a circle has more than twelve facets."""


class Frame(NamedTuple):
    """What the degrees of freedom of a body are.

    Attributes
    ----------
    T : sparse, shape (n, n)
        Orthogonal: the values along x, y, z are T times those along the directions of the nodes.
    basis : ndarray, shape (N, d, d)
        The directions of each node.
    held : ndarray of int, shape (N,)
        How many directions of each node are held; they come first.
    normal : ndarray of bool, shape (N,)
        Whether the next one is the normal, of a node that is turned.
    """

    T: sp.csr_array
    basis: Array
    held: Indices
    normal: Array


def held_directions(body: Discretisation) -> Iterator[tuple[str, Indices, Array]]:
    """Of each component that is held on a boundary the name, the nodes, and its directions.

    Normals of a smooth boundary of several names are those of the first. At the tip of a wedge
    normals are opposite, not close: through a tip that one of them leaves free the body would flow.
    """
    axes, walls = np.eye(body.components), np.zeros_like(body.points)
    all_held = dict.fromkeys(body.clamped or (), AXES[: body.components])
    for name, what in [*all_held.items(), *body.held.items()]:
        nodes, normals = normals_at(body, [name])
        apart = (walls[nodes] * normals).sum(axis=1) <= np.sqrt(1 - SMOOTH**2)
        walls[nodes[apart]] = normals[apart]
        for letter in what:
            yield name, nodes, walls[nodes] if letter == "n" else axes[AXES.index(letter)]


def frame_of(body: Discretisation) -> Frame:
    """The frame of a body with components held on boundaries."""
    size, d = body.scalar.N, body.components
    count, normal = np.zeros(size, dtype=np.int64), np.zeros(size, dtype=bool)
    basis = np.zeros((size, d, d))

    def add(nodes: Indices, directions: Array, least: float = PARALLEL) -> None:
        """Make a direction of each node orthogonal to those before, and append what is left."""
        old, directions = basis[nodes], np.broadcast_to(directions, (len(nodes), d))
        for _ in range(2):
            along = np.einsum("ksi,ki->ks", old, directions)
            directions = directions - np.einsum("ksi,ks->ki", old, along)
        length = np.linalg.norm(directions, axis=1)
        new = (length > least) & (count[nodes] < d)
        basis[nodes[new], count[nodes[new]]] = directions[new] / length[new, None]
        count[nodes[new]] += 1

    for _, nodes, directions in held_directions(body):
        add(nodes, directions)
    fixed = count.copy()
    for names in body.turned if d > 1 else ():
        nodes, normals = normals_at(body, names)
        add(nodes, normals)
        normal[nodes] = count[nodes] > fixed[nodes]
    for axis in np.eye(d):  # some is sqrt(1/3) away from the span of fewer than d others
        add(np.arange(size), axis, least=0.5)
    dofs = body.nodes.T  # node, direction
    T = sparse_matrix(basis, dofs[:, None, :], dofs[:, :, None], (dofs.size, dofs.size))
    T.eliminate_zeros()
    return Frame(T, basis, fixed, normal)


def normals_at(body: Discretisation, names: Sequence[str]) -> tuple[Indices, Array]:
    """The nodes of boundaries, each with the mean outward normal, weighted by the facets' sizes."""
    basis, _, nodes = body.on_boundary(names, nodal=True)
    weighted = basis.normals * basis.dx.sum(axis=1)[None, :, None]
    sums = np.array([np.bincount(nodes.T.ravel(), x.ravel()) for x in weighted]).T
    nodes = np.unique(nodes)
    normals = sums[nodes] / np.linalg.norm(sums[nodes], axis=1, keepdims=True)
    return nodes, np.where(np.abs(normals) < 1e-14, 0.0, normals)  # so that axes are met exactly
