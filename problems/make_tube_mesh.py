"""Remake tube.msh: the section of a lined tube (needs gmsh: pip install gmsh).

An annulus 20 mm < r < 50 mm of six-node triangles with curved edges; a core up to r = 42 mm and a
sleeve around it. Lengths in metres. Angles count from the x axis.

    bonded    r = 50 mm, 240 to 300 degrees       glued to the housing
    contact   r = 50 mm, the rest                 pressed against the housing
    pulled    r = 20 mm, 10 to 130 degrees        where the rod drags the bore
    free      r = 20 mm, the rest
"""

from pathlib import Path

import gmsh
import numpy as np

BORE, INTERFACE, OUTSIDE = 0.020, 0.042, 0.050
BONDED, PULLED = (240.0, 300.0), (10.0, 130.0)
SIZE_BORE, SIZE_CONTACT = 3.1e-3, 2.45e-3


def circle(radius: float, angles: list[float], size: float) -> list[int]:
    """Counter-clockwise arcs of at most 120 degrees from angle to angle; closed."""
    geo = gmsh.model.geo
    center = geo.addPoint(0.0, 0.0, 0.0)
    turns = np.radians(angles)
    points = [geo.addPoint(radius * np.cos(a), radius * np.sin(a), 0.0, size) for a in turns]
    return [
        geo.addCircleArc(start, center, end)
        for start, end in zip(points, points[1:] + points[:1], strict=True)
    ]


def main() -> None:
    """Mesh and write beside this file."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.add("tube")
    geo = gmsh.model.geo
    bore = circle(BORE, [PULLED[0], PULLED[1], 270.0], SIZE_BORE)
    interface = circle(INTERFACE, [30.0, 150.0, 270.0], SIZE_CONTACT)
    outside = circle(OUTSIDE, [BONDED[0], BONDED[1], 60.0, 150.0], SIZE_CONTACT)
    loops = [geo.addCurveLoop(arcs) for arcs in (bore, interface, outside)]
    core = geo.addPlaneSurface([loops[1], loops[0]])
    sleeve = geo.addPlaneSurface([loops[2], loops[1]])
    geo.synchronize()
    groups = {
        "pulled": (1, bore[:1]),
        "free": (1, bore[1:]),
        "bonded": (1, outside[:1]),
        "contact": (1, outside[1:]),
        "core": (2, [core]),
        "sleeve": (2, [sleeve]),
    }
    for name, (dimension, members) in groups.items():
        gmsh.model.addPhysicalGroup(dimension, members, name=name)
    gmsh.option.setNumber("Mesh.Algorithm", 6)
    gmsh.model.mesh.generate(2)
    gmsh.model.mesh.setOrder(2)
    gmsh.option.setNumber("Mesh.MshFileVersion", 2.2)
    gmsh.write(str(Path(__file__).with_name("tube.msh")))
    gmsh.finalize()


if __name__ == "__main__":
    main()
