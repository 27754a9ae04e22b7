"""What a run of a scene leaves behind: a summary in JSON, a NetCDF file, VTU files for ParaView.

Every file is written beside its place and then moved there, so that a reader never meets half of
one, and a run that fails leaves the files of the run before it whole. Pictures are made by
`sweepopt.fem.pictures`.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import meshio
import numpy as np

from sweepopt import io
from sweepopt.fem import pictures
from sweepopt.fem.contact import Slip, signed_lengths, slip_of
from sweepopt.plot import MOST_FRAMES, even_steps
from sweepopt.results import Dataset, dataset_of, software, solver_name, variable, write_dataset

if TYPE_CHECKING:
    from sweepopt.fem.scene import Scene
    from sweepopt.fem.spaces import Discretisation
    from sweepopt.results import Energy, Solution

SUMMARY = "summary.json"
RESULTS = ("*.nc", "*.png", "*.gif", "*.mp4", "vtu/*.series", "vtu/*.vtu")
"""Files of a run; those that the summary lists are removed by the next run in the same folder."""
VTK = {"P1": ("line", "triangle", "tetra"), "P2": ("line3", "triangle6", "tetra10")}
"""Cells of VTK files on meshes of dimension 1, 2 and 3."""
WEIGHTS, TRACTIONS = ("1", "m", "m2", "m3"), ("N", "N/m", "Pa", "Pa/m")
"""Units of the weight of a contact node and of tractions, by the dimension of what slips.

Where forces are per length, tractions have the next unit. Stresses have the same units, by the
dimension of the body: a bar, a sheet (moduli times thickness), a solid.
"""


TIMES = {
    " yr": 365.25 * 86400.0,
    " d": 86400.0,
    " h": 3600.0,
    " s": 1.0,
    " ms": 1e-3,
    " \N{MICRO SIGN}s": 1e-6,
}
"""Units of time in words and pictures, in seconds."""


def unit_of_time(scene: Scene, end: float) -> tuple[str, float]:
    """The longest unit of time that is no longer than a run of a scene, and its seconds."""
    if scene.units != "SI":
        return "", 1.0
    return next((one for one in TIMES.items() if one[1] <= end), (" s", 1.0))


@dataclass(frozen=True, eq=False)
class Report:
    """A run of a scene and what its files and pictures have in common.

    Parameters
    ----------
    scene : Scene
    solution : Solution
        With one step or more.
    name, text : str
        The scene's name and its file's text.
    seconds : float
        Wall time of the solution.

    Attributes
    ----------
    slip : Slip or None
        None without friction.
    energy : Energy
    """

    scene: Scene
    solution: Solution
    name: str = ""
    text: str = ""
    seconds: float = 0.0

    def __post_init__(self) -> None:
        self.scene.require_run(self.solution)

    @property
    def body(self) -> Discretisation:
        """The space of the scene."""
        return self.scene.discretisation

    def at(self, name: str, steps: np.ndarray) -> Any:
        """What the scene calls so ("displacement", "stress") at the ends of steps; -1 is t = 0."""
        return getattr(self.scene, name)(self.solution, self.solution.t[steps + 1])

    @cached_property
    def slip(self) -> Any:
        """What the contact does, a `Slip`; None without friction."""
        return slip_of(self.scene, self.solution)

    @cached_property
    def energy(self) -> Energy:
        """The energies of the run."""
        return self.solution.energy()

    @property
    def units(self) -> dict[str, str]:
        """Units of the scene's quantities; energies and forces of sections are per length."""
        body, contact = self.body, self.scene.contact
        dimension, names = body.mesh.dim(), () if contact is None else contact.boundary
        inside = not set(names) <= set(body.mesh.boundaries or ())
        size = 0 if body.lumped else dimension - (not inside)
        per_length = dimension == 2 and not (inside and body.kind == "plane stress")
        per, root = ("/m", "W^0.5 m^-0.5") if per_length else ("", "W^0.5")
        units = {
            "time": "s",
            "length": "m",
            "velocity": "m/s",
            "stress": TRACTIONS[dimension - 1 + per_length],
            "force": f"N{per}",
            "energy": f"J{per}",
            "certificate": root,
            "viability": root,
            "weight": WEIGHTS[size],
            "traction": TRACTIONS[size + per_length],
        }
        return units if self.scene.units == "SI" else dict.fromkeys(units, "1")

    def suffix(self, quantity: str) -> str:
        """The unit behind a number, such as " m"; nothing in a dimensionless scene."""
        unit = self.units[quantity]
        return f" {unit}" if unit != "1" else ""

    @property
    def clock(self) -> tuple[str, float]:
        """The unit of the times of the run, and its seconds."""
        return unit_of_time(self.scene, self.solution.t[-1])

    def moment(self, t: float) -> str:
        """A time in words."""
        unit, seconds = self.clock
        return f"t = {t / seconds:.5g}{unit}"


def write(report: Report, folder: Path, picture_files: Sequence[str]) -> list[str]:
    """Write all files of a run, pictures by their names; what was written, the summary last."""
    write_dataset(dataset_on_mesh(report), folder / "solution.nc")
    for path in map(folder.joinpath, picture_files):
        if path.suffix != ".png":
            pictures.animate(report, path, path.stem)
            continue
        with io.replacing(path) as part:
            pictures.draw(report, path.stem).savefig(part)
    series = [path.relative_to(folder).as_posix() for path in write_vtu(report, folder)]
    files = ["solution.nc", *picture_files, *series]
    write_summary(report, folder, files)
    return [*files, SUMMARY]


def summary_of(report: Report, files: Sequence[str] = ()) -> dict[str, Any]:
    """The numbers of a run as plain JSON types; null where there is no finite number.

    `files` are what the run wrote, relative to its folder.
    """
    scene, solution, slip, energy = report.scene, report.solution, report.slip, report.energy
    plan, stats = solution.plan, solution.stats
    summary = {
        "scene": report.name,
        "title": scene.title,
        "changes": scene.changes,
        "status": solution.status.name.lower(),
        "success": solution.success,
        "message": solution.message,
        "units": {"scene": scene.units, **report.units},
        "settings": {
            "t_end": scene.t_end,
            "t_reached": solution.t[-1],
            "steps": len(solution.steps),
            "scheme": plan.scheme.name,
            "solver": solver_name(solution),
            "tol": plan.tol,
        },
        "plan": {
            "unknowns": plan.unknowns,
            "nonsmooth_unknowns": plan.nonsmooth_unknowns,
            "left_out": scene.left_out,
        },
        "max_displacement": largest(report),
        "energy": {
            name: x[-1] for name, x in [*energy._asdict().items(), ("balance", energy.balance)]
        },
        "slip": None if slip is None else slip.statistics()._asdict(),
        "worst": {
            "certificate": stats["certificate"].max(),
            "relative": stats["relative"].max(),
            "viability": solution.viability().max(),
        },
        "solvers": Counter(stats["solver"].tolist()),
        "iterations": stats["iterations"].sum(),
        "seconds": report.seconds,
        "materials": {
            name: k for k, name in enumerate(scene.discretisation.mesh.subdomains or {}, start=1)
        },
        "versions": software(solution),
        "files": files,
    }
    text = json.dumps(summary, default=lambda array: array.tolist())
    return json.loads(text, parse_constant=lambda _: None)


def largest(report: Report) -> dict[str, Any]:
    """The largest displacement, with its time and place."""
    u = report.scene.displacement(report.solution)
    size = np.abs(signed_lengths(u))
    when, where = np.unravel_index(np.argmax(size), size.shape)
    point = report.body.points[where]
    return {"value": size[when, where], "time": report.solution.t[when], "point": point}


def write_summary(report: Report, folder: Path, files: Sequence[str]) -> None:
    """Write `summary_of` a run, and remove files of the run before that this one has not written.

    A picture or a VTU file of that run would otherwise pass for one of this run. Only files that
    the summary of that run lists are removed; what else is in the folder is somebody's own.
    """
    try:
        earlier = set(json.loads((folder / SUMMARY).read_bytes())["files"])
    except (OSError, ValueError, LookupError, TypeError, RecursionError):  # none, or none of ours
        earlier = set()
    _write_json(folder / SUMMARY, summary_of(report, files))
    for path in [path for pattern in RESULTS for path in folder.glob(pattern)]:
        if path.is_file() and path.relative_to(folder).as_posix() in earlier.difference(files):
            path.unlink()


Variables = dict[str, tuple[str, str, Any, str]]
"""Dimensions, quantity, values and description of what a run's file adds to the solution's own."""
ENERGIES = {
    "stored": "change of elastic energy",
    "viscous": "lost to viscosity",
    "friction": "lost to friction and yielding",
    "work": "work of the loads",
}
STATE = "unknowns at the end of the run, internal ones such as plastic strains too"
WEIGHT = "length, area or volume that it stands for"
PLASTIC = "sqrt(2/3) |p| of the plastic strain p, its mean in each cell of the mesh"


def dataset_on_mesh(report: Report) -> Dataset:
    """A run as a dataset on its mesh: what `solution.nc` holds.

    Dimensions are time, step, node (clamped ones too), triangle, corner and contact.
    """
    scene, solution, units = report.scene, report.solution, report.units
    rows = _of_mesh(report) | {
        f"energy_{name}": ("time", "energy", getattr(report.energy, name), words)
        for name, words in ENERGIES.items()
    }
    if report.slip is not None:
        rows |= _of_contact(report.slip)
    if (strain := scene.plastic_strain(solution)) is not None:
        rows["plastic_strain"] = "time cell", "", strain, PLASTIC
    run = dataset_of(solution)
    del run.variables["velocity"]
    rows["u"] = "unknown", "", solution.u[-1], STATE
    for name, (dimensions, quantity, values, words) in rows.items():
        run.variables[name] = variable(dimensions, values, words, units.get(quantity, "1"))
    for name in ("time", "certificate", "viability"):
        run.variables[name][2]["units"] = units[name]
    run.variables["step_end"][2]["units"] = units["time"]
    run.coordinates |= {"x", "y", "z", "contact_node", "boundary", "arc_length"} & set(rows)
    run.attributes |= {
        "title": scene.title or report.name or "A body with friction",
        "Conventions": "CF-1.11",
        "scene": report.text,
        "units_of_the_scene": scene.units,
    }
    return run


def _of_mesh(report: Report) -> Variables:
    """Fields at the nodes, and where these are."""
    scene, body = report.scene, report.body
    u, velocity = scene.displacement(report.solution), scene.velocity(report.solution)
    vector = " component" if body.components > 1 else ""
    rows = {
        "displacement": (f"time node{vector}", "length", u, "displacement"),
        "velocity": (f"step node{vector}", "velocity", velocity, "velocity in each step"),
    }
    if body.triangles.size:  # a bar has no faces
        words = "nodes of each triangle; a quadratic element counts as four"
        rows["triangles"] = "triangle corner", "", np.int32(body.triangles), words
    for axis, place in zip("xyz", body.points.T, strict=False):
        rows[axis] = "node", "length", place, f"{axis} coordinate of the node"
    return rows


def _of_contact(slip: Slip) -> Variables:
    """What `dataset_on_mesh` adds for the nodes with friction."""
    contact, names = slip.contact, slip.contact.boundary.astype(object)
    along = " component" if contact.unknown.ndim > 1 else ""
    return {
        "contact_node": ("contact", "", contact.node, "node of the contact"),
        "boundary": ("contact", "", names, "boundary of the contact node"),
        "arc_length": ("contact", "length", contact.arc, "arc length along the boundaries"),
        "contact_weight": ("contact", "weight", contact.weight, WEIGHT),
        "friction_bound": ("contact", "force", contact.threshold, "force at which it slips, w g"),
        "traction": (f"step contact{along}", "traction", slip.traction, "friction, against slip"),
        "slip_state": ("step contact", "", slip.state, "1, 0, -1: slips forward, sticks, back"),
    }


def write_vtu(report: Report, folder: Path) -> list[Path]:
    """Write `vtu/step_*.vtu` at even times, at most 50, and the series that ParaView opens.

    Point data are displacement and velocity (of the step that ends there; of the first step at the
    start), cell data the number of the material in the summary's `materials`, 0 for none, and the
    stress and the plastic strain where there is one.

    Returns
    -------
    list of Path
        The series first.
    """
    body = report.body

    def in_space(x: np.ndarray) -> np.ndarray:  # ParaView's points and vectors are in space
        return x if x.ndim == 1 else np.pad(x, ((0, 0), (0, 3 - x.shape[1])))

    cells = body.scalar.element_dofs.T
    kind = VTK[body.element][body.mesh.dim() - 1]
    mesh = meshio.Mesh(in_space(body.points), {kind: cells})
    if body.mesh.subdomains:
        material = np.zeros(len(cells), dtype=np.int32)
        for k, members in enumerate(body.mesh.subdomains.values(), start=1):
            material[members] = k
        mesh.cell_data = {"material": [material]}
    folder = folder / "vtu"
    io.folder_at("folder", folder)
    steps = np.append(-1, even_steps(report.solution, MOST_FRAMES - 1))
    in_points = {name: report.at(name, steps) for name in ("displacement", "velocity")}
    in_cells = {name: report.at(name, steps) for name in ("stress", "plastic_strain")}
    files = [folder / f"step_{i:06d}.vtu" for i in steps + 1]
    for k, path in enumerate(files):
        mesh.point_data = {name: in_space(x[k]) for name, x in in_points.items()}
        mesh.cell_data |= {name: [x[k]] for name, x in in_cells.items() if x is not None}
        with io.replacing(path) as part:
            mesh.write(part, file_format="vtu", compression="zlib")
    series = folder / "solution.vtu.series"
    times = zip(files, report.solution.t[steps + 1].tolist(), strict=True)
    entries = [{"name": path.name, "time": time} for path, time in times]
    _write_json(series, {"file-series-version": "1.0", "files": entries})
    return [series, *files]


def _write_json(path: Path, content: dict[str, Any]) -> None:
    io.put(path, (json.dumps(content, indent=2, allow_nan=False) + "\n").encode())
