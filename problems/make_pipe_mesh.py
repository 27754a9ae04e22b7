"""Remake pipe.msh: rings of curved six-node triangles on a disc of 5 mm, thin ones at the wall.

Bingham's flow near its limit is sheared in a thin layer at the wall. With a plug of radius r the
flux errs by about 0.15 (h/(R - r))^2, where h is the width of the ring in which the plug ends: the
nearer to the wall, the thinner are the rings, up to r = 0.9 R. Edges along rings are arcs.
"""

from pathlib import Path

import meshio
import numpy as np

RADIUS = 5e-3  # m
RINGS = [0.17, 0.33, 0.5, 0.65, 0.75, 0.82, 0.88, 0.94, 1.0]  # where they end, in radii
ARCS = [1, 2, 3, 3, 3, 4, 4, 4, 4]  # on a sixth of each


def main() -> None:
    """Mesh and write beside this file."""
    first = np.cumsum([0, 1, *(6 * arcs for arcs in ARCS)])  # node of the centre, of each ring
    radius, angle = np.repeat([0, *RINGS], np.diff(first)), np.zeros(first[-1])
    triangles, turn = [], 0.0
    for k, (arcs, inside) in enumerate(zip(ARCS, [0, *ARCS], strict=False), start=1):
        turn -= 0.5 * (arcs == inside)  # of an arc: its middle is before the node inside
        angle[first[k] : first[k + 1]] = (np.arange(6 * arcs) + turn) * np.pi / (3 * arcs)
        for sixth in range(6):
            outer, inner = (
                [first[ring] + (sixth * n + j) % max(6 * n, 1) for j in range(n + 1)]
                for ring, n in ((k, arcs), (k - 1, inside))
            )
            triangles += zip(outer, outer[1:], inner, strict=False)
            triangles += zip(inner, outer[1:], inner[1:], strict=False)
    corners = np.array(triangles)
    ends = np.sort(np.vstack([corners, np.roll(corners, -1, axis=1)]).reshape(2, -1), axis=0).T
    edges, edge, count = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    towards = np.column_stack([np.cos(angle), np.sin(angle)]) * (radius > 0)[:, None]
    middles = towards[edges].sum(axis=1)  # of edges: half way in radius and in angle
    middles *= (radius[edges].mean(axis=1) / np.linalg.norm(middles, axis=1))[:, None]
    number, wall = first[-1] + np.arange(len(edges)), count == 1
    lines = np.column_stack([edges, number])[wall]
    cells = np.hstack([corners, number[edge.reshape(corners.shape)]])
    tags = [np.full(len(lines), 1), np.full(len(cells), 2)]
    mesh = meshio.Mesh(
        RADIUS * np.vstack([radius[:, None] * towards, middles]),
        [("line3", lines), ("triangle6", cells)],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={"wall": np.array([1, 1]), "body": np.array([2, 2])},
    )
    path = Path(__file__).with_name("pipe.msh")
    meshio.write(path, mesh, file_format="gmsh22", binary=False, float_fmt=".16g")


if __name__ == "__main__":
    main()
