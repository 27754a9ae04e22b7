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

from sweepopt.checks import bounded
from sweepopt.errors import InputError
from sweepopt.io import as_path, read_bytes
from sweepopt.linalg import EPS

Indices = NDArray[np.int64]

FLAT = 1e-10
"""A height below this share of the longest edge is rounding: at 1e-11 a matrix of P2 elements in
thin strips is wrong by 1e-4."""
MESHES = {"triangle": skfem.MeshTri, "triangle6": skfem.MeshTri2}
"""Meshes by what meshio calls their triangles."""
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
    printed = io.StringIO()
    try:
        gmsh = (content := read_bytes(path)).startswith(b"$MeshFormat")
        if gmsh and b"$EndElements" not in content:  # meshio takes the elements up to there
            raise InputError("is cut short ($EndElements is missing); save it again")
        with OUTPUT, redirect_stdout(printed), redirect_stderr(printed), warnings.catch_warnings():
            # numpy only warns of words among numbers and of numbers out of range
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", "string or file could not be read")
            warnings.filterwarnings("error", category=RuntimeWarning)
            raw = meshio.read(path, file_format="gmsh" if gmsh else None)
        return _mesh_of(raw)
    except InputError as error:
        raise InputError(f"mesh {path.name:.100}: {error}") from error
    except (Exception, SystemExit) as error:  # meshio has no list of what it raises
        fault = " ".join(printed.getvalue().split()) or f"{type(error).__name__}: {error}"
        what = f"mesh {path.name:.100}: is damaged or no mesh that meshio can read"
        raise InputError(f"{what} ({fault:.200})") from error


def check_mesh(mesh: skfem.MeshTri) -> None:
    """Refuse NaN nodes, triangles without area, overlaps and inside-out curved triangles.

    Raises
    ------
    InputError
        Naming the triangle (its number in the mesh) and where it is.
    """
    bounded("nodes", mesh.doflocs.T, "finite coordinates")
    corners = mesh.p[:, mesh.t]
    edges = corners[:, 1:] - corners[:, :1]
    area, longest = np.linalg.det(edges.T), np.max(np.hypot(*edges), axis=0)
    rounding = 8 * EPS * np.abs(mesh.p).max()  # of a height, whose ends are rounded nodes
    flat = np.abs(area) <= np.maximum(FLAT * longest, rounding) * longest
    _refuse_triangles(mesh, flat, "has no area")
    # triangles to the left of their sides: two on the same side of an edge overlap
    start = np.where(area < 0, mesh.t[::-1], mesh.t).astype(np.int64)
    sides = start * mesh.nvertices + np.roll(start, -1, axis=0)
    _, number, count = np.unique(sides, return_inverse=True, return_counts=True)
    most = count[number].reshape(sides.shape).max(axis=0)
    _refuse_triangles(mesh, most > 1, "overlaps a neighbour")
    if isinstance(mesh, skfem.MeshTri2):
        # not by its `detDF`, which raises an error of its own where one is 0
        jacobian = np.linalg.det(mesh.mapping().DF(skfem.ElementTriP2.doflocs.T).T)
        turned = jacobian.min(axis=0) * jacobian.max(axis=0) <= 0.0
        _refuse_triangles(mesh, turned, "is inverted: its curved edges cross")


def _mesh_of(raw: meshio.Mesh) -> skfem.MeshTri:
    """The triangles of a file with its groups."""
    cells = {kind: nodes for kind, nodes in raw.cells_dict.items() if len(nodes)}
    surface, line = ("triangle6", "line3") if "triangle6" in cells else ("triangle", "line")
    if others := set(cells) - {surface, line, "vertex"}:
        raise InputError(f"only triangles of one order are supported, not {', '.join(others)}")
    if surface not in cells:
        raise InputError("has no triangles; save the meshed surface in a physical group")
    used = np.unique(cells[surface])
    if used[0] < 0 or used[-1] >= len(raw.points):
        raise InputError("is damaged: an element names a node that is not in the file")
    points, t = np.asarray(raw.points[used], float), np.searchsorted(used, cells[surface])
    bounded("nodes", points, "finite coordinates")
    if np.any(np.ptp(points[:, 2:], axis=0) > 1e-9 * np.ptp(points[:, :2])):
        raise InputError("is not flat: z varies; the section must lie in a plane z = constant")
    nodes = np.ascontiguousarray(points[:, :2].T)
    mesh = MESHES[surface](nodes, np.ascontiguousarray(t.T))
    # scikit-fem keeps one middle of an edge
    if not np.array_equal(mesh.doflocs[:, mesh.dofs.element_dofs[3:]], nodes[:, t.T[3:]]):
        raise InputError("is damaged: the edges of its triangles have not one middle node each")
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
        k = int(np.argmax(bad))
        x, y = mesh.p[:, mesh.t[:, k]].mean(axis=1)
        raise InputError(f"triangle {k} near ({x:g}, {y:g}) {fault}; repair the mesh")
