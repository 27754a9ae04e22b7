"""Remake pipe.msh: rings of six-node triangles on a disc of 5 mm, curved along the wall."""

from pathlib import Path

import meshio
import numpy as np

RADIUS, RINGS = 5e-3, 7  # m


def main() -> None:
    """Mesh and write beside this file."""
    rings = range(1, RINGS + 1)
    first = [0, *(3 * k * (k - 1) + 1 for k in rings)]  # node of each ring
    angle = np.concatenate([np.zeros(1), *(np.arange(6 * k) * np.pi / (3 * k) for k in rings)])
    radius = np.repeat([0, *rings], [1, *(6 * k for k in rings)]) / RINGS
    triangles = []
    for k in rings:
        for side in range(6):
            outer = [first[k] + (side * k + j) % (6 * k) for j in range(k + 1)]
            inner = [first[k - 1] + (side * (k - 1) + j) % max(6 * (k - 1), 1) for j in range(k)]
            triangles += zip(outer, outer[1:], inner, strict=False)
            triangles += zip(inner, outer[1:], inner[1:], strict=False)
    corners = np.array(triangles)
    ends = np.sort(np.vstack([corners, np.roll(corners, -1, axis=1)]).reshape(2, -1), axis=0).T
    edges, edge, count = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    points = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    middles, wall = points[edges].mean(axis=1), count == 1
    middles[wall] /= np.linalg.norm(middles[wall], axis=1, keepdims=True)
    number = len(points) + np.arange(len(edges))
    lines = np.column_stack([edges, number])[wall]
    cells = np.hstack([corners, number[edge.reshape(corners.shape)]])
    tags = [np.full(len(lines), 1), np.full(len(cells), 2)]
    mesh = meshio.Mesh(
        RADIUS * np.vstack([points, middles]),
        [("line3", lines), ("triangle6", cells)],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={"wall": np.array([1, 1]), "body": np.array([2, 2])},
    )
    path = Path(__file__).with_name("pipe.msh")
    meshio.write(path, mesh, file_format="gmsh22", binary=False, float_fmt=".16g")


if __name__ == "__main__":
    main()
