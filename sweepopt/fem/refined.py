"""Uniformly refined meshes, whose functions contain those of the meshes that they were made from.

Each triangle is divided into four of half its size. The map from the reference triangle to a curved
triangle stays as it is, so that the parts of a curved edge are parts of the same parabola.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse as sp
import skfem

from sweepopt.errors import InputError

MOST_CELLS = 10_000_000
"""Of a mesh that is refined or made: ten times those of the largest runs that were measured."""
CELLS = {1: "intervals", 2: "triangles", 3: "tetrahedra"}


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
    if not isinstance(mesh, skfem.MeshTri2):
        return mesh.refined(times)
    fine, quadratic = _straight(mesh).refined(times), skfem.ElementTriP2()
    places = nested(mesh, quadratic, times, quadratic) @ mesh.doflocs.T
    curved = replace(skfem.MeshTri2.from_mesh(fine), doflocs=np.ascontiguousarray(places.T))
    return _named(curved, fine)


def nested(
    mesh: skfem.MeshTri, element: skfem.Element, times: int, finer: skfem.Element
) -> sp.csr_array:
    """Values of piecewise polynomials on a mesh at the degrees of freedom of a refined one.

    Parameters
    ----------
    mesh : skfem.MeshTri
    element, finer : skfem.Element
        P1 or P2, on the mesh and on the one refined `times` times; `finer` has no lower degree.

    Returns
    -------
    sparse, shape (degrees of freedom on the refined mesh, on the mesh)
    """
    # in the coordinates of a triangle, which do not see where its edges are curved
    straight = _straight(mesh)
    coarse, fine = (
        skfem.CellBasis(one, kind, intorder=1)
        for one, kind in ((straight, element), (straight.refined(times), finer))
    )
    parent = np.arange(fine.nelems) % coarse.nelems  # scikit-fem numbers the parts in four blocks
    dofs, first = np.unique(fine.element_dofs.T, return_index=True)
    triangle = first // fine.Nbfun
    places = fine.doflocs[:, dofs, None]
    local = straight.mapping().invF(places, tind=parent[triangle])[:, :, 0]
    columns = coarse.element_dofs[:, parent[triangle]]
    values = np.array([element.lbasis(local, k)[0] for k in range(coarse.Nbfun)])
    rows = np.broadcast_to(dofs, columns.shape)
    entries = values.ravel(), (rows.ravel(), columns.ravel())
    return sp.csr_array(entries, shape=(fine.N, coarse.N))


def _straight(mesh: skfem.MeshTri) -> skfem.MeshTri:
    """With the same corners, numbers and names, and straight edges."""
    corners = np.ascontiguousarray(mesh.p[:, : mesh.nvertices])
    return _named(skfem.MeshTri(corners, mesh.t), mesh)


def _named(mesh: skfem.MeshTri, other: skfem.MeshTri) -> skfem.MeshTri:
    """With the names that parts of another mesh, of the same numbers, have."""
    named = mesh.with_boundaries(other.boundaries or {})
    return named.with_subdomains(other.subdomains or {})
