"""Meshes with named boundaries and subdomains, checked before anything is assembled.

Files are read by meshio. What it, scikit-fem or a solver would meet as a singular matrix much later
(an element without area, a fold, crossed curved edges) is refused here, with its place. Triangles
of second order keep their curved edges (`MeshTri2`, isoparametric); tetrahedra have straight ones.
"""

import io
import threading
import warnings
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from math import factorial, prod
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import scipy.sparse as sp
import skfem

from sweepopt.checks import at_path, bounded, count, listed, number
from sweepopt.errors import InputError, shown
from sweepopt.fem.fields import Array, Coefficient, Indices
from sweepopt.fem.mesh_groups import group_entities, read_abaqus
from sweepopt.io import as_path, read_bytes
from sweepopt.linalg import EPS

LEAST_AREA = 1e-10
"""A height below this share of the longest edge is rounding: at 1e-11 a matrix of P2 elements in
thin strips is wrong by 1e-4."""
MESHES = {
    "tetra": (skfem.MeshTet, "triangle"),
    "triangle6": (skfem.MeshTri2, "line3"),
    "triangle": (skfem.MeshTri, "line"),
    "line": (skfem.MeshLine, "vertex"),
}
"""Classes of meshes and the kind of their facets, by the kind of their cells in meshio's names.

The first kind of which a file has cells is that of the body."""
SIDES = (("left", "right"), ("bottom", "top"), ("front", "back"))
"""Names of the ends of a grid along x, y and z."""
MOST_CELLS = 10_000_000
"""Of a mesh that is refined or made: ten times those of the largest runs that were measured."""
CELLS = {1: "intervals", 2: "triangles", 3: "tetrahedra"}
OUTPUT = threading.Lock()
"""Held while the output of meshio is caught: there is one stdout for all threads."""


def grid(
    sizes: Sequence[float],
    cells: Sequence[int],
    points: Sequence[str] | None = None,
) -> skfem.Mesh:
    """An interval, a rectangle of triangles or a box of tetrahedra in equal cells, or its image.

    Parameters
    ----------
    sizes : sequence of float, shape (d,)
        Lengths along x, y and z.
    cells : sequence of int, shape (d,)
        How many along each; a rectangle is cut in two triangles, a box in six tetrahedra.
    points : sequence of str, shape (d,), optional
        Where its points, from 0 to the sizes, go: formulas in x, y and z, which move, grade or bend
        it.

    Returns
    -------
    skfem.Mesh
        With the boundaries left and right (along x), bottom and top (y), front and back (z).

    Raises
    ------
    InputError
        If the lengths are not one to three numbers > 0, or the others are not as many, or a
        formula has no finite value.

    Examples
    --------
    >>> sorted(grid([2.0, 1.0], [4, 2]).boundaries)
    ['bottom', 'left', 'right', 'top']
    >>> grid([1.0], [4], points=["x**2"]).p.round(4).tolist()
    [[0.0, 0.0625, 0.25, 0.5625, 1.0]]
    """
    lengths, counts = listed("sizes", sizes, number, 0.0, True), listed("cells", cells, count)
    if not len(lengths) == len(counts) <= len(SIDES):
        raise InputError(
            f"sizes and cells must have one entry for each of x, y, z, got {len(lengths)} and "
            f"{len(counts)}"
        )
    if prod(counts) * factorial(len(counts)) > MOST_CELLS:
        raise InputError(
            f"cells: {shown(counts)} make more than {MOST_CELLS:.0e} cells; take fewer"
        )
    lines = [np.linspace(0.0, size, n + 1) for size, n in zip(lengths, counts, strict=True)]
    mesh = (skfem.MeshLine, skfem.MeshTri, skfem.MeshTet)[len(lines) - 1].init_tensor(*lines)
    boundaries = {}
    for k, line in enumerate(lines):
        for name, end in zip(SIDES[k], line[[0, -1]], strict=True):
            boundaries[name] = np.flatnonzero((mesh.p[k, mesh.facets] == end).all(axis=0))
    if points is not None:
        if len(listed("points", points)) != len(lines):
            raise InputError(f"points must be {len(lines)} formulas, one for each of x, y, z")
        places = [Coefficient(f"points[{k}]").values(one, mesh.p) for k, one in enumerate(points)]
        mesh = type(mesh)(np.array(places), mesh.t)
    return mesh.with_boundaries(boundaries)


def chain(nodes: int) -> skfem.Mesh:
    """Nodes at x = 0, 1, 2, ... with an edge from each to the next, for a lumped model.

    Returns
    -------
    skfem.Mesh
        With the boundaries left and right.

    Examples
    --------
    >>> chain(3).p
    array([[0., 1., 2.]])
    """
    edges = count("nodes", nodes, 2, MOST_CELLS, "take fewer") - 1
    return grid([edges], [edges])


def read_mesh(path: str | Path) -> skfem.Mesh:
    """Read a mesh of intervals, triangles of first or second order, or straight tetrahedra.

    Parameters
    ----------
    path : str or Path
        Gmsh (``.msh``, 2.2 or 4.1), or another format that meshio knows by its suffix, such as
        VTU (``.vtu``) and Abaqus (``.inp``).

    Returns
    -------
    skfem.Mesh
        `MeshTri2` for six-node triangles. Physical groups, or sets of elements, of facets and cells
        are its boundaries and subdomains, by name, and so are sets of all nodes of outer facets; a
        group without a name is called by its number.
        VTU files have such numbers of their cells and facets in cell data "gmsh:physical".

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
    with at_path("mesh "):
        content = read_bytes(path)
    printed, where = io.StringIO(), f"mesh {path.name:.100}: "
    try:
        gmsh = content.startswith(b"$MeshFormat")
        if gmsh and b"$EndElements" not in content:  # meshio takes the elements up to there
            raise InputError("is cut short ($EndElements is missing); save it again")
        with OUTPUT, redirect_stdout(printed), redirect_stderr(printed), warnings.catch_warnings():
            # numpy only warns of words among numbers and of numbers out of range
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", "string or file could not be read")
            warnings.filterwarnings("error", category=RuntimeWarning)
            abaqus = path.suffix.lower() == ".inp"
            raw = read_abaqus(content) if abaqus else meshio.read(path, "gmsh" if gmsh else None)
        if gmsh and b"\n$Entities" in content:
            group_entities(raw, content)
        _, _, names = content.partition(b"$PhysicalNames")  # their number, then each
        if gmsh and names and int(names.split(None, 1)[0]) > len(raw.field_data):
            raise InputError(
                "has physical groups of one name, of which only the last could be found; give each "
                "a name of its own, or make them one group"
            )
        return _mesh_of(raw)
    except InputError as error:
        raise InputError(f"{where}{error}") from None
    except (Exception, SystemExit) as error:  # meshio has no list of what it raises
        fault = " ".join(printed.getvalue().split()) or f"{type(error).__name__}: {error}"
        what = "is damaged or no mesh that meshio can read, such as .msh"
        if "gmsh:physical" in fault:
            what = "has elements in no physical group (Mesh.SaveAll = 1)"
        raise InputError(f"{where}{what} ({fault:.200})") from None


def check_mesh(mesh: skfem.Mesh) -> None:
    """Refuse nodes that are NaN or in no cell, and cells without area, doubled or inside out.

    Raises
    ------
    InputError
        Naming the cell (its number in the mesh) and where it is, or another kind of mesh.
    """
    if not isinstance(mesh, (skfem.MeshLine, skfem.MeshTri, skfem.MeshTet)):
        raise InputError(
            f"must have intervals, triangles or tetrahedra, not be a {type(mesh).__name__}"
        )
    bounded("nodes", mesh.doflocs.T, "finite coordinates")
    if (alone := np.setdiff1d(np.arange(mesh.t.max()), mesh.t)).size:
        where = coordinates(mesh.p[:, alone[0]])
        raise InputError(
            f"node {alone[0]} at {where} is in no cell; give mesh.remove_unused_nodes()"
        )
    corners = mesh.p[:, mesh.t]
    edges = corners[:, 1:] - corners[:, :1]
    area, longest = np.linalg.det(edges.T), np.linalg.norm(edges, axis=0).max(axis=0)
    rounding = 8 * EPS * np.abs(mesh.p).max()  # of a height, whose ends are rounded nodes
    least = np.maximum(LEAST_AREA * longest, rounding) * longest ** (mesh.dim() - 1)
    _refuse_cells(mesh, np.abs(area) <= least, "has no area")
    # a facet has one cell at most on each of its sides: two of them overlap
    facet = mesh.t2f
    apex = mesh.t.sum(axis=0) - mesh.facets.sum(axis=0)[facet]
    ends = np.concatenate([mesh.facets[:, facet], apex[None]])
    side = np.linalg.det((mesh.p[:, ends[1:]] - mesh.p[:, ends[:1]]).T).T > 0.0
    _, number, count = np.unique(2 * facet + side, return_inverse=True, return_counts=True)
    most = count[number].max(axis=0)
    _refuse_cells(mesh, most > 1, "overlaps a neighbour or is there twice")
    if isinstance(mesh, skfem.MeshTri2):
        # not by its `detDF`, which raises an error of its own where one is 0
        jacobian = np.linalg.det(mesh.mapping().DF(skfem.ElementTriP2.doflocs.T).T)
        turned = jacobian.min(axis=0) * jacobian.max(axis=0) <= 0.0
        _refuse_cells(mesh, turned, "is inverted: its curved edges cross")


def _mesh_of(raw: meshio.Mesh) -> skfem.Mesh:
    """The cells of a file with its groups."""
    cells = {kind: nodes for kind, nodes in raw.cells_dict.items() if len(nodes)}
    cell = next((kind for kind in MESHES if kind in cells), "triangle")
    kind, facet = MESHES[cell]
    allowed = {cell, facet, "vertex"} | ({"line"} if cell == "tetra" else set())
    if others := set(cells) - allowed:
        raise InputError(
            "only triangles of one order, straight tetrahedra and intervals are supported, not "
            f"{', '.join(others)}"
        )
    if cell not in cells:
        raise InputError("has no triangles; save the meshed surface in a physical group")
    used = np.unique(cells[cell])
    if used[0] < 0 or used[-1] >= len(raw.points):
        raise InputError("is damaged: an element names a node that is not in the file")
    points, t = np.asarray(raw.points[used], float), np.searchsorted(used, cells[cell])
    bounded("nodes", points, "finite coordinates")
    d = kind.elem.refdom.dim()
    if np.any(np.ptp(points[:, d:], axis=0) > 1e-9 * np.ptp(points[:, :d])):
        raise InputError(
            "is not flat: z varies; the section must lie in a plane z = constant"
            if d == 2
            else "has no triangles, and its lines are no bar along x; save the body in a group"
        )
    nodes = np.ascontiguousarray(points[:, :d].T)
    mesh = kind(nodes, np.ascontiguousarray(t.T))
    # scikit-fem keeps one middle of an edge
    if d == 2 and not np.array_equal(
        mesh.doflocs[:, mesh.dofs.element_dofs[3:]], nodes[:, t.T[3:]]
    ):
        raise InputError("is damaged: the edges of its triangles have not one middle node each")
    check_mesh(mesh)

    lines = cells.get(facet, np.empty((0, d), int))
    boundaries = _boundaries(raw, mesh, cells[cell], lines, facet)
    return mesh.with_boundaries(boundaries).with_subdomains(_groups(raw, d, cell))


def _boundaries(
    raw: meshio.Mesh, mesh: skfem.Mesh, cells: Indices, facets: Any, kind: str
) -> dict[str, Indices]:
    """Facets of the mesh in each group of a file's facets, and in each set of its nodes."""
    d = mesh.dim()
    corners = np.unique(cells[:, : d + 1])
    vertex = np.full(len(raw.points), -1)  # in the mesh, of a point of the file
    vertex[corners] = np.arange(corners.size)
    boundaries = _groups(raw, d - 1, kind)
    for name, members in boundaries.items():
        ends = vertex[facets[members, :d]].T
        touching = sum(mesh.p2f[:, end] for end in ends)  # of facets and members, common nodes
        at, member = (touching == d).nonzero()
        if (ends < 0).any() or (np.bincount(member, minlength=len(members)) != 1).any():
            what = ("point", "curve", "surface")[d - 1]
            raise InputError(f"physical {what} {name!r} has a line that is no edge of a triangle")
        boundaries[name] = np.unique(at)
    for name, members in raw.point_sets.items():
        own = np.setdiff1d(vertex[np.asarray(members, dtype=int)], -1)
        outer = np.isin(mesh.facets, own).all(axis=0) & (mesh.f2t[1] < 0)
        whole = np.isin(own, mesh.facets[:, outer]).all()  # no node of it lies elsewhere
        if name not in boundaries and outer.any() and whole:
            boundaries[name] = np.flatnonzero(outer)
    return boundaries


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
    numbers = np.abs(raw.cell_data_dict.get("gmsh:physical", {}).get(kind, []))
    for tag in np.setdiff1d(numbers, 0).tolist():  # 0 is no group
        name = names.get((tag, dimension), str(tag))
        groups.setdefault(name, np.flatnonzero(numbers == tag))
    return groups


def _refuse_cells(mesh: skfem.Mesh, bad: Array, fault: str) -> None:
    if np.any(bad):
        k = np.argmax(bad)
        place = coordinates(mesh.p[:, mesh.t[:, k]].mean(axis=1))
        what = ("interval", "triangle", "tetrahedron")[mesh.dim() - 1]
        repair = "repair the mesh, or the points of a grid"
        raise InputError(f"{what} {k} near {place} {fault}; {repair}")


def coordinates(point: Array) -> str:
    """Those of a point in words, such as "(0, 1)"."""
    return f"({', '.join(f'{x:g}' for x in point)})"


def refined(mesh: skfem.Mesh, times: int) -> skfem.Mesh:
    """The mesh with each of its cells divided `times` times, with its names.

    Raises
    ------
    InputError
        If it has too many triangles.
    """
    if not times:
        return mesh
    most = max(int(np.log2(MOST_CELLS / mesh.nelements) / mesh.dim()), 0)
    if times > most:
        raise InputError(
            f"refinements: {times} of {mesh.nelements} {CELLS[mesh.dim()]} make more than "
            f"{MOST_CELLS:.0e} of them; take at most {most}"
        )
    if isinstance(mesh, skfem.MeshTet):
        return refined(_finer_solid(mesh), times - 1)
    if not isinstance(mesh, skfem.MeshTri2):
        return mesh.refined(times)
    fine, quadratic = _straight(mesh).refined(times), skfem.ElementTriP2()
    places = nested(mesh, quadratic, times, quadratic) @ mesh.doflocs.T
    curved = replace(skfem.MeshTri2.from_mesh(fine), doflocs=np.ascontiguousarray(places.T))
    return _with_names(curved, fine)


def _finer_solid(mesh: skfem.MeshTet) -> skfem.MeshTet:
    """Each tetrahedron in eight, with the names of facets, which scikit-fem drops."""
    fine = replace(mesh, _boundaries=None).refined()
    nodes, boundaries = np.vstack([mesh.facets, mesh.nvertices + mesh.f2e]), {}
    for name, members in (mesh.boundaries or {}).items():
        touching = sum(fine.p2f[:, node] for node in nodes[:, members])
        boundaries[name] = np.unique((touching == 3).nonzero()[0])  # within one facet
    return fine.with_boundaries(boundaries)


def nested(
    mesh: skfem.Mesh, element: skfem.Element, times: int, finer: skfem.Element
) -> sp.csr_array:
    """Values of piecewise polynomials on a mesh at the degrees of freedom of a refined one.

    Parameters
    ----------
    mesh : skfem.Mesh
    element, finer : skfem.Element
        P1 or P2, on the mesh and on the one refined `times` times; `finer` has no lower degree.

    Returns
    -------
    sparse, shape (degrees of freedom on the refined mesh, on the mesh)
    """
    # in the coordinates of a triangle, which do not see where its edges are curved
    straight = replace(_straight(mesh), _boundaries=None)
    coarse, fine = (
        skfem.CellBasis(one, kind, intorder=1)
        for one, kind in ((straight, element), (straight.refined(times), finer))
    )
    parent = straight.element_finder()(*fine.mesh.p[:, fine.mesh.t].mean(axis=1))
    dofs, first = np.unique(fine.element_dofs.T, return_index=True)
    cell = first // fine.Nbfun
    places = fine.doflocs[:, dofs, None]
    local = straight.mapping().invF(places, tind=parent[cell])[:, :, 0]
    columns = coarse.element_dofs[:, parent[cell]]
    values = np.array([element.lbasis(local, k)[0] for k in range(coarse.Nbfun)])
    return sparse_matrix(values, dofs, columns, (fine.N, coarse.N))


def sparse_matrix(
    values: Array, rows: Indices, columns: Indices, shape: tuple[int, int]
) -> sp.csr_array:
    """The matrix with these sums of entries; rows and columns are broadcast to the values."""
    places = (np.broadcast_to(index, values.shape).ravel() for index in (rows, columns))
    return sp.csr_array((values.ravel(), tuple(places)), shape=shape)


def _straight(mesh: skfem.Mesh) -> skfem.Mesh:
    """With the same corners, numbers and names, and straight edges."""
    if not isinstance(mesh, skfem.MeshTri2):
        return mesh
    return _with_names(skfem.MeshTri.from_mesh(mesh), mesh)


def _with_names(mesh: skfem.MeshTri, other: skfem.MeshTri) -> skfem.MeshTri:
    """With the names that parts of another mesh, of the same numbers, have."""
    named = mesh.with_boundaries(other.boundaries or {})
    return named.with_subdomains(other.subdomains or {})
