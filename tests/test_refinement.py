"""The velocity of A, B and u themselves, where solvers see their rounded sum and product."""

import math
from decimal import Decimal, localcontext
from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp
from cases import SQUARE, isotropic, worst_certificate

import sweepopt as so
from sweepopt.study.hard import Program
from sweepopt.study.hard.bodies import chain, spectral
from sweepopt.study.hard.exact import ROUNDING
from sweepopt.study.hard.velocities import combination, make

pytestmark = pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
N = 12
FEW = np.eye(N)[:, [1, 4, 5, 9]]
EDGE = np.random.default_rng(7).uniform(0.2, 1.0, N)
SETS = {
    "a point": lambda: so.Point(np.zeros(N)),
    "a box": lambda: so.Box(-EDGE, EDGE),
    "a box on a few": lambda: so.image(FEW, so.Box(-EDGE[:4], EDGE[:4])),
    "a ball": lambda: so.Ball(np.zeros(N), 0.5),
    "discs on a few": lambda: so.image(FEW, so.Balls(EDGE[:2], 2)),
    "a polyhedron": lambda: so.Polyhedron(np.random.default_rng(8).normal(size=(9, N)), np.ones(9)),
}
FORMS = {"dense": np.array, "sparse": sp.csc_array}


def one_step(process, gamma, tol=1e-9):
    """The velocity for M = A + gamma B."""
    scheme = "implicit-euler" if gamma else "catching-up"
    how = {"scheme": scheme, "tol": tol, "on_unstable": "ignore"}
    return so.solve(process, t_end=gamma or 1e-20, steps=1, **how)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("seed, gamma", [(9, 0.0), (12, 1 / 3)])
def test_stiffness_of_1e10_costs_no_digits(seed, gamma, name, form):
    random = np.random.default_rng(seed)
    # the states that a stiff body comes to: large where it is soft, B u is small beside |B| |u|
    A, B = chain(random, N), spectral(random, 0, 10, N)
    u = np.linalg.solve(B, random.normal(size=N))
    C = so.Moving(SETS[name](), 3 * random.normal(size=N))
    sol = one_step(so.SweepingProcess(FORMS[form](A), FORMS[form](B), C, u), gamma)
    z, certificate = sol.velocity[0], sol.stats["certificate"][0]
    program = Program(A, B, gamma)
    exact = program.solve(u, C.at(0.0))
    # what every velocity is refined to; without that the errors are 5e-8
    assert program.error(z, exact) <= certificate <= 1e-9 * exact.size


def test_a_state_that_only_rounding_moves_rests():
    # B u = (0.1, -0.1) is in C, but the two products in it are rounded to 1e-7
    B, u = np.array([[1e10 + 1, 1e10], [1e10, 1e10 + 1]]), np.array([0.1, -0.1]) * (1 + 2.0**-20)
    assert np.abs(B @ u - u).max() > 1e-8
    process = so.SweepingProcess(np.eye(2), B, so.Moving(so.Box([-1e-9] * 2, [1e-9] * 2), u), u)
    sol = one_step(process, 0.1)
    assert (sol.velocity == 0).all()
    assert sol.stats["certificate"][0] == 0.0


def test_a_diagonal_body_past_its_threshold_by_rounding_rests_to_the_last_bit():
    B, past = np.array([3.0, 7.0]), 1 + np.array([4, 3]) * 2.0**-52
    box = SQUARE
    process = so.SweepingProcess(np.diag([0.5, 1.0]), np.diag(B), box, past / B)
    assert not so.solve(process, t_end=1.0, steps=2).velocity.any()


ON_CIRCLE = {k: np.array([np.cos(k), np.sin(k)]) for k in (14, 23, 38)}


@pytest.mark.parametrize(
    "C",
    [
        pytest.param(so.Ball(3.3 * ON_CIRCLE[23], 3.3), id="ball"),
        pytest.param(so.Ball(3.3 * ON_CIRCLE[23], 3.3) & so.Box([-9, -9], [9, 9]), id="cut"),
        pytest.param(
            so.Ellipsoid(4.8 * np.array([2, 1]) * ON_CIRCLE[38], 4.8**2 * np.diag([4.0, 1.0])),
            id="ellipsoid",
        ),
        pytest.param(so.image([[1, 0.3], [0.2, 1]], so.Ball(2.4 * ON_CIRCLE[14], 2.4)), id="image"),
    ],
)
def test_a_force_of_zero_on_the_boundary_of_a_set_with_a_centre_moves_nothing(C):
    # as of 0 + (centre + ball around 0): what rounds is the centre
    process = so.SweepingProcess([[2.0, 0.5], [0.5, 1.0]], np.eye(2), C, [0.0, 0.0])
    assert not so.solve(process, t_end=1.0, steps=1, scheme="implicit-euler").velocity.any()


def test_zero_is_inside_of_a_composed_set_that_rounds_with_the_operand_it_is_cut_by():
    a, c = np.random.default_rng(2).uniform([-1.0, 0.3], 1.0)
    far = so.HalfSpace([1.0], -40.0) + 40.0 + c
    C = (so.Ball([a], 1.0) & far) + so.Ball([0.3 - a], 0.5) - np.array([c])
    assert not C.normal(np.zeros(1)).any()
    assert C.normal(np.array([3.0]))[0] == pytest.approx(3.0 - (min(a + 1, c) + 0.8 - a - c))


@pytest.mark.parametrize("start", ["there", "far"])
@pytest.mark.parametrize("scheme", ["implicit-euler", "sdirk2"])
def test_a_body_near_its_equilibrium_is_certified(start, scheme):
    random = np.random.default_rng(13)
    A, row, u0 = chain(random, N), random.normal(size=N), 1e3 * random.normal(size=N)
    B, steps, mu = np.outer(row, row), 3, 1e-6
    load = B @ u0  # but for rounding
    if start == "far":
        B, load, u0, steps, mu = chain(random, N), random.normal(size=N), 0 * u0, 200, 2.0
    process = so.SweepingProcess(A, B, so.Point(load), u0)
    sol = so.solve(process, t_end=steps * mu, steps=steps, scheme=scheme, tol=1e-9)
    assert sol.success
    last = sol.velocity[-1]
    assert np.abs(last).max() < (1e-9 if start == "there" else 1e-12)
    if scheme == "implicit-euler":
        u, program = sol.u[-2], Program(A, B, mu)
        exact = program.solve(u, process.C.at(sol.t[-1]))
        assert program.error(last, exact) <= 1e-8 * exact.size


@pytest.mark.parametrize("name", ["a point", "a box on a few"])
@pytest.mark.parametrize("stiffness", [None, 0.5])
def test_a_tolerance_near_rounding_is_met_by_a_closer_look(name, stiffness):
    n = 600
    K = sp.csc_array(sp.diags_array([-1.0, 2.0 + 1e-6, -1.0], offsets=[-1, 0, 1], shape=(n, n)))
    few = sp.csc_array((np.ones(3), ([5, 100, 400], range(3))), shape=(n, 3))
    C = so.Point(np.zeros(n)) if name == "a point" else so.image(few, so.Box([-1.0] * 3, [1.0] * 3))
    f = np.random.default_rng(0).normal(size=n)
    moving = so.Moving(C, center=lambda t: t * f)
    process = so.SweepingProcess(K, stiffness and stiffness * K, moving, np.zeros(n))
    rough, fine = (so.solve(process, t_end=1.0, steps=5, tol=tol) for tol in (1e-6, 1e-11))
    assert fine.success
    assert 0 < worst_certificate(fine) <= 1e-11 < worst_certificate(rough)


# ---- one unknown, in plain numbers -------------------------------------------------------------


@pytest.mark.parametrize("scheme", ["catching-up", "implicit-euler", "trapezoid", "sdirk2"])
@pytest.mark.parametrize("B", [1.0, 1e12])
def test_one_unknown_alone_moves_as_one_of_two(scheme, B):
    load = so.Separable([(so.Sine(2.0, 3.0), 1.0), (so.Constant(0.25), 1.0)])
    A = 1e12 if scheme == "catching-up" and B > 1 else 0.5
    alone = so.SweepingProcess(A, B, so.Moving(so.Box(-0.75, 0.5), load), 0.3 / B)
    twice = so.Separable([(one, [1.0, 1.0]) for one, _ in load.terms])
    box = so.Box([-0.75] * 2, [0.5] * 2)
    both = so.SweepingProcess(A * np.eye(2), B * np.eye(2), so.Moving(box, twice), [0.3 / B] * 2)
    one, two = (
        so.solve(process, t_end=7.0, steps=100, scheme=scheme, on_unstable="ignore")
        for process in (alone, both)
    )
    np.testing.assert_allclose(one.u, two.u[:, :1], rtol=0, atol=1e-15 * abs(two.u).max())
    assert max(worst_certificate(one), worst_certificate(two)) <= 1e-6
    assert set(one.stats["solver"]) == {"closed form"}


def test_rows_that_are_nearly_the_same_are_told_apart():
    C = so.Polyhedron([[2.0], [0.5], [-1.0]], [2.0, 0.499999995, 1e4])
    process = so.SweepingProcess(1.0, 1.0, C, 1.5)
    sol = so.solve(process, t_end=0.5, steps=1, scheme="catching-up")
    for z in (sol.velocity[0, 0], so.velocity_field(process, tol=1e-10)(0.0, [1.5])[0]):
        assert abs(z + 0.50000001) <= 1e-15 + sol.stats["certificate"][0]
    assert sol.stats["certificate"][0] < 1e-14


@pytest.mark.parametrize("C", [so.Box(-1.0, 1.0), so.Balls([1.0], 1), so.HalfSpace(1.0, 1.0)])
def test_a_velocity_field_looks_closer_where_plain_numbers_round_too_much(C):
    moving = so.Moving(C, so.Constant(1e12))
    process = isotropic(moving, 1.0, 1.0)
    np.testing.assert_allclose(so.velocity_field(process)(0.0, [1e12 + 3]), [-2.0], rtol=1e-12)


def test_a_refined_answer_is_compared_to_the_forces_and_not_to_a_residual():
    # bounds from 0 to inf at condition 1e7: OSQP's first answer is 1e9 times too large
    random = np.random.default_rng([412, 43])
    process = make(combination(random), random)
    sol = so.solve(
        process, t_end=1.0, steps=1, scheme="implicit-euler", solver="osqp", path="eliminated"
    )
    size = sol.stats["certificate"][0] / sol.stats["relative"][0]
    exact = Program(process.A, process.B, 1.0).solve(sol.u[0], process.C.at(1.0))
    assert size <= 1.001 * exact.size


def needle(seed):
    """A polyhedron with opposite faces 1e-13 to 1e-6 from parallel, and a load across it."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 6))
    rows = rng.normal(size=(int(rng.integers(1, n + 1)), n))
    eps = 10.0 ** rng.uniform(-13, -6)
    G = np.vstack([rows, -rows + eps * rng.normal(size=rows.shape)])
    slack = np.where(rng.random(len(G)) < 0.5, eps, 1.0) * rng.random(len(G))
    A, B = (root @ root.T + 1e-3 * np.eye(n) for root in rng.normal(size=(2, n, n)))
    if seed % 5 == 0:  # the projection itself is the answer
        A, B = A[0, 0] * np.eye(n), B[0, 0] * np.eye(n)
    u0 = rng.normal(size=n) * 10.0 ** rng.uniform(-2, 6)
    return so.SweepingProcess(A, B, so.Polyhedron(G, G @ rng.normal(size=n) + slack), u0)


def test_certificates_on_needles_are_no_less_than_the_error():
    """Where slack is rounded 2 of these are below, by up to 2e12, and 4 have no support."""
    certified, mu = 0, 0.1
    for seed in [*range(8), 92]:  # 92 is empty by the rounding of its rows
        process = needle(seed)
        try:
            run = so.solve(process, t_end=mu, steps=1, scheme="implicit-euler")
        except so.StepError:
            continue  # no proof is no wrong one
        if "/" in str(run.stats["solver"][0]):
            continue  # a step in parts has no certificate of the whole
        judge = Program(process.A, process.B, mu)
        exact = judge.solve(process.u0, process.C)
        error = judge.error(run.velocity[0], exact)
        at_rest = 0.0 if run.velocity[0].any() else ROUNDING * exact.forces
        assert error <= run.stats["certificate"][0] + at_rest, seed
        certified += 1
    assert certified >= 7


def test_rows_that_fix_a_point_only_together_are_certified_to_1e_9():
    """Rows of whole numbers, some of which add up to 0 <w> <= 0: all of these are equations."""
    rng, N = np.random.default_rng(0), 12
    rows = rng.integers(-3, 4, size=(4, N)).astype(float)
    G = np.vstack([rows, -rng.integers(1, 4, size=4) @ rows, np.eye(N), -np.eye(N)])
    x = rng.integers(-4, 5, size=N).astype(float)
    h = np.concatenate([G[:5] @ x, x + 5, 5 - x])
    A, B = (root @ root.T + 1e-3 * np.eye(N) for root in rng.normal(size=(2, N, N)))
    process = so.SweepingProcess(A, B, so.Polyhedron(G, h), 100 * rng.normal(size=N))
    run, judge = one_step(process, 0.1), Program(process.A, process.B, 0.1)
    error = judge.error(run.velocity[0], judge.solve(process.u0, process.C))
    assert error <= run.stats["certificate"][0]
    assert run.stats["relative"][0] <= 1e-9


def test_the_support_function_of_a_needle_is_that_of_its_apex():
    for eps in (1e-6, 1e-9, 1e-12):
        C = so.Polyhedron([[0.0, 1.0], [eps, -1.0], [-1.0, 0.0]], [1.0, 1.0, 0.0])
        apex = np.array([2.0 / eps, 1.0])
        for z in ([1.0, 0.0], [0.3, 0.5], [1.0, -1.0]):
            assert np.isclose(C.support(z), max(apex @ z, -z[1], z[1]), rtol=1e-15 / eps)
        assert C.support([-1.0, 0.0]) == 0.0


def test_points_beside_a_far_centre_round_as_it_does():
    """The boundary of the ball passes 0: q is beyond it by (|q - c|^2 - 25) / (|q - c| + 5)."""
    c = [-3, -4]
    for q in 2.0**-20 * np.random.default_rng(0).uniform(size=(9, 2)):
        process = so.SweepingProcess(3 * np.eye(2), np.eye(2), so.Ball(c, 5.0), q)
        sol = so.solve(process, t_end=1e-9, steps=1, scheme="catching-up")
        excess = sum(Fraction(x) ** 2 - 2 * Fraction(x) * a for x, a in zip(q, c, strict=True))
        exact = -float(excess) / (np.hypot(*(q - c)) + 5) / 3 * (q - c) / np.hypot(*(q - c))
        error = math.sqrt(3) * np.linalg.norm(sol.velocity[0] - exact)
        assert 0 < error <= sol.stats["certificate"][0]


def test_a_far_centre_rounds_no_unknowns_but_its_own():
    """A ball in units 2^20 times as small, beside another: certificates do not see the units."""
    certificates = []
    for unit in (1.0, 2.0**20):
        d = [unit**2, unit**2, 1.0, 1.0]
        C = so.product(so.Ball([2 * unit, 0], 2 * unit), so.Ball([0.3, 0.1], 1.0))
        process = so.SweepingProcess(np.diag(d), np.diag(d), C, [-0.3 / unit, 0.2 / unit, 2, 0.5])
        with pytest.warns(so.InitialStateWarning):
            sol = so.solve(process, t_end=2.0, steps=5, scheme="implicit-euler")
        certificates.append(sol.stats["certificate"])
    assert np.array_equal(*certificates)


@pytest.mark.parametrize("through_0", [False, True])
def test_what_rounds_at_a_rim_may_be_on_either_side_of_it(through_0):
    """The point of a cut disc next to q, along the normal of its circle at the rim.

    Where the circle and the cut go through 0, the cut rounds nothing and the circle does.
    """
    for angle in np.geomspace(1e-5, 1e-2, 30):
        normal = np.array([np.cos(angle), np.sin(angle)])
        center, rim, away = -normal, 0 * normal, 0.2
        if not through_0:
            center, rim, away = 0 * normal, normal, 1e-16 / angle**2
        q = rim + normal * away
        C = so.Ball(center, 1.0) & so.Box([-np.inf, -np.inf], [rim[0], np.inf])
        process = so.SweepingProcess(np.eye(2), np.eye(2), C, q)
        sol = so.solve(process, t_end=1e-9, steps=1, scheme="catching-up")
        with localcontext() as context:
            context.prec = 50
            x, y, a, b, cut = (Decimal(float(value)) for value in (*q, *center, rim[0]))
            on_circle = a + (x - a) / ((x - a) ** 2 + (y - b) ** 2).sqrt()
            w = min(on_circle, cut)
            exact = w - x, b + (1 - (w - a) ** 2).sqrt() - y
            off = [Decimal(v) - z for v, z in zip(sol.velocity[0].tolist(), exact, strict=True)]
            assert sum(a * a for a in off).sqrt() <= Decimal(sol.stats["certificate"][0])


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
def test_a_body_relaxes_to_rest_in_a_disc_of_space():
    """A projection starts from the normals before, those of opposite rows too: these cancel."""
    rng = np.random.default_rng(3)
    b, u0, row = rng.normal(size=(3, 3))
    C = so.Ball(np.zeros(3), 50.0) & so.Polyhedron([row, -row], [0.0, 0.0])
    process = so.SweepingProcess(np.diag([1.0, 2.0, 3.0]), np.outer(b, b), C, u0)
    run = {"scheme": "sdirk2", "on_unstable": "ignore"}
    assert so.solve(process, t_end=40.0, steps=40, **run).success
