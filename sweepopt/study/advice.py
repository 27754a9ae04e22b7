"""What to use: the cheapest cell that is accurate enough, and where half its error is cheapest."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.study.sources import body_name

if TYPE_CHECKING:
    from pandas import DataFrame

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


def advice_table(table: DataFrame, targets: Sequence[float] = TARGETS) -> DataFrame:
    """The advice in words: a row a problem, a column a target, "-" where no cell meets it."""
    import pandas as pd

    chosen = advice(table, targets)
    runs = {(row.problem, row.target): _run(row) for row in chosen.itertuples()}
    problems = table.problem.unique()
    words = [
        [runs.get((name, target), "-").removeprefix(f"{name} ") for target in targets]
        for name in problems
    ]
    return pd.DataFrame(words, problems, [f"{target:g}" for target in targets])


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


def halving_table(table: DataFrame) -> DataFrame:
    """The same in words: a row a run, a column an axis."""
    costs = halving(table)
    words = costs[list(AXES)].map(_words)
    words.insert(0, "error", [f"{row.error / row.size:.2g}" for row in costs.itertuples()])
    words.insert(0, "cheapest", costs.cheapest.replace("", "-"))
    return words.set_index([[_run(row) for row in costs.itertuples()]])


def _words(factor: float) -> str:
    if factor > MUCH:
        return "no help" if factor == np.inf else f"> {MUCH:g} x"
    return "-" if np.isnan(factor) else f"{factor:.2g} x"


def _run(row: Any) -> str:
    """A cell in words."""
    body = body_name(row.problem, row.refinements, row.element)
    return f"{body} {row.scheme} {row.steps} {row.solver} tol {row.tol:g}, {1e3 * row.wall:.3g} ms"


def summary(table: DataFrame, targets: Sequence[float] = TARGETS) -> str:
    """The advice as text, and the failures below."""
    failures = table[~table.success].status.value_counts()
    unknown = int((table.success & table.error.isna()).sum())
    lines = ["the fastest way to each relative error", advice_table(table, targets).to_string(), ""]
    lines += ["factor of the time for half the error, from the best runs on"]
    lines += [halving_table(table).to_string()]
    lines += ["", f"{len(table)} cells, {failures.sum()} failed"]
    lines += [f"  {count:4}  {status}" for status, count in failures.items()]
    if unknown:
        lines.append(f"  {unknown:4}  succeeded, but no reference is good enough for an error")
    return "\n".join(lines)
