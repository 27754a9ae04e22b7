"""The finite element space V_h = { v in H^1 : v = 0 on Gamma_1 } on a checked mesh."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
import skfem
from numpy.typing import ArrayLike, NDArray

from sweepopt.checks import choice, floats
from sweepopt.errors import InputError, shown
from sweepopt.fem.fields import Datum, check_datum, evaluate
from sweepopt.fem.mesh import Indices, check_mesh, group

Array = NDArray[np.float64]

ELEMENTS = {"P1": skfem.ElementTriP1(), "P2": skfem.ElementTriP2()}
QUADRATURE = {"P1": 4, "P2": 6}
"""Order of the quadrature of forms: two more than constant coefficients on straight edges need."""
SPLIT = {"P1": [[0, 1, 2]], "P2": [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]}
"""Local points of the linear triangles that draw one element."""


@dataclass(frozen=True, eq=False)
class Discretisation:
    """Continuous piecewise polynomials on a mesh, zero on the clamped boundary.

    Parameters
    ----------
    mesh : skfem.MeshTri
        `MeshTri2` for curved edges.
    clamped : sequence of str
        Names of the boundaries that make up Gamma_1.
    element : {"P1", "P2"}

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
        If the mesh is damaged or a piece of it is not clamped, or a boundary is not known.

    Examples
    --------
    >>> square = skfem.MeshTri().refined(2).with_defaults()
    >>> Discretisation(square, ["top"]).dim
    20
    """

    mesh: skfem.MeshTri
    clamped: tuple[str, ...]
    element: str = "P1"

    def __init__(self, mesh: skfem.MeshTri, clamped: Sequence[str], element: str = "P1") -> None:
        choice("element", element, ELEMENTS)
        if not isinstance(mesh, skfem.MeshTri):
            raise InputError(
                f"mesh must be a path or a mesh of triangles (skfem.MeshTri), got {shown(mesh)}"
            )
        check_mesh(mesh)
        object.__setattr__(self, "mesh", mesh)
        object.__setattr__(self, "clamped", tuple(clamped))
        object.__setattr__(self, "element", element)
        self._refuse_loose_pieces()
        if not self.dim:
            raise InputError(
                f"clamped: holding {', '.join(self.clamped)} leaves no unknown; "
                "clamp less or refine the mesh"
            )

    @cached_property
    def basis(self) -> skfem.CellBasis:
        """The scikit-fem basis in the triangles, of all degrees of freedom."""
        return skfem.CellBasis(self.mesh, ELEMENTS[self.element], intorder=QUADRATURE[self.element])

    @cached_property
    def free(self) -> Indices:
        """Degrees of freedom off the clamped boundary."""
        held = self.basis.get_dofs(facets=self.facets("clamped", self.clamped)).flatten()
        return np.setdiff1d(np.arange(self.basis.N), held)

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

    def facets(self, what: str, names: Sequence[str]) -> Indices:
        """Boundary edges of the named groups, each once, in the order of the names.

        Parameters
        ----------
        what : str
            The argument that names them, for errors.
        """
        found = []
        for name in names:
            try:
                edges = group(self.mesh.boundaries, name, "boundary")
            except InputError as error:
                raise InputError(f"{what}: {error}") from error
            if np.any(self.mesh.f2t[1, edges] >= 0):
                raise InputError(f"{what}: {name!r} lies inside the body; name a boundary of it")
            found.append(edges)
        joined = np.concatenate(found) if found else np.empty(0, dtype=np.int64)
        _, first = np.unique(joined, return_index=True)
        return np.asarray(joined[np.sort(first)])

    def restrict(self, full: ArrayLike | sp.sparray) -> Array | sp.csc_array:
        """Entries of a vector, or rows and columns of a matrix, that belong to unknowns."""
        if sp.issparse(full):
            return sp.csc_array(sp.csr_array(full)[self.free][:, self.free])
        return np.asarray(full)[self.free]

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

    def interpolate(self, function: Datum) -> Array:
        """Nodal values of a function of x (shape (2, N)) at the unknowns, shape (dim,)."""
        values = evaluate("function", check_datum("function", function), self.points.T, {})
        return np.asarray(values[self.free])

    def l2_error(self, u: ArrayLike, exact: Callable[[Array], ArrayLike]) -> float:
        """|u_h - exact| in L^2; `exact` maps x of shape (2, ...) to (...)."""
        fine = self._fine_basis
        difference = np.asarray(fine.interpolate(self.expand(u))) - exact(_x(fine))
        return float(np.sqrt(np.sum(difference**2 * fine.dx)))

    def h1_error(self, u: ArrayLike, gradient: Callable[[Array], ArrayLike]) -> float:
        """|grad u_h - gradient| in L^2; `gradient` maps x of shape (2, ...) to (2, ...)."""
        fine = self._fine_basis
        difference = np.asarray(fine.interpolate(self.expand(u)).grad) - gradient(_x(fine))
        return float(np.sqrt(np.sum(difference**2 * fine.dx)))

    @cached_property
    def _fine_basis(self) -> skfem.CellBasis:
        return skfem.CellBasis(
            self.mesh, ELEMENTS[self.element], intorder=QUADRATURE[self.element] + 2
        )

    def _refuse_loose_pieces(self) -> None:
        """a is coercive only if every piece of the body is clamped somewhere."""
        held = np.zeros(self.mesh.nvertices, dtype=bool)
        held[self.mesh.facets[:, self.facets("clamped", self.clamped)]] = True
        start, end = self.mesh.facets
        links = sp.coo_array((np.ones(start.size), (start, end)), shape=2 * (held.size,))
        _, piece = sp.csgraph.connected_components(links, directed=False)
        used = np.unique(self.mesh.t)
        loose = np.setdiff1d(piece[used], piece[held])
        if loose.size:
            x, y = self.mesh.p[:, used[piece[used] == loose[0]][0]]
            raise InputError(
                f"clamped: nothing holds the piece of the body with the point ({x:g}, {y:g}); "
                "clamp an edge of every piece (a must be coercive)"
            )


def _x(basis: skfem.CellBasis) -> Array:
    return np.asarray(basis.global_coordinates())
