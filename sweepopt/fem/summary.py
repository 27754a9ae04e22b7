"""The numbers of a run as JSON, and the list of the files it wrote."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sweepopt.fem.report import (
    Report,
    materials_of,
    solver_counts,
)
from sweepopt.io import replacing
from sweepopt.results import software, solver_name

SUMMARY = "summary.json"


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
            "solvers": solver_counts(solution),
            "iterations": stats["iterations"].sum(),
            "seconds": report.seconds,
            "materials": {name: k for k, name in enumerate(materials_of(scene), start=1)},
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
