"""The forms of the antiplane model: stiffness, loads and the lumped friction functional.

a(u, v) = int_Omega c grad u . grad v      (c = eta or kappa)
<f, v>  = int_Omega f0 v,   int_{Gamma_2} f2 v
J_h(v)  = sum_k w_k g_k |v_k|              (nodes k of Gamma_3)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
import skfem
from numpy.typing import ArrayLike, NDArray
from skfem.helpers import dot, grad

from sweepopt.errors import InputError
from sweepopt.fem.discretisation import ELEMENTS, QUADRATURE, Discretisation
from sweepopt.fem.fields import FRICTION, Datum, Range, evaluate
from sweepopt.fem.mesh import Indices

Array = NDArray[np.float64]

NODES = {"P1": ([0.0, 1.0], [1 / 2, 1 / 2]), "P2": ([0.0, 0.5, 1.0], [1 / 6, 4 / 6, 1 / 6])}
"""Nodal quadrature on an edge: trapezoid for P1, Simpson for P2."""


def stiffness(body: Discretisation, name: str, coefficient: Datum, allowed: Range) -> sp.csc_array:
    """Matrix of ``int c grad u . grad v`` on the unknowns, shape (dim, dim)."""
    basis = body.basis
    x = np.asarray(basis.global_coordinates())
    values = evaluate(name, coefficient, x, body.mesh.subdomains or {}, allowed)
    form = skfem.BilinearForm(lambda u, v, w: w.c * dot(grad(u), grad(v)))
    with np.errstate(over="ignore", invalid="ignore"):
        full = form.assemble(basis, c=skfem.DiscreteField(values))
        matrix = body.restrict((full + full.T) / 2)
    refuse_overflow(name, matrix.data)
    return matrix


def volume_load(body: Discretisation, name: str, density: Datum) -> Array:
    """Vector of ``int_Omega f0 v`` on the unknowns, shape (dim,)."""
    x = np.asarray(body.basis.global_coordinates())
    values = evaluate(name, density, x, body.mesh.subdomains or {})
    return np.asarray(body.restrict(_load(name, body.basis, values)))


def boundary_load(body: Discretisation, name: str, on: Sequence[str], density: Datum) -> Array:
    """Vector of ``int_{Gamma_2} f2 v`` on the unknowns, shape (dim,)."""
    facets = body.facets("on", on)
    basis = skfem.FacetBasis(
        body.mesh, ELEMENTS[body.element], facets=facets, intorder=QUADRATURE[body.element]
    )
    x = np.asarray(basis.global_coordinates())
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
    x = np.asarray(basis.global_coordinates())
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
