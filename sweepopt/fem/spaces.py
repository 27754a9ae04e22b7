"""The finite element space, its unknowns, and integrals on it.

A body is lumped (u is a number at each node of a chain), antiplane (u is a number: the displacement
out of a section, or along a bar), in plane strain, in plane stress, or solid (u is a vector).
Components are held to zero on named boundaries; on boundaries with friction the components at a
node are the normal and the tangents, so that contact holds a component and friction acts on
unknowns.
"""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import field
from functools import cached_property
from itertools import combinations
from math import factorial
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
import skfem
from numpy.typing import ArrayLike

from sweepopt.checks import at_path, choice, count, floats, meaning
from sweepopt.display import Brief, record
from sweepopt.errors import InputError, shown
from sweepopt.fem.fields import Array, Coefficient, Datum, Indices
from sweepopt.fem.frames import AXES, Frame, frame_of
from sweepopt.fem.mesh import (
    CELLS,
    check_mesh,
    coordinates,
    nested,
    read_mesh,
    refined,
    sparse_matrix,
)
from sweepopt.io import as_path

KINDS = {
    "antiplane": (1, 2),
    "plane strain": (2,),
    "plane stress": (2,),
    "solid": (3,),
    "lumped": (1,),
}
"""Dimensions of the mesh of each kind of body."""
ELEMENTS = {
    "P1": (skfem.ElementLineP1(), skfem.ElementTriP1(), skfem.ElementTetP1()),
    "P2": (skfem.ElementLineP2(), skfem.ElementTriP2(), skfem.ElementTetP2()),
}
"""Elements on meshes of dimension 1, 2 and 3."""
SPLIT = {"P1": [[0, 1, 2]], "P2": [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]}
"""Local points of the linear triangles that draw one element."""
BODY = "body"
"""What effects call the whole of it, where no boundary or subdomain has that name."""


@meaning(degree='; give element, "P1" or "P2"', order='; give element, "P1" or "P2"')
@record
class Discretisation(Brief):
    """Continuous piecewise polynomials on a mesh, with components held to zero on boundaries.

    Parameters
    ----------
    mesh : skfem.Mesh, str or Path
        Of intervals, triangles or tetrahedra, as the kind needs; `MeshTri2` for curved edges; a
        path is read by `read_mesh`.
    clamped : str or sequence of str
        Names of the boundaries that make up Gamma_1, where all components are held; "clamped" by
        default, none where `held` says what is.
    element : {"P1", "P2"}
    refinements : int
        How often each cell is divided (a triangle into four). Curved edges stay as they are: the
        functions of a mesh are functions of the finer ones.
    kind : {"lumped", "antiplane", "plane strain", "plane stress", "solid"}
        A lumped model is a chain of P1 intervals of length 1: gradients are the differences along
        edges, and an integral of values over the body is their sum over the nodes; a node between
        two subdomains is half of each.
    held : mapping of str to str
        Components that are zero on a boundary: letters of "xyz" and "n" (normal), such as
        ``{"axis": "n", "foot": "xy"}``. At a node the normal is the mean of those of the boundary's
        facets. Where boundaries meet at less than 30 degrees from a straight line they are smooth,
        and the normal of the first one holds the node.

    Attributes
    ----------
    turned : sequence of tuple of str
        Boundaries where the unknowns of a node are the components along its normal and its
        tangents: scenes turn those with friction, which have one normal for all names of an effect.
    dim : int
        Number of unknowns.
    components : int
        Of the displacement: 1 for "antiplane", else the dimension of the mesh.
    free : ndarray, shape (dim,)
        Which degrees of freedom of the frames are unknowns, increasing.
    points : ndarray, shape (N, d)
        Where the nodes sit, held ones too.
    triangles : ndarray, shape (m, 3)
        Linear triangles through `points`, for pictures, of a solid those of its surface; a
        quadratic element counts as four. None of a mesh of intervals.

    Raises
    ------
    InputError
        If the mesh is damaged or not one of the kind, a boundary is not known, a component is none
        of the body, nothing is left free, or the refined mesh is too large.

    Examples
    --------
    >>> square = skfem.MeshTri().refined(2).with_defaults()
    >>> Discretisation(square, ["top"]).dim
    20
    >>> Discretisation(square, kind="plane strain", held={"top": "x", "left": "n"}).dim
    41
    """

    mesh: skfem.Mesh
    clamped: Sequence[str] | None = None
    element: str = "P1"
    refinements: int = 0
    kind: str = "antiplane"
    held: Mapping[str, str] = field(default_factory=dict)
    turned: Sequence[tuple[str, ...]] = field(default=(), init=False)
    start = 0.0  # of the scene that is built on it: when functions of time may be called
    effects = tuple[Any, ...]()  # all of that scene

    def __post_init__(self) -> None:
        choice("element", self.element, ELEMENTS)
        dimensions = KINDS[choice("kind", self.kind, KINDS)]
        count("refinements", self.refinements, 0)
        if not isinstance(self.mesh, skfem.Mesh):
            path = as_path("a mesh that is no skfem.Mesh", self.mesh)
            object.__setattr__(self, "mesh", read_mesh(path))
        with at_path("mesh: "):
            check_mesh(self.mesh)
        if self.mesh.dim() not in dimensions:
            needs = " or ".join(CELLS[k] for k in dimensions)
            fitting = ", ".join(kind for kind, some in KINDS.items() if self.mesh.dim() in some)
            raise InputError(f"kind: {self.kind!r} needs a mesh of {needs}; of this one: {fitting}")
        object.__setattr__(self, "mesh", refined(self.mesh, self.refinements))
        if self.lumped and (
            self.element != "P1" or not np.allclose(np.diff(self.mesh.p[0][self.mesh.t], axis=0), 1)
        ):
            raise InputError(
                "kind: 'lumped' needs P1 and intervals of length 1; give mesh = { nodes = ... }, "
                "or take 'antiplane' for a bar"
            )
        given = ("clamped" if not self.held else ()) if self.clamped is None else self.clamped
        empty = isinstance(given, (list, tuple)) and not given
        names = () if empty else boundary_names("clamped", given)
        self.facets("clamped", names)
        object.__setattr__(self, "clamped", names)
        self._check_held()
        if not self.dim:
            everything = ", ".join([*names, *self.held])
            raise InputError(
                f"clamped: holding {everything} leaves no unknown; clamp less or refine the mesh"
            )

    def _check_held(self) -> None:
        if not isinstance(self.held, Mapping):
            raise InputError(
                f"held must say what is held on a boundary, such as {{ foot = 'y' }}, got "
                f"{shown(self.held)}"
            )
        if self.held and self.components == 1:
            raise InputError(
                f"held: {self.kind!r} (the default kind is 'antiplane') has one component; name in "
                "clamped where it is held"
            )
        known = AXES[: self.components] + "n"
        for name, what in self.held.items():
            self.facets("held", [name])
            if not (isinstance(what, str) and what and set(what) <= set(known)):
                raise InputError(f"held.{name} must be letters of {known!r}, got {shown(what)}")

    @property
    def lumped(self) -> bool:
        """Whether it is nodes and edges, with nothing between them."""
        return self.kind == "lumped"

    @property
    def components(self) -> int:
        """How many the displacement has."""
        return 1 if self.lumped or self.kind == "antiplane" else self.mesh.dim()

    @cached_property
    def scalar(self) -> skfem.CellBasis:
        """The scikit-fem basis of one component, for its degrees of freedom."""
        return skfem.CellBasis(self.mesh, ELEMENTS[self.element][self.mesh.dim() - 1], intorder=1)

    @property
    def _element(self) -> skfem.Element:
        scalar = self.scalar.elem
        return scalar if self.components == 1 else skfem.ElementVector(scalar)

    @cached_property
    def basis(self) -> skfem.CellBasis:
        """The scikit-fem basis of all components, in the cells, with the quadrature of strains.

        Everything that is an integral of strains is one by this quadrature, whose points are those
        of stresses and plastic strains: of P1 elements the centroid, of P2 one exact on quadratic
        functions. Scenes drop it once they are assembled, as it is large.
        """
        rule, d = None, self.mesh.dim()
        if self.scalar.elem.maxdeg == 1:
            rule = np.full((d, 1), 1 / (d + 1)), np.array([1 / factorial(d)])
        return skfem.CellBasis(self.mesh, self._element, intorder=2, quadrature=rule)

    @property
    def whole(self) -> Place:
        """All of the body, with the quadrature of strains."""
        return Place(self.basis, self.mesh.subdomains or {}, self.scalar.element_dofs)

    @cached_property
    def nodes(self) -> Indices:
        """Degrees of freedom in `basis` of each component at each node, shape (components, N)."""
        basis = self.scalar.with_element(self._element)
        dofs = basis.nodal_dofs, basis.edge_dofs, basis.facet_dofs, basis.interior_dofs
        return np.hstack([part for part in dofs if part.size])

    @cached_property
    def frame(self) -> Frame:
        """At each node the directions of its degrees of freedom, those that are held first."""
        return frame_of(self)

    def with_unknowns(self, **fields: Any) -> Discretisation:
        """The same with other values of `clamped`, `held`, `turned`, `effects` or `start`."""
        other = copy.copy(self)
        for name in ("frame", "free", "extension"):
            other.__dict__.pop(name, None)
        other.__dict__.update(fields)
        return other

    def digest(self, *internal: Array) -> str:
        """A checksum of the kind, cells and unknowns, and of the nodes to 1e-9 of the body's size.

        `internal` is what internal unknowns are measured in.
        """
        size, cells = np.ptp(self.points), np.asarray(self.mesh.t, dtype=np.int64)
        places = np.round(self.points / size, 9) + 0.0  # one zero
        directions = np.round(self.frame.basis, 9) + 0.0
        parts = [part.tobytes() for part in (cells, places, self.free, directions, *internal)]
        return hashlib.sha256(b" ".join([f"{self.kind} {size:.9g}".encode(), *parts])).hexdigest()

    def loose_point(self, M: Any) -> str | None:
        """A point of a piece of the body that a matrix of the unknowns does not hold, if any.

        Of each piece the motions are taken that strain nothing (translations, and rotations of
        vectors), and M on those that are not held.

        Returns
        -------
        str or None
            Such as "(0, 1)"; None where every piece is held.
        """
        cells, size = self.scalar.element_dofs, self.scalar.N
        graph = sparse_matrix(np.ones(cells.shape), cells[0], cells, (size, size))
        count, piece = sp.csgraph.connected_components(graph, directed=False)
        axes, scale = np.eye(self.components), np.abs(M).max() or 1.0
        turns = [np.outer(a, b) - np.outer(b, a) for a, b in combinations(axes, 2)]
        for k in range(count):
            nodes = np.flatnonzero(piece == k)
            x = self.points[nodes] - self.points[nodes].mean(axis=0)
            x = x / (np.abs(x).max() or 1.0)
            modes = [*(np.tile(axis, (len(x), 1)) for axis in axes), *(x @ turn for turn in turns)]
            full = np.zeros((self.nodes.size, len(modes)))
            full[self.nodes.T[nodes]] = np.stack(modes, axis=-1)
            free = self.extension.T @ full
            gram = full.T @ full - free.T @ free + free.T @ (M @ free) / scale
            if np.linalg.eigvalsh(gram)[0] <= 1e-12 * len(x):
                return coordinates(self.points[nodes[0]])
        return None

    def facet_nodes(self, facets: Indices) -> Indices:
        """Nodes of each facet; of an edge start, (middle,) end; shape (nodes of a facet, m)."""
        scalar, corners = self.scalar, self.scalar.nodal_dofs[0, self.mesh.facets[:, facets]]
        if self.element == "P1" or self.mesh.dim() == 1:
            return corners
        if self.mesh.dim() == 2:
            return np.vstack([corners[:1], scalar.facet_dofs[:, facets], corners[1:]])
        return np.vstack([corners, scalar.edge_dofs[0, self.mesh.f2e[:, facets]]])

    @cached_property
    def free(self) -> Indices:
        """Degrees of freedom, in the frames of the nodes, that are not held."""
        slot = np.arange(self.components)[:, None]
        return np.sort(self.nodes[slot >= self.frame.held])

    @cached_property
    def extension(self) -> sp.csr_array:
        """All degrees of freedom of `basis`, 0 where they are held, from the unknowns."""
        return self.frame.T[:, self.free]

    @property
    def dim(self) -> int:
        """Number of unknowns."""
        return self.free.size

    @cached_property
    def points(self) -> Array:
        """Coordinates of the nodes, shape (N, d)."""
        return np.ascontiguousarray(self.scalar.doflocs.T)

    @cached_property
    def triangles(self) -> Indices:
        """Linear triangles through the points, shape (m, 3)."""
        nodes = self.scalar.element_dofs
        if self.mesh.dim() == 3:
            nodes = self.facet_nodes(self.mesh.boundary_facets())
        elif self.mesh.dim() == 1:
            return np.empty((0, 3), dtype=np.int64)
        return np.vstack([nodes[corners].T for corners in SPLIT[self.element]])

    def facets(self, what: str, names: str | Sequence[str]) -> tuple[Indices, dict[str, Indices]]:
        """Boundary facets of the named groups, each once, and which of them are in each group.

        Parameters
        ----------
        what : str
            The argument that names them, for errors.
        """
        names = [names] if isinstance(names, str) else names
        boundaries = self.mesh.boundaries or {}
        for name in names:
            if name not in boundaries:
                known = ", ".join(sorted(boundaries)) or "none (give the mesh physical groups)"
                known += "; nothing is clamped by clamped = []" * (name == "clamped")
                default = "is missing, and its default " * (self.clamped is None)
                raise InputError(
                    f"{what}: {default}{name!r} is not a boundary of the mesh; there are: {known}"
                )
            _require_some(what, name, boundaries[name])
            if np.any(self.mesh.f2t[1, boundaries[name]] >= 0):
                raise InputError(f"{what}: {name!r} lies inside the body; name a boundary of it")
        each = [np.empty(0), *(boundaries[name] for name in names)]
        facets = np.unique(np.concatenate(each).astype(np.int64))
        return facets, {name: np.searchsorted(facets, boundaries[name]) for name in names}

    def expand(self, u: ArrayLike) -> Array:
        """Values at all nodes, zero where they are held.

        Parameters
        ----------
        u : array_like, shape (..., dim)

        Returns
        -------
        ndarray, shape (..., N), or (..., N, components) of vectors
        """
        values = floats("u", u, "numbers")
        if values.shape[-1:] != (self.dim,):
            raise InputError(f"u must have {self.dim} entries in its last axis, got {values.shape}")
        full = (self.extension @ values.reshape(-1, self.dim).T).T
        full = full.reshape(*values.shape[:-1], self.nodes.size)
        return full[..., self.nodes[0] if self.components == 1 else self.nodes.T]

    def restrict(self, x: Any) -> Any:
        """A matrix or a vector of all degrees of freedom of `basis`, on the unknowns."""
        size, shape = self.extension.shape[0], np.shape(x)
        if shape[:1] != (size,):
            raise InputError(
                f"restrict: give a matrix or a vector of all {size} degrees of freedom of "
                f"body.basis, got shape {shape}"
            )
        if shape != (size, size):
            return self.extension.T @ x
        restricted = self.extension.T @ sp.csc_array(x) @ self.extension
        restricted.sort_indices()
        return restricted

    def from_coarser(self, coarse: Discretisation) -> sp.csr_array:
        """The matrix that turns values of the unknowns on a coarser mesh into values on this one.

        Parameters
        ----------
        coarse : Discretisation
            Of the same mesh, with no more refinements and no higher degree: each of its functions
            is one of these too. Where unknowns are turned, up to the change of the normals.

        Returns
        -------
        sparse, shape (dim, coarse.dim)
        """
        times = self.refinements - coarse.refinements
        values = nested(coarse.mesh, coarse.scalar.elem, times, self.scalar.elem)
        if self.components > 1:
            at = self.nodes.ravel(), coarse.nodes.ravel()
            fine, old = (sp.eye_array(one.size, format="csr")[one] for one in at)
            values = fine.T @ sp.block_diag([values] * self.components) @ old
        return sp.csr_array(self.extension.T @ values @ coarse.extension)

    def interpolate(self, function: Any, name: str = "function") -> Array:
        """Nodal values of a function of x (shape (d, N)) at the unknowns, shape (dim,).

        Of a vector a list of data, one for each component. The name is what errors call it.
        """
        coefficient, full = Coefficient(name), np.zeros(self.nodes.size)
        parts = coefficient.parts(function, self.components)
        full[self.nodes] = [coefficient.values(datum, self.points.T) for datum in parts]
        return self.restrict(full)

    def rows(self, basis: Any, values: Any) -> sp.csr_array:
        """Rows of the unknowns' values at the points of a quadrature, point after point.

        Parameters
        ----------
        values : array_like, shape (basis functions of a cell, rows of a point, cells, points)
            What each basis function adds to each row.
        """
        values = np.asarray(values)
        at = np.arange(values[0].size).reshape(*values.shape[2:], -1)
        dofs = basis.element_dofs[:, None, :, None]
        full = sparse_matrix(values, np.moveaxis(at, -1, 0), dofs, (at.size, basis.N))
        return full @ self.extension

    def place(self, on: Sequence[str], *, nodal: bool = False, strains: bool = False) -> Place:
        """Where an effect acts: boundaries, subdomains, or all of the body ("body").

        Parameters
        ----------
        on : sequence of str
            Errors call them so. Empty is all of it, whatever has the name "body".
        nodal : bool
            With the scalar element and a quadrature whose points are the nodes.
        strains : bool
            With the quadrature of `basis`, in cells; the other has an order two above what
            products of u on straight edges need.
        """
        inside, boundaries = self.mesh.subdomains or {}, self.mesh.boundaries or {}
        cells, groups, rule = np.arange(self.mesh.nelements), dict[str, Indices](inside), None
        if not strains and (both := [one for one in on if one in inside and one in boundaries]):
            raise InputError(
                f"on: {both[0]!r} is a boundary and a subdomain; give one another name"
            )
        if on and all(name in inside for name in on):
            for name in on:
                _require_some("on", name, inside[name])
            cells = np.unique(np.concatenate([inside[name] for name in on]))
            groups = {name: np.searchsorted(cells, inside[name]) for name in on}
        elif on and (tuple(on) != (BODY,) or BODY in boundaries):
            if strains:
                raise InputError(
                    f"on: name subdomains, or 'body'; there are: {', '.join(inside) or 'none'}"
                )
            return self.on_boundary(on, nodal=nodal)
        elif strains:
            return self.whole
        if nodal:
            rule = self.rule(self.mesh.dim())
        elif strains:
            rule = self.basis.quadrature
        basis = self._integrals(skfem.CellBasis, nodal, quadrature=rule, elements=cells)
        if nodal and self.lumped:
            # each node counts as one in all, shared by the cells at it
            times = np.bincount(self.scalar.element_dofs.ravel())
            basis.dx = 1.0 / times[basis.element_dofs.T]
        return Place(basis, groups, self.scalar.element_dofs[:, cells])

    def on_boundary(self, names: Sequence[str], *, nodal: bool = False) -> Place:
        """Boundaries alone, whatever subdomain has their name; arguments as of `place`."""
        facets, groups = self.facets("on", names)
        rule = self.rule(self.mesh.dim() - 1) if nodal else None
        basis = self._integrals(skfem.FacetBasis, nodal, quadrature=rule, facets=facets)
        return Place(basis, groups, self.facet_nodes(facets))

    def _integrals(self, kind: Any, nodal: bool, **parts: Any) -> Any:
        """A basis of scikit-fem on cells or facets."""
        element = self.scalar.elem if nodal else self._element
        return kind(self.mesh, element, intorder=2 * self.scalar.elem.maxdeg + 2, **parts)

    def rule(self, dimension: int) -> tuple[Array, Array]:
        """A quadrature on cells or facets whose points are the nodes, in their order.

        Trapezoid and its like for P1, exact on linear functions; for P2 Simpson's on edges and the
        middles of edges on triangles, exact on quadratic functions.
        """
        if not dimension:
            return np.empty((0, 1)), np.ones(1)
        points = ELEMENTS[self.element][dimension - 1].doflocs.T
        weights = np.full(dimension + 1, 1 / factorial(dimension + 1))
        if self.element == "P2":
            if dimension == 3:
                raise InputError("on: a volume of P2 elements has no nodal quadrature; use P1")
            weights = np.array([1, 1, 4] if dimension == 1 else [0, 0, 0, 1, 1, 1]) / 6
        if dimension < self.mesh.dim() == 2:  # an edge has its middle between its ends
            order = np.argsort(points[0])
            points, weights = points[:, order], weights[order]
        return points, weights


class Place(NamedTuple):
    """A part of a body, with its groups (subdomains or boundaries) and the nodes of its cells."""

    basis: Any
    groups: Mapping[str, Indices]
    nodes: Indices

    def values(self, coefficient: Coefficient, datum: Datum, t: float | None = None) -> Array:
        """Values at the points of the quadrature, shape (cells, points)."""
        points = self.basis.global_coordinates()
        return coefficient.values(datum, points, self.groups, t)

    @property
    def shares(self) -> Array:
        """Weights of the points in means over their cells, shape (cells, points)."""
        return self.basis.dx / self.basis.dx.sum(axis=1, keepdims=True)


def _require_some(what: str, name: str, members: Any) -> None:
    """Refuse an empty boundary or subdomain, as a condition gives that no point meets."""
    if not len(members):
        raise InputError(f"{what}: {name!r} is empty in this mesh; name a part that is there")


def boundary_names(argument: str, value: object) -> tuple[str, ...]:
    """One name or several as a tuple of distinct strings."""
    names = (value,) if isinstance(value, str) else value
    if (
        not (isinstance(names, (list, tuple)) and names)
        or not all(isinstance(name, str) for name in names)
        or len(set(names)) < len(names)
    ):
        raise InputError(f"{argument} must be a name or distinct names, got {shown(value)}")
    return tuple(names)
