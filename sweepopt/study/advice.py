"""What to use: for each problem the cheapest cell that is accurate enough."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

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

    words = {
        (row.problem, row.target): f"{row.scheme} {row.steps} {row.solver}, {1e3 * row.wall:.3g} ms"
        for row in advice(table, targets).itertuples()
    }
    problems = table.problem.unique()
    entries = [[words.get((problem, target), "-") for target in targets] for problem in problems]
    return pd.DataFrame(entries, problems, [f"{target:g}" for target in targets])


def summary(table: DataFrame, targets: Sequence[float] = TARGETS) -> str:
    """The advice as text, and the failures below."""
    failures = table[~table.success].status.value_counts()
    unknown = int((table.success & table.error.isna()).sum())
    lines = ["the fastest way to each relative error", advice_table(table, targets).to_string(), ""]
    lines += [f"{len(table)} cells, {failures.sum()} failed"]
    lines += [f"  {count:4}  {status}" for status, count in failures.items()]
    if unknown:
        lines.append(f"  {unknown:4}  succeeded, but no reference is good enough for an error")
    return "\n".join(lines)
