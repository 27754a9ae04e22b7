"""What ways cost at one error: the smoothed law, the search for settings, other packages."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest

import sweepopt as so
from sweepopt.study import peers
from sweepopt.study.equal_error import cheapest, cost_table, equal_error, main
from sweepopt.study.peers import compare_peers, error_at_nodes, peer_table
from sweepopt.study.problems import BLOCK, problem
from sweepopt.study.smoothed import METHODS, friction_of, smooth, solve_smoothed
from sweepopt.study.ways import (
    REPORTS,
    Ladder,
    Run,
    Steps,
    Task,
    by_hand,
    exact,
    field_solver,
    scheme,
    smoothed,
)


@pytest.fixture(scope="module")
def task() -> Task:
    return Task(BLOCK.process(), BLOCK.t_end)


def known_errors(task: Task, order: float, constant: float = 1.0) -> Steps:
    """A way whose error is constant * steps^-order by construction."""
    direction = np.zeros_like(task.exact)
    direction[-1] = 1.0 / task.process.metric.norm(np.ones(task.process.dim))

    def run(steps: int) -> Run:
        return Run(
            f"{steps} steps", lambda: task.exact + constant * float(steps) ** -order * direction
        )

    return Steps("known", run)


@pytest.mark.parametrize("name", ["S01", "S02", "S03", "block"])
def test_the_smoothed_law_tends_to_the_exact_solution_in_proportion_to_eps(name: str) -> None:
    posed = problem(name)
    task = Task(posed.process(), posed.t_end)
    errors = [
        task.error(
            solve_smoothed(
                friction_of(task.process), task.times, eps=eps, method="LSODA", rtol=1e-11,
                max_step=0.2,
            )
        )
        for eps in (1e-3, 1e-4, 1e-5, 1e-6)
    ]  # fmt: skip
    slopes = np.diff(np.log10(errors))
    assert np.all((slopes > -1.1) & (slopes < -0.8)), errors
    assert errors[-1] < 2e-5


@pytest.mark.parametrize("eps", [1e-1, 1e-4, 1e-8])
def test_the_smoothed_velocity_solves_the_law_and_its_slope_is_the_derivative(eps: float) -> None:
    friction = friction_of(problem("S03").process())
    law = smooth(friction, eps)
    for t in np.linspace(0.05, 7.9, 40):
        for u in (-1.0, 0.0, 0.3):
            z = law.velocity(t, [u])[0]
            s = 3.0 * math.sin(2.0 * t) - friction.b * u
            assert friction.a * z + math.tanh(z / eps) == pytest.approx(s, abs=1e-12)
            step = 1e-6
            apart = law.velocity(t, [u + step])[0] - law.velocity(t, [u - step])[0]
            slopes = [law.slope(t, [v])[0][0] for v in (u - step, u, u + step)]
            assert min(slopes) - 1e-6 <= apart / (2 * step) <= max(slopes) + 1e-6


@pytest.mark.parametrize("name", ["P09", "S04", "V05", "M16", "P10"])
def test_a_process_without_a_smoothed_law_is_refused(name: str) -> None:
    with pytest.raises(so.InputError, match="one unknown with a dashpot"):
        friction_of(problem(name).process())


def test_eps_must_be_positive() -> None:
    with pytest.raises(so.InputError, match="eps"):
        smooth(friction_of(BLOCK.process()), 0.0)


def test_the_loop_by_hand_is_the_paper_s_scheme(task: Task) -> None:
    ours = scheme(task, "catching-up").run(1000).states()
    assert np.abs(by_hand(task).run(1000).states() - ours).max() < 1e-12


@pytest.mark.parametrize("wanted", [1e-3, 1e-5])
def test_every_way_reaches_the_error_and_tells_its_true_one(task: Task, wanted: float) -> None:
    rivals = [smoothed(task, method, 0.5) for method in METHODS]
    fields = [field_solver(task, "LSODA"), field_solver(task, "Radau")]
    ways = [scheme(task, "midpoint"), scheme(task, "sdirk2"), exact(task), *fields, *rivals]
    costs = equal_error(task, wanted, ways=ways, rounds=1)
    assert {cost.way for cost in costs} == {way.name for way in ways}
    fine = so.solve(task.process, t_end=task.t_end, steps=20_000, scheme="sdirk2", save=200).u
    for way in ways:
        found = cheapest(task, way, wanted)
        assert not found.note
        assert found.error <= wanted
        independent = np.abs(found.run.states() - fine).max()  # |.|_A = |.|: A = 1
        assert abs(independent - found.error) < 1e-7
    assert [cost.seconds for cost in costs] == sorted(cost.seconds for cost in costs)
    assert costs[0].ratio == pytest.approx(1.0)
    assert "midpoint" in cost_table(costs, wanted)


@pytest.mark.parametrize("order", [1.0, 2.0, 3.0])
@pytest.mark.parametrize("wanted", [1e-3, 1e-5])
def test_the_search_finds_about_the_fewest_steps(task: Task, order: float, wanted: float) -> None:
    found = cheapest(task, known_errors(task, order, 10.0), wanted)
    steps, fewest = int(found.run.setting.split()[0]), (10.0 / wanted) ** (1.0 / order)
    assert found.error <= wanted
    assert fewest <= steps <= 1.3 * fewest + REPORTS


def test_what_takes_too_many_steps_is_extrapolated_and_says_so(task: Task) -> None:
    way = known_errors(task, 1.0)
    (cost,) = equal_error(task, 1e-6, ways=[way], rounds=1, most=20_000)
    assert "extrapolated to 1e+06 steps, order 1.00" in cost.note
    assert cost.setting == "20000 steps"
    assert cost.error == pytest.approx(1 / 20_000)
    assert math.isnan(cost.ratio)
    assert "extrapolated" in cost_table([cost], 1e-6)


def test_a_way_that_never_gets_there_comes_last_with_its_best_error(task: Task) -> None:
    def rungs(wanted: float) -> object:
        for off in (1.0, 0.1, 0.5):
            yield Run(f"off {off}", lambda off=off: task.exact + off)

    costs = equal_error(task, 1e-3, ways=[Ladder("poor", rungs), exact(task)], rounds=1)
    assert [cost.way for cost in costs] == ["exact", "poor"]
    assert (costs[1].note, costs[1].setting) == ("not reached", "off 0.1")


def test_the_command_prints_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    main(["S01", "--t-end", "1", "--error", "1e-2", "--rounds", "1"])
    printed = capsys.readouterr().out
    assert "S01" in printed
    assert "BDF on the smoothed law" in printed
    assert "catching-up by hand" in printed


def test_peers_are_skipped_without_a_python(capsys: pytest.CaptureFixture[str]) -> None:
    rows = compare_peers({})
    assert [row.name for row in rows] == ["solve_nivp", "nosnoc"]
    assert all("skipped" in row.note for row in rows)
    peers.main([])
    assert capsys.readouterr().out.count("skipped: no python that has it was named") == 2


def test_a_python_without_the_package_is_a_row_that_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (one,) = [peer for peer in peers.PEERS if peer.name.endswith("adaptive")]
    first = one._replace(rungs=lambda wanted: iter(list(one.rungs(wanted))[:1]))
    monkeypatch.setattr(peers, "PEERS", (first,))
    for python, words in ((sys.executable, "No module named"), ("/no/such/python", "No such file")):
        (row,) = compare_peers({"solve_nivp": python}, errors=[1e-3])
        assert "not reached" in row.note
        assert words in row.note
        assert words in peer_table([row])


def test_an_unknown_peer_is_refused() -> None:
    with pytest.raises(so.InputError, match="siconos"):
        compare_peers({"siconos": sys.executable})


def test_a_peer_is_judged_at_its_own_nodes_and_must_come_to_the_end(task: Task) -> None:
    times = np.sort(np.append(np.linspace(0.0, 10.0, 37), [3.0, 3.0 + 1e-15]))
    u = so.solve(task.process, steps=np.unique(times.round(12)), scheme="exact")(times)[:, 0]
    assert error_at_nodes(times, u) < 1e-8
    assert error_at_nodes(times, u + 0.5) == pytest.approx(0.5, abs=1e-8)
    assert error_at_nodes(times[:-3], u[:-3]) == math.inf
