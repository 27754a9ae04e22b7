"""Adaptive steps: the error asked for, at about the work of the best fixed step or far less."""

from __future__ import annotations

import math
import warnings
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cases import SETS, case

import sweepopt as so
from sweepopt.integrate.error_estimator import Watch
from sweepopt.integrate.error_model import Carried, Missed
from sweepopt.integrate.error_propagation import Flow
from sweepopt.integrate.local_refinement import mended
from sweepopt.integrate.mesh_density import density, finer_grid, first_grid
from sweepopt.integrate.switching_times import find_kinks, find_stops
from sweepopt.study.problems import BURST, problem

TOLERANCES = [1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7]
FACTOR = 3.0  # by which an error may miss its tolerance


def run(name: str, steps: Any, **changes: Any) -> so.Solution:
    this = problem(name)
    with warnings.catch_warnings():
        # V05, L13 start outside of C(0) on purpose
        warnings.simplefilter("ignore", so.InitialStateWarning)
        return so.solve(this.process(), t_end=this.t_end, steps=steps, **changes)


@cache
def exact(name: str, t: float) -> np.ndarray:
    """u(t) of a reference case: from the exact value before it in 64 small steps."""
    process, u = case(name).process, case(name).exact(2003)
    times = np.append(np.arange(2003) * (case(name).t_end / 2003), case(name).t_end)
    k = min(int(np.searchsorted(times, t, side="right")) - 1, 2002)
    for node in (k, k + 1):
        if abs(t - times[node]) <= 1e-12 * times[-1]:
            return u[node]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", so.InitialStateWarning)
        small = so.SweepingProcess(process.A, process.B, problem(name).process().C, u[k])
        scheme = "sdirk2" if process.rate_independent else "midpoint"
        steps = np.linspace(times[k], t, 65)
        return so.solve(small, steps=steps, scheme=scheme, tol=1e-9, save="last").u[-1]


def error(name: str, sol: so.Solution, nodes: int = 40) -> float:
    """max |u_i - u(t_i)| over some nodes, the last one with them."""
    some = np.unique(np.linspace(1, len(sol.t) - 1, nodes).astype(int))
    norm = case(name).process.metric.norm
    return max(norm(sol.u[i] - exact(name, float(sol.t[i]))) for i in some)


def work(sol: so.Solution) -> int:
    """Velocity programs of all passes."""
    return len(sol.plan.scheme.b) * sum(one.steps for one in sol.passes)


def best_fixed(name: str, scheme: str, tol: float) -> int:
    """Velocity programs of the fewest equal steps that meet tol and go on to do so.

    A grid that happens to hit the turns of the load, by luck, is not what a user can count on:
    twice and 1.3 times as many steps must meet tol too.
    """

    def meets(n: int) -> bool:
        return all(
            error(name, run(name, round(share * n), scheme=scheme), 25) <= tol
            for share in (1.0, 1.3, 2.0)
        )

    low, high = 2, 4
    while not meets(high):
        low, high = high, 2 * high
    while high - low > max(1, high // 25):
        middle = (low + high) // 2
        low, high = (low, middle) if meets(middle) else (middle, high)
    return high * len(so.schemes.SCHEMES[scheme].b)


@pytest.mark.parametrize("tol", [1e-2, 1e-4])
@pytest.mark.parametrize("name", SETS)
def test_the_tolerance_is_met(name: str, tol: float) -> None:
    sol = run(name, so.Adaptive(tol))
    assert sol.success
    assert error(name, sol) <= FACTOR * tol
    assert len(sol.stats) == len(sol.t) - 1 <= sol.passes[-1].steps
    assert sol.passes[-1].error <= FACTOR * tol


def random_process(seed: int) -> tuple[so.SweepingProcess, float]:
    """A body in a box that is moved by tables and sines, and how long."""
    random = np.random.default_rng(seed)
    dim, t_end = int(random.integers(1, 5)), float(random.choice([2.0, 5.0, 10.0]))

    def table(points: int) -> so.Table:
        inside = np.sort(random.uniform(0.0, t_end, points))
        values = 0.7 * np.cumsum(random.normal(size=points + 2))
        return so.Table([0.0, *inside, t_end], values - values[0])

    def sine() -> so.Sine:
        return so.Sine(1.0, float(random.uniform(2.0, 12.0)))

    loads = [[sine(), sine()], [table(8), table(8)], [table(6), sine()]][random.integers(3)]
    roots = random.normal(size=(2, dim, dim)) / math.sqrt(dim)
    A = float(random.choice([0.05, 1.0])) * (roots[0] @ roots[0].T + 0.3 * np.eye(dim))
    B = roots[1] @ roots[1].T + 0.1 * np.eye(dim)
    g = random.uniform(0.1, 0.6, dim)
    load = so.Separable([(history, random.normal(size=dim)) for history in loads])
    C = so.Moving(so.Box(-g, g), load)
    return so.SweepingProcess(A, B, C, np.zeros(dim)), t_end


def random_errors(seed: int, viscous: bool = True) -> list[float]:
    """max_i |u_i - u(t_i)| / tol for three tolerances of a random process."""
    process, t_end = random_process(seed)
    if not viscous:
        A = np.zeros_like(process.A)
        process = so.SweepingProcess(A, process.B, process.C, process.u0)
    exact = so.solve(process, t_end=t_end, steps=1, scheme="exact").exact
    assert exact is not None
    norm = process.metric.norm
    size = max(map(norm, exact(np.linspace(0.0, t_end, 400))))
    found = []
    for tol in (1e-2 * size, 1e-3 * size, 1e-4 * size):
        sol = so.solve(process, t_end=t_end, steps=so.Adaptive(tol))
        found.append(max(map(norm, sol.u - exact(sol.t))) / tol)
    return found


@pytest.mark.parametrize("viscous", [True, False])
@pytest.mark.parametrize("seeds", [range(8), pytest.param(range(8, 60), marks=pytest.mark.slow)])
def test_few_processes_that_the_method_was_not_made_for_miss_the_tolerance(
    seeds: range, viscous: bool
) -> None:
    """An estimate is no bound: an event between two nodes can stay unseen."""
    errors = np.ravel([random_errors(seed, viscous) for seed in seeds])
    assert np.mean(errors <= FACTOR) >= 0.95
    assert errors.max() <= 2 * FACTOR


@pytest.mark.slow
@pytest.mark.parametrize("name", SETS)
def test_every_tolerance_is_met_at_about_the_work_of_the_best_fixed_step(name: str) -> None:
    rows = []
    for tol in TOLERANCES:
        sol = run(name, so.Adaptive(tol))
        ratio = math.nan
        if tol >= 1e-5 and name != "E20":  # equal steps need 40,000 for 1e-4 there
            ratio = work(sol) / best_fixed(name, sol.plan.scheme.name, tol)
        rows.append((tol, error(name, sol, 150) / tol, ratio))
        print(name, *(f"{value:.3g}" for value in rows[-1]))
    table = np.array(rows)
    assert (table[:, 1] <= FACTOR).all()
    ratios = table[:, 2]
    assert (ratios[np.isfinite(ratios)] <= 1.5).all()


@pytest.mark.parametrize("scheme", ["catching-up", "implicit-euler", "trapezoid", "sdirk2"])
@pytest.mark.parametrize("name", ["S03", "P09", "V05"])
def test_every_scheme_meets_the_tolerance(name: str, scheme: str) -> None:
    tol = 1e-2 if so.schemes.SCHEMES[scheme].order == 1 else 1e-4
    sol = run(name, so.Adaptive(tol), scheme=scheme, on_unstable="ignore")
    assert sol.plan.scheme.name == scheme
    assert error(name, sol) <= FACTOR * tol


def burst(times: np.ndarray) -> np.ndarray:
    """u of H18, phase by phase: y = f -+ g - b u has y' = s - b y / a while the block slips."""
    a, b, g = 0.02, 2.0, 1.0
    points = np.union1d(BURST[0], times)
    loads = np.interp(points, *BURST)
    found, u = {0.0: 0.0}, 0.0
    for start, end, f, after in zip(points, points[1:], loads, loads[1:], strict=False):
        t, slope = start, (after - f) / (end - start)
        while t < end:
            force = f + slope * (t - start) - b * u
            side = math.copysign(1.0, force if abs(force) >= g * (1 - 1e-12) else slope)
            y = force - side * g
            if side * y < -1e-12 or (abs(y) <= 1e-12 and side * slope <= 0):  # it sticks
                wait = -y / slope if side * slope > 0 else math.inf
                t = min(t + wait, end)
                continue
            steady = slope * a / b
            left = end - t
            if side * steady < 0:
                left = min(left, a / b * math.log((steady - y) / steady))
            decay = math.exp(-b / a * left)
            # u' = y / a
            u += (steady * left + (y - steady) * a / b * (1 - decay)) / a
            t += left
        found[end] = u
    return np.array([found[t] for t in times])


def test_a_short_burst_in_a_long_hold_takes_far_fewer_steps_than_equal_ones() -> None:
    this = problem("H18")
    norm = this.process().metric.norm

    def missed(sol: so.Solution) -> float:
        return max(map(norm, sol.u - burst(sol.t)[:, None]))

    for tol in (1e-2, 1e-3, 1e-4):
        sol = run("H18", so.Adaptive(tol))
        assert missed(sol) <= FACTOR * tol
    fixed = run("H18", 10 * work(sol))
    assert missed(fixed) > missed(sol)
    assert set(BURST[0]) <= set(sol.t.tolist())


def test_breakpoints_and_requested_times_are_hit_exactly() -> None:
    wanted = [0.1, 2 / 3, math.pi, 8.9]
    for name, breakpoints in (("B15", {3.0, 6.0}), ("E20", {2.0, 6.0})):
        sol = run(name, so.Adaptive(1e-3), save=wanted)
        assert sol.t.tolist() == [0.0, *wanted, problem(name).t_end]
        assert breakpoints <= set(sol.stats["t"].tolist())


def test_steps_are_halves_of_halves_so_that_programs_are_shared() -> None:
    sol = run("P10", so.Adaptive(1e-4))
    sizes = np.diff(sol.t)
    halvings = np.log2(sizes.max() / sizes)
    assert np.abs(halvings - np.round(halvings)).max() <= 1e-9
    assert 2 <= np.unique(np.round(halvings)).size <= 16


def test_steps_are_equal_where_that_takes_fewer() -> None:
    sizes = np.diff(run("S03", so.Adaptive(1e-4)).t)
    assert sizes.max() <= (1 + 1e-9) * sizes.min()


def test_a_run_is_the_same_bit_for_bit() -> None:
    one, two = (run("P09", so.Adaptive(1e-3)) for _ in range(2))
    assert np.array_equal(one.t, two.t)
    assert np.array_equal(one.u, two.u)


def test_a_callback_a_function_and_a_file_see_each_step_of_the_last_pass_once(
    tmp_path: Path,
) -> None:
    plain, seen = run("S03", so.Adaptive(1e-3)), []
    sol = run("S03", so.Adaptive(1e-3), callback=lambda info: seen.append(info.t))
    assert seen == plain.t[1:].tolist()
    assert np.array_equal(sol.u, plain.u)
    sol = run("S03", so.Adaptive(1e-3), save=lambda t, u, z: t)
    assert sol.recorded == seen
    sol = run("S03", so.Adaptive(1e-3), save=tmp_path / "run.nc")
    assert np.array_equal(sol.u, plain.u)
    sol = run("S03", so.Adaptive(1e-3), save=10, progress=True)
    assert np.array_equal(sol.t[1:-1], plain.t[10::10][: len(sol.t) - 2])
    sol = run("S03", so.Adaptive(1e-3), callback=lambda info: info.t > 2)
    assert sol.status is so.Status.STOPPED


def test_ctrl_c_returns_the_steps_of_the_pass_under_way(monkeypatch: pytest.MonkeyPatch) -> None:
    from sweepopt.integrate import adaptive_driver as passes

    class Impatient(passes.Watch):
        def see(self, i: int, u: np.ndarray, z: np.ndarray) -> None:
            super().see(i, u, z)
            if i == 40:
                raise KeyboardInterrupt

    monkeypatch.setattr("sweepopt.integrate.adaptive.Watch", Impatient)
    sol = run("S03", so.Adaptive(1e-3))
    assert sol.status is so.Status.INTERRUPTED
    assert len(sol.t) == 42


def jumping() -> so.SweepingProcess:
    C = so.Moving(so.Box([-1], [1]), center=lambda t: [0.5 * t + 4.0 * (t > 1.2345)])
    return so.SweepingProcess([[0.5]], [[2.0]], C, [0.0])


def test_a_jump_of_the_load_that_needs_too_short_steps_is_told_with_its_time() -> None:
    steps = so.Adaptive(1e-7, minimum=1e-3)
    with pytest.raises(so.StepError, match=r"0\.001 is needed; does the load jump") as failure:
        so.solve(jumping(), t_end=4.0, steps=steps)
    assert failure.value.t == pytest.approx(1.2345, abs=0.1)
    assert failure.value.u.shape == (1,)
    sol = so.solve(jumping(), t_end=4.0, steps=steps, on_failure="stop")
    assert sol.status is so.Status.INEXACT
    assert "minimum" in sol.message
    assert sol.t[-1] == pytest.approx(1.2345, abs=0.1)
    # without a minimum that forbids it the jump is resolved
    assert so.solve(jumping(), t_end=4.0, steps=so.Adaptive(1e-4)).success


@pytest.mark.parametrize(
    ("steps", "changes", "words"),
    [
        (lambda: so.Adaptive(0.0), {}, "tol must be > 0"),
        (lambda: so.Adaptive(1e-3, first=-1.0), {}, "first must be > 0"),
        (lambda: so.Adaptive(1e-3, first=0.1, minimum=0.2), {}, "longer than first"),
        (lambda: so.Adaptive(1e-3), {"t_end": None}, "t_end is missing"),
        (lambda: so.Adaptive(1e-3), {"path": "proportional"}, "needs all steps beforehand"),
        (lambda: so.Adaptive(1e-3), {"save": [9.0]}, "not on the time grid"),
        (lambda: so.Adaptive(1e-7), {"memory": 9000.0}, "more than memory"),
    ],
)
def test_what_cannot_be_is_refused(steps: Any, changes: dict[str, Any], words: str) -> None:
    process = problem("S03").process()
    with pytest.raises(so.InputError, match=words):
        so.solve(process, steps=steps(), **{"t_end": 8.0, **changes})


def test_a_body_whose_contact_alone_could_move_says_why_it_does_not() -> None:
    load = so.Separable([(so.Sine(3.0, 3.0), np.ones(6))])
    D = so.image(np.eye(6)[:, 4:], so.Box([-0.5, -0.5], [0.5, 0.5]))
    A = 2 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1)
    vi = so.EvolutionVI(A, 2 * A, load=load, dissipation=D, u0=np.zeros(6))
    assert so.solve(vi, t_end=2.0, steps=5).plan.path == "proportional"
    sol = so.solve(vi, t_end=2.0, steps=so.Adaptive(1e-3))
    assert sol.plan.path == "eliminated"
    assert "need all steps beforehand" in str(sol.plan)


def test_a_kink_is_found_between_two_steps_and_only_there_the_grid_is_finer() -> None:
    cuts = np.array([0.0, 1.0])
    times = first_grid(cuts, 1 / 16)
    z = np.maximum(0.5 * (times[1:] + times[:-1]) - 0.4, 0.0)
    slopes = np.diff(z) * 16
    found = density(times, cuts, np.abs(np.diff(slopes)) * 8, order=2)
    assert abs(found.edges[np.argmax(found.rho)] - 0.4) <= 1 / 16
    grid = finer_grid(found, cuts, 1 / 16, 40)
    assert len(grid) == 41
    assert abs(grid[np.argmin(np.diff(grid))] - 0.4) <= 1 / 16


def test_a_body_that_never_moves_is_done_after_two_coarse_passes() -> None:
    process = so.SweepingProcess([[1.0]], [[1.0]], so.Box([-1], [1]), u0=[0.0])
    sol = so.solve(process, t_end=1.0, steps=so.Adaptive(1e-6))
    assert not sol.u.any()
    assert [one.steps for one in sol.passes] == [16, 32]


def test_a_tolerance_that_takes_too_many_steps_ends_with_what_there_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("sweepopt.integrate.adaptive.STEPS", 500)
    process = problem("S03").process()
    sol = so.solve(
        process, t_end=8.0, steps=so.Adaptive(1e-6), scheme="implicit-euler", on_failure="stop"
    )
    assert sol.status is so.Status.INEXACT
    assert "more than 500; the run has" in sol.cause
    assert sol.t[-1] == 8.0
    with pytest.raises(so.StepError, match="Loosen the tolerance"):
        so.solve(process, t_end=8.0, steps=so.Adaptive(1e-6), scheme="implicit-euler")


def test_steps_that_overshoot_however_short_end_after_few_passes() -> None:
    process = so.SweepingProcess([[1.0]], [[1e20]], so.Box([-1.0], [1.0]), [1.0])
    with (
        pytest.warns(so.SweepoptWarning),
        pytest.raises(
            so.StepError, match=r"with [1-9][0-9]{3} steps, rises .* take implicit-euler"
        ),
    ):
        so.solve(process, t_end=1.0, steps=so.Adaptive(0.01))


def hat(times: np.ndarray, kink: float) -> np.ndarray:
    """Velocities in the middle of the steps: one unknown starts to slip, the other goes on."""
    middle = 0.5 * (times[1:] + times[:-1])
    late = np.maximum(middle - kink, 0.0)
    return np.column_stack([2 * late - 0.3 * late**2, np.cos(middle)])


@pytest.mark.parametrize("kink", [0.4501, 0.47, 0.4999, 0.5301])
def test_a_kink_is_found_with_its_place_and_its_jump_and_smooth_unknowns_have_none(
    kink: float,
) -> None:
    times = np.append(np.linspace(0.0, 0.4, 9), np.linspace(0.45, 1.0, 8))
    kinks, smooth = find_kinks(times, hat(times, kink), np.zeros(16, dtype=int), np.abs)
    assert kinks.unknown.tolist() == [0]
    assert kinks.t[0] == pytest.approx(kink, abs=0.003)
    assert kinks.jump[0] == pytest.approx(2.0, rel=0.05)
    assert times[kinks.step[0]] <= kinks.t[0] <= times[kinks.step[0] + 1]
    assert np.abs(smooth[:, 0]).max() <= 0.61
    # across a breakpoint nothing is compared
    segment = (np.arange(16) >= 9).astype(int)
    kinks, _ = find_kinks(times, hat(times, kink), segment, np.abs)
    assert not kinks.t.size or abs(kink - 0.45) > 0.05


def test_where_a_block_without_viscosity_stops_is_the_vertex_of_its_way() -> None:
    times = np.linspace(0.0, 2.0, 14)
    u = np.sin(np.minimum(times, 0.5 * np.pi))  # it stops at pi / 2, in the eleventh step
    z = np.diff(u)[:, None] / np.diff(times)[:, None]
    z[10] += 0.002 / (times[11] - times[10])  # and goes too far
    stops = find_stops(times, z, np.zeros(13, dtype=int))
    assert stops.step.tolist() == [10]
    assert stops.t[0] == pytest.approx(0.5 * np.pi, abs=2e-3)
    assert stops.jump[0] == pytest.approx(1.0, rel=0.1)
    assert stops.missed[0] == pytest.approx(0.002, abs=1e-4)
    assert stops.sure[0]


def second_order(name: str) -> dict[str, str]:
    return {"scheme": "sdirk2"} if case(name).process.rate_independent else {}


def watched(name: str, times: np.ndarray) -> tuple[so.Solution, Watch, Flow]:
    """A run over a grid, and what is seen of it."""
    sol = run(name, times, **second_order(name))
    flow = Flow(case(name).process, sol.plan.scheme)
    watch = Watch(times, times[[0, -1]], flow, None, 100)
    for i, (u, z) in enumerate(zip(sol.u[1:], sol.velocity, strict=True)):
        watch.see(i, u, z)
    return sol, watch, flow


@pytest.mark.parametrize("name", ["S02", "S03", "P09", "P10", "V05", "B14", "M16"])
def test_the_error_of_a_pass_and_that_of_another_grid_are_told_within_a_third(name: str) -> None:
    """Kinks count by their place: the leading order alone is wrong by 2 to 4 here and there."""
    scheme = second_order(name)
    fine, coarse = (np.linspace(0.0, case(name).t_end, n + 1) for n in (1000, 350))
    _, watch, flow = watched(name, fine)
    found = error(name, run(name, fine, **scheme), 200)
    assert watch.error == pytest.approx(found, rel=0.35)
    found = error(name, run(name, coarse, **scheme), 200)
    foretold = watch.course.on(flow, coarse).sizes(flow).max()
    assert foretold == pytest.approx(found, rel=0.35)


@pytest.mark.parametrize("name", ["S03", "M16"])
def test_a_pass_that_is_mended_is_the_run_over_its_grid(name: str) -> None:
    sol = run(name, so.Adaptive(1e-2))
    assert sol.passes[-1].steps > len(sol.t) - 1  # some were made again
    again = run(name, sol.t, scheme=sol.plan.scheme.name)
    assert np.abs(again.u - sol.u).max() <= 1e-14
    assert np.array_equal(again.stats["t"], sol.stats["t"])
    # bit for bit with the same sizes of steps
    seen: list[Any] = []
    called = run(name, so.Adaptive(1e-2), callback=lambda info: seen.append(info.velocity.copy()))
    assert np.array_equal(called.u, sol.u)
    assert np.array_equal(called.velocity, sol.velocity)
    assert np.array_equal(np.array(seen), sol.velocity)
    assert np.array_equal(called.stats["certificate"], sol.stats["certificate"])
    assert np.array_equal(run(name, so.Adaptive(1e-2), save="last").u[-1], sol.u[-1])


@pytest.mark.parametrize("name", ["S03", "P09", "M16"])
def test_states_that_are_too_large_to_be_kept_are_seen_a_few_at_a_time(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    times = np.linspace(0.0, case(name).t_end, 301)
    _, whole, _ = watched(name, times)
    monkeypatch.setattr("sweepopt.integrate.error_estimator.WHOLE", 0)
    monkeypatch.setattr("sweepopt.integrate.error_estimator.BLOCK", 30)
    _, watch, _ = watched(name, times)
    assert whole.whole
    assert not watch.whole
    assert watch.error == pytest.approx(whole.error, rel=1e-3)
    assert np.array_equal(watch.sizes, whole.sizes)
    sol = run(name, so.Adaptive(1e-3))
    assert sol.success
    assert error(name, sol) <= FACTOR * 1e-3


def test_a_block_without_viscosity_that_turns_from_one_step_to_the_next_is_seen() -> None:
    times = np.linspace(0.0, 1.0, 9)
    process = so.SweepingProcess([[0.0]], [[1.0]], so.Box([-1], [1]), [0.0])
    watch = Watch(times, times[[0, -1]], Flow(process, so.schemes.SCHEMES["sdirk2"]), None, 16)
    for i in range(8):
        z = np.array([1.0 if i < 4 else -1.0])
        watch.see(i, z * times[i + 1], z)
    assert watch.error > 0.01


def test_only_what_is_not_forgotten_is_mended() -> None:
    """Two steps miss the same, but nothing is left of the first one's when the second errs."""
    process = so.SweepingProcess([[1.0]], [[1.0]], so.Box([-1], [1]), [0.0])
    flow, n = Flow(process, so.schemes.SCHEMES["midpoint"]), 12
    own, kept = np.zeros((n, 1)), np.ones((n, 1))
    own[[2, 8]], kept[5] = 1.0, 0.0
    missed = Missed(own, kept, np.ones(n), kept[:, 0], np.zeros(n))
    errors = np.array([0, 0, 1, 1, 1, 0, 0, 0, 1.1, 1.1, 1.1, 1.1])[:, None]
    times = np.linspace(0.0, 1.0, n + 1)
    better = mended(flow, times, missed, Carried(errors, np.zeros(n)), 1.05, 0.5, 0.0)
    assert better is not None
    assert better.known == 8
    assert np.setdiff1d(better.times, times) == pytest.approx([0.5 * (times[8] + times[9])])
    # not where the steps would be too short
    assert mended(flow, times, missed, Carried(errors, np.zeros(n)), 1.05, 0.5, 0.05) is None


def test_no_step_that_is_halved_becomes_shorter_than_the_minimum() -> None:
    process, t_end = random_process(101)
    exact = so.solve(process, t_end=t_end, steps=1, scheme="exact").exact
    assert exact is not None
    size = max(map(process.metric.norm, exact(np.linspace(0.0, t_end, 400))))
    steps = so.Adaptive(0.1 * size, first=10.0, minimum=1.0)
    sol = so.solve(process, t_end=t_end, steps=steps, on_failure="stop")
    assert np.diff(sol.t).min() >= 1.0 or not sol.success


def test_what_the_first_steps_said_is_not_lost_where_a_pass_goes_on_from_later_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from sweepopt.integrate import loop as march

    step = march.step

    def unproved(process: Any, scheme: Any, velocities: Any, t: float, mu: float, u: Any) -> Any:
        z, stages = step(process, scheme, velocities, t, mu, u)
        if t > 0.01:
            return z, stages
        found = [one.velocity._replace(relative=math.nan) for one in stages]
        return z, [one._replace(velocity=new) for one, new in zip(stages, found, strict=True)]

    monkeypatch.setattr("sweepopt.integrate.loop.step", unproved)
    monkeypatch.setattr("sweepopt.integrate.loop._overshot", lambda *of: of[3] == 0)
    monkeypatch.setattr("sweepopt.integrate.loop.longest_safe", lambda *of: 0.0)
    with pytest.warns(so.StabilityWarning, match="in the step from t = 0:"):
        sol = so.solve(problem("S03").process(), t_end=8.0, steps=so.Adaptive(1e-2))
    assert sol.passes[-1].steps > len(sol.t) - 1
    assert np.isnan(sol.stats["relative"]).sum() == 1
    assert sol.status is so.Status.UNCERTIFIED


def test_ctrl_c_just_where_a_pass_is_to_be_mended_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    class Impatient(Watch):
        def see(self, i: int, u: np.ndarray, z: np.ndarray) -> bool:
            if super().see(i, u, z):
                raise KeyboardInterrupt
            return False

    monkeypatch.setattr("sweepopt.integrate.adaptive.Watch", Impatient)
    assert run("S03", so.Adaptive(1e-2)).status is so.Status.INTERRUPTED
