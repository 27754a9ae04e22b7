"""Triangle meshes with named boundaries and subdomains, checked before anything is assembled.

Files are read by meshio. What it, scikit-fem or a solver would meet as a singular matrix much later
(an element without area, a fold, crossed curved edges) is refused here, with its place. Triangles
of second order keep their curved edges (`MeshTri2`, isoparametric).
"""

from __future__ import annotations

import io
import threading
import warnings
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
LARGEST = 1e100
"""Coordinates beyond this overflow when they are squared and multiplied by a coefficient."""
NODES = {"vertex": 1, "line": 2, "line3": 3, "triangle": 3, "triangle6": 6}
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
    >>> from sweepopt.io import find_scene
    >>> sorted(read_mesh(find_scene("tube").with_suffix(".msh")).subdomains)
    ['core', 'sleeve']
    """
    path = as_path("path", path)
    try:
        return _mesh_of(_parsed(path))
    except InputError as error:
        raise InputError(f"mesh {path.name:.100}: {error}") from error


def check_mesh(mesh: skfem.MeshTri) -> None:
    """Refuse NaN nodes, triangles without area, overlaps and inside-out curved triangles.

    Raises
    ------
    InputError
        Naming the triangle (its number in the mesh) and where it is.
    """
    check_nodes(mesh.doflocs)
    edges = _edges_of_triangles(mesh)
    longest = np.max(np.sum(edges**2, axis=0), axis=0)
    _refuse_triangles(mesh, np.abs(np.linalg.det(edges.T)) <= FLAT * longest, "has no area")
    _, number, count = np.unique(sides(mesh), return_inverse=True, return_counts=True)
    most = count[number].reshape(mesh.t.shape).max(axis=0)
    _refuse_triangles(mesh, most > 1, "overlaps a neighbour")
    if isinstance(mesh, skfem.MeshTri2):
        # not by its `detDF`, which raises an error of its own where one is 0
        J, nodes = mesh.mapping().J, skfem.ElementTriP2.doflocs.T
        jacobian = J(0, 0, nodes) * J(1, 1, nodes) - J(0, 1, nodes) * J(1, 0, nodes)
        turned = jacobian.min(axis=1) * jacobian.max(axis=1) <= 0.0
        _refuse_triangles(mesh, turned, "is inverted: its curved edges cross")


def check_nodes(points: NDArray[np.float64]) -> None:
    """Refuse coordinates, shape (2 or 3, N), that are not numbers or overflow when squared."""
    bad = np.flatnonzero(~(np.abs(points) < LARGEST).all(axis=0))
    if bad.size:
        raise InputError(f"node {bad[0]} has coordinates {points[:, bad[0]]}; mesh again")


def sides(mesh: skfem.MeshTri) -> Indices:
    """Sides of all triangles as start * nvertices + end, the triangle on the left; shape (3, m).

    No side is there twice: two triangles on the same side of an edge overlap.
    """
    turned = np.linalg.det(_edges_of_triangles(mesh).T) < 0
    start = np.where(turned, mesh.t[::-1], mesh.t).astype(np.int64)
    return start * mesh.nvertices + np.roll(start, -1, axis=0)


def _edges_of_triangles(mesh: skfem.MeshTri) -> NDArray[np.float64]:
    """From the first corner of each triangle to the two others, shape (2, 2, m)."""
    corners = mesh.p[:, mesh.t]
    return np.asarray(corners[:, 1:] - corners[:, :1])


def _parsed(path: Path) -> meshio.Mesh:
    """What meshio reads, which neither prints nor ends the program here."""
    content = read_bytes(path)
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
    """The triangles of a file with its groups."""
    for kind, nodes in ((block.type, np.asarray(block.data)) for block in raw.cells):
        if kind not in NODES:
            raise InputError(f"only triangles are supported, not {kind}")
        if nodes.shape[1:] != (NODES[kind],):
            raise InputError("is damaged: a section has fewer numbers than it announces")
        if nodes.min(initial=0) < 0 or nodes.max(initial=0) >= len(raw.points):
            raise InputError("is damaged: an element names a node that is not in the file")
    cells = {kind: nodes for kind, nodes in raw.cells_dict.items() if len(nodes)}
    surface, line = ("triangle6", "line3") if "triangle6" in cells else ("triangle", "line")
    if surface not in cells:
        raise InputError("has no triangles; save the meshed surface in a physical group")
    if set(cells) - {surface, line, "vertex"}:
        raise InputError("mixes elements of first and second order; use one order")
    used = np.unique(cells[surface])
    mesh = _section(np.asarray(raw.points[used], float), np.searchsorted(used, cells[surface]))
    check_mesh(mesh)

    corners, lines = np.unique(cells[surface][:, :3]), cells.get(line, np.empty((0, 2), int))
    edges, wanted = (
        np.sort(pairs, axis=1).astype(np.int64) @ [len(raw.points), 1]
        for pairs in (corners[mesh.facets.T], lines[:, :2])
    )
    boundaries = _groups(raw, 1, line)
    for name, members in boundaries.items():
        if not np.isin(wanted[members], edges).all():
            raise InputError(f"physical curve {name!r} has a line that is no edge of a triangle")
        boundaries[name] = np.unique(np.searchsorted(edges, wanted[members]))
    return mesh.with_boundaries(boundaries).with_subdomains(_groups(raw, 2, surface))


def _section(points: NDArray[np.float64], triangles: Indices) -> skfem.MeshTri:
    """A mesh on points of a plane z = constant, of triangles with three or six nodes."""
    check_nodes(points.T)
    if np.any(np.ptp(points[:, 2:], axis=0) > 1e-9 * np.ptp(points[:, :2])):
        raise InputError("is not flat: z varies; the section must lie in a plane z = constant")
    nodes, t = np.ascontiguousarray(points[:, :2].T), np.ascontiguousarray(triangles.T)
    try:  # scikit-fem numbers the corners first, and keeps one middle of an edge
        mesh = (skfem.MeshTri2 if len(t) == 6 else skfem.MeshTri)(nodes, t)
        whole = np.array_equal(mesh.doflocs[:, mesh.dofs.element_dofs[3:]], nodes[:, t[3:]])
    except IndexError:  # or has fewer of them than edges
        whole = False
    if not whole:
        raise InputError("is damaged: the edges of its triangles have not one middle node each")
    return mesh


def _groups(raw: meshio.Mesh, dimension: int, kind: str) -> dict[str, Indices]:
    """Named groups of one dimension: positions among all elements of the kind.

    meshio has named groups as `cell_sets` or as numbers of the elements, whose names are in
    `field_data`; a number is negative where the elements are turned round.
    """
    groups = {
        name: sets[kind].astype(int)
        for name, sets in raw.cell_sets_dict.items()
        if kind in sets and not name.startswith("gmsh:")
    }
    names = {tuple(np.ravel(value)): name for name, value in raw.field_data.items()}
    for key in GROUPS:
        numbers = np.abs(raw.cell_data_dict.get(key, {}).get(kind, []))
        for number in np.setdiff1d(numbers, 0).tolist():
            name = names.get((number, dimension), str(number))
            groups.setdefault(name, np.flatnonzero(numbers == number))
    return groups


def _refuse_triangles(mesh: skfem.MeshTri, bad: NDArray[np.bool_], fault: str) -> None:
    if np.any(bad):
        k = int(np.flatnonzero(bad)[0])
        x, y = mesh.p[:, mesh.t[:, k]].mean(axis=1)
        more = f" (and {bad.sum() - 1} more)" if bad.sum() > 1 else ""
        raise InputError(f"triangle {k} near ({x:g}, {y:g}) {fault}{more}; repair the mesh")
