"""What a run of a scene leaves behind: slip, summary and VTU files hold the solution's numbers."""

import json
import math

import meshio
import numpy as np
import pytest
from meshes import report_of, ring, smooth, square
from numpy.testing import assert_allclose, assert_array_equal

import sweepopt as so
from sweepopt.fem import BodyForce, Friction, Viscosity, antiplane
from sweepopt.fem.output import summary_of, write_summary, write_vtu
from sweepopt.plot import MOST_FRAMES


@pytest.fixture(scope="module")
def report():
    return report_of(ring(), name="ring", text="[domain]", seconds=1.5)


# ---- slip -----------------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", ["catching-up", "implicit-euler", "midpoint"])
def test_traction_is_friction(scheme):
    report = report_of(ring(steps=120, scheme=scheme))
    slip = report.slip
    g, slips = slip.contact.bound, slip.velocity != 0.0
    assert slips.any()
    assert not slips.all()
    assert (np.abs(slip.traction) <= g * (1 + 1e-5)).all()
    expected = np.broadcast_to(-g * np.sign(slip.velocity), slip.velocity.shape)
    assert_allclose(slip.traction[slips], expected[slips], rtol=1e-5)
    power = -(slip.traction * slip.velocity) @ slip.contact.weight
    dissipated = np.cumsum(np.diff(slip.t) * power)
    assert_allclose(report.energy.friction[1:], dissipated, rtol=1e-5, atol=1e-12)


def test_statistics_count_what_the_velocities_say(report):
    slip = report.slip
    said, slips = slip.statistics(), slip.velocity != 0.0
    share = slips @ slip.contact.weight / slip.contact.weight.sum()
    assert said.most == pytest.approx(share.max())
    assert said.time_of_most == slip.t[1 + share.argmax()]
    assert said.switches == np.count_nonzero(np.diff(slips, axis=0))
    total = np.abs(np.diff(slip.displacement, axis=0)).sum(axis=0)
    assert said.largest_total == pytest.approx(total.max())
    assert 0.0 < said.most <= said.ever + 1e-12 <= 1.0 + 1e-12
    effects = [Viscosity(1.0), Friction("outer", g=1e9), BodyForce(so.Sine(1.0, period=9.0))]
    stuck = report_of(ring(effects=effects, steps=3)).slip.statistics()
    assert stuck == (0.0, 0.0, None, 0, 0.0)


# ---- summary --------------------------------------------------------------------------------


def test_summary_is_plain_finite_json_with_the_solutions_numbers(report, tmp_path):
    write_summary(report, tmp_path, ["solution.nc"])

    def refuse(constant):
        raise AssertionError(f"{constant} in the summary")

    text = (tmp_path / "summary.json").read_text(encoding="utf-8")
    summary = json.loads(text, parse_constant=refuse)
    scene, solution, energy = report.scene, report.solution, report.energy
    names, counts = np.unique(solution.stats["solver"], return_counts=True)
    expected = {
        "success": True,
        "message": solution.message,
        "solvers": dict(zip(names, counts, strict=True)),
        "slip": report.slip.statistics()._asdict(),
        "materials": {"core": 1, "sleeve": 2},
        "seconds": 1.5,
        "files": ["solution.nc"],
    }
    assert {name: summary[name] for name in expected} == expected
    assert summary["settings"]["t_reached"] == 6.0
    assert summary["settings"]["steps"] == sum(summary["solvers"].values()) == 60
    assert summary["plan"]["unknowns"] == solution.plan.unknowns
    assert summary["plan"]["nonsmooth_unknowns"] == len(scene.contact)
    assert summary["energy"]["work"] == energy.work[-1]
    assert summary["energy"]["balance"] == energy.balance[-1]
    assert summary["worst"]["relative"] == solution.stats["relative"].max()
    assert summary["worst"]["viability"] == solution.viability().max()
    largest = summary["max_displacement"]
    assert np.abs(solution(largest["time"])).max() == largest["value"] == np.abs(solution.u).max()
    assert summary["versions"]["sweepopt"] == so.__version__
    assert {"python", "numpy", "scipy", "cvxpy", "osqp"} <= set(summary["versions"])


def test_without_friction_there_is_no_slip_and_no_solver():
    summary = summary_of(report_of(smooth(), seconds=math.nan))
    assert summary["slip"] is None
    assert summary["seconds"] is None  # JSON has no nan
    assert summary["settings"]["solver"] == "linear"
    assert set(summary["units"].values()) == {"dimensionless", "1"}


def test_files_of_an_earlier_run_do_not_pass_for_files_of_this_one(report, tmp_path):
    folder = tmp_path / "out"
    (folder / "vtu").mkdir(parents=True)
    earlier = ["contact.png", "vtu/step_000007.vtu"]
    mine = ["displacement.png", "vtu/step_000008.vtu", "notes.txt", "../outside.png"]
    for name in (*earlier, *mine, "solution.nc"):
        (folder / name).write_text("content")

    def left():
        return {file.relative_to(tmp_path).as_posix() for file in tmp_path.rglob("*.*")}

    whole = left() | {"out/summary.json"}
    for no_summary in (
        None,
        "[1, 2]",
        "half of a summ",
        '{"title": ""}',
        '{"files": 3}',
        "[" * 9999,
    ):
        if no_summary:
            (folder / "summary.json").write_text(no_summary)
        write_summary(report, folder, ["solution.nc", *earlier])
        assert left() == whole
        (folder / "summary.json").unlink()
    # of what a summary lists that was tampered with, no other kind of file and none outside
    listed = ["solution.nc", *earlier, "notes.txt", "../outside.png", "absent.png"]
    (folder / "summary.json").write_text(json.dumps({"files": listed}))
    write_summary(report, folder, ["solution.nc"])
    assert whole - left() == {f"out/{name}" for name in earlier}


# ---- VTU ------------------------------------------------------------------------------------


@pytest.mark.parametrize("element, kind", [("P1", "triangle"), ("P2", "triangle6")])
def test_vtu_series_holds_the_solution(tmp_path, element, kind):
    report = report_of(ring(element=element, steps=7))
    series, *files = write_vtu(report, tmp_path)
    index = json.loads(series.read_text(encoding="utf-8"))
    assert index["file-series-version"] == "1.0"
    assert [entry["time"] for entry in index["files"]] == pytest.approx(report.solution.t)
    assert [series.parent / entry["name"] for entry in index["files"]] == files
    body, solution = report.scene.discretisation, report.solution
    velocity = np.vstack([solution.velocity[:1], solution.velocity])
    for path, t, u, z in zip(files, solution.t, solution.u, velocity, strict=True):
        mesh = meshio.read(path)
        assert [block.type for block in mesh.cells] == [kind]
        assert_array_equal(mesh.points[:, :2], body.points)
        assert_array_equal(mesh.point_data["displacement"], body.expand(u))
        assert_array_equal(mesh.point_data["velocity"], body.expand(z))
        (stress,) = report.scene.stress(solution, t)
        assert_allclose(mesh.cell_data["stress"][0], stress, rtol=1e-12)
    points, cells = mesh.points, mesh.cells[0].data
    centre = points[cells[:, :3]].mean(axis=1)
    material = np.where(np.hypot(*centre[:, :2].T) < 1.5, 1, 2)
    assert_array_equal(mesh.cell_data["material"][0], material)
    # VTK wants the middles of the edges 01, 12, 20 after the corners
    corners = points[cells[:, :3]]
    ends = np.roll(corners, -1, axis=1)
    gap = points[cells[:, 3:]] - ((corners + ends) / 2.0)[:, : cells.shape[1] - 3]
    chord = np.linalg.norm(ends - corners, axis=2)
    assert (np.linalg.norm(gap, axis=2) < 0.1 * chord[:, : cells.shape[1] - 3]).all()


@pytest.mark.parametrize("steps", [49, 50])
def test_vtu_files_are_few_and_include_start_and_end(tmp_path, steps):
    scene = antiplane(square(1), clamped="top", effects=[Viscosity(1.0)], t_end=1.0, steps=steps)
    series, *files = write_vtu(report_of(scene), tmp_path)
    times = [entry["time"] for entry in json.loads(series.read_text())["files"]]
    assert 25 <= len(files) <= MOST_FRAMES
    assert (times[0], times[-1]) == (0.0, 1.0)
    assert (np.diff(times) > 0).all()
