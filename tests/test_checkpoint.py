"""A run that is killed loses nothing: resumed, it is the same to the last bit."""

import errno
import io
import json
import os
import pickle
import random
import sys
import time
import warnings
import zipfile
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import scipy.sparse as sp
from cases import SQUARE, block, isotropic, refuses, slow
from processes import started
from test_reduction import process as chain

import sweepopt as so
from sweepopt.integrate.checkpoint import differences, fingerprint

HERE = Path(__file__).parent


def body(**changes):
    return chain(**{"u0": np.zeros(40), **changes})


def balls(load=1.5):
    """Four contact points that slip in two directions, on unknowns of their own."""
    A, B = 2 * np.eye(8) - 0.3 * (np.eye(8, k=1) + np.eye(8, k=-1)), np.diag(np.arange(1.0, 9.0))
    f = so.Separable([(so.Sine(load, 2.0), np.ones(8)), (so.Triangle(load, 3.0), np.arange(8.0))])
    return so.SweepingProcess(A, B, so.Moving(so.Balls([0.5, 1.0, 1.5, 0.0], 2), f), np.zeros(8))


def polygon():
    """Rows that are given by a function, at A = 0."""
    G = np.array([[1.0, 0.2], [-1.0, 0.1], [0.3, 1.0], [-0.2, -1.0]])
    C = so.Polyhedron(G, lambda t: [1 + t, 0.5 - 2 * t, 1 + np.sin(t), 0.5 - t])
    return so.SweepingProcess(np.zeros((2, 2)), [[2.0, 0.5], [0.5, 1.0]], C, [0.0, 0.0])


def free():
    """Nothing nonsmooth, and no proof: a set of the user's."""
    import cvxpy as cp

    C = so.Moving(so.Constraints(2, lambda w: [cp.norm(w) <= 1]), center=lambda t: [2 * t, t])
    return isotropic(C, 1.0, 1.0)


def pipe():
    """A body whose plastic strains are condensed."""
    from test_return_mapping import pipe  # fem, which a process that is killed need not import

    return pipe(1).problem


def stiff(k):
    """Two blocks tied by a spring k, which move as one: A is lost in A + mu B for mu k > 1e15."""
    B = k * np.array([[1.0, -1.0], [-1.0, 1.0]])
    C = so.Moving(SQUARE, so.Separable([(so.Sine(3.0, 6.0), [1.0, 1.0])]))
    return so.SweepingProcess(np.eye(2), B, C, [0.0, 0.0])


MANY_SIZES = np.array([*range(16), 0, 16, 0, 17, 1, 0, 18, 1, 19, *range(20)])
RUNS = {
    "proportional": (body, {"path": "proportional"}),
    "eliminated": (body, {"path": "eliminated", "solver": so.OSQP(tol=1e-7), "save": 5}),
    "full": (body, {"path": "full", "solver": "osqp"}),
    "newton": (body, {"path": "eliminated", "solver": "newton", "save": "last"}),
    "two stages": (body, {"scheme": "sdirk2", "solver": "clarabel", "save": [1.0, 2.0]}),
    "balls": (balls, {"solver": "clarabel"}),
    "polygon": (polygon, {"solver": "osqp", "t_end": 0.3, "steps": 15}),
    "uncertified": (free, {"steps": 3}),
    "set that is a function": (
        lambda: isotropic(so.MovingSet(lambda t: so.Box(t, 3.0)), 0.5, 2.0),
        {"t_end": 2.0},
    ),
    "times of the user": (
        lambda: block(lambda t: [3 * np.sin(4 * t)]),
        {"steps": np.linspace(0.0, 2.0, 21) ** 2, "t_end": None},
    ),
    # the last bit of u is a force of 1: it overshoots, in parts
    "steps in parts": (
        lambda: stiff(4e15),
        {"t_end": 3.0, "steps": 3, "scheme": "midpoint", "solver": "osqp"}
        | {"on_unstable": "ignore"},
    ),
    # more sizes than matrices are kept: which are dropped must not depend on where a run began
    "many step sizes": (
        body,
        {"steps": np.append(0.0, np.cumsum(0.02 + 0.001 * MANY_SIZES)), "path": "eliminated"}
        | {"solver": so.OSQP(tol=1e-4), "tol": 1e-3, "t_end": None},
    ),
    "return mapping": (
        pipe,
        {"path": "return mapping", "scheme": "implicit-euler", "t_end": 3.0, "steps": 15},
    ),
}


@cache
def finished(name):
    """The process of that name, its arguments and its run, which nothing has killed."""
    process, settings = arguments(name)
    with TemporaryDirectory() as folder:
        where = so.Checkpoint(Path(folder) / "a", steps=between(name))
        return process, settings, so.solve(process, checkpoint=where, **settings)


def arguments(name):
    make, settings = RUNS[name]
    return make(), {"t_end": 2.0, "steps": 20, **settings}


def between(name):
    """How many steps are between two files: few where each takes long."""
    return 1 if name in ("uncertified", "steps in parts") else 4


def same(a, b):
    """Equal to the last bit, but for wall times."""
    names = [name for name in a.stats.dtype.names or () if name != "seconds"]
    return (
        a.status is b.status
        and a.t.tobytes() == b.t.tobytes()
        and a.u.tobytes() == b.u.tobytes()
        and a.velocity.tobytes() == b.velocity.tobytes()
        and all(a.stats[name].tobytes() == b.stats[name].tobytes() for name in names)
    )


class Killed(Exception):
    """Stands for a kill where a real one would take long."""


def stopping(step):
    def stop(info):
        if info.step == step:
            raise Killed

    return stop


def killed(path, name="proportional", at=18, **changes):
    process, settings = arguments(name)
    where = so.Checkpoint(path, steps=between(name))
    with pytest.raises(Killed):
        so.solve(process, checkpoint=where, callback=stopping(at), **(settings | changes))


# ---- the same to the last bit ---------------------------------------------------------------


@pytest.mark.parametrize("name", RUNS)
def test_a_resumed_run_is_the_whole_run(name, tmp_path):
    process, settings, whole = finished(name)
    every = between(name)
    never = so.Checkpoint(tmp_path / "never", steps=every, seconds=1e6)
    assert name != "full" or same(so.solve(process, checkpoint=never, **settings), whole)
    assert whole.velocity.any()
    path = tmp_path / "b.npz"
    killed(path, name, 0)
    for at in (every - 1, every + 1):  # again and again
        with pytest.raises(Killed):
            so.resume(path, arguments(name)[0], callback=stopping(at))
    resumed = so.resume(path, arguments(name)[0])
    assert same(resumed, whole)
    assert np.array_equal(resumed.plan.solvers, whole.plan.solvers)
    assert same(so.resume(path, process), whole)  # the end is in the file too


def test_what_a_function_recorded_comes_back(tmp_path):
    def record(t, u, z):
        return {
            "t": t,
            "u": u[3],
            "rows": u[:4].reshape(2, 2),
            "z": (z[4] > 0, [1, True, "word", None]),
        }

    process, settings = arguments("proportional")
    whole = so.solve(process, save=record, **settings)
    path = tmp_path / "run.npz"
    killed(path, save=record)
    with refuses("needs function"):
        so.resume(path, process)
    resumed = so.resume(path, process, save=record)
    assert repr(resumed.recorded) == repr(whole.recorded)
    assert len(resumed.recorded or []) == 20


@pytest.mark.parametrize(
    "bad",
    [object(), 2**70, {1: 2.0}, np.array(["a"])],
    ids=["object", "integer", "dict", "array of text"],
)
def test_records_that_no_file_can_hold_are_refused_at_the_first_step(bad, tmp_path):
    process, settings = arguments("proportional")
    where, seen = so.Checkpoint(tmp_path / "run.npz", steps=50), []
    with refuses("numbers or arrays"):
        so.solve(
            process,
            checkpoint=where,
            save=lambda t, u, z: bad,
            callback=lambda info: seen.append(info.step),
            **settings,
        )
    assert seen == [0]


# ---- kill -9 --------------------------------------------------------------------------------

CHILD = """
import sys
sys.path.insert(0, {tests!r})
import test_checkpoint, sweepopt as so
process, settings = test_checkpoint.arguments({name!r})
settings["steps"] = {steps}
so.solve(process, checkpoint=so.Checkpoint({path!r}, steps=5), **settings)
"""


@pytest.mark.parametrize(
    "name, times, steps, alive", [("full", 1, 100, 1), slow("proportional", 25, 1200, 15)]
)
def test_a_run_that_is_killed_loses_nothing(name, times, steps, alive, tmp_path):
    """The first one at its first checkpoint, while another run on its name is refused."""
    process, settings = arguments(name)
    settings["steps"], moments = steps, random.Random(1)
    whole = so.solve(process, checkpoint=so.Checkpoint(tmp_path / "a", steps=5), **settings)
    for k in range(times):
        path = tmp_path / f"{name}-{k}.npz"
        code = CHILD.format(tests=str(HERE), name=name, path=str(path), steps=steps)
        with started(path.exists, "-c", code) as child:
            if k:
                time.sleep(moments.uniform(0.0, 1.2))
            else:
                for again in (so.resume, partial(so.solve, checkpoint=path, **settings)):
                    with refuses(r"npz is being written by another run"):
                        again(*(path, process)[again is not so.resume :])
        alive -= child.returncode != 0
        assert same(so.resume(path, process), whole), f"{name}, killed at moment {k}"
    assert alive <= 0


# ---- another problem, another form ----------------------------------------------------------


def test_a_checkpoint_of_another_problem_is_refused_and_says_what_differs(tmp_path):
    path = tmp_path / "run.npz"
    killed(path, "balls")
    ours = balls()
    A, B, C, u0 = ours.A, ours.B, ours.C, ours.u0
    others = [
        (so.SweepingProcess(2 * A, B, C, u0), "another problem: A differs"),
        (so.SweepingProcess(A, None, C, u0 + 0.01), "another problem: B, u0 differ"),
        (balls(load=1.5 + 1e-15), r"another problem: C\(t\) differs"),
        (body(), "another problem: A, B, u0, C"),
        ("balls", "process must be"),
    ]
    for other, message in others:
        with refuses(message):
            so.resume(path, other)
    with refuses("had no function"):
        so.resume(path, ours, save=lambda t, u, z: t)
    assert so.resume(path, ours).success


def test_sums_of_other_sets_are_another_problem():
    def process(radius, falls):
        one = so.Moving(so.Ball([0.0, 0.0], 1.0), scale=so.Sine(0.3, 1.0, offset=1.0))
        scale = so.Table([0.0, 1.0], [1.0, falls])
        two = so.Moving(so.Ellipsoid([0.0, 0.0], [[radius, 0.0], [0.0, 1.0]]), scale=scale)
        return so.SweepingProcess(np.eye(2), np.eye(2), one + two, [0.0, 0.0])

    times = np.linspace(0.0, 1.0, 11)
    began = fingerprint(process(0.5, 0.7), times)
    assert differences(began, process(0.5, 0.7), times) == []
    for other in (process(0.6, 0.7), process(0.5, 0.8)):
        assert differences(began, other, times) == ["C(t)"]


def test_a_load_that_differs_late_or_between_the_times_that_are_compared_is_another_problem(
    tmp_path,
):
    def spiked(spike):
        times = [0.0, 0.50001, 0.50002, 0.50003, 4.0]
        return so.Table(times, [0.0, 1.0, spike, 1.0, 2.0])

    loads = [
        lambda late: lambda t: [t if t < 3.9 else late],
        spiked,
    ]
    for k, load in enumerate(loads):
        path = tmp_path / f"{k}.npz"
        how = {"t_end": 4.0, "steps": 80, "callback": stopping(5)}
        with pytest.raises(Killed):
            so.solve(block(load(3.0)), checkpoint=path, **how)
        with refuses(r"C\(t\) differs"):
            so.resume(path, block(load(3.1)))
        assert so.resume(path, block(load(3.0))).success


def content_of(path):
    """A checkpoint is a plain .npz with a record in JSON."""
    arrays = dict(np.load(path))
    return json.loads(arrays.pop("record").tobytes()), arrays


def rewritten(path, change):
    record, arrays = content_of(path)
    change(record, arrays)
    with path.open("wb") as file:
        np.savez(file, **{"record": np.frombuffer(json.dumps(record).encode(), np.uint8), **arrays})


def test_another_form_other_versions_and_states_that_do_not_fit_are_noticed(
    tmp_path,
):
    path = tmp_path / "run.npz"
    killed(path)
    rewritten(path, lambda record, _: record["versions"].update(numpy="1.0"))
    with pytest.warns(so.CheckpointWarning, match=r"numpy 1\.0 -> ") as told:
        so.resume(path, body())
    assert told[0].filename == __file__
    rewritten(path, lambda record, _: record["versions"].update(numpy=np.__version__))
    rewritten(path, lambda record, _: record.update(plan="another"))
    with refuses("planned differently"):
        so.resume(path, body())
    rewritten(path, lambda record, _: record.update(schema=99))
    with refuses("form 99"):
        so.resume(path, body())
    killed(tmp_path / "b.npz")
    rewritten(tmp_path / "b.npz", lambda _, arrays: arrays.update(nodes=np.zeros((3, 2))))
    with pytest.raises(so.CheckpointError, match="does not fit"):
        so.resume(tmp_path / "b.npz", body())


# ---- damage ---------------------------------------------------------------------------------


def flipped(content, bit):
    changed = bytearray(content)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def test_300_bit_flips_are_detected_or_harmless(tmp_path):
    path, process = tmp_path / "run.npz", body()
    whole = so.solve(process, t_end=4.0, steps=30, checkpoint=path, save=5)
    content, rng = path.read_bytes(), random.Random(7)
    (tmp_path / "run.npz.previous").unlink(missing_ok=True)
    detected = 0
    for _ in range(300):
        path.write_bytes(flipped(content, rng.randrange(8 * len(content))))
        try:
            assert same(so.resume(path, process), whole)
        except so.CheckpointError:
            detected += 1
    assert detected > 250


@pytest.mark.parametrize("share", [0.0, 0.999])
def test_a_damaged_checkpoint_gives_way_to_the_one_before_it(share, tmp_path):
    process, settings, whole = finished("full")
    path = tmp_path / "run.npz"
    killed(path, "full")
    (tmp_path / ".run.123.part.npz").write_bytes(b"of a run that was killed while it wrote")
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with refuses("resume looks"):
        so.solve(process, checkpoint=path, **settings)
    with pytest.warns(so.CheckpointWarning, match="damaged.*before it, after step 12") as warned:
        assert same(so.resume(path, process), whole)
    assert warned[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert same(so.resume(path, process), whole)  # it was replaced by a whole one
    assert [file.name for file in tmp_path.glob("*run*")] == ["run.npz"]  # as the run is done
    path.rename(tmp_path / "run.npz.previous")  # as a kill between the two renamings leaves it
    assert same(so.resume(path, process), whole)


def test_two_damaged_files_are_an_error_and_none_is_one(tmp_path):
    path = tmp_path / "run.npz"
    with refuses("there is no checkpoint"):
        so.resume(path, body())
    killed(path)
    for file in (path, tmp_path / "run.npz.previous"):
        file.write_bytes(flipped(file.read_bytes(), 8 * 3000))
    with pytest.raises(so.CheckpointError, match="is damaged"):
        so.resume(path, body())


@pytest.mark.parametrize(
    "record",
    [np.array([{"schema": 4}], dtype=object), np.frombuffer(b'{"run": 3}', np.uint8)],
    ids=["pickle", "another file"],
)
def test_no_pickle_and_no_other_file_is_read(record, tmp_path, monkeypatch):
    path = tmp_path / "run.npz"
    np.savez(path, record=record)
    monkeypatch.setattr(pickle, "load", lambda *_, **__: pytest.fail("it was unpickled"))
    with pytest.raises(so.CheckpointError):
        so.resume(path, body())


def test_a_solution_is_no_checkpoint_and_the_error_says_what_reads_it(tmp_path):
    so.solve(body(), t_end=0.1, steps=2, save=str(tmp_path / "run.nc"))
    with pytest.raises(so.CheckpointError, match=r"no checkpoint; .* so\.Solution\.load"):
        so.resume(tmp_path / "run.nc", body())


def test_a_file_cannot_ask_for_more_memory_than_it_has_bytes(tmp_path):
    path = tmp_path / "run.npz"
    killed(path)
    (tmp_path / "run.npz.previous").unlink()
    arrays = dict(np.load(path))
    np.savez_compressed(path, **arrays)
    with pytest.raises(so.CheckpointError, match="compressed"):
        so.resume(path, body())
    for size in (10**15, 2**62):
        header = io.BytesIO()
        about = {"descr": "<f8", "fortran_order": False, "shape": (size,)}
        np.lib.format.write_array_header_1_0(header, about)
        np.savez(path, **{name: array for name, array in arrays.items() if name != "last"})
        with zipfile.ZipFile(path, "a") as file:
            file.writestr("last.npy", header.getvalue())
        with pytest.raises(so.CheckpointError, match="damaged"):
            so.resume(path, body())


# ---- a full disk ----------------------------------------------------------------------------


def test_a_full_disk_leaves_the_old_checkpoint_and_says_so(tmp_path, monkeypatch):
    process, settings, whole = finished("full")
    folder = tmp_path / "disk"
    folder.mkdir()
    path, force, steps = folder / "run.npz", os.fsync, [0]

    def full(handle):
        if steps[-1] > 13:
            raise OSError(errno.ENOSPC, "No space left on device")
        force(handle)

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(so.CheckpointError, match=r"after step 16 .*No space left.*is whole"):
        so.solve(
            process,
            checkpoint=so.Checkpoint(path, steps=4),
            callback=lambda info: steps.append(info.step) or None,
            **settings,
        )
    monkeypatch.undo()
    assert sorted(file.name for file in folder.iterdir()) == ["run.npz", "run.npz.previous"]
    assert content_of(path)[0]["run"]["done"] == 12
    assert same(so.resume(path, process), whole)


# ---- what is refused ------------------------------------------------------------------------


def continued(**changes):
    """A run with a checkpoint, which leaves no file where it is refused; for data/refused.txt."""
    with TemporaryDirectory() as place:
        given = {"t_end": 4.0, "steps": 80, "checkpoint": Path(place) / "run.npz", **changes}
        try:
            so.solve(body(), **given)
        finally:
            assert not list(Path(place).iterdir())


def test_a_run_that_is_not_finished_is_not_overwritten(tmp_path):
    path = tmp_path / "run.npz"
    killed(path)
    with refuses("has done 16 of 20 steps; continue it"):
        so.solve(body(), t_end=2.0, steps=20, checkpoint=path)
    so.resume(path, body())
    assert so.solve(body(), t_end=1.0, steps=20, checkpoint=path).success


def test_a_run_that_lacks_a_package_leaves_no_checkpoint(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "tqdm.auto", None)
    with pytest.raises(so.MissingExtraError, match="tqdm"):
        so.solve(body(), t_end=1.0, steps=10, checkpoint=tmp_path / "run.npz", progress=True)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["run.npz", "run.npz.previous"])
def test_a_file_that_cannot_be_read_is_named(name, tmp_path, monkeypatch):
    path, process = tmp_path / "run.npz", body()
    so.solve(process, t_end=1.0, steps=12, checkpoint=so.Checkpoint(path, steps=3))
    if name != path.name:
        path.unlink()
    plain = Path.open

    def refusing(file, *how, **more):
        if file.name == name:
            raise PermissionError(errno.EACCES, "Permission denied")
        return plain(file, *how, **more)

    monkeypatch.setattr(Path, "open", refusing)
    refused = f"{name} cannot be read .Permission denied"
    with refuses(refused):
        so.resume(path, process)
    with refuses(refused):
        so.solve(process, t_end=1.0, steps=12, checkpoint=path)


# ---- two runs, and files that are none ------------------------------------------------------


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes")
def test_devices_and_pipes_are_refused_before_anything_runs(tmp_path):
    from sweepopt.fem import read_mesh

    process, settings = arguments("full")
    pipe = tmp_path / "pipe.msh"
    os.mkfifo(pipe)
    for path in (pipe, Path("/dev/zero")):
        with refuses(f"{path.name}: cannot be read .no regular file"):
            so.Table.from_csv(path, "f")
        with refuses(f"{path.name}.*no regular file"):
            read_mesh(path)
    for path in (pipe, Path("/dev/full")):
        with refuses(r"checkpoint is .* which is no regular file"):
            so.solve(process, checkpoint=path, **settings)
        with refuses("path is .*, which is no regular file"):
            so.resume(path, process)


def test_a_checkpoint_that_can_have_no_lock_is_refused_by_name(tmp_path):
    process = isotropic(so.Box(-1, 1))
    with pytest.raises(so.CheckpointError, match=r"no file can be made beside .*shorter name"):
        so.solve(process, t_end=1.0, steps=3, checkpoint=tmp_path / ("a" * 248 + ".npz"))


def test_files_of_sparse_problems_are_told_by_the_same_hashes_as_ever():
    # matrices were kept by columns once; those of files from then shall be known again
    eye = sp.eye_array(2)
    C = so.Polyhedron(sp.vstack([eye, -eye]), np.ones(4))
    hashes = fingerprint(so.SweepingProcess(eye, eye, C, [0.0, 0.0]), np.array([0.0, 1.0]))
    expected = {"A": "209369404f28c7f2", "B": "209369404f28c7f2", "C(t)": "0b2481eed42e2a4c"}
    assert {name: hashes[name][:16] for name in expected} == expected
