"""The contact boundary: which unknowns rub, how strongly, where, and what they do in a run.

On Gamma_3 the friction traction q = eta d_nu u' + kappa d_nu u satisfies |q| <= g, and
q = -g u'/|u'| where u' != 0. Tested with the basis function of node k it reads

    w_k q_k = (A u' + B u - f)_k,      |q_k| <= g_k.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy.sparse as sp
import skfem
from numpy.typing import NDArray
from scipy.integrate import newton_cotes

from sweepopt.errors import InputError
from sweepopt.fem.fields import Coefficient, Datum
from sweepopt.fem.mesh import Indices
from sweepopt.fem.spaces import Discretisation
from sweepopt.sets import Box, ConvexSet, image

if TYPE_CHECKING:
    from sweepopt.fem.scene import Scene
    from sweepopt.results import Solution

Array = NDArray[np.float64]

BOUND = Coefficient("g", 0.0, finite=False)
STATES = {-1: "slips_backward", 0: "sticks", 1: "slips_forward"}


@dataclass(frozen=True, eq=False)
class Contact:
    """Unknowns with friction, in the order in which one walks along the boundary.

    Walked with the body on the left; pieces of a boundary follow one another. Clamped nodes and
    nodes with g = 0 are left out: there is nothing nonsmooth at them.

    Attributes
    ----------
    unknown : ndarray, shape (m,)
        Index of each among the unknowns of the problem.
    points : ndarray, shape (m, 2)
    boundary : ndarray of str, shape (m,)
        Name of the boundary it is on.
    arc : ndarray, shape (m,)
        Arc length along the boundaries, one after the other.
    weight, bound : ndarray, shape (m,)
        w_k (a length) and g_k of ``J_h(v) = sum_k w_k g_k |v_k|``.
    """

    unknown: Indices
    points: Array
    boundary: NDArray[np.str_]
    arc: Array
    weight: Array
    bound: Array

    def __len__(self) -> int:
        return int(self.unknown.size)

    @property
    def threshold(self) -> Array:
        """Friction forces ``w_k g_k`` at which the nodes slip, shape (m,)."""
        return self.weight * self.bound

    def dissipation(self, dim: int) -> ConvexSet:
        """D = E^T [-w g, w g], E selecting the contact unknowns: J_h is its support function."""
        m = len(self)
        select = sp.csc_array((np.ones(m), (self.unknown, np.arange(m))), shape=(dim, m))
        return image(select, Box(-self.threshold, self.threshold))


def contact_on(body: Discretisation, on: Sequence[str], g: Datum) -> Contact:
    """Contact of the boundaries `on` with friction bound `g`, lumped by nodal quadrature.

    Trapezoid (P1) or Simpson (P2) on every edge, with the length element of a curved edge taken
    at its nodes. The nodes of the rule are those of the element, so that
    ``J_h(v) = sum_k w_k g_k |v_k|`` stays separable: the dissipation is a box on the contact
    unknowns. Where v does not change sign within an edge the error is O(h^2) for P1 and O(h^4)
    for P2; on edges where it does, O(h^2) of the edge's own share in both, as |v| has a kink.

    Raises
    ------
    InputError
        If all of it is clamped.
    """
    facets, groups = body.edges("on", on)
    degree = body.basis.elem.maxdeg
    rule = np.linspace([0.0], [1.0], degree + 1, axis=1), newton_cotes(degree)[0] / degree
    basis = skfem.FacetBasis(body.mesh, body.basis.elem, facets=facets, quadrature=rule)
    weights, bounds = basis.dx, BOUND.values(g, basis.global_coordinates(), groups)
    nodes = body.edge_nodes(facets).T
    weight, threshold = (
        np.bincount(nodes.ravel(), shares.ravel(), body.basis.N)
        for shares in (weights, weights * bounds)
    )

    # walked with the body on the left, where the outward normal is on the right
    x, y = (body.points[nodes[:, -1]] - body.points[nodes[:, 0]]).T
    normal_x, normal_y = basis.normals.mean(axis=2)
    along = np.where((x * normal_y < y * normal_x)[:, None], nodes, nodes[:, ::-1])
    order = np.concatenate([mine[_walk(body.points, along[mine])] for mine in groups.values()])
    length = weights[order].sum(axis=1)
    ends = np.cumsum(length)
    arc = np.linspace(ends - length, ends, nodes.shape[1], axis=1).ravel()
    boundary = np.repeat(on, [nodes.shape[1] * len(mine) for mine in groups.values()])

    node, first = np.unique(along[order], return_index=True)
    free = np.isin(node, body.free)
    if not free.any():
        raise InputError(f"on: all of {', '.join(on)} is clamped; nothing can slip there")
    keep = np.sort(first[free & (threshold[node] > 0.0)])
    k = along[order].ravel()[keep]
    return Contact(
        unknown=np.searchsorted(body.free, k),
        points=body.points[k],
        boundary=boundary[keep],
        arc=arc[keep],
        weight=weight[k],
        bound=threshold[k] / weight[k],
    )


def _walk(points: Array, along: Indices) -> list[int]:
    """The order in which edges follow one another: open pieces, then closed from their largest x.

    Parameters
    ----------
    points : ndarray, shape (N, 2)
    along : ndarray, shape (m, 2 or 3)
        The nodes of each edge, first the one where a walk enters it.
    """
    tail, head = along[:, 0], along[:, -1]
    leaving = {node: k for k, node in enumerate(tail.tolist())}
    walked: dict[int, None] = {}
    for k in np.lexsort((-points[tail, 0], np.isin(tail, head))).tolist():
        while k is not None and k not in walked:
            walked[k] = None
            k = leaving.get(head[k])
    return list(walked)


class SlipStatistics(NamedTuple):
    """How much of the contact slips, how often and how far; shares are of its length.

    Attributes
    ----------
    ever, most : float
        Share that slips at some time, and the largest share that slips at once.
    time_of_most : float or None
        End of the first step with that share; None if nothing slips.
    switches : int
        Changes from stick to slip or back, over all nodes and steps.
    reversals : int
        Changes of the direction of slip without a stuck step between.
    largest_total, mean_total : float
        int |u'| dt: its largest value, and its mean over the contact.
    """

    ever: float
    most: float
    time_of_most: float | None
    switches: int
    reversals: int
    largest_total: float
    mean_total: float


@dataclass(frozen=True, eq=False)
class Slip:
    """What m contact nodes do in n steps.

    Attributes
    ----------
    contact : Contact
    t : ndarray, shape (n+1,)
    stage_t : ndarray, shape (n,)
        Where in each step the traction is taken: at the scheme's stage, so that |q| <= g holds as
        exactly as the step is certified; in the middle for schemes of several stages.
    displacement : ndarray, shape (n+1, m)
    velocity : ndarray, shape (n, m)
        Exactly 0.0 where a node sticks.
    traction : ndarray, shape (n, m)
        q_k, against the velocity.
    """

    contact: Contact
    t: Array
    stage_t: Array
    displacement: Array
    velocity: Array
    traction: Array

    @cached_property
    def state(self) -> NDArray[np.int8]:
        """1, 0 or -1: slips forward, sticks, slips backward; shape (n, m)."""
        return np.sign(self.velocity).astype(np.int8)

    @cached_property
    def share(self) -> Array:
        """Share of the contact's length that slips in each step, shape (n,)."""
        weight = self.contact.weight
        return np.minimum((self.state != 0) @ weight / weight.sum(), 1.0)

    @cached_property
    def total(self) -> Array:
        """int |u'| dt of each node, shape (m,)."""
        return np.asarray(np.diff(self.t) @ np.abs(self.velocity))

    def statistics(self) -> SlipStatistics:
        """The slip statistics of the run."""
        weight = self.contact.weight / self.contact.weight.sum()
        slipping = self.state != 0
        before, after = self.state[:-1], self.state[1:]
        most = int(np.argmax(self.share))
        return SlipStatistics(
            ever=min(float(slipping.any(axis=0) @ weight), 1.0),
            most=float(self.share[most]),
            time_of_most=float(self.t[most + 1]) if slipping.any() else None,
            switches=int(np.count_nonzero(slipping[:-1] != slipping[1:])),
            reversals=int(np.count_nonzero(before * after == -1)),
            largest_total=float(self.total.max()),
            mean_total=float(self.total @ weight),
        )


def slip_of(scene: Scene, solution: Solution) -> Slip | None:
    """Stick, slip and friction of a run; None for a scene without friction.

    Parameters
    ----------
    scene : Scene
    solution : Solution
        Of the scene's problem, with one step or more, all of them kept.
    """
    contact = scene.contact
    if contact is None:
        return None
    process, scheme, rows = solution.process, solution.plan.scheme, contact.unknown
    mu = np.diff(solution.t)
    stage_t = solution.t[:-1] + np.dot(scheme.b, scheme.c) * mu
    implicit = np.dot(scheme.b, [sum(row) for row in scheme.a])
    force = np.array(
        [
            (process.A @ z + process.times_B(u + implicit * h * z) - process.C.at(t).anchor)[rows]
            for t, h, u, z in zip(
                stage_t.tolist(), mu, solution.u[:-1], solution.velocity, strict=True
            )
        ]
    )
    return Slip(
        contact=contact,
        t=solution.t,
        stage_t=stage_t,
        displacement=solution.u[:, rows],
        velocity=solution.velocity[:, rows],
        traction=force / contact.weight,
    )
