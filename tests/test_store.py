"""Files of a run, read back: every number is the solution's, every variable says what it is."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
import xarray as xr
from meshes import annulus, square

import sweepopt as so
from sweepopt.fem import BodyForce, Elasticity, Friction, Scene, Traction, Viscosity, antiplane
from sweepopt.fem import output as store
from sweepopt.fem.slip import slip_of
from sweepopt.integrate.record import Log, StatesInMemory


def ring(**changes: Any) -> Scene:
    """A quadratic ring of two materials in SI units: glued inside, friction outside."""
    settings: dict[str, Any] = {
        "clamped": "inner",
        "element": "P2",
        "effects": [
            Viscosity({"core": 2.0, "sleeve": 1.0}),
            Elasticity(2.0),
            Friction("outer", g=0.6),
            BodyForce(so.Sine(4.0, period=4.0), f0=lambda x: 1.0 + 0.4 * x[0]),
        ],
        "t_end": 6.0,
        "steps": 60,
        "units": "SI",
        "title": "a ring",
    }
    return antiplane(annulus(2), **(settings | changes))


def report_of(scene: Scene) -> store.Report:
    return store.make_report(scene, scene.solve(), name="ring", text="[domain]", seconds=1.5)


@pytest.fixture(scope="module")
def report() -> store.Report:
    return report_of(ring())


@pytest.fixture(scope="module")
def written(report: store.Report, tmp_path_factory: pytest.TempPathFactory) -> xr.Dataset:
    path = tmp_path_factory.mktemp("netcdf") / "solution.nc"
    store.write_netcdf(report, path)
    with xr.open_dataset(path, engine="h5netcdf") as dataset:
        return dataset.load()


def assert_described(dataset: xr.Dataset) -> None:
    for name, variable in dataset.variables.items():
        assert variable.attrs.get("units"), f"{name} has no units"
        assert len(variable.attrs.get("long_name", "")) > 3, f"{name} has no long_name"


# ---- slip -----------------------------------------------------------------------------------


def test_traction_is_friction(report: store.Report) -> None:
    slip = report.slip
    assert slip is not None
    g, slips = slip.contact.bound, slip.velocity != 0.0
    assert slips.any()
    assert not slips.all()
    assert (np.abs(slip.traction) <= g * (1 + 1e-5)).all()
    expected = np.broadcast_to(-g * np.sign(slip.velocity), slip.velocity.shape)
    np.testing.assert_allclose(slip.traction[slips], expected[slips], rtol=1e-5)
    power = -(slip.traction * slip.velocity) @ slip.contact.weight
    dissipated = np.cumsum(np.diff(slip.t) * power)
    np.testing.assert_allclose(report.energy.friction[1:], dissipated, rtol=1e-5, atol=1e-12)


@pytest.mark.parametrize("scheme", ["catching-up", "implicit-euler", "midpoint"])
def test_traction_stays_below_the_bound_in_every_scheme(scheme: str) -> None:
    scene = ring(element="P1", steps=120, scheme=scheme)
    slip = slip_of(scene, scene.solve())
    assert slip is not None
    assert np.abs(slip.traction / slip.contact.bound).max() == pytest.approx(1.0, abs=1e-5)


def test_slip_zone_of_the_reference_square_spreads_and_reverses() -> None:
    def shape(x: np.ndarray) -> np.ndarray:
        bubble = np.sin(np.pi * x[1])
        return 0.45 * np.pi**2 * bubble * (1.0 + 2.0 * np.cos(np.pi * x[0]))

    scene = antiplane(
        square(20),
        clamped="top",
        effects=[
            Viscosity(1.0),
            Elasticity(1.0),
            Friction("bottom", g=1.0),
            BodyForce(so.Sine(1.0, period=2.0 * math.pi), f0=shape),
        ],
        t_end=4.0,
        steps=100,
    )
    slip = slip_of(scene, scene.solve())
    assert slip is not None
    # shared/reference_antiplane.md: shares of Gamma_3 at some times
    known = {0.4: 0.27, 0.8: 0.73, 1.2: 0.89, 1.6: 0.94, 2.0: 0.81, 3.2: 0.40, 3.6: 0.68, 4.0: 0.82}
    for t, share in known.items():
        found = np.interp(t, slip.stage_t, slip.share)
        assert found == pytest.approx(share, abs=0.05), f"t = {t}"
    assert not slip.share[(slip.stage_t > 2.4) & (slip.stage_t < 2.8)].any()
    assert slip.statistics().reversals == 0
    np.testing.assert_allclose(slip.position, np.linspace(0.0, 1.0, 21), atol=1e-12)


def test_statistics_count_what_the_velocities_say(report: store.Report) -> None:
    slip = report.slip
    assert slip is not None
    said = slip.statistics()
    moving = slip.velocity != 0.0
    share = moving @ slip.contact.weight / slip.contact.weight.sum()
    assert said.most == pytest.approx(share.max())
    assert said.time_of_most == slip.t[1 + int(np.argmax(share))]
    assert said.switches == np.count_nonzero(np.diff(moving.astype(int), axis=0))
    total = (np.abs(np.diff(slip.displacement, axis=0))).sum(axis=0)
    assert said.largest_total == pytest.approx(total.max())
    assert said.mean_total <= said.largest_total
    assert 0.0 < said.most <= said.ever + 1e-12 <= 1.0 + 1e-12


def test_a_contact_that_never_slips_has_no_time_of_most() -> None:
    scene = ring(
        effects=[Viscosity(1.0), Friction("outer", g=1e9), BodyForce(so.Sine(1.0, period=9.0))]
    )
    slip = slip_of(scene, scene.solve(steps=3))
    assert slip is not None
    assert slip.statistics() == (0.0, 0.0, None, 0, 0, 0.0, 0.0)


def test_positions_run_on_over_several_boundaries() -> None:
    scene = two_sided()
    slip = slip_of(scene, scene.solve())
    assert slip is not None
    assert len(slip.boundary_starts) == 2
    # the shared corner counts once, the clamped one not at all
    np.testing.assert_allclose(slip.position, np.arange(12) / 6.0, atol=1e-12)


def two_sided() -> Scene:
    return antiplane(
        square(6),
        clamped="top",
        effects=[
            Viscosity(1.0),
            Friction(["bottom", "left"], g={"bottom": 0.1, "left": 0.3}),
            Traction("right", so.Sine(1.0, period=2.0)),
        ],
        t_end=2.0,
        steps=12,
    )


# ---- datasets -------------------------------------------------------------------------------


def test_netcdf_describes_every_variable_in_si_units(written: xr.Dataset) -> None:
    assert_described(written)
    units = {name: variable.attrs["units"] for name, variable in written.variables.items()}
    for name, unit in {
        "displacement": "m",
        "velocity": "m s-1",
        "x": "m",
        "time": "s",
        "step_end": "s",
        "arc_length": "m",
        "friction_bound": "N m-1",
        "traction": "Pa",
        "energy_work": "J m-1",
        "relative": "1",
    }.items():
        assert units[name] == unit
    assert set(written.sizes) == {"time", "step", "node", "triangle", "corner", "contact"}


def test_netcdf_holds_the_solution_on_all_nodes(report: store.Report, written: xr.Dataset) -> None:
    scene, solution, slip = report.scene, report.solution, report.slip
    assert slip is not None
    body, free = scene.discretisation, scene.discretisation.free
    np.testing.assert_array_equal(written.time, solution.t)
    np.testing.assert_array_equal(written.displacement[:, free], solution.u)
    np.testing.assert_array_equal(written.velocity[:, free], solution.velocity)
    held = np.setdiff1d(np.arange(len(body.points)), free)
    assert held.size
    assert not written.displacement[:, held].any()
    np.testing.assert_array_equal(np.column_stack([written.x, written.y]), body.points)
    np.testing.assert_array_equal(written.triangles, body.triangles)
    nodes = written.contact_node.values
    np.testing.assert_allclose(written.displacement.values[:, nodes], slip.displacement)
    np.testing.assert_array_equal(np.sign(written.velocity.values[:, nodes]), written.slip_state)
    np.testing.assert_array_equal(written.traction, slip.traction)
    np.testing.assert_array_equal(written.friction_bound, scene.contact.threshold)
    for name in ("certificate", "relative", "iterations"):
        np.testing.assert_array_equal(written[name], solution.stats[name])
    np.testing.assert_array_equal(written.solver.values.astype(str), solution.stats["solver"])
    np.testing.assert_array_equal(written.viability, solution.viability())
    assert set(written.boundary.values) == {"outer"}


def test_netcdf_carries_the_scene_and_its_origin(written: xr.Dataset) -> None:
    assert written.attrs["title"] == "a ring"
    assert written.attrs["scene"] == "[domain]"
    assert written.attrs["status"] == "success"
    assert "UGRID" in written.attrs["Conventions"]
    assert written.attrs["tol"] == 1e-6
    for package in ("sweepopt", "numpy", "scipy", "cvxpy"):
        assert f"{package} " in written.attrs["software"]


def test_dimensionless_scenes_have_units_1_and_no_friction_means_no_contact(
    tmp_path: Path,
) -> None:
    effects = [Viscosity(1.0), BodyForce(so.Sine(1.0, period=4.0))]
    scene = antiplane(square(4), clamped="top", effects=effects, t_end=1.0, steps=4)
    report = report_of(scene)
    assert report.slip is None
    store.write_netcdf(report, tmp_path / "solution.nc")
    with xr.open_dataset(tmp_path / "solution.nc", engine="h5netcdf") as dataset:
        assert_described(dataset)
        assert "contact" not in dataset.sizes
        others = set(dataset.variables) - {"seconds"}
        assert {dataset[name].attrs["units"] for name in others} == {"1"}
    summary = store.summary_of(report)
    assert summary["slip"] is None
    assert summary["settings"]["solver"] == "linear"


def test_any_solution_becomes_a_dataset() -> None:
    C = so.Moving(so.Box([-1, -1], [1, 1]), center=lambda t: [1.5 * t, 0.0])
    solution = so.solve(so.SweepingProcess(np.eye(2), 2 * np.eye(2), C, [0, 0]), t_end=3.0, steps=9)
    dataset = solution.to_xarray()
    assert_described(dataset)
    assert dict(dataset.sizes) == {"time": 10, "unknown": 2, "step": 9}
    np.testing.assert_array_equal(dataset.u, solution.u)
    np.testing.assert_array_equal(dataset.velocity, solution.velocity)
    np.testing.assert_array_equal(dataset.step_end, solution.t[1:])
    for name in solution.stats.dtype.names or ():
        assert name == "t" or name in dataset


# ---- summary --------------------------------------------------------------------------------


def test_summary_is_plain_finite_json_with_the_solutions_numbers(
    report: store.Report, tmp_path: Path
) -> None:
    store.write_summary(report, tmp_path, ["solution.nc"])

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} in the summary")

    text = (tmp_path / "summary.json").read_text(encoding="utf-8")
    summary = json.loads(text, parse_constant=refuse)
    solution, energy = report.solution, report.energy
    assert summary["success"] is True
    assert summary["message"] == solution.message
    assert summary["settings"]["steps"] == 60
    assert summary["settings"]["t_reached"] == 6.0
    assert summary["plan"]["unknowns"] == solution.plan.unknowns
    assert summary["plan"]["nonsmooth_unknowns"] == len(report.scene.contact)
    assert summary["energy"]["work"] == energy.work[-1]
    assert summary["energy"]["balance"] == energy.balance[-1]
    assert summary["worst"]["relative"] == solution.stats["relative"].max()
    names, counts = np.unique(solution.stats["solver"], return_counts=True)
    assert summary["solvers"] == dict(zip(names, counts, strict=True))
    assert sum(summary["solvers"].values()) == 60
    assert summary["worst"]["viability"] == solution.viability().max()
    largest = summary["max_displacement"]
    assert largest["value"] == np.abs(solution.u).max()
    assert np.abs(solution(largest["time"])).max() == largest["value"]
    assert summary["slip"] == report.slip.statistics()._asdict()
    assert summary["materials"] == {"core": 1, "sleeve": 2}
    assert summary["seconds"] == 1.5
    assert summary["versions"]["sweepopt"] == so.__version__
    assert {"python", "numpy", "scipy", "cvxpy", "osqp"} <= set(summary["versions"])


def test_numbers_that_are_not_finite_become_null(report: store.Report) -> None:
    kept = report.solution.statistics
    certificate = kept.columns["certificate"].copy()
    certificate[3] = np.nan
    spoiled = replace(kept, columns={**kept.columns, "certificate": certificate})
    broken = replace(report.solution, statistics=spoiled, status=so.Status.UNCERTIFIED)
    summary = store.summary_of(store.make_report(report.scene, broken, seconds=math.inf))
    assert summary["worst"]["certificate"] is None
    assert summary["seconds"] is None


def test_files_of_an_earlier_run_do_not_pass_for_files_of_this_one(
    report: store.Report, tmp_path: Path
) -> None:
    for name in ("contact.png", "foreign.png"):
        (tmp_path / name).write_text("picture")
    store.write_summary(report, tmp_path, ["contact.png", "gone.vtu"])
    store.write_summary(report, tmp_path, ["solution.nc"])
    assert not (tmp_path / "contact.png").exists()
    assert (tmp_path / "foreign.png").exists()


@pytest.mark.parametrize(
    "text",
    [
        "not json",
        "[]",
        '{"versions": {}, "files": ["mine.png"]}',
        '{"versions": {"sweepopt": "0"}, "files": ["../mine.png", "mine.toml", 3]}',
        '{"versions": {"sweepopt": "0"}, "files": ["FOLDER/mine.png"]}',
    ],
)
def test_a_foreign_summary_removes_nothing(report: store.Report, tmp_path: Path, text: str) -> None:
    folder = tmp_path / "results"
    folder.mkdir()
    mine = [tmp_path / "mine.png", folder / "mine.png", folder / "mine.toml"]
    for path in mine:
        path.write_text("mine")
    (folder / "summary.json").write_text(text.replace("FOLDER", folder.as_posix()))
    store.write_summary(report, folder, [])
    assert all(path.exists() for path in mine)


# ---- VTU ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("element", "kind"), [("P1", "triangle"), ("P2", "triangle6")])
def test_vtu_series_holds_the_solution(tmp_path: Path, element: str, kind: str) -> None:
    report = report_of(ring(element=element, steps=7))
    series, *files = store.write_vtu(report, tmp_path)
    index = json.loads(series.read_text(encoding="utf-8"))
    assert index["file-series-version"] == "1.0"
    assert [entry["time"] for entry in index["files"]] == pytest.approx(report.solution.t)
    assert [series.parent / entry["name"] for entry in index["files"]] == files
    body, solution = report.scene.discretisation, report.solution
    for i, path in enumerate(files):
        mesh = meshio.read(path)
        assert [block.type for block in mesh.cells] == [kind]
        np.testing.assert_array_equal(mesh.points[:, :2], body.points)
        expected = body.expand(solution.u[i])
        np.testing.assert_array_equal(mesh.point_data["displacement"], expected)
        step = body.expand(solution.velocity[max(i - 1, 0)])
        np.testing.assert_array_equal(mesh.point_data["velocity"], step)
    material = mesh.cell_data["material"][0]
    corners = mesh.points[mesh.cells[0].data[:, :3]].mean(axis=1)
    np.testing.assert_array_equal(material, np.where(np.hypot(*corners[:, :2].T) < 1.5, 1, 2))
    if kind == "triangle6":
        # VTK wants the middles of the edges 01, 12, 20 after the corners
        points, cells = mesh.points, mesh.cells[0].data
        for k, (a, b) in enumerate([(0, 1), (1, 2), (2, 0)], start=3):
            chord = points[cells[:, a]] - points[cells[:, b]]
            middle = (points[cells[:, a]] + points[cells[:, b]]) / 2.0
            gap = np.linalg.norm(points[cells[:, k]] - middle, axis=1)
            assert (gap < 0.1 * np.linalg.norm(chord, axis=1)).all()


@pytest.mark.parametrize("steps", [48, 49, 50, 98, 99, 120])
def test_vtu_files_are_few_and_include_start_and_end(
    report: store.Report, tmp_path: Path, steps: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(meshio, "write", lambda path, *_, **__: Path(path).write_text("vtu"))
    t = np.linspace(0.0, 1.0, steps + 1)
    u = np.zeros((steps + 1, report.solution.u.shape[1]))
    many = replace(
        report.solution,
        t=t,
        steps=np.arange(steps),
        states=StatesInMemory(u, u[1:]),
        statistics=Log(steps).statistics(t[1:], 0.0),
    )
    few = store.Report("", "", report.scene, many, None, report.energy, 0.0)
    series, *files = store.write_vtu(few, tmp_path)
    times = [entry["time"] for entry in json.loads(series.read_text())["files"]]
    assert 25 <= len(files) <= store.MOST_VTU
    assert times[0] == 0.0
    assert times[-1] == 1.0
    assert (np.diff(times) > 0).all()


# ---- atomic replacement ---------------------------------------------------------------------


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "summary.json"
    path.write_text("old")

    def write_half() -> None:
        with store.replacing(path) as part:
            part.write_text("half of the n")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_half()
    assert path.read_text() == "old"
    with store.replacing(path) as part:
        part.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("package", ["xarray", "h5netcdf", "h5py"])
def test_a_missing_package_names_the_extra_that_brings_it(
    report: store.Report, tmp_path: Path, package: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(so.MissingExtraError, match=rf'{package}.*pip install "sweepopt\[fem\]"'):
        store.write_netcdf(report, tmp_path / "solution.nc")
