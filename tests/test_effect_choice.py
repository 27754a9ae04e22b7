"""Effects on and off: changes of a scene by path, what is left out is absent, limits agree."""

import json
from itertools import combinations, cycle
from typing import Any

import numpy as np
import pytest
import skfem
from cases import refuses, slow, worst_certificate
from meshes import run_of
from numpy.testing import assert_allclose, assert_array_equal

from sweepopt import cli
from sweepopt.fem import (
    BodyForce,
    Dashpot,
    Discretisation,
    Elasticity,
    Friction,
    Initial,
    MaxwellBranch,
    Plasticity,
    SlipWeakening,
    Viscosity,
    body,
    compare_effects,
    grid,
    read_scene,
)
from sweepopt.fem.contact import slip_of
from sweepopt.fem.output import Report, dataset_on_mesh, write_dataset
from sweepopt.loads import Constant

pytestmark = pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")

SOLID = {
    "domain": {"mesh": {"sizes": [1.0, 1.0, 1.0], "cells": [2, 2, 2]}, "kind": "solid"},
    "time": {"end": 1.0, "steps": 10},
    "effects": {
        "viscosity": {"eta": 1.0},
        "elasticity": {"E": 2.0, "nu": 0.3},
        "foundation": {"on": "left", "k": 3.0},
        "dashpot": {"on": "right", "eta": 0.5},
        "friction": {"on": "bottom", "g": 0.2},
        "one_way": {"on": "back", "along": "x"},
        "traction": [
            {"on": "right", "history": {"waveform": "sine", "amplitude": 1.0, "period": 2.0}},
            {"on": "front", "f2": [0.1, 0.0, 0.0], "history": {"waveform": "constant"}},
        ],
    },
}
SOLID["domain"]["clamped"] = "top"
SOLID["effects"]["traction"][0]["f2"] = [1.0, 0.0, 0.0]


def test_changes_reach_values_in_tables_lists_and_whole_tables():
    scene = read_scene(
        "square",
        changes={
            "effects.friction.g": 0.5,
            "solve": {"tol": 1e-8},
            "effects.traction": [{"on": "left", "f2": 1.0, "history": {"waveform": "constant"}}],
            "effects.traction[0].f2": 2.5,
        },
    )
    assert set(scene.contact.bound) == {0.5}
    assert scene.tol == 1e-8
    assert [one.f2 for one in scene.effects if hasattr(one, "f2")] == [2.5]
    assert scene.changes[0] == "effects.friction.g = 0.5"


def test_an_effect_is_left_out_by_its_kind_or_by_its_name():
    both, one, none = (
        read_scene(SOLID, without=without) for without in ([], ["traction[1]"], ["traction"])
    )
    assert len(both.effects) == len(one.effects) + 1 == len(none.effects) + 2
    with refuses(r"no effect 'body_force'; there are: visc.*traction\[1\]"):
        read_scene(SOLID, without=["body_force"])
    # also one of a user's own that is not there
    changes = {"effects.rail": {"c": 1.0}}
    assert len(read_scene("square", changes=changes, without=["rail"]).effects) == 4
    with refuses(r"effects\.rail: unknown key; .* of your own"):
        read_scene("square", changes=changes, without=["traction"])


@pytest.fixture(autouse=True)
def _no_pictures(monkeypatch):
    """They take most of the time of a run."""
    monkeypatch.setattr("sweepopt.fem.pictures.AUTOMATIC", ())


def test_the_command_changes_a_scene_and_says_so(tmp_path, capsys):
    zigzag = "{ waveform = 'triangle', amplitude = 1.5, period = 1.37 }"
    changes = ["--set", "effects.elasticity.kappa=2.0", "--set", "time.steps=20"]
    changes += ["--set", f"effects.traction.history={zigzag}"]
    options = ["--out", str(tmp_path), "--without", "friction"]
    assert cli.main(["run", "square", *changes, "--no-progress", *options]) == 0
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    expected = ["effects.elasticity.kappa = 2.0", "time.steps = 20"]
    assert summary["changes"][:2] == expected
    assert summary["changes"][3:] == ["without friction"]
    assert summary["settings"]["steps"] == 20
    shown = capsys.readouterr().out
    assert all(f"changed             {one}" in shown for one in expected)
    # what is printed is the plan of the run
    assert "breakpoints         6 of the load lie inside of steps" in shown
    for change, message in (("time.steps", "write PATH=VALUE"), ("time.end=0,5", "quotes")):
        assert cli.main(["run", "square", "--set", change]) == 2
        assert message in capsys.readouterr().err


def test_list_and_effects_show_what_a_scene_has(capsys):
    assert cli.main(["list"]) == 0
    assert "effects: viscosity, elasticity, friction, traction" in capsys.readouterr().out
    assert cli.main(["effects", "square", "--steps", "2"]) == 0
    shown = capsys.readouterr().out
    assert all(
        word in shown for word in ("without friction", "9 intervals", "nonzeros_B", "seconds")
    )
    words = shown.split()
    assert max(len(word) for word in words if "." in word) == len("1.0e-03")


def test_the_table_of_effects_counts_what_is_there():
    rows = compare_effects("square", steps=3)
    whole, bare = rows.loc["all effects"], rows.loc["without friction"]
    assert (bare.path, bare.solvers, bare.sets, bare.nonsmooth_unknowns) == ("linear", "", "", 0)
    assert rows.nonzeros_B["without elasticity"] == rows.nonzeros_A["without viscosity"] == 0
    assert (whole.unknowns, whole.nonsmooth_unknowns, whole.sets) == (72, 9, "9 intervals")
    assert rows.certificate.max() <= 1e-6
    alone = read_scene("square").solve(t_end=0.06, steps=3)
    assert whole.nonzeros_A == alone.process.A.count_nonzero()
    needed = compare_effects("square", without="elasticity", steps=1)
    assert list(needed.index) == ["all effects", "without friction", "without traction"]
    ratchet = compare_effects(
        "square", changes={"effects.one_way": {"on": "bottom"}}, without="traction", steps=1
    )
    assert {"9 intervals, 9 half-lines", "9 half-lines"} <= {*ratchet.sets}
    axes = {"effects.friction.axes": [1.0, 2.0], "domain.mesh.cells": [4, 3]}
    ellipses = compare_effects("sheet", changes=axes, without="body_force", steps=1)
    assert ellipses.sets["all effects"].endswith(" ellipses in R^2")


def test_the_table_of_effects_has_steps_of_the_whole_run():
    """The first five of the chain are at rest, which tells nothing of what a step costs."""
    rows = compare_effects("chain", changes={"domain.mesh.nodes": 20})
    assert rows.solvers["all effects"] != rows.solvers["without body_force"] == "at rest"
    # the long steps between them would be refused here
    explicit = {"solve": {"scheme": "catching-up"}, "effects.elasticity.kappa": 10.0}
    rows = compare_effects("square", changes=explicit, without=["traction"])
    assert set(rows.solvers) == {"", "at rest"}
    # stiff steps of it, by implicit Euler, are linear solves too
    small = {"domain.mesh.cells": [3, 2, 1]}
    rows = compare_effects("tread", changes=small, without="elasticity")
    assert rows.solvers["without friction"] == ""


FLAT = {
    "domain": {"mesh": {"sizes": [1.0, 1.0], "cells": [3, 3]}, "clamped": "top"},
    "time": {"end": 1.0, "steps": 10},
    "effects": {
        "viscosity": {"eta": 1.0},
        "elasticity": {"kappa": 2.0},
        "dashpot": {"on": "right", "eta": 0.5},
        "foundation": {"on": "left", "k": 3.0},
        "friction": {"on": "bottom", "g": 0.2, "slip": {"distance": 0.1, "residual": 0.5}},
        "yield_stress": {"g": 0.1},
        "traction": {"on": "right", "history": {"waveform": "constant"}},
    },
}


def test_an_effect_leaves_what_the_others_add_bitwise_as_it_is():
    """Over all pairs; in antiplane shear, as friction turns the unknowns of vectors."""
    optional = [kind for kind in FLAT["effects"] if kind not in ("viscosity", "elasticity")]

    def scene_with(*some):
        return read_scene(FLAT, without=[kind for kind in optional if kind not in some])

    single = {kind: scene_with(kind) for kind in optional}
    for one, two in combinations(optional, 2):
        both, first, second = scene_with(one, two), single[one], single[two]
        damped, stiff = (second if two == kind else first for kind in ("dashpot", "foundation"))
        assert (both.problem.A != damped.problem.A).nnz == 0, (one, two)
        assert (both.problem.B != stiff.problem.B).nnz == 0, (one, two)
        assert np.array_equal(both.load(0.5), first.load(0.5) + second.load(0.5))
        for rows, mine in zip(both.yields, [*first.yields, *second.yields], strict=True):
            assert (rows.rows.E != mine.rows.E).nnz == 0
            assert np.array_equal(rows.at(0.0), mine.at(0.0))


@pytest.mark.parametrize("name", ["ring", "plate"])
def test_plasticity_leaves_the_elastic_matrix_bitwise_as_it_is(name):
    changes = {"domain.element": "P1"}
    elastic = read_scene(name, changes=changes, without=["plasticity"]).problem.B
    n, whole = elastic.shape[0], read_scene(name, changes=changes).problem.B
    assert (whole[:n, :n] != elastic).nnz == 0


SMALL = (1e-3, 1e-5)


@pytest.mark.parametrize(
    "path, changes, without",
    [
        ("effects.friction.g", SMALL, ["friction"]),
        ("effects.elasticity.kappa", SMALL, ["elasticity"]),
        ("effects.friction.slip", [{"distance": 0.1, "residual": 1 - x} for x in SMALL], []),
        ("effects.friction.slip", [{"distance": 1 / x} for x in SMALL], []),
    ],
)
def test_a_vanishing_effect_is_an_absent_one(path, changes, without):
    """|u - u_0| is proportional to the coefficient, and small."""

    def displacement(more, without=()):
        scene = read_scene("square", changes=COARSE | more, without=without)
        return scene.solve(steps=10, tol=1e-12).u

    bare = displacement({}, without)
    errors = [abs(displacement({path: change}) - bare).max() for change in changes]
    slopes = np.diff(np.log(errors)) / np.diff(np.log(SMALL))
    assert np.allclose(slopes, 1.0, atol=0.05), slopes
    assert errors[-1] < 2e-5 * abs(bare).max() / 0.5


@pytest.mark.parametrize("block", [1, 2])
def test_friction_follows_its_law_of_the_slip_at_every_node(block):
    """|q| = g phi(|u|) of the end of the step where a node slips, and no more where it sticks."""
    changes: dict[str, Any] = {"effects.friction.slip": {"distance": 0.05, "residual": 0.3}}
    source, without = ("square", []) if block == 1 else (SOLID, ["one_way"])
    scene = read_scene(source, changes=changes, without=without)
    solution = scene.solve(steps=40, scheme="implicit-euler", tol=1e-9)
    slip, law = slip_of(scene, solution), SlipWeakening(0.05, 0.3)
    assert 0 < solution.plan.contraction < 0.5
    assert worst_certificate(solution) <= 1e-9
    assert np.count_nonzero(slip.contact.unknown[0] >= 0) == block
    force, far = (
        np.linalg.norm(x.reshape(*x.shape[:2], -1), axis=2)
        for x in (slip.traction, slip.displacement[1:])
    )
    bound, slips = slip.contact.bound * law(far), slip.speed > 0
    assert bound.min() < 0.9 * slip.contact.bound.min()
    assert slips.any()
    assert_allclose(force[slips], bound[slips], rtol=1e-6)
    assert (force <= bound * (1 + 1e-6)).all()
    # what pictures show
    assert_allclose(slip.bound, bound, rtol=1e-9)
    assert_allclose(abs(slip.use[slips]), 1.0, rtol=1e-6)


@pytest.mark.parametrize("axes", [None, [3.0, 1.0]])
def test_the_slip_at_a_slanted_corner_is_that_along_the_tangent(axes):
    """The corner moves up the wall that holds it; its slip is less by the sine of the slope."""
    mesh = grid([1.0, 1.0], [1, 1], ["x", "y - 0.8 * x"])
    space = Discretisation(mesh, "right", kind="plane strain", held={"left": "n"})
    law, sine = SlipWeakening(0.1, 0.2), 0.8 / np.hypot(1.0, 0.8)
    rub = Friction("bottom", 0.3, axes=axes, slip=law)
    (rubs,) = body(space, [Viscosity(1.0), rub]).yields
    u = space.interpolate(["0", "0.07"])
    assert rubs.at(0.0, u) == pytest.approx(rubs.at(0.0) * law(0.07 * sine))
    # what reports show is along the tangent, too
    pull = BodyForce(Constant(), [0.0, 1.0])
    scene, solution = run_of(space, [Viscosity(1.0), Friction("bottom", 0.05), pull])
    slip = slip_of(scene, solution)
    assert_allclose(abs(slip.traction), 0.05, rtol=1e-9)
    up = scene.displacement(solution)[:, slip.contact.node, 1]
    assert_allclose(abs(slip.displacement), abs(up) * sine, rtol=1e-9)


@pytest.mark.parametrize(
    "points, motion", [(["x + 0.3 * y", "y"], [0, 1]), (["x + 0.3 * z", "y", "z"], [0, 1, 1])]
)
def test_friction_on_a_slanted_wall_that_is_held_along_x_takes_the_tangential_velocity(
    points, motion
):
    """It took all of the velocity that is free: 4.4 % too much for the wall of the plane."""
    d = len(points)
    mesh, kind = grid([1.0] * d, [2] * d, points), ("plane strain", "solid")[d - 2]
    space = Discretisation(mesh, [], kind=kind, held={"right": "x"})
    scene = body(space, [Dashpot("body", 1.0), Friction("right", 0.5)])
    area, along = np.hypot(1.0, 0.3), 0.3 / np.hypot(1.0, 0.3)  # the normal is (1, ..., -0.3)
    expected = 0.5 * area * np.sqrt(np.dot(motion, motion) - along**2)
    z = space.interpolate([str(v) for v in motion])
    assert scene.problem.dissipation.support(z) == pytest.approx(expected, rel=1e-12)


def test_a_curved_wall_of_two_names_that_is_held_along_its_normal_has_discs():
    """Of ellipses at the nodes of both names the steps of all would not be Newton's."""
    bend = ["(1 + z) * cos(0.5 + y)", "x", "(1 + z) * sin(0.5 + y)"]
    mesh = grid([2.0, 1.5, 1.0], [2, 8, 1], bend)
    wall = mesh.boundaries["front"]
    low = mesh.p[0, mesh.facets[:, wall]].mean(axis=0) > 0.3
    mesh = mesh.with_boundaries({**mesh.boundaries, "a": wall[low], "b": wall[~low]})
    space = Discretisation(mesh, "back", kind="solid", held={"a": "n", "b": "n"})
    scene = body(space, [Viscosity(1.0), Friction(["a", "b"], g=0.1)])
    assert [(one.rows.block, one.metric) for one in scene.yields] == [(2, None)]


T = [0.0, 0.37, 1.13, 1.71, 2.0]
PULL = {"table": {"t": T, "values": [0.0, 1.5, -1.5, 1.2, 0.3]}}
BOUNDS = {
    "at rest": ({}, []),
    "slip": ({"effects.friction.slip": {"distance": 0.5, "residual": 0.4}}, []),
    "formula": ({"effects.friction.g": "0.3 * (1 + 0.5 * sin(t))"}, []),
    "history": (
        {"effects.friction.history": {"table": {"t": [0, 0.77, 2], "values": [1, 0.5, 1]}}},
        [0.77],
    ),
    "load": (
        {"effects.body_force": {"f0": "0.1 * x * sin(t)", "history": {"waveform": "constant"}}},
        [],
    ),
}


@pytest.mark.parametrize("name", ["at rest", *map(slow, [*BOUNDS][1:])])  # .ci/run runs all
def test_steps_end_at_breakpoints_of_loads_whatever_the_bound_of_friction_does(name):
    """The second order is the scheme's; the slope varies with where in a step nodes stop."""
    given, more = BOUNDS[name]
    changes = {"domain.refinements": 0, "time.end": 2.0, "effects.traction.history": PULL}
    scene = read_scene("square", changes=changes | given)
    runs = [scene.solve(steps=steps, tol=1e-9) for steps in (16, 32, 64, 128, 256)]
    assert runs[0].plan.breakpoints.tolist() == sorted(T[1:-1] + more)
    errors = [abs(run.u - runs[-1](run.t)).max() for run in runs[:-1]]
    assert np.polyfit(range(4), np.log2(errors), 1)[0] < -1.85, errors
    # without the breakpoints 1.46e-3 to 1.6e-3, and 1.5e-4 to 2.2e-4
    assert errors[0] < 1.4e-3, errors
    assert errors[2] < 9e-5, errors


@pytest.mark.parametrize("without", [["traction", "elasticity"], ["traction"]])
@pytest.mark.parametrize("scheme", ["auto", "implicit-euler"])
def test_steps_end_where_the_rate_of_a_prescribed_displacement_jumps(scheme, without):
    """Without elasticity the load has the rate alone."""
    changes = {"effects.prescribed_displacement": {"on": "top", "history": PULL}, "time.end": 2.0}
    scene = read_scene("square", changes=changes, without=without)
    sol = scene.solve(steps=10, scheme=scheme, tol=1e-10)
    assert sol.plan.breakpoints.tolist() == T[1:-1]
    parts = scene.solve(steps=np.union1d(sol.t, T), scheme=scheme, tol=1e-10)
    size = abs(parts.u).max()
    np.testing.assert_allclose(sol.u, parts.u[np.isin(parts.t, sol.t)], atol=1e-8 * size)


UNIT = Discretisation(grid([1.0, 1.0], [2, 2]), "top", kind="plane strain")


def weakening(**hardening):
    """A body that hardens, whose friction falls with the slip; for data/refused.txt."""
    weak = Friction("bottom", g=0.5, slip=SlipWeakening(1.0, 0.5))
    effects = [Elasticity(E=10.0, nu=0.3), Plasticity(1.0, **hardening), weak]
    return run_of(UNIT, effects, scheme="auto")[1]


def test_a_law_of_the_slip_goes_with_kinematic_hardening():
    assert 0 < weakening(Hk=1.0).plan.contraction < 1


def test_numbers_for_unknowns_that_friction_turns_are_refused():
    """(0.1, 0.3) at a wall that rubs and does not hold was taken for (0.3, -0.1)."""
    effects, u = [Viscosity(1.0), Friction("bottom", 0.1)], ["0.1 * (1 - y)", "0.3 * (1 - y)"]
    with refuses(r"u0: friction turns unknowns .*Initial"):
        body(UNIT, effects, u0=UNIT.interpolate(u))
    scene = body(UNIT, effects, u0=Initial(u))
    turned = scene.discretisation
    again = body(turned, effects, u0=turned.interpolate(u))
    assert_array_equal(again.problem.u0, scene.problem.u0)
    start = np.outer(1 - turned.points[:, 1], [0.1, 0.3])
    assert_allclose(turned.expand(again.problem.u0), start, atol=1e-15)
    body(UNIT, [*effects, Elasticity(E=1.0, nu=0.3)], u0=np.zeros(UNIT.dim))
    held = Discretisation(UNIT.mesh, "top", kind="plane strain", held={"bottom": "n"})
    body(held, effects, u0=held.interpolate(u))  # of which none turns


COARSE = {"domain.refinements": 1}
BRANCH = COARSE | {"effects.maxwell": {"tau": 0.5, "kappa": 1.0}}


def start(path, changes):
    return changes | {"initial": {"run": str(path)}}


HARDENING = {"domain.element": "P1", "effects.plasticity.Hk": 0.0, "effects.plasticity.Hi": 1e10}


@pytest.mark.parametrize(
    "source, changes, names",
    [
        ("square", COARSE, ["solution.nc"]),
        ("square", BRANCH, ["run.nc", "kept.nc", "solution.nc"]),
        ("plate", HARDENING, ["solution.nc"]),
    ],
)
def test_a_scene_starts_where_a_run_of_it_has_ended(source, changes, names, tmp_path):
    """From files with all unknowns, and from that of a scene; bit for bit."""
    scene = read_scene(source, changes=changes)
    half = scene.solve(t_end=1.0, steps=2, save=tmp_path / "run.nc" if "run.nc" in names else None)
    assert all(half.field(name).u[-1].any() for name in half.process.fields)
    write_dataset(dataset_on_mesh(Report(scene, half)), tmp_path / "solution.nc")
    if "kept.nc" in names:
        half.save(tmp_path / "kept.nc")
    for name in names:
        again = read_scene(source, changes=start(tmp_path / name, changes))
        assert np.array_equal(again.problem.u0, half.u[-1]), name


PLANE = {
    "domain": FLAT["domain"] | {"kind": "plane strain"},
    "time": {"end": 1.0, "steps": 2},
    "effects": {"viscosity": {"eta": 1.0}},
}

HARD = {"elasticity": {"E": 3.0, "nu": 0.3}, "plasticity": {"sigma_y": 1.0, "Hi": 30.0}}
LOOSE, RUBS = {"domain.clamped": "bottom"}, {"on": "top", "g": 0.1}
YIELDING = PLANE | {"effects": PLANE["effects"] | HARD}


def test_a_run_of_another_scene_is_no_start(tmp_path):
    effects = {"viscosity": {"eta": 1.0}, "maxwell": [BRANCH["effects.maxwell"]]}
    listed, narrow = COARSE | {"effects": effects}, {"sizes": [1.0, 0.5], "cells": [4, 4]}
    sheet = {"domain.mesh": narrow, "domain.refinements": 0, "effects.friction.g": 0.0}
    for source, changes, others in (
        (
            "square",
            BRANCH,
            [
                ("square", listed, r"40 unknowns of u, maxwell, the scene 40 of u, maxwell\[0\]"),
                ("square", {}, r"unknowns of u, maxwell, the scene \d+ of u; take"),
                ("square", BRANCH | sheet, r"is of another mesh"),
                (SOLID, {}, r"40 unknowns of u, maxwell, the scene 54 of u"),
            ],
        ),
        (
            PLANE,
            {},
            [
                (FLAT, {}, r"24 unknowns of u, the scene 12 of u"),
                (PLANE, {"domain.mesh.sizes": [2.0, 2.0]}, "another mesh"),
            ],
        ),
        # unknowns of the top are along y and x there, all other numbers are the same
        (PLANE, LOOSE, [(PLANE, LOOSE | {"effects.friction": RUBS}, "held or turned")]),
        (YIELDING, {}, [(YIELDING, {"effects.plasticity.Hi": 1.0}, "isotropic hardening")]),
    ):
        scene = read_scene(source, changes=changes)
        run = scene.solve(t_end=1.0, steps=2, save=tmp_path / "run.nc")
        write_dataset(dataset_on_mesh(Report(scene, run)), tmp_path / "solution.nc")
        for name, (other, more, words) in zip(
            cycle(("run.nc", "solution.nc")), others, strict=False
        ):
            with refuses(rf"initial.run: .*{words}"):
                read_scene(other, changes=start(tmp_path / name, more))


def test_a_run_whose_other_half_was_plastic_is_no_start(tmp_path):
    halves = UNIT.mesh.with_subdomains(
        {"left": lambda x: x[0] < 0.5, "right": lambda x: x[0] > 0.5}
    )
    space = Discretisation(halves, "bottom", kind="plane strain")

    def plastic(half, u0=None):
        return body(space, [Elasticity(E=3.0, nu=0.3), Plasticity(1.0, Hk=3.0, on=half)], u0=u0)

    run = Initial(run=tmp_path / "run.nc")
    plastic("left").solve(t_end=1.0, steps=1, save=run.run)
    assert not plastic("left", run).problem.u0.any()
    with refuses(r"run: .* is of another mesh .* other cells are plastic"):
        plastic("right", run)


def test_a_run_of_a_body_of_other_moduli_is_a_start(tmp_path):
    """Of which entries of B there are depends on rounding where they cancel."""
    mesh = skfem.MeshTri().refined(3).with_defaults()
    space = Discretisation(mesh, "left", element="P2")

    def scene(kappa, u0=None):
        return body(space, [Viscosity(1.0), MaxwellBranch(1.0, kappa=kappa)], u0=u0)

    run = Initial(run=tmp_path / "run.nc")
    end = scene(1.0).solve(t_end=1.0, steps=1, save=run.run).u[-1]
    for kappa in (1 / 3, 1.1, 2.0):
        np.testing.assert_array_equal(scene(kappa, run).problem.u0, end)


def test_a_start_is_a_formula_of_each_component(tmp_path):
    parts = [{"along": "y", "at": [0, 1], "values": [0, 0.01]}, 0.0, "0.02 * x * y"]
    scene = read_scene(SOLID, changes={"initial": {"u": parts}})
    space = scene.discretisation
    free = space.frame.held == 0
    x, y, _ = space.points[free].T
    expected = np.column_stack([0.01 * y, 0 * y, 0.02 * x * y])
    assert_allclose(space.expand(scene.problem.u0)[free], expected, atol=1e-16)
    by_hand = body(space, scene.effects, u0=Initial(["0.01 * y", *parts[1:]]))
    assert np.array_equal(by_hand.problem.u0, scene.problem.u0)
