"""A run of a scene as a NetCDF file on its mesh, in the units of the scene."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.fem.contact import STATES, Slip
from sweepopt.fem.output import Report, Units
from sweepopt.io import replacing
from sweepopt.results import (
    attributes_of,
    dataset,
    netcdf_package,
    statistics_of,
    times_of,
    variable,
)

if TYPE_CHECKING:
    import xarray as xr

    from sweepopt.fem import Discretisation
    from sweepopt.results import Energy, Solution


def dataset_of(report: Report) -> xr.Dataset:
    """A run as a dataset on its mesh: what `solution.nc` holds.

    Dimensions are time, step, node (clamped ones too), triangle, corner and contact. Mesh and
    fields follow the UGRID conventions, flags the CF conventions.
    """
    scene, solution, units = report.scene, report.solution, report.units
    body = scene.discretisation
    variables = {
        **_fields(body, solution, units),
        **_mesh(body),
        **statistics_of(solution, units.certificate, units.viability),
        **_energies(report.energy, units),
    }
    coordinates = {
        **times_of(solution, units.time),
        "x": variable(("node",), body.points[:, 0], "x coordinate of the node", units.length),
        "y": variable(("node",), body.points[:, 1], "y coordinate of the node", units.length),
    }
    if report.slip is not None:
        variables |= _contact_variables(report.slip, units)
        coordinates |= _contact_coordinates(report)
    title = scene.title or report.name or "An antiplane problem"
    attributes = {
        **attributes_of(solution, title),
        "Conventions": "CF-1.11 UGRID-1.0",
        "scene": report.text,
        "units_of_the_scene": scene.units,
    }
    return dataset(variables, coordinates, attributes)


def _fields(body: Discretisation, solution: Solution, units: Units) -> dict[str, Any]:
    on_mesh = {"mesh": "mesh", "location": "node"}
    return {
        "displacement": variable(
            ("time", "node"),
            body.expand(solution.u),
            "displacement out of the plane",
            units.length,
            **on_mesh,
        ),
        "velocity": variable(
            ("step", "node"),
            body.expand(solution.velocity),
            "velocity out of the plane in each step",
            units.velocity,
            **on_mesh,
        ),
    }


def _mesh(body: Discretisation) -> dict[str, Any]:
    return {
        "mesh": variable(
            (),
            np.int32(0),
            "mesh of triangles; a quadratic element counts as four",
            cf_role="mesh_topology",
            topology_dimension=np.int32(2),
            node_coordinates="x y",
            face_node_connectivity="triangles",
            face_dimension="triangle",
        ),
        "triangles": variable(
            ("triangle", "corner"),
            body.triangles.astype(np.int32),
            "nodes of each triangle",
            cf_role="face_node_connectivity",
            start_index=np.int32(0),
        ),
    }


def write_netcdf(report: Report, path: Path) -> None:
    """Write `dataset_of` a run, compressed."""
    netcdf_package()  # says so now if it is missing
    run = dataset_of(report)
    packed = {"zlib": True, "complevel": 1, "shuffle": True}
    encoding = {
        name: {**(packed if values.size > 1000 else {}), "_FillValue": None}
        for name, values in run.variables.items()
        if values.dtype.kind in "if"
    }
    with replacing(path) as part:
        run.to_netcdf(part, engine="h5netcdf", encoding=encoding)


def _energies(energy: Energy, units: Units) -> dict[str, Any]:
    described = {
        "stored": "elastic energy 1/2 <B u, u>, its change since the start",
        "viscous": "energy dissipated by viscosity",
        "friction": "energy dissipated by friction",
        "work": "work of the loads",
    }
    return {
        f"energy_{name}": variable(
            ("time",), getattr(energy, name), f"{words}, per length", units.energy
        )
        for name, words in described.items()
    }


def _contact_variables(slip: Slip, units: Units) -> dict[str, Any]:
    contact = slip.contact
    return {
        "contact_weight": variable(
            ("contact",), contact.weight, "length of boundary of the contact node", units.length
        ),
        "friction_bound": variable(
            ("contact",),
            contact.threshold,
            "friction force at which the node slips, weight times g, per length",
            units.force,
        ),
        "traction": variable(
            ("step", "contact"),
            slip.traction,
            "friction traction on the body, against the slip",
            units.traction,
        ),
        "slip_state": variable(
            ("step", "contact"),
            slip.state,
            "direction of slip; 0 where the velocity is exactly 0.0",
            flag_values=np.array(list(STATES), dtype=np.int8),
            flag_meanings=" ".join(STATES.values()),
        ),
    }


def _contact_coordinates(report: Report) -> dict[str, Any]:
    assert report.slip is not None
    contact = report.slip.contact
    return {
        "contact_node": variable(
            ("contact",), report.scene.discretisation.free[contact.unknown], "node of the contact"
        ),
        "arc_length": variable(
            ("contact",),
            contact.arc,
            "arc length from the start of the contact node's boundary",
            report.units.length,
        ),
        "boundary": variable(
            ("contact",), contact.boundary.astype(object), "boundary of the contact node"
        ),
    }
