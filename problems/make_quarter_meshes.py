"""Remake ring.msh and plate.msh: quarters of a thick ring and of a square plate with a hole.

Six-node triangles with curved edges, from a grid in two directions: s from the inner side outwards
and the angle. Lengths in metres; the quarters lie at x, y >= 0.

    ring    1 < r < 1.3; inner, x_axis, y_axis
    plate   half the side 0.1, radius of the hole 0.01, cells smallest there; x_axis, y_axis, top
"""

from pathlib import Path

import meshio
import numpy as np
import skfem


def quarter(lines: list[np.ndarray], curved: bool) -> skfem.MeshTri2:
    """The ring, or the plate with a hole."""
    mesh = skfem.MeshTri2.from_mesh(skfem.MeshTri.init_tensor(*lines))
    s, a = mesh.doflocs
    turn = np.array([np.cos(np.pi * a / 2), np.sin(np.pi * a / 2)])
    if curved:
        return skfem.MeshTri2((1 + 0.3 * s) * turn, mesh.t)
    side = np.where(a <= 0.5, [0 * a + 0.1, 0.2 * a], [0.2 * (1 - a), 0 * a + 0.1])
    return skfem.MeshTri2(0.01 * turn * (1 - s) + side * s, mesh.t)


def write(name: str, mesh: skfem.MeshTri2, sides: dict[str, np.ndarray]) -> None:
    """Nodes, triangles and the edges of each side, whose points are given by a mask."""
    triangles = mesh.dofs.element_dofs.T
    groups, lines = {}, []
    for k, (side, mask) in enumerate(sides.items(), start=1):
        groups[side] = np.array([k, 1])
        edges = np.vstack([triangles[:, list(e)] for e in ((0, 1, 3), (1, 2, 4), (2, 0, 5))])
        lines.append(edges[mask[edges].all(axis=1)])
    cells = [("line3", one) for one in lines] + [("triangle6", triangles)]
    numbers = [np.full(len(one), k) for k, one in enumerate(lines, start=1)]
    numbers.append(np.zeros(len(triangles), dtype=int))
    data = {"gmsh:physical": numbers, "gmsh:geometrical": numbers}
    points = np.pad(mesh.doflocs.T, ((0, 0), (0, 1)))
    meshio.Mesh(points, cells, cell_data=data, field_data=groups).write(
        Path(__file__).with_name(name), file_format="gmsh22", binary=False, float_fmt=".12g"
    )


def main() -> None:
    """Mesh and write beside this file."""
    ring = quarter([np.linspace(0, 1, 9), np.linspace(0, 1, 41)], curved=True)
    x, y = ring.doflocs
    axes = {"x_axis": np.abs(y) < 1e-12, "y_axis": np.abs(x) < 1e-12}
    write("ring.msh", ring, axes | {"inner": np.hypot(x, y) < 1 + 1e-9})
    cells = np.linspace(0.0, 1.0, 23)
    plate = quarter([np.expm1(3 * cells) / np.expm1(3), cells], curved=False)
    x, y = plate.doflocs
    axes = {"x_axis": np.abs(y) < 1e-12, "y_axis": np.abs(x) < 1e-12}
    write("plate.msh", plate, axes | {"top": np.abs(y - 0.1) < 1e-12})


if __name__ == "__main__":
    main()
