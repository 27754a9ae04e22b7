"""Antiplane frictional contact on finite elements: a scene declares effects, and only they exist.

    antiplane(mesh, clamped=..., effects=[...])     a scene from Python
    read_scene("tube.toml")                         the same from a file of data

The model: v in H^1 with v = 0 on Gamma_1,
a = int eta grad u . grad v, b = int kappa grad u . grad v, J(v) = int_{Gamma_3} g |v|,
<f, v> = int f0 v + int_{Gamma_2} f2 v.
"""

from sweepopt.errors import brought_by

with brought_by("fem"):
    import meshio  # noqa: F401
    import skfem  # noqa: F401

from sweepopt.fem.contact import Contact
from sweepopt.fem.effects import (
    BodyForce,
    Contribution,
    Effect,
    Elasticity,
    Friction,
    Traction,
    Viscosity,
)
from sweepopt.fem.fields import Profile
from sweepopt.fem.mesh import read_mesh
from sweepopt.fem.scene import Scene, antiplane
from sweepopt.fem.scene_file import EFFECTS, read_scene
from sweepopt.fem.spaces import Discretisation

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
