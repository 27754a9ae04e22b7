"""The exact trajectory: the reference values, and the inclusion itself where nobody has them."""

import numpy as np
import pytest
import tqdm.auto
from cases import SQUARE, block, isotropic, random_process, refuses, slope, worst_certificate
from reference_cases import GRIDS, REFERENCE, case
from scipy.spatial import ConvexHull

import sweepopt as so
from sweepopt.errors import Status
from sweepopt.study.hard import hard_trajectories
from sweepopt.study.problems import problem

pytestmark = pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
POLYHEDRAL = ("S01", "S02", "S03", "S04", "P09", "P10", "B15", "M16", "E20")
SWITCHES = {name: data["switch_times"] for name, data in REFERENCE.items()}
SLIDING = so.Sine(3.0, np.pi)


def exact(process, t_end, steps=100):
    sol = so.solve(process, t_end=t_end, steps=steps, scheme="exact")
    assert sol.success
    assert np.abs(sol.exact(sol.t) - sol.u).max() <= 1e-14 * np.abs(sol.u).max()
    return sol.exact


def residual(process, found, times):
    """The largest |P_C(w - z) - w| of w = A u' + B u, which is 0 for -u' in N_C(w); relative.

    u' is taken in units of a stiffness, so that both are forces.
    """
    M = process.A if process.A.any() else process.B
    tau, worst, size = float(np.abs(M).max()), 0.0, 1e-2
    for t, u, z in zip(times, found(times), found.velocity(times), strict=True):
        w = process.A @ z + process.times_B(u)
        C = process.C.at(float(t))
        worst = max(worst, float(np.linalg.norm(C.project(w - tau * z) - w)))
        size = max(size, float(np.linalg.norm(tau * z)), float(np.linalg.norm(w)))
    return worst / size


def integral_error(found):
    """How far u is from u0 + int u', by Gauss's rule on fine intervals in every phase."""
    x, weights = np.polynomial.legendre.leggauss(12)
    worst, u = 0.0, found.phases[0].state(found.starts[0])
    ends = [*found.starts[1:], found.end]
    for phase, end in zip(found.phases, ends, strict=True):
        worst = max(worst, np.abs(phase.state(phase.start) - u).max())
        cuts = phase.start + (end - phase.start) * np.append(0.0, np.geomspace(1e-6, 1.0, 40))
        half = 0.5 * np.diff(cuts)[:, None]
        at = cuts[:-1, None] + half * (1 + x)
        u_dot = phase.velocity(at.ravel()).reshape(*at.shape, -1)
        total = half * np.einsum("j,ijk->ik", weights, u_dot)
        worst = max(worst, np.abs(np.diff(phase.state(cuts), axis=0) - total).max())
        u = phase.state(end)
    return worst


def follows_the_inclusion(process, t_end, steps=60, rounding=1e-11):
    """The exact trajectory does, at any time, and u is the integral of its derivative."""
    found = exact(process, t_end, steps)
    times = np.random.default_rng(0).uniform(found.starts[0], found.end, 20)
    assert residual(process, found, times) <= 1e-10
    assert integral_error(found) <= rounding * max(1.0, np.abs(found(times)).max())


@pytest.mark.parametrize("name", [*POLYHEDRAL, "L13"])
def test_values_and_switch_times_are_those_of_the_reference(name):
    this, process = problem(name), problem(name).process()
    found = exact(process, this.t_end)
    for n in GRIDS:
        times = np.append(np.arange(n) * (this.t_end / n), this.t_end)
        error = found(times) - case(name).exact(n)
        assert max(map(process.metric.norm, error)) <= 1e-12
    for t, digits in REFERENCE[name]["digits"].items():
        np.testing.assert_allclose(found(float(t)), np.float64(digits), atol=1e-12)
    if name != "L13":  # linear
        assert found.switches == pytest.approx(SWITCHES[name], abs=1e-10)
        assert len(found.phases) == len(found.switches) + 1


def test_every_node_carries_the_certificate_of_its_inclusion():
    sol = so.solve(problem("P09").process(), t_end=10.0, steps=200, scheme="exact")
    assert set(sol.stats["solver"]) == {"closed form"}
    assert worst_certificate(sol) <= 1e-12
    assert sol.stats["iterations"].sum() == 31  # phases
    assert sol.viability().max() <= 1e-12
    assert "closed forms between the switches" in str(sol.plan)
    assert np.array_equal(sol.velocity, np.diff(sol.u, axis=0) / 0.05)


class Contradictory(so.Sine):
    """A history whose closed form is not that of its values from t = 3 on."""

    def piece(self, a, b):
        piece = super().piece(a, b)
        return piece._replace(waves=[(r * (1 + 1e-3 * (a >= 3)), w, p) for r, w, p in piece.waves])

    def breakpoints(self, a, b):
        return np.array([3.0] if a < 3 < b else [])


def test_a_node_that_misses_tol_stops_the_run():
    process = block(Contradictory(3.0, np.pi))
    with pytest.raises(so.StepError, match=r"the closed form misses the inclusion .* tol is 1e-06"):
        so.solve(process, t_end=8.0, steps=100, scheme="exact")
    sol = so.solve(process, t_end=8.0, steps=100, scheme="exact", on_failure="stop")
    assert sol.status is Status.INEXACT
    assert sol.t[-1] == pytest.approx(2.96)


@pytest.mark.parametrize("whole", [False, True], ids=["generic", "degenerate"])
def test_the_inclusion_holds_at_any_time_and_u_is_the_integral_of_its_derivative(
    whole,
):
    for seed in range(8):
        process, grid = random_process(seed, polyhedral=True, whole=whole)
        follows_the_inclusion(process, None, steps=grid)


# ---- known motions ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "load",
    [
        so.Triangle(1.0, 4.0),
        so.Sine(1.0, 4.0),
        so.Sine(1.0, 3.7, phase=0.3),
        so.Table([0, 1, 3, 4, 5, 12], [0, 1, 1, 0, -1, -1]),
        so.Polynomial([0, 1 / 3, -1 / 36]),
    ],
)
@pytest.mark.parametrize("A", [0.5, 0.0])
def test_a_load_that_just_reaches_the_threshold_moves_nothing(load, A):
    found = exact(block(load, A), 12.0)
    assert found.switches.size == 0
    assert not found.velocity(np.linspace(0, 12, 301)).any()


def test_201_switches_have_the_period_of_the_load_to_rounding():
    # the first ones are those of S03, the same block
    found = exact(block(SLIDING), 50 * np.pi, steps=2)
    assert found.switches[: len(SWITCHES["S03"])] == pytest.approx(SWITCHES["S03"], abs=1e-10)
    assert len(found.switches) == 201
    later = found.switches[20:-1].reshape(-1, 4)  # what the start leaves falls by 100 a period
    periods = np.pi * np.arange(len(later))[:, None]
    assert np.abs(later - later[0] - periods).max() <= 1e-12
    assert np.ptp(found(later), axis=0).max() <= 1e-14


@pytest.mark.parametrize("A", [1e-2, 1e-6, 1e-10])
def test_small_viscosity_tends_to_the_process_without_any(A):
    times = np.linspace(0, 8, 500)
    apart = exact(block(SLIDING, A), 8.0)(times) - exact(block(SLIDING, 0.0), 8.0)(times)
    assert np.abs(apart).max() <= 1.6 * A  # |u' / B| <= 1.5 |f'| / 2


@pytest.mark.parametrize("rates", [(1.0, 1e10), (1e10, 1.0), (1.0, 1e-10), (1e5, 1e-5)])
def test_stiff_bodies_lose_no_digits(rates):
    # slow and fast modes known in closed form: A = X^T X, B = X^T diag(rates) X
    X = np.array([[1.0, 0.5], [0.0, 1.0]] if rates[0] < rates[1] else [[1.0, 0.0], [0.5, 1.0]])
    A, B = X.T @ X, X.T @ np.diag(rates) @ X
    C = so.Moving(so.Point([0.0, 0.0]), so.Separable([(so.Constant(1.0), X.T @ np.array(rates))]))
    times = np.geomspace(1e-11, 5.0, 40)
    expected = np.linalg.solve(X, -np.expm1(-np.outer(rates, times))).T
    found = exact(so.SweepingProcess(A, B, C, [0.0, 0.0]), 5.0)
    assert np.abs(found(times) - expected).max() <= 1e-13


def test_a_hold_of_a_million_relaxation_times_is_one_phase():
    """The velocity only decays: steps proved free of events were as long as a relaxation time,
    and stood still where it underflows."""
    load = so.Table([0.0, 1.0, 1e6, 1e6 + 1.0], [0.0, 3.0, 3.0, 0.0])
    found = exact(block(load), 1e6 + 1.0)
    assert found.switches == pytest.approx([1 / 3, 1.0, 1e6, 1e6 + 2 / 3], abs=1e-9)
    back = 1.5 * (1 / 3 + np.expm1(-4 / 3) / 4)  # slips back by that from 1
    assert found([1e3, 1e6, 1e6 + 1.0]).ravel() == pytest.approx([1.0, 1.0, 1 - back], abs=1e-9)


def test_a_switch_that_the_rounding_of_late_times_puts_too_early_is_passed():
    """The same face followed twice from the same time, and the run ended there."""
    A, B = [[3.6, -1.7], [-1.7, 0.98]], [[0.083, 0.056], [0.056, 0.91]]
    times = np.cumsum([0.0, 1.0, 1e6, 1.0, 1e6])
    load = so.VectorTable(times, [[0.0, 0.0], *2 * [[1.3, 0.2]], *2 * [[2.6, 1.9]]])
    C = so.Moving(so.Box([-0.4, -0.5], [0.6, 1.0]), load)
    process = so.SweepingProcess(A, B, C, np.zeros(2))
    found = so.solve(process, steps=times, scheme="exact").exact
    assert residual(process, found, times[-2] + np.geomspace(0.01, 1e6, 50)) <= 1e-13
    assert integral_error(found) <= 1e-9


def test_a_start_outside_of_the_set_begins_with_a_velocity():
    found = exact(block(SLIDING, u0=5.0), 8.0)
    # 0.5 u' + 2 u = 3 sin 2t + 1 at first
    assert found.velocity(1e-300) == pytest.approx([-18.0])
    assert residual(block(SLIDING, u0=5.0), found, np.linspace(0.01, 8, 60)) <= 1e-12


def test_switches_that_accumulate_end_the_trajectory(monkeypatch):
    monkeypatch.setattr("sweepopt.integrate.exact.trajectory.PHASES", 5)
    sol = so.solve(block(SLIDING), t_end=8.0, steps=100, scheme="exact", on_failure="stop")
    assert sol.status is Status.SWITCHING
    assert 0 < sol.exact.end - sol.t[-1] < 0.08
    with refuses("is outside of"):
        sol.exact(8.0)


class Interrupted(Contradictory):
    """A history at whose breakpoint the user presses Ctrl-C."""

    def piece(self, a, b):
        if a >= 3:
            raise KeyboardInterrupt
        return so.Sine.piece(self, a, b)


def test_phases_are_computed_as_the_steps_come_to_them():
    whole, seen = exact(block(SLIDING), 8.0), list[int]()

    def stop(step):
        seen.append(step.step)
        return step.t >= 2.0

    load = Interrupted(3.0, np.pi)
    for callback, last, status in [(stop, 2.0, Status.STOPPED), (None, 2.96, Status.INTERRUPTED)]:
        process = block(load)
        sol = so.solve(process, t_end=8.0, steps=100, scheme="exact", callback=callback)
        assert sol.status is status
        assert sol.t[-1] == pytest.approx(last)
        assert last <= sol.exact.end <= 3.0
        assert np.abs(sol.u - whole(sol.t)).max() <= 1e-14
    assert seen == list(range(25))


BOX = SQUARE


HEXAGON = BOX + so.image([[1.0], [1.0]], so.Box(-0.5, 0.5))
COMPOSED = {
    "zonotope": so.image([[1.0, 0.5, -0.3], [0.0, 0.7, 1.0]], so.Box(-np.ones(3), np.ones(3))),
    "sum": HEXAGON,
    "image": so.image([[2.0, 0.3], [0.1, 0.4]], HEXAGON & so.Box([-1, -1.3], [1.2, 1])),
    "part": so.product(HEXAGON, so.Box(-1, 2)) & so.HalfSpace([1.0, 1.0, 1.0], 2.0),
    "few": so.image([[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]], -0.7 * HEXAGON),
    "flat": so.Polyhedron([[1, 1], [-1, -1], [1, 0], [-1, 0]], [0, 0, 1, 1]) + 0.5 * BOX,
    "apart": so.Polytope([[1.0, 0.0], [0.0, 1.0], [-1.0, -1.0]]),
}
SHRINKING = so.Table([0, 1, 1.5, 2, 3], [1.2, 0.2, 0.0, 0.0, 1])


GROWING = so.Polynomial([0.5, 0.4])
SCALED = [("sum", None), ("few", SHRINKING)]
SCALED += [(name, GROWING) for name in COMPOSED if name not in ("sum", "few")]


@pytest.mark.parametrize("name, scale", SCALED)
def test_composed_sets_and_moving_scales_are_followed(name, scale):
    shape, rng = COMPOSED[name], np.random.default_rng(3)
    n = shape.dim
    X, Y = rng.normal(size=(2, n, n))
    load = so.Separable([(so.Sine(2.0, 2.3), np.ones(n)), (so.Sine(1.0, 1.7), rng.normal(size=n))])
    C = so.Moving(shape, load, scale)
    if name == "apart":  # each with a scale of its own
        C = C + so.Moving(HEXAGON, scale=SHRINKING)
    process = so.SweepingProcess(X @ X.T + np.eye(n), Y @ Y.T, C, np.zeros(n))
    follows_the_inclusion(process, 1.1)


@pytest.mark.parametrize("seed", [6, 8, 9, 10])
def test_a_set_that_closes_for_a_moment_is_followed(seed):
    # the scale (1 - t / 2)^2 only touches 0: beside t = 2 its value is rounding of 1 - t + t^2 / 4
    X, Y = np.random.default_rng(seed).normal(size=(2, 2, 2))
    load = so.Separable([(so.Sine(2.0, 4.0), [1.0, 0.5]), (so.Sine(1.0, 3.0), [-0.3, 1.0])])
    C = so.Moving(so.Box([-1, -0.5], [0.8, 1]), load, so.Polynomial([1, -1, 0.25]))
    A, B = 1e-3 * (X @ X.T + 0.2 * np.eye(2)), Y @ Y.T + 0.5 * np.eye(2)
    follows_the_inclusion(so.SweepingProcess(A, B, C, np.zeros(2)), 3.0, steps=6)


@pytest.mark.parametrize("seed", [43, 56, 59])
def test_rows_that_are_nearly_dependent_are_followed(seed):
    # needles: multipliers near 0 are rounding of S^-1, condition 1e5
    rng, B = (
        np.random.default_rng(seed),
        np.array([[5.4, -1.9, -1.6], [-1.9, 2.2, 1.8], [-1.6, 1.8, 2.3]]),
    )
    rng.normal(size=(3, 3))
    V = rng.normal(size=(7, 3)) @ np.diag([1, 0.05, 0.002])
    V = (V @ np.linalg.qr(rng.normal(size=(3, 3)))[0]).round(3)
    load = [(so.Sine(2.5, 1.7, 0.3), [1.0, -0.5, 0.2]), (so.Sine(1, 2.3), [0.0, 1.0, 1.0])]
    C = so.Moving(so.Polytope(V), so.Separable(load))
    u0 = np.linalg.solve(B, C.at(0.0).project(np.zeros(3)))
    process = so.SweepingProcess(0 * B, B, C, u0)
    # rounding times the condition is 2e-11, and which part of it is seen depends on the processor
    follows_the_inclusion(process, 3.0, rounding=5e-11)


@pytest.mark.parametrize("seed", [2, 7, 428, 519, 947])
def test_rows_through_one_corner_take_over_from_one_another(seed):
    # more rows than unknowns hold at the start, and each of them moves at a speed of its own; the
    # seeds are some of those that fail without the program a little later, or with rows that
    # depend on active ones
    random = np.random.default_rng(seed)
    n = random.integers(2, 4)
    m = n + random.integers(1, 3)
    G = random.normal(size=(m, n)).round(1)
    if seed % 3 < 2:
        G[-1] = G[0] + G[1] if seed % 3 == 0 else random.uniform(0.2, 1, n) @ G[:n]
    sides = so.Separable(
        [
            (so.Constant(1.0), G @ np.ones(n)),
            (so.Polynomial([0.0, 1.0]), 1.0 * random.integers(-2, 3, m)),
        ]
    )
    L = random.normal(size=(n, n))
    A = np.eye(n) + (L @ L.T if seed % 2 else 0)
    pull = random.uniform(0, 1, m) * (random.random(m) < 0.7)
    process = so.SweepingProcess(A, np.eye(n), so.Polyhedron(G, sides), 1 + G.T @ pull)
    follows_the_inclusion(process, 0.3)


def test_a_body_with_friction_along_a_side_is_followed_through_all_its_switches():
    from skfem import MeshTri

    from sweepopt.fem import Elasticity, Friction, Traction, Viscosity, antiplane

    mesh = MeshTri.init_tensor(*2 * [np.linspace(0.0, 1.0, 6)]).with_defaults()
    traction = Traction("right", history=so.Sine(amplitude=2.0, period=4.0))
    effects = [Viscosity(1.0), Elasticity(2.0), traction, Friction("bottom", g=0.5)]
    body = antiplane(mesh, clamped="top", effects=effects)
    sol = so.solve(body.problem, t_end=4.0, steps=25, scheme="exact")
    assert sol.plan.path == "proportional"
    assert len(sol.exact.switches) >= 4 * len(body.contact.unknown)
    assert np.abs(sol.exact(sol.t) - sol.u).max() <= 1e-14
    errors = []
    for n in (25, 50, 100, 200):
        other = so.solve(body.problem, t_end=4.0, steps=n)
        errors.append(np.abs(other.u[:: n // 25] - sol.u).max())
    assert slope([25, 50, 100, 200], errors) >= 1.7
    assert errors[-1] <= 3.2e-5, errors


def refused(C):
    """A process that the scheme does not apply to, for data/refused.txt."""
    process = isotropic(C)
    so.solve(process, t_end=1.0, steps=10, scheme="exact")


def test_a_switch_that_rounding_hides_is_found_later_or_is_no_success():
    # A is next to nothing and B has rank one: that a row ceases to hold near 1.71 is hidden in B u
    times = [0.0, 0.51, 1.47, 1.7, 1.72, 1.78, 1.79, 2.32]
    load = so.Table(times, [0.0, 1.85, -1.34, -0.29, -1.37, -1.0, -0.77, -0.66])
    scale = so.Sine(0.26, period=3.76, phase=1.1, offset=1.18)
    C = so.Moving(
        so.Box([-0.98, -1.48], [0.39, 0.87]), so.Separable([(load, [-2.06, 1.93])]), scale
    )
    A = 1e-8 * np.array([[7.75, 1.86], [1.86, 9.49]])
    process = so.SweepingProcess(A, np.outer([5.62, -1.83], [5.62, -1.83]), C, [0.0147, -0.004774])
    try:
        exact = so.solve(process, steps=[0.0, 2.32], scheme="exact").exact
    except so.StepError:
        return
    fine = so.solve(process, steps=np.linspace(0.0, 2.32, 1001), scheme="implicit-euler", tol=1e-9)
    assert np.abs(exact(fine.t) - fine.u).max() <= 0.01 * np.abs(fine.u).max()


def stiff_chain(A, B, g, terms):
    """Masses with friction g in a row of springs under waves (amplitude, period, shape)."""
    f = so.Separable([(so.Sine(*wave), shape) for *wave, shape in terms])
    g = np.array(g)
    return so.SweepingProcess(np.diag(A), np.array(B), so.Moving(so.Box(-g, g), f), 0 * g), f, g


@pytest.mark.parametrize("steps", [1, 7, 10])
def test_stiff_bodies_start_again_where_rounding_hides_how_they_stopped(steps):
    # a body that stops is hidden by rounding for a while, Lam = 1e7 times more in each derivative
    B = [[3.66, -0.69, 0.0], [-0.69, 2.07, -1.38], [0.0, -1.38, 3.39]]
    terms = [
        (1.15, 1.45, [-1.96, 1.62, -3.0]),
        (0.53, 1.77, [-1.72, 1.38, -3.0]),
        (1.26, 2.82, [1.39, 3.0, 0.03]),
    ]
    process, f, g = stiff_chain([3e-7, 7e-7, 6e-7], B, [1.04, 0.87, 1.36], terms)
    found = exact(process, 6.56, steps)
    t = np.linspace(0.01, 6.55, 200)
    force = np.array([f(one) for one in t]) - found.velocity(t) @ process.A - found(t) @ B
    assert (np.abs(force) <= g * (1 + 1e-12)).all()  # 1.6 g where the first body did not start
    assert residual(process, found, t) <= 1e-12
    assert len(found.phases) == 39


def test_bodies_that_stop_together_take_a_phase_each():
    # within 1e-7 of the load's peak, where rounding of the forces hides their speeds
    B = [[3.7, -0.97, 0.0], [-0.97, 3.08, -0.5], [0.0, -0.5, 2.81]]
    terms = [(1.48, 2.74, [-1.22, 1.25, 3.0])]
    process, *_ = stiff_chain([3.57e-7, 4.46e-7, 2.05e-7], B, [0.34, 0.74, 0.54], terms)
    found = exact(process, 6.89, 5)
    assert len(found.phases) <= 30  # over 1,000 at the first peak alone
    assert residual(process, found, np.linspace(0.01, 6.88, 200)) <= 1e-12


def test_waves_that_rounding_of_late_times_cannot_resolve_are_no_success():
    # a period is eight rounding units of t: the run was one phase at rest under a load of 3 g
    process, times = block(so.Sine(3.0, period=1e-3)), 1e12 + np.linspace(0.0, 3e-3, 4)
    with pytest.raises(so.StepError, match="misses the inclusion"):
        so.solve(process, steps=times, scheme="exact")


def test_waves_too_fast_to_be_followed_end_in_a_step_error():
    process = block(so.Sine(3.0, period=1e-12))
    words = r"step 0 .* phases do not get beyond t = .*; use implicit"
    with pytest.raises(so.StepError, match=words):
        so.solve(process, t_end=1.0, steps=10, scheme="exact")


def test_multipliers_of_nearly_dependent_rows_are_no_stall():
    # the noise of one is |S^-1| times that of the slacks: 101 phases within 5e-6 without that
    A = np.array([[2.79885e-5, -3.57591e-5], [-3.57591e-5, 4.5693e-5]])
    B = np.array([[2.8519, -3.69376], [-3.69376, 5.94226]])
    load = so.Table([0.0, 0.0668577, 2.73565, 5.0], [0.502941, 0.502941, 0.842261, 0.842261])
    g, shape = np.array([0.17974, 0.47507]), np.array([-1.12852, 2.03615])
    scale = so.Table([0.0, 2.5, 5.0], [1.0, 0.0, 1.5])
    C = so.Moving(so.Box(-g, g), so.Separable([(load, shape)]), scale)
    process = so.SweepingProcess(A, B, C, np.zeros(2))
    with pytest.warns(so.InitialStateWarning):
        found = exact(process, 5.0)
    assert len(found.phases) < 20
    assert residual(process, found, np.linspace(1e-3, 4.999, 200)) <= 1e-9


def test_progress_of_one_long_step_moves_with_its_phases(monkeypatch):
    seen = []

    class Bar(tqdm.auto.tqdm):
        def update(self, n=1):
            seen.append(self.n + n)
            return super().update(n)

    monkeypatch.setattr(tqdm.auto, "tqdm", Bar)
    process = isotropic(so.Moving(so.Box(-1, 1), SLIDING))
    sol = so.solve(process, t_end=5.0, steps=1, scheme="exact", progress=True)
    assert seen[:-1] == pytest.approx(sol.exact.starts[1:] / 5.0)
    assert seen[-1] == 1.0


def test_exact_passes_the_time_at_which_a_box_without_viscosity_closes():
    [row] = hard_trajectories(trajectories=["closing_without_viscosity"], schemes=["exact"])
    assert row.verdict == "met"


@pytest.mark.parametrize("seed", [0, 8])
def test_a_face_that_ends_where_it_starts_but_for_rounding_is_left(seed):
    # six and more rows meet in a corner, cond A = 1e7: the multiplier that says so is rounding
    random, n = np.random.default_rng(seed), 4
    vertices = random.normal(size=(7, n))
    rows = ConvexHull(vertices - vertices.mean(axis=0)).equations
    turn = np.linalg.qr(random.normal(size=(n, n)))[0]
    A = turn * [1e-7, 1e-6, 1e-3, 1.0] @ turn.T
    loads = [(h, random.normal(size=n)) for h in (so.Triangle(2.0, 1.0), so.Sine(2.0, 1.3))]
    C = so.Moving(so.Polyhedron(rows[:, :-1], -rows[:, -1]), so.Separable(loads))
    process = so.SweepingProcess(0.5 * (A + A.T), None, C, np.zeros(n))
    sol = so.solve(process, t_end=0.7, steps=3, scheme="exact")
    assert worst_certificate(sol) <= 1e-6
    assert len(sol.exact.phases) <= 60
