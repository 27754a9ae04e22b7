"""Sets and the laws they obey: every law runs over every entry of the zoo.

A new shape or operation is one line in ZOO. Each entry states the set a second time, as cvxpy
constraints on w, which share no code with the library: that is what the laws compare with.
"""

import warnings
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property, partial

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp

import sweepopt as so
from sweepopt.checks import vector
from sweepopt.linalg import dense
from sweepopt.sets import Features, NoHalfspacesError, facets, shape_of
from sweepopt.sets.curves import basis

Constraints = list[cp.Constraint]
Build = Callable[..., "Sample"]
EPS = float(np.finfo(float).eps)
# A sum's point where p = 0: the splitting's residual there is of third order in the error of how w
# splits into a + b, w of second order, so that w is known to EPS^(2/3) = 4e-11.
EDGE = 1e-9
PROGRAM = 1e-6  # agreement with the independent solve (Clarabel, inaccurate where it stalls)


@dataclass(frozen=True)
class Sample:
    """A set and, independently of it, the constraints that say the same.

    Attributes
    ----------
    C : ConvexSet
    inside : callable
        cvxpy variable w -> constraints for w in C.
    """

    C: so.ConvexSet
    inside: Callable[[cp.Variable], Constraints]

    @cached_property
    def supremum(self):
        """The program sup { <w, z> : w in C }, with its z and w; cvxpy canonicalises it once."""
        w, z = cp.Variable(self.C.dim), cp.Parameter(self.C.dim)
        return cp.Problem(cp.Maximize(z @ w), self.inside(w)), z, w

    def extreme(self, direction):
        """sup of <w, z> over the set and a point where it is taken, by the independent form."""
        problem, z, w = self.supremum
        z.value = direction
        problem.solve(solver=cp.CLARABEL)
        if problem.status in (cp.UNBOUNDED, cp.UNBOUNDED_INACCURATE):
            return np.inf, None
        assert problem.value is not None, problem.status
        return float(problem.value), w.value

    def violation(self, point):
        """How much `point` violates the independent constraints."""
        w, moved = cp.Variable(self.C.dim), cp.Variable(self.C.dim)
        nearest = cp.Problem(cp.Minimize(cp.norm(moved)), [w == point + moved, *self.inside(w)])
        nearest.solve(solver=cp.CLARABEL)
        assert nearest.value is not None, nearest.status
        return float(nearest.value)


@dataclass(frozen=True)
class Entry:
    """One line of the zoo.

    Attributes
    ----------
    build : callable
        (frame, rng) -> Sample. `frame` decides dim and matrices, `rng` the offsets: two samples
        from one frame have one cone.
    bounded, cone : bool
    tol : float
        Relative accuracy of the projection: rounding unless stated.
    edge_tol : float
        The same at points of the boundary of sums, where how w splits into a + b is singular.
    support_tol : float
        Relative accuracy of the support function: rounding unless a program computes it.
    """

    build: Build
    bounded: bool = True
    cone: bool = False
    tol: float = 1e-12
    edge_tol: float = 1e-12
    support_tol: float = 1e-12

    def sample(self, seed, offsets=0):
        return self.build(np.random.default_rng(seed), np.random.default_rng((seed, offsets)))


def direction(rng, dim):
    """A random vector, now and then with zeros in it."""
    z = rng.normal(size=dim)
    return np.where(rng.random(dim) < 0.2, 0.0, z) if rng.random() < 0.3 else z


def far_and_near(rng, C):
    """A random point of the space of C at a random distance."""
    return 10.0 ** rng.uniform(-1, 1.5) * rng.normal(size=C.dim)


# ---- shapes -----------------------------------------------------------------------------------


def _dim(frame, dim):
    drawn = int(frame.integers(1, 6))
    return drawn if dim is None else dim


def point(frame, rng, dim=None):
    p = rng.normal(size=_dim(frame, dim))
    return Sample(so.Point(p), lambda w: [w == p])


def box(frame, rng, dim=None):
    dim = _dim(frame, dim)
    lower = rng.normal(size=dim)
    upper = lower + rng.exponential(size=dim)
    return Sample(so.Box(lower, upper), lambda w: [w >= lower, w <= upper])


def open_box(frame, rng, dim=None):
    dim = 1 + _dim(frame, dim)
    kind = frame.integers(0, 4, size=dim)
    kind[0] = frame.integers(0, 3)  # one entry at least is unbounded
    lower = np.where(kind % 2, rng.normal(size=dim), -np.inf)
    upper = np.where(kind >= 2, np.nan_to_num(lower, neginf=0) + rng.random(dim), np.inf)
    low, up = np.isfinite(lower), np.isfinite(upper)
    return Sample(
        so.Box(lower, upper),
        lambda w: (
            [w[i] >= lower[i] for i in np.flatnonzero(low)]
            + [w[i] <= upper[i] for i in np.flatnonzero(up)]
        ),
    )


def orthant(frame, rng, dim=None):
    return Sample(so.Orthant(_dim(frame, dim)), lambda w: [w >= 0])


def whole_space(frame, rng, dim=None):
    return Sample(so.WholeSpace(_dim(frame, dim)), lambda w: [])


def ball(frame, rng, dim=None):
    center, radius = rng.normal(size=_dim(frame, dim)), rng.exponential()
    return Sample(so.Ball(center, radius), lambda w: [cp.norm(w - center) <= radius])


def balls(frame, rng, dim=None):
    block, count = int(frame.integers(1, 4)), int(frame.integers(1, 3))
    radii = rng.exponential(size=count)
    return Sample(
        so.Balls(radii, block),
        lambda w: [cp.norm(w[k * block :][:block]) <= radii[k] for k in range(count)],
    )


def ellipsoid(frame, rng, dim=None):
    dim = _dim(frame, dim)
    axes = np.linalg.qr(frame.normal(size=(dim, dim)))[0]
    squares = 10.0 ** np.linspace(-1, 0, dim)
    center, shape = rng.normal(size=dim), (axes * squares) @ axes.T
    shape = 0.5 * (shape + shape.T)
    return Sample(
        so.Ellipsoid(center, shape),
        lambda w: [cp.norm((axes / np.sqrt(squares)).T @ (w - center)) <= 1],
    )


def half_space(frame, rng, dim=None):
    normal, offset = frame.normal(size=_dim(frame, dim)), rng.normal()
    return Sample(so.HalfSpace(normal, offset), lambda w: [normal @ w <= offset])


def polyhedron(frame, rng, dim=None):
    # bounded: the rows surround the origin; some come twice, some are redundant
    dim = _dim(frame, dim)
    G = np.vstack([np.eye(dim), -np.eye(dim), frame.normal(size=(3, dim))])
    G = np.vstack([G, G[:2]])
    x = rng.normal(size=dim)
    h = G @ x + rng.exponential(size=len(G))
    return Sample(so.Polyhedron(sp.csr_array(G), h), lambda w: [G @ w <= h])


def vertex_cone(frame, rng, dim=None):
    # more rows through one vertex than there are unknowns
    dim = _dim(frame, dim)
    G = np.abs(frame.normal(size=(2 * dim + 2, dim)))
    return Sample(so.Polyhedron(G, np.zeros(len(G))), lambda w: [G @ w <= 0])


def flat(frame, rng, dim=None):
    # an equation as two rows: no interior
    dim = 1 + _dim(frame, dim)
    row = frame.normal(size=dim)
    row[:2] = -abs(row[0]), abs(row[1])  # two signs: unbounded
    G = np.vstack([row, -row, np.eye(dim)])
    level, top = rng.normal(), np.abs(rng.normal(size=dim)) + 3
    h = np.concatenate([[level, -level], top])
    return Sample(so.Polyhedron(G, h), lambda w: [row @ w == level, w <= top])


def polytope(frame, rng, dim=None):
    vertices = frame.normal(size=(int(frame.integers(1, 9)), _dim(frame, dim)))

    def inside(w):
        theta = cp.Variable(len(vertices), nonneg=True)
        return [vertices.T @ theta == w, cp.sum(theta) == 1]

    return Sample(so.Polytope(vertices), inside)


def second_order_cone(frame, rng, dim=None):
    dim = _dim(frame, dim)
    inside = [lambda w: [w[0] >= 0], lambda w: [cp.norm(w[1:]) <= w[0]]][dim > 1]
    return Sample(so.SecondOrderCone(dim), inside)


def second_order_cones(frame, rng, dim=None):
    count = int(frame.integers(1, 4)) if dim is None else 1
    block, slopes = _dim(frame, dim), frame.exponential(size=count) + 0.1

    def inside(w):
        rows = cp.reshape(w, (count, block), order="C")
        if block == 1:
            return [rows >= 0]
        return [cp.norm(rows[:, 1:], axis=1) <= cp.multiply(slopes, rows[:, 0])]

    return Sample(so.SecondOrderCone(block, slopes), inside)


def constraints(frame, rng, dim=None):
    dim, center = _dim(frame, dim), rng.normal(size=3)
    return Sample(
        so.Constraints(dim, lambda w: [cp.norm(w - center[0], 1) <= 1, w[0] <= center[0] + 0.5]),
        lambda w: [cp.sum(cp.abs(w - center[0])) <= 1, w[0] <= center[0] + 0.5],
    )


class DiamondBall(so.ConvexSet):
    """{ w : sum |w_i| <= radius }:  sigma(z) = radius max |z_i|."""

    def __init__(self, radius, dim):
        self.radius, self.dim, self.offsets = radius, dim, np.array([radius])

    def support(self, z):
        return float(self.radius * np.abs(vector("z", z, self.dim)).max())

    def project(self, w):
        w = vector("w", w, self.dim)
        sizes = np.sort(np.abs(w))[::-1]
        levels = (np.cumsum(sizes) - self.radius) / np.arange(1, self.dim + 1)
        return np.sign(w) * np.maximum(np.abs(w) - max(levels.max(), 0.0), 0.0)

    def features(self, p):
        size = cp.Variable(1)
        return Features([size], [p <= size, -p <= size])


def diamond(frame, rng, dim=None):
    radius, dim = rng.exponential(), _dim(frame, dim)
    return Sample(DiamondBall(radius, dim), lambda w: [cp.norm1(w) <= radius])


# ---- operations -------------------------------------------------------------------------------


def operation(rule):
    """rule(frame, rng, s, ...) of samples s, as a way to build one from ways to build those.

    `columns` is the dim of the first where that is not the dim of all.
    """

    def on(*builds, columns=None, **settings):
        def make(frame, rng, dim=None):
            samples = [builds[0](frame, rng, columns or dim)]
            samples += [build(frame, rng, samples[0].C.dim) for build in builds[1:]]
            return rule(frame, rng, *samples, **settings)

        return make

    return on


@operation
def translated(frame, rng, s):
    v = rng.normal(size=s.C.dim)
    return Sample(s.C + v, lambda w: s.inside(w - v))


@operation
def scaled(frame, rng, s):
    r = rng.uniform(0.5, 3)
    return Sample(r * s.C, lambda w: s.inside(w / r))


@operation
def negated(frame, rng, s):
    return Sample(-s.C, lambda w: s.inside(-w))


@operation
def moving(frame, rng, s):
    """A snapshot of center(t) + scale(t) C."""
    v, t = rng.normal(size=s.C.dim), rng.uniform()
    C = so.Moving(s.C, center=lambda t: t * v, scale=lambda t: 1 + t).at(t)
    return Sample(C, lambda w: s.inside((w - t * v) / (1 + t)))


@operation
def summed(frame, rng, a, b):
    def inside(w):
        first = cp.Variable(a.C.dim)
        return [*a.inside(first), *b.inside(w - first)]

    return Sample(a.C + b.C, inside)


@operation
def met(frame, rng, a, b, weights=(1,) * 6, far=3.0):
    """C & D with D shifted so that means of some points of each coincide."""
    x, y = (
        np.average([s.C.project(far * rng.normal(size=s.C.dim)) for _ in weights], 0, weights)
        for s in (a, b)
    )
    return common(a, b, x - y)


def touching(one, two):
    """C & D with D shifted so that a point of each boundary coincides: hardly any interior.

    Both are moved inwards by more than the shift rounds, so that it does not part the sets.
    """
    return met(one, two, weights=(1, 1e-13), far=9.0)


@operation
def cut(frame, rng, a, b):
    """C & D as they are: cones meet at 0."""
    return common(a, b, np.zeros(a.C.dim))


def common(a, b, v):
    """C & (D + v)."""
    D = b.C + v if v.any() else b.C
    return Sample(a.C & D, lambda w: [*a.inside(w), *b.inside(w - v)])


@operation
def truncated(frame, rng, s):
    """C & Ball(0, n), as the theory does with unbounded sets."""
    zero = np.zeros(s.C.dim)
    n = 2 + float(np.linalg.norm(s.C.project(zero)))
    return common(s, Sample(so.Ball(zero, n), lambda w: [cp.norm(w) <= n]), zero)


def crossed(*builds):
    def make(frame, rng, dim=None):
        parts = [build(frame, rng) for build in builds]
        cuts = np.cumsum([0] + [s.C.dim for s in parts])

        def inside(w):
            ends = zip(parts, cuts[:-1], cuts[1:], strict=True)
            blocks = [s.inside(w[i:j]) for s, i, j in ends]
            return [constraint for block in blocks for constraint in block]

        return Sample(so.product(*(s.C for s in parts)), inside)

    return make


def selection(frame, dim):
    rows = frame.permutation(dim + 3)[:dim]
    return sp.csc_array((np.ones(dim), (rows, np.arange(dim))), shape=(dim + 3, dim))


def repeated(frame, dim):
    """The last column names the first unknown again."""
    M = np.eye(max(dim - 1, 1), dim)
    M[0, -1] = 1.0
    return M


MATRICES = {
    "selection": selection,
    "injective": lambda frame, dim: np.vstack([np.eye(dim), frame.normal(size=(2, dim))]),
    "wide": lambda frame, dim: frame.normal(size=(3, dim)),  # many preimages
    "shadow": lambda frame, dim: frame.normal(size=(max(dim - 1, 1), dim)),
    "signed": lambda frame, dim: selection(frame, dim) * np.resize([-2.0, 0.3], dim),
    "repeated": repeated,
}


@operation
def mapped(frame, rng, s, kind, scale=1.0):
    """An image by a matrix; `scale` puts M in other units than the part."""
    M = scale * MATRICES[kind](frame, s.C.dim)
    s = s if scale == 1 else Sample(1 / scale * s.C, lambda w, s=s: s.inside(w * scale))

    def inside(w):
        part = cp.Variable(s.C.dim)
        return [M @ part == w, *s.inside(part)]

    return Sample(so.image(M, s.C), inside)


@operation
def polar_of(frame, rng, s):
    """The polar of a cone, stated by generators: p with sigma(K, p) <= 0 from K's epigraph dual."""
    if isinstance(s.C, so.Polyhedron):
        G = s.C.G

        def generated(p):
            y = cp.Variable(G.shape[0], nonneg=True)
            return [G.T @ y == p]

        return Sample(s.C.polar(), generated)
    if isinstance(s.C, so.SecondOrderCone):
        # |p[1:]| <= -p[0] / slope: that of w with slope w[0] in place of w[0], twice
        scale = np.where(np.arange(s.C.dim) % s.C.block, 1.0, np.repeat(s.C.slopes**-2, s.C.block))
        return Sample(s.C.polar(), lambda p: s.inside(cp.multiply(-scale, p)))
    return Sample(s.C.polar(), lambda p: [p <= 0])


def cone_half_space(frame, rng, dim=None):
    normal = frame.normal(size=_dim(frame, dim))
    normal[0] = -abs(normal[0])  # the axis of the second-order cone is in it
    return Sample(so.HalfSpace(normal, 0.0), lambda w: [normal @ w <= 0])


Unbounded = partial(Entry, bounded=False)
Cone = partial(Unbounded, cone=True)

ZOO = {
    "point": Entry(point),
    "box": Entry(box),
    "box, some sides open": Unbounded(open_box),
    "orthant": Cone(orthant),
    "whole space": Cone(whole_space),
    "ball": Entry(ball),
    "balls": Entry(balls),
    "ellipsoid": Entry(ellipsoid),
    "half-space": Unbounded(half_space),
    "polyhedron": Entry(polyhedron),
    "polyhedron, degenerate vertex": Cone(vertex_cone),
    "polyhedron, flat": Unbounded(flat),
    "polytope": Entry(polytope),
    "second-order cone": Cone(second_order_cones),
    "a user's own": Entry(diamond),
    "r own - v": Entry(translated(scaled(diamond))),
    "constraints": Entry(constraints, tol=1e-9, edge_tol=1e-8, support_tol=1e-9),
    "box + v": Entry(translated(box)),
    "cone + v": Unbounded(translated(second_order_cone)),
    "r ellipsoid": Entry(scaled(ellipsoid)),
    "r polyhedron": Entry(scaled(polyhedron)),
    "-polytope": Entry(negated(polytope)),
    "-cone": Cone(negated(second_order_cone)),
    "moving ball": Entry(moving(ball)),
    "moving polytope": Entry(moving(polytope)),
    "box + ball": Entry(summed(box, ball), edge_tol=EDGE),
    "polytope + box + v + polytope": Entry(summed(translated(summed(polytope, box)), polytope)),
    "ball + ellipsoid": Entry(summed(ball, ellipsoid), edge_tol=EDGE),
    "polytope + ball": Entry(summed(polytope, ball), edge_tol=EDGE),
    "box + polar cone": Unbounded(summed(box, polar_of(orthant))),
    "ball + polar cone": Unbounded(summed(ball, polar_of(second_order_cone)), edge_tol=EDGE),
    "selected box + polyhedral cone": Unbounded(
        summed(mapped(box, kind="selection"), polar_of(vertex_cone))
    ),
    "box & ball": Entry(met(box, ball), support_tol=1e-7),
    "ball & half-space": Entry(met(ball, half_space), support_tol=1e-7),
    "ball & ellipsoid": Entry(met(ball, ellipsoid), support_tol=1e-7),
    "polyhedron & ball": Entry(met(polyhedron, ball), support_tol=1e-7),
    "polyhedron & half-space": Entry(met(polyhedron, half_space)),
    "box & polyhedron": Entry(met(box, polyhedron)),
    "box & polyhedron, touching": Entry(touching(box, polyhedron)),
    "truncated cone": Entry(truncated(second_order_cone), support_tol=1e-7),
    "truncated orthant": Entry(truncated(orthant), support_tol=1e-7),
    "truncated moving polyhedron": Entry(truncated(moving(half_space)), support_tol=1e-7),
    "cone & half-space": Cone(cut(second_order_cone, cone_half_space), support_tol=1e-7),
    "cone & orthant": Cone(cut(second_order_cone, orthant), support_tol=1e-7),
    "cone + polyhedral cone": Cone(summed(second_order_cone, vertex_cone), support_tol=1e-7),
    "orthant + cone": Cone(summed(orthant, second_order_cone), edge_tol=EDGE, support_tol=1e-7),
    "ball x box x cone": Unbounded(crossed(ball, box, second_order_cone)),
    "polytope x ellipsoid": Entry(crossed(polytope, ellipsoid)),
    "polyhedron x selection": Entry(crossed(polyhedron, mapped(box, kind="selection"))),
    "selection of a box": Entry(mapped(box, kind="selection")),
    "signed selection of a box": Entry(mapped(box, kind="signed")),
    "signed selection of an orthant": Cone(mapped(orthant, kind="signed")),
    "signed selection of a ball": Entry(mapped(ball, kind="signed"), edge_tol=EDGE),
    "box with a node named twice": Entry(mapped(box, kind="repeated")),
    "selection of balls": Entry(mapped(balls, kind="selection")),
    "injective image of a ball": Entry(mapped(ball, kind="injective")),
    "injective image of a box": Entry(mapped(box, kind="injective")),
    "injective image of an orthant": Cone(mapped(orthant, kind="injective")),
    "image of an image of an orthant": Cone(
        mapped(mapped(orthant, kind="injective"), kind="injective")
    ),
    "shadow of a box": Entry(mapped(box, kind="shadow")),
    "shadow of an ellipsoid": Entry(mapped(ellipsoid, kind="shadow"), edge_tol=EDGE),
    "wide image of a box": Entry(mapped(box, kind="wide", columns=5)),
    "wide image of a box, small": Entry(mapped(box, kind="wide", scale=1e-3, columns=5)),
    "wide image of a box, large": Entry(mapped(box, kind="wide", scale=1e3, columns=5)),
    "wide image of a ball": Entry(mapped(ball, kind="wide", columns=4), edge_tol=EDGE),
    "wide image of a ball, small": Entry(
        mapped(ball, kind="wide", scale=1e-3, columns=4), edge_tol=EDGE
    ),
    "wide image of a ball, large": Entry(
        mapped(ball, kind="wide", scale=1e3, columns=4), edge_tol=EDGE
    ),
    "wide image of balls": Entry(mapped(crossed(ball, ball), kind="wide"), edge_tol=EDGE),
    "wide image of a polytope": Entry(mapped(polytope, kind="wide", columns=4)),
    "polar of the orthant": Cone(polar_of(orthant)),
    "polar of a half-space": Cone(polar_of(cone_half_space)),
    "polar of a polyhedral cone": Cone(polar_of(vertex_cone)),
    "polar of the second-order cone": Cone(polar_of(second_order_cone)),
}


@cache
def kinds():
    """The names of the zoo; those of one class, with flat or with curved faces, are one kind."""
    found = defaultdict(list)
    for name, entry in ZOO.items():
        C = entry.sample(0).C
        found[type(C), C.polyhedral].append(name)
    return [*found.values()]


def of_each_kind(turn):
    """A set of each kind, another one of it at each turn."""
    return [names[turn % len(names)] for names in kinds()]


# ---- laws -------------------------------------------------------------------------------------


def size(*arrays):
    """The unit in which rounding is measured: the largest entry, at least 1 (sets are O(1))."""
    return max(1.0, *(float(np.abs(a).max(initial=0.0)) for a in arrays))


def close(a, b, tol, unit=1.0):
    """a = b within tol units; infinities must agree."""
    with np.errstate(invalid="ignore"):
        same = (a == b) | (np.abs(np.subtract(a, b)) <= tol * unit)
    assert np.all(same), f"{a} and {b} differ by more than {tol * unit:.1e}"


def normals(s, rng):
    """A direction in which the support function is finite: a normal of the set."""
    return s.C.normal(far_and_near(rng, s.C))


def support_is_sublinear(entry, s, rng):
    x, y = normals(s, rng), normals(s, rng)
    sx, sy = s.C.support(x), s.C.support(y)
    unit = size(x, y) * size(s.C.offsets)
    assert np.isfinite([sx, sy]).all()
    close(s.C.support_rows(np.array([x, y])), [sx, sy], entry.support_tol, unit)
    assert s.C.support(x + y) <= sx + sy + entry.support_tol * unit
    for factor in (1e-9, 0.3, 7.0, 1e9):
        close(s.C.support(factor * x), factor * sx, entry.support_tol, factor * unit)
    assert s.C.support(np.zeros(s.C.dim)) == 0.0


def support_is_the_supremum(entry, s, rng):
    axes = np.vstack([np.eye(s.C.dim), -np.eye(s.C.dim)])
    assert np.isfinite([s.C.support(e) for e in axes]).all() == entry.bounded
    for e in axes if not entry.bounded else ():
        assert np.isinf(s.C.support(e)) == np.isinf(s.extreme(e)[0])
    for z in (normals(s, rng), direction(rng, s.C.dim)):
        if z.any():
            z = z / np.abs(z).max()
            close(s.C.support(z), s.extreme(z)[0], PROGRAM, size(s.C.offsets))


def epigraph_is_the_support(entry, s, rng):
    for z in (normals(s, rng), direction(rng, s.C.dim)):
        z = z / (np.abs(z).max() or 1.0)
        value, constraints = s.C.epigraph(cp.Constant(z))
        problem = cp.Problem(cp.Minimize(value), constraints)
        with np.errstate(divide="ignore", invalid="ignore"):  # cvxpy's, at a cone of constant 0
            problem.solve(solver=cp.CLARABEL)
        infeasible = problem.status in (cp.INFEASIBLE, cp.INFEASIBLE_INACCURATE)
        found = np.inf if infeasible else problem.value
        close(found, s.C.support(z), PROGRAM, size(s.C.offsets))


def features_are_linear_in_the_offsets(entry, s, rng):
    """One program compiled for s.C gives the support function of a set with other offsets."""
    v = rng.normal(size=s.C.dim)
    families = [(s.C + v, s.C - v), (2.0 * s.C, 0.5 * s.C)]
    if s.C.singleton:
        families = [(s.C, s.C + v)]
    for C, D in families:
        assert C.same_cone(D)
        assert D.same_cone(C)
        z = normals(Sample(D, s.inside), rng)
        z = z / (np.abs(z).max() or 1.0)
        y, constraints = C.features(cp.Constant(z))
        if not y:
            continue
        offsets = cp.Parameter(D.offsets.size)
        problem = cp.Problem(cp.Minimize(offsets @ cp.hstack(y)), constraints)
        assert problem.is_dcp(dpp=True)
        offsets.value = D.offsets
        with np.errstate(divide="ignore", invalid="ignore"):  # as in the epigraph
            problem.solve(solver=cp.CLARABEL)
        close(problem.value, D.support(z), PROGRAM, size(D.offsets))


def projection_is_the_nearest_point(entry, s, rng):
    v, w = far_and_near(rng, s.C), far_and_near(rng, s.C)
    Pv, Pw = s.C.project(v), s.C.project(w)
    unit = size(v, w, s.C.offsets)
    close(s.C.project(Pw), Pw, entry.edge_tol, unit)
    assert s.C.contains(Pw, 2 * entry.edge_tol * unit)
    assert s.violation(Pw) <= PROGRAM * unit
    # nonexpansive, and firmly so
    assert (v - w - Pv + Pw) @ (Pv - Pw) >= -2 * entry.tol * unit**2
    # variational inequality at points of the set that the independent form finds
    z = (w - Pw) / (np.abs(w - Pw).max() or 1.0)
    for direction_of in (z, z + 0.1 * rng.normal(size=s.C.dim), direction(rng, s.C.dim)):
        _, c = s.extreme(direction_of)
        if c is not None:
            assert (w - Pw) @ (c - Pw) <= PROGRAM * unit**2


def normal_and_projection_make_a_pair(entry, s, rng):
    """Moreau: v = P_C(v) + p with p in N_C, that is sigma(C, p) = <p, P_C(v)>."""
    v = far_and_near(rng, s.C)
    w, p = s.C.project(v), s.C.normal(v)
    unit = size(v, s.C.offsets)
    close(w + p, v, 1e-14, unit)
    close(s.C.support(p), p @ w, max(entry.tol, entry.support_tol), unit**2)


def a_point_of_the_set_stays_where_it_is(entry, s, rng):
    inside = np.mean([s.C.project(far_and_near(rng, s.C)) for _ in range(4)], axis=0)
    unit = size(inside, s.C.offsets)
    close(s.C.project(inside), inside, entry.tol, unit)
    close(s.C.normal(inside), 0.0, entry.tol, unit)


def cone_and_polar_split_every_vector(entry, s, rng):
    if not entry.cone:
        return
    v = far_and_near(rng, s.C)
    polar = s.C.polar()
    w, p = s.C.project(v), polar.project(v)
    tol, zero = max(1e-13, entry.edge_tol), 0.0 if entry.support_tol <= 1e-12 else entry.support_tol
    close(w + p, v, tol, size(v))
    close(w @ p, 0.0, tol, size(v) ** 2)
    again = polar.polar()
    close(again.project(v), w, tol, size(v))
    for z in (p, s.C.normal(v), direction(rng, s.C.dim)):
        close(again.support(z), s.C.support(z), max(tol, zero), size(z))
    close(s.C.support(s.C.normal(v)), 0.0, zero, size(v))
    close(polar.support(polar.normal(v)), 0.0, zero, size(v))


def translation_adds_to_support_and_projection(entry, s, rng):
    v, w = rng.normal(size=(2, s.C.dim))
    z = normals(s, rng)
    unit = size(z, w, s.C.offsets) ** 2
    for C in (s.C + v, v + s.C, s.C - (-v), s.C + list(v)):
        close(C.support(z), s.C.support(z) + v @ z, entry.support_tol, unit)
        close(C.project(w), s.C.project(w - v) + v, entry.tol, unit)
        close(C.anchor, s.C.anchor + v, 1e-15, unit)
        assert C.singleton == s.C.singleton
        assert C.nonsmooth_dim == s.C.nonsmooth_dim
    with pytest.raises(so.InputError, match=r"cone|polar"):
        (s.C + v).polar()


def scaling_scales(entry, s, rng):
    w, z = far_and_near(rng, s.C), normals(s, rng)
    unit = size(w, z, s.C.offsets) ** 2
    ratio = rng.choice([0.5, 3.0])
    support, nearest, magnitude = s.C.support(z), s.C.project(w), s.C.magnitude()
    for r in (1e-9, ratio, 1e9, -1.0, -2.0):
        same = [r * s.C]
        if r == ratio:
            same += [s.C * r, np.float64(r) * s.C, s.C / (1 / r)]
        if r == -1:
            same += [-s.C, 0.0 - s.C if s.C.dim == 1 else -s.C]
        for C in same:
            sigma = C.support(np.sign(r) * z)
            close(sigma, abs(r) * support, entry.support_tol, abs(r) * unit)
            close(C.project(r * w), r * nearest, 2 * entry.tol, abs(r) * unit)
        close(same[0].magnitude(), abs(r) * magnitude, 1e-10, abs(r) * unit)
    mirrored = -s.C
    close((-mirrored).project(w), nearest, entry.tol, unit)


def supports_add_in_sums_and_products(entry, s, rng):
    z, radius = normals(s, rng), rng.random()
    ball = so.Ball(rng.normal(size=s.C.dim), radius)
    unit = size(z, s.C.offsets) ** 2
    expected = s.C.support(z) + ball.support(z)
    close((s.C + ball).support(z), expected, entry.support_tol, unit)
    close((ball + s.C).support(z), expected, entry.support_tol, unit)
    pair = so.product(s.C, ball)
    assert pair.dim == 2 * s.C.dim
    close(pair.support(np.concatenate([z, z])), expected, entry.support_tol, unit)
    M = rng.normal(size=(s.C.dim, s.C.dim))
    pulled = np.linalg.solve(M.T, z)
    of_image = so.image(M, s.C).support(pulled)
    # on the edge of the domain of sigma, where many normals are, the rounding of M^T pulled decides
    if entry.bounded or np.isfinite(of_image):
        close(of_image, s.C.support(z), 1e-9 + entry.support_tol, unit)


def intersection_with_a_large_ball_changes_nothing(entry, s, rng):
    v = far_and_near(rng, s.C)
    w = s.C.project(v)
    truncated = s.C & so.Ball(np.zeros(s.C.dim), 2 * np.linalg.norm(w) + 1)
    unit = size(v, w, s.C.offsets)
    close(truncated.project(v), w, 1e-12 + 10 * entry.tol, unit)
    truncated.require_nonempty()
    z = rng.normal(size=s.C.dim)
    assert truncated.support(z) <= s.C.support(z) + 1e-6 * unit * size(z)


def neighbours(C, rng):
    """Sets at known Hausdorff distances of C: d_H(C, C + v) = |v|, d_H(C, C + Ball(0, r)) = r."""
    v, r = rng.normal(size=C.dim), rng.random()
    return (C + v, np.linalg.norm(v)), (C + so.Ball(np.zeros(C.dim), r), r)


def support_is_lipschitz_in_hausdorff_distance(entry, s, rng):
    """Adly and Haddad, Lemma 2.1."""
    C, z, x = s.C, normals(s, rng), far_and_near(rng, s.C)
    unit = size(z, x, C.offsets)
    tol = entry.support_tol * unit**2
    for D, distance in neighbours(C, rng):
        assert abs(C.support(z) - D.support(z)) <= np.linalg.norm(z) * distance + tol
        P, Q = C.project(x), D.project(x)
        dP, dQ = np.linalg.norm(x - P), np.linalg.norm(x - Q)
        assert abs(dP - dQ) <= distance + 10 * max(entry.tol, 1e-7) * unit
        assert 2 * (dP + dQ) * distance + max(entry.tol, 1e-7) * unit**2 >= (P - Q) @ (P - Q)


def truncated_sets_are_at_most_eight_times_as_far_apart(entry, s, rng):
    """Adly and Haddad, Lemma 2.3: cut with a ball of twice the distance of 0 to both or more."""
    C = s.C
    for D, distance in neighbours(C, rng):
        nearest = [E.project(np.zeros(C.dim)) for E in (C, D)]
        R = (2 + rng.random()) * max(map(np.linalg.norm, nearest)) + rng.random() * distance
        one, two = (E & so.Ball(np.zeros(C.dim), R) for E in (C, D))
        for first, second in ((one, two), (two, one)):
            x = first.project(far_and_near(rng, C))
            apart = np.linalg.norm(second.project(x) - x)
            assert apart <= 8 * distance + 10 * max(entry.tol, 1e-7) * size(x, C.offsets)


def distance_bound_bounds_the_hausdorff_distance(entry, s, rng):
    """|sigma(C, z) - sigma(D, z)| <= |z| bound, and the same for the distances of points."""
    seed = int(rng.integers(2**20))
    C, D = (entry.sample(seed, offsets).C for offsets in (1, 2))
    assert C.same_cone(D)
    assert C.offsets.shape == D.offsets.shape
    bound, back = C.distance_bound(D), D.distance_bound(C)
    assert C.distance_bound(C) == 0.0
    assert (bound is None) == (back is None)
    if bound is None or back is None:
        return
    close(bound, back, 1e-7 + entry.support_tol, size(C.offsets, D.offsets))
    samples = [Sample(C, s.inside), Sample(D, s.inside)]
    for z in (*(normals(one, rng) for one in samples), direction(rng, C.dim)):
        one, two = C.support(z), D.support(z)
        unit = size(z) * size(C.offsets, D.offsets)
        if one != two:
            assert abs(one - two) <= np.linalg.norm(z) * bound + 2 * entry.support_tol * unit
    w = far_and_near(rng, C)
    near = [np.linalg.norm(w - E.project(w)) for E in (C, D)]
    assert abs(near[0] - near[1]) <= bound + 10 * entry.edge_tol * size(w, C.offsets, D.offsets)


def derivative_is_the_slope_of_the_projection(entry, s, rng):
    """Where the slopes ahead and behind agree (the projection is smooth there)."""
    v, e = far_and_near(rng, s.C), rng.normal(size=s.C.dim)
    blocks = s.C.blocks(v)
    if blocks is None:
        return
    D = np.zeros((s.C.dim, s.C.dim))
    for at, block in blocks:
        D[at[:, :, None], at[:, None]] = block
    ahead, behind = (
        (s.C.project(v + h * e) - s.C.project(v)) / h for h in (1e-6 * size(v), -1e-6 * size(v))
    )
    if np.abs(ahead - behind).max() <= 1e-5 * size(e):
        close(D @ e, ahead, 1e-4, size(e))


def rows_are_the_set(entry, s, rng):
    try:
        N, d, E, e = facets(s.C)
    except NoHalfspacesError:
        return
    if isinstance(shape_of(s.C), so.Polytope):  # its facets are rounded
        return
    G, h = np.vstack([dense(N), E, -E]), np.concatenate([d, e, -e])
    for v in (far_and_near(rng, s.C), s.C.project(far_and_near(rng, s.C))):
        w = s.C.project(v)
        slack, rounding = h - G @ v, entry.tol * size(v, h) * (1 + abs(G).sum(axis=1))
        assert (G @ w <= h + rounding).all()
        if (slack >= 0).all():
            close(w, v, entry.tol, size(v))
        if (slack < -rounding).any():
            assert (w != v).any()


def magnitude_bounds_the_set(entry, s, rng):
    bound = s.C.magnitude()
    assert np.isfinite(bound) == entry.bounded
    for _ in range(3):
        w = s.C.project(far_and_near(rng, s.C))
        assert np.linalg.norm(w) <= bound + entry.tol * size(w) + 1e-7 * bound


def descriptions_are_consistent(entry, s, rng):
    C = s.C
    assert C.anchor.shape == (C.dim,)
    assert C.nonsmooth_dim >= 0
    assert C.same_cone(C)
    assert C.at(3.0) is C
    assert C.offsets.ndim == 1
    C.require_nonempty()
    if C.singleton:
        assert C.nonsmooth_dim == 0
        close(C.project(rng.normal(size=C.dim)), C.anchor, 0.0)


def normal_pair_is_proven_near_any_guess(entry, s, rng):
    C = s.C
    p, w = rng.normal(size=C.dim), far_and_near(rng, C)
    tau = 10.0 ** rng.uniform(-1, 1, size=C.dim)
    found = C.normal_pair(p, w, tau)
    if not C.certifiable:
        assert found is None
        return
    unit = size(w, p / tau, p * tau, C.offsets)
    inside = C.project(found.w)
    close(found.w, inside, entry.edge_tol, unit)
    support = C.support(found.p)
    assert np.isfinite(support)
    assert found.gap >= 0
    slack = max(entry.tol, entry.support_tol) * unit * size(found.p)
    assert found.gap >= support - found.p @ found.w - slack


def normal_pair_error_is_as_small_as_the_perturbation(entry, s, rng):
    C, tau = s.C, float(10.0 ** rng.uniform(-0.5, 0.5))
    if not C.certifiable:
        return
    v = far_and_near(rng, C)
    w, p = C.project(v), C.normal(v) / tau
    unit = size(v, C.offsets)
    for delta in (1e-4, 1e-6, 0.0):
        dp, dw = delta * unit * rng.uniform(-1, 1, size=(2, C.dim))
        found = C.normal_pair(p + dp, w + dw, np.full(C.dim, tau))
        reach = 40 * delta + 10 * entry.tol
        close(found.p, p, reach, unit)
        close(found.w, w, reach, unit)
        assert np.sqrt(found.gap) <= reach * unit


def gap_is_what_a_pair_misses(entry, s, rng):
    p, w = normals(s, rng), s.C.project(far_and_near(rng, s.C))
    unit = size(w, s.C.offsets) * size(p)
    gap = s.C.gap(p, w)
    assert gap >= 0
    close(gap, s.C.support(p) - p @ w, max(entry.tol, entry.support_tol, entry.edge_tol), unit)


def gap_along_a_curve_bounds_the_gap_between_samples_too(entry, s, rng):
    C = s.C
    p = np.array([normals(s, rng) for _ in range(3)])
    w = np.array([C.project(far_and_near(rng, C)) for _ in range(4)])
    if rng.random() < 0.5:  # a curve that goes round a corner little by little
        v = far_and_near(rng, C) + 0.1 * rng.normal(size=(4, C.dim))
        w, p = np.array([C.project(x) for x in v]), np.array([C.normal(x) for x in v[[0, 1, 3]]])
    nodes, weights = np.polynomial.legendre.leggauss(16)
    theta = 0.5 + 0.5 * nodes
    sizes = rng.uniform(0.5, 2.0, 4)
    at, scale = basis(2, theta) @ p, basis(3, theta) @ sizes
    if rng.random() < 0.5:
        w = C.curves_within(w[None] + 0.1 * rng.normal(size=w.shape), sizes[None])[0]
    along = (basis(3, theta) @ (sizes[:, None] * w)) / scale[:, None]
    for y in along:
        close(C.project(y), y, max(entry.tol, entry.edge_tol), size(along, C.offsets))
    missed = scale * [C.support(x) - x @ y for x, y in zip(at, along, strict=True)]
    slack = max(entry.tol, entry.support_tol, entry.edge_tol) * size(w, C.offsets) * size(p)
    # Gauss's rule, whose error is that of the kinks of sigma
    bound = C.gaps_along_curves(p[None], w[None], sizes[None])[0]
    assert 0.5 * weights @ missed <= bound + slack + 2e-3 * np.abs(missed).max()


def a_step_is_the_program_that_a_user_of_cvxpy_sees(entry, s, rng):
    """Its optimal z is the velocity of the run, to the certificates of both."""
    n, v, w = s.C.dim, *rng.normal(size=(2, s.C.dim))
    moves = [
        so.Moving(s.C, center=lambda t: v + t * w),
        so.Moving(s.C, center=v, scale=lambda t: 1 + t),
        so.MovingSet(lambda t: s.C + t * w, dim=n),
    ]
    A, B = (root @ root.T + np.eye(n) for root in rng.normal(size=(2, n, n)))
    process = so.SweepingProcess(A, B, moves[rng.integers(3)], 2 * rng.normal(size=n))
    scheme = str(rng.choice(["catching-up", "implicit-euler", "midpoint"]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", so.SweepoptWarning)
        sol = so.solve(process, t_end=0.2, steps=2, scheme=scheme, on_unstable="ignore")
    program = sol.step_program(1)
    solvers = [(cp.CLARABEL, {})]
    if s.C.polyhedral:
        solvers += [(cp.OSQP, {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iter": 100_000})]
    if not s.C.singleton:  # it refuses programs without constraints
        solvers += [(cp.SCS, {"eps": 1e-8, "max_iters": 100_000})]
    solver, settings = solvers[rng.integers(len(solvers))]
    program.problem.solve(solver=solver, **settings)
    answer = program.certify(program.z.value)
    error = np.sqrt((d := answer.z - sol.velocity[1]) @ program.M @ d)
    if s.C.certifiable:
        assert error <= (answer.certificate + sol.stats["certificate"][1]) * (1 + 1e-9)
        assert answer.relative <= 1e-4
    else:
        close(answer.z, sol.velocity[1], 1e-5, size(answer.z))


LAWS = {
    # each with the number of random examples per entry
    support_is_sublinear: 1,
    support_is_the_supremum: 1,
    epigraph_is_the_support: 1,
    features_are_linear_in_the_offsets: 1,
    projection_is_the_nearest_point: 1,
    normal_and_projection_make_a_pair: 2,
    a_point_of_the_set_stays_where_it_is: 1,
    cone_and_polar_split_every_vector: 2,
    translation_adds_to_support_and_projection: 1,
    scaling_scales: 1,
    supports_add_in_sums_and_products: 1,
    intersection_with_a_large_ball_changes_nothing: 1,
    support_is_lipschitz_in_hausdorff_distance: 1,
    truncated_sets_are_at_most_eight_times_as_far_apart: 1,
    distance_bound_bounds_the_hausdorff_distance: 1,
    derivative_is_the_slope_of_the_projection: 3,
    rows_are_the_set: 2,
    magnitude_bounds_the_set: 2,
    descriptions_are_consistent: 2,
    normal_pair_is_proven_near_any_guess: 2,
    normal_pair_error_is_as_small_as_the_perturbation: 2,
    gap_is_what_a_pair_misses: 2,
    gap_along_a_curve_bounds_the_gap_between_samples_too: 1,
    a_step_is_the_program_that_a_user_of_cvxpy_sees: 1,
}
