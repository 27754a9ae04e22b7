"""Scene files: data in, problem out; what is not named does not exist; every fault has a path."""

from copy import deepcopy

import numpy as np
import pytest
from meshes import annulus, square, write_msh
from test_golden import SCENE_TEXT

from sweepopt import Constant, InputError, Sine, Table, Triangle
from sweepopt.fem import (
    BodyForce,
    Elasticity,
    Friction,
    Profile,
    Traction,
    Viscosity,
    antiplane,
    read_scene,
)

SMALL = {
    "domain": {"mesh": "square.msh", "clamped": "top"},
    "time": {"end": 1.0, "steps": 4},
    "effects": {"viscosity": {"eta": 1.0}},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Meshes and tables that the scenes below name."""
    path = tmp_path_factory.mktemp("scenes")
    write_msh(path / "ring.msh", annulus(2))
    write_msh(path / "square.msh", square(2))
    write_msh(path / "coarse.msh", square(1))
    (path / "f.csv").write_text("t,f\n0,0\n1,0.5\n2,0.25\n")
    (path / "loads.csv").write_text("t,f2\n0,0\n1,0.5\n2,0.25\n")
    (path / "late.csv").write_text("t,f2\n0.25,0\n9,0.5\n")
    (path / "text.csv").write_text("t,f2\n0,0\n1,much\n")
    (path / "broken.msh").write_text("$MeshFormat\n")
    (path / "full.toml").write_text(SCENE_TEXT)
    return path


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
def test_a_file_states_the_same_problem_as_python(folder):
    scene = read_scene(folder / "full.toml")
    by_hand = antiplane(
        folder / "ring.msh",
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


def test_text_a_path_and_a_mapping_are_read_alike(folder):
    import tomllib

    scenes = [
        read_scene(str(folder / "full.toml")),
        read_scene(SCENE_TEXT, folder=folder),
        read_scene(tomllib.loads(SCENE_TEXT), folder=folder),
    ]
    assert all(same(scenes[0], scene) for scene in scenes[1:])


@pytest.mark.parametrize(
    "zero", [{}, {"elasticity": {"kappa": 0.0}, "friction": {"on": "bottom", "g": 0.0}}]
)
def test_what_a_scene_does_not_name_or_is_zero_does_not_exist(folder, zero):
    scene = read_scene(SMALL | {"effects": SMALL["effects"] | zero}, folder=folder)
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


BAD = [
    # the file as a whole
    ("units", "cgs", "units must be one of dimensionless, SI; got 'cgs'"),
    ("title", 3, "title must be text, got 3"),
    ("title", "a\0b", "title must be text, got .* leave out control characters"),
    ("domain", MISSING, "domain: is missing"),
    ("effects", {}, "effects must hold a viscosity"),
    # domain, time, solve
    ("domain.mesh", 3, "domain.mesh must be a path, got 3"),
    ("domain.mesh", "\0", "domain.mesh .*cannot be read"),
    ("domain.mesh", "absent.msh", "domain.mesh absent.msh: .*absent.msh: cannot be read"),
    ("domain.mesh", "broken.msh", "domain.mesh broken.msh: is cut short"),
    ("domain.mesh", "loads.csv", "domain.mesh loads.csv: is damaged or no mesh"),
    ("domain", {"mesh": "square.msh"}, "domain.clamped: 'clamped' is not a boundary of the mesh"),
    ("domain", COARSE, "domain.clamped: holding bottom, top leaves no unknown"),
    ("domain.clamped", "roof", "domain.clamped: 'roof' is not a boundary of the mesh; there are"),
    ("domain.clamped", 3, "domain.clamped must be a list with one entry or more, got 3"),
    ("domain.element", "P7", "domain.element must be one of P1, P2; got 'P7'"),
    ("initial", 3, "initial: must be a table, got 3"),
    ("initial", {"v": 1.0}, "initial.v: unknown key"),
    ("initial", {"u": 1.0, "run": "x.nc"}, "initial.run: give u or run, not both"),
    ("initial", {"u": [1.0, 2.0]}, "initial.u must have 1 components"),
    ("initial", {"u": "x + q"}, "initial.u must be a number or a formula of .* got 'q'"),
    ("initial", {"u": "x + t"}, "initial.u does not move here"),
    ("initial", {"u": float("nan")}, "initial.u is nan"),
    ("initial", {"run": "absent.nc"}, "initial.run: .*absent.nc is no NetCDF file of a run"),
    ("initial", {"run": "loads.csv"}, "initial.run: .*loads.csv is no NetCDF file of a run"),
    ("time.end", 0.0, "time.end must be > 0, got 0"),
    ("time.end", "10", "time.end must be one number, got '10'"),
    ("time.end", True, "time.end must be one number, got True .entries are bool; give numbers"),
    ("time.steps", 2.5, "time.steps must be a positive whole number, got 2.5"),
    ("solve.scheme", "leapfrog", "solve.scheme 'leapfrog' is not known"),
    ("solve.solver", "simplex", "solve.solver 'simplex' is not known"),
    ("solve.tol", -1.0, "solve.tol must be > 0, got -1"),
]
BAD_EFFECTS = [
    ("viscosity", 3, "viscosity: must be a table, got 3"),
    ("viscosity.eta", 0.0, "viscosity.eta must be > 0, got 0"),
    ("viscosity.eta", 1e308, "viscosity.eta is 1e.308, beyond"),
    ("viscosity.eta", 10**400, "viscosity.eta must be one number, got 1000"),
    ("viscosity.eta", "x[0]", r"viscosity.eta must be a number or a formula, got 'x\[0\]'"),
    ("viscosity.eta", True, "viscosity.eta must be one number, got True"),
    ("viscosity.eta", [1.0], r"viscosity.eta must be one number, got 1 of them in a list"),
    ("viscosity.eta", {"core": 1.0}, "viscosity.eta.core is not a group here"),
    ("elasticity", {"kappa": -1}, "elasticity.kappa must be >= 0, got -1"),
    ("elasticity", along("z", [0, 1], [1, 1]), "elasticity.kappa.along must be one of x, y"),
    ("elasticity", along("x", [0, 1]), "elasticity.kappa.values: is missing"),
    ("elasticity", along("x", [0, 0.5], [1, 1]), r"elasticity.kappa.at covers \[0, 0.5\] but x"),
    ("elasticity", along("x", [0, 1], [1, -1]), "elasticity.kappa must be >= 0, got -"),
    ("friction", {"on": "left", "g": -1.0}, "friction.g must be >= 0, got -1"),
    ("friction", {"on": "left", "g": float("nan")}, "friction.g is nan; give a number"),
    ("friction", {"on": "wall", "g": 1.0}, "friction.on: 'wall' is not a boundary"),
    ("friction", {"on": "top", "g": 1.0}, "friction.on: all of top is clamped"),
    ("friction", {"on": 3, "g": 1.0}, "friction.on must be a list with one entry"),
    ("friction", {"on": ["left", "right"], "g": {"left": 1}}, "friction.g .* several in right"),
    ("traction", [TRACTION, {}], r"traction\[1\].on: is missing"),
    (
        "traction",
        TRACTION | {"f2": "1 +"},
        "traction.f2 must be a number or a formula, got '1 [+]'",
    ),
]
BAD_HISTORIES = [
    (3.0, "history: must have one of csv, waveform or table; got 3.0"),
    ({"waveform": "square"}, "history.waveform must be one of constant, sine, triangle; got"),
    ({"waveform": ["sine"]}, r"history.waveform must be one of .*; got \['sine'\]"),
    ({"waveform": "sine", "amplitude": 1.0, "period": -1.0}, "history.period must be > 0"),
    ({"waveform": "constant", "value": 1.0, "csv": "loads.csv"}, ".*waveform: unknown key"),
    ({"table": {"t": [0.0, 1.0]}}, "history.table.values: is missing"),
    (table([0, 0], [0, 1]), r"history.table.t must increase strictly, but entry 1 \(0\)"),
    (table("ab", [0, 1]), "history.table.t must be an array of numbers"),
    (table([0, 1], ["a", 1]), "history.table.values must be an array"),
    (table([0, 0.5], [0, 1]), r"history.t = 1 lies outside the table, .* \[0, 0.5\]; extend"),
    (csv("absent.csv"), "history.*absent.csv: cannot be read"),
    ({"csv": "loads.csv"}, "history.column: is missing"),
    (csv("loads.csv", column="f9"), "history.*loads.csv: column 'f9' is missing among"),
    (csv("text.csv"), "history.*text.csv, column 'f2', row 3: 'much' is not"),
    (csv("late.csv"), r"history.t = 0 lies outside the table, which covers \[0.25, 9\]"),
    (csv("loads.csv", scale="1"), "history.scale must be one number, got '1'"),
    (csv("loads.csv", scale=np.nan), "history.scale is nan; give a finite number"),
]
BAD += [(f"effects.{key}", value, f"effects.{message}") for key, value, message in BAD_EFFECTS]
BAD += [
    ("effects.traction", {"on": "left", "history": history}, f"effects.traction.{message}")
    for history, message in BAD_HISTORIES
]


def changed(path, value):
    """SMALL with one entry replaced, added or (MISSING) removed."""
    keys = path.split(".")
    data = deepcopy(SMALL)
    table = data
    for key in keys[:-1]:
        table = table.setdefault(key, {})
    if value is MISSING:
        del table[keys[-1]]
    else:
        table[keys[-1]] = value
    return data


@pytest.mark.parametrize(("path", "value", "message"), BAD)
def test_a_bad_entry_is_refused_with_its_path(folder, path, value, message):
    with pytest.raises(InputError, match=f"^{message}"):
        read_scene(changed(path, value), folder=folder)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("absent.toml", "absent.toml: cannot be read"),
        ("nowhere", "'nowhere' is neither a scene file nor a problem; there are: .*tube"),
        ("../tube", "'../tube' is neither"),
        ("[domain]\nmesh = \n", "the scene: is not TOML: .*line 2"),
        ("[domain]\nmesh = 1\nmesh = 2\n", "the scene: is not TOML"),
        ("\n", "domain: is missing; time: is missing; effects: is missing"),
        (3, "source must be a path, got 3"),
        (None, "source must be .*, got None"),
        (b"", "source must be .*, got b''"),
        # found by fuzzing (test_fuzz.py), shrunken
        pytest.param("x = " + 5000 * "9" + "\n", "is not TOML: Exceeds", id="digits"),
        pytest.param("x = " + 3000 * "[" + "\n", "is not TOML: brackets within", id="brackets"),
        pytest.param(5000 * "x", "is neither a scene file nor a problem", id="a long name"),
        ("a\0b.toml", r"a\\x00b.toml': cannot be read \(embedded null byte"),
    ],
)
def test_a_bad_file_is_refused(source, message):
    with pytest.raises(InputError, match=message):
        read_scene(source)


def test_folders_are_paths_and_files_are_text(tmp_path):
    with pytest.raises(InputError, match="folder must be a path, got None"):
        read_scene(SCENE_TEXT, folder=None)
    (tmp_path / "scene.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"scene.toml: is not UTF-8 text"):
        read_scene(tmp_path / "scene.toml")
    with pytest.raises(InputError, match="cannot be read"):
        read_scene(tmp_path)
