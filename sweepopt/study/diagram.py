"""The work-precision diagram as a picture: what accuracy costs, and what failed.

A panel is a problem with its mesh, a colour a scheme and tolerance, a marker a solver, a dashed
line the guaranteed bound of the error in time. Cells that have no place on logarithmic axes are not
left out: an error of 0 lies below the others of its panel, a cell that failed or whose error is not
known above them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.checks import choice
from sweepopt.errors import InputError
from sweepopt.plot import new_figure
from sweepopt.study.cell import CellRow
from sweepopt.study.sources import body_name

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
BOUND = "guaranteed bound"


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
        Where to draw one problem. Otherwise a new figure with a panel for each problem and mesh;
        those of one problem have the same limits.

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
    cells = points(table, x, y)
    problems, names, solvers = (list(cells[name].unique()) for name in ("panel", "line", "solver"))
    if ax is not None and len(problems) > 1:
        raise InputError(
            f"ax is one panel but table has the problems {', '.join(problems)}; leave ax out or "
            f"pass one problem, table[table.problem == {table.problem.iloc[0]!r}], and one mesh"
        )
    legend = ax
    if ax is None:
        columns, lines = min(len(problems), COLUMNS), -(-len(problems) // COLUMNS)
        legend = new_figure((4.4 * columns + 1.8, 4.0 * lines))
    panels: dict[str, Any] = {}
    first: dict[str, Any] = {}
    for k, (panel, rows) in enumerate(cells.groupby("panel", sort=False), start=1):
        # meshes of one problem have the same limits, so that they can be compared
        one = first.get(rows.problem.iloc[0])
        here = ax or legend.add_subplot(lines, columns, k, sharex=one, sharey=one)
        panels[panel] = here
        first.setdefault(rows.problem.iloc[0], here)
        here.set(title=panel, xlabel=COSTS[x], ylabel=f"{ACCURACIES[y]}, $|\\cdot|_A$")
        here.set(xscale="log", yscale="log")
        here.grid(alpha=0.3)
        # labels at 2 and 4 between powers of ten have room in a panel
        here.xaxis.get_minor_locator().set_params(subs=(2, 4))
    groups = cells.groupby(["panel", "line", "solver", "kind"], sort=False)
    for (problem, line, solver, kind), rows in groups:
        marker = MARKERS[solvers.index(solver) % len(MARKERS)]
        style = {"known": f"{marker}-", BOUND: "--", "failed": "x"}.get(kind, "o")
        panels[problem].plot(
            *rows.sort_values("steps")[["x", "y"]].to_numpy().T,
            style,
            color=COLOURS[names.index(line) % len(COLOURS)],
            markerfacecolor=None if kind == "known" else "none",
            label=f"{line} · {solver}" if kind == "known" else kind,
        )
    named = {line.get_label(): line for panel in panels.values() for line in panel.lines}
    place = {} if ax is legend else {"loc": "outside right upper"}
    legend.legend(named.values(), named.keys(), fontsize="small", **place)
    return panels[problems[0]]


def points(table: Any, x: str, y: str) -> DataFrame:
    """The cells with their places x and y on logarithmic axes, their panel and line.

    `kind` is "known", "failed" or, for example, "error not known"; beside errors the cells with a
    guaranteed bound are there once more, with it as y, unless a problem has several meshes: then
    the error of these is in y and not in the bound.
    """
    import pandas as pd

    missing = [name for name in CellRow._fields if name not in getattr(table, "columns", ())]
    if missing:
        raise InputError(f"table lacks the columns {missing}; pass the table of a study as it is")
    if not len(table):
        raise InputError("table has no rows; run the study first")
    known = table.success & np.isfinite(table[y])
    kind = np.select([~table.success, ~known], ["failed", f"{y} not known"], "known")
    columns = {"x": table[x], "y": table[y].where(known)}
    places = {
        name: values.groupby(table.problem).transform(_on_axis) for name, values in columns.items()
    }
    bodies = table[["problem", "refinements", "element"]]
    tols = table.tol.map(" · tol {:g}".format) if table.tol.nunique() > 1 else ""
    panels = [body_name(*row) for row in bodies.itertuples(index=False)]
    cells = table.assign(**places, kind=kind, panel=panels, line=table.scheme + tols)
    one_mesh = len(bodies.drop_duplicates()) == table.problem.nunique()
    with_bound = (cells.kind == "known") & np.isfinite(cells.bound)
    proved = cells[with_bound & (y == "error") & one_mesh]
    return pd.concat([cells, proved.assign(y=proved.bound, kind=BOUND)])


def _on_axis(values: Series) -> Series:
    """Finite and positive numbers: 0 below the others, what is not known above them."""
    positive = values[np.isfinite(values) & (values > 0)]
    low, high = (positive.min(), positive.max()) if len(positive) else (1.0, 1.0)
    return values.where(np.isfinite(values), 3 * high).clip(lower=low / 3)
