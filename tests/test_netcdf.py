"""NetCDF files, read back: every number is the solution's, every variable says what it is."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from cases import SQUARE, isotropic, refuses
from meshes import report_of, ring, run_of, smooth
from numpy.testing import assert_array_equal

import sweepopt as so
from sweepopt.fem import Discretisation, Friction, Viscosity, grid
from sweepopt.fem.output import Report, dataset_on_mesh, write_dataset


@pytest.fixture(scope="module")
def report():
    return report_of(ring(), name="ring", text="[domain]")


def written_to(path, report):
    write_dataset(dataset_on_mesh(report), path)
    with xr.open_dataset(path, engine="h5netcdf") as dataset:
        return dataset.load()


@pytest.fixture(scope="module")
def written(report, tmp_path_factory):
    return written_to(tmp_path_factory.mktemp("netcdf") / "solution.nc", report)


def assert_described(dataset):
    for name, variable in dataset.variables.items():
        assert variable.attrs.get("units"), f"{name} has no units"
        assert len(variable.attrs.get("long_name", "")) > 3, f"{name} has no long_name"


def test_every_variable_is_described_in_si_units(written):
    assert_described(written)
    expected = {
        **{"displacement": "m", "velocity": "m/s", "x": "m", "arc_length": "m"},
        **{"time": "s", "step_end": "s", "friction_bound": "N/m", "traction": "Pa"},
        **{"energy_work": "J/m", "relative": "1"},
    }
    assert {name: written[name].attrs["units"] for name in expected} == expected
    places = {"certificate": "step_end", "displacement": "x y"}  # as CF has them
    assert {name: written[name].encoding["coordinates"] for name in places} == places
    assert set(written.sizes) == {
        *("time", "step", "node", "triangle", "corner", "contact", "unknown")
    }


def test_the_file_of_a_scene_is_for_xarray_and_no_solution_to_load(written):
    with refuses(r"u at the end alone: read it with xarray\.open_data"):
        so.Solution.load(written.encoding["source"])


def test_the_solution_is_on_all_nodes(report, written):
    scene, solution, slip = report.scene, report.solution, report.slip
    body, nodes = scene.discretisation, written.contact_node.values
    displacement, velocity = written.displacement.values, written.velocity.values
    held = np.setdiff1d(np.arange(len(body.points)), body.free)
    assert held.size
    assert not displacement[:, held].any()
    for found, expected in [
        (written.time, solution.t),
        (displacement[:, body.free], solution.u),
        (velocity[:, body.free], solution.velocity),
        (np.column_stack([written.x, written.y]), body.points),
        (written.triangles, body.triangles),
        (displacement[:, nodes], slip.displacement),
        (np.sign(velocity[:, nodes]), written.slip_state),
        (written.traction, slip.traction),
        (written.friction_bound, scene.contact.threshold),
        (written.solver.values.astype(str), solution.stats["solver"]),
        (written.viability, solution.viability()),
        *((written[name], solution.stats[name]) for name in ("certificate", "iterations")),
    ]:
        assert_array_equal(found, expected)
    assert set(written.boundary.values) == {"outer"}


def test_the_scene_and_its_origin_are_attributes(written):
    expected = {"title": "a ring", "scene": "[domain]", "status": "success", "tol": 1e-6}
    assert {name: written.attrs[name] for name in expected} == expected
    for package in ("sweepopt", "numpy", "scipy", "cvxpy"):
        assert f"{package} " in written.attrs["software"]


def test_dimensionless_scenes_have_units_1_and_no_friction_means_no_contact(tmp_path):
    dataset = written_to(tmp_path / "solution.nc", report_of(smooth()))
    assert_described(dataset)
    assert "contact" not in dataset.sizes
    others = set(dataset.variables) - {"seconds"}
    assert {dataset[name].attrs["units"] for name in others} == {"1"}


def test_any_solution_becomes_a_dataset():
    C = so.Moving(SQUARE, center=lambda t: [1.5 * t, 0.0])
    solution = so.solve(isotropic(C, 1.0, 2), t_end=3.0, steps=9)
    dataset = solution.to_xarray()
    assert_described(dataset)
    assert dict(dataset.sizes) == {"time": 10, "unknown": 2, "step": 9}
    assert_array_equal(dataset.u, solution.u)
    assert_array_equal(dataset.velocity, solution.velocity)
    assert_array_equal(dataset.step_end, solution.t[1:])
    assert set(solution.stats.dtype.names) - {"t"} <= set(dataset.variables)


@pytest.mark.parametrize(
    "kind, sizes, on, expected",
    [
        ("solid", [1.0, 1.0, 1.0], "bottom", ("m2", "Pa", "N", "Pa")),
        ("solid", [1.0, 1.0, 1.0], "body", ("m3", "Pa/m", "N", "Pa")),
        ("plane stress", [1.0, 1.0], "body", ("m2", "Pa", "N", "N/m")),
        ("plane strain", [1.0, 1.0], "bottom", ("m", "Pa", "N/m", "Pa")),
        ("antiplane", [1.0], "body", ("m", "N/m", "N", "N")),
        ("antiplane", [1.0], "right", ("1", "N", "N", "N")),
        ("lumped", [1.0], "body", ("1", "N", "N", "N")),
    ],
)
def test_contact_is_in_units_of_what_slips(kind, sizes, on, expected):
    """A weight times a traction is a force; areas were in m, and stresses of sheets in Pa."""
    space = Discretisation(grid(sizes, [1] * len(sizes)), "left", kind=kind)
    scene, run = run_of(space, [Viscosity(1.0), Friction(on, 0.1)], steps=1)
    units = Report(replace(scene, units="SI"), run).units
    assert tuple(units[name] for name in ("weight", "traction", "force", "stress")) == expected
