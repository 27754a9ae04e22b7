"""The finite element space V_h = { v in H^1 : v = 0 on Gamma_1 } and the forms on it.

a(u, v) = int_Omega c grad u . grad v      (c = eta or kappa)
<f, v>  = int_Omega f0 v,   int_{Gamma_2} f2 v
J_h(v)  = sum_k w_k g_k |v_k|              (nodes k of Gamma_3)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
import skfem
from numpy.typing import ArrayLike, NDArray
from skfem.helpers import dot, grad

from sweepopt.checks import choice, floats
from sweepopt.errors import InputError, shown
from sweepopt.fem.fields import FRICTION, Datum, Range, check_datum, evaluate
from sweepopt.fem.mesh import Indices, check_mesh

Array = NDArray[np.float64]

ELEMENTS = {"P1": skfem.ElementTriP1(), "P2": skfem.ElementTriP2()}
QUADRATURE = {"P1": 4, "P2": 6}
"""Order of the quadrature of forms: two more than constant coefficients on straight edges need."""
SPLIT = {"P1": [[0, 1, 2]], "P2": [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]}
"""Local points of the linear triangles that draw one element."""
NODES = {"P1": ([0.0, 1.0], [1 / 2, 1 / 2]), "P2": ([0.0, 0.5, 1.0], [1 / 6, 4 / 6, 1 / 6])}
"""Nodal quadrature on an edge: trapezoid for P1, Simpson for P2."""


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
        boundaries = self.mesh.boundaries or {}
        found = [np.empty(0, dtype=np.int64)]
        for name in names:
            if name not in boundaries:
                known = ", ".join(sorted(boundaries)) or "none (give the mesh physical groups)"
                raise InputError(
                    f"{what}: {name!r} is not a boundary of the mesh; there are: {known}"
                )
            found.append(np.asarray(boundaries[name], dtype=np.int64))
            if np.any(self.mesh.f2t[1, found[-1]] >= 0):
                raise InputError(f"{what}: {name!r} lies inside the body; name a boundary of it")
        edges = np.concatenate(found)
        _, first = np.unique(edges, return_index=True)
        return np.asarray(edges[np.sort(first)])

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
        field = self._fine.interpolate(self.expand(u))
        return self._l2_norm(np.asarray(field) - exact(_x(self._fine)))

    def h1_error(self, u: ArrayLike, gradient: Callable[[Array], ArrayLike]) -> float:
        """|grad u_h - gradient| in L^2; `gradient` maps x of shape (2, ...) to (2, ...)."""
        field = self._fine.interpolate(self.expand(u))
        return self._l2_norm(np.asarray(field.grad) - gradient(_x(self._fine)))

    @cached_property
    def _fine(self) -> skfem.CellBasis:
        """For errors: of a higher order than the forms, so that their quadrature is not seen."""
        order = QUADRATURE[self.element] + 2
        return skfem.CellBasis(self.mesh, ELEMENTS[self.element], intorder=order)

    def _l2_norm(self, values: ArrayLike) -> float:
        return float(np.sqrt(np.sum(np.square(values) * self._fine.dx)))

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


def stiffness(body: Discretisation, name: str, coefficient: Datum, allowed: Range) -> sp.csc_array:
    """Matrix of ``int c grad u . grad v`` on the unknowns, shape (dim, dim)."""
    basis = body.basis
    x = _x(basis)
    values = evaluate(name, coefficient, x, body.mesh.subdomains or {}, allowed)
    form = skfem.BilinearForm(lambda u, v, w: w.c * dot(grad(u), grad(v)))
    with np.errstate(over="ignore", invalid="ignore"):
        full = form.assemble(basis, c=skfem.DiscreteField(values))
        matrix = body.restrict((full + full.T) / 2)
    refuse_overflow(name, matrix.data)
    return matrix


def volume_load(body: Discretisation, name: str, density: Datum) -> Array:
    """Vector of ``int_Omega f0 v`` on the unknowns, shape (dim,)."""
    x = _x(body.basis)
    values = evaluate(name, density, x, body.mesh.subdomains or {})
    return np.asarray(body.restrict(_load(name, body.basis, values)))


def boundary_load(body: Discretisation, name: str, on: Sequence[str], density: Datum) -> Array:
    """Vector of ``int_{Gamma_2} f2 v`` on the unknowns, shape (dim,)."""
    facets = body.facets("on", on)
    basis = skfem.FacetBasis(
        body.mesh, ELEMENTS[body.element], facets=facets, intorder=QUADRATURE[body.element]
    )
    x = _x(basis)
    values = evaluate(name, density, x, edge_groups(body, on, facets))
    return np.asarray(body.restrict(_load(name, basis, values)))


class EdgeRule(NamedTuple):
    """Nodal quadrature on m edges.

    Attributes
    ----------
    facets : ndarray, shape (m,)
        Edges of Gamma_3.
    weights : ndarray, shape (m, 2 or 3)
        Share of each node of an edge in its length, in the order start, (middle,) end of
        `mesh.facets`.
    bounds : ndarray, shape (m, 2 or 3)
        g at these nodes.
    """

    facets: Indices
    weights: Array
    bounds: Array


def friction_weights(body: Discretisation, name: str, on: Sequence[str], bound: Datum) -> EdgeRule:
    """Nodal quadrature of ``J(v) = int_{Gamma_3} g |v|``.

    Trapezoid (P1) or Simpson (P2) on every edge, with the length element of a curved edge taken
    at its nodes. The nodes of the rule are those of the element, so that
    ``J_h(v) = sum_k w_k g_k |v_k|`` stays separable: the dissipation is a box on the contact
    unknowns. Where v does not change sign within an edge the error is O(h^2) for P1 and O(h^4)
    for P2; on edges where it does, O(h^2) of the edge's own share in both, as |v| has a kink.
    """
    facets = body.facets("on", on)
    where, rule = NODES[body.element]
    basis = skfem.FacetBasis(
        body.mesh,
        ELEMENTS[body.element],
        facets=facets,
        quadrature=(np.array([where]), np.array(rule)),
    )
    x = _x(basis)
    bounds = evaluate(name, bound, x, edge_groups(body, on, facets), FRICTION)
    return EdgeRule(facets, basis.dx, bounds)


def edge_groups(body: Discretisation, on: Sequence[str], facets: Indices) -> dict[str, Indices]:
    """Positions in `facets` of each boundary of `on`."""
    return {name: np.flatnonzero(np.isin(facets, body.facets("on", (name,)))) for name in on}


def refuse_overflow(name: str, integrals: ArrayLike) -> None:
    """Refuse a coefficient whose values are finite but whose integrals are not."""
    if not np.all(np.isfinite(integrals)):
        raise InputError(
            f"{name} is too large: its integrals over the mesh overflow; choose other units"
        )


def _load(name: str, basis: skfem.CellBasis | skfem.FacetBasis, values: Array) -> Array:
    form = skfem.LinearForm(lambda v, w: w.f * v)
    with np.errstate(over="ignore", invalid="ignore"):
        load = np.asarray(form.assemble(basis, f=skfem.DiscreteField(values)))
    refuse_overflow(name, load)
    return load


def _x(basis: skfem.CellBasis | skfem.FacetBasis) -> Array:
    """Points of the quadrature, shape (2, cells, points)."""
    return np.asarray(basis.global_coordinates())
