"""What a run makes of the cells of a body: their stress and their plastic strain, a number each.

The deviator of the stress is that of the strains, their rates and plastic strains, at the points
where plasticity has them,

    s = 2 mu (dev e(u) - p) + 2 eta dev e(u'),

and its mean in a cell has the size sqrt(3/2) |s|, von Mises's stress; in antiplane shear the shear
stress |s| / sqrt(2). Pressures, which need no deviator, are not in it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.fem.effects import (
    Eigenstrain,
    Elasticity,
    MaxwellBranch,
    Viscosity,
    YieldStress,
    deviators,
)
from sweepopt.fem.fields import Array, Indices
from sweepopt.fem.plasticity import ZZ, Plasticity
from sweepopt.fem.spaces import BODY

if TYPE_CHECKING:
    from sweepopt.fem.scene import Scene
    from sweepopt.results import Solution


def stress_laws(scene: Scene) -> list[tuple[Any, slice]]:
    """The effects that make the stress, with their internal unknowns; none if strains do not.

    A yield stress leaves it open where nothing flows; tensors, and in plane stress eigenstrains,
    have other deviators.
    """
    flat = scene.discretisation.kind == "plane stress"
    unknown = (YieldStress, Eigenstrain) if flat else (YieldStress,)
    effects = scene.effects
    if any(isinstance(one, unknown) or getattr(one, "tensor", None) is not None for one in effects):
        return []
    known = zip(effects, scene.internal, strict=True)
    return [(one, part) for one, part in known if hasattr(one, "moduli")]


def stress_of(scene: Scene, solution: Solution, t: Array) -> Array | None:
    """The stress in each cell at times, with the velocity of the step that ends there."""
    if not (laws := stress_laws(scene)):
        return None
    body, states, u = scene.discretisation, solution(t), scene.displacement(solution, t)
    rate = scene.velocity(solution)[np.maximum(np.searchsorted(solution.t, t) - 1, 0)]
    place, total = body.place("stress", (BODY,), strains=True), 0.0
    share = place.basis.dx / place.basis.dx.sum(axis=1, keepdims=True)
    free = body.with_unknowns(clamped=(), held={}, turned=())
    for law, part in laws:
        motion = rate if isinstance(law, Viscosity) else u
        if isinstance(law, MaxwellBranch):
            motion = u - body.expand(states[:, part])
        lam, mu = law.moduli(body, place)
        rows = deviators(free, place, lam, mu)[:, body.nodes.T.ravel()]
        strain = (rows @ motion.reshape(len(u), -1).T).T.reshape(len(u), *share.shape, -1)
        for cells, _, p, zz in _plastic_points(scene, states) if type(law) is Elasticity else ():
            if zz.size:
                p[..., 1] -= ZZ * zz
            strain[:, cells[:: share.shape[1]]] -= p.reshape(len(u), -1, *strain.shape[2:])
        total += np.einsum("cp,kcps->kcs", 2 * share * mu, strain)
    size: Array = np.linalg.norm(total, axis=2) * np.sqrt(0.5 if body.components == 1 else 1.5)
    return size


def plastic_strain_of(scene: Scene, states: Array) -> Array | None:
    """sqrt(2/3) |p|, its mean in each cell; None without plasticity."""
    strain = None
    for cells, weight, p, _ in _plastic_points(scene, states):
        if strain is None:
            strain = np.zeros((len(states), scene.discretisation.mesh.nelements))
        share = weight / np.bincount(cells, weight)[cells]
        np.add.at(strain.T, cells, np.sqrt(2 / 3) * (share * np.linalg.norm(p, axis=2)).T)
    return strain


def _plastic_points(scene: Scene, states: Array) -> Iterator[tuple[Indices, Array, Array, Array]]:
    """Of each plasticity the cell, the weight, p and, in plane stress, e_zz of each point."""
    known = zip(scene.effects, scene.internal, strict=True)
    parts = [part for one, part in known if isinstance(one, Plasticity)]
    flat = scene.discretisation.kind == "plane stress"
    for one in scene.yields:
        if (cells := one.rows.cells) is None:
            continue
        unknown = one.rows.E.nonzero()[1].max(initial=0)
        part = next((part for part in parts if part.start <= unknown < part.stop), None)
        if part is None:  # another effect may have cells too
            continue
        rows, first = one.rows, one.slopes is not None
        p = (rows.E @ states.T).T.reshape(len(states), -1, rows.block)[..., first:]
        yield cells, rows.weight, p, states[:, part][:, : flat * rows.weight.size]
