"""Friction: which unknowns rub, how strongly, where, and what they do in a run.

On Gamma_3 the friction traction q = eta d_nu u' + kappa d_nu u satisfies |q| <= g, and
q = -g u'/|u'| where u' != 0; so do the tangential tractions of bodies in the plane and of solids,
and the forces on the face of a sheet. Tested with the basis function of node k it reads

    w_k q_k = (A u' + B u - f)_k,      |q_k| <= g_k.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain
from math import prod
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from sweepopt.checks import at_path, choice, count, vector
from sweepopt.display import Brief, record
from sweepopt.errors import InputError
from sweepopt.fem.fields import Array, Indices, SlipLaw, in_time
from sweepopt.fem.frames import PARALLEL, SMOOTH, normals_at
from sweepopt.fem.mesh import sparse_matrix
from sweepopt.fem.spaces import Discretisation, Place
from sweepopt.linalg import NEGLIGIBLE
from sweepopt.loads import Constant, Separable
from sweepopt.sets import Balls, Box, ConvexSet, SecondOrderCone, images, product

if TYPE_CHECKING:
    from sweepopt.fem.effects import Friction
    from sweepopt.fem.scene import Scene
    from sweepopt.results import Solution


@record
class Rows(Brief):
    """Rows E of the velocity whose forces are bounded, those of a block together.

    Attributes
    ----------
    E : sparse, shape (m * block, dim)
    block : int
        Rows of each block: 1 for intervals, 2 for discs, 3 for balls.
    weight : ndarray, shape (m,)
        The length, area or volume that each block stands for in the integral.
    where : {"trace", "nodes", "gradient", "internal"}
        What E u is: unknowns on a boundary, unknowns inside, derivatives, internal unknowns.
    """

    E: sp.csr_array
    block: int
    weight: Array
    where: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "E", sp.csr_array(self.E))


@record
class Yield(Brief):
    """``J(v) = sum_k w_k g_k |E_k v|``: rows with the sets D_k that bound their forces.

    Attributes
    ----------
    rows : Rows
    g : ndarray of shape (m,), Separable or callable t -> (m,)
        Bound of each block's force, per length, area or volume.
    histories : sequence of callable
        Functions of time that g is made of, as data: steps end at their breakpoints.
    slip_metric : as metric, or None
        <slip_metric x, x> is the square of the displacement along the tangents, which `slip` takes.
    label : str
        What errors put in front of g, such as "effects.friction."; a scene sets it.
    metric : ndarray, shape (m, block, block), or None
        Of ellipses: |x| is sqrt(<metric x, x>); None is the Euclidean norm.
    shape : {"ball", "half-line"}
        A half-line is a row that must not be negative: J is 0 where it is not, else inf.
    slopes : ndarray, shape (m,), or None
        J is sum_k w_k g_k a_k where slope_k a_k >= |v_k|, else inf, (a_k, v_k) the rows of a block:
        forces are in shifted cones.
    contact : Contact or None
        Where friction acts, for reports.
    slip : SlipLaw or None
        phi: g_k phi(|E_k u|) takes the place of g_k, which does not move then.
    """

    rows: Rows
    g: Array | Callable[[float], Array]
    metric: Array | None = None
    shape: str = "ball"
    slopes: Array | None = None
    contact: Contact | None = None
    slip: SlipLaw | None = None
    histories: Sequence[Callable[[float], Any]] = ()
    slip_metric: Array | None = None
    label: str = ""

    def check(self, start: float) -> None:
        """Refuse numbers, at the start, that do not belong to these rows, as users write them."""
        rows = self.rows
        choice("shape", self.shape, ("ball", "half-line"))
        choice("rows.where", rows.where, ("trace", "nodes", "gradient", "internal"))
        blocks, rest = divmod(rows.E.shape[0], count("rows.block", rows.block))
        if rest:
            raise InputError(f"rows.E has {rows.E.shape[0]} rows, no blocks of {rows.block}")
        g = self.g(start) if callable(self.g) else self.g
        _require_bounds(self.factors, vector("g", g, blocks if np.ndim(g) else None, finite=False))
        _require_bounds("rows.weight", vector("rows.weight", rows.weight, blocks))

    def at(self, t: float, u: Array | None = None) -> Array:
        """Radii w_k g_k at a time and a state, the unslipped one if there is none, shape (m,)."""
        with at_path(self.label):
            g = self.g(t) if callable(self.g) else self.g
            _require_bounds(self.factors, g)
        radii = np.multiply(self.rows.weight, g)  # lists of a user, too
        if self.slip is None or u is None:
            return radii
        displacement = (self.rows.E @ u).reshape(-1, self.rows.block)
        G = self.slip_metric
        along = displacement if G is None else np.einsum("kij,kj->ki", G, displacement)
        return radii * self.slip(np.sqrt((displacement * along).sum(axis=1)))

    @property
    def factors(self) -> str:
        """What errors call g."""
        return "g times its history" if self.histories else "g"

    def sizes(self, forces: Array) -> Array:
        """Those of forces in the norms whose balls are the D_k, signed of one row, shape (m,)."""
        x = (self.rows.E @ forces).reshape(-1, self.rows.block)
        if self.metric is not None:
            x = np.linalg.solve(np.linalg.cholesky(self.metric), x[..., None])[..., 0]
        return x[:, 0] if self.rows.block == 1 else np.linalg.norm(x, axis=1)

    @property
    def tangential(self) -> Array:
        """Of blocks of one row the length along the tangents for a unit of its row, shape (m,)."""
        if self.rows.block > 1 or self.slip_metric is None:
            return np.ones(len(self.rows.weight))
        return np.sqrt(self.slip_metric[:, 0, 0])

    @property
    def euclidean_rows(self) -> sp.csr_array:
        """Rows in which |x| is the Euclidean norm."""
        if self.metric is None:
            return self.rows.E
        root = np.linalg.cholesky(self.metric).transpose(0, 2, 1)
        at = np.arange(len(root) + 1)
        return sp.csr_array(sp.bsr_array((root, at[:-1], at)) @ self.rows.E)

    @property
    def lipschitz(self) -> sp.csc_array:
        """``sum_k w_k g_k lip(phi) E_k^T E_k``, the matrix of a `StateDependent` C."""
        assert self.slip is not None
        slopes = self.at(0.0) * self.slip.lipschitz
        if self.metric is not None:
            slopes = slopes * np.sqrt(np.linalg.eigvalsh(self.metric)[:, -1])
        E = self.rows.E
        return sp.csc_array(E.T @ sp.diags_array(np.repeat(slopes, self.rows.block)) @ E)


def _require_bounds(name: str, values: Any) -> None:
    """Refuse negative bounds of forces."""
    if np.min(values) < 0:
        remedy = "; give it an offset" if "history" in name else ""
        raise InputError(f"{name} must be >= 0, got {np.min(values):g}{remedy}")


def by_history(yields: Sequence[Yield]) -> list[tuple[Any, list[Yield]]]:
    """For each history the yields whose bounds it multiplies, a constant one where bounds rest.

    Empty where a bound moves in another way.
    """
    groups, rest = dict[int, tuple[Any, list[Yield]]](), Constant()
    for one in yields:
        terms = one.g.terms if isinstance(one.g, Separable) else [(rest, one.g)]
        (phi, g), *others = terms
        if others or callable(g):
            return []
        groups.setdefault(id(phi), (phi, []))[1].append(replace(one, g=g))
    return list(groups.values())


def dissipation(yields: Sequence[Yield]) -> Callable[..., ConvexSet]:
    """(t, u) -> ``D = sum_k E_k^T D_k``: the image of a product of intervals, discs and cones.

    Ellipses are discs of other rows. Beside discs or balls alone intervals are those of a row and
    zeros, so that all have one dimension, as path "cones" asks for.
    """
    dims = {one.rows.block for one in yields} - {1}
    balls = all(one.shape == "ball" and one.slopes is None for one in yields)
    least = max(dims) if balls and len(dims) == 1 else 1
    blocks = [max(one.rows.block, least) for one in yields]
    E = [
        sp.kron(one.euclidean_rows, np.eye(block // one.rows.block, 1))
        for one, block in zip(yields, blocks, strict=True)
    ]
    of_forces = images(sp.csc_array(sp.vstack(E).T))

    def at(t: float = 0.0, u: Array | None = None) -> ConvexSet:
        parts = [_set_of(one, block, t, u) for one, block in zip(yields, blocks, strict=True)]
        return of_forces(parts[0] if len(parts) == 1 else product(*parts))

    return at


def _set_of(one: Yield, block: int, t: float, u: Array | None) -> ConvexSet:
    """The product of the sets D_k."""
    radii = one.at(t, u)
    if one.shape == "half-line":
        return Box(np.full(radii.size, -np.inf), np.zeros(radii.size))
    if one.slopes is not None:
        return np.kron(radii, np.eye(1, block)[0]) - SecondOrderCone(block, one.slopes)
    return Box(-radii, radii) if block == 1 else Balls(radii, block)


@record
class Contact(Brief):
    """Nodes with friction; along a curve in the order in which one walks along it.

    Walked with the body on the left; pieces of a boundary follow one another. Clamped nodes and
    nodes with g = 0 are left out: there is nothing nonsmooth at them.

    Attributes
    ----------
    unknown : ndarray, shape (m,) or (m, components)
        Index of each among the unknowns of the problem; where several components slip a row for
        each node, with -1 for those that do not.
    node, points : ndarray, shape (m,) and (m, d)
        Among the nodes of the body, and where.
    boundary : ndarray of str, shape (m,)
        Name of the boundary or subdomain it is on.
    arc : ndarray, shape (m,)
        Arc length along the boundaries, one after the other; nan where there is no curve.
    parts : sparse, shape (m, facets and cells of the mesh)
        What each node stands for of each facet or cell with friction, whose sum is w_k.
    bound : ndarray, shape (m,)
        g_k of ``J_h(v) = sum_k w_k g_k |v_k|``; of a bound that moves that at the start.
    """

    unknown: Indices
    node: Indices
    points: Array
    boundary: Array
    arc: Array
    parts: sp.csr_array
    bound: Array

    def __len__(self) -> int:
        return len(self.unknown)

    @cached_property
    def weight(self) -> Array:
        """w_k, a length, an area or a volume: the sum of its parts, shape (m,)."""
        return self.parts.sum(axis=1)

    @property
    def threshold(self) -> Array:
        """Friction forces ``w_k g_k`` at which the nodes slip, shape (m,)."""
        return self.weight * self.bound

    @property
    def shares(self) -> Array:
        """Of the contact's length or area that the nodes stand for, shape (m,)."""
        return self.weight / self.weight.sum()

    @property
    def on_curve(self) -> bool:
        """Whether all nodes follow one another along curves."""
        return not np.isnan(self.arc).any()

    def of(self, values: ArrayLike) -> Array:
        """Values of the unknowns (last axis) at the nodes, 0 where a component does not slip."""
        values = np.asarray(values)
        return np.where(self.unknown >= 0, values[..., self.unknown], 0.0)


def merged(contacts: Sequence[Contact]) -> Contact | None:
    """The contacts as one: a node or a facet that is in several of them is there once."""
    if not contacts:
        return None

    def joined(name: str) -> Any:
        return np.concatenate([getattr(one, name) for one in contacts])

    unknown, keep, owner = _owners(contacts)
    threshold = np.bincount(owner, joined("threshold"))
    each = sp.coo_array(sp.vstack([one.parts for one in contacts]))
    once = sp.lil_array((keep.size, each.shape[1]))
    once[owner[each.row], each.col] = each.data  # the same of all that act on a facet
    parts = sp.csr_array(once)
    before = np.cumsum([0.0, *(one.weight.sum() for one in contacts)])[:-1]
    arc = joined("arc") + np.repeat(before, list(map(len, contacts)))
    node, points, boundary = (joined(name)[keep] for name in ("node", "points", "boundary"))
    unknown = unknown[keep]
    if (unknown >= 0).sum(axis=1).max() == 1:
        unknown = unknown.max(axis=1)
    weight = parts.sum(axis=1)
    return Contact(unknown, node, points, boundary, arc[keep], parts, threshold / weight)


def _owners(contacts: Sequence[Contact]) -> tuple[Indices, Indices, Indices]:
    """Unknowns of all nodes, a row each; the first of equal rows; for each row which of these."""
    every = np.vstack([one.unknown.reshape(len(one), -1) for one in contacts])
    _, first, group = np.unique(every, axis=0, return_index=True, return_inverse=True)
    keep = np.sort(first)
    return every, keep, np.searchsorted(keep, first[group.ravel()])


def friction_on(body: Discretisation, law: Friction) -> list[Yield]:
    """Friction with the bound g, or g p, lumped by nodal quadrature.

    Trapezoid (P1) or Simpson (P2) on every edge, with the length element of a curved edge taken
    at its nodes; a third of a triangle at its corners (P1) or at the middles of its edges (P2). The
    nodes of the rule are those of the element, so that ``J_h(v) = sum_k w_k g_k |v_k|`` stays
    separable. Where v does not change sign within a cell the error is O(h^2) for P1 and O(h^4)
    for P2 on edges; on edges where it does, O(h^2) of the edge's own share in both, as |v| has a
    kink.

    Returns
    -------
    list of Yield
        One for each number of components that slip at a node: fewer where some are held.

    Raises
    ------
    InputError
        If all of it is clamped.
    """
    place = body.place(law.on, nodal=True)
    nodes, N = place.nodes.T, body.scalar.N

    def moving_bound(k: Indices, t: float) -> Array:
        return _thresholds(law, place, N, t, law.history)[k] / weight[k]

    weight = np.bincount(nodes.ravel(), place.basis.dx.ravel(), N)
    parts = _parts(body, place)
    threshold, at_start = (
        _thresholds(law, place, N, body.start, phi) for phi in (None, law.history)
    )
    finite = np.isfinite(threshold).all()
    by_formula = in_time(law.g) or in_time(law.p) or (law.history is not None and not finite)
    if law.slip is not None and (law.history is not None or by_formula or not finite):
        raise InputError(
            "slip: a law of the slip multiplies a finite bound that does not move in time; leave "
            "history and t out"
        )
    boundary = hasattr(place.basis, "normals")
    along, names, arc = _nodes_of(body, place)
    first = np.sort(np.unique(along, return_index=True)[1])
    node = along[first]
    unknown, rows, tangents = _slipping(body, node, law.on if boundary else ())
    sizes = rows.any(axis=2).sum(axis=1)
    if not sizes.any():
        raise InputError(f"on: all of {', '.join(law.on)} is clamped; nothing can slip there")
    keep = (sizes > 0) & (weight[node] > 0.0) & (by_formula | (threshold[node] > 0.0))
    yields = []
    for block in np.unique(sizes[keep]).tolist():
        mine = keep & (sizes == block)
        k, at, some = node[mine], first[mine], rows[mine, :block]
        bound = threshold[k] / weight[k]
        if block > 1 and not np.isfinite(bound).all():
            raise InputError("g is inf where two components could slip; hold them instead")
        contact = Contact(
            unknown[mine], k, body.points[k], names[at], arc[at], parts[k], at_start[k] / weight[k]
        )
        metric, of_slip = (_metric(body, some @ tangents[mine], axes) for axes in (law.axes, None))
        blocks = Rows(_at_nodes(body, k, some), block, weight[k], "trace" if boundary else "nodes")
        g = partial(moving_bound, k) if by_formula else bound
        if law.history is not None and not by_formula:
            g = Separable([(law.history, bound)])
        histories = () if law.history is None else (law.history,)
        yields.append(Yield(blocks, g, metric, "ball", None, contact, law.slip, histories, of_slip))
    return yields


def _at_nodes(body: Discretisation, nodes: Indices, rows: Array) -> sp.csr_array:
    """Rows of the unknowns from rows of the directions of nodes, shape (m, block, d)."""
    row, dofs = np.arange(rows[..., 0].size).reshape(len(rows), -1, 1), body.nodes.T[nodes, None]
    E = sparse_matrix(rows, row, dofs, (row.size, body.nodes.size))[:, body.free]
    E.eliminate_zeros()
    return E


def _thresholds(law: Friction, place: Place, size: int, t: float, phi: Any) -> Array:
    """Friction forces, times a history, at which the nodes slip, of all nodes, shape (size,)."""
    factor = 1.0 if phi is None else float(phi(t))
    with np.errstate(invalid="ignore"):
        forces = factor * prod(law.values_at(place, t)) * place.basis.dx
    forces[np.isnan(forces)] = 0.0  # one of them is 0, another is infinite
    return np.bincount(place.nodes.T.ravel(), forces.ravel(), size).astype(float)


def _parts(body: Discretisation, place: Place) -> sp.csr_array:
    """What each node stands for of each facet, and behind these of each cell."""
    mesh, basis = body.mesh, place.basis
    of_cells = mesh.nfacets + np.arange(mesh.nelements)
    at = basis.find if hasattr(basis, "normals") else of_cells[basis.tind]
    nodes = place.nodes.T  # of a lumped body each is its own facet, and all of its cell
    columns, shape = (
        nodes if body.lumped else at[:, None],
        (body.scalar.N, mesh.nfacets + mesh.nelements),
    )
    return sparse_matrix(basis.dx, nodes, columns, shape)


def _slipping(
    body: Discretisation, nodes: Indices, names: Sequence[str]
) -> tuple[Indices, Array, Array]:
    """What slips at nodes: unknowns for reports, -1 for others, rows of v, and tangents.

    A direction of a node slips if it is not held and has a tangential part. The rows of a node are
    these directions if their tangential parts are independent, else combinations of them. Rows of
    zeros follow.
    """
    tangents = _tangents(body, nodes, names)
    left, lengths, _ = np.linalg.svd(tangents)
    sizes, rubs = (lengths > PARALLEL).sum(axis=1, keepdims=True), tangents.any(axis=2)
    alone, slot = rubs.sum(axis=1, keepdims=True) == sizes, np.arange(body.components)
    chosen = np.eye(body.components)[np.argsort(~rubs, axis=1, kind="stable")]
    rows = np.where(alone[..., None], chosen, left.transpose(0, 2, 1))
    unknown = np.searchsorted(body.free, body.nodes.T[nodes])
    in_reports = rubs & (alone | (slot > 0))
    return np.where(in_reports, unknown, -1), rows * (slot < sizes)[..., None], tangents


def _tangents(body: Discretisation, nodes: Indices, names: Sequence[str]) -> Array:
    """Tangential parts of the directions of nodes on boundaries that are not held, shape (m, d, d).

    The normal of the boundaries is held, or the first direction of a node, or close to it; else, or
    where an axis is held, as on a slanted wall, all directions have parts in the tangent plane.
    Without names all are tangential.
    """
    slot, tangents = np.arange(body.components), body.frame.basis[nodes]
    rubs = slot >= body.frame.held[nodes, None]
    if names and body.components > 1:
        at, normals = normals_at(body, names)
        normal = normals[np.searchsorted(at, nodes), None]
        along = (tangents * normal).sum(axis=2)
        others = rubs & (slot > 0)
        corner = np.linalg.norm(along * others, axis=1, keepdims=True) > SMOOTH
        axial = [name for name, what in body.held.items() if what != "n"]
        if axial:
            corner |= np.isin(nodes, body.on_boundary(axial).nodes)[:, None]
        tangents = tangents - (along * corner)[..., None] * normal
        rubs = np.where(corner, rubs & (np.linalg.norm(tangents, axis=2) > PARALLEL), others)
    return tangents * rubs[..., None]


def _metric(body: Discretisation, tangents: Array, axes: Any) -> Array | None:
    """|diag(axes) v|^2 of velocities along tangents, block by block; None if it is |v|^2."""
    if axes is not None:
        tangents = tangents * vector("axes", axes, body.components)
    metric = tangents @ tangents.transpose(0, 2, 1)
    return None if np.allclose(metric, np.eye(metric.shape[1]), rtol=0.0, atol=PARALLEL) else metric


def _nodes_of(body: Discretisation, place: Any) -> tuple[Indices, Array, Array]:
    """The nodes of all cells in turn, the names of their groups, and their arc lengths.

    Edges are walked with the body on the left: the outward normal is on the right.
    """
    nodes, groups = place.nodes.T, place.groups
    names = np.full(nodes.shape, "body", dtype=object)
    for name, members in reversed(groups.items()):
        names[members] = name
    arc = np.full(nodes.shape, np.nan)
    if hasattr(place.basis, "normals") and body.mesh.dim() == 2:
        x, y = (body.points[nodes[:, -1]] - body.points[nodes[:, 0]]).T
        normal_x, normal_y = place.basis.normals.mean(axis=2)
        nodes = np.where((x * normal_y < y * normal_x)[:, None], nodes, nodes[:, ::-1])
        each = (mine[_walk(body.points, nodes[mine])].tolist() for mine in groups.values())
        order = list(dict.fromkeys(chain.from_iterable(each)))  # some are in two groups
        length = place.basis.dx[order].sum(axis=1)
        ends = np.cumsum(length)
        arc = np.linspace(ends - length, ends, nodes.shape[1], axis=1)
        nodes, names = nodes[order], names[order]
    return nodes.ravel(), names.ravel().astype(str), arc.ravel()


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
    order: dict[int, None] = {}
    for k in np.lexsort((-points[tail, 0], np.isin(tail, head))).tolist():
        while k is not None and k not in order:
            order[k] = None
            k = leaving.get(head[k])
    return list(order)


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
    largest_total : float
        The largest int |u'| dt of the nodes.
    """

    ever: float
    most: float
    time_of_most: float | None
    switches: int
    largest_total: float


@dataclass(frozen=True, eq=False)
class Slip:
    """What m contact nodes do in n steps.

    Attributes
    ----------
    contact : Contact
    t : ndarray, shape (n+1,)
    stage_t : ndarray, shape (n,)
        Where in each step the traction is taken: at the scheme's stage, so that |q| <= g holds as
        exactly as the step is certified. For schemes of several stages, and steps in parts, it is
        that of the mean velocity in the middle: off by the error of the step, also above g.
    displacement : ndarray, shape (n+1, m) or (n+1, m, components)
    velocity : ndarray, shape (n, m) or (n, m, components)
        Exactly 0.0 where a node sticks, and where it is rounding beside the largest of the run.
    traction : ndarray, shape (n, m) or (n, m, components)
        q_k, against the velocity; nan where a part of A u' + B u - f is another bounded force
        whose share is not known: of a yield stress, one-way motion, friction along other tangents;
        and, as the bound, at nodes that rub along an edge of a sheet and over its face.
    bound : ndarray, shape (n, m)
        g_k at these times and states, which a law of the slip or a bound that moves changes.
    use : ndarray, shape (n, m)
        Share of the bound that the traction takes, with its sign where it has one; of ellipses in
        their own metric: 1 is on the ellipse. It is nan where the traction is, and of several
        frictions with other axes at a node it is meant for one alone, as their sum is no ellipse.
    """

    contact: Contact
    t: Array
    stage_t: Array
    displacement: Array
    velocity: Array
    traction: Array
    bound: Array
    use: Array

    @cached_property
    def state(self) -> Array:
        """1, 0 or -1: slips (forward), sticks, slips backward; shape (n, m)."""
        return np.sign(signed_lengths(self.velocity)).astype(np.int8)

    @property
    def speed(self) -> Array:
        """|u'| of each node, shape (n, m)."""
        return np.abs(signed_lengths(self.velocity))

    @cached_property
    def total(self) -> Array:
        """int |u'| dt of each node, shape (m,)."""
        return np.diff(self.t) @ self.speed

    def statistics(self) -> SlipStatistics:
        """The slip statistics of the run."""
        slipping = self.state != 0
        shares = slipping @ self.contact.shares  # of each step
        most = np.argmax(shares)
        return SlipStatistics(
            ever=float(slipping.any(axis=0) @ self.contact.shares),
            most=float(shares[most]),
            time_of_most=float(self.t[most + 1]) if slipping.any() else None,
            switches=int(np.count_nonzero(slipping[:-1] != slipping[1:])),
            largest_total=float(self.total.max()),
        )


def signed_lengths(x: Array) -> Array:
    """Numbers of shape (n, m) as they are, the lengths of vectors of shape (n, m, d)."""
    return x if x.ndim == 2 else np.linalg.norm(x, axis=2)


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
    process, scheme = solution.process, solution.plan.scheme
    mu = np.diff(solution.t)
    stage_t = solution.t[:-1] + np.dot(scheme.b, scheme.c) * mu
    implicit = np.dot(scheme.b, [sum(row) for row in scheme.a])
    rubbing: Any = [one for one in scene.yields if one.contact is not None]
    _, keep, owner = _owners([one.contact for one in rubbing])
    force, sizes, radii = [], [], []
    for t, h, u, z in zip(stage_t.tolist(), mu, solution.u[:-1], solution.velocity, strict=True):
        u = u + implicit * h * z
        q = process.A @ z + process.times_B(u) - scene.load(t)
        force.append(contact.of(q))
        sizes.append(np.concatenate([one.sizes(q) for one in rubbing])[keep])
        radii.append(np.bincount(owner, np.concatenate([one.at(t, u) for one in rubbing])))
    several, bound, use = contact.unknown.ndim > 1, np.array(radii), np.array(sizes)
    lengths = np.concatenate([one.tangential for one in rubbing])
    apart = np.abs(lengths - lengths[keep][owner]) > PARALLEL  # frictions of other tangents
    along = lengths[keep][:, None] if several else lengths[keep]
    use = np.divide(np.abs(use) if several else use, bound, out=0 * use, where=bound > 0)
    velocity = contact.of(solution.velocity) * along
    speed = np.abs(signed_lengths(velocity))
    # a body that creeps to its equilibrium ends with the rounding of its forces: 2e-14 were seen
    velocity[speed <= NEGLIGIBLE * speed.max()] = 0.0
    acts = sp.vstack([one.rows.E for one in scene.yields]) != 0
    laws = contact.of(acts.T @ acts.sum(axis=1))  # more than one of a row that combines unknowns
    mixed = (laws.max(axis=1) if several else laws) > np.bincount(owner, ~apart)
    facets = scene.discretisation.mesh.nfacets
    of_facets, of_cells = contact.parts[:, :facets], contact.parts[:, facets:]
    one_kind = (of_facets.sum(axis=1) == 0) | (of_cells.sum(axis=1) == 0)
    size = np.where(one_kind, contact.weight, np.nan)  # no sum of a length and an area
    weight = np.where(mixed, np.nan, size)
    return Slip(
        contact=contact,
        t=solution.t,
        stage_t=stage_t,
        displacement=contact.of(solution.u) * along,
        velocity=velocity,
        traction=force / ((weight[:, None] if several else weight) * along),
        bound=bound / size,
        use=np.where(mixed, np.nan, use),
    )
