"""The velocity program: every solver path, the certificate against the true error."""

import math
import sys
import warnings
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
from cases import SQUARE, isotropic, worst_certificate
from hypothesis import given, settings
from hypothesis import strategies as st

import sweepopt as so
from sweepopt.linalg import Factor
from sweepopt.velocity import VelocityProgram, certify

SOLVERS = [so.Clarabel(), so.OSQP(), so.DAQP(), so.Cvxpy("CLARABEL"), so.Cvxpy("OSQP")]


def exact_friction(M, q, g):
    """argmin 1/2 <Mz,z> + <q,z> + sum g_k |z_k| by trying all sign patterns."""
    n = len(q)
    for signs in product((-1, 0, 1), repeat=n):
        s = np.array(signs)
        moving = s != 0
        z = np.zeros(n)
        z[moving] = np.linalg.solve(M[np.ix_(moving, moving)], -(q + g * s)[moving])
        force = M @ z + q
        if (z * s >= 0).all() and (np.abs(force[~moving]) <= g[~moving] * (1 + 1e-12)).all():
            return z
    raise AssertionError("a strongly convex program has a solution")


def random_program(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    root = rng.normal(size=(n, n))
    return root @ root.T + 0.1 * np.eye(n), 3 * rng.normal(size=n), rng.uniform(0, 3, size=n)


def solved(solver, M, q, C):
    """The certified answer of one solver, without others behind it."""
    program = VelocityProgram(Factor(M), C)
    answer = solver.compile(program)(q, C)
    return certify(program.M, q, C, answer.z)


@pytest.mark.parametrize("solver", SOLVERS, ids=lambda solver: solver.name)
@pytest.mark.parametrize("scale", [2.0**-40, 1.0, 2.0**40])
def test_every_solver_finds_the_exact_velocity_within_its_certificate(solver, scale):
    for seed in range(4):
        M, q, g = random_program(seed)
        found, exact = (
            solved(solver, M, scale * q, so.Box(-scale * g, scale * g)),
            exact_friction(M, q, g),
        )
        size = scale * Factor(M).dual_norm(q)
        assert Factor(M).norm(found.z - scale * exact) <= found.certificate + 1e-14 * size
        assert found.relative <= 1e-6
        # stuck unknowns among moving ones are exactly zero
        assert ((found.z == 0) == (exact == 0)).all()


@pytest.mark.parametrize(
    "C",
    [
        so.Balls([1.0, 3.0], 2),
        -0.5 * so.Balls([1.0, 3.0], 2) + np.arange(4.0),
        2.0 * so.Ball([1.0, 0.0, -1.0, 0.5], 2.0) + np.ones(4),
        so.Balls([1.0, 0.0, 2.0, 1.0], 1),
        so.image(np.eye(4)[[3, 0, 2, 1]], so.product(so.Ball([0, 0], 1.0), so.Ball([0, 0], 3.0))),
    ],
    ids=["balls", "moved and scaled", "a ball moved and scaled", "with a point", "permuted"],
)
def test_the_active_set_method_meets_balls_wherever_they_are(C):
    rng = np.random.default_rng(5)
    root = np.linalg.qr(rng.normal(size=(4, 4)))[0]
    M = root * np.geomspace(1e-4, 1e4, 4) @ root.T
    assert so.ActiveSet().treats(C)
    found = solved(so.ActiveSet(), (M + M.T) / 2, 9 * rng.normal(size=4), C)
    assert found.z.any()
    assert found.relative <= 1e-9


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
@pytest.mark.parametrize("seed", [630, 658])
def test_boxes_beside_discs_are_met_across_jumps_of_stiffness(seed):
    rng = np.random.default_rng(seed)
    box = so.Box(-np.ones(4), 10 ** rng.uniform(-3, 3, 4))
    C = so.product(box, so.Balls(10 ** rng.uniform(-3, 3, 3), 2))
    k = 10 ** rng.uniform(0, 8, 11)
    A = np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
    pull = 10 * rng.normal(size=10) * np.abs(C.project(np.full(10, 1e9)))
    moving = so.Moving(C, so.Separable([(so.Sine(1.0, 2.0), pull)]))
    assert so.solve(so.SweepingProcess(A, None, moving, np.zeros(10)), t_end=1.0, steps=2).success


@settings(derandomize=True, deadline=None, max_examples=100)
@given(seed=st.integers(0, 10**6), noise=st.floats(-12, 1))
def test_the_certificate_is_never_below_the_error_of_any_answer(seed, noise):
    M, q, g = random_program(seed)
    C = so.Box(-g, g)
    exact = exact_friction(M, q, g)
    rng = np.random.default_rng(seed + 1)
    guess = exact + 10**noise * rng.normal(size=len(q))
    program = VelocityProgram(Factor(M), C)
    velocity = certify(program.M, q, C, guess)
    error = program.M.norm(velocity.z - exact)
    assert error <= velocity.certificate * (1 + 1e-9) + 1e-14 * program.M.dual_norm(q)
    # and it is of the size of the noise, not of its square root
    assert velocity.certificate <= 100 * np.linalg.cond(M) * 10**noise * np.linalg.norm(M) + 1e-12


def test_one_compiled_program_serves_all_translates_scales_and_offsets():
    compiled = []

    class Counting(so.Clarabel):
        def compile(self, program):
            compiled.append(program)
            return super().compile(program)

    motions = [
        so.Moving(so.Ball([0, 0], 1), lambda t: [9 * np.sin(t), t], lambda t: 1 + 0.5 * np.cos(t)),
        so.Polyhedron([[1.0, 0], [0, 1], [-1, -1]], lambda t: [np.cos(4 * t), np.cos(t), 1 + t]),
        so.MovingSet(lambda t: so.Ball([2 * np.sin(t), 1.0], 1 + t / 4)),
        so.Moving(SQUARE, lambda t: [2.5 * t, 0]) & so.Ball([0, 0], 2),
    ]
    for C in motions:
        compiled.clear()
        process = isotropic(C, 1.0, 1.0)
        times = np.append(np.linspace(0.0, 0.25, 11), np.linspace(0.25, 0.5, 6)[1:])
        sol = so.solve(process, steps=times, solver=Counting(), on_unstable="ignore")
        assert sol.success
        assert 1 <= len(compiled) <= 2  # for two sizes of steps, equal but for rounding


class Disc(so.ConvexSet):
    """As a user may write it: cvxpy replaces a variable with a sign, and drops one without ties."""

    dim, offsets = 2, np.ones(1)

    def support(self, z):
        return float(np.linalg.norm(z))

    def project(self, w):
        return w / max(1.0, float(np.linalg.norm(w)))

    def features(self, p):
        import cvxpy as cp

        y = cp.Variable(1, nonneg=True)
        return [y + 0 * cp.Variable(1)], [cp.norm(p) <= y]


@pytest.mark.parametrize("solver", ["clarabel", "cvxpy"])
def test_features_may_have_any_variables(solver):
    M, q = np.array([[2.0, 0.5], [0.5, 1.0]]), np.array([3.0, -1.0])
    own, ball = (velocity(M, q, C, solver=solver) for C in (Disc(), so.Ball([0, 0], 1)))
    assert Factor(M).norm(own.z - ball.z) <= own.certificate + ball.certificate


def velocity(M, q, C, **settings):
    """z with -z in N_C(M z + q), and the statistics, of the first step of a run with load -q."""
    process = so.SweepingProcess(M, None, so.Moving(C, -q), np.zeros(len(q)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", so.InitialStateWarning)
        sol = so.solve(process, t_end=1.0, steps=1, **settings)
    stats = dict(zip(sol.stats.dtype.names, sol.stats[0].tolist(), strict=True))
    return SimpleNamespace(z=sol.velocity[0], **stats)


@pytest.mark.parametrize("solver", ["auto", "clarabel", "osqp"])
def test_rows_beside_a_set_on_few_unknowns_are_as_exact_as_the_same_set_all_in_rows(
    solver,
):
    rng, condition = np.random.default_rng(5), 1e2
    G, h = rng.normal(size=(7, 3)), rng.uniform(0.1, 1.0, 7)
    box, few = so.Box([-0.5, -0.2], [0.3, 0.4]), np.eye(3)[:, [0, 2]]
    sides = np.vstack([np.eye(3), -np.eye(3)])
    same = so.Polyhedron(
        scipy.linalg.block_diag(G, sides), np.concatenate([h, [0.3, 0, 0.4, 0.5, 0, 0.2]])
    )
    turn = np.linalg.qr(rng.normal(size=(6, 6)))[0]
    M = (turn * np.geomspace(1, condition, 6)) @ turn.T
    M, norm = 0.5 * (M + M.T), Factor(M).norm
    C = so.product(so.Polyhedron(G, h), so.image(few, box))
    for q in 10 * rng.normal(size=(2, 6)):
        found = velocity(M, q, C, solver=solver, tol=1e-12)
        other = velocity(M, q, same, solver="active-set", tol=1e-12)
        assert norm(found.z - other.z) <= 1e-12 * math.sqrt(condition) * norm(other.z)


@pytest.mark.parametrize("kind, solver", [("hull", "newton"), ("rows", "active-set")])
def test_a_set_that_is_given_anew_is_asked_of_a_solver_that_compiles_next_to_nothing(kind, solver):
    points, load = np.random.default_rng(0).normal(size=(12, 5)), np.ones(5)

    def at(t):
        moved = points + 0.1 * np.cos(t * points)
        if kind == "hull":
            return so.Polytope(moved + 3 * np.sin(3 * t) * load)
        return so.Polyhedron(moved, 1 + 3 * np.sin(3 * t) * moved @ load)

    process = so.SweepingProcess(np.eye(5) + 0.5, None, so.MovingSet(at), load)
    sol = so.solve(process, t_end=2.0, steps=20)
    assert worst_certificate(sol) <= 1e-6
    assert set(sol.stats["solver"][1:]) <= {solver, "at rest"}
    fixed = so.SweepingProcess(
        process.A, None, so.Moving(at(0.0), lambda t: np.sin(t) * load), load
    )
    assert "osqp" in so.solve(fixed, t_end=2.0, steps=20).stats["solver"]


LOOSE_TO_TIGHT = (1e-1, 1e-4, 1e-9)


@pytest.mark.parametrize("solver", ["osqp", "clarabel"])
@pytest.mark.parametrize("path", ["full", "eliminated"])
def test_a_loose_tolerance_is_cheaper_and_is_met_by_a_looser_certificate(solver, path):
    rng, n = np.random.default_rng(3), 40
    M = 2.05 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    C = so.image(np.eye(n)[:, ::4], so.Box(-np.ones(10), np.ones(10)))
    q = 3 * rng.normal(size=n)
    exact = velocity(M, q, C)
    found = [velocity(M, q, C, solver=solver, path=path, tol=tol) for tol in LOOSE_TO_TIGHT]
    work = [one.iterations for one in found]
    assert work[0] < work[1] < work[2]
    assert [one.attempts for one in found[:2]] == [1, 1]
    assert found[0].relative > 1e3 * found[2].relative
    for one, tol in zip(found, LOOSE_TO_TIGHT, strict=True):
        assert one.relative <= tol
        assert Factor(M).norm(one.z - exact.z) <= one.certificate + exact.certificate
        # exact stick is kept
        assert ((one.z == 0) == (exact.z == 0)).all()


def test_a_set_without_proof_makes_the_run_uncertified_and_right():
    """A solver whose word alone counts is asked to be careful."""
    import cvxpy as cp

    random = np.random.default_rng(3)
    root, f = random.normal(size=(4, 4)), so.Separable([(so.Sine(3.0, 4.0), random.normal(size=4))])
    A = root @ root.T + 0.1 * np.eye(4)
    runs = []
    for shape in (so.Constraints(4, lambda w: [cp.norm(w) <= 1]), so.Ball(np.zeros(4), 1.0)):
        process = so.SweepingProcess(A, A, so.Moving(shape, f), np.zeros(4))
        runs.append(so.solve(process, t_end=2.0, steps=4))
    assert runs[0].u[-1] == pytest.approx(runs[1].u[-1], rel=1e-5)
    assert runs[0].status is so.Status.UNCERTIFIED
    assert "uncertified" in runs[0].message
    assert np.isnan(runs[0].stats["certificate"]).any()


def test_a_body_at_rest_in_a_set_without_proof_stays_there():
    """Its velocity and its load are 0: nothing to which a certificate could be compared."""
    import cvxpy as cp

    C, B = so.Constraints(3, lambda w: [cp.norm(w, 1) <= 1]), 0.7 * np.eye(3) + 0.1
    sol = so.solve(so.SweepingProcess(np.eye(3), B, C, np.zeros(3)), t_end=1.0, steps=1)
    assert sol.status is so.Status.UNCERTIFIED
    assert not sol.u.any()


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
def test_where_a_solver_has_no_answer_the_next_is_asked():
    A, box = np.array([[2.0, 1.0], [1.0, 3.0]]), so.Box([-4.0, 3.0], [-2.0, 5.0])
    process = so.SweepingProcess(A, None, box, np.zeros(2))
    blind = so.Cvxpy("OSQP", {"eps_dual_inf": 1e30})  # calls every program unbounded
    velocity = so.solve(process, t_end=1.0, steps=1, solver=blind).velocity[0]
    np.testing.assert_allclose(A @ velocity, [-2.0, 3.0])


def test_a_large_polyhedron_is_not_called_certified():
    n = 1100
    G = sp.vstack([sp.eye_array(n), -sp.eye_array(n)], format="csc")
    polyhedron = so.Moving(so.Polyhedron(G, np.ones(2 * n)), lambda t: np.full(n, 3 * t))
    box = so.Moving(so.Box(-np.ones(n), np.ones(n)), lambda t: np.full(n, 3 * t))
    runs = [
        so.solve(so.SweepingProcess(sp.eye_array(n), None, C, np.zeros(n)), t_end=1.0, steps=1)
        for C in (polyhedron, box)
    ]
    assert runs[0].status is so.Status.UNCERTIFIED
    assert runs[1].status is so.Status.SUCCESS
    assert runs[0].u == pytest.approx(runs[1].u, abs=1e-6)


def test_daqp_takes_a_load_of_next_to_nothing():
    q, M = np.array([5e-324, -5e-324, 0.0]), np.array([[2.0, 1, 0], [1, 3, 1], [0, 1, 2]])
    for scale in (1.0, 1e300):
        assert solved(so.DAQP(), M, scale * q, so.Orthant(3)).relative <= 1e-11


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
@pytest.mark.parametrize("force", [1.0, 1e44, 1e70])
def test_daqp_takes_forces_of_any_size(force):
    M, box = np.array([[2.0, 1.0], [1.0, 3.0]]), force * SQUARE
    C = box + force * np.array([2.5, -3.3])
    answers = [
        so.solve(so.SweepingProcess(M, M, C, np.zeros(2)), t_end=1.0, steps=2, solver=solver).u
        for solver in ("daqp", "newton")
    ]
    np.testing.assert_allclose(answers[0], answers[1], rtol=1e-12)


def test_what_daqp_cannot_treat_or_find_is_said(monkeypatch):
    assert not so.DAQP().treats(so.Balls([1.0], 2))
    assert not so.DAQP().treats(so.Polytope([[0.0, 1], [1, 0], [0, 0]]))
    assert not so.DAQP(max_dim=2).treats(so.Box([-1, -1, -1], [1, 1, 1]))
    C = so.Box(-1.0, 1.0)
    monkeypatch.setitem(sys.modules, "daqp", None)
    with pytest.raises(so.MissingExtraError, match="speed"):
        so.DAQP().compile(VelocityProgram(Factor(np.eye(1)), C))


@pytest.mark.parametrize("shift", [0.0, 1.0])
def test_a_huge_force_on_one_contact_does_not_hold_another_past_its_threshold(shift):
    E, g = np.eye(5)[:, [0, 3]], np.array([1e13, 1.0])
    C, q = so.image(E, so.Box(-g, g)) + np.full(5, shift), np.full(5, shift)
    for excess, rests in ((0.0, True), (1e-6, False)):
        q[[0, 3]] = 1e13, shift + 1.0 + excess
        assert velocity(np.eye(5), q, C).z.any() != rests
    q[[1, 3]] = 1e-6, shift  # beside the contact nothing holds
    assert velocity(np.eye(5), q, C).z.any()


# ---- what is out of reach --------------------------------------------------------------------

FEW = [1, 4, 5, 9]
HELD = np.array([0.7, 1e74, 0.4, 1e12])


def far(kind):
    """Bounds from 0.4 to 1e74 in one set."""
    E, ends = np.eye(12)[:, FEW], np.where(np.arange(12) % 2, 1e74, 0.5)
    return {
        "box": lambda: so.Box(-ends, ends),
        "one side": lambda: so.Box(-ends, np.full(12, 0.5)),
        "contact": lambda: so.image(E, so.Box(-HELD, HELD)) + np.full(12, 0.3),
        "half-lines": lambda: so.image(E, so.Box(-HELD, np.full(4, np.inf))),
        "discs": lambda: so.image(E, so.Balls(HELD[:2], 2)),
        "scaled": lambda: 2.0 * -so.product(so.Balls([1e74, 0.3], 2), so.Box(-ends[:8], ends[:8])),
    }[kind]()


@pytest.mark.parametrize("kind", ["box", "one side", "contact", "half-lines", "discs", "scaled"])
def test_bounds_out_of_reach_blind_no_solver(kind):
    chain = 2.05 * np.eye(12) - np.eye(12, k=1) - np.eye(12, k=-1)
    q = 3 * np.random.default_rng(7).normal(size=12)
    assert velocity(chain, q, far(kind), tol=1e-9).relative <= 1e-9


@pytest.mark.parametrize("seed", [0, 1, 26, 31, 43])
def test_the_certificate_of_a_long_thin_ellipsoid_is_not_below_the_error(seed):
    rng, corner = np.random.default_rng(seed), 1.0 * np.array([1, 1, -1, -1])
    # p is an eigenvector of the shape, so that w = c + p / |p|: all of these numbers are exact
    shape = np.eye(4) + 2.0 ** rng.integers(20, 32) * np.ones((4, 4))
    G = rng.integers(-3, 4, size=(4, 4)).astype(float)
    M, p = G @ G.T + 4 * np.eye(4), 2.0 ** rng.integers(4, 12) * corner
    c = rng.integers(-2, 3, size=4).astype(float)
    found = velocity(M, c + corner / 2 + M @ p, so.Ellipsoid(c, shape), tol=1e-4)
    assert Factor(M).norm(found.z + p) <= found.certificate


@pytest.mark.parametrize("solver", ["auto", "clarabel", "osqp"])
def test_nothing_moves_where_c_is_the_whole_space(solver):
    process = so.EvolutionVI(0.5, 0.5, dissipation=so.WholeSpace(1), u0=[1.0])
    sol = so.solve(process, t_end=1.0, steps=2, solver=solver)
    assert np.array_equal(sol.u, np.ones((3, 1)))


def stuck_in(C, w, p):
    """Which unknowns rest where the force pushes C along its normal p at w: the velocity is -p."""
    M = np.array([[2.0, 0.6, 0.3], [0.6, 1.0, 0.2], [0.3, 0.2, 1.5]])[: w.size, : w.size]
    process = so.SweepingProcess(M, None, C - (w + M @ p), np.zeros(w.size))
    z = so.velocity_field(process)(0.0, process.u0)
    np.testing.assert_allclose(z, -p, atol=1e-6 * np.abs(p).max())
    return (z == 0).tolist()


@pytest.mark.parametrize("height", [31.5, 31.75, 32.0])
def test_a_hull_in_a_box_far_away_slides_along_one_axis_alone(height):
    # rounding was left along the edge: 4e-15 beside 3e-4
    hull = so.Polytope([[58, 32], [58, 31], [58, 33], [57, 32], [56, 30], [56, 35]])
    C = hull & so.Box([-198, -736], [58, 800])
    assert stuck_in(C, np.array([58.0, height]), np.array([3e-4, 0.0])) == [False, True]


@pytest.mark.parametrize("p", [[0.3, 0.0, 0.2], [0.0, 0.1, -0.2], [1.0, 1.0, 0.0]])
def test_a_sum_of_ellipsoids_far_away_slides_along_two_axes_alone(p):
    # rounding was left in the third: 1e-12 beside 0.3
    D, E, p = np.diag([1.0, 4.0, 9.0]), np.diag([25.0, 4.0, 1.0]), np.array(p)
    C = so.Ellipsoid(np.full(3, 3e3), D) + so.Ellipsoid(np.zeros(3), E)
    w = 3e3 + D @ p / np.sqrt(p @ D @ p) + E @ p / np.sqrt(p @ E @ p)
    assert stuck_in(C, w, p) == (p == 0).tolist()


@pytest.mark.parametrize("beyond", [5e-14, 7e-14])
def test_a_force_next_to_the_boundary_is_certified_sharply(beyond):
    """Of a pull of 0 nothing is normal but 0: what rounds in points of the parts is no normal."""
    C = so.Ellipsoid([-1.75, -2.0, 2.0], np.diag([1.0, 4.0, 9.0])) & so.Box([-2, -9, -9], [9, 9, 9])
    process = so.SweepingProcess(np.diag([0.01, 0.1, 10.0]), np.eye(3), C, np.zeros(3))
    z = so.velocity_field(process, tol=1e-8)(0.0, [-1.75, beyond, 2.0])  # refuses 1.3e-7
    np.testing.assert_allclose(z, 0.0, atol=1e-11)


@pytest.mark.parametrize(
    "C",
    [
        so.Polyhedron([[1, 1], [-1, 1], [0, -1]], [1, 1, 1]),
        so.Polytope([[1, 0], [0, 1], [-1, -1]]),
    ],
    ids=["polyhedron", "hull"],
)
def test_a_body_that_moved_comes_to_rest_at_0_to_the_last_bit(C):
    """Solvers, which are asked first then, leave rounding."""
    M = np.array([[2.0, 0.6], [0.6, 1.0]])
    velocity = so.velocity_field(so.SweepingProcess(M, np.eye(2), C, np.zeros(2)))
    for angle in np.linspace(0.0, 6.2, 24):
        far = 20 * np.array([np.cos(angle), np.sin(angle)])
        for share in (1.0, 0.999):
            assert velocity(0.0, far).all()
            assert velocity(0.0, share * C.project(far)).tolist() == [0.0, 0.0]
