"""The command line: a scene goes in, a folder of results comes out, errors are one clean line."""

import errno
import json
import os
import re
import signal
import sys
import tempfile
import warnings
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import h5netcdf
import pytest
import tqdm.auto
import xarray as xr
from matplotlib.figure import Figure
from meshes import annulus, write_msh
from PIL import Image
from processes import python

import sweepopt as so
from sweepopt import cli, plot
from sweepopt.driver import finish
from sweepopt.io import list_scenes

SCENE = """
title = "a small ring"
units = "SI"
[domain]
mesh = "ring.msh"
clamped = "inner"
[time]
end = 6.0
steps = 30
[effects.viscosity]
eta = { core = 2.0, sleeve = 1.0 }
[effects.friction]
on = "outer"
g = 0.6
[effects.body_force]
f0 = { along = "x", at = [-2.0, 2.0], values = [0.5, 1.5] }
history = { waveform = "sine", amplitude = 4.0, period = 4.0 }
"""
BARE = SCENE.replace('[effects.friction]\non = "outer"\ng = 0.6\n', "")
OUT = Path("out")
OPTIONAL = ["matplotlib", "xarray", "h5netcdf", "h5py", "skfem", "meshio", "tqdm"]


def make_scene(folder, text=SCENE):
    write_msh(folder / "ring.msh", annulus(2))
    (folder / "ring.toml").write_text(text, encoding="utf-8")
    return folder / "ring.toml"


@pytest.fixture(autouse=True)
def scene(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return make_scene(tmp_path)


def run(*options, picture="", bar=False, files=True):
    """The exit code of a run of the scene into folder out, with at most a picture and a bar.

    Without `files` of states, which take longer than a few steps.
    """
    quiet = [] if bar else ["--no-progress"]
    one = ["--set", f'pictures=["{picture}"]'] if picture else []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sweepopt.fem.pictures.AUTOMATIC", ())  # they take most of the time
        if not files:
            patch.setattr("sweepopt.fem.output.write_dataset", Mock())
            patch.setattr("sweepopt.fem.output.write_vtu", Mock(return_value=[]))
        return cli.main(["run", "ring.toml", "--out", "out", *quiet, *one, *options])


def summary_in(folder=OUT):
    found = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert isinstance(found, dict)
    return found


def solution_in(folder=OUT):
    return xr.load_dataset(folder / "solution.nc", engine="h5netcdf")


# ---- run ------------------------------------------------------------------------------------


def test_run_writes_every_file_and_says_what_it_will_do_and_did(monkeypatch, capsys):
    monkeypatch.setattr("sweepopt.fem.pictures.draw", lambda *_: Figure())
    assert cli.main(["run", "ring.toml"]) == 0
    shown, results = capsys.readouterr(), Path("results/ring")
    for words in (
        "a small ring",
        "0 to 6 s in 30 steps",
        "unknowns",
        "nonsmooth unknowns",
        "left out            no elasticity: B is not formed",
        "scheme              sdirk32",
        "tolerance           1e-06",
        "The run reached t_end and every step is certified within tol.",
        "of the contact slips",
        "J/m = stored 0 + viscous",
        "worst certificate",
        "solution.nc, displacement.png, stress.png, contact.png, vtu/solution.vtu.series, ",
    ):
        assert words in shown.out
    work, stored, spent, rubbed, rest = map(
        float,
        re.search(
            r"work (\S+) J/m = stored (\S+) \+ viscous (\S+) \+ \S+ and \S+ (\S+) J/m; "
            r"balance error (\S+)",
            shown.out,
        ).groups(),
    )
    assert 0 < abs(rest) < 0.1 * work
    assert stored + spent + rubbed == pytest.approx(work + rest, rel=1e-3, abs=0.1 * abs(rest))
    assert "30/30" in shown.err
    summary = summary_in(results)
    assert summary["settings"]["scheme"] == "sdirk32"
    files = summary["files"]
    found = {path.relative_to(results).as_posix() for path in results.rglob("*") if path.is_file()}
    assert found == {*files, "summary.json"}
    assert sum(name.endswith(".vtu") for name in files) == 31
    assert solution_in(results).attrs["scene"] == SCENE


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
def test_of_a_prescribed_displacement_the_energies_that_are_known_are_said(capsys):
    pull = 'effects.prescribed_displacement={ on = "inner", history = { waveform = "sine", '
    pull += "amplitude = 4.0, period = 4.0 } }"
    assert run("--set", pull, files=False) == 0
    (line,) = re.findall("^energy.*", capsys.readouterr().out, re.MULTILINE)
    rubbed = summary_in()["energy"]["friction"]
    words = "J/m; the others are not known where a displacement is prescribed"
    assert line.endswith(f"friction and yielding {rubbed:.4g} {words}")


def test_the_plan_is_printed_before_the_run(monkeypatch, capsys):
    monkeypatch.setattr("sweepopt.cli.finish", Mock(side_effect=KeyboardInterrupt))
    assert run() == 130
    shown = capsys.readouterr().out
    assert "0 to 6 s in 30 steps" in shown
    assert "nonsmooth unknowns" in shown


def test_options_replace_the_scenes_settings_and_no_progress_leaves_stderr_empty(
    capsys,
):
    expected = {"steps": 7, "scheme": "implicit-euler", "solver": "clarabel", "tol": 1e-5}
    options = [word for name, x in expected.items() for word in (f"--{name}", str(x))]
    assert run(*options, files=False) == 0
    assert expected.items() <= summary_in()["settings"].items()
    assert capsys.readouterr().err == ""


def test_a_second_run_replaces_the_first_whole(scene):
    assert run("--steps", "9", picture="contact") == 0
    assert (OUT / "contact.png").stat().st_size > 20_000
    (OUT / "notes.txt").write_text("mine")
    (OUT / "solution.nc").write_text("broken")
    scene.write_text(BARE)
    assert run("--steps", "4") == 0
    summary = summary_in()
    assert (summary["slip"], summary["settings"]["steps"]) == (None, 4)
    assert not (OUT / "contact.png").exists()  # there is no contact any more
    assert len(list((OUT / "vtu").glob("*.vtu"))) == 5
    assert (OUT / "notes.txt").read_text() == "mine"
    assert solution_in().sizes["step"] == 4
    assert not list(OUT.rglob(".*"))


def test_the_error_bound_of_a_run_is_printed_on_request(capsys):
    assert run("--steps", "20", "--bound", files=False) == 0
    *_, last = capsys.readouterr().out.splitlines()
    words = r"error bound +(\S+) \(guaranteed\) in the norm of A, where the largest u has (\S+)"
    bound, size = map(float, re.fullmatch(words, last).groups())
    assert 0 < bound < 0.2 * size


def test_an_animation_is_written_on_request(monkeypatch):
    monkeypatch.setattr(plot, "MOST_FRAMES", 2)
    assert run("--steps", "4", "--animate", files=False) == 0
    assert "displacement.gif" in summary_in()["files"]
    with Image.open("out/displacement.gif") as shown:
        assert shown.n_frames == 2


# ---- a run that does not end well -----------------------------------------------------------


def test_ctrl_c_writes_what_was_computed(monkeypatch, capsys):
    class Bar(tqdm.auto.tqdm):  # type: ignore[type-arg]
        def update(self, n=1):  # the loop calls it after each step
            shown = super().update(n)
            if self.n == 5:
                signal.raise_signal(signal.SIGINT)
            return shown

    monkeypatch.setattr(tqdm.auto, "tqdm", Bar)
    # tests that run in the background of a shell inherit that Ctrl-C is ignored
    signal.signal(signal.SIGINT, signal.default_int_handler)
    assert run(bar=True) == 130
    assert so.Status.INTERRUPTED.value in capsys.readouterr().out
    summary = summary_in()
    assert (summary["status"], summary["success"]) == ("interrupted", False)
    assert summary["settings"]["steps"] == 5
    assert summary["settings"]["t_reached"] == pytest.approx(1.0)
    dataset = solution_in()
    assert (dataset.sizes["step"], dataset.attrs["status"]) == (5, "interrupted")


def test_ctrl_c_while_writing_keeps_the_files_of_the_run_before(monkeypatch, capsys):
    assert run("--steps", "4") == 0
    before = {path: path.read_bytes() for path in OUT.glob("*.*")}
    monkeypatch.setattr(h5netcdf.File, "create_variable", Mock(side_effect=KeyboardInterrupt))
    assert run("--steps", "4") == 130
    assert "interrupted" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in OUT.glob("*.*")} == before


def test_on_a_full_disk_the_results_go_to_a_temporary_folder(monkeypatch, capsys, tmp_path):
    force, other = os.fsync, tmp_path / "other"
    other.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(other))

    def full(handle):
        if "out" in os.readlink(f"/proc/self/fd/{handle}"):
            raise OSError(errno.ENOSPC, "No space left on device")
        force(handle)

    monkeypatch.setattr(os, "fsync", full)
    assert run("--steps", "4") == 1
    assert "out: the results cannot be written there (No space" in capsys.readouterr().err
    (folder,) = other.iterdir()
    assert solution_in(folder).sizes["step"] == 4


@pytest.mark.filterwarnings("always::sweepopt.VariationWarning")
def test_a_warning_of_a_run_is_printed_once(monkeypatch, capsys):
    check = so.SweepingProcess.check

    def jumping(self, times):
        warnings.warn("C(t) jumps by an infinite distance", so.VariationWarning, stacklevel=1)
        return check(self, times)

    calls = Mock(side_effect=jumping)
    monkeypatch.setattr(so.SweepingProcess, "check", lambda self, times: calls(self, times))
    assert run("--scheme", "implicit-euler", "--steps", "7", files=False) == 0
    assert capsys.readouterr().err.count("infinite distance") == 1
    assert calls.call_count == 1


def test_a_run_that_stops_early_writes_its_certified_steps_and_exits_with_1(monkeypatch, capsys):
    def stopped(process, options, run):
        assert options.on_failure == "stop"
        solution = finish(process, replace(options, callback=lambda info: info.step == 3), run)
        return replace(solution, status=so.Status.INEXACT)

    monkeypatch.setattr("sweepopt.cli.finish", stopped)
    assert run(files=False) == 1
    assert "missed tol" in capsys.readouterr().out
    summary = summary_in()
    assert (summary["success"], summary["settings"]["steps"]) == (False, 4)


def test_a_run_without_a_single_step_writes_nothing_and_says_so(scene, capsys):
    scene.write_text(BARE)
    # no solver reaches this: rounding alone is larger, once the body moves
    assert run("--tol", "1e-30") == 1
    assert "nothing is written" in capsys.readouterr().err
    assert not list(OUT.iterdir())


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["nowhere"], "'nowhere' is neither a scene file nor a problem; there are: "),
        (["nowhere.toml"], "nowhere.toml: cannot be read"),
        (["ring.toml", "--scheme", "leapfrog"], "scheme 'leapfrog' is not known"),
        (["ring.toml", "--solver", "magic"], "solver 'magic' is not known"),
        (["ring.toml", "--steps", "0"], "steps must be a positive whole number"),
        (["ring.toml", "--tol", "-1"], "tol must be > 0"),
        (["ring.toml", "--out", "ring.msh"], "--out is 'ring.msh', where no folder can be"),
        (["bad.toml"], "sweepopt: bad.toml: effects.friction.g must be >= 0"),
        (["ring.toml", "--set", "time.end=0"], "sweepopt: ring.toml: time.end must be > 0"),
        (["pipe", "--set", "solve.scheme=rk4"], "pipe.toml: solve.scheme 'rk4' is not known; use"),
        (["ring.toml", "--set", "effects.friction.g=2 * x"], "of text a shell takes quotes away"),
        (["no.toml"], "is not TOML"),
        (["ring.toml", "--path", "cone"], "path must be one of auto, proportional, eliminated"),
    ],
)
def test_bad_arguments_and_scenes_give_one_clean_line(arguments, words, capsys):
    Path("bad.toml").write_text(SCENE.replace("g = 0.6", "g = -1.0"))
    Path("no.toml").write_text(SCENE.replace("[time]", "[time"))
    assert cli.main(["run", *arguments, "--no-progress"]) == 2
    shown = capsys.readouterr().err
    assert words in shown
    assert shown.startswith("sweepopt: ")
    assert shown.count("\n") == 1


@pytest.mark.parametrize("arguments, words", [
    (["run", "pipe", "--bounds"], "unrecognized argument --bounds; did you mean --bound?"),
    (
        ["rum", "pipe"],
        "there is no command rum, but list, run, effects, study, compare; did you mean run?",
    ),
    (
        ["effects", "pipe", "--scheme", "exact"],
        "unrecognized argument --scheme; there are: --set, --steps, --without",
    ),
    (["--bound", "run", "pipe"], "unrecognized argument --bound; put it after the command"),
    (["list", "--long"], "unrecognized argument --long; there are: none"),
    (
        ["run", "pipe", "tube"],
        "unrecognized argument tube; give one SCENE or STUDY, and words with blanks in quotes: "
        "--set 'PATH=a b'",
    ),
])  # fmt: skip
def test_an_option_that_is_not_known_is_named_with_the_nearest_one(arguments, words, capsys):
    with pytest.raises(SystemExit):
        cli.main(arguments)
    assert capsys.readouterr().err.endswith(f"error: {words}\n")


def test_an_unstable_step_is_refused_with_advice_that_the_command_line_can_follow(scene, capsys):
    scene.write_text(SCENE + "[effects.elasticity]\nkappa = 90.0\n")
    assert run("--scheme", "catching-up") == 2
    shown = capsys.readouterr().err
    assert "'catching-up' amplifies errors: step * Lam = " in shown
    assert shown.endswith(
        "which needs no such step and never overshoots; use --steps or --scheme\n"
    )
    assert shown.count("\n") == 1


def test_our_warnings_are_one_line_without_a_source_file(scene, capsys):
    # a load that is there at t = 0 starts with a velocity
    constant = 'waveform = "constant", value = 9.0'
    scene.write_text(SCENE.replace('waveform = "sine", amplitude = 4.0, period = 4.0', constant))
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        assert run("--steps", "2", files=False) == 0
    shown = capsys.readouterr().err
    assert shown.startswith("sweepopt: warning: f(0) - B u0 is not in the dissipation set")
    assert shown.count("\n") == 1


@pytest.mark.parametrize("command", ["run tub", "effects tub", "compare tub", "study mes"])
def test_a_wrong_name_is_told_before_a_missing_package(command, monkeypatch, capsys):
    for package in ("skfem", "matplotlib", "sweepopt.study"):
        monkeypatch.setitem(sys.modules, package, None)
    assert cli.main(command.split()) == 2
    assert "did you mean " in capsys.readouterr().err


def test_workers_of_a_study_are_counted_before_it_starts(capsys):
    assert cli.main(["study", "hard", "--workers", "0"]) == 2
    assert "--workers must be a positive whole number, got 0" in capsys.readouterr().err


DISCS = """
[domain]
mesh = { sizes = [1.0, 1.0], cells = [2, 2] }
kind = "plane stress"
clamped = []
[time]
end = 1.0
steps = 3
[effects.dashpot]
on = "body"
eta = 1.0
[[effects.friction]]
on = "body"
g = 0.3
[[effects.friction]]
on = "body"
g = 0.2
history = { waveform = "sine", amplitude = 0.5, period = 1.0, offset = 1.0 }
[effects.body_force]
f0 = [1.0, 0.5]
history = { waveform = "sine", amplitude = 1.0, period = 1.0 }
"""


def test_a_bound_that_a_path_does_not_have_is_refused_before_the_run(scene, capsys):
    scene.write_text(DISCS)
    assert run("--path", "cones", "--bound") == 2
    assert capsys.readouterr().err.endswith("or take path='full'\n")


@pytest.mark.parametrize(
    "package, extra",
    [("matplotlib", "plot"), ("h5py", "fem"), ("h5netcdf", "fem")],
)
def test_a_missing_package_is_named_before_the_run(package, extra, monkeypatch, capsys):
    for name in [package, *(one for one in sys.modules if one.startswith(f"{package}."))]:
        monkeypatch.setitem(sys.modules, name, None)
    assert cli.main(["run", "ring.toml"]) == 2
    said = f'sweepopt: {package} is not installed; run: pip install "sweepopt[{extra}]"\n'
    assert capsys.readouterr() == ("", said)


# ---- list -----------------------------------------------------------------------------------


def test_files_and_costs_of_effects_need_neither_pandas_nor_xarray():
    code = (
        "import sys; sys.modules.update(pandas=None, xarray=None)\n"
        "import sweepopt as so; from sweepopt.cli import main\n"
        "main(['effects', 'ring.toml', '--steps', '4'])\n"
        "sol = so.scene('ring.toml').solve(steps=4)\n"
        "sol.save('run.nc'); print((so.Solution.load('run.nc').u == sol.u).all())\n"
        "try: sol.to_xarray()\n"
        "except so.MissingExtraError as error: print(error)"
    )
    head, *rows, same, refused = python("-W", "error", "-c", code).stdout.splitlines()
    assert head.split()[:2] == ["unknowns", "nonsmooth_unknowns"]
    assert len({len(line) for line in (head, *rows)}) == 1
    assert [row.split()[0] for row in rows] == ["all", "without", "without"]
    assert (same, refused[:25]) == ("True", "xarray is not installed; ")
    assert refused.endswith('"sweepopt[study]"')


@pytest.mark.skipif(sys.platform == "win32", reason="no pipe of POSIX")
def test_a_reader_that_has_enough_of_the_list_ends_it_without_a_word(monkeypatch, capsys):
    there, here = os.pipe()
    os.close(there)
    with open(here, "w") as output:  # at its end, as at Python's, what is left is written
        monkeypatch.setattr(sys, "stdout", output)
        assert cli.main(["list"]) == 0
    assert capsys.readouterr().err == ""


def test_list_works_with_the_core_install_alone_and_without_a_warning():
    code = (
        f"import sys; sys.modules.update(dict.fromkeys({OPTIONAL}))\n"
        "from sweepopt.cli import main\n"
        "code = main(['list']); run = main(['run', 'tube']); print(code, run)"
    )
    shown = python("-W", "error", "-c", code)
    *lines, codes = shown.stdout.splitlines()
    problems = [[name, title] for name, title in list_scenes().items()]
    assert [line.split(maxsplit=1) for line in lines[::2]] == problems
    assert all(line.split()[0] == "effects:" for line in lines[1::2])
    assert "tube" in list_scenes()
    assert codes == "0 2"
    assert shown.stderr.startswith("sweepopt: ")
    assert shown.stderr.endswith('pip install "sweepopt[fem]"\n')
