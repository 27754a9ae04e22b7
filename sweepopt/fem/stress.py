"""What a run makes of the cells of a body: their stress and their plastic strain, a number each.

The deviator of the stress is the sum of what effects add to it, at the points of strains,

    s = 2 mu (dev e(u) - p) + 2 eta dev e(u'),

and its mean in a cell has the size sqrt(3/2) |s|, von Mises's stress; in antiplane shear the shear
stress |s| / sqrt(2). Pressures, which need no deviator, are not in it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sweepopt.fem.effects import Kinematics, Stress
from sweepopt.fem.fields import Array
from sweepopt.fem.spaces import BODY

if TYPE_CHECKING:
    from sweepopt.fem.scene import Scene
    from sweepopt.results import Solution


def stress_laws(scene: Scene) -> list[tuple[Stress, slice]]:
    """The effects' parts of the stress, with their internal unknowns; none if one is not known."""
    each = zip(scene.effects, scene.internal, strict=True)
    laws = [(one.stress(scene.discretisation), at) for one, at in each if hasattr(one, "stress")]
    known = [(law, at) for law, at in laws if law is not None]
    return known if len(known) == len(laws) else []


def stress_of(scene: Scene, solution: Solution, t: Array) -> Array | None:
    """The stress in each cell at times, with the velocity of the step that ends there."""
    if not (laws := stress_laws(scene)):
        return None
    body, states, u = scene.discretisation, solution(t), scene.displacement(solution, t)
    rate = scene.velocity(solution)[np.maximum(np.searchsorted(solution.t, t) - 1, 0)]
    total = np.zeros((len(u), 1, 1, 1))
    for law, at in laws:
        total = total + law(Kinematics(u, rate, states[:, at]))
    shares = body.place("stress", (BODY,), strains=True).shares
    mean = np.einsum("cp,kcps->kcs", shares, total)
    size: Array = np.linalg.norm(mean, axis=2) * np.sqrt(0.5 if body.components == 1 else 1.5)
    return size


def plastic_strain_of(scene: Scene, states: Array) -> Array | None:
    """sqrt(2/3) |p|, its mean in each cell; None without plasticity."""
    each = zip(scene.effects, scene.internal, strict=True)
    parts = [
        one.plastic_strain(scene.discretisation, states[:, at])
        for one, at in each
        if hasattr(one, "plastic_strain")
    ]
    return sum(parts) if parts else None
