"""VTU files and their series for ParaView."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from sweepopt.errors import brought_by
from sweepopt.fem.report import Report, materials_of
from sweepopt.io import replacing

MOST_VTU = 50
"""At most so many VTU files a run."""


def write_vtu(report: Report, folder: Path) -> list[Path]:
    """Write `vtu/step_*.vtu` at even times, at most 50, and the series that ParaView opens.

    Point data are displacement and velocity (of the step that ends there; of the first step at the
    start), cell data the number of the material in the summary's `materials`, 0 for none.

    Returns
    -------
    list of Path
        The series first.
    """
    with brought_by("fem"):
        import meshio

    scene, solution = report.scene, report.solution
    body = scene.discretisation
    kind = {3: "triangle", 6: "triangle6"}[len(body.basis.element_dofs)]
    points = np.column_stack([body.points, np.zeros(len(body.points))])
    cells = [(kind, np.ascontiguousarray(body.basis.element_dofs.T))]
    groups = materials_of(scene)
    material = np.zeros(body.mesh.nelements, dtype=np.int32)
    for k, members in enumerate(groups.values(), start=1):
        material[members] = k
    folder = folder / "vtu"
    folder.mkdir(parents=True, exist_ok=True)
    last = len(solution.steps)
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
