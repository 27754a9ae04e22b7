"""The benchmarks at a size that takes seconds: what is computed, and how accurately.

Nothing here looks at how long anything takes.
"""

import math
import sys
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

import sweepopt as so
from sweepopt.study.problems import problem

sys.path.insert(0, str(Path(__file__).parent.parent / "benchmarks"))
import bounds
import equal_error
import loops_by_hand
import packages
import scenes
from equal_error import Task

pytestmark = pytest.mark.slow  # .ci/run runs them


@pytest.fixture(scope="module")
def task():
    block = problem("block")
    return Task.of(block.process(), block.t_end)


# ---- loops by hand ----------------------------------------------------------------------------


def test_every_path_and_loop_is_as_accurate_as_it_says_and_ours_are_certified():
    known = {one.path: one for one in (*loops_by_hand.SQUARE, *loops_by_hand.TINY)}
    table = loops_by_hand.bench([8], steps=5, rounds=1)
    assert set(table.path) == set(known)
    for row in table.to_dict("records"):
        by_hand = "hand" in row["path"] or "cvxpy" in row["path"]
        assert row["difference"] <= known[row["path"]].accuracy, row["path"]
        assert math.isnan(row["certificate"]) == by_hand, row["path"]
        assert by_hand or row["certificate"] <= 1e-6
        assert math.isnan(row["x by hand"]) == (not known[row["path"]].by_hand)
    text = loops_by_hand.text(table)
    assert "unit square, 8 cells a side: 72 unknowns, 9 with friction, 5 steps" in text


def test_the_command_runs_chosen_paths_and_writes_rows(tmp_path, capsys):
    chosen = ["--cells", "4", "--steps", "3", "--rounds", "2", "--only", "eliminated"]
    loops_by_hand.main([*chosen, "--csv", str(tmp_path / "rows.csv")])
    assert "eliminated" in capsys.readouterr().out
    header, row = (tmp_path / "rows.csv").read_text().splitlines()
    assert header.startswith("case,path,ms/step")
    assert "eliminated" in row
    assert loops_by_hand.SQUARE[-1].most < 1_001_000  # slow loops leave out large cases


# ---- all ways at one error --------------------------------------------------------------------


def test_every_way_reaches_the_error(task):
    both = equal_error.scheme(task, "catching-up"), equal_error.by_hand(task)
    ours, theirs = (next(islice(way.settings(1e-3), 6, None)) for way in both)
    assert ours.setting == theirs.setting == "800 steps"
    assert np.abs(ours.states() - theirs.states()).max() < 1e-12
    ways = [*equal_error.ours(task), equal_error.by_hand(task)]
    ways += [equal_error.smoothed(task, method, 0.5) for method in equal_error.METHODS]
    table = equal_error.equal_error(task, 1e-3, ways, rounds=1)
    assert set(table.way) == {way.name for way in ways}
    assert (table.error <= 1e-3).all()
    assert (table.note == "").all()
    assert table["x best"].min() == 1.0


# ---- error bounds -----------------------------------------------------------------------------


def test_a_guaranteed_bound_below_a_known_error_is_told():
    kind = bounds.KINDS["soft"]
    rows = [row for case in bounds.cases(kind, 1) for row in bounds.rows(case, kind.hidden)]
    assert all(row.guaranteed and row.ratio >= 1 - row.doubt for row in rows)
    text, wrong = bounds.line("soft", rows)
    assert text.split()[1:3] == ["4", "4"]
    assert kind.says in text
    low = rows[0]._replace(ratio=0.9)
    assert (wrong, bounds.line("soft", [*rows, low])[1]) == (False, True)
    assert not bounds.line("soft", [*rows, low._replace(guaranteed=False)])[1]


# ---- other packages ---------------------------------------------------------------------------


def test_a_package_is_judged_at_its_own_nodes_and_must_come_to_the_end(task):
    times = np.sort(np.append(np.linspace(0.0, 10.0, 37), [3.0, 3.0 + 1e-15]))
    u = so.solve(task.process, steps=np.unique(times.round(12)), scheme="exact")(times)[:, 0]
    assert packages.error_at_nodes(times, u) < 1e-8
    assert packages.error_at_nodes(times, u + 0.5) == pytest.approx(0.5, abs=1e-8)
    assert packages.error_at_nodes(times[:-3], u[:-3]) == math.inf


@pytest.mark.filterwarnings("ignore::sweepopt.errors.InitialStateWarning")
@pytest.mark.parametrize("name, size", [("tread", 2), ("pipe", 3), ("rough", 3), ("ring", 1)])
def test_steps_of_the_scenes_are_those_of_their_loop_with_cvxpy(name, size):
    make, _, t_end, _ = scenes.SCENES[name]
    scene, steps = make(size), 10
    run, seconds = scenes.timed(scene, t_end, steps)
    assert seconds.size == steps
    step = scenes.by_cvxpy(scene, t_end / steps)
    for k in (4, 9):
        z, _ = step(run.u[k], float(run.t[k + 1]))
        assert np.abs(z - run.velocity[k]).max() <= 2e-3 * np.abs(z).max()
