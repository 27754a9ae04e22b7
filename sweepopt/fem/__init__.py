"""Antiplane frictional contact on finite elements: a scene declares effects, and only they exist.

    antiplane(mesh, clamped=..., effects=[...])     a scene from Python
    read_scene("tube.toml")                         the same from a file of data

The model: v in H^1 with v = 0 on Gamma_1,
a = int eta grad u . grad v, b = int kappa grad u . grad v, J(v) = int_{Gamma_3} g |v|,
<f, v> = int f0 v + int_{Gamma_2} f2 v.
"""

from importlib.util import find_spec

from sweepopt.errors import MissingExtraError

for _module, _package in (("skfem", "scikit-fem"), ("meshio", "meshio")):
    if find_spec(_module) is None:
        raise MissingExtraError(_package, "fem")

from sweepopt.fem.contact import Contact  # noqa: E402
from sweepopt.fem.effects import (  # noqa: E402
    BodyForce,
    Contribution,
    Effect,
    Elasticity,
    Friction,
    Traction,
    Viscosity,
)
from sweepopt.fem.fields import Profile  # noqa: E402
from sweepopt.fem.mesh import read_mesh  # noqa: E402
from sweepopt.fem.scene import Scene, antiplane  # noqa: E402
from sweepopt.fem.scene_file import EFFECTS, read_scene  # noqa: E402
from sweepopt.fem.spaces import Discretisation  # noqa: E402

__all__ = [
    "EFFECTS",
    "BodyForce",
    "Contact",
    "Contribution",
    "Discretisation",
    "Effect",
    "Elasticity",
    "Friction",
    "Profile",
    "Scene",
    "Traction",
    "Viscosity",
    "antiplane",
    "read_mesh",
    "read_scene",
]
