"""What must hold while the inside changes: the public face and its numbers, beside golden files.

A deliberate change is written down by ``python tests/test_golden.py --write [NAME ...]`` (from the
top of the tree, with the library importable) and reviewed as the difference of `tests/golden`.
Only the public face is used here, so that the files outlive any change behind it.
"""

import builtins
import contextlib
import inspect
import io
import json
import os
import re
import sys
import tempfile
import tomllib
import warnings
from copy import deepcopy
from functools import reduce
from operator import getitem
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from meshes import annulus, write_msh

import sweepopt as so
from sweepopt import fem
from sweepopt.cli import main

GOLDEN = Path(__file__).parent / "golden"


# ---- signatures ---------------------------------------------------------------------------------

HISTORY = "breakpoints variation __call__"
MEMBERS = {
    "ConvexSet": "support project contains epigraph features derivative polar "
    "__add__ __sub__ __rsub__ __rmul__ __neg__ __and__",
    "Moving": "at",
    "MovingSet": "at",
    "SweepingProcess": "as_sweeping as_vi Lam beta",
    "EvolutionVI": "as_sweeping",
    "Solution": "process plan t steps status recorded exact passes u velocity stats success "
    "message complete __call__ viability residual error_bound energy plot animate to_xarray save "
    "load step_program",
    "Plan": "unknowns nonsmooth_unknowns solver scheme tol left_out path",
    "Energy": "stored viscous friction work balance",
    "Pass": "steps error seconds",
    "StepInfo": "step t u velocity certificate",
    "StepProgram": "problem z M Bu C certify",
    "Scene": "problem discretisation contact effects left_out t_end steps scheme solver tol units "
    "title solve plot animate write",
    **dict.fromkeys(("Constant", "Polynomial", "Separable", "Sine", "Triangle"), HISTORY),
    "Table": f"{HISTORY} from_csv",
}
"""What users may call or read of a class; other members are between the rooms of the library."""
NOT_CALLED = (
    *("Solution", "Plan", "ErrorBound", "Energy", "StepInfo", "Pass", "Scene", "StepProgram"),
    *("Contact", "Contribution", "Discretisation", "Effect"),
)
"""Classes of which users are handed instances."""


def signature(function):
    """Names, kinds and defaults of the arguments, without annotations."""
    given = inspect.signature(function)
    bare = [p.replace(annotation=inspect.Parameter.empty) for p in given.parameters.values()]
    text = str(given.replace(parameters=bare, return_annotation=inspect.Signature.empty))
    return re.sub(r" at 0x[0-9a-f]+", "", text)


def described(name, thing):
    """Call and members of something public; of a set only what differs from any other set."""
    if not isinstance(thing, type):
        return {"": signature(thing) if callable(thing) else "data"}
    if issubclass(thing, BaseException):
        bases = [base.__name__ for base in thing.__mro__[1:]]
        public = [base for base in bases if base in so.__all__ or hasattr(builtins, base)]
        return {"": " < ".join(public[: public.index("Exception")] or ["Exception"])}
    if thing is so.Status:
        return {status.name: status.value for status in so.Status}
    found = {"": "class" if name in NOT_CALLED else signature(thing)}
    fields = {*getattr(thing, "__dataclass_fields__", ()), *getattr(thing, "_fields", ())}
    is_set = issubclass(thing, so.ConvexSet)
    for member in MEMBERS.get("ConvexSet" if is_set else name, "").split():
        value = None if member in fields else getattr(thing, member)
        how = signature(value) if callable(value) else "attribute"
        if thing is so.ConvexSet or not is_set or how != signature(getattr(so.ConvexSet, member)):
            found[member] = how
    return found


def api():
    """Names of the library and of `sweepopt.fem`, how they are called, statuses and exceptions."""
    found = {
        module.__name__: {
            name: described(name, getattr(module, name)) for name in sorted(module.__all__)
        }
        for module in (so, fem)
    }
    center = so.Separable([(so.Sine(3.0, period=np.pi), 1.0)])
    process = so.SweepingProcess(0.5, 2.0, so.Moving(so.Box(-1, 1), center), 0.0)
    solution = so.solve(process, t_end=2.0, steps=20)
    found["stats"] = " ".join(solution.stats.dtype.names or ())
    found["error_bound"] = " ".join(sorted(vars(solution.error_bound())))
    return found


# ---- command line and files ---------------------------------------------------------------------


def called(*arguments):
    """Exit code and all that a command says."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            code = main(arguments)
        except SystemExit as error:
            code = int(error.code or 0)
    return code, said.getvalue()


def cli():
    """Usage of each command."""
    found = {}
    with mock.patch.dict(os.environ, COLUMNS="2000", NO_COLOR="1"):
        for command in ("run", "list", "effects", "study", "compare"):
            usage = called(command, "--help")[1].partition("\n\n")[0]
            found[command] = " ".join(usage.split())
    return found


SCENE_TEXT = """
title = "a ring"
units = "SI"
domain = { mesh = "ring.msh", clamped = ["inner"], element = "P2" }
time = { end = 2.0, steps = 8 }
solve = { scheme = "implicit-euler", solver = "osqp", tol = 1e-5 }
[effects]
viscosity = { eta = { core = 1.0, sleeve = 0.2 } }
elasticity = { kappa = { along = "radius", at = [0.9, 2.1], values = [1.0, 3.0] } }
friction = { on = "outer", g = 0.3 }
body_force = { f0 = 2.0, history = { table = { t = [0, 2], values = [0, 1] } } }
[[effects.traction]]
on = "outer"
history = { csv = "f.csv", column = "f", time = "t", scale = 2.0 }
[[effects.traction]]
on = "outer"
f2 = 2.0
history = { waveform = "sine", amplitude = 1.0, period = 4.0, phase = 0.1, offset = 0.2 }
[[effects.traction]]
on = "outer"
history = { waveform = "triangle", amplitude = 1.0, period = 4.0 }
[[effects.traction]]
on = "outer"
history = { waveform = "constant", value = 1.0 }
"""
SCENE = tomllib.loads(SCENE_TEXT)
STUDY = """
problems = ["S03"]
schemes = ["midpoint"]
solvers = ["auto"]
steps = [10]
tols = [1e-6]
repeats = 1
title = "one cell"
"""


def tables(data, path=()):
    """Paths of all tables of a file."""
    if isinstance(data, dict):
        yield path
    for key, value in data.items() if isinstance(data, dict) else enumerate(data):
        if isinstance(value, (dict, list)):
            yield from tables(value, (*path, key))


def keys():
    """What a scene with each key is read as, and how each table refuses an unknown key."""
    refused = {}
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        write_msh(folder / "ring.msh", annulus(1))
        (folder / "f.csv").write_text("t,f\n0,0\n2,1\n")
        scene = fem.read_scene(SCENE, folder=folder)
        for path in tables(SCENE):
            changed = deepcopy(SCENE)
            reduce(getitem, path, changed)["nonsense"] = 1.0
            with pytest.raises(so.InputError) as error:
                fem.read_scene(changed, folder=folder)
            refused[".".join(map(str, path))] = str(error.value)
        for name in ("study", "hard"):
            file = folder / f"{name}.toml"
            file.write_text(STUDY + ("[hard]\n" if name == "hard" else "") + "nonsense = 1\n")
            code, said = called("study", str(file), "--out", str(folder / "out"))
            refused[name] = f"exit code {code}: " + said.strip().replace(place, "")
    settings = ("title", "units", "t_end", "steps", "scheme", "solver", "tol")
    read = {name: getattr(scene, name) for name in settings}
    effects = " ".join(type(effect).__name__ for effect in scene.effects)
    return {"scene": {**read, "effects": effects}, "unknown": refused}


# ---- the run of the README, with longer steps --------------------------------------------------


def tube():
    """What `sweepopt run tube --steps 96` writes, and its numbers."""
    import meshio
    import xarray as xr
    from matplotlib.figure import Figure

    empty = mock.patch("sweepopt.fem.pictures.draw", return_value=Figure())
    with tempfile.TemporaryDirectory() as place, empty:
        folder = Path(place)
        code, said = called("run", "tube", "--steps", "96", "--no-progress", "--out", place)
        assert code == 0, said
        summary = json.loads((folder / "summary.json").read_text())
        with xr.open_dataset(folder / "solution.nc", engine="h5netcdf") as data:
            dataset = {
                "attributes": " ".join(sorted(map(str, data.attrs))),
                "sizes": {str(name): size for name, size in data.sizes.items()},
                "variables": {
                    str(name): f"{variable.dtype.kind} {variable.dims}: "
                    + " ".join(sorted(variable.attrs))
                    for name, variable in data.variables.items()
                },
            }
        series = [name for name in summary["files"] if "step_" in name]
        last = meshio.read(folder / series[-1])
    assert summary["worst"]["relative"] <= 5e-11
    varying = ("seconds", "versions", "solvers", "iterations", "worst", "message", "settings")
    return {
        "summary": " ".join(summary),
        "in summary": {name: " ".join(summary[name]) for name in ("settings", "worst")},
        **{name: value for name, value in summary.items() if name not in (*varying, "files")},
        "energy": {name: x for name, x in summary["energy"].items() if name != "balance"},
        "scheme": summary["settings"]["scheme"],
        "files": [name for name in summary["files"] if "step_" not in name],
        "series": {"first": series[0], "last": series[-1], "number": len(series)},
        "netcdf": dataset,
        "vtu": {"points": sorted(last.point_data), "cells": sorted(last.cell_data)},
    }


# ---- the comparison -----------------------------------------------------------------------------

FACES = {
    "api": (api, 0.0),
    "cli": (cli, 0.0),
    "keys": (keys, 0.0),
    "tube": (tube, 1e-6),
}
"""What is written in each golden file and how far its numbers may be off, relatively."""


def flat(data, path=""):
    """Leaves of nested mappings and lists by their path; numbers with eight digits."""
    if not isinstance(data, (dict, list)):
        return {path[1:]: float(f"{data:.8g}") if isinstance(data, float) else data}
    pairs = data.items() if isinstance(data, dict) else enumerate(data)
    return {k: v for key, value in pairs for k, v in flat(value, f"{path}/{key}").items()}


def current(name):
    """What the golden file of that name would be now."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", so.SweepoptWarning)
        return flat(FACES[name][0]())


@pytest.mark.parametrize("name", FACES)
def test_what_is_public_is_as_it_was_written_down(name):
    golden = json.loads((GOLDEN / f"{name}.json").read_text(encoding="utf-8"))
    found = current(name)
    gone = {key: golden[key] for key in golden.keys() - found.keys()}
    new = {key: found[key] for key in found.keys() - golden.keys()}
    assert (gone, new) == ({}, {})
    for key, value in golden.items():
        close = pytest.approx(value, rel=FACES[name][1]) if isinstance(value, float) else value
        assert found[key] == close, key


if __name__ == "__main__" and sys.argv[1:2] == ["--write"]:
    for _name in sys.argv[2:] or FACES:
        _text = json.dumps(current(_name), indent=1, ensure_ascii=False)
        (GOLDEN / f"{_name}.json").write_text(_text + "\n", encoding="utf-8")
