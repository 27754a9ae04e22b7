"""The driver: grids, interpolant, failures, stability, callbacks, interruption."""

import warnings

import numpy as np
import pytest
from cases import SQUARE, block, isotropic, refuses
from reference_cases import case

import sweepopt as so
from sweepopt.velocity import Answer


def slider():
    return block(lambda t: 1.5 * t)


def outside():
    return block(so.Table([0.0, 100.0], [0.0, 100.0]), 1.0, 1.0, 3.0)


def test_the_interpolant_is_piecewise_linear_and_meets_its_nodes():
    sol = so.solve(slider(), t_end=5.0, steps=40)
    assert np.array_equal(sol.t, np.append(np.arange(40) * 0.125, 5.0))  # never accumulated
    assert set(sol.stats["solver"]) == {"closed form"}
    assert np.array_equal(sol(sol.t), sol.u)
    assert sol(1.0).shape == (1,)
    assert sol([0.3, 0.7, 5.0]).shape == (3, 1)
    middle = 0.5 * (sol.t[10] + sol.t[11])
    assert sol(middle) == pytest.approx(0.5 * (sol.u[10] + sol.u[11]))
    assert sol.velocity == pytest.approx(
        np.diff(sol.u, axis=0) / np.diff(sol.t)[:, None], abs=1e-12
    )
    for outside in (-0.1, 5.1):
        with refuses("outside"):
            sol(outside)
    with refuses("t is nan"):
        sol(np.nan)


def test_tiny_steps_on_a_large_state_lose_no_motion():
    # without compensation 1e7 + 7e-10 * z, a third of its last digit, would round the motion away
    process = so.SweepingProcess(1.0, None, so.Point(1.0), 1e7)
    with pytest.warns(so.InitialStateWarning):
        sol = so.solve(process, t_end=3e-7, steps=450)
    assert float(sol.u[-1, 0]) - 1e7 == pytest.approx(3e-7, abs=1e-9)  # half of the last digit


class Lying(so.Clarabel):
    """A solver that says "solved", and that its wrong answer is normal."""

    def compile(self, program):
        n = program.M.dim
        z, y = np.full(n, 7.0), np.zeros(program.cone.offsets.size)
        return lambda q, C: Answer(z, y, 1, "solved", program.M.M @ z + q, normal=True)


def hard():
    M = np.array([[2.0, -1.9], [-1.9, 2.0]])
    box = so.Polyhedron([[1, 0], [0, 1], [-1, 0], [0, -1]], [1, 0.5, 1, 0.5])
    C = so.Moving(box, lambda t: [3 * t, 2.0])
    return so.SweepingProcess(M, None, C, [0, 0])


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
def test_a_solver_that_lies_is_believed_nothing():
    sol = so.solve(hard(), t_end=1.0, steps=10, solver=Lying())
    assert sol.success
    assert sol.u == pytest.approx(so.solve(hard(), t_end=1.0, steps=10).u, abs=1e-6)


def test_a_tolerance_that_cannot_be_met_raises_or_stops_but_never_passes():
    with pytest.warns(so.InitialStateWarning), pytest.raises(so.StepError, match="tol") as failure:
        so.solve(hard(), t_end=1.0, steps=10, tol=1e-30)
    assert failure.value.step == 0
    assert failure.value.certificate > 1e-30
    assert np.array_equal(failure.value.u, [0, 0])
    with pytest.warns(so.InitialStateWarning):
        sol = so.solve(hard(), t_end=1.0, steps=10, tol=1e-30, on_failure="stop")
    assert sol.status is so.Status.INEXACT
    assert not sol.success


def test_catching_up_refuses_a_step_that_amplifies_and_warns_of_one_that_overshoots():
    process = slider()  # Lam = 4
    with pytest.raises(so.UnstableStepError, match="implicit-euler"):
        so.solve(process, t_end=6.0, steps=10, scheme="catching-up")
    with pytest.warns(so.StabilityWarning, match="amplifies"):
        so.solve(process, t_end=6.0, steps=10, scheme="catching-up", on_unstable="warn")
    with pytest.warns(so.StabilityWarning, match="overshoot"):
        so.solve(process, t_end=4.0, steps=10, scheme="catching-up")
    so.solve(process, t_end=6.0, steps=10, scheme="catching-up", on_unstable="ignore")
    so.solve(process, t_end=6.0, steps=10, scheme="implicit-euler")


@pytest.mark.parametrize("scheme", ["auto", "implicit-euler", "catching-up"])
@pytest.mark.parametrize("wave", [so.Sine(3.0, 0.1), so.Triangle(3.0, 0.1)])
def test_steps_that_see_no_wave_of_the_load_are_warned_of_once_with_the_steps_to_take(wave, scheme):
    process = block(wave, 0.5)
    how = {"t_end": 2.0, "scheme": scheme}
    said = (
        r"period of 0\.1, but steps are up to 0\.1 long: .*Take 6 .*which are steps=120 .*Adaptive"
    )
    with pytest.warns(so.StabilityWarning, match=said) as caught:
        sol = so.solve(process, steps=20, **how)
    assert scheme == "auto" or abs(sol.u).max() < 1e-9  # whose stages are within the steps
    assert len(caught) == 1
    with pytest.warns(so.StabilityWarning, match="steps are up to 0.05 long"):
        so.solve(process, steps=40, **how)
    enough = so.solve(process, steps=120, **how)  # no warning: they are errors here
    assert abs(enough.u).max() > 0.02
    so.solve(process, t_end=2.0, steps=20, error=1.0, scheme="implicit-euler")
    so.solve(block(type(wave)(0.0, 0.1), 0.5), steps=20, **how)


def test_steps_are_compared_with_the_wave_whose_slope_is_the_load():
    process = block(so.Triangle(1.0, 0.5).rate(), 0.5, u0=4.0)
    with pytest.warns(so.StabilityWarning, match="period of 0.5"):
        so.solve(process, t_end=4.0, steps=8, scheme="sdirk2")


def test_long_steps_are_no_fault_where_breakpoints_of_a_triangle_divide_them():
    times = np.append(np.linspace(0.0, 2.0, 41), 2.16)
    process = block(so.Triangle(3.0, 0.3), 0.5)
    assert so.solve(process, steps=times).plan.breakpoints.size
    with pytest.warns(so.StabilityWarning, match="steps are up to 0.16 long"):
        so.solve(process, steps=times, scheme="sdirk32")
    assert so.solve(process, steps=times, scheme="exact").success


def test_auto_is_sdirk32_for_steps_of_any_length_and_the_plan_says_why():
    def scheme(process, steps, **how):
        plan = str(so.solve(process, t_end=3.0, steps=steps, **how).plan)
        (line,) = (line for line in plan.splitlines() if "scheme  " in line)
        return line.removeprefix("scheme").strip()

    why = "sdirk32 (order 2): second order and L-stable, for any step * Lam"
    for process in (slider(), block(so.Sine(1.0, 1.0)), case("M16").process):
        assert scheme(process, 7) == scheme(process, 100) == why
    assert scheme(slider(), 5, scheme="sdirk2") == "sdirk2 (order 2)"
    assert scheme(slider(), so.Adaptive(1e-2)) == "sdirk2 (order 2)"


def test_the_truncation_of_the_papers_lemma_is_one_expression_for_moving_sets():
    """Adly and Haddad, Lemma 2.3: cut with a ball that is large enough C(t) moves u as before."""
    process = case("P10").process  # C(t) is a half-line
    truncated = isotropic(process.C & so.Ball(np.zeros(1), 50), 0.5, 1.0)
    plain, sol = (so.solve(each, t_end=16.0, steps=25) for each in (process, truncated))
    assert sol.success
    assert sol.u == pytest.approx(plain.u, abs=1e-9)


def test_the_residual_of_the_inequality_vanishes_with_the_step():
    this = case("P09")
    times = np.linspace(0.3, 9.7, 30)
    residuals = [
        np.abs(so.solve(this.process, t_end=10.0, steps=n, scheme="implicit-euler").residual(times))
        for n in (50, 800)
    ]
    assert residuals[1].mean() <= residuals[0].mean() / 8


@pytest.mark.parametrize("stiffness", [1e-12, 1e12])
@pytest.mark.parametrize(
    "S",
    [
        so.Point([0.0, 0.0]),
        so.Polyhedron([[1.0, 2.0], [1.0, -1.0], [-1.0, -0.5]], [1.0, 1.0, 1.0]),
        so.Ball([0, 0], 1.0) + SQUARE,
    ],
    ids=lambda S: type(S).__name__,
)
def test_a_state_that_blows_up_is_no_success(S, stiffness):
    load = so.Separable([(so.Sine(1.0, 2.3), stiffness * np.array([30.0, 60.0]))])
    A, B = stiffness * np.eye(2), stiffness * np.diag([100.0, 200.0])
    process = so.SweepingProcess(A, B, so.Moving(stiffness * S, load), [0.0, 0.0])
    how = {"t_end": 1e4, "steps": 1000, "scheme": "catching-up", "on_unstable": "ignore"}
    sol = so.solve(process, on_failure="stop", **how)
    assert sol.status is so.Status.INEXACT
    assert "grows beyond all numbers" in sol.message
    assert np.isfinite(sol.u).all()
    with pytest.raises(so.StepError, match="smaller steps") as failure:
        so.solve(process, **how)
    assert np.array_equal(failure.value.u, sol.u[-1])


@pytest.mark.parametrize("size", [1e-70, 1e70, 1e73])
def test_numbers_that_input_may_have_do_not_count_as_a_blow_up(size):
    C = so.Moving(so.Box([-size, -size], [size, size]))
    process = so.SweepingProcess(np.eye(2), np.eye(2), C, [0.1 * size, 0.0])
    assert so.solve(process, t_end=1.0, steps=5).success
    stiff = so.SweepingProcess(np.eye(2), size * np.eye(2), C, [0.5, 0.0])
    assert so.solve(stiff, t_end=1.0, steps=5).success


@pytest.mark.parametrize(
    "how",
    [
        {},
        {"error": 1.0},
        {"error": 1.0, "save": "last"},
        {"steps": so.Adaptive(1e-2)},
        {"t_end": 15.0, "scheme": "catching-up"},
    ],
    ids=str,
)
def test_warnings_name_the_line_of_the_user(how):
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        so.solve(outside(), **{"t_end": 1.0, "steps": 10, **how})
    assert seen
    assert {w.filename for w in seen} == {__file__}


def test_steps_that_grow_by_little_each_keep_their_own_size_at_large_times():
    # B = 0 and M = 1: u gains the size of each step
    process = isotropic(so.Point(1.0), 1.0, 0.0)
    times = 1.7e9 + np.append(0.0, np.cumsum(1.0 + 3e-4 * np.linspace(0, 1, 300)))
    with pytest.warns(so.InitialStateWarning):
        sol = so.solve(process, steps=times)
    gained = np.diff(sol.u[:, 0]) / sol.velocity[:, 0]
    assert np.abs(gained - np.diff(times)).max() <= 4e-6  # rounding of the times is 2.4e-7


def random_body(random, n, u0):
    """No load and a small box around 0."""
    roots = random.normal(size=(2, n, n))
    A, B = (root @ root.T + 0.1 * np.eye(n) for root in roots)
    return so.SweepingProcess(A, B, so.Box(-0.2 * np.ones(n), 0.2 * np.ones(n)), u0)


def overshoots(process, **how):
    """A run, and what it says of stability."""
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        sol = so.solve(process, **how)
    return sol, [str(w.message) for w in seen if w.category is so.StabilityWarning]


def far_outside():
    """It should rise from -1 to -0.1 and stick there."""
    return so.SweepingProcess(1.0, 1.0, so.Box(-0.1, 2.0), u0=-1.0)


@pytest.mark.parametrize(
    "scheme, mu, reached",
    [
        ("midpoint", 2.1, -0.078),
        ("midpoint", 1e6, 0.8),
        ("trapezoid", 3.9, 0.755),
        ("sdirk2", 19.9, 0.855),
    ],
)
def test_a_step_that_overshoots_is_warned_of(scheme, mu, reached):
    how = {"t_end": mu, "steps": 1}
    sol, said = overshoots(far_outside(), scheme=scheme, **how)
    assert sol.u[-1, 0] == pytest.approx(reached, abs=0.01)
    assert len(said) == 1
    assert f"{scheme!r} can overshoot into a wrong stuck state: step * Lam = {mu:.3g}" in said[0]
    assert "take scheme='auto' or implicit-euler" in said[0]
    assert not overshoots(far_outside(), scheme=scheme, on_unstable="ignore", **how)[1]
    for right in ("implicit-euler", "sdirk32", "auto"):
        sol, said = overshoots(far_outside(), scheme=right, **how)
        assert -1 <= sol.u[-1, 0] <= -0.0999
        assert not said


@pytest.mark.parametrize("path", ["full", "eliminated", "proportional"])
def test_every_path_tells_of_an_overshoot(path):
    A = np.array([[3.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 2.0]])
    C = so.image(np.eye(3)[:, :1], so.Box(-0.1, 2.0))
    process = so.SweepingProcess(A, A, C, u0=[-1.0, 0.0, 0.0])
    for scheme in ("midpoint", "auto"):
        said = overshoots(process, t_end=40.0, steps=2, path=path, scheme=scheme)[1]
        assert bool(said) == (scheme == "midpoint")
        assert not overshoots(process, t_end=4.0, steps=4, path=path, scheme=scheme)[1]


@pytest.mark.parametrize("scheme", ["midpoint", "trapezoid"])
def test_a_scheme_by_name_that_rings_warns_once_where_something_sticks_and_moves(
    scheme,
):
    load = so.Sine(2.0, 2.0)

    def said(C, viscosity=1e-3, **how):
        process = so.SweepingProcess(viscosity, 1.0, C, 0.0)
        return overshoots(process, **{"t_end": 6.0, "steps": 60, "scheme": scheme, **how})[1]

    moving = so.Moving(so.Box(-1, 1), load)
    (words,) = said(moving)
    assert f"scheme {scheme!r} rings: step * Lam = 100" in words
    assert "take scheme='auto' or implicit-euler" in words
    assert len(said(moving, 0.029)) == 1  # step * Lam = 3.4: R = -0.27, below -RINGING
    assert not said(moving, 0.035)  # 2.9, -0.18
    assert not said(moving, on_unstable="ignore")
    assert not said(so.Box(-1, 1))
    assert not said(so.Moving(so.Point(0.0), load))  # a linear problem
    assert not said(moving, steps=so.Adaptive(1e-2), t_end=0.2)  # its errors are estimated
    if scheme == "midpoint":
        assert "rings: A is singular" in said(moving, 0.0)[0]


def test_bodies_that_start_far_outside_of_their_set_and_overshoot_are_told_of():
    random, seen = np.random.default_rng(0), 0
    for _ in range(25):
        n = int(random.integers(1, 6))
        u0 = 3 * random.normal(size=n)
        process = random_body(random, n, u0)
        mu = 3 * 10 ** random.uniform(-1, 2) / process.Lam
        sol, said = overshoots(process, t_end=5 * mu, steps=5, scheme="midpoint")
        auto, nothing = overshoots(process, t_end=5 * mu, steps=5)
        assert not nothing
        right = overshoots(process, t_end=5 * mu, steps=80, scheme="implicit-euler")[0].u[-1]
        B, whole = process.B, right - u0
        offs = (sol.u[-1] - right, auto.u[-1] - right)
        error, of_auto = (np.sqrt((off @ B @ off) / (whole @ B @ whole)) for off in offs)
        seen += error > 0.2
        assert said or error <= 0.2, (mu * process.Lam, error)
        assert of_auto <= 0.1, (mu * process.Lam, of_auto)
        assert mu * process.Lam > 2 or not said
    assert seen > 5


@pytest.mark.parametrize("scheme", ["implicit-euler", "midpoint"])
@pytest.mark.parametrize("mu", [1e-10, 1e-4, 1.0, 30.0, 1e6])
def test_without_a_load_the_energy_never_grows(scheme, mu):
    process = random_body(np.random.default_rng(3), 3, [1.0, -2.0, 3.0])
    sol, said = overshoots(process, t_end=40 * mu, steps=40, scheme=scheme)
    assert bool(said) == (scheme == "midpoint" and mu * process.Lam > 2)
    energy = np.array([0.5 * u @ process.B @ u for u in sol.u])
    assert energy[0] > energy[-1]
    assert (np.diff(energy) <= 1e-14 * energy[0]).all()
