"""A and B with no common kernel: A may be singular, A = 0 is an instance."""

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
from cases import refuses, slope, springs
from numpy.testing import assert_allclose
from scipy.optimize import lsq_linear

import sweepopt as so
from sweepopt.integrate import SCHEMES

IMPLICIT = ("implicit-euler", "midpoint", "sdirk2")
quiet = pytest.mark.filterwarnings("ignore::sweepopt.StabilityWarning")


def random_pair(seed, dim=5):
    """Semidefinite, both singular, with no common kernel."""
    Q = np.random.default_rng(seed).normal(size=(dim, dim))
    lost = seed % (dim - 1) + 1
    return Q[lost:].T @ Q[lost:], Q[: lost + 1].T @ Q[: lost + 1]


def load(t):
    return np.array([2 * np.sin(3 * t), t, -t, np.sin(t), 3 * t])


@quiet
@pytest.mark.parametrize(
    "scheme, convert", [*zip(IMPLICIT, (sp.csc_array, np.asarray, sp.csc_array), strict=True)]
)
def test_steps_are_those_of_a_dense_least_squares_problem(scheme, convert):
    tableau = SCHEMES[scheme]
    for seed in range(4):
        A, B = random_pair(seed)
        C = so.Moving(so.Box(-0.5 * np.ones(5), 0.7 * np.ones(5)), load)
        process = so.SweepingProcess(convert(A), convert(B), C, np.zeros(5))
        assert not process.coercive
        sol = so.solve(process, t_end=1.0, steps=20, scheme=scheme, tol=1e-9)
        u, mu = np.zeros(5), 1 / 20
        for i in range(20):
            stages = []
            for row, c in zip(tableau.a, tableau.c, strict=True):
                start = u + mu * sum(a * z for a, z in zip(row, stages, strict=False))
                M, f = A + mu * row[-1] * B, load((i + c) * mu)
                L = np.linalg.cholesky(np.linalg.inv(M)).T
                w = lsq_linear(L, L @ (B @ start), (f - 0.5, f + 0.7), "bvls", tol=1e-14).x
                stages.append(np.linalg.solve(M, w - B @ start))
            u = u + mu * sum(b * z for b, z in zip(tableau.b, stages, strict=True))
        assert np.abs(sol.u[-1] - u).max() <= 1e-7 * np.abs(u).max()


K0, K1, ETA, G = 1.0, 2.0, 0.5, 0.3


def zener(u0=(0.0, 0.0)):
    """A spring beside a Maxwell branch, held by friction, under the load t; u and the dashpot."""
    B = [[K0 + K1, -K1], [-K1, K1]]
    held = so.image([[1.0], [0.0]], so.Box(-G, G))
    C = so.Moving(held, so.Separable([(so.Polynomial([0.0, 1.0]), [1.0, 0.0])]))
    return so.SweepingProcess([[0.0, 0.0], [0.0, ETA]], B, C, u0)


def of_zener(t):
    s, a, b = np.maximum(t - G, 0), K1 / (K0 + K1) / ETA, K0 * K1 / (K0 + K1) / ETA
    q = a * (s / b - (1 - np.exp(-b * s)) / b**2)
    return np.column_stack([(s + K1 * q) / (K0 + K1), q])


@quiet
@pytest.mark.parametrize("scheme", [*IMPLICIT, "sdirk32"])
def test_the_orders_hold_on_a_zener_element_with_friction(scheme):
    errors = []
    for n in (20, 40, 80, 160):
        sol = so.solve(zener(), t_end=2.0, steps=n, scheme=scheme, tol=1e-10)
        errors.append(np.abs(sol.u - of_zener(sol.t)).max())
    order = slope([20, 40, 80, 160], errors)
    assert order == pytest.approx(SCHEMES[scheme].order, abs=0.1)
    assert errors[-1] <= (3e-3 if order < 1.5 else 1e-5)


def test_auto_is_an_l_stable_scheme_and_its_bound_holds():
    sol = so.solve(zener(), t_end=2.0, steps=80)
    assert sol.plan.scheme.name == "sdirk32"
    assert "L-stable" in sol.plan.scheme.reason
    e, B = sol.u - of_zener(sol.t), np.array([[3.0, -2.0], [-2.0, 2.0]])
    bound = sol.error_bound()
    assert bound.guaranteed
    assert np.sqrt(np.einsum("ij,jk,ik->i", e, B, e)).max() <= bound < 1e-2
    assert sol.viability().max() <= 1e-6


def test_a_rectifier_with_an_ideal_diode_follows_its_source_and_then_decays():
    # charges through the diode, which flow one way, and through the resistance
    R, c = 2.0, 1.0
    source = so.Separable([(so.Sine(1.0, 2 * np.pi), [1.0, 0.0])])
    circuit = so.EvolutionVI(
        np.diag([0.0, R]),
        np.array([[1.0, -1.0], [-1.0, 1.0]]) / c,
        load=source,
        cone=so.Polyhedron([[-1.0, 0.0]], [0.0]),
        u0=[0.0, 0.0],
    )
    sol = so.solve(circuit, t_end=5.0, steps=200, tol=1e-9)
    voltage = (sol.u[:, 0] - sol.u[:, 1]) / c
    off = np.pi - np.arctan(R * c)
    decay = np.sin(off) * np.exp(-(sol.t - off) / (R * c))
    assert voltage == pytest.approx(np.where(sol.t < off, np.sin(sol.t), decay), abs=1e-3)
    assert sol.velocity[:, 0].min() >= 0
    with refuses("both are singular to rounding; compare"):
        sol.error_bound()


def test_the_bound_of_an_A_that_is_singular_to_rounding_is_that_of_a_singular_one():
    C = so.Moving(so.Box([-1, -1], [1, 1]), so.Separable([(so.Sine(3.0, 3.0), [1.0, 0.0])]))
    bounds = []
    for more in (0.0, 20 * np.finfo(float).eps):
        process = so.SweepingProcess([[1.0, 1.0], [1.0, 1.0 + more]], np.eye(2), C, [0.0, 0.0])
        assert process.coercive == (more > 0)
        bounds.append(so.solve(process, t_end=3.0, steps=10).error_bound())
    assert bounds[1].guaranteed
    assert bounds[1] == pytest.approx(bounds[0], rel=1e-2)


def test_a_common_kernel_is_refused_and_a_little_elasticity_tends_to_the_play():
    """Two sliders and a spring between them, which nothing else holds: |u_1| <= 3/4 - 1/2."""
    A, B = np.zeros((2, 2)), np.array([[1.0, -1.0], [-1.0, 1.0]])
    load = so.Separable([(so.Triangle(0.75, 4.0), [1.0, 0.0])])
    C = so.Moving(so.Box([-0.5, -0.3], [0.5, 0.3]), center=load)
    with refuses(r"bounded C.* a little elasticity to an element"):
        so.SweepingProcess(A, B, C, [0.0, 0.0])
    errors = []
    for little in (1e-2, 1e-3, 1e-4, 1e-5):
        process = so.SweepingProcess(A, B + little * np.eye(2), C, [0.0, 0.0])
        errors.append(abs(so.solve(process, t_end=4.0, steps=40).u - [-0.25, 0.0])[-1].max())
    assert np.allclose(np.diff(np.log10(errors)), -1, atol=0.01)
    assert errors[-1] < 3e-6


def test_an_incompatible_start_is_refused_and_a_compatible_one_computed():
    with refuses(r"change u0, to so\.compatible_start"):
        so.solve(zener([1.0, 0.0]), t_end=1.0, steps=5)
    start = so.compatible_start(zener([1.0, 0.0]))
    assert start == pytest.approx([G / (K0 + K1), 0.0], abs=1e-9)  # only the spring's end jumps
    with pytest.warns(so.InitialStateWarning, match="starts with a velocity"):
        assert so.solve(zener(start), t_end=1.0, steps=5).success
    # a jump of A = 0 is the projection
    still = so.SweepingProcess(np.zeros((1, 1)), 2.0, so.Box(-1, 1), 3.0)
    assert so.compatible_start(still) == pytest.approx([0.5])
    coercive = so.SweepingProcess(1.0, 2.0, so.Box(-1, 1), 3.0)
    assert so.compatible_start(coercive) == pytest.approx([3.0])


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
def test_a_start_is_compatible_though_rounding_puts_the_load_beside_the_range_of_A():
    v = np.array([0.1, 0.7, 0.3])  # <kernel of v v^T, v> is 1e-17, not 0
    load = so.Separable([(so.Constant(), v)])
    process = so.EvolutionVI(np.outer(v, v), np.eye(3), load=load, u0=np.zeros(3))
    sol = so.solve(process, t_end=1.0, steps=200)
    # along v: |v|^2 x' + x = |v|
    size = np.linalg.norm(v)
    assert_allclose(sol.u[-1], v * (1 - np.exp(-1 / size**2)), rtol=1e-4)


def test_zeros_that_are_stored_couple_nothing():
    A = sp.csr_array(([1.0, 0.0, 0.0, 0.0], ([0, 0, 1, 1], [0, 1, 0, 1])))
    assert A.nnz == 4
    pull = so.Separable([(so.Sine(3.0, period=4.0), [1.0, 1.0])])
    box, u0 = so.Box(-np.ones(2), np.ones(2)), np.zeros(2)
    runs = [
        so.solve(
            so.EvolutionVI(M, np.eye(2), load=pull, dissipation=box, u0=u0), t_end=4.0, steps=20
        )
        for M in (A, A.toarray())
    ]
    np.testing.assert_allclose(runs[0].u, runs[1].u, rtol=0, atol=1e-12)
    assert float(runs[0].error_bound()) < np.inf


def test_a_body_that_can_move_is_refused_though_rounding_makes_its_matrix_definite():
    """These three have Cholesky factors: their runs failed at a later step, or not at all."""
    held = springs(8)
    for seed in (5, 15, 21):
        rng = np.random.default_rng(seed)
        E, motion = rng.normal(size=(30, 30)), rng.uniform(0.5, 1.5, size=30)
        E -= np.outer(E @ motion, motion) / (motion @ motion)
        for A in (E.T @ E, scipy.linalg.block_diag(E.T @ E, held)):
            zero = np.zeros(len(A))
            with pytest.raises(so.IndefiniteError, match="body"):
                so.SweepingProcess(A, 2 * A, so.Ball(zero, 1.0), zero)


def test_a_bar_on_a_soft_spring_is_no_body_that_can_move():
    """A spring of 1e-11 of a cell, 1e-8 of the bar: u at its end is that of both in series."""
    n, soft = 1000, 1e-11
    ones = np.ones(n)
    A = sp.diags_array([np.r_[1 + soft, 2 * ones[2:], 1], -ones[1:], -ones[1:]], offsets=[0, 1, -1])
    end = np.eye(n)[-1]
    load = so.Separable([(so.Polynomial([0.0, 1.0]), end)])
    friction = so.image(end[:, None], so.Box(-0.25, 0.25))
    process = so.EvolutionVI(None, A, load=load, dissipation=friction, u0=0 * ones)
    u = so.solve(process, t_end=1.0, steps=4).u[-1]
    np.testing.assert_allclose(u, 0.75 * (1 / (A.diagonal()[0] - 1) + np.arange(n)), rtol=1e-6)


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
@pytest.mark.parametrize("kind", ["image", "cut"])
def test_a_body_relaxes_in_a_flat_set_whose_ends_are_far_away(kind):
    """The ends of the set round 1e-14, which is no part of velocities that fall to 1e-11."""
    random = np.random.default_rng(5)
    root, b, M = (random.normal(size=shape) for shape in ((3, 3), (3, 1), (3, 2)))
    A, B, N = root @ root.T + np.eye(3), b @ b.T, scipy.linalg.null_space(M.T)
    rows = np.vstack([N.T, -N.T])
    C = {
        "image": so.image(M, so.Polyhedron(random.normal(size=(3, 2)), [50.0] * 3)),
        "cut": so.Ball([0.0] * 3, 50.0) & so.Polyhedron(rows, [0.0, 0.0]),
    }[kind]
    u = random.normal(size=3)
    sol = so.solve(so.SweepingProcess(A, B, C, u), t_end=56.0, steps=28, scheme="implicit-euler")
    for z in sol.velocity:  # across the plane alone, linear
        expected = -N @ np.linalg.solve(N.T @ (A + 2 * B) @ N, N.T @ B @ u)
        assert np.linalg.norm(z - expected) <= 1e-6 * np.linalg.norm(expected)
        u = u + 2 * expected
    assert 0 < np.linalg.norm(expected) < 1e-10
