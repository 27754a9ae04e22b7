"""Triangle meshes with named boundaries and subdomains, checked before anything is assembled.

Second-order triangles keep their curved edges (`MeshTri2`, isoparametric). What scikit-fem or a
solver would meet as a singular matrix much later (an element without area, a fold, a piece that
nothing holds) is refused here, with its place.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import skfem
from numpy.typing import NDArray

from sweepopt.errors import InputError
from sweepopt.fem.gmsh import Gmsh, read_gmsh
from sweepopt.io import as_path, read_bytes

Indices = NDArray[np.int64]

FLAT = 1e-10
"""An area below this share of the square of the longest edge is no triangle."""
LINES = ("line", "line3")
HUGE = 1e100
"""Coordinates beyond this overflow when they are squared."""


def read_mesh(path: str | Path) -> skfem.MeshTri:
    """Read a Gmsh ``.msh`` file (2.2 or 4.1) of triangles of first or second order.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    skfem.MeshTri
        `MeshTri2` for six-node triangles. Physical curves and surfaces are its boundaries and
        subdomains, by name; a group without a name is called by its number.

    Raises
    ------
    InputError
        If the file is not such a mesh; the message names the file and the fault.

    Examples
    --------
    >>> from sweepopt.library import find_problem
    >>> sorted(read_mesh(find_problem("tube").with_suffix(".msh")).subdomains)
    ['core', 'sleeve']
    """
    path = as_path("path", path)
    try:
        return _build(read_gmsh(read_bytes(path)))
    except InputError as error:
        where = "" if str(error).startswith(str(path)) else f"{path}: "
        raise InputError(f"{where}{error}") from error


def check_mesh(mesh: skfem.MeshTri) -> None:
    """Refuse NaN nodes, triangles without area, folds and inside-out curved triangles.

    Raises
    ------
    InputError
        Naming the triangle (its number in the mesh) and where it is.
    """
    check_nodes(mesh.doflocs)
    corners = mesh.p[:, mesh.t]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    longest = np.maximum(np.sum(first**2, axis=0), np.sum(second**2, axis=0))
    _refuse_triangles(mesh, np.abs(cross(first, second)) <= FLAT * longest, "has no area")

    shared = np.bincount(mesh.t2f.ravel(), minlength=mesh.nfacets)
    _refuse_triangles(mesh, np.any(shared[mesh.t2f] > 2, axis=0), "shares an edge with two others")
    inner = np.flatnonzero(mesh.f2t[1] >= 0)
    start, end = mesh.p[:, mesh.facets[:, inner]].swapaxes(0, 1)
    sides = [cross(end - start, opposite(mesh, inner, k) - start) for k in (0, 1)]
    folded = np.zeros(mesh.nelements, dtype=bool)
    folded[mesh.f2t[1, inner[sides[0] * sides[1] > 0.0]]] = True
    _refuse_triangles(mesh, folded, "is inverted: it overlaps a neighbour")

    if isinstance(mesh, skfem.MeshTri2):
        # not by its `detDF`, which raises an error of its own where one is 0
        J, nodes = mesh.mapping().J, skfem.ElementTriP2.doflocs.T
        jacobian = J(0, 0, nodes) * J(1, 1, nodes) - J(0, 1, nodes) * J(1, 0, nodes)
        turned = jacobian.min(axis=1) * jacobian.max(axis=1) <= 0.0
        _refuse_triangles(mesh, turned, "is inverted: its curved edges cross")


def check_nodes(points: NDArray[np.float64]) -> None:
    """Refuse coordinates, shape (2 or 3, N), that are not numbers or overflow when squared."""
    bad = np.flatnonzero(~(np.abs(points) < HUGE).all(axis=0))
    if bad.size:
        raise InputError(f"node {bad[0]} has coordinates {points[:, bad[0]]}; mesh again")


def group(groups: Mapping[str, Any] | None, name: str, what: str) -> Indices:
    """Members of a named group of edges or triangles, or an error that lists the names."""
    known = groups or {}
    if name not in known:
        names = ", ".join(sorted(known)) or "none (give the mesh physical groups)"
        raise InputError(f"{name!r} is not a {what} of the mesh; there are: {names}")
    return np.asarray(known[name], dtype=np.int64)


def _build(raw: Gmsh) -> skfem.MeshTri:
    surfaces = {block.kind for block in raw.blocks if len(block.nodes)} & {"triangle", "triangle6"}
    if not surfaces:
        raise InputError("has no triangles; save the meshed surface in a physical group")
    if len(surfaces) == 2:
        raise InputError("mixes triangles of first and second order; use one order")
    (kind,) = surfaces
    points = raw.points
    cells = np.vstack([block.nodes for block in raw.blocks if block.kind == kind])
    used = np.unique(cells)
    check_nodes(points[used].T)
    if np.ptp(points[used, 2]) > 1e-9 * np.ptp(points[used, :2]):
        raise InputError("is not flat: z varies; the section must lie in a plane z = constant")
    if kind == "triangle6":
        _require_middles(cells)
    # corners first, as scikit-fem numbers them; nodes of no triangle are dropped
    corners = np.unique(cells[:, :3])
    number = np.full(len(points), -1)
    number[corners] = np.arange(corners.size)
    middle = np.setdiff1d(used, corners)
    number[middle] = corners.size + np.arange(middle.size)
    xy = np.ascontiguousarray(points[np.concatenate([corners, middle]), :2].T)
    t = np.ascontiguousarray(number[cells].T)
    mesh = skfem.MeshTri2(xy, t) if kind == "triangle6" else skfem.MeshTri(xy, t)
    check_mesh(mesh)

    lines = [block.nodes[:, :2] for block in raw.blocks if block.kind in LINES]
    edges = number[np.vstack(lines)] if lines else np.empty((0, 2), dtype=int)
    boundaries = {
        name: _facets(mesh, edges[members], name)
        for name, members in _groups(raw, 1, LINES).items()
    }
    return mesh.with_boundaries(boundaries).with_subdomains(_groups(raw, 2, (kind,)))


def _require_middles(cells: Indices) -> None:
    """Refuse six-node triangles unless each edge has one middle node, and that no other edge."""
    edges = np.sort(np.vstack([cells[:, [0, 1]], cells[:, [1, 2]], cells[:, [2, 0]]]), axis=1)
    middles = cells[:, 3:].T.ravel()
    both = np.column_stack([edges, middles])
    counts = {len(np.unique(one, axis=0)) for one in (edges, middles, both)}
    if len(counts) > 1 or np.isin(middles, cells[:, :3]).any():
        raise InputError("is damaged: the edges of its triangles have not one middle node each")


def _groups(raw: Gmsh, dimension: int, kinds: tuple[str, ...]) -> dict[str, Indices]:
    """Physical groups of one dimension: name -> indices into the blocks of `kinds`, joined."""
    found: dict[str, list[Indices]] = {}
    offset = 0
    for block in raw.blocks:
        if block.kind not in kinds:
            continue
        for number in np.unique(block.groups[block.groups != 0]).tolist():
            members = offset + np.flatnonzero((block.groups == number).any(axis=1))
            found.setdefault(raw.names.get((dimension, number), str(number)), []).append(members)
        offset += len(block.nodes)
    return {name: np.unique(np.concatenate(members)) for name, members in found.items()}


def _facets(mesh: skfem.MeshTri, edges: Indices, name: str) -> Indices:
    """Edge numbers of the mesh for pairs of nodes."""
    pairs = np.sort(edges, axis=1)
    keys = mesh.facets[0].astype(np.int64) * mesh.nvertices + mesh.facets[1]
    wanted = pairs[:, 0] * mesh.nvertices + pairs[:, 1]
    order = np.argsort(keys)
    at = np.minimum(np.searchsorted(keys, wanted, sorter=order), keys.size - 1)
    facets = order[at]
    if np.any(pairs < 0) or np.any(keys[facets] != wanted):
        raise InputError(f"physical curve {name!r} has a line that is no edge of a triangle")
    return np.asarray(np.unique(facets))


def _refuse_triangles(mesh: skfem.MeshTri, bad: NDArray[np.bool_], fault: str) -> None:
    if np.any(bad):
        k = int(np.flatnonzero(bad)[0])
        x, y = mesh.p[:, mesh.t[:, k]].mean(axis=1)
        more = f" (and {bad.sum() - 1} more)" if bad.sum() > 1 else ""
        raise InputError(f"triangle {k} near ({x:g}, {y:g}) {fault}{more}; repair the mesh")


def opposite(mesh: skfem.MeshTri, facets: Indices, side: int) -> NDArray[np.float64]:
    """The corner of a facet's triangle that is not on the facet, shape (2, k)."""
    corners = mesh.t[:, mesh.f2t[side, facets]]
    other = corners.sum(axis=0) - mesh.facets[:, facets].sum(axis=0)
    return np.asarray(mesh.p[:, other])


def cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """``a_x b_y - a_y b_x``: positive if b points to the left of a."""
    return np.asarray(a[0] * b[1] - a[1] * b[0])
