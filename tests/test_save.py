"""What is kept of a run: all of it, a part, a function, a file; and never more than fits."""

import copy
import pickle
import sys
import tracemalloc
from functools import cache
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pandas as pd
import pytest
import scipy.sparse as sp
import xarray as xr
from cases import block, refuses
from processes import python
from test_reduction import CONTACT, SETS, process, springs

import sweepopt as so

PATHS = ["proportional", "eliminated"]


def run(path, **changes):
    return so.solve(process(u0=np.zeros(40)), t_end=2.0, steps=40, path=path, **changes)


whole_run = cache(run)


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize(
    "save, nodes",
    [
        ("last", [0, 40]),
        (1, list(range(41))),
        (15, [0, 15, 30, 40]),
        ([0.0, 1.0, 1.55], [0, 20, 31, 40]),
        ([2.0], [0, 40]),
        (10**30, [0, 40]),
    ],
    ids=str,
)
def test_the_kept_steps_are_those_of_the_whole_run(path, save, nodes):
    whole, some = whole_run(path), run(path, save=save)
    assert np.array_equal(some.t, whole.t[nodes])
    assert np.array_equal(some.u, whole.u[nodes])
    ends = np.array(nodes[1:])
    assert np.array_equal(some.velocity, whole.velocity[ends - 1])
    # every step has its certificate, kept or not
    assert np.array_equal(some.stats["certificate"], whole.stats["certificate"])
    assert np.array_equal(some.viability(), whole.viability())
    assert some.viability(2.0) == whole.viability(2.0)
    assert some.complete == (save == 1)


@pytest.mark.parametrize("path", PATHS)
def test_the_interpolant_answers_in_kept_steps_and_refuses_others(path):
    whole, some = whole_run(path), run(path, save=15)
    inside = np.array([[0.0, 0.71, 0.75], [1.5, 1.99, 2.0]])
    assert some(inside) == pytest.approx(whole(inside), abs=1e-14)
    assert np.array_equal(some(0.0), whole.u[0])
    assert some.viability(0.75) == whole.viability(0.75)
    for ask, t in [(some, 0.02), (some, 0.76), (some.viability, 0.0), (some.residual, 0.0)]:
        with refuses("not kept"):
            ask(t)
    with refuses("not all were kept"):
        some.energy()
    dataset = some.to_xarray()
    assert dict(dataset.sizes) == {"time": 4, "unknown": 40, "step": 40, "kept_step": 3}


@pytest.mark.parametrize("path", PATHS)
def test_a_function_records_every_step_and_sees_all_unknowns(path):
    whole = whole_run(path)
    sol = run(path, save=lambda t, u, z: (t, u[5], z[17]))
    assert sol.recorded == [
        (t, u[5], z[17]) for t, u, z in zip(whole.t[1:], whole.u[1:], whole.velocity, strict=True)
    ]
    assert len(sol.t) == 2
    assert whole.recorded is None


def test_an_empty_container_that_is_called_records_and_watches():
    class Record(list):
        def __call__(self, *step):
            self.append(step)

    recorded, watched = Record(), Record()
    sol = so.solve(slider(), t_end=1.0, steps=4, save=recorded, callback=watched)
    assert sol.recorded == [None] * 4
    assert [t for t, u, z in recorded] == [step.t for (step,) in watched] == [0.25, 0.5, 0.75, 1.0]


@pytest.mark.parametrize("path", PATHS)
def test_a_file_holds_what_memory_would(path, tmp_path):
    whole, file = whole_run(path), tmp_path / "run.nc"
    sol = run(path, save=file)
    assert list(tmp_path.iterdir()) == [file]
    assert np.array_equal(sol.u, whole.u)
    assert np.array_equal(sol.velocity, whole.velocity)
    assert np.array_equal(sol(np.array([0.03, 1.7])), whole(np.array([0.03, 1.7])))
    with xr.open_dataset(file, engine="h5netcdf") as dataset:
        assert np.array_equal(dataset.time, whole.t)
        assert np.array_equal(dataset.u, whole.u)


def test_a_dataset_can_be_changed_and_its_solution_cannot():
    sol = so.solve(slider(), t_end=1.0, steps=4)
    data = sol.to_xarray()
    data["u"] *= 1e3
    assert np.array_equal(data.u, 1e3 * sol.u)
    for states in (sol.u, sol.velocity):
        with pytest.raises(ValueError, match="read-only"):
            states[-1] += 1.0


@pytest.mark.parametrize("save", [None, 3])
def test_a_solution_is_loaded_as_it_was_saved(save, tmp_path):
    sol = run("eliminated", save=save)
    sol.save(tmp_path / "sol.nc")
    files = [tmp_path / "sol.nc"]
    if save is None:
        files.append(tmp_path / "run.nc")
        run("eliminated", save=files[1])
    wanted = sol.to_xarray().drop_vars("seconds")
    for file in files:
        with xr.open_dataset(file, engine="h5netcdf") as dataset:
            found = dataset.load().drop_vars("seconds")
        found.attrs.pop("run", None)
        xr.testing.assert_identical(found, wanted)
        for process_ in (None, sol.process):
            same = so.Solution.load(file, process_)
            assert np.array_equal(same.u, sol.u)
            assert np.array_equal(same.velocity, sol.velocity)
            for name in set(sol.stats.dtype.names) - {"seconds"}:
                assert np.array_equal(same.stats[name], sol.stats[name])
            assert (same.message, same.status) == (sol.message, sol.status)
            assert same.complete == sol.complete
            assert np.array_equal(same(sol.t[-1]), sol(sol.t[-1]))
            assert repr(same) == repr(sol)
        assert np.array_equal(same.viability(), sol.viability())


def test_a_solution_that_is_loaded_without_its_process_or_with_another_says_so(tmp_path):
    sol, file = whole_run("eliminated"), tmp_path / "sol.nc"
    sol.save(file)
    absent = so.Solution.load(file)
    with refuses(r"loaded without its process.*load\(path, process\)"):
        absent.viability()
    assert repr(absent.plan) == "not in the file: so.Solution.load(path, process) has it"
    with refuses(r"process has dim 1, but .* has dim 40"):
        so.Solution.load(file, slider())
    parts = {"A": 2.0 * sol.process.A, "B": sol.process.B, "C": sol.process.C + np.full(40, 1e-3)}
    other = so.SweepingProcess(**parts, u0=sol.process.u0)
    with pytest.warns(so.errors.CheckpointWarning, match=r"A, C\(t\) of process and of the run in"):
        so.Solution.load(file, other)


def test_a_missing_file_is_named(tmp_path, monkeypatch):
    (tmp_path / "locked.nc").write_bytes(b"of another user")
    monkeypatch.setattr(np, "memmap", Mock(side_effect=PermissionError(13, "Permission denied")))
    with refuses(r"locked.nc cannot be read \(Permission denied\)"):
        so.Solution.load(tmp_path / "locked.nc")
    for absent in (tmp_path / "sol.nc", "name" * 1000):
        with refuses("there is no file"):
            so.Solution.load(absent)


def slider():
    return block(so.Sine(3.0, 2.0))


def test_a_file_has_the_states_of_the_run_whatever_a_callback_does_to_its_own(
    tmp_path,
):
    in_file = run("eliminated", save=tmp_path / "run.nc", callback=lambda step: step.u.fill(7.0))
    whole = whole_run("eliminated")
    assert np.array_equal(in_file.u, whole.u)
    for nodes in ([3, 1, 1], [[-1, 0]], 5, slice(2, 4)):
        assert np.array_equal(in_file.states.u(nodes), whole.u[nodes])


def test_a_run_that_fails_has_a_file_of_its_steps_and_replaces_no_other(tmp_path):
    def stop(info):
        if info.step == 11:
            raise RuntimeError("enough")

    file = tmp_path / "run.nc"
    sol = run("eliminated", save=str(file), callback=lambda info: info.step == 3)
    with pytest.raises(RuntimeError, match="enough"):
        run("eliminated", save=file, callback=stop)
    assert sol.u.shape == (5, 40)
    (part,) = set(tmp_path.iterdir()) - {file}
    with xr.open_dataset(part, engine="h5netcdf") as dataset:
        assert np.array_equal(dataset.time, whole_run("eliminated").t[:13])
        assert np.array_equal(dataset.u, whole_run("eliminated").u[:13])


def test_a_folder_is_no_file_for_a_run(tmp_path):
    (tmp_path / "folder.nc").mkdir()
    with refuses("is no regular file"):
        run("eliminated", save=tmp_path / "folder.nc")
    with refuses("it is a folder, name the file in it"):
        so.Solution.load(tmp_path / "folder.nc")


def test_a_history_that_does_not_fit_is_refused_before_the_run():
    with refuses(r"save='last'.*larger memory"):
        run("eliminated", memory=25_000)
    assert run("proportional", memory=25_000).success  # it keeps four unknowns a step
    assert run("eliminated", memory=25_000, save="last").success
    with pytest.raises(
        so.InputError, match=r"keeping 4 states .* takes 2\.88e-06 GB, more than memory = 5e-07"
    ):
        run("eliminated", memory=500, save=[0.5, 1.0, 1.5])


@pytest.mark.parametrize("raises", [False, True], ids=["stopped", "interrupted"])
@pytest.mark.parametrize("path", PATHS)
def test_a_run_that_a_users_function_ends_is_a_consistent_solution(path, raises, tmp_path):
    def end(info):
        if raises and info.step == 6:
            raise KeyboardInterrupt
        return info.step == 6

    whole = whole_run(path)
    for save in (None, "last", 3, [1.5], tmp_path / "run.nc", lambda t, u, z: t):
        sol = run(path, save=save, callback=end)
        assert sol.status is (so.Status.INTERRUPTED if raises else so.Status.STOPPED)
        assert len(sol.stats) == 7
        kept = np.searchsorted(whole.t, sol.t)
        assert (kept[0], kept[-1]) == (0, 7)
        assert np.array_equal(sol.t, whole.t[kept])
        assert np.array_equal(sol.u, whole.u[kept])
        assert np.array_equal(sol.velocity, whole.velocity[kept[1:] - 1])


class CtrlC:
    """Ctrl-C before the k-th line of the library that runs after a step."""

    def __init__(self, step, k):
        self.step, self.left = step, k
        self.inside = str(Path(so.__file__).parent / "integrate")

    def callback(self, info):
        if info.step == self.step:
            frame = sys._getframe()
            while frame is not None:
                frame.f_trace, frame = self.trace, frame.f_back
            sys.settrace(self.trace)

    def trace(self, frame, event, _):
        if not frame.f_code.co_filename.startswith(self.inside):
            return self.trace if frame.f_code.co_filename == __file__ else None
        if event == "line":
            self.left -= 1
            if self.left == 0:
                sys.settrace(None)
                raise KeyboardInterrupt
        return self.trace


@pytest.mark.parametrize("save", [None, 3], ids=str)
def test_ctrl_c_at_any_line_of_a_step_leaves_a_consistent_solution(save, tmp_path):
    this = slider()
    how = {"t_end": 1.0, "steps": 10, "save": save, "scheme": "midpoint"}
    whole = so.solve(this, **{**how, "save": None})
    expected = so.solve(this, **how, checkpoint=so.Checkpoint(tmp_path / "a", steps=4))
    done = set()
    for k in range(1, 80, 6):
        file = tmp_path / f"{k}.npz"
        where = so.Checkpoint(file, steps=4)
        sol = so.solve(this, **how, checkpoint=where, callback=CtrlC(4, k).callback)
        assert sol.status is so.Status.INTERRUPTED
        n = len(sol.stats)
        done.add(n)
        assert sol.t[-1] == whole.t[n]
        assert sol.u[-1] == whole.u[n]
        assert sol.velocity[-1] == whole.velocity[n - 1]
        assert len(sol.velocity) == len(sol.t) - 1 == len(sol.steps)
        found = so.resume(file, this)
        assert found.u.tobytes() == expected.u.tobytes()
        assert found.t.tobytes() == expected.t.tobytes()
        assert found.velocity.tobytes() == expected.velocity.tobytes()
    assert done >= {5, 6}


# times of all sizes have steps of many periods
@pytest.mark.filterwarnings("ignore:the load has a period:sweepopt.StabilityWarning")
def test_times_are_matched_with_the_nearest_node_and_then_found_again():
    this = process(u0=np.zeros(40))
    grid = np.linspace(0.0, 1.0, 8)
    rounded = np.round(grid[[2, 5, 7]], 13)
    sol = so.solve(this, t_end=1.0, steps=7, save=rounded)
    assert np.array_equal(sol(rounded), sol.u[1:])
    fine = np.append(0.0, np.geomspace(1e-12, 1e3, 40))
    kept = so.solve(this, steps=fine, save=fine[[3, 17, 33]])
    assert np.array_equal(kept.t, fine[[0, 3, 17, 33, 40]])


def test_a_run_has_its_states_whatever_becomes_of_its_file(tmp_path):
    first = run("eliminated", save=tmp_path / "run.nc")
    so.solve(process(u0=np.zeros(40)), t_end=3.0, steps=80, save=tmp_path / "run.nc")
    (tmp_path / "run.nc").unlink()
    whole = whole_run("eliminated")
    assert np.array_equal(first(1.0), whole(1.0))
    assert np.array_equal(first.u, whole.u)


def test_all_columns_of_the_statistics_are_those_of_one_array():
    table = so.solve(slider(), t_end=0.4, steps=40).stats
    assert table.shape == (40,)
    assert table["t"] == pytest.approx(0.01 * np.arange(1, 41))
    assert (table["seconds"] > 0).all()
    assert list(pd.DataFrame(table).columns) == list(table.dtype.names or ())


# ---- memory ---------------------------------------------------------------------------------


def traced(steps, process, **how):
    """Bytes that a run which keeps its last state takes at most."""
    tracemalloc.start()
    sol = so.solve(process, t_end=1.0, steps=steps, save="last", **how)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert sol.success
    return most


def test_memory_does_not_grow_with_the_steps_that_are_not_kept():
    n = 1000
    A, contact = springs(np.ones(n + 1)), sp.eye_array(n, format="csc")[:, CONTACT]
    load = so.Separable([(so.Sine(2.0, 3.0), np.sin(np.arange(n)))])
    C = so.Moving(-so.image(contact, SETS["intervals"]), load)
    this = so.SweepingProcess(A, 1.7 * A, C, np.zeros(n))
    _, few, many = (traced(steps, this, path="eliminated") for steps in (3, 10, 200))
    assert many <= 1.3 * few  # the states of 200 steps take 1.6 MB, 2.4 times as much as few


# ---- damage, and disks that are full ----

FULL = """
import resource
import numpy as np, scipy.sparse as sp, sweepopt as so
load = so.Sine(3.0, 2.0)
slider = so.SweepingProcess(0.5, 2.0, so.Moving(so.Box(-1, 1), load), 0.0)
chain = 2.1 * sp.eye_array(400) - sp.eye_array(400, k=1) - sp.eye_array(400, k=-1)
few = so.image(sp.eye_array(400, 4), so.Box(-np.ones(4), np.ones(4)))
pull = so.Separable([(load, np.sin(np.arange(400)))])
large = so.SweepingProcess(chain, 1.7 * chain, so.Moving(few, pull), np.zeros(400))
for size, process, settings in (
    (30_000, slider, {{"steps": 600}}),
    (100_000, large, {{"steps": 75, "path": "eliminated"}}),
    (10_000, large, {{"steps": 75, "path": "eliminated"}}),
    (4_000, large, {{"steps": 75, "path": "eliminated"}}),  # one state
):
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, 200_000))
    try:
        so.solve(process, t_end=4.0, save={file!r}, **settings)
    except so.SaveError as error:
        whole, sol = so.solve(process, t_end=4.0, **settings), error.solution
        assert "run.nc cannot be written (File too large)" in str(error), error
        assert np.array_equal(sol.u[1:], whole.u[sol.steps + 1])
        print(len(sol.t), len(sol.stats))
    try:
        whole.save({file!r})
    except so.SaveError as error:
        assert "run.nc cannot be written (File too large)" in str(error), error
        assert error.solution is whole
    else:
        assert size > 50_000  # as it is compressed
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no limits of files")
def test_a_full_disk_loses_nothing_that_is_in_memory_and_nothing_crashes(tmp_path):
    done = python(FULL.format(file=str(tmp_path / "run.nc")), check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.split() == ["601", "600", "31", "31", "3", "3", "1", "1"]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_a_run_is_not_lost_with_its_file(error, tmp_path, monkeypatch):
    monkeypatch.setattr("sweepopt.results.dataset._dump", Mock(side_effect=error("as it is")))
    with pytest.raises(
        so.SaveError, match=rf"run.nc .*written \({error.__name__}\('as it is"
    ) as at:
        run("eliminated", save=tmp_path / "run.nc")
    assert np.array_equal(at.value.solution.u, whole_run("eliminated").u)
    assert not list(tmp_path.iterdir())


def test_every_flipped_bit_and_every_cut_of_a_file_is_named(tmp_path):
    file, random = tmp_path / "run.nc", np.random.default_rng(0)
    so.solve(slider(), t_end=4.0, steps=500, save=file)
    content = file.read_bytes()
    damaged = [content[: random.integers(len(content))] for _ in range(20)]
    for _ in range(100):
        flipped = bytearray(content)
        flipped[random.integers(len(content))] ^= 1 << int(random.integers(8))
        damaged.append(bytes(flipped))
    for one in [b"", content[:-1], content[:-100] + bytes(100), content + b"\n", *damaged]:
        file.write_bytes(one)
        with pytest.raises(so.CheckpointError, match=r"run.nc is damaged"):
            so.Solution.load(file)


@pytest.mark.skipif(sys.platform == "win32", reason="no limits of files")
def test_a_disk_without_place_for_the_first_state_is_told_before_the_run(tmp_path):
    text = FULL.format(file=str(tmp_path / "run.nc")).replace("SaveError", "InputError")
    text = text[: text.index("        whole, sol")].replace("30_000", "4")
    done = python(f"{text}        print(error)\n        break\n", check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.endswith("run.nc cannot be written (File too large)\n")
    assert not list(tmp_path.iterdir())


def test_a_checkpoint_that_is_loaded_as_a_solution_is_called_one(tmp_path):
    so.solve(block(so.Sine(2.0, period=4.0)), t_end=1.0, steps=2, checkpoint=tmp_path / "a.npz")
    with pytest.raises(so.DamagedFileError, match=r"a\.npz is .* a checkpoint by so\.resume"):
        so.Solution.load(tmp_path / "a.npz")


def test_every_variable_of_a_file_has_a_checksum(tmp_path):
    """So that other programs read no number that was damaged."""
    file, kept = tmp_path / "run.nc", tmp_path / "kept.nc"
    so.solve(slider(), t_end=2.0, steps=50, save=file)
    so.solve(slider(), t_end=2.0, steps=50).save(kept)
    for path in (file, kept):
        with xr.open_dataset(path, engine="h5netcdf") as dataset:
            assert "solver" in dataset.variables
            assert all(x.encoding["fletcher32"] for x in dataset.variables.values())


# ---- copies ---------------------------------------------------------------------------------

COPIES = (copy.copy, copy.deepcopy, lambda thing: pickle.loads(pickle.dumps(thing)))


@pytest.mark.parametrize("settings", [{}, {"save": 3}, {"scheme": "exact"}], ids=str)
def test_a_copy_of_a_solution_can_do_what_the_solution_can(settings):
    n = 6
    B = sp.diags_array([[2.0] * n, [-1.0] * (n - 1), [-1.0] * (n - 1)], offsets=[0, 1, -1])
    load = so.Separable([(so.Sine(2.0, period=4.0), np.linspace(1.0, 2.0, n))])
    D = so.Box(-np.ones(n), np.ones(n))
    process = so.EvolutionVI(0.5 * sp.eye_array(n), B, load=load, dissipation=D, u0=np.zeros(n))
    sol = so.solve(process, t_end=2.0, steps=4, **settings)
    shown, copies = repr(sol), [copied(sol) for copied in COPIES]
    for same in copies:
        assert repr(same) == shown
        assert not same.t.flags.writeable
        np.testing.assert_array_equal(same.u, sol.u)
        np.testing.assert_array_equal(same(sol.t[-1]), sol(sol.t[-1]))
        np.testing.assert_array_equal(same.viability(), sol.viability())
        again = so.solve(same.process, t_end=2.0, steps=4, **settings)
        np.testing.assert_array_equal(again.u, sol.u)
        assert float(same.error_bound()) == float(sol.error_bound())


def test_a_scene_and_its_run_go_through_pickle():
    scene = so.scene("square")
    same, sol = pickle.loads(pickle.dumps((scene, scene.solve(steps=6))))
    np.testing.assert_array_equal(same.displacement(sol), scene.displacement(scene.solve(steps=6)))


def test_a_file_that_another_program_wrote_again_is_not_loaded(tmp_path):
    file, again = tmp_path / "run.nc", tmp_path / "again.nc"
    so.solve(slider(), t_end=4.0, steps=50, save=file)
    with xr.open_dataset(file, engine="h5netcdf") as dataset:
        dataset.load().assign_attrs(note="mine").to_netcdf(again, engine="h5netcdf")
    with pytest.raises(so.CheckpointError, match=r"again.nc .* read by xarray.open_dataset"):
        so.Solution.load(again)


@pytest.mark.parametrize("again", COPIES)
def test_what_a_failed_step_knows_comes_out_of_another_process_too(again):
    ends = so.StepError("missed", t=0.5, step=3, u=np.ones(2), certificate=1e-3)
    extra = so.MissingExtraError("needs it")
    assert str(again(extra)) == "needs it"
    same = again(ends)
    assert (str(same), same.t, same.step, same.certificate) == ("missed", 0.5, 3, 1e-3)
    assert same.u.tolist() == [1.0, 1.0]
