"""What a run of a scene leaves behind: a summary in JSON and VTU files for ParaView.

Every file is written beside its place and then moved there, so that a reader never meets half of
one, and a run that fails leaves the files of the run before it whole. Pictures are made by
`sweepopt.fem.pictures`, the NetCDF file by `sweepopt.fem.netcdf`.
"""

from __future__ import annotations

import json
import platform
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import meshio
import numpy as np

from sweepopt import io
from sweepopt.fem.contact import Slip, slip_of
from sweepopt.results import software, solver_name

if TYPE_CHECKING:
    from sweepopt.fem.scene import Scene
    from sweepopt.results import Energy, Solution

SUMMARY = "summary.json"
MOST_VTU = 50
"""VTU files of a run: enough for a film, few enough for a large mesh."""


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
        return SI if self.scene.units == "SI" else DIMENSIONLESS


def make_report(
    scene: Scene, solution: Solution, *, name: str = "", text: str = "", seconds: float = 0.0
) -> Report:
    """Compute slip and energies of a run, once."""
    slip, energy = slip_of(scene, solution), solution.energy()
    return Report(name, text, scene, solution, slip, energy, seconds)


def summary_of(report: Report, files: Sequence[str] = ()) -> dict[str, Any]:
    """The numbers of a run as plain JSON types; null where there is no finite number.

    Parameters
    ----------
    report : Report
    files : sequence of str
        What the run wrote, relative to its folder.
    """
    scene, solution, slip, energy = report.scene, report.solution, report.slip, report.energy
    body, plan, stats = scene.discretisation, solution.plan, solution.stats
    size = np.abs(solution.u)
    when, where = np.unravel_index(int(np.argmax(size)), size.shape)
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
            "max_displacement": {
                "value": size[when, where],
                "time": solution.t[when],
                "point": body.points[body.free[where]],
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
            "solvers": Counter(stats["solver"].tolist()),
            "iterations": stats["iterations"].sum(),
            "seconds": report.seconds,
            "materials": {name: k for k, name in enumerate(body.mesh.subdomains or {}, start=1)},
            "versions": {"python": platform.python_version(), **software(solution)},
            "files": files,
        }
    )


def write_summary(report: Report, folder: Path, files: Sequence[str]) -> None:
    """Write `summary_of` a run, and remove what an earlier run listed there and this one has not.

    A picture or a VTU file of an earlier run would otherwise pass for one of this run.
    """
    path = folder / SUMMARY
    earlier = _listed(path)
    _write_json(path, summary_of(report, files))
    for name in earlier - set(files):
        (folder / name).unlink(missing_ok=True)


def write_vtu(report: Report, folder: Path) -> list[Path]:
    """Write `vtu/step_*.vtu` at even times, at most 50, and the series that ParaView opens.

    Point data are displacement and velocity (of the step that ends there; of the first step at the
    start), cell data the number of the material in the summary's `materials`, 0 for none.

    Returns
    -------
    list of Path
        The series first.
    """
    solution, body = report.solution, report.scene.discretisation
    nodes = np.ascontiguousarray(body.basis.element_dofs.T)
    cells = [({3: "triangle", 6: "triangle6"}[nodes.shape[1]], nodes)]
    points = np.column_stack([body.points, np.zeros(len(body.points))])
    groups = dict(body.mesh.subdomains or {})
    material = np.zeros(body.mesh.nelements, dtype=np.int32)
    for k, members in enumerate(groups.values(), start=1):
        material[members] = k
    folder = folder / "vtu"
    folder.mkdir(parents=True, exist_ok=True)
    last = len(solution.steps)
    stride = -(-last // (MOST_VTU - 1))
    written, entries = [], []
    for i in [*range(0, last, stride), last]:
        fields = {
            "displacement": body.expand(solution.u[i]),
            "velocity": body.expand(solution.velocity[max(i - 1, 0)]),
        }
        materials = {"material": [material]} if groups else None
        mesh = meshio.Mesh(points, cells, point_data=fields, cell_data=materials)
        path = folder / f"step_{i:06d}.vtu"
        with io.replacing(path) as part:
            meshio.write(part, mesh, file_format="vtu", compression="zlib")
        written.append(path)
        entries.append({"name": path.name, "time": float(solution.t[i])})
    series = folder / "solution.vtu.series"
    _write_json(series, {"file-series-version": "1.0", "files": entries})
    return [series, *written]


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    io.put(path, (json.dumps(content, indent=2, allow_nan=False) + "\n").encode())


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
