"""The work-precision diagram as a picture: what accuracy costs, and what failed.

A colour is a scheme, a marker a solver, a dashed line the guaranteed bound of the error. Cells that
have no place on logarithmic axes are not left out: an error of 0 lies below the others of its
panel, a cell that failed or whose error is not known above them.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.checks import choice
from sweepopt.errors import InputError
from sweepopt.plot import new_figure
from sweepopt.study.cell import CellRow

if TYPE_CHECKING:
    from pandas import DataFrame, Series

# Okabe and Ito's, which every common colour vision can distinguish
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#8C8C8C")
COLUMNS = 3
"""Panels side by side."""
MARKERS = ("o", "s", "^", "v", "D", "P", "*")
EDGE = 3.0
"""Times the largest number of a panel: where those stand that are not known."""
COSTS = {
    "wall": "wall time (s)",
    "cpu": "processor time (s)",
    "steps": "time steps",
    "solver_calls": "solver calls",
}
ACCURACIES = {"error": "largest error over the steps", "bound": "bound of the error"}
NUMBERS = ("steps", "tol", "error", "bound", *COSTS)


def work_precision(table: DataFrame, *, x: str = "wall", y: str = "error", ax: Any = None) -> Any:
    """Accuracy against cost on logarithmic axes, a line for each scheme and solver.

    Parameters
    ----------
    table : pandas DataFrame
        Of a study, one row a cell.
    x : {"wall", "cpu", "steps", "solver_calls"}
        The cost.
    y : {"error", "bound"}
        The accuracy. Beside errors the guaranteed bounds are drawn dashed.
    ax : matplotlib Axes, optional
        Where to draw one problem. Otherwise a new figure with a panel for each problem.

    Returns
    -------
    matplotlib Axes
        The first panel; its `figure` holds all of them.

    Raises
    ------
    InputError
        If the table lacks a column, `x` or `y` is none of the above, or `ax` is given for several
        problems.
    MissingExtraError
        If matplotlib is not installed.
    """
    choice("x", x, COSTS)
    choice("y", y, ACCURACIES)
    check_table(table)
    problems = list(table.problem.unique())
    if ax is not None and len(problems) > 1:
        raise InputError(
            f"ax is one panel but table has the problems {', '.join(problems)}; leave ax out or "
            f"pass one problem, table[table.problem == {problems[0]!r}]"
        )
    panels = [ax] if ax is not None else _panels(len(problems))
    for panel, problem in zip(panels, problems, strict=True):
        _draw(panel, table, problem, x, y)
        panel.set(title=problem, xlabel=COSTS[x], ylabel=f"{ACCURACIES[y]}, $|\\cdot|_A$")
    handles = {
        label: handle
        for panel in panels
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True)
    }
    place = {"loc": "outside right upper"} if ax is None else {}
    target = panels[0].figure if ax is None else ax
    target.legend(handles.values(), handles.keys(), fontsize="small", **place)
    return panels[0]


def check_table(table: Any) -> None:
    """Refuse what is not the table of a study, with an InputError."""
    if not hasattr(table, "columns") or not hasattr(table, "iloc"):
        raise InputError(f"table must be a pandas DataFrame, got {type(table).__name__}")
    missing = [name for name in CellRow._fields if name not in table.columns]
    if missing:
        raise InputError(f"table lacks the columns {missing}; pass the table of a study as it is")
    if not len(table):
        raise InputError("table has no rows; run the study first")
    for name in NUMBERS:
        if table[name].dtype.kind not in "iuf":
            raise InputError(f"table[{name!r}] holds entries that are no numbers")


def curves(table: DataFrame) -> Iterator[tuple[str, DataFrame]]:
    """The cells of each scheme, solver and tolerance by the number of steps, with their name."""
    names = ["scheme", "solver", "tol"] if table.tol.nunique() > 1 else ["scheme", "solver"]
    for key, rows in table.groupby(names, sort=False):
        words = [f"tol {part:g}" if isinstance(part, float) else str(part) for part in key]
        yield " · ".join(words), rows.sort_values("steps")


def indices(table: DataFrame, column: str) -> dict[str, int]:
    """A number for each scheme or solver of a study, for its colour or its marker."""
    return {name: k for k, name in enumerate(table[column].unique())}


def placed(cells: DataFrame, y: str = "error") -> DataFrame:
    """The cells of one problem with columns for their place in the diagram.

    `y` is the accuracy and the costs are positive, as on logarithmic axes; `kind` is "known",
    "failed" or, for example, "error not known". The accuracy itself stays in its column.
    """
    known = cells.success & np.isfinite(cells[y])
    kind = np.select([~cells.success, ~known], ["failed", f"{y} not known"], "known")
    costs = {cost: _on_axis(cells[cost]) for cost in COSTS}
    return cells.assign(**costs, y=_on_axis(cells[y].where(known)), kind=kind)


def _on_axis(values: Series) -> Series:
    """Finite and positive numbers: 0 below the others, what is not known above them."""
    positive = values[np.isfinite(values) & (values > 0)]
    low, high = (positive.min(), positive.max()) if len(positive) else (1.0, 1.0)
    return values.where(np.isfinite(values), EDGE * high).clip(lower=low / EDGE)


def _panels(count: int) -> list[Any]:
    columns = min(count, COLUMNS)
    rows = -(-count // columns)
    panels = new_figure((4.4 * columns + 1.8, 4.0 * rows)).subplots(rows, columns, squeeze=False)
    for panel in panels.flat[count:]:
        panel.set_axis_off()
    return list(panels.flat[:count])


def _draw(ax: Any, table: DataFrame, problem: str, x: str, y: str) -> None:
    """One problem; colours and markers are those of the whole table."""
    schemes, solvers = indices(table, "scheme"), indices(table, "solver")
    ax.set(xscale="log", yscale="log")
    ax.grid(alpha=0.3)
    for label, rows in curves(placed(table[table.problem == problem], y)):
        colour = COLOURS[schemes[rows.scheme.iloc[0]] % len(COLOURS)]
        marker = MARKERS[solvers[rows.solver.iloc[0]] % len(MARKERS)]
        known = rows[rows.kind == "known"]
        if len(known):
            ax.plot(known[x], known.y, marker=marker, color=colour, label=label)
        proved = known[known.guaranteed & np.isfinite(known.bound)]
        if y == "error" and len(proved):
            ax.plot(proved[x], proved.bound, "--", color=colour, lw=1.0, label="guaranteed bound")
        for kind, others in rows[rows.kind != "known"].groupby("kind"):
            sign = "x" if kind == "failed" else "o"
            ax.plot(others[x], others.y, sign, color=colour, mfc="none", label=kind)
