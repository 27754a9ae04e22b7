"""Scene files: data in, problem out; what is not named does not exist; every fault has a path."""

from copy import deepcopy
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from cases import refuses
from meshes import annulus, square, write_msh
from test_golden import SCENE_TEXT

from sweepopt import Constant, Sine, Table, Triangle
from sweepopt.fem import (
    BodyForce,
    Contribution,
    Discretisation,
    Elasticity,
    Friction,
    Profile,
    Traction,
    Viscosity,
    antiplane,
    body,
    read_scene,
)

SMALL = {
    "domain": {"mesh": "square.msh", "clamped": "top"},
    "time": {"end": 1.0, "steps": 4},
    "effects": {"viscosity": {"eta": 1.0}},
}


PLACE = TemporaryDirectory()  # until the process ends
FOLDER = Path(PLACE.name)
for _name, _mesh in {"ring": annulus(2), "square": square(2), "coarse": square(1)}.items():
    write_msh(FOLDER / f"{_name}.msh", _mesh)
for _name, _text in {
    "f.csv": "t,f\n0,0\n1,0.5\n2,0.25\n",
    "loads.csv": "t,f2\n0,0\n1,0.5\n2,0.25\n",
    "late.csv": "t,f2\n0.25,0\n9,0.5\n",
    "text.csv": "t,f2\n0,0\n1,much\n",
    "broken.msh": "$MeshFormat\n",
    "full.toml": SCENE_TEXT,
}.items():
    (FOLDER / _name).write_text(_text)


def same(one, two):
    """Whether two scenes state the same problem."""
    f, g = one.problem.load, two.problem.load
    v = np.cos(np.arange(one.discretisation.dim))
    return (
        abs(one.problem.A - two.problem.A).max() == 0
        and abs(one.problem.B - two.problem.B).max() == 0
        and np.array_equal(one.contact.threshold, two.contact.threshold)
        and one.problem.dissipation.support(v) == two.problem.dissipation.support(v)
        and all(np.array_equal(f(t), g(t)) for t in (0.0, 0.7, 2.0))
    )


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
def test_a_file_states_the_same_problem_as_python():
    scene = read_scene(FOLDER / "full.toml")
    by_hand = antiplane(
        FOLDER / "ring.msh",
        clamped="inner",
        element="P2",
        effects=[
            Viscosity({"core": 1.0, "sleeve": 0.2}),
            Elasticity(Profile("radius", [0.9, 2.1], [1.0, 3.0])),
            Friction("outer", g=0.3),
            BodyForce(Table([0, 2], [0, 1]), f0=2.0),
            Traction("outer", Table([0, 1, 2], [0, 1, 0.5])),
            Traction("outer", Sine(1.0, period=4.0, phase=0.1, offset=0.2), f2=2.0),
            Traction("outer", Triangle(1.0, period=4.0)),
            Traction("outer", Constant(1.0)),
        ],
    )
    assert same(scene, by_hand)
    assert (scene.title, scene.units, scene.t_end, scene.steps) == ("a ring", "SI", 2.0, 8)
    assert (scene.scheme, scene.solver, scene.tol) == ("implicit-euler", "osqp", 1e-5)
    assert scene.left_out == ()
    sol = scene.solve()
    assert sol.success
    assert len(sol.t) == 9
    assert len(scene.solve(steps=3).t) == 4


def test_text_a_path_and_a_mapping_are_read_alike():
    import tomllib

    scenes = [
        read_scene(str(FOLDER / "full.toml")),
        read_scene(SCENE_TEXT, folder=FOLDER),
        read_scene(tomllib.loads(SCENE_TEXT), folder=FOLDER),
    ]
    assert all(same(scenes[0], scene) for scene in scenes[1:])


@pytest.mark.parametrize(
    "zero", [{}, {"elasticity": {"kappa": 0.0}, "friction": {"on": "bottom", "g": 0.0}}]
)
def test_what_a_scene_does_not_name_or_is_zero_does_not_exist(zero):
    scene = read_scene(SMALL | {"effects": SMALL["effects"] | zero}, folder=FOLDER)
    problem = scene.problem
    assert problem.B is problem.dissipation is problem.load is scene.contact is None
    absent = [sentence.split(":")[0] for sentence in scene.left_out]
    assert absent == ["no elasticity", "no friction", "no load"]
    assert scene.solve().u.max() == 0.0


TRACTION = {"on": "left", "history": {"waveform": "constant", "value": 1.0}}
COARSE = {"mesh": "coarse.msh", "clamped": ["bottom", "top"]}
MISSING = object()


def along(direction, at, *values):
    """A profile as a scene file has it."""
    return {"kappa": {"along": direction, "at": at, **({"values": values[0]} if values else {})}}


def table(times, values):
    return {"table": {"t": times, "values": values}}


def csv(name, column="f2", **more):
    return {"csv": name, "column": column, **more}


def changed(path, value, scene=SMALL):
    """The scene with one entry replaced, added or (MISSING) removed."""
    keys = path.split(".")
    data = deepcopy(scene)
    table = data
    for key in keys[:-1]:
        table = table.setdefault(key, {})
    if value is MISSING:
        del table[keys[-1]]
    else:
        table[keys[-1]] = value
    return data


def test_folders_are_paths_and_files_are_text(tmp_path):
    with refuses("folder must be a path, got None"):
        read_scene(SCENE_TEXT, folder=None)
    (tmp_path / "scene.toml").write_bytes(b"\xff\xfe\x00")
    with refuses(r"scene.toml: is not UTF-8 text"):
        read_scene(tmp_path / "scene.toml")
    with refuses("cannot be read"):
        read_scene(tmp_path)


def read(path, value):
    """The small scene with a value at a path, for data/refused.txt."""
    return read_scene(changed(path, value), folder=FOLDER)


def read_history(history):
    return read("effects.traction", {"on": "left", "history": history})


def test_functions_of_time_are_called_at_the_start_of_a_scene_that_lists_its_times():
    seen = []

    def late(x, t):
        seen.append(t)
        return 1.0 + 0.0 * x[0]

    class Own:
        def contribute(self, space):
            return Contribution(loads=[(lambda t: late([0.0], t), np.zeros(space.dim))])

    section = Discretisation(square(2), "left")
    effects = [Viscosity(1.0), Friction("bottom", late)]
    body(section, [*effects, Own()], steps=np.linspace(2.0, 3.0, 3)).solve()
    assert min(seen) == 2.0
    with refuses(r"steps\[1\] is nan"):
        body(section, effects, steps=[0.0, np.nan])
