"""A study: its table, what a kill leaves, executors that agree bit for bit, failures as rows."""

import shutil
import signal
from concurrent.futures import Executor, Future
from dataclasses import replace
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import Mock

import numpy as np
import pandas as pd
import psutil
import pytest
from cases import refuses
from processes import started
from reference_cases import case
from test_cli import make_scene

import sweepopt as so
from sweepopt import io as library
from sweepopt.cli import main
from sweepopt.study import (
    Study,
    advice,
    dask_executor,
    find_source,
    halving,
    own_source,
    processes,
    read_study,
    read_table,
    run,
    summary,
)
from sweepopt.study.cell import Cell, CellRow, Reference, run_cell
from sweepopt.study.problems import problem

# of a run: its times, and the threads that its process was given
OF_A_RUN = ["wall", "cpu", "machine"]
TEXT = """
title = "small cells"
problems = ["S03", "V05"]
schemes = ["midpoint", "catching-up"]
solvers = ["auto", "daqp"]
steps = [14, 20]
tols = [1e-6]
repeats = 1
"""
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")  # sockets of workers killed
SMALL = Study(("S03", "M16"), ("midpoint", "catching-up"), ("auto",), (8, 16), repeats=1)


def same(one, other):
    """Equal bit for bit, times apart."""
    pd.testing.assert_frame_equal(
        one.drop(columns=OF_A_RUN), other.drop(columns=OF_A_RUN), check_exact=True
    )


def finished(folder):
    """The lines of the finished cells, in the order in which they were written."""
    path = folder / "rows.jsonl"
    return path.read_bytes().splitlines()[1:] if path.exists() else []


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("study") / "small.toml"
    path.write_text(TEXT, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """The folder of a small study, to be copied."""
    folder = tmp_path_factory.mktemp("small") / "small"
    run(SMALL, folder)
    return folder


@pytest.fixture(scope="module")
def killed(file, tmp_path_factory):
    """The folder of the study when its process was killed at half; its workers ended with it."""
    folder = tmp_path_factory.mktemp("killed")
    command = ["-m", "sweepopt", "study", str(file), "--out", str(folder), "--workers", "1"]
    with started(lambda: len(finished(folder)) >= 8, *command) as process:
        children = psutil.Process(process.pid).children(recursive=True)
    assert 8 <= len(finished(folder)) < 16
    assert children
    _, alive = psutil.wait_procs(children, timeout=20)
    assert not alive
    return folder


@pytest.fixture(scope="module")
def table(file, killed):
    """The study's table after it went on."""
    before, said = finished(killed), []
    table = run(read_study(file), killed, progress=said.append)
    # none of the finished cells is lost, none is computed again; a line may be cut
    whole = [line for line in before if line.endswith(b"}")]
    assert len(table) == 16
    assert finished(killed)[: len(whole)] == whole
    assert len([line for line in said if " of " in line and ":" in line]) == 16 - len(whole)
    return table


# ---- the table ------------------------------------------------------------------------------


def test_a_study_killed_at_half_ends_its_workers_and_goes_on_where_it_was(file, killed, table):
    assert list(table.columns) == list(CellRow._fields)
    assert table.run.is_unique
    assert (table.success == (table.status == "SUCCESS")).all()

    study, nobody = read_study(file), Mock(Executor)  # finished: nothing is computed
    pd.testing.assert_frame_equal(run(study, killed, executor=nobody), table, check_exact=True)
    nobody.submit.assert_not_called()
    pd.testing.assert_frame_equal(read_table(study, killed), table, check_exact=True)


def test_errors_and_certificates_are_those_of_the_library(table):
    chosen = (table.problem == "S03") & (table.solver == "auto")
    process = problem("S03").process()
    for row in table[chosen & table.success].itertuples():
        sol = so.solve(process, t_end=8.0, steps=row.steps, scheme=row.scheme, on_unstable="ignore")
        assert row.certificate == sol.stats["relative"].max()
        assert row.size == pytest.approx(np.abs(sol.u).max() * np.sqrt(0.5), rel=1e-14)
        assert row.bound == sol.error_bound()
        assert row.steps_done == row.steps
        assert row.wall > 0.0


@pytest.mark.slow  # .ci/run runs it
def test_errors_are_those_against_exact_solutions_or_fine_runs(tmp_path):
    rows = run(Study(("S03", "V05"), ("midpoint",), ("auto",), (101,), repeats=1), tmp_path)
    for row in rows.itertuples():
        assert row.error == pytest.approx(case(row.problem).errors["midpoint"]["101"], rel=0.03)
    assert rows.reference_error[0] == 0.0 < 20 * rows.reference_error[1] <= rows.error[1]


def test_a_process_of_ones_own_is_a_problem_like_those_of_the_library(tmp_path):
    known = problem("S03")
    mine = own_source("mine", known.process(), known.t_end)
    table = run(replace(SMALL, problems=(mine, "S03")), tmp_path)
    of_mine, of_theirs = (table[table.problem == name] for name in ("mine", "S03"))
    for column in ("status", "error", "bound", "certificate", "steps_done", "path"):
        np.testing.assert_array_equal(of_mine[column], of_theirs[column])
    other = own_source("mine", known.process(), 0.5 * known.t_end)
    assert run(replace(SMALL, problems=(mine,)), tmp_path).run.isin(table.run).all()
    assert not run(replace(SMALL, problems=(other,)), tmp_path).run.isin(table.run).any()
    with refuses(r"^problems\[0\]: a process is given as own_source"):
        replace(SMALL, problems=(known.process(),))
    with refuses("executor: processes of one's own"):
        run(replace(SMALL, problems=(mine,)), tmp_path, executor=processes(1))
    with refuses(r"study must be a Study, got 'my.toml'; .*read_study"):
        run("my.toml", tmp_path)


def test_an_error_that_the_reference_cannot_tell_is_no_number(monkeypatch):
    process, u = problem("S03").process(), np.zeros((3, 1))
    near = Reference(u + 1e-6, 1e-6)
    assert np.isnan(near.error(process, u))
    far = near._replace(u=u + 1.5 * 20 * 1e-6)
    assert far.error(process, u) == pytest.approx(1.5 * 20 * 1e-6 * np.sqrt(0.5))
    assert np.isnan(far.error(process, u[:2]))  # a run that stopped early
    cell = Cell(find_source("S03"), "midpoint", "auto", 8, 1e-6, 1)
    missing = Mock(return_value=Reference(message=" No reference: StepError: missed."))
    monkeypatch.setattr("sweepopt.study.cell.find_reference", missing)
    row = run_cell(cell, cell.problem)
    assert row.status == "SUCCESS"
    assert np.isnan(row.error)
    assert " No reference: StepError: missed." in row.message


def test_failures_are_rows(table, tmp_path, monkeypatch):
    refused = table[(table.problem == "V05") & (table.solver == "daqp")]
    assert set(refused.status) == {"SolverRefusedError"}
    assert refused.message.str.startswith("daqp cannot treat Ball").all()
    unstable = table[(table.scheme == "catching-up") & (table.problem == "S03")]
    assert set(unstable[unstable.steps == 14].status) == {"UnstableStepError"}
    # a warning of a run that succeeded is told
    assert unstable[unstable.steps == 20].message.str.contains("can overshoot").all()
    solvers = ("cvxpy:nope", "cvxpy:clarabel")
    rows = run(Study(("S03",), ("midpoint",), solvers, (8,), repeats=1), tmp_path)
    assert list(rows.status) == ["SolverRefusedError", "SUCCESS"]
    assert rows.error.isna().tolist() == [True, False]
    assert rows.machine.str.contains("python 3.").all()

    monkeypatch.setattr("clarabel.DefaultSolver", Mock(side_effect=ZeroDivisionError("a bug")))
    cell = Cell(find_source("P09"), "midpoint", "clarabel", 8, 1e-6, 1)
    row = run_cell(cell, cell.problem)
    assert (row.status, row.message, row.success) == ("ZeroDivisionError", "a bug", False)


# ---- meshes ---------------------------------------------------------------------------------


@pytest.mark.slow  # .ci/run runs it
def test_errors_of_meshes_are_against_a_finer_one_and_fall_with_their_order(tmp_path):
    square, text = library.find_scene("square"), "refinements = 2"
    shutil.copy(square.with_suffix(".msh"), tmp_path)
    coarse = square.read_text().replace(text, "refinements = 1").replace("end = 4.0", "end = 1.0")
    (tmp_path / "square.toml").write_text(coarse)
    study = Study(("square.toml",), ("midpoint",), ("auto",), (12,), repeats=1, folder=tmp_path)
    one = replace(study, refinements=(1,))
    study = replace(one, refinements=(0, 1), elements=("P1", "P2"))
    table = run(study, tmp_path)
    assert table.success.all()
    assert list(table.unknowns[table.element == "P1"]) == [20, 72]
    of_p1, of_p2 = (table.error[table.element == one].to_numpy() for one in study.elements)
    assert (of_p2 < 0.5 * of_p1).all()
    # the traction ends in a corner of the square: the orders are those of its singularity
    assert (np.log2(of_p1[:-1] / of_p1[1:]) > 0.7).all()
    assert (np.log2(of_p2[:-1] / of_p2[1:]) > 0.9).all()

    finest = study.reference(study.runs()[0].problem)
    assert (finest.refinements, finest.element) == (2, "P2")
    own = replace(study, elements=("", "P1"))  # "" may be P2
    assert own.reference(own.runs()[0].problem).element == "P2"
    (row,) = run(one, tmp_path / "one").itertuples()
    # on one mesh the error is that in time, which its guaranteed bound holds for
    assert row.error < 0.1 * of_p1[-1]
    assert row.error <= row.bound


# ---- files ----------------------------------------------------------------------------------


def test_what_is_not_whole_is_computed_again(small, tmp_path):
    shutil.copytree(small, tmp_path, dirs_exist_ok=True)
    whole, lines = read_table(SMALL, tmp_path), finished(tmp_path)
    killed = lines[-1][:-9]  # while it was written
    damaged = [b"", lines[0][:-20], b"{}", b"[]", b"5", b"\xff", *lines[4:-1], killed]
    (tmp_path / "rows.jsonl").write_bytes(b"\n".join(damaged))
    said = []
    again = run(SMALL, tmp_path, progress=said.append)
    assert said[0] == "8 runs, 3 of them finished before"
    same(again, whole)
    assert finished(tmp_path)[5:9] == [*lines[4:-1], killed]


def test_an_edited_scene_is_another_cell_and_a_moved_one_is_not(tmp_path):
    def cell(folder):
        return Cell(find_source("ring.toml", folder), "midpoint", "auto", 4, 1e-6, 1)

    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        make_scene(tmp_path / name)
    here = cell(tmp_path / "a")
    assert cell(tmp_path / "b").id == here.id
    for file in ("ring.toml", "ring.msh"):
        path = tmp_path / "b" / file
        content = path.read_bytes()
        path.write_bytes(content + b"\n")
        assert cell(tmp_path / "b").id != here.id
        path.write_bytes(content)
    # a scene that is edited while a study runs is a failed row
    scene = tmp_path / "a" / "ring.toml"
    text = scene.read_text()
    scene.write_text(text.replace("g = 0.6", "g = 0.7"))
    assert "not as it was when the study started" in run_cell(here, here.problem).message
    scene.write_text(text)
    row = run_cell(here, here.problem)
    assert (row.status, row.problem, row.steps_done) == ("SUCCESS", "ring", 4)
    assert row.path != "full"
    scene.write_text(f'{text}\n[solve]\npath = "full"\n')  # the path that a scene names is taken
    full = cell(tmp_path / "a")
    assert run_cell(full, full.problem).path == "full"


def test_a_scene_that_starts_from_a_run_is_another_when_the_run_is(tmp_path):
    (tmp_path / "after.toml").write_text('[initial]\nrun = "solution.nc"\n')
    run, digests = tmp_path / "solution.nc", set()
    for content in (b"one", b"two", b"one"):
        run.write_bytes(content)
        digests.add(find_source("after.toml", tmp_path).digest)
    assert len(digests) == 2


# ---- executors ------------------------------------------------------------------------------


def local_cluster(workers, **settings):
    """A dask cluster, of which the extra test has none."""
    distributed = pytest.importorskip("distributed", reason="needs the extra dask")
    return distributed.LocalCluster(workers, **{"threads_per_worker": 1} | settings)


@pytest.fixture(scope="module")
def cluster():
    """The address of a dask cluster that gives up what workers died of, or beside, twice."""
    giving_up = {"allowed_failures": 1}
    with local_cluster(2, dashboard_address=None, scheduler_kwargs=giving_up) as there:
        yield there.scheduler_address


def test_the_command_computes_the_same_rows_on_a_scheduler(small, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = TEXT.replace('"V05"', '"M16"').replace("[14, 20]", "[8, 16]").replace(', "daqp"', "")
    Path("small.toml").write_text(text, encoding="utf-8")
    # a thread in place of a worker's process, which takes seconds to start; .ci/run has processes
    with local_cluster(1, processes=False, dashboard_address=None) as there:
        address = there.scheduler_address
        assert main(["study", "small.toml", "--out", "out", "--scheduler", address]) == 0
        assert there.scheduler.transition_counter >= 8  # cells
    same(read_table(SMALL, "out"), read_table(SMALL, small))


def test_a_cluster_that_is_not_there_or_shares_time_is_refused():
    shared = {"threads_per_worker": 2, "processes": False, "dashboard_address": ":0"}
    with local_cluster(1, **shared) as there:
        for address, words in (
            (there.scheduler_address, "has 2 threads, .* --nthreads 1"),
            ("nowhere", "scheduler 'nowhere' does not answer"),
        ):
            with refuses(words), dask_executor(address):
                pass


@pytest.mark.slow  # .ci/run runs it
@pytest.mark.parametrize("where", ["processes", "dask"])
def test_workers_give_the_same_rows_though_a_cell_kills_them_and_other_breakdowns_end_the_study(
    where, small, tmp_path, monkeypatch, request
):
    gone = Future()
    gone.set_exception(ConnectionError("the scheduler is gone"))
    with pytest.raises(ConnectionError):
        run(SMALL, tmp_path, executor=Mock(Executor, submit=Mock(return_value=gone)))
    assert not finished(tmp_path)

    def deadly(pool):
        def submit(function, cell, *arguments):
            dies = "M16 midpoint auto 16" in str(cell)
            call = (signal.raise_signal, signal.SIGKILL) if dies else (function, cell, *arguments)
            return given(*call)

        given = pool.submit
        monkeypatch.setattr(pool, "submit", submit)
        return pool

    monkeypatch.setattr("sweepopt.study.study.processes", lambda count: deadly(processes(count)))
    dask = where == "dask" and request.getfixturevalue("cluster")
    few = replace(SMALL, problems=("M16",), schemes=("midpoint",), steps=(16, 8))
    with dask_executor(dask) if dask else processes(1) as workers:
        table = run(few, tmp_path, executor=deadly(workers))
    dead = table.status == "BrokenProcessPool"
    assert table.run[dead].str.startswith("M16 midpoint auto 16").tolist() == [True]
    assert table.message[dead].str.contains("terminated abruptly").all()
    whole, rest = read_table(SMALL, small), table[~dead]
    assert len(rest) == 1
    same(rest.reset_index(drop=True), whole[whole.run.isin(rest.run)].reset_index(drop=True))


# ---- what a study may be --------------------------------------------------------------------


def read(old, new):
    """The study with a change, for data/refused.txt."""
    with TemporaryDirectory() as place:
        path = Path(place) / "bad.toml"
        path.write_text(TEXT.replace(old, new, 1))
        return read_study(path)


def test_tables_of_hard_and_stiff_cases_change_nothing_else(file):
    both = read(TEXT, f"{TEXT}\n[hard]\nseeds = [1]\n[stiff]\nseeds = [2]\n")
    assert replace(both, folder="") == replace(read_study(file), folder="")


def test_the_studies_of_the_library_can_be_run_and_are_no_problems():
    folder = library.find_study("accuracy").parent
    assert library.find_study("hard").parent.name == "hard"
    for path in folder.glob("*.toml"):
        assert len(read_study(library.find_study(path.stem)).runs()) > 0
        assert path.stem not in library.list_scenes()


def row(error, wall, **others):
    """Of a run that succeeded, unless the others say more."""
    asked = ("P", 0, "", "midpoint", "auto", 10, 1e-6, 1, "id")
    return CellRow(*asked, "SUCCESS", True, error=error, size=2.0, wall=wall)._replace(**others)


# ---- advice ---------------------------------------------------------------------------------


def test_the_next_halving_is_cheapest_along_the_axis_of_the_least_cost():
    def modelled(refinements, steps, tol, element="P1"):
        """The error in time is of second order, that in space of first; a tol of 1e-1 leaves 0."""
        solver = 1e-3 if tol == 1e-1 else 0.0
        error = 16.0 / steps**2 + 0.1 / 2**refinements / (8 if element == "P2" else 1) + solver
        wall = 1e-3 * steps * 4**refinements * (3 if element == "P2" else 1) - (tol > 1e-2) * 1e-4
        return row(2 * error, wall, refinements=refinements, element=element, steps=steps, tol=tol)

    axes = product((0, 1, 2), (10, 20, 40, 80), (1e-1, 1e-6), ("P1", "P2"))
    costs = halving(pd.DataFrame([modelled(k, n, tol, e) for k, n, tol, e in axes]))
    assert costs.wall.is_monotonic_increasing
    assert (costs.error.to_numpy()[1:] < 0.9 * costs.error.to_numpy()[:-1]).all()
    first, last = costs.iloc[0], costs.iloc[-1]
    assert (first.steps, first.refinements, first.element) == (10, 0, "P1")
    assert first.cheapest == "more steps"  # of an error of 0.26, 0.16 is in time
    fall = np.log((0.16 + 0.101) / (0.04 + 0.101))
    cost = np.log((20e-3 - 1e-4) / (10e-3 - 1e-4))
    assert first["more steps"] == pytest.approx(np.exp(cost * np.log(2) / fall))
    assert set(costs.cheapest) == {"more steps", "a smaller tol", "a finer mesh", ""}
    assert costs["a higher degree"][costs.element == "P2"].isna().all()
    assert np.isnan(last[["more steps", "a finer mesh"]].astype(float)).all()
    # more steps help at first, but the error of the mesh is more than half
    table = pd.DataFrame([modelled(k, n, 1e-6) for k in (0, 1) for n in (14, 20, 40, 80)])
    stuck = halving(table).query("steps == 14 and refinements == 0").iloc[0]
    assert (stuck["more steps"], stuck.cheapest) == (np.inf, "a finer mesh")
    # neither alone lessens the error
    errors = {(10, "P1"): 1.0, (10, "P2"): 1.0, (20, "P1"): 1.0, (20, "P2"): 0.3}
    table = pd.DataFrame([row(e, n, steps=n, element=p) for (n, p), e in errors.items()])
    assert list(halving(table).cheapest) == ["more steps and a higher degree", ""]
    # the words of the summary name the run and the way
    table = pd.DataFrame([modelled(0, n, 1e-6, e) for n in (10, 80) for e in ("P1", "P2")])
    shown = [line.split() for line in summary(table).splitlines()]
    assert ["P", "midpoint", "auto", "10", "1e-06", "0", "P1", "0.26", "10", "more"] in [
        line[:10] for line in shown
    ]
    assert ["no", "run", "meets", "0.01"] in shown
    assert any(line[9:12] == ["a", "higher", "degree"] for line in shown)


def test_the_advice_is_the_fastest_cell_that_is_accurate_enough():
    rows = [row(1e-3, 5.0), row(1e-2, 2.0, scheme="best"), row(3e-2, 1.0)]
    rows += [row(1e-9, 0.1, status="INEXACT", success=False)]
    table = pd.DataFrame([*rows, row(np.nan, 0.1)])
    chosen = advice(table, (1e-2, 1e-3, 1e-5))
    assert list(chosen.target) == [1e-2, 1e-3]
    assert list(chosen.wall) == [2.0, 5.0]
    shown = summary(table)
    assert ["P", "best", "auto", "10", "1e-06", "0", "0.005", "2e+03", "0.01"] in [
        line.split() for line in shown.splitlines()
    ]
    assert "5 runs, 1 failed" in shown
    assert "1  succeeded, but no reference is good enough for an error" in shown
