"""NetCDF files, read back: every number is the solution's, every variable says what it is."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from meshes import annulus, square

import sweepopt as so
from sweepopt.fem import (
    BodyForce,
    Elasticity,
    Friction,
    Scene,
    Viscosity,
    antiplane,
    netcdf,
)
from sweepopt.fem import output as store


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
    netcdf.write_netcdf(report, path)
    with xr.open_dataset(path, engine="h5netcdf") as dataset:
        return dataset.load()


def assert_described(dataset: xr.Dataset) -> None:
    for name, variable in dataset.variables.items():
        assert variable.attrs.get("units"), f"{name} has no units"
        assert len(variable.attrs.get("long_name", "")) > 3, f"{name} has no long_name"


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
    netcdf.write_netcdf(report, tmp_path / "solution.nc")
    with xr.open_dataset(tmp_path / "solution.nc", engine="h5netcdf") as dataset:
        assert_described(dataset)
        assert "contact" not in dataset.sizes
        others = set(dataset.variables) - {"seconds"}
        assert {dataset[name].attrs["units"] for name in others} == {"1"}


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


@pytest.mark.parametrize("package", ["xarray", "h5netcdf", "h5py"])
def test_a_missing_package_names_the_extra_that_brings_it(
    report: store.Report, tmp_path: Path, package: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(so.MissingExtraError, match=rf'{package}.*pip install "sweepopt\[fem\]"'):
        netcdf.write_netcdf(report, tmp_path / "solution.nc")
