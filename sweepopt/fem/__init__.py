"""Bodies on finite elements: a scene declares effects, and only they exist.

    body(Discretisation(mesh, kind="solid"), effects=[...])     a scene from Python
    antiplane(mesh, clamped=..., effects=[...])                 in antiplane shear
    read_scene("tube.toml")                                     the same from a file of data

The model in antiplane shear: v in H^1 with v = 0 on Gamma_1,
a = int eta grad u . grad v, b = int kappa grad u . grad v, J(v) = int_{Gamma_3} g |v|,
<f, v> = int f0 v + int_{Gamma_2} f2 v. Of vectors a and b are those of their strains, and J has the
tangential velocity.
"""

from sweepopt import checks, errors

with errors.brought_by("fem"):
    import meshio
    import skfem

from sweepopt.fem.contact import Contact, Rows, Yield
from sweepopt.fem.effects import (
    BodyForce,
    Contribution,
    Dashpot,
    Effect,
    Eigenstrain,
    Elasticity,
    Foundation,
    Friction,
    MaxwellBranch,
    OneWay,
    PointForce,
    PrescribedDisplacement,
    Traction,
    Viscosity,
    YieldStress,
)
from sweepopt.fem.fields import Coefficient, Profile, SlipWeakening
from sweepopt.fem.mesh import chain, grid, read_mesh
from sweepopt.fem.plasticity import Plasticity
from sweepopt.fem.scene import Initial, Scene, antiplane, body
from sweepopt.fem.scene_file import EFFECTS, compare_effects, read_scene
from sweepopt.fem.spaces import Discretisation

__all__ = checks.face(globals())
