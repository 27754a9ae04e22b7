"""What the effects of a scene cost: the scene beside itself without each of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sweepopt.checks import count
from sweepopt.errors import InputError
from sweepopt.fem.scene import Scene
from sweepopt.fem.scene_file import changed, effect_tables, load_scene, read_scene, remaining


class EffectCost(NamedTuple):
    """A scene, or the scene without one effect.

    Attributes
    ----------
    scene : str
        "all effects" or "without ..."
    unknowns, nonsmooth_unknowns : int
    sets : str
        How many sets bound forces, and their shapes; empty without any.
    nonzeros_A, nonzeros_B : int
        0 where there is no matrix.
    path : str
        How a step is solved (`Plan.path`); linear: one linear solve and no solver.
    solvers : str
        Which ones took the steps; empty where the path is linear.
    seconds : float
        Wall time of a step, the median.
    certificate : float
        The worst relative one of the steps.
    """

    scene: str
    unknowns: int
    nonsmooth_unknowns: int
    sets: str
    nonzeros_A: int
    nonzeros_B: int
    path: str
    solvers: str
    seconds: float
    certificate: float


class EffectCosts(tuple[EffectCost, ...]):
    """Rows that print themselves as a table."""

    needed: dict[str, str]
    """Effects that the scene cannot be without, and why."""

    def __str__(self) -> str:
        names = ("", "unknowns", "nonsmooth", "sets", "nnz A", "nnz B", "path", "solver")
        heads = (*names, "s/step", "certificate")
        rows = [
            [*(str(one) or "-" for one in row[:-2]), f"{row.seconds:.2g}", f"{row.certificate:.0e}"]
            for row in self
        ]
        table = [list(heads), *rows]
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        lines = [
            "  ".join(f"{one:<{width}}" for one, width in zip(row, widths, strict=True)).rstrip()
            for row in table
        ]
        return "\n".join([*lines, *(f"needs {name}: {why}" for name, why in self.needed.items())])


def compare_effects(
    source: str | Path | Mapping[str, Any],
    *,
    folder: str | Path = ".",
    changes: Mapping[str, Any] | None = None,
    without: Sequence[str] = (),
    steps: int = 5,
) -> EffectCosts:
    """The scene, and the scene without each of its effects that it can be without.

    Parameters
    ----------
    source, folder, changes, without
        As for `read_scene`.
    steps : int
        The first steps of the run are taken, of the scene's length; the time of one is the median.

    Returns
    -------
    EffectCosts
        A tuple of rows, which prints itself as a table.

    Raises
    ------
    InputError
        As `read_scene` does.

    Examples
    --------
    >>> rows = compare_effects("square", steps=2)
    >>> [(row.scene, row.nonsmooth_unknowns, row.path) for row in rows[::3]]
    [('all effects', 9, 'proportional'), ('without friction', 0, 'linear')]
    """
    steps = count("steps", steps)
    whole = read_scene(source, folder=folder, changes=changes, without=without)
    data, folder, _ = load_scene(source, folder)
    data = changed(data, changes or {})
    rows, needed = [_cost("all effects", whole, steps)], {}
    for label in remaining(list(effect_tables(data["effects"])), without):
        name = label.removeprefix("effects.")
        try:
            scene = read_scene(data, folder=folder, without=[*without, name])
        except InputError as error:
            needed[name] = str(error)
        else:
            rows.append(_cost(f"without {name}", scene, steps))
    costs = EffectCosts(rows)
    costs.needed = needed
    return costs


def _cost(name: str, scene: Scene, steps: int) -> EffectCost:
    assert scene.t_end is not None  # read_scene has both
    assert scene.steps is not None
    taken = min(steps, scene.steps)
    solution = scene.solve(t_end=scene.t_end * taken / scene.steps, steps=taken)
    plan, stats, process = solution.plan, solution.stats, solution.process
    linear = plan.path == "linear"
    nonzeros = [0 if M is None else int(M.count_nonzero()) for M in (process.A, process.B)]
    return EffectCost(
        scene=name,
        unknowns=plan.unknowns,
        nonsmooth_unknowns=plan.nonsmooth_unknowns,
        sets=_sets(scene),
        nonzeros_A=nonzeros[0],
        nonzeros_B=nonzeros[1],
        path=plan.path,
        solvers="" if linear else ", ".join(sorted(set(stats["solver"].tolist()))),
        seconds=float(np.median(stats["seconds"])),
        certificate=float(stats["relative"].max()),
    )


def _sets(scene: Scene) -> str:
    """How many sets of each shape."""
    counted: Counter[str] = Counter()
    for one in scene.yields:
        size, cone = one.rows.block, one.slopes is not None
        name = f"{'cones' if cone else 'balls' if one.metric is None else 'ellipses'} in R^{size}"
        if size == 1:
            name = "intervals" if one.shape == "ball" else "half-lines"
        counted[name] += len(one.rows.weight)
    return ", ".join(f"{m} {name}" for name, m in counted.items())
