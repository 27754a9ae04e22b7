"""The bound of a whole trajectory: never below the true error, and close to it."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from cases import case

import sweepopt as so
from sweepopt.control import divided
from sweepopt.loads import Polynomial
from sweepopt.motion import GAUSS, motion
from sweepopt.norms import Norms
from sweepopt.schemes import SCHEMES
from sweepopt.study.problems import PROBLEMS, Spiral

RUNS = [
    (name, scheme)
    for name, problem in PROBLEMS.items()
    for scheme in SCHEMES
    if SCHEMES[scheme].implicit or np.any(problem.A)
]
COERCIVE = [name for name, problem in PROBLEMS.items() if np.any(problem.A)]


def run(name: str, steps: int, scheme: str, **options: Any) -> so.Solution:
    problem = PROBLEMS[name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", so.InitialStateWarning)
        return so.solve(
            problem.process(),
            t_end=problem.t_end,
            steps=steps,
            scheme=scheme,
            on_unstable="ignore",
            **options,
        )


def furthest(name: str, sol: so.Solution, n: int = 2003) -> float:
    """The largest |u - u_n| seen, at the nodes and on another grid."""
    this = case(name)
    times = np.linspace(0.0, this.t_end, n + 1)
    between = max(map(this.process.metric.norm, sol(times) - this.exact(n)))
    return max(between, this.error(sol))


@pytest.mark.parametrize(("name", "scheme"), RUNS)
def test_the_bound_is_never_below_the_error_and_the_lower_one_never_above(
    name: str, scheme: str
) -> None:
    for steps in (101, 211):
        sol = run(name, steps, scheme)
        bound, error = sol.error_bound(), furthest(name, sol)
        assert bound.guaranteed
        assert bound >= error
        # the other grid does not hit the worst time exactly
        assert bound.lower <= 1.1 * error
        assert bound == bound.of_t.max()
        assert len(bound.of_t) == len(bound.B) == steps


@pytest.mark.slow
@pytest.mark.parametrize(("name", "scheme"), RUNS)
@pytest.mark.parametrize("tol", [1e-9, 1e-6, 1e-3])
def test_the_bound_holds_on_all_grids_and_with_sloppy_solvers(
    name: str, scheme: str, tol: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sweepopt.polish.POLISHED", np.inf)
    for steps in (101, 211, 503, 1009, 2003):
        sol = run(name, steps, scheme, solver=so.Clarabel(tol=tol), tol=max(tol, 1e-6))
        bound = sol.error_bound()
        assert bound.guaranteed
        assert bound >= furthest(name, sol)


@pytest.mark.parametrize("name", ["P09", "B15"])
@pytest.mark.parametrize("scheme", ["implicit-euler", "midpoint"])
def test_what_a_sloppy_solver_misses_is_inside_the_bound(
    name: str, scheme: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    sharp = run(name, 101, scheme).error_bound()
    monkeypatch.setattr("sweepopt.polish.POLISHED", np.inf)
    sol = run(name, 101, scheme, solver=so.Clarabel(tol=1e-3), tol=1e-2)
    bound = sol.error_bound()
    assert sol.stats["relative"].max() > 1e-6
    assert furthest(name, sol) <= bound
    assert bound != sharp


def test_the_bound_of_first_order_schemes_is_close_to_their_error() -> None:
    for steps, median, worst in ((101, 2.0, 10.0), (1009, 1.3, 3.0)):
        effectivity = []
        for name in COERCIVE:
            for scheme in ("catching-up", "implicit-euler"):
                sol = run(name, steps, scheme)
                effectivity.append(sol.error_bound() / case(name).error(sol))
        assert np.median(effectivity) <= median
        assert max(effectivity) <= worst


@pytest.mark.parametrize("name", ["S03", "P09", "V05", "L13", "S04"])
@pytest.mark.parametrize("scheme", ["midpoint", "trapezoid", "sdirk2"])
def test_the_bound_falls_with_the_order_of_the_scheme(name: str, scheme: str) -> None:
    grids = (101, 211, 503, 1009)
    bounds = [float(run(name, steps, scheme).error_bound()) for steps in grids]
    assert -np.polyfit(np.log(grids), np.log(bounds), 1)[0] >= 1.45


def test_a_body_that_never_moves_has_next_to_no_bound() -> None:
    load = so.Separable([(so.Sine(0.9, 2.0), [1.0])])
    process = so.SweepingProcess([[1.0]], [[2.0]], so.Moving(so.Box([-1], [1]), load), [0.0])
    bound = so.solve(process, t_end=4.0, steps=100).error_bound()
    assert bound <= 1e-7
    assert bound.guaranteed


def test_a_load_that_is_a_function_gives_a_sampled_value_that_says_so() -> None:
    problem = PROBLEMS["S03"]
    sol = so.solve(case("S03").process, t_end=problem.t_end, steps=211, scheme="implicit-euler")
    bound = sol.error_bound()
    assert not bound.guaranteed
    assert bound == pytest.approx(run("S03", 211, "implicit-euler").error_bound(), rel=0.05)


@pytest.mark.parametrize("scheme", ["catching-up", "implicit-euler", "midpoint"])
def test_the_variation_of_a_function_makes_the_bound_a_guarantee(scheme: str) -> None:
    problem = PROBLEMS["S03"]
    wave = so.Sine(3.0, np.pi)
    sol = so.solve(
        case("S03").process, t_end=problem.t_end, steps=211, scheme=scheme, on_unstable="ignore"
    )
    bound = sol.error_bound(variation=lambda t: wave.variation(0.0, t))
    assert bound.guaranteed
    assert case("S03").error(sol) <= bound <= 0.5
    with pytest.raises(so.InputError, match="variation must not fall"):
        sol.error_bound(variation=lambda t: -t)


def test_a_set_that_is_a_function_needs_its_variation_too() -> None:
    def C(t: float) -> so.Box:
        return so.Box([2 * np.sin(t) - 1 - 0.2 * t], [2 * np.sin(t) + 1 + 0.1 * t])

    process = so.SweepingProcess([[1.0]], [[1.0]], so.MovingSet(C), [0.0])
    reference = so.solve(process, t_end=4.0, steps=20_000)
    for steps in (100, 400):
        sol = so.solve(process, t_end=4.0, steps=steps)
        error = np.abs(sol.u - reference(sol.t)).max()
        sampled = sol.error_bound()
        assert not sampled.guaranteed
        assert error <= sampled <= 0.1
        known = sol.error_bound(variation=lambda t: 2.2 * t)
        assert known.guaranteed
        assert error <= known


def test_a_scale_that_moves_is_data_too() -> None:
    C = so.Moving(
        so.Box([-1], [1]), so.Separable([(so.Sine(2.0, 5.0), [1.0])]), so.Sine(0.3, 3.0, 0.0, 0.6)
    )
    process = so.SweepingProcess([[1.0]], [[1.5]], C, [0.0])
    reference = so.solve(process, t_end=6.0, steps=40_000)
    for scheme in ("implicit-euler", "midpoint"):
        sol = so.solve(process, t_end=6.0, steps=300, scheme=scheme)
        error = process.metric.norm(np.ravel(np.abs(sol.u - reference(sol.t)).max()))
        bound = sol.error_bound()
        assert bound.guaranteed
        assert error <= bound <= 60 * error


def test_a_run_that_kept_the_last_state_only_has_the_same_bound() -> None:
    whole, last = (run("P09", 101, "midpoint", save=save) for save in (None, "last"))
    assert last.error_bound() == pytest.approx(float(whole.error_bound()), rel=1e-9)


def test_units_do_not_change_the_bound() -> None:
    def bound(force: float, length: float) -> float:
        load = so.Separable([(so.Sine(3.0 * force, 3.0), [1.0])])
        C = so.Moving(so.Box([-force], [force]), load)
        ratio = force / length
        process = so.SweepingProcess([[0.5 * ratio]], [[2 * ratio]], C, [0.0])
        found = so.solve(process, t_end=5.0, steps=100, scheme="catching-up").error_bound()
        return float(found) / np.sqrt(force * length)

    assert bound(2.0**40, 2.0**-20) == pytest.approx(bound(1.0, 1.0), rel=1e-9)


def test_steps_are_refined_until_the_bound_holds() -> None:
    problem = PROBLEMS["S03"]
    times, exact = np.linspace(0.0, problem.t_end, 2004), case("S03").exact(2003)
    for scheme, error in (("midpoint", 1e-3), ("catching-up", 2e-2)):
        sol = so.solve(
            problem.process(), t_end=problem.t_end, steps=50, scheme=scheme, error=error,
            on_unstable="ignore",
        )  # fmt: skip
        assert sol.error_bound() <= error
        assert np.abs(sol(times) - exact).max() * np.sqrt(0.5) <= error
        assert (len(sol.t) - 1) % 50 == 0


def test_an_error_that_cannot_be_guaranteed_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(so.InputError, match=r"error= needs a guaranteed bound"):
        so.solve(case("S03").process, t_end=1.0, steps=20, error=1e-2)
    with pytest.raises(so.InputError, match="error must be > 0, got 0"):
        so.solve(case("S03").process, t_end=1.0, steps=20, error=0)
    monkeypatch.setattr("sweepopt.refinement.STEPS", 2000)
    with pytest.raises(so.AccuracyError, match="finer grids do not help or take more") as caught:
        so.solve(PROBLEMS["S01"].process(), t_end=1.0, steps=20, error=1e-15)
    assert caught.value.solution.success


@pytest.mark.parametrize(
    "history",
    [
        so.Sine(2.0, 0.7, 0.3, 1.0),
        so.Triangle(1.5, 0.8),
        Polynomial([1.0, -2.0, 0.5, 3.0, -1.0, 0.7, 0.2]),
        so.Table([0, 0.3, 0.9, 2.0], [1, -1, 2, 0]),
        Spiral(0.8, 2.0, 0.3),
    ],
)
def test_a_history_is_no_further_from_its_polynomials_than_they_say(history: Any) -> None:
    C = so.Moving(so.Box([-1], [1]), so.Separable([(history, [1.0])]))
    moved = motion(C)
    assert moved is not None
    grid = moved.grid(np.linspace(0.0, 2.0, 8))
    center, _ = moved.on(grid)
    inside = np.linspace(0.0, 1.0, 41)
    power = np.vander(GAUSS, 6)
    for k, (a, b) in enumerate(zip(grid.begin, grid.end, strict=True)):
        weights = np.linalg.solve(power, center.values[k, :, 0])
        through = np.vander(inside, 6) @ weights
        apart = np.abs(history(a + (b - a) * inside) - through).max()
        assert apart <= center.away[k, 0] + 1e-11


def test_errors_grow_no_faster_than_k() -> None:
    random = np.random.default_rng(3)
    for _ in range(20):
        root = random.normal(size=(4, 4))
        A = root @ root.T + 0.1 * np.eye(4)
        other = random.normal(size=(4, 4))
        B = other @ other.T
        C = so.Box(-random.uniform(0, 1, 4), random.uniform(0, 1, 4))
        one, two = (so.SweepingProcess(A, B, C, random.normal(size=4)) for _ in range(2))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", so.InitialStateWarning)
            runs = [so.solve(p, t_end=3.0, steps=300, scheme="implicit-euler") for p in (one, two)]
        apart = Norms(one).A(runs[0].u - runs[1].u)
        assert (apart <= Norms(one).growth(runs[0].t) * apart[0] * (1 + 1e-3)).all()


def test_a_grid_is_divided_evenly() -> None:
    assert np.array_equal(divided(np.array([0.0, 1.0, 3.0]), 2), [0, 0.5, 1, 2, 3])
