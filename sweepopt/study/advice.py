"""What to use: for each problem the cheapest cell that is accurate enough."""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan
from typing import TYPE_CHECKING

from sweepopt.study.rows import aligned

if TYPE_CHECKING:
    from pandas import DataFrame

TARGETS = (1e-2, 1e-4, 1e-6)


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
        A row a problem and target, with the columns problem, target and those of the cell; a
        target that no cell meets has no row.
    """
    import pandas as pd

    known = table[table.success & table.error.notna()]
    found = []
    for problem in table.problem.unique():
        mine = known[known.problem == problem]
        for target in targets:
            enough = mine[mine.error <= target * mine["size"]]
            if len(enough):
                found.append({"target": target, **enough.loc[enough.wall.idxmin()].to_dict()})
    columns = ["problem", "target", *(name for name in table.columns if name != "problem")]
    return pd.DataFrame(found, columns=columns)


def summary(table: DataFrame, targets: Sequence[float] = TARGETS) -> str:
    """The advice as text, a line a problem, and the failures below."""
    chosen = advice(table, targets)
    lines = [["relative error", *(f"{target:g}" for target in targets)]]
    for problem in table.problem.unique():
        cells = [
            chosen[(chosen.problem == problem) & (chosen.target == target)] for target in targets
        ]
        lines.append([problem, *(_said(cell.iloc[0]) if len(cell) else "-" for cell in cells)])
    text = aligned(lines)
    return "\n".join(["the fastest way to each accuracy", text, "", *_failures(table)])


def _said(cell: object) -> str:
    milliseconds = 1e3 * cell.wall  # type: ignore[attr-defined]
    words = f"{cell.scheme} {cell.steps} {cell.solver}"  # type: ignore[attr-defined]
    return f"{words}, {milliseconds:.3g} ms"


def _failures(table: DataFrame) -> list[str]:
    lost = table[~table.success]
    unknown = table[table.success & table.error.map(isnan)]
    lines = [f"{len(table)} cells, {len(lost)} failed"]
    lines += [f"  {count:4}  {status}" for status, count in lost.status.value_counts().items()]
    if len(unknown):
        lines.append(f"  {len(unknown):4}  succeeded, but no reference is good enough for an error")
    return lines
