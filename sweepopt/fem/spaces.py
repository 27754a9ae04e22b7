"""The finite element space V_h = { v in H^1 : v = 0 on Gamma_1 } and the forms on it.

a(u, v) = int_Omega c grad u . grad v      (c = eta or kappa)
<f, v>  = int_Omega f0 v,   int_{Gamma_2} f2 v
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
import skfem
from numpy.typing import ArrayLike, NDArray
from skfem.helpers import dot, grad

from sweepopt.checks import choice, count, floats, listed
from sweepopt.errors import InputError, shown
from sweepopt.fem.fields import Coefficient, Datum
from sweepopt.fem.mesh import Indices, check_mesh, read_mesh
from sweepopt.fem.refined import nested, refined
from sweepopt.io import as_path

Array = NDArray[np.float64]

ELEMENTS = {"P1": skfem.ElementTriP1(), "P2": skfem.ElementTriP2()}
SPLIT = {"P1": [[0, 1, 2]], "P2": [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]}
"""Local points of the linear triangles that draw one element."""


@dataclass(frozen=True, eq=False)
class Discretisation:
    """Continuous piecewise polynomials on a mesh, zero on the clamped boundary.

    Parameters
    ----------
    mesh : skfem.MeshTri, str or Path
        `MeshTri2` for curved edges; a path is read by `read_mesh`.
    clamped : str or sequence of str
        Names of the boundaries that make up Gamma_1.
    element : {"P1", "P2"}
    refinements : int
        How often each triangle is divided into four. Curved edges stay as they are: the functions
        of a mesh are functions of the finer ones.

    Attributes
    ----------
    dim : int
        Number of unknowns.
    free : ndarray, shape (dim,)
        Which of the N points carry an unknown, increasing.
    points : ndarray, shape (N, 2)
        Where all degrees of freedom sit, clamped ones too.
    triangles : ndarray, shape (m, 3)
        Linear triangles through `points`, for pictures; a quadratic element counts as four.

    Raises
    ------
    InputError
        If the mesh is damaged or a piece of it is not clamped, a boundary is not known, or the
        refined mesh is too large.

    Examples
    --------
    >>> square = skfem.MeshTri().refined(2).with_defaults()
    >>> Discretisation(square, ["top"]).dim
    20
    """

    mesh: skfem.MeshTri
    clamped: Sequence[str] = "clamped"
    element: str = "P1"
    refinements: int = 0

    def __post_init__(self) -> None:
        choice("element", self.element, ELEMENTS)
        count("refinements", self.refinements, 0)
        if not isinstance(self.mesh, skfem.MeshTri):
            path = as_path("a mesh that is no skfem.MeshTri", self.mesh)
            object.__setattr__(self, "mesh", read_mesh(path))
        check_mesh(self.mesh)
        object.__setattr__(self, "mesh", refined(self.mesh, self.refinements))
        object.__setattr__(self, "clamped", boundary_names("clamped", self.clamped))
        facets, _ = self.edges("clamped", self.clamped)
        # a is coercive only if every piece of the body is clamped somewhere
        _, piece = sp.csgraph.connected_components(self.mesh.p2t.T @ self.mesh.p2t)
        loose = ~np.isin(piece, piece[self.mesh.facets[:, facets]])
        if loose.any():
            x, y = self.mesh.p[:, np.argmax(loose)]
            raise InputError(
                f"clamped: nothing holds the piece of the body with the point ({x:g}, {y:g}); "
                "clamp an edge of every piece (a must be coercive)"
            )
        if not self.dim:
            raise InputError(
                f"clamped: holding {', '.join(self.clamped)} leaves no unknown; "
                "clamp less or refine the mesh"
            )

    @cached_property
    def basis(self) -> skfem.CellBasis:
        """The scikit-fem basis in the triangles, of all degrees of freedom.

        Its quadrature has an order two above what constant coefficients on straight edges need.
        """
        element = ELEMENTS[self.element]
        return skfem.CellBasis(self.mesh, element, intorder=2 * element.maxdeg + 2)

    def edge_nodes(self, facets: Indices) -> Indices:
        """Degrees of freedom along each edge: start, (middle,) end; shape (2 or 3, m)."""
        start, end = self.basis.nodal_dofs[0, self.mesh.facets]
        return np.vstack([start, *self.basis.facet_dofs, end])[:, facets]

    @cached_property
    def free(self) -> Indices:
        """Degrees of freedom off the clamped boundary."""
        return self.basis.complement_dofs(self.basis.get_dofs(self.clamped))

    @property
    def dim(self) -> int:
        """Number of unknowns."""
        return int(self.free.size)

    @cached_property
    def points(self) -> Array:
        """Coordinates of all degrees of freedom, shape (N, 2)."""
        return np.ascontiguousarray(self.basis.doflocs.T)

    @cached_property
    def triangles(self) -> Indices:
        """Linear triangles through the points, shape (m, 3)."""
        return np.vstack([self.basis.element_dofs[corners].T for corners in SPLIT[self.element]])

    def edges(self, what: str, names: Sequence[str]) -> tuple[Indices, dict[str, Indices]]:
        """Boundary edges of the named groups, each once, and which of them are in each group.

        Parameters
        ----------
        what : str
            The argument that names them, for errors.
        """
        boundaries = self.mesh.boundaries or {}
        for name in names:
            if name not in boundaries:
                known = ", ".join(sorted(boundaries)) or "none (give the mesh physical groups)"
                raise InputError(
                    f"{what}: {name!r} is not a boundary of the mesh; there are: {known}"
                )
            if np.any(self.mesh.f2t[1, boundaries[name]] >= 0):
                raise InputError(f"{what}: {name!r} lies inside the body; name a boundary of it")
        edges = np.unique(np.concatenate([np.asarray(boundaries[name]) for name in names]))
        return edges, {name: np.searchsorted(edges, boundaries[name]) for name in names}

    def expand(self, u: ArrayLike) -> Array:
        """Values at all points, zero on the clamped ones.

        Parameters
        ----------
        u : array_like, shape (..., dim)

        Returns
        -------
        ndarray, shape (..., N)
        """
        values = floats("u", u, "numbers")
        if values.shape[-1:] != (self.dim,):
            raise InputError(f"u must have {self.dim} entries in its last axis, got {values.shape}")
        full = np.zeros((*values.shape[:-1], self.basis.N))
        full[..., self.free] = values
        return full

    def from_coarser(self, coarse: Discretisation) -> sp.csr_array:
        """The matrix that turns values of the unknowns on a coarser mesh into values on this one.

        Parameters
        ----------
        coarse : Discretisation
            Of the same mesh, with no more refinements and no higher degree: each of its functions
            is one of these too.

        Returns
        -------
        sparse, shape (dim, coarse.dim)
        """
        times = self.refinements - coarse.refinements
        values = nested(coarse.mesh, ELEMENTS[coarse.element], times, ELEMENTS[self.element])
        return values[self.free][:, coarse.free]

    def interpolate(self, function: Datum) -> Array:
        """Nodal values of a function of x (shape (2, N)) at the unknowns, shape (dim,)."""
        return Coefficient("function").values(function, self.points.T, {})[self.free]


STIFFNESS = skfem.BilinearForm(lambda u, v, w: w.c * dot(grad(u), grad(v)))
LOAD = skfem.LinearForm(lambda v, w: w.c * v)


def assemble(
    body: Discretisation,
    form: skfem.BilinearForm | skfem.LinearForm,
    coefficient: Coefficient,
    datum: Datum,
    on: Sequence[str] = (),
) -> Any:
    """Integrals of a form with a coefficient over the body, or over its boundaries `on`.

    Returns
    -------
    sparse, shape (dim, dim), or ndarray, shape (dim,)
        On the unknowns.
    """
    basis, groups = body.basis, body.mesh.subdomains or {}
    if on:
        facets, groups = body.edges("on", on)
        order = 2 * basis.elem.maxdeg + 2
        basis = skfem.FacetBasis(body.mesh, basis.elem, facets=facets, intorder=order)
    values = coefficient.values(datum, basis.global_coordinates(), groups)
    integrals = form.assemble(basis, c=skfem.DiscreteField(values))[body.free]
    return sp.csc_array(integrals[:, body.free]) if sp.issparse(integrals) else integrals


def boundary_names(argument: str, value: object) -> tuple[str, ...]:
    """One name or several as a tuple of distinct strings."""
    names = (value,) if isinstance(value, str) else listed(argument, value)
    if not all(isinstance(name, str) for name in names) or len(set(names)) < len(names):
        raise InputError(f"{argument} must be a name or distinct names, got {shown(value)}")
    return names
