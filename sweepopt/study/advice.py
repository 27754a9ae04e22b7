"""What to use: the cheapest cell that is accurate enough, and where half its error is cheapest."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, inf, isnan, log, nan
from typing import TYPE_CHECKING, Any

from sweepopt.study.sources import body_name

if TYPE_CHECKING:
    from pandas import DataFrame, Series

TARGETS = (1e-2, 1e-4, 1e-6)
AXES = {
    "more steps": ("steps", False),
    "a smaller tol": ("tol", True),
    "a finer mesh": ("refinements", False),
    "a higher degree": ("element", False),
}
"""What makes a run more accurate: a column of the table, and whether by smaller values."""
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

    words = {
        (row.problem, row.target): _run(row).removeprefix(f"{row.problem} ")
        for row in advice(table, targets).itertuples()
    }
    problems = table.problem.unique()
    entries = [[words.get((problem, target), "-") for target in targets] for problem in problems]
    return pd.DataFrame(entries, problems, [f"{target:g}" for target in targets])


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
    import pandas as pd

    known = table[table.success & (table.error > 0)].sort_values(["wall", "error"], kind="stable")
    least = known.groupby("problem").error.transform(_least_before)
    best = known[known.error < NOTABLE * least]
    best = best.sort_values("problem", kind="stable")
    rows = []
    for row in best.itertuples():
        factors = {words: _factor(known, row, *axis) for words, axis in AXES.items()}
        possible = {words: factor for words, factor in factors.items() if factor <= MUCH}
        rows.append({**factors, "cheapest": min(possible, key=possible.__getitem__, default="")})
    return best.join(pd.DataFrame(rows, best.index, [*AXES, "cheapest"]))


def _least_before(errors: Series) -> Series:
    """Of each run the least error of the faster ones."""
    return errors.cummin().shift(fill_value=inf)


def _factor(known: DataFrame, row: Any, axis: str, smaller: bool) -> float:
    """Time for half the error, in units of a cell's own, by the next cell along an axis."""
    columns = "problem", "scheme", "solver", *(column for column, _ in AXES.values())
    same = [column for column in columns if column != axis]
    others = known[(known[same] == [getattr(row, name) for name in same]).all(axis=1)]
    value, values = getattr(row, axis), others[axis]
    finer = others[values < value if smaller else values > value]
    if not len(finer):
        return nan
    following = finer.sort_values(axis, ascending=not smaller).iloc[0]
    fall = log(row.error / following.error)
    if not fall > 0:
        return inf
    # more accurate in less time is possible: times are measured
    return exp(min(max(log(following.wall / row.wall), 0.0) * log(2) / fall, 700.0))


def halving_table(table: DataFrame) -> DataFrame:
    """The same in words: a row a run, a column an axis."""
    costs = halving(table)
    words = costs[list(AXES)].map(_words)
    words.insert(0, "error", [f"{row.error / row.size:.2g}" for row in costs.itertuples()])
    words.insert(0, "cheapest", costs.cheapest.replace("", "-"))
    return words.set_index([[_run(row) for row in costs.itertuples()]])


def _words(factor: float) -> str:
    if factor > MUCH:
        return "no help" if factor == inf else f"> {MUCH:g} x"
    return "-" if isnan(factor) else f"{factor:.2g} x"


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
