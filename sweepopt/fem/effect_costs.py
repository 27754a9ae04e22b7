"""What the effects of a scene cost: the scene beside itself without each of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.checks import at_path, count
from sweepopt.errors import InputError, brought_by
from sweepopt.fem.scene import Scene
from sweepopt.fem.scene_file import changed, effect_tables, load_scene, names_of, read_scene

if TYPE_CHECKING:
    from pandas import DataFrame


def compare_effects(
    source: str | Path | Mapping[str, Any],
    *,
    changes: Mapping[str, Any] | None = None,
    without: Sequence[str] = (),
    steps: int = 5,
) -> DataFrame:
    """The scene, and the scene without each of its effects that it can be without, as a table.

    Parameters
    ----------
    source, changes, without
        As for `read_scene`.
    steps : int
        The first steps of the run are taken, of the scene's length; the time of one is the median.

    Returns
    -------
    pandas DataFrame
        A row "all effects", then one "without ..." for each effect, with the columns ``unknowns``,
        ``nonsmooth_unknowns``, ``sets`` (how many bound forces, and their shapes), ``nonzeros_A``
        and ``nonzeros_B`` (0 where there is no matrix), ``path`` (how a step is solved,
        `Plan.path`), ``solvers`` (which ones took the steps; none where the path is linear),
        ``seconds`` (of a step, the median) and ``certificate`` (the worst relative one).

    Raises
    ------
    InputError
        As `read_scene` does.

    Examples
    --------
    >>> table = compare_effects("square", steps=2)
    >>> table.path["all effects"], table.path["without friction"]
    ('proportional', 'linear')
    """
    with brought_by("fem"):  # with xarray
        import pandas as pd
    steps, without = count("steps", steps), names_of(without)
    data, folder, where = load_scene(source)
    with at_path(where):
        data = changed(data, changes or {})
        whole = read_scene(data, folder=folder, without=without)
    costs = {"all effects": _cost(whole, steps)}
    for label in effect_tables(data["effects"], without):
        name = label.removeprefix("effects.")
        with suppress(InputError):  # the scene cannot be without it
            scene = read_scene(data, folder=folder, without=[*without, name])
            costs[f"without {name}"] = _cost(scene, steps)
    return pd.DataFrame.from_dict(costs, orient="index")


def _cost(scene: Scene, steps: int) -> dict[str, Any]:
    taken = min(steps, scene.steps)
    solution = scene.solve(t_end=scene.t_end * taken / scene.steps, steps=taken)
    plan, stats, process = solution.plan, solution.stats, solution.process
    nonzeros = [0 if M is None else int(M.count_nonzero()) for M in (process.A, process.B)]
    return {
        "unknowns": plan.unknowns,
        "nonsmooth_unknowns": plan.nonsmooth_unknowns,
        "sets": _sets(scene),
        "nonzeros_A": nonzeros[0],
        "nonzeros_B": nonzeros[1],
        "path": plan.path,
        "solvers": ", ".join(sorted(set(stats["solver"].tolist()) - {"linear"})),
        "seconds": np.median(stats["seconds"]),
        "certificate": stats["relative"].max(),
    }


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
