"""The work-precision diagram as a picture: what accuracy costs, and what failed.

A colour is a scheme, a marker a solver, a dashed line the guaranteed bound of the error. Cells that
have no place on logarithmic axes are not left out: an error of 0 lies below the others of its
panel, a cell that failed or whose error is not known above them.
"""

from __future__ import annotations

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
MARKERS = "os^vDP*"
COSTS = {
    "wall": "wall time (s)",
    "cpu": "processor time (s)",
    "steps": "time steps",
    "solver_calls": "solver calls",
}
ACCURACIES = {"error": "largest error over the steps", "bound": "bound of the error"}


def work_precision(table: DataFrame, *, x: str = "wall", y: str = "error", ax: Any = None) -> Any:
    """Accuracy against cost on logarithmic axes, a line for each scheme, solver and tolerance.

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
    panels: list[Any] = [ax]
    legend: dict[str, Any] = {}
    if ax is None:
        columns, lines = min(len(problems), COLUMNS), -(-len(problems) // COLUMNS)
        ax = new_figure((4.4 * columns + 1.8, 4.0 * lines))
        panels = [ax.add_subplot(lines, columns, k + 1) for k in range(len(problems))]
        legend = {"loc": "outside right upper"}
    for panel, problem in zip(panels, problems, strict=True):
        panel.set(title=problem, xlabel=COSTS[x], ylabel=f"{ACCURACIES[y]}, $|\\cdot|_A$")
        panel.set(xscale="log", yscale="log")
        panel.grid(alpha=0.3)
        _draw(panel, table, problem, x, y)
    named: dict[str, Any] = {}
    for line in (line for panel in panels for line in panel.lines):
        named.setdefault(line.get_label(), line)
    ax.legend(named.values(), named.keys(), fontsize="small", **legend)
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
    for name in ("tol", *ACCURACIES, *COSTS):
        if table[name].dtype.kind not in "iuf":
            raise InputError(f"table[{name!r}] holds entries that are no numbers")


def placed(cells: DataFrame, x: str, y: str) -> DataFrame:
    """The cells of one problem with the columns x, y and kind for their place in the diagram.

    `x` and `y` are finite and positive, as on logarithmic axes: 0 below the others, what is not
    known above them; `kind` is "known", "failed" or, for example, "error not known".
    """
    known = cells.success & np.isfinite(cells[y])
    kind = np.select([~cells.success, ~known], ["failed", f"{y} not known"], "known")
    return cells.assign(x=_on_axis(cells[x]), y=_on_axis(cells[y].where(known)), kind=kind)


def _on_axis(values: Series) -> Series:
    positive = values[np.isfinite(values) & (values > 0)]
    low, high = (positive.min(), positive.max()) if len(positive) else (1.0, 1.0)
    return values.where(np.isfinite(values), 3 * high).clip(lower=low / 3)


def _draw(ax: Any, table: DataFrame, problem: str, x: str, y: str) -> None:
    """One problem; colours and markers are those of the whole table."""
    schemes, solvers = list(table.scheme.unique()), list(table.solver.unique())
    cells = placed(table[table.problem == problem], x, y)
    for (scheme, solver, tol), rows in cells.groupby(["scheme", "solver", "tol"], sort=False):
        rows = rows.sort_values("steps")
        label = f"{scheme} · {solver}" + (f" · tol {tol:g}" if table.tol.nunique() > 1 else "")
        colour = COLOURS[schemes.index(scheme) % len(COLOURS)]
        marker = MARKERS[solvers.index(solver) % len(MARKERS)]
        known = rows[rows.kind == "known"]
        proved = known[known.guaranteed & np.isfinite(known.bound)]
        if len(known):
            ax.plot(known.x, known.y, marker=marker, color=colour, label=label)
        if len(proved) and y == "error":
            ax.plot(proved.x, proved.bound, "--", color=colour, lw=1.0, label="guaranteed bound")
        for kind, others in rows[rows.kind != "known"].groupby("kind"):
            sign = "x" if kind == "failed" else "o"
            ax.plot(others.x, others.y, sign, color=colour, mfc="none", label=kind)
