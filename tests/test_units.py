"""Answers do not depend on units: powers of 2 of forces, lengths, times, over all sets of the zoo.

Energies are in force * length: A in force * time / length, B in force / length, C in force.
"""

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from cases import slow, worst_certificate
from laws import ZOO, of_each_kind

import sweepopt as so
from sweepopt.study.hard.bodies import rod

pytestmark = pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
POWERS = (-40, -13, 17, 40)
ENOUGH = 1e-12
SOLVER = 1e-6  # what Clarabel is accurate to


def spd(random, dim):
    R = random.normal(size=(dim, dim))
    return R @ R.T + np.eye(dim)


def run(C, seed, F=1.0, L=1.0, T=1.0, **how):
    """Some steps of a small process whose data are in the units F, L and T."""
    random = np.random.default_rng(seed)
    A, B = spd(random, C.dim), spd(random, C.dim)
    f = 3 * random.normal(size=C.dim)
    C = so.Moving(C, center=so.Separable([(so.Sine(1.0, 5.0 * T), F * f)]))
    process = so.SweepingProcess(F * T / L * A, F / L * B, C, np.zeros(f.size))
    how = {"steps": 2, "on_unstable": "ignore", **how}
    return so.solve(process, t_end=2 * T, tol=1e-9, **how)


@pytest.mark.parametrize(
    "seed, name",
    [
        (seed, name) if name in of_each_kind(0) else slow(seed, name)
        for seed, name in enumerate(ZOO)
        # what a user states in cvxpy cannot be restated by anybody else: STATED below
        if name != "constraints"
    ],
)
def test_units_change_nothing_but_rounding(seed, name):
    sample, random = ZOO[name].sample(seed), np.random.default_rng(seed)
    F, L, T = 2.0 ** random.choice(POWERS, 3)
    plain, other = run(sample.C, seed), run(F * sample.C, seed, F, L, T)
    assert worst_certificate(plain) <= 1e-9
    # answers of solvers that iterate are alike as far as they are proved
    proved = worst_certificate(plain) + worst_certificate(other)
    for one, two in ((plain.u, other.u / L), (plain.velocity, other.velocity * (T / L))):
        atol = max(ENOUGH, proved) * np.abs(one).max()
        np.testing.assert_allclose(two, one, rtol=0, atol=atol)
        assert np.array_equal(two == 0, one == 0)


@pytest.mark.parametrize("seed", range(4))
def test_a_hull_is_met_in_the_units_of_a_body_whose_stiffness_jumps(seed):
    from sweepopt.study.hard import Program

    random, n = np.random.default_rng(seed), 6
    A, g = rod(10.0 ** random.integers(-6, 7, n + 1)), random.uniform(0.2, 2.0, n)
    f = 3 * random.normal(size=n)
    hull = so.Polytope(np.vstack([np.zeros(n), np.diag(g)])) + f
    rows = so.Polyhedron(np.vstack([-np.eye(n), 1 / g]), np.append(np.zeros(n), 1.0)) + f
    process = so.SweepingProcess(A, None, hull, np.zeros(n))
    # rounding leaves up to 1.1e-9, in one metric for all entries 6e-6
    z = so.solve(process, t_end=1.0, steps=1, tol=1e-8).velocity[0]
    program = Program(A)
    exact = program.solve(np.zeros(n), rows)
    assert program.error(z, exact) <= 1e-8 * exact.size


def test_discs_too_many_for_newton_may_have_units_of_their_own():
    random, discs = np.random.default_rng(0), 800
    units = 10.0 ** random.uniform(-6, 6, discs)
    U = sp.diags_array(np.repeat(units, 2))
    A = sp.csc_array(U @ rod(10.0 ** random.uniform(-2, 2, 2 * discs + 1)) @ U)
    f = so.Separable([(so.Sine(2.0, 4.0), U @ random.normal(size=2 * discs))])
    C = so.Moving(so.Balls(units * random.uniform(0.2, 1.0, discs), 2), f)
    process = so.SweepingProcess(A, 2 * A, C, np.zeros(2 * discs))
    sol = so.solve(process, t_end=1.0, steps=3, scheme="midpoint")
    assert worst_certificate(sol) <= 1e-6


W, V = np.random.default_rng(0).normal(size=(2, 3, 3))
WITH_MATRICES = {
    "ellipsoid": lambda F: so.Ellipsoid(np.zeros(3), F**2 * W @ W.T),
    "rows": lambda F: so.Polyhedron(np.vstack([W, -W]) / F, np.full(6, 0.2)),
    "image": lambda F: so.image(F * W, so.Polyhedron(np.vstack([V, -V]), np.ones(6))),
    "sum": lambda F: so.image(F * W, so.Ball(np.zeros(3), 1.0)) + so.image(F * V, CUBE),
    "intersection": lambda F: so.image(F * W, so.Ball(np.zeros(3), 1.0)) & so.image(F * V, CUBE),
}
CUBE = so.Box(-np.ones(3), np.ones(3))


@pytest.mark.parametrize("name", WITH_MATRICES)
def test_solvers_do_not_see_the_units_of_the_matrices_of_a_set(name):
    """With F for the unit of forces, a matrix of an image is in F, rows are in 1 / F."""
    z, units = np.array([1.0, 0.5, -0.3]), (1.0, 2.0**-40, 2.0**40)
    sets = [WITH_MATRICES[name](F) for F in units]
    plain, *others = (run(C, 3, F, solver="clarabel") for C, F in zip(sets, units, strict=True))
    assert np.abs(plain.u).max() > 1e-3
    for sol in others:
        proved = worst_certificate(plain) + worst_certificate(sol)
        np.testing.assert_allclose(sol.u, plain.u, rtol=0, atol=proved * np.abs(plain.u).max())
    lengths = np.divide([C.support(z) for C in sets], units)
    assert lengths == pytest.approx(lengths[0], rel=1e-9)


@pytest.mark.parametrize("columns", [2, 6])
def test_columns_of_an_image_may_have_units_of_their_own(columns):
    random = np.random.default_rng(columns)
    M, g = random.normal(size=(4, columns)), random.uniform(0.2, 0.8, size=columns)
    found = []
    for power in (0, -27, 13, 40):
        units = np.where(np.arange(columns) % 2, 1.0, 2.0**power)
        found.append(run(so.image(M * units, so.Box(-g / units, g / units)), columns).u)
    assert found[0].any()
    for u in found[1:]:
        np.testing.assert_allclose(u, found[0], rtol=0, atol=ENOUGH * np.abs(found[0]).max())


@pytest.mark.parametrize(
    "seed, S",
    [
        (10, so.product(so.Ball([0.0, 0.0], 1.0), so.Box(-1, 1))),
        (5, so.Balls([1.0, 2.0], 2)),
        (11, so.Balls([1.0, 2.0], 2)),
    ],
)
def test_columns_of_an_image_of_balls_may_be_of_any_sizes(seed, S):
    random = np.random.default_rng(seed)
    M = random.normal(size=(2, S.dim)) * random.permutation(np.logspace(-8, 8, S.dim))
    load = so.Separable([(so.Sine(1e3, 3.0), [1.0, 0.5])])
    process = so.SweepingProcess(
        [[2.0, 0.5], [0.5, 1.0]], np.eye(2), so.Moving(so.image(M, S), load), [0.0, 0.0]
    )
    sol = so.solve(process, t_end=3.0, steps=10, scheme="implicit-euler")
    for t, u, z in zip(sol.t[1:], sol.u[1:], sol.velocity, strict=True):
        w = process.A @ z + process.B @ u
        # sigma(M S, -z) = sigma(S, -M^T z), which is <w, -z> where -z is normal at w
        size = S.support(np.abs(M.T @ z)) + np.linalg.norm(w) * np.linalg.norm(z)
        assert S.support(-M.T @ z) + (w - load(t)) @ z == pytest.approx(0.0, abs=1e-6 * size)


GENERATORS = np.random.default_rng(1).normal(size=(3, 4))


def generated(w, F):
    v = cp.Variable(4, nonneg=True)
    return [w == GENERATORS @ v, cp.sum(v) <= F]


def semidefinite(w, F):
    """w w^T <= X, trace X <= F^2: entries in units of F^2, F and 1 in one matrix."""
    X, column = cp.Variable((3, 3), symmetric=True), cp.reshape(w, (3, 1), order="F")
    return [cp.bmat([[X, column], [column.T, np.eye(1)]]) >> 0, cp.trace(X) <= F**2]


# constraints of somebody who measures forces in units of 1 / F
STATED = {
    "sum of sizes": lambda w, F: [cp.norm(w, 1) <= F],
    "squares": lambda w, F: [cp.sum_squares(w) <= (0.1 * F) ** 2],
    "generated": generated,
    "semidefinite": semidefinite,
    "exponential": lambda w, F: [cp.exp(w[0] / F) <= w[1] / F + 1.2, cp.norm(w) <= 2 * F],
    "power cone": lambda w, F: [
        cp.PowCone3D(w[1] + F, 1.0, F**-0.6 * w[0], 0.4),
        cp.norm(w) <= 2 * F,
    ],
    "parabola": lambda w, F: [cp.sum_squares(w[:2]) <= F * w[2]],
}
CONTACT = np.eye(5)[:, [1, 2, 4]]


@pytest.mark.parametrize(
    "name, path",
    [
        ("semidefinite", "full"),
        ("power cone", "eliminated"),
        *(slow(name, "full") for name in STATED if name != "semidefinite"),
        slow("squares", "eliminated"),
    ],
)
def test_constraints_may_be_stated_in_any_units(name, path):
    how = {"path": path, "solver": "clarabel" if path == "eliminated" else "auto", "steps": 1}
    found = []
    for F in (1.0, 2.0**40 if path == "full" else 2.0**-40):
        C = so.Constraints(3, lambda w, F=F: STATED[name](w, F))
        sol = run(so.image(CONTACT, C) if path == "eliminated" else C, 3, F, 1 / F, **how)
        found.append((sol.u * F, sol.velocity * F))
    assert np.abs(found[0][1]).max() > 1e-3
    for one, two in zip(*found, strict=True):
        np.testing.assert_allclose(two, one, rtol=0, atol=SOLVER * np.abs(one).max())


def logarithm(w, F):
    return [cp.log(w[0] + F) >= np.log(0.5 * F), cp.norm(w) <= F]


@pytest.mark.parametrize("build", [*STATED.values(), logarithm], ids=[*STATED, "logarithm"])
def test_supports_and_projections_of_constraints_scale(build):
    z, w = np.array([0.3, 0.8, -0.5]), np.array([1.7, -0.4, -0.9])
    C = so.Constraints(3, lambda w: build(w, 1.0))
    support, nearest = C.support(z), C.project(w)
    for F in (2.0**-40, 2.0**40):
        D, size = so.Constraints(3, lambda w, F=F: build(w, F)), F * np.abs(w).max()
        assert D.support(z) == pytest.approx(F * support, rel=SOLVER)
        np.testing.assert_allclose(D.project(F * w), F * nearest, rtol=0, atol=SOLVER * size)
