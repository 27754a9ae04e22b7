"""Files that outlive a run: NetCDF, a summary in JSON and VTU files for ParaView.

Every file is written beside its place and then moved there, so that a reader never meets half of
one, and a run that fails leaves the files of the run before it whole.
"""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sweepopt.errors import MissingExtraError
from sweepopt.slip import STATES, Slip, slip_of

if TYPE_CHECKING:
    import xarray as xr

    from sweepopt.fem import Scene
    from sweepopt.solution import Energy, Solution

SUMMARY = "summary.json"
MOST_VTU = 50
"""At most so many VTU files a run."""


class Units(NamedTuple):
    """Units of antiplane quantities; energies and forces are per length of the body."""

    time: str
    length: str
    velocity: str
    traction: str
    force: str
    energy: str
    certificate: str
    viability: str


DIMENSIONLESS = Units(*["1"] * len(Units._fields))
SI = Units("s", "m", "m s-1", "Pa", "N m-1", "J m-1", "W^0.5 m^-0.5", "W^0.5 m^-0.5")


@dataclass(frozen=True, eq=False)
class Report:
    """A run of a scene and what its files and pictures have in common.

    Attributes
    ----------
    name, text : str
        The scene's name and its file's text.
    scene : Scene
    solution : Solution
        With one step or more.
    slip : Slip or None
        None without friction.
    energy : Energy
    seconds : float
        Wall time of the solution.
    """

    name: str
    text: str
    scene: Scene
    solution: Solution
    slip: Slip | None
    energy: Energy
    seconds: float

    @property
    def units(self) -> Units:
        """Units of the scene's quantities."""
        if self.scene.units != "SI":
            return DIMENSIONLESS
        # with A = 0 the viability is measured in the metric of B (MATH.md, norms)
        rate_independent = self.solution.process.rate_independent
        return SI._replace(viability="N^0.5") if rate_independent else SI


def make_report(
    scene: Scene, solution: Solution, *, name: str = "", text: str = "", seconds: float = 0.0
) -> Report:
    """Compute slip and energies of a run, once."""
    slip, energy = slip_of(scene, solution), solution.energy()
    return Report(name, text, scene, solution, slip, energy, seconds)


# ---- NetCDF ---------------------------------------------------------------------------------


def to_xarray(solution: Solution) -> xr.Dataset:
    """A solution as a dataset: u, velocity and the statistics of each step.

    Parameters
    ----------
    solution : Solution

    Returns
    -------
    xarray.Dataset
        Dimensions time, step and unknown; each variable has `units` and `long_name`.

    Raises
    ------
    MissingExtraError
        If xarray is not installed.
    """
    dataset = _xarray().Dataset(
        {
            "u": _variable(("time", "unknown"), solution.u, "u_n at the grid times"),
            "velocity": _variable(
                ("step", "unknown"), solution.velocity, "velocity u_n' in each step"
            ),
            **_steps(solution, DIMENSIONLESS),
        },
        {
            **_times(solution, DIMENSIONLESS),
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
    body, on_mesh = scene.discretisation, {"mesh": "mesh", "location": "node"}
    variables = {
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


def write_netcdf(report: Report, path: Path) -> None:
    """Write `dataset_of` a run, compressed."""
    for package in ("h5netcdf", "h5py"):  # h5netcdf alone cannot write: h5py is its backend
        _installed(package, "fem")
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
    step = np.arange(len(solution.velocity))
    return {
        "time": _variable(("time",), solution.t, "time", units.time),
        "step": _variable(("step",), step, "step, counted from 0"),
        "step_end": _variable(("step",), solution.t[1:], "time at the end of the step", units.time),
    }


def _steps(solution: Solution, units: Units) -> dict[str, Any]:
    stats = solution.stats
    described = {
        "certificate": ("bound of the error of the step's velocity program", units.certificate),
        "relative": ("certificate relative to the size of the program, what tol bounds", "1"),
        "iterations": ("iterations of the solver", "1"),
        "attempts": ("solvers and settings tried; 0 where the body is at rest", "1"),
        "seconds": ("wall time of the step", "s"),
    }
    steps = {name: _variable(("step",), stats[name], *words) for name, words in described.items()}
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
    versions = ", ".join(f"{name} {number}" for name, number in _versions(solution).items())
    plan = solution.plan
    return {
        "title": title,
        "software": versions,
        "status": solution.status.name.lower(),
        "message": solution.message,
        "scheme": plan.scheme.name,
        "solver": _solver(solution),
        "tol": plan.tol,
    }


# ---- summary --------------------------------------------------------------------------------


def summary_of(report: Report, files: Sequence[str] = ()) -> dict[str, Any]:
    """The numbers of a run as plain JSON types; null where there is no finite number.

    Parameters
    ----------
    report : Report
    files : sequence of str
        What the run wrote, relative to its folder.
    """
    scene, solution, slip, energy = report.scene, report.solution, report.slip, report.energy
    plan, stats = solution.plan, solution.stats
    where, when = _largest(solution.u)
    return _plain(
        {
            "scene": report.name,
            "title": scene.title,
            "status": solution.status.name.lower(),
            "success": solution.success,
            "message": solution.message,
            "units": {"scene": scene.units, **report.units._asdict()},
            "settings": {
                "t_end": scene.t_end,
                "t_reached": solution.t[-1],
                "steps": len(solution.velocity),
                "scheme": plan.scheme.name,
                "solver": _solver(solution),
                "tol": plan.tol,
            },
            "plan": {
                "unknowns": plan.unknowns,
                "nonsmooth_unknowns": plan.nonsmooth_unknowns,
                "left_out": scene.left_out,
            },
            "max_displacement": {
                "value": np.abs(solution.u[when, where]),
                "time": solution.t[when],
                "point": scene.discretisation.points[scene.discretisation.free[where]],
            },
            "energy": {
                **{name: values[-1] for name, values in energy._asdict().items()},
                "balance": energy.balance[-1],
            },
            "slip": None if slip is None else slip.statistics()._asdict(),
            "worst": {
                "certificate": stats["certificate"].max(),
                "relative": stats["relative"].max(),
                "viability": solution.viability().max(),
            },
            "iterations": stats["iterations"].sum(),
            "seconds": report.seconds,
            "materials": {name: k for k, name in enumerate(_materials(scene), start=1)},
            "versions": {"python": platform.python_version(), **_versions(solution)},
            "files": files,
        }
    )


def write_summary(report: Report, folder: Path, files: Sequence[str]) -> None:
    """Write `summary_of` a run, and remove what an earlier run listed there and this one has not.

    A picture or a VTU file of an earlier run would otherwise pass for one of this run.
    """
    path = folder / SUMMARY
    earlier = _listed(path)
    with replacing(path) as part:
        text = json.dumps(summary_of(report, files), indent=2, allow_nan=False)
        part.write_text(text + "\n", encoding="utf-8")
    for name in earlier - set(files):
        (folder / name).unlink(missing_ok=True)


def _listed(path: Path) -> set[str]:
    """Results that a summary says an earlier run wrote; nothing if it is no summary of ours."""
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
        names = summary["files"] if "sweepopt" in summary["versions"] else []
        return {str(name) for name in names if _is_result(Path(str(name)))}
    except (OSError, ValueError, KeyError, TypeError):
        return set()


def _is_result(name: Path) -> bool:
    inside = not name.is_absolute() and ".." not in name.parts
    return inside and name.suffix in (".nc", ".png", ".vtu", ".series")


def _largest(u: np.ndarray) -> tuple[int, int]:
    """Unknown and time index of the largest displacement."""
    when, where = np.unravel_index(int(np.argmax(np.abs(u))), u.shape)
    return int(where), int(when)


def _plain(value: Any) -> Any:
    """Plain JSON types; None for a number that is not finite."""
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def _solver(solution: Solution) -> str:
    solvers = solution.plan.solvers
    return solvers[0].name if solvers else "linear"


def _versions(solution: Solution) -> dict[str, str]:
    """Versions of what computed the solution; its solver is one of them."""
    solver = _solver(solution).split(":")[-1]
    names = ["sweepopt", "numpy", "scipy", "cvxpy", "scikit-fem", solver]
    found = {}
    for name in dict.fromkeys(names):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    from sweepopt import __version__  # a clone on the path has no metadata

    return {**found, "sweepopt": __version__}


# ---- VTU ------------------------------------------------------------------------------------


def write_vtu(report: Report, folder: Path) -> list[Path]:
    """Write `vtu/step_*.vtu` at even times, at most 50, and the series that ParaView opens.

    Point data are displacement and velocity (of the step that ends there; of the first step at the
    start), cell data the number of the material in the summary's `materials`, 0 for none.

    Returns
    -------
    list of Path
        The series first.
    """
    _installed("meshio", "fem")
    import meshio

    scene, solution = report.scene, report.solution
    body = scene.discretisation
    kind = {3: "triangle", 6: "triangle6"}[len(body.basis.element_dofs)]
    points = np.column_stack([body.points, np.zeros(len(body.points))])
    cells = [(kind, np.ascontiguousarray(body.basis.element_dofs.T))]
    groups = _materials(scene)
    material = np.zeros(body.mesh.nelements, dtype=np.int32)
    for k, members in enumerate(groups.values(), start=1):
        material[members] = k
    folder = folder / "vtu"
    folder.mkdir(parents=True, exist_ok=True)
    last = len(solution.velocity)
    stride = -(-last // (MOST_VTU - 1))
    written, entries = [], []
    for i in [*range(0, last, stride), last]:
        mesh = meshio.Mesh(
            points,
            cells,
            point_data={
                "displacement": body.expand(solution.u[i]),
                "velocity": body.expand(solution.velocity[max(i - 1, 0)]),
            },
            cell_data={"material": [material]} if groups else None,
        )
        path = folder / f"step_{i:06d}.vtu"
        with replacing(path) as part:
            meshio.write(part, mesh, file_format="vtu", compression="zlib")
        written.append(path)
        entries.append({"name": path.name, "time": float(solution.t[i])})
    series = folder / "solution.vtu.series"
    with replacing(series) as part:
        text = json.dumps({"file-series-version": "1.0", "files": entries}, indent=1)
        part.write_text(text + "\n", encoding="utf-8")
    return [series, *written]


def _materials(scene: Scene) -> dict[str, Any]:
    """Triangles of each named subdomain."""
    return dict(scene.discretisation.mesh.subdomains or {})


# ---- common ---------------------------------------------------------------------------------


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A new file that takes the place of `path` when the block ends well, and else disappears."""
    part = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        yield part
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def _xarray() -> Any:
    try:
        import xarray
    except ImportError as error:
        raise MissingExtraError("xarray", "fem") from error
    return xarray


def _installed(package: str, extra: str) -> None:
    try:
        __import__(package)
    except ImportError as error:
        raise MissingExtraError(package, extra) from error
