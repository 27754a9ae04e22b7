"""Trajectories as xarray datasets and NetCDF files, every variable with its unit and name."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.errors import brought_by
from sweepopt.fem.contact import STATES, Slip
from sweepopt.fem.output import (
    DIMENSIONLESS,
    Report,
    Units,
    solver_name,
    versions_of,
)
from sweepopt.integrate import netcdf_package
from sweepopt.io import replacing

if TYPE_CHECKING:
    import xarray as xr

    from sweepopt.fem import Discretisation
    from sweepopt.results import Energy, Solution


def to_xarray(solution: Solution) -> xr.Dataset:
    """A solution as a dataset: u, velocity and the statistics of each step.

    Parameters
    ----------
    solution : Solution

    Returns
    -------
    xarray.Dataset
        Dimensions time, step and unknown, and kept_step for the velocities if not all steps were
        kept; each variable has `units` and `long_name`.

    Raises
    ------
    MissingExtraError
        If xarray is not installed.
    """
    kept = "step" if solution.complete else "kept_step"
    dataset = _xarray().Dataset(
        {
            "u": _variable(("time", "unknown"), solution.u, "u_n at the kept grid times"),
            "velocity": _variable(
                (kept, "unknown"), solution.velocity, "velocity u_n' in each kept step"
            ),
            **_steps(solution, DIMENSIONLESS),
        },
        {
            **_times(solution, DIMENSIONLESS),
            kept: _variable((kept,), solution.steps, "step, counted from 0"),
            "unknown": _variable(("unknown",), np.arange(solution.u.shape[1]), "unknown"),
        },
    )
    return dataset.assign_attrs(_attributes("A sweeping process", solution))


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
        **_steps(solution, units),
        **_energies(report.energy, units),
    }
    coordinates = {
        **_times(solution, units),
        "x": _variable(("node",), body.points[:, 0], "x coordinate of the node", units.length),
        "y": _variable(("node",), body.points[:, 1], "y coordinate of the node", units.length),
    }
    if report.slip is not None:
        variables |= _contact_variables(report.slip, units)
        coordinates |= _contact_coordinates(report)
    title = scene.title or report.name or "An antiplane problem"
    return (
        _xarray()
        .Dataset(variables, coordinates)
        .assign_attrs(
            _attributes(title, solution),
            Conventions="CF-1.11 UGRID-1.0",
            scene=report.text,
            units_of_the_scene=scene.units,
        )
    )


def _fields(body: Discretisation, solution: Solution, units: Units) -> dict[str, Any]:
    on_mesh = {"mesh": "mesh", "location": "node"}
    return {
        "displacement": _variable(
            ("time", "node"),
            body.expand(solution.u),
            "displacement out of the plane",
            units.length,
            **on_mesh,
        ),
        "velocity": _variable(
            ("step", "node"),
            body.expand(solution.velocity),
            "velocity out of the plane in each step",
            units.velocity,
            **on_mesh,
        ),
    }


def _mesh(body: Discretisation) -> dict[str, Any]:
    return {
        "mesh": _variable(
            (),
            np.int32(0),
            "mesh of triangles; a quadratic element counts as four",
            cf_role="mesh_topology",
            topology_dimension=np.int32(2),
            node_coordinates="x y",
            face_node_connectivity="triangles",
            face_dimension="triangle",
        ),
        "triangles": _variable(
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
    dataset = dataset_of(report)
    packed = {"zlib": True, "complevel": 1, "shuffle": True}
    encoding = {
        name: {**(packed if variable.size > 1000 else {}), "_FillValue": None}
        for name, variable in dataset.variables.items()
        if variable.dtype.kind in "if"
    }
    with replacing(path) as part:
        dataset.to_netcdf(part, engine="h5netcdf", encoding=encoding)


def _variable(
    dims: tuple[str, ...], values: Any, long_name: str, units: str = "1", **attributes: Any
) -> tuple[Any, ...]:
    return dims, values, {"long_name": long_name, "units": units, **attributes}


def _times(solution: Solution, units: Units) -> dict[str, Any]:
    step = np.arange(len(solution.stats))
    return {
        "time": _variable(("time",), solution.t, "time", units.time),
        "step": _variable(("step",), step, "step, counted from 0"),
        "step_end": _variable(
            ("step",), solution.stats["t"], "time at the end of the step", units.time
        ),
    }


def _steps(solution: Solution, units: Units) -> dict[str, Any]:
    stats = solution.stats
    described = {
        "certificate": ("largest error bound of the step's velocity programs", units.certificate),
        "relative": ("certificate relative to the size of the program, what tol bounds", "1"),
        "iterations": ("iterations of the solver", "1"),
        "attempts": ("solvers and settings tried; 0 where the body is at rest", "1"),
        "seconds": ("wall time of the step", "s"),
    }
    steps = {name: _variable(("step",), stats[name], *words) for name, words in described.items()}
    answered = "solver that answered the step"
    steps["solver"] = _variable(("step",), stats["solver"].astype(object), answered)
    viability = "bound of the distance of the step's force to C"
    steps["viability"] = _variable(("step",), solution.viability(), viability, units.viability)
    return steps


def _energies(energy: Energy, units: Units) -> dict[str, Any]:
    described = {
        "stored": "elastic energy 1/2 <B u, u>, its change since the start",
        "viscous": "energy dissipated by viscosity",
        "friction": "energy dissipated by friction",
        "work": "work of the loads",
    }
    return {
        f"energy_{name}": _variable(
            ("time",), getattr(energy, name), f"{words}, per length", units.energy
        )
        for name, words in described.items()
    }


def _contact_variables(slip: Slip, units: Units) -> dict[str, Any]:
    contact = slip.contact
    return {
        "contact_weight": _variable(
            ("contact",), contact.weight, "length of boundary of the contact node", units.length
        ),
        "friction_bound": _variable(
            ("contact",),
            contact.threshold,
            "friction force at which the node slips, weight times g, per length",
            units.force,
        ),
        "traction": _variable(
            ("step", "contact"),
            slip.traction,
            "friction traction on the body, against the slip",
            units.traction,
        ),
        "slip_state": _variable(
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
        "contact_node": _variable(
            ("contact",), report.scene.discretisation.free[contact.unknown], "node of the contact"
        ),
        "arc_length": _variable(
            ("contact",),
            contact.arc,
            "arc length from the start of the contact node's boundary",
            report.units.length,
        ),
        "boundary": _variable(
            ("contact",), contact.boundary.astype(object), "boundary of the contact node"
        ),
    }


def _attributes(title: str, solution: Solution) -> dict[str, Any]:
    versions = ", ".join(f"{name} {number}" for name, number in versions_of(solution).items())
    plan = solution.plan
    return {
        "title": title,
        "software": versions,
        "status": solution.status.name.lower(),
        "message": solution.message,
        "scheme": plan.scheme.name,
        "solver": solver_name(solution),
        "tol": plan.tol,
    }


def _xarray() -> Any:
    with brought_by("fem"):
        import xarray
    return xarray
