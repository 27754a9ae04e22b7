"""Sets that move obey the algebra of sets that do not, at every time."""

import numpy as np
import pytest
from cases import SQUARE, isotropic, refuses, worst_certificate
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import sweepopt as so

TIMES = (0.3, 2.0)
G = np.vstack([np.eye(2), -np.eye(2), [[1.0, 1.0]]])
BALL = so.Ball([0.2, -0.1], 0.8)


def offsets(t):
    return np.array([1 + t, 1, 1, 1 + t * t, 1.5])


WAVES = so.Separable([(so.Sine(2.0, 1.3), [1.0, -1.0]), (so.Triangle(1.0, 0.9), [0.0, 2.0])])
FAMILIES = {
    "data": so.Moving(so.Box([-1, -2], [1, 2]), WAVES),
    "scaled data": so.Moving(BALL, WAVES, so.Sine(0.3, 1.1, offset=1.0)),
    "translated": so.Moving(so.Box([-1, -2], [1, 2]), center=lambda t: [np.sin(t), t]),
    "scaled": so.Moving(BALL, scale=lambda t: 1 + t),
    "both": so.Moving(so.Ellipsoid([0, 0], [[2, 1], [1, 2]]), lambda t: [t, 1.0], lambda t: 2 - t),
    "offsets": so.Polyhedron(G, offsets),
    "any": so.MovingSet(lambda t: so.Ball([t, 0.0], 1 + t)),
}


def same(C, D):
    """Equal support functions and projections."""
    rng = np.random.default_rng(0)
    assert C.dim == D.dim
    for z in rng.normal(size=(3, C.dim)):
        np.testing.assert_allclose(C.support(z), D.support(z), atol=1e-7)
        np.testing.assert_allclose(C.project(4 * z), D.project(4 * z), atol=1e-12)


OPERATIONS = {
    "C+v": lambda C: C + [1.0, 2.0],
    "v+C": lambda C: np.array([1.0, 2.0]) + C,
    "C-v": lambda C: C - [1.0, 2.0],
    "v-C": lambda C: [1.0, 2.0] - C,
    "rC": lambda C: 2.0 * C,
    "Cr": lambda C: C * np.float64(0.5),
    "-rC": lambda C: -3.0 * C,
    "-C": lambda C: -C,
    "C+D": lambda C: C + BALL,
    "D+C": lambda C: BALL + C,
    "C&D": lambda C: C & so.Ball([0.0, 0.0], 5.0),
    "D&C": lambda C: so.Ball([0.0, 0.0], 5.0) & C,
    "product": lambda C: so.product(C, BALL, C),
    "image": lambda C: so.image([[1.0, 0.0], [1.0, 1.0], [0.0, 2.0]], C),
    "C+D(t)": lambda C: C + FAMILIES["any"],
    "product with D(t)": lambda C: so.product(C, FAMILIES["any"]),
    "C&D(t)": lambda C: C & so.MovingSet(lambda t: so.Ball([0.0, t], 3.0)),
}


@pytest.mark.parametrize("operation", OPERATIONS)
def test_operations_commute_with_time(operation):
    turn = [*OPERATIONS].index(operation)
    cuts = [*FAMILIES.values()][turn % 7 :: 3]  # whose supports are programs
    for C in cuts if "&" in operation else FAMILIES.values():
        for t in TIMES:
            same(OPERATIONS[operation](C).at(t), OPERATIONS[operation](C.at(t)).at(t))


@pytest.mark.parametrize("operation", ["C+v", "v-C", "-rC", "C+D", "product", "image"])
@pytest.mark.parametrize("family", ["data", "scaled data"])
def test_sums_multiples_images_and_products_of_translates_by_data_are_such(family, operation):
    C = OPERATIONS[operation](FAMILIES[family])
    process = so.SweepingProcess(
        np.eye(C.dim), np.eye(C.dim), C, C.at(0.0).project(np.zeros(C.dim))
    )
    assert so.solve(process, t_end=1.0, steps=3).error_bound().guaranteed


@pytest.mark.parametrize("unit", [0.3, 1.0, 5.0])
def test_rows_of_any_length_mean_the_same_set_after_operations(unit):
    C = so.Moving(so.Polyhedron(unit * G, np.full(5, unit)), WAVES, so.Sine(0.3, 1.1, offset=1.0))
    D = so.Moving(so.HalfSpace([0.0, unit], 0.7 * unit), WAVES)
    operations = (
        lambda C, D: C & D,
        so.product,
        lambda C, D: so.image([[1.0, 1.0], [0.0, 2.0]], C & D) + C,
    )
    for operation in operations:
        for t in TIMES:
            same(operation(C, D).at(t), operation(C.at(t), D.at(t)))


def test_a_moving_box_of_no_width_is_a_factor_of_products():
    C = so.Moving(so.Box([0.0, 0.0], [0.0, 0.0]), WAVES, so.Sine(0.3, 1.1, offset=1.0))
    D = so.Moving(BALL, scale=so.Triangle(0.3, 9.0))
    for t in TIMES:
        same(so.product(C, D).at(t), so.product(C.at(t), D.at(t)))


@settings(derandomize=True, deadline=None, max_examples=30, database=None)
@given(st.floats(-10, 10), st.integers(0, 1000))
def test_a_moving_set_is_center_plus_scale_times_shape(t, seed):
    rng = np.random.default_rng(seed)
    shape = so.Polytope(rng.normal(size=(5, 3)))
    C = so.Moving(shape, center=lambda t: np.full(3, t), scale=lambda t: t * t).at(t)
    z = rng.normal(size=3)
    expected = t * z.sum() + t * t * shape.support(z)
    np.testing.assert_allclose(C.support(z), expected, atol=1e-12)


def from_five(t):
    """Offsets of G that a load table gives on [5, 10] only."""
    if not 5 <= t <= 10:
        raise so.InputError(f"the table ends at 5 and 10, got {t:g}")
    return offsets(t)


def test_a_set_with_a_known_dim_is_not_asked_for_before_it_starts():
    ball = so.MovingSet(lambda t: so.Ball(from_five(t)[:2], 1.0), dim=2)
    for C, dim in (
        (so.Polyhedron(G, from_five), 2),
        (so.image(np.ones((3, 2)), ball), 3),
        (so.image(np.ones((3, 2)), so.Polyhedron(G, from_five)), 3),
        (so.product(ball, so.Polyhedron(G, from_five)), 4),
        (ball + so.Polyhedron(G, from_five), 2),
    ):
        assert C.dim == dim
        assert C.at(5.0).same_cone(C.at(6.0))
    with refuses(r"at t = 0: the table .*; give dim= if"):
        so.MovingSet(lambda t: so.Ball(from_five(t), 1.0))
    load = so.Polyhedron([[1.0], [-1.0]], lambda t: from_five(t)[:2] + 5 * (t - 5))
    process = isotropic(load)
    assert so.solve(process, steps=np.linspace(5, 6, 5)).t[0] == 5.0


def test_a_moving_point_is_its_center():
    point = so.Moving(so.Point([1.0, 0.0]), center=lambda t: [t, t], scale=2.0).at(3.0)
    shrunk = so.Moving(BALL, center=[5.0, 3.0], scale=lambda t: 1 - t).at(1.0)
    for C in (point, shrunk):
        assert C.singleton
        np.testing.assert_array_equal(C.anchor, [5.0, 3.0])
    C = so.Moving(so.Orthant(2), center=lambda t: [t, 2 * t])
    np.testing.assert_array_equal(C.at(1.5).anchor, [1.5, 3.0])
    assert BALL.at(9.0) is BALL


def boom(t):
    return so.Box(0.0, 1.0 - t)


def test_a_set_that_becomes_empty_says_when_once():
    C = so.MovingSet(boom) & so.Box(-5.0, 5.0)
    with pytest.raises(so.EmptySetError, match=r"^C\(t\) at t = 1.5: Box is empty"):
        C.at(1.5)
    assert C.at(1.0).contains([0.0])


@pytest.mark.parametrize("solver", ["auto", "daqp", "osqp"])
def test_a_box_shrinks_through_all_sizes_to_a_point_and_grows_again(solver):
    A, f = np.array([[2.0, -1.0], [-1.0, 2.0]]), np.array([3.0, 1.0])
    sizes = [4.0, 1e-16, 1e-40, 1e-70, 1e-74, 0.0, 1e-70, 1e-16, 1.0]
    C = so.Moving(SQUARE, f, scale=lambda t: sizes[round(t)])
    process = so.SweepingProcess(A, None, C, [0.0, 0.0])
    sol = so.solve(process, t_end=8.0, steps=8, scheme="implicit-euler", solver=solver, tol=1e-12)
    assert sol.success
    for z, size in zip(sol.velocity, sizes[1:], strict=True):
        np.testing.assert_allclose(A @ z, f - size, atol=1e-12)


# ---- sets that depend on the state ----------------------------------------------------------

A, B, RATE, DISTANCE, RESIDUAL = 0.5, 1.0, 1.5, 0.2, 0.4
"""A mass whose friction falls from 1 to RESIDUAL with the slip u, under the load 1 + RATE t."""
STEEPEST = (1 - RESIDUAL) / DISTANCE


def weakened(u):
    return RESIDUAL + (1 - RESIDUAL) * np.exp(-abs(u) / DISTANCE)


def mass(viscosity=A, steepest=STEEPEST):
    C = so.StateDependent(
        lambda t, u: so.Box(1 + RATE * t - weakened(u), 1 + RATE * t + weakened(u)), steepest
    )
    return so.SweepingProcess(viscosity, B, C, u0=0.0)


def exact(times):
    """u by SciPy: it slips forward from t = 0 on, so that A u' + B u = 1 + RATE t - g(u)."""
    run = solve_ivp(
        lambda t, u: (1 + RATE * t - weakened(u) - B * u) / A,
        (0.0, times[-1]),
        [0.0],
        t_eval=times,
        method="DOP853",
        rtol=1e-12,
        atol=1e-14,
    )
    return run.y[0]


@pytest.mark.parametrize(
    "scheme, order, ceiling",
    [
        ("catching-up", 1, 0.012),
        ("implicit-euler", 1, 0.008),
        ("midpoint", 2, 4e-5),
        ("trapezoid", 2, 4e-5),
        ("sdirk2", 2, 1e-5),
    ],
)
def test_friction_that_weakens_with_slip_keeps_the_order_of_a_scheme(scheme, order, ceiling):
    errors = []
    for steps in (40, 80, 160, 320):
        sol = so.solve(mass(), t_end=2.0, steps=steps, scheme=scheme, tol=1e-10)
        assert sol.success
        assert worst_certificate(sol) <= 1e-10
        errors.append(abs(sol.u[:, 0] - exact(sol.t)).max())
    slopes = np.diff(np.log2(errors))
    assert np.allclose(slopes, -order, atol=0.1), (errors, slopes)
    assert errors[-1] < ceiling


def test_the_velocity_of_a_state_has_the_set_of_that_state():
    velocity = so.velocity_field(mass(), tol=1e-10)
    run = solve_ivp(velocity, (0.0, 2.0), [0.0], method="LSODA", rtol=1e-11, atol=1e-13)
    assert abs(run.y[0, -1] - exact([0.0, 2.0])[-1]) < 1e-8


def test_the_contraction_is_computed_and_is_that_of_the_iteration():
    """Of one mass mu L / (A + mu B), which the iterates of a step by hand show too."""
    mu = 0.05
    sol = so.solve(mass(), t_end=1.0, steps=20, scheme="implicit-euler")
    assert sol.plan.contraction == pytest.approx(mu * STEEPEST / (A + mu * B), rel=1e-8)
    assert f"contraction {sol.plan.contraction:.2g}" in str(sol.plan)
    z = [0.0]
    for _ in range(12):
        z.append((1 + RATE * mu - weakened(mu * z[-1])) / (A + mu * B))
    moved = np.abs(np.diff(z))
    assert (moved[1:8] <= sol.plan.contraction * moved[:7]).all()
    assert moved[1] > 0.7 * sol.plan.contraction * moved[0]
    assert sol.velocity[0, 0] == pytest.approx(z[-1], rel=1e-6)
    assert so.solve(mass(), t_end=1.0, steps=20, scheme="catching-up").plan.contraction == 0


def test_a_step_that_is_no_contraction_is_refused_with_the_size_of_one_that_is():
    with pytest.raises(
        so.UnstableStepError, match=r"contraction is 1.71, not .* at most 0.167"
    ) as one:
        so.solve(mass(), t_end=2.0, steps=3, scheme="implicit-euler")
    size = float(str(one.value).rpartition(" ")[2])
    assert so.solve(mass(), t_end=2.0, steps=int(2 / size) + 1, scheme="implicit-euler").success
    with pytest.raises(so.UnstableStepError, match="no shorter step helps, as B u alone"):
        so.solve(mass(viscosity=0.0), t_end=2.0, steps=1000)


def test_a_lipschitz_matrix_that_is_too_small_is_found_by_the_iteration():
    def friction(t, u):
        g = 0.5 + 2 * abs(u)
        return so.Box(5 * t - g, 5 * t + g)

    C = so.StateDependent(friction, 0.01)
    with refuses(r"lipschitz of C\(t, u\) is too small: at t = "):
        so.solve(isotropic(C), t_end=1.0, steps=10)


@pytest.mark.parametrize("seed", [46, 50, 51])
def test_a_lipschitz_matrix_that_is_just_large_enough_is_no_error(seed):
    """Of 60 such bodies these iterate down to what the ends of their sets round."""
    random = np.random.default_rng(seed)
    n = int(random.integers(1, 4))
    A, B = (np.diag(10 ** random.uniform(-1, 1, n)) for _ in range(2))
    g, w = random.random(n) + 0.2, random.uniform(0.1, 0.6)
    steps, force = int(random.integers(10, 40)), 2 * random.normal(size=n)

    def weakening(t, u):
        friction = g * (1 - w * np.tanh(abs(u)))
        load = force * np.sin(2 * t) + 0.3 * t
        return so.Box(load - friction, load + friction)

    process = so.SweepingProcess(A, B, so.StateDependent(weakening, np.diag(g * w)), np.zeros(n))
    for scheme in ("implicit-euler", "sdirk2", "auto"):
        assert so.solve(process, t_end=3.0, steps=steps, scheme=scheme, tol=1e-9).success


def test_what_a_set_adds_to_the_rate_counts_for_the_step_of_the_explicit_scheme():
    def run(steps):
        C = so.StateDependent(lambda t, u: so.Box(t - 1 - 10 * abs(u), t + 1 + 10 * abs(u)), 10)
        process = isotropic(C)
        return so.solve(process, t_end=2.0, steps=steps, scheme="catching-up")

    with pytest.raises(so.UnstableStepError, match=r"step \* Lam = 5; take steps <= 0\.1"):
        run(4)
    assert run(20).success


def test_a_function_of_the_state_cannot_change_it():
    def C(t, u):
        u *= 0
        return so.Box(-1, 1)

    process = so.SweepingProcess(1.0, None, so.StateDependent(C, 0.1), 2.0)
    with pytest.raises(ValueError, match="read-only"):
        so.solve(process, t_end=1.0, steps=5)


def test_energy_viability_and_programs_see_the_set_of_the_state(tmp_path):
    sol = so.solve(mass(), t_end=2.0, steps=400, scheme="midpoint")
    assert abs(sol.energy().balance).max() < 2e-5
    assert sol.viability([0.5, 1.5]).max() < 5e-3
    program = sol.step_program(200)
    program.problem.solve(solver="CLARABEL")
    assert program.z.value == pytest.approx(sol.velocity[200], rel=1e-6)
    stop = so.Checkpoint(tmp_path / "run.npz", steps=20)
    so.solve(mass(), t_end=2.0, steps=80, checkpoint=stop, callback=lambda step: step.step == 50)
    whole = so.solve(mass(), t_end=2.0, steps=80, checkpoint=tmp_path / "other.npz")
    assert np.array_equal(so.resume(stop.path, mass()).u, whole.u)
    with refuses(r"C\(t\)"):
        so.resume(stop.path, mass(steepest=2 * STEEPEST))
