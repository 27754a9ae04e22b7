"""What to use: the cheapest cell that is accurate enough, and where half its error is cheapest."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from pandas import DataFrame

FORMAT: dict[str, Any] = {"index": False, "na_rep": "-", "float_format": "{:.3g}".format}
"""Of tables that are printed, by pandas."""
TARGETS = (1e-2, 1e-4, 1e-6)
AXES = {
    "more steps": ("steps", False),
    "a smaller tol": ("tol", True),
    "a finer mesh": ("refinements", False),
    "a higher degree": ("element", False),
}
"""What makes a run more accurate: a column of the table, and whether by smaller values."""
SETTINGS = ("problem", "scheme", "solver", *(column for column, _ in AXES.values()))
NOTABLE = 0.9  # of the error of faster runs: what is less by less is no reason for a row
MUCH = 100.0
"""Times the time for half the error: an axis that takes more is not the one to go along."""


def advice(table: DataFrame, targets: Sequence[float] = TARGETS) -> DataFrame:
    """The fastest successful cell of each problem whose error is at most target * size.

    Parameters
    ----------
    table : pandas DataFrame
        Of a study.
    targets : sequence of float
        Errors relative to sup |u_i|_A, the same for every problem and in all units.

    Returns
    -------
    pandas DataFrame
        A row a problem and target, with the columns of the cell and its target; a target
        that no cell meets has no row.
    """
    import pandas as pd

    known = table[table.success & table.error.notna()].sort_values("wall", kind="stable")
    chosen = [
        known[known.error <= target * known["size"]]
        .drop_duplicates("problem")
        .assign(target=target)
        for target in targets
    ]
    return pd.concat(chosen, ignore_index=True)


def halving(table: DataFrame) -> DataFrame:
    """What half the error would cost, along each axis, from the best runs on.

    The best runs are those that are more accurate by a tenth than all faster ones of the problem.
    Along an axis the next cell of the same scheme and solver is taken, all other settings equal.
    Through the two, error = constant * wall^-p, so that half the error takes 2^(1/p) times the
    time: a local estimate from what was measured.

    Parameters
    ----------
    table : pandas DataFrame
        Of a study.

    Returns
    -------
    pandas DataFrame
        A row a run, with the columns of its cell, one for each axis in `AXES` called "more steps"
        for example: the factor of the time, inf where the error does not fall, nan where no next
        cell was measured; and `cheapest`, the axis of the least factor, "" if all are above MUCH.
    """
    known = table[table.success & (table.error > 0)].sort_values(["wall", "error"], kind="stable")
    factors = {}
    for words, (axis, smaller) in AXES.items():
        cells = known.sort_values(axis, ascending=not smaller)
        same = [column for column in SETTINGS if column != axis]
        following = cells.groupby(same)[["error", "wall"]].shift(-1)
        fall = np.log(cells.error / following.error)
        # more accurate in less time is possible: times are measured
        rise = np.log(following.wall / cells.wall).clip(lower=0.0)
        factor = np.exp((rise * np.log(2) / fall).clip(upper=700.0))
        factors[words] = factor.where(~(fall <= 0), np.inf)
    cells = known.assign(**factors)
    faster = cells.groupby("problem").error.transform(lambda x: x.cummin().shift(fill_value=np.inf))
    best = cells[cells.error < NOTABLE * faster].sort_values("problem", kind="stable")
    possible = best[list(AXES)].fillna(np.inf)
    cheapest = possible.idxmin(axis="columns").where(possible.min(axis="columns") <= MUCH, "")
    return best.assign(cheapest=cheapest)


def readable(cells: DataFrame, *columns: str) -> DataFrame:
    """Columns of advice behind settings, relative error and time of its cells."""
    shown = cells.assign(**{"relative error": cells.error / cells["size"], "ms": 1e3 * cells.wall})
    return shown[[*SETTINGS, "relative error", "ms", *columns]]


def summary(table: DataFrame, targets: Sequence[float] = TARGETS) -> str:
    """The advice as text, and the failures below."""
    failures = table[~table.success].status.value_counts()
    unknown = int((table.success & table.error.isna()).sum())
    chosen = readable(advice(table, targets), "target")
    words = chosen.to_string(**FORMAT) if len(chosen) else f"no run meets {max(targets):g}"
    lines = ["the fastest way to each relative error", words, ""]
    lines += ["factor of the time for half the error, from the best runs on"]
    lines += [readable(halving(table), "cheapest", *AXES).to_string(**FORMAT)]
    lines += ["", f"{len(table)} cells, {failures.sum()} failed"]
    lines += [f"  {count:4}  {status}" for status, count in failures.items()]
    if unknown:
        lines.append(f"  {unknown:4}  succeeded, but no reference is good enough for an error")
    return "\n".join(lines)
