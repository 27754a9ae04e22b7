"""Sets and the laws they obey: every law runs over every entry of the zoo.

A new shape or operation is one line in ZOO. Each entry states the set a second time, as cvxpy
constraints on w, which share no code with the library: that is what the laws compare with.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

import sweepopt as so

Rng = np.random.Generator
Constraints = list[cp.Constraint]
Build = Callable[..., "Sample"]
EPS = float(np.finfo(float).eps)
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

    def extreme(self, z: np.ndarray) -> tuple[float, np.ndarray | None]:
        """sup of <w, z> over the set and a point where it is taken, by the independent form."""
        w = cp.Variable(self.C.dim)
        problem = cp.Problem(cp.Maximize(z @ w), self.inside(w))
        problem.solve(solver=cp.CLARABEL)
        if problem.status in (cp.UNBOUNDED, cp.UNBOUNDED_INACCURATE):
            return np.inf, None
        assert problem.value is not None, problem.status
        return float(problem.value), w.value

    def violation(self, point: np.ndarray) -> float:
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
    support_tol : float
        Relative accuracy of the support function: rounding unless a program computes it.
    family : bool
        Whether two samples of one frame share their cone.
    """

    build: Build
    bounded: bool = True
    cone: bool = False
    tol: float = 1e-12
    support_tol: float = 1e-12
    family: bool = True

    def sample(self, seed: int, offsets: int = 0) -> Sample:
        return self.build(np.random.default_rng(seed), np.random.default_rng((seed, offsets)))


def direction(rng: Rng, dim: int) -> np.ndarray:
    """A random vector, now and then with zeros in it."""
    z = rng.normal(size=dim)
    return np.where(rng.random(dim) < 0.2, 0.0, z) if rng.random() < 0.3 else z


def far_and_near(rng: Rng, dim: int) -> np.ndarray:
    """A random point at a random distance."""
    return 10.0 ** rng.uniform(-1, 1.5) * rng.normal(size=dim)


# ---- shapes -----------------------------------------------------------------------------------


def _dim(frame: Rng, dim: int | None) -> int:
    drawn = int(frame.integers(1, 6))
    return drawn if dim is None else dim


def point(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
    p = rng.normal(size=_dim(frame, dim))
    return Sample(so.Point(p), lambda w: [w == p])


def box(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
    dim = _dim(frame, dim)
    lower = rng.normal(size=dim)
    upper = lower + rng.exponential(size=dim)
    return Sample(so.Box(lower, upper), lambda w: [w >= lower, w <= upper])


def open_box(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
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


def orthant(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
    return Sample(so.Orthant(_dim(frame, dim)), lambda w: [w >= 0])


def whole_space(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
    return Sample(so.WholeSpace(_dim(frame, dim)), lambda w: [])


def ball(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
    center, radius = rng.normal(size=_dim(frame, dim)), rng.exponential()
    return Sample(so.Ball(center, radius), lambda w: [cp.norm(w - center) <= radius])


def balls(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
    block, count = int(frame.integers(1, 4)), int(frame.integers(1, 3))
    radii = rng.exponential(size=count)
    return Sample(
        so.Balls(radii, block),
        lambda w: [cp.norm(w[k * block : (k + 1) * block]) <= radii[k] for k in range(count)],
    )


def _ellipsoid(frame: Rng, rng: Rng, dim: int | None, decades: float) -> Sample:
    dim = _dim(frame, dim)
    axes = np.linalg.qr(frame.normal(size=(dim, dim)))[0]
    squares = 10.0 ** np.linspace(-decades, 0, dim)
    center, shape = rng.normal(size=dim), (axes * squares) @ axes.T
    shape = 0.5 * (shape + shape.T)
    return Sample(
        so.Ellipsoid(center, shape),
        lambda w: [cp.norm((axes / np.sqrt(squares)).T @ (w - center)) <= 1],
    )


def ellipsoid(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
    return _ellipsoid(frame, rng, dim, decades=1)


def half_space(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
    normal, offset = frame.normal(size=_dim(frame, dim)), rng.normal()
    return Sample(so.HalfSpace(normal, offset), lambda w: [normal @ w <= offset])


def polyhedron(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
    # bounded: the rows surround the origin; some come twice, some are redundant
    dim = _dim(frame, dim)
    G = np.vstack([np.eye(dim), -np.eye(dim), frame.normal(size=(3, dim))])
    G = np.vstack([G, G[:2]])
    x = rng.normal(size=dim)
    h = G @ x + rng.exponential(size=len(G))
    return Sample(so.Polyhedron(sp.csr_array(G), h), lambda w: [G @ w <= h])


def vertex_cone(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
    # more rows through one vertex than there are unknowns
    dim = _dim(frame, dim)
    G = np.abs(frame.normal(size=(2 * dim + 2, dim)))
    return Sample(so.Polyhedron(G, np.zeros(len(G))), lambda w: [G @ w <= 0])


def flat(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
    # an equation as two rows: no interior
    dim = 1 + _dim(frame, dim)
    row = frame.normal(size=dim)
    G = np.vstack([row, -row, np.eye(dim)])
    level, top = rng.normal(), np.abs(rng.normal(size=dim)) + 3
    h = np.concatenate([[level, -level], top])
    return Sample(so.Polyhedron(G, h), lambda w: [row @ w == level, w <= top])


def polytope(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
    vertices = frame.normal(size=(int(frame.integers(1, 9)), _dim(frame, dim)))
    return Sample(so.Polytope(vertices), lambda w: _hull(vertices, w))


def _hull(vertices: np.ndarray, w: cp.Variable) -> Constraints:
    theta = cp.Variable(len(vertices), nonneg=True)
    return [vertices.T @ theta == w, cp.sum(theta) == 1]


def second_order_cone(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
    dim = _dim(frame, dim)
    inside = [lambda w: [w[0] >= 0], lambda w: [cp.norm(w[1:]) <= w[0]]][dim > 1]
    return Sample(so.SecondOrderCone(dim), inside)


def constraints(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
    dim, center = _dim(frame, dim), rng.normal(size=3)
    return Sample(
        so.Constraints(dim, lambda w: [cp.norm(w - center[0], 1) <= 1, w[0] <= center[0] + 0.5]),
        lambda w: [cp.sum(cp.abs(w - center[0])) <= 1, w[0] <= center[0] + 0.5],
    )


# ---- operations -------------------------------------------------------------------------------


def translated(build: Build) -> Build:
    def make(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
        s = build(frame, rng, dim)
        v = rng.normal(size=s.C.dim)
        return Sample(s.C + v, lambda w: s.inside(w - v))

    return make


def scaled(build: Build) -> Build:
    def make(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
        s, r = build(frame, rng, dim), rng.uniform(0.5, 3)
        return Sample(r * s.C, lambda w: s.inside(w / r))

    return make


def negated(build: Build) -> Build:
    def make(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
        s = build(frame, rng, dim)
        return Sample(-s.C, lambda w: s.inside(-w))

    return make


def moving(build: Build) -> Build:
    """A snapshot of center(t) + scale(t) C."""

    def make(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
        s = build(frame, rng, dim)
        v, t = rng.normal(size=s.C.dim), rng.uniform()
        C = so.Moving(s.C, center=lambda t: t * v, scale=lambda t: 1 + t)
        return Sample(C.at(t), lambda w: s.inside((w - t * v) / (1 + t)))

    return make


def summed(one: Build, two: Build) -> Build:
    def make(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
        a = one(frame, rng, dim)
        b = two(frame, rng, a.C.dim)

        def inside(w: cp.Variable) -> Constraints:
            first = cp.Variable(a.C.dim)
            return [*a.inside(first), *b.inside(w - first)]

        return Sample(a.C + b.C, inside)

    return make


def met(one: Build, two: Build) -> Build:
    """C & D with D shifted so that the sets share a ball of a random size around a point."""

    def make(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
        a = one(frame, rng, dim)
        b = two(frame, rng, a.C.dim)
        v = a.C.project(rng.normal(size=a.C.dim)) - b.C.project(rng.normal(size=a.C.dim))
        return Sample(a.C & (b.C + v), lambda w: [*a.inside(w), *b.inside(w - v)])

    return make


def truncated(build: Build) -> Build:
    """C & Ball(0, n), as the theory does with unbounded sets."""

    def make(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
        s = build(frame, rng, dim)
        n = 2 + float(np.linalg.norm(s.C.project(np.zeros(s.C.dim))))
        ball = so.Ball(np.zeros(s.C.dim), n)
        return Sample(s.C & ball, lambda w: [*s.inside(w), cp.norm(w) <= n])

    return make


def crossed(*builds: Build) -> Build:
    def make(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
        parts = [build(frame, rng) for build in builds]
        cuts = np.cumsum([0] + [s.C.dim for s in parts])

        def inside(w: cp.Variable) -> Constraints:
            blocks = [s.inside(w[i:j]) for s, i, j in zip(parts, cuts, cuts[1:], strict=False)]
            return sum(blocks, [])

        return Sample(so.product(*(s.C for s in parts)), inside)

    return make


def mapped(build: Build, kind: str) -> Build:
    def make(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
        s = build(frame, rng, dim)
        dim = s.C.dim
        M: Any
        if kind == "selection":
            rows = frame.permutation(dim + 3)[:dim]
            M = sp.csc_array((np.ones(dim), (rows, np.arange(dim))), shape=(dim + 3, dim))
        elif kind == "injective":
            M = np.vstack([np.eye(dim), frame.normal(size=(2, dim))])
        else:
            M = frame.normal(size=(max(dim - 1, 1), dim))

        def inside(w: cp.Variable) -> Constraints:
            part = cp.Variable(dim)
            return [M @ part == w, *s.inside(part)]

        return Sample(so.image(M, s.C), inside)

    return make


def polar_of(build: Build) -> Build:
    """The polar of a cone, stated by generators: p with sigma(K, p) <= 0 from K's epigraph dual."""

    def make(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
        s = build(frame, rng, dim)
        if isinstance(s.C, so.Polyhedron):
            G = s.C.G

            def generated(p: cp.Variable) -> Constraints:
                y = cp.Variable(G.shape[0], nonneg=True)
                return [G.T @ y == p]

            return Sample(s.C.polar(), generated)
        if isinstance(s.C, so.SecondOrderCone):
            return Sample(s.C.polar(), lambda p: s.inside(-p))
        return Sample(s.C.polar(), lambda p: [p <= 0])

    return make


def cone_half_space(frame: Rng, rng: Rng, dim: int | None = None) -> Sample:
    normal = frame.normal(size=_dim(frame, dim))
    return Sample(so.HalfSpace(normal, 0.0), lambda w: [normal @ w <= 0])


ZOO: dict[str, Entry] = {
    "point": Entry(point),
    "box": Entry(box),
    "box, some sides open": Entry(open_box, bounded=False),
    "orthant": Entry(orthant, bounded=False, cone=True),
    "whole space": Entry(whole_space, bounded=False, cone=True),
    "ball": Entry(ball),
    "balls": Entry(balls),
    "ellipsoid": Entry(ellipsoid),
    "half-space": Entry(half_space, bounded=False),
    "polyhedron": Entry(polyhedron),
    "polyhedron, degenerate vertex": Entry(vertex_cone, bounded=False, cone=True),
    "polyhedron, flat": Entry(flat, bounded=False),
    "polytope": Entry(polytope),
    "second-order cone": Entry(second_order_cone, bounded=False, cone=True),
    "constraints": Entry(constraints, tol=1e-7, support_tol=1e-7, family=False),
    "box + v": Entry(translated(box)),
    "cone + v": Entry(translated(second_order_cone), bounded=False),
    "r ellipsoid": Entry(scaled(ellipsoid)),
    "r polyhedron": Entry(scaled(polyhedron)),
    "-polytope": Entry(negated(polytope)),
    "-cone": Entry(negated(second_order_cone), bounded=False, cone=True),
    "moving ball": Entry(moving(ball)),
    "moving polytope": Entry(moving(polytope)),
    "box + ball": Entry(summed(box, ball)),
    "ball + ellipsoid": Entry(summed(ball, ellipsoid)),
    "polytope + ball": Entry(summed(polytope, ball)),
    "box + polar cone": Entry(summed(box, polar_of(orthant)), bounded=False),
    "ball + polar cone": Entry(summed(ball, polar_of(second_order_cone)), bounded=False),
    "selected box + polyhedral cone": Entry(
        summed(mapped(box, "selection"), polar_of(vertex_cone)), bounded=False
    ),
    "box & ball": Entry(met(box, ball), support_tol=1e-7),
    "ball & half-space": Entry(met(ball, half_space), support_tol=1e-7),
    "ball & ellipsoid": Entry(met(ball, ellipsoid), support_tol=1e-7),
    "polyhedron & ball": Entry(met(polyhedron, ball), support_tol=1e-7),
    "polyhedron & half-space": Entry(met(polyhedron, half_space), support_tol=1e-7),
    "box & polyhedron": Entry(met(box, polyhedron), support_tol=1e-7),
    "truncated cone": Entry(truncated(second_order_cone), support_tol=1e-7),
    "truncated orthant": Entry(truncated(orthant), support_tol=1e-7),
    "truncated moving polyhedron": Entry(truncated(moving(half_space)), support_tol=1e-7),
    "ball x box x cone": Entry(crossed(ball, box, second_order_cone), bounded=False),
    "polytope x ellipsoid": Entry(crossed(polytope, ellipsoid)),
    "selection of a box": Entry(mapped(box, "selection")),
    "selection of balls": Entry(mapped(balls, "selection")),
    "injective image of a ball": Entry(mapped(ball, "injective")),
    "injective image of a box": Entry(mapped(box, "injective")),
    "injective image of an orthant": Entry(mapped(orthant, "injective"), bounded=False, cone=True),
    "shadow of a box": Entry(mapped(box, "shadow")),
    "shadow of an ellipsoid": Entry(mapped(ellipsoid, "shadow")),
    "polar of the orthant": Entry(polar_of(orthant), bounded=False, cone=True),
    "polar of a half-space": Entry(polar_of(cone_half_space), bounded=False, cone=True),
    "polar of a polyhedral cone": Entry(polar_of(vertex_cone), bounded=False, cone=True),
    "polar of the second-order cone": Entry(polar_of(second_order_cone), bounded=False, cone=True),
}
