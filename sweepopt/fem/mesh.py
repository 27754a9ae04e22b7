"""Triangle meshes with named boundaries and subdomains, checked before anything is assembled.

Files are read by meshio. What it, scikit-fem or a solver would meet as a singular matrix much later
(an element without area, a fold, crossed curved edges) is refused here, with its place. Triangles
of second order keep their curved edges (`MeshTri2`, isoparametric).
"""

from __future__ import annotations

import io
import threading
import warnings
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import meshio
import numpy as np
import skfem
from numpy.typing import NDArray

from sweepopt.errors import InputError
from sweepopt.io import as_path, read_bytes

Indices = NDArray[np.int64]

FLAT = 1e-10
"""An area below this share of the square of the longest edge is rounding, no triangle."""
HUGE = 1e100
"""Coordinates beyond this overflow when they are squared and multiplied by a coefficient."""
CORNERS = {"vertex": 1, "line": 2, "line3": 3, "triangle": 3, "triangle6": 6}
"""Elements that a mesh of a section may have, and their numbers of nodes."""
GROUPS = ("gmsh:physical", "medit:ref")
"""What meshio calls the number of an element's group; 0 is none."""
OUTPUT = threading.Lock()
"""Held while the output of meshio is caught: there is one stdout for all threads."""


def read_mesh(path: str | Path) -> skfem.MeshTri:
    """Read a mesh of triangles of first or second order.

    Parameters
    ----------
    path : str or Path
        Gmsh (``.msh``, 2.2 or 4.1) or another format that meshio knows by its suffix.

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
    >>> from sweepopt.io import find_problem
    >>> sorted(read_mesh(find_problem("tube").with_suffix(".msh")).subdomains)
    ['core', 'sleeve']
    """
    path = as_path("path", path)
    content = read_bytes(path)
    try:
        return _mesh_of(_parsed(path, content))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


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


def _parsed(path: Path, content: bytes) -> meshio.Mesh:
    """What meshio reads, which neither prints nor ends the program here."""
    gmsh = content.startswith(b"$MeshFormat")
    if gmsh and b"$EndElements" not in content:  # meshio takes the elements up to there
        raise InputError("is cut short ($EndElements is missing); save it again")
    printed = io.StringIO()
    try:
        with (
            OUTPUT,
            redirect_stdout(printed),
            redirect_stderr(printed),
            warnings.catch_warnings(),
        ):
            # numpy only warns of words among numbers and of numbers out of range
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", "string or file could not be read")
            warnings.filterwarnings("error", category=RuntimeWarning)
            return meshio.read(path, file_format="gmsh" if gmsh else None)
    except (Exception, SystemExit) as error:
        fault = " ".join(printed.getvalue().split()) or f"{type(error).__name__}: {error}"
        raise InputError(f"is damaged or no mesh that meshio can read ({fault:.200})") from error


def _mesh_of(raw: meshio.Mesh) -> skfem.MeshTri:
    blocks = [block for block in raw.cells if len(block.data)]
    kinds = {block.type for block in blocks}
    if foreign := sorted(kinds - set(CORNERS)):
        raise InputError(f"only triangles are supported, not {foreign[0]}")
    for block in blocks:
        nodes = np.asarray(block.data)
        if nodes.shape[1:] != (CORNERS[block.type],):
            raise InputError("is damaged: a section has fewer numbers than it announces")
        if nodes.min() < 0 or nodes.max() >= len(raw.points):
            raise InputError("is damaged: an element names a node that is not in the file")
    surfaces = sorted(kinds & {"triangle", "triangle6"})
    if not surfaces:
        raise InputError("has no triangles; save the meshed surface in a physical group")
    if len(surfaces) == 2:
        raise InputError("mixes triangles of first and second order; use one order")
    points = np.asarray(raw.points, dtype=float)
    cells = np.vstack([block.data for block in blocks if block.type == surfaces[0]])
    used = np.unique(cells)
    check_nodes(points[used].T)
    thickness = np.ptp(points[used, 2:], axis=0).max(initial=0.0)  # of a file with two or three
    if thickness > 1e-9 * np.ptp(points[used, :2]):
        raise InputError("is not flat: z varies; the section must lie in a plane z = constant")
    curved = surfaces == ["triangle6"]
    if curved:
        _require_middles(cells)
    # corners first, as scikit-fem numbers them; nodes of no triangle are dropped
    corners = np.unique(cells[:, :3])
    middle = np.setdiff1d(used, corners)
    number = np.full(len(points), -1)
    number[corners] = np.arange(corners.size)
    number[middle] = corners.size + np.arange(middle.size)
    xy = np.ascontiguousarray(points[np.concatenate([corners, middle]), :2].T)
    t = np.ascontiguousarray(number[cells].T)
    mesh = skfem.MeshTri2(xy, t) if curved else skfem.MeshTri(xy, t)
    check_mesh(mesh)

    lines = [block.data[:, :2] for block in blocks if block.type in ("line", "line3")]
    edges = number[np.vstack(lines)] if lines else np.empty((0, 2), dtype=int)
    boundaries = {
        name: _facets(mesh, edges[members], name)
        for name, members in _groups(raw, 1, ("line", "line3")).items()
    }
    return mesh.with_boundaries(boundaries).with_subdomains(_groups(raw, 2, surfaces))


def _require_middles(cells: Indices) -> None:
    """Refuse six-node triangles unless each edge has one middle node, and that no other edge."""
    edges = np.sort(np.vstack([cells[:, [0, 1]], cells[:, [1, 2]], cells[:, [2, 0]]]), axis=1)
    middles = cells[:, 3:].T.ravel()
    both = np.column_stack([edges, middles])
    counts = {len(np.unique(one, axis=0)) for one in (edges, middles, both)}
    if len(counts) > 1 or np.isin(middles, cells[:, :3]).any():
        raise InputError("is damaged: the edges of its triangles have not one middle node each")


def _groups(raw: meshio.Mesh, dimension: int, kinds: Sequence[str]) -> dict[str, Indices]:
    """Named groups of one dimension: positions among all elements of these kinds.

    meshio has named groups as `cell_sets` or as numbers of the elements, whose names are in
    `field_data`; a number is negative where the elements are turned round.
    """
    names = {
        (value[1], value[0]): name
        for name, value in raw.field_data.items()
        if np.shape(value) == (2,)
    }
    found: dict[str, list[Indices]] = {}
    offset = 0
    for k, block in enumerate(raw.cells):
        if block.type not in kinds:
            continue
        members = {
            name: np.asarray(sets[k], dtype=np.int64)
            for name, sets in raw.cell_sets.items()
            if not name.startswith("gmsh:")
        }
        for numbers in (np.abs(raw.cell_data[key][k]) for key in GROUPS if key in raw.cell_data):
            for number in np.unique(numbers[numbers != 0]).tolist():
                name = names.get((dimension, number), str(number))
                members[name] = np.union1d(
                    members.get(name, np.empty(0, np.int64)), np.flatnonzero(numbers == number)
                )
        for name, positions in members.items():
            if positions.size:
                found.setdefault(name, []).append(offset + positions)
        offset += len(block.data)
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
