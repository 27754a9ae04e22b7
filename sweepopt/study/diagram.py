"""The work-precision diagram: what accuracy costs, and what failed.

A panel is a problem with its mesh, a colour a scheme and tolerance, a marker a solver, a dashed
line the guaranteed bound of the error in time. Cells that have no place on logarithmic axes are not
left out: an error of 0 lies below the others of its panel, a cell that failed or whose error is not
known above them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sweepopt.checks import choice
from sweepopt.errors import InputError
from sweepopt.plot import new_figure
from sweepopt.results import ErrorBound, Solution
from sweepopt.study.cell import CellRow, guaranteed_bound
from sweepopt.study.problems import body_name

if TYPE_CHECKING:
    from pandas import DataFrame, Series

# Okabe and Ito's, which every common colour vision can distinguish
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#8C8C8C")
COLUMNS = 3
"""Panels side by side."""
ERROR = "largest error over the steps"
MARKERS = "osDP^v"
COSTS = {
    "wall": "wall time (s)",
    "cpu": "processor time (s)",
    "steps": "time steps",
    "solver_calls": "solver calls",
}


class Curve(NamedTuple):
    """A line of the diagram.

    Attributes
    ----------
    panel, label : str
    cells : DataFrame
        Rows of the study's table by their number of steps, with their places `x` and `y` on
        logarithmic axes.
    marker, line, colour : str
        As matplotlib names them; there is no line, or there are no markers, where one is "".
    """

    panel: str
    label: str
    cells: DataFrame
    marker: str
    line: str
    colour: str


def work_precision(table: DataFrame, *, x: str = "wall") -> Any:
    """Errors against cost on logarithmic axes, a line for each scheme, solver and tolerance.

    Parameters
    ----------
    table : pandas DataFrame
        Of a study, one row a cell.
    x : {"wall", "cpu", "steps", "solver_calls"}
        The cost.

    Returns
    -------
    matplotlib Axes
        The first panel; its `figure` has one for each problem and mesh. Bounds are not drawn where
        a problem has several meshes, whose error is in the errors and not in the bounds.

    Raises
    ------
    InputError
        If the table lacks a column or has no rows, or `x` is none of the above.
    MissingExtraError
        If matplotlib is not installed.
    """
    lines = curves(table, x)
    axes = panels(list(dict.fromkeys(curve.panel for curve in lines)))
    for ax in axes.values():
        ax.set(xscale="log", yscale="log", xlabel=COSTS[x], ylabel=f"{ERROR}, $|\\cdot|_A$")
        # labels at 2 and 4 between powers of ten have room in a panel
        ax.xaxis.get_minor_locator().set_params(subs=(2, 4))
    for curve in lines:
        axes[curve.panel].plot(
            curve.cells.x,
            curve.cells.y,
            f"{curve.marker}{curve.line}",
            color=curve.colour,
            label=curve.label,
            fillstyle="full" if curve.line else "none",
        )
    named = {line.get_label(): line for ax in axes.values() for line in ax.lines}
    ax.figure.legend(named.values(), named.keys(), fontsize="small", loc="outside right upper")
    return ax.figure.axes[0]


def curves(table: DataFrame, x: str) -> list[Curve]:
    """The lines of the diagram, for `work_precision` and for the report.

    Raises
    ------
    InputError
        As `work_precision`.
    """
    choice("x", x, COSTS)
    missing = [name for name in CellRow._fields if name not in getattr(table, "columns", ())]
    if missing:
        raise InputError(f"table lacks the columns {missing}; pass the table of a study as it is")
    if not len(table):
        raise InputError("table has no rows; run the study first")
    known = table.success & np.isfinite(table.error)
    tols = table.tol.map(" · tol {:g}".format) if table.tol.nunique() > 1 else ""
    bodies = zip(table.problem, table.refinements, table.element, strict=True)
    cells = table.assign(
        panel=[body_name(*body) for body in bodies],
        line=table.scheme + tols,
        known=known,
        x=table[x].groupby(table.problem).transform(_on_axis),
        y=table.error.where(known).groupby(table.problem).transform(_on_axis),
    )
    colours = dict(zip(cells.line.unique(), cycle(COLOURS), strict=False))
    markers = dict(zip(cells.solver.unique(), cycle(MARKERS), strict=False))
    bounded = cells.panel.nunique() == cells.problem.nunique()
    lines = []
    for (panel, line, solver), rows in cells.groupby(["panel", "line", "solver"], sort=False):
        rows = rows.sort_values("steps")
        proved = rows.known & np.isfinite(rows.bound) & bounded
        for label, marker, style, shown, y in (
            (f"{line} · {solver}", markers[solver], "-", rows.known, rows.y),
            ("guaranteed bound", "", "--", proved, rows.bound),
            ("failed", "x", "", ~rows.success, rows.y),
            ("error not known", "o", "", rows.success & ~rows.known, rows.y),
        ):
            if shown.any():
                drawn = rows.assign(y=y)[shown]
                lines.append(Curve(panel, label, drawn, marker, style, colours[line]))
    return lines


def trajectories(solutions: Mapping[str, Solution]) -> Any:
    """Axes, a panel a run by name: the component that moves most, in its guaranteed band."""
    axes = panels(list(solutions))
    for ax, solution in zip(axes.values(), solutions.values(), strict=True):
        k = int(np.argmax(np.ptp(solution.u, axis=0)))
        t, u, bound = solution.t, solution.u[:, k], guaranteed_bound(solution)
        ax.plot(t, u)
        ax.set(xlabel="t", ylabel=f"u[{k}]")
        if isinstance(bound, ErrorBound):  # |u_k - u_n,k| <= |e|_A sqrt((A^-1)_kk)
            inverse = solution.process.metric.solve(np.eye(1, solution.process.dim, k)[0])
            band = np.sqrt(inverse[k]) * np.append(bound.of_t[:1], bound.of_t)
            ax.fill_between(t, u - band, u + band, alpha=0.25)
    return ax


def panels(names: Sequence[str]) -> dict[str, Any]:
    """Axes of a new figure by their titles, side by side."""
    columns, lines = min(len(names), COLUMNS), -(-len(names) // COLUMNS)
    figure = new_figure((4.4 * columns + 1.8, 4.0 * lines))
    axes = {}
    for k, name in enumerate(names, start=1):
        axes[name] = figure.add_subplot(lines, columns, k, title=name)
        axes[name].grid(alpha=0.3)
    return axes


def _on_axis(values: Series) -> Series:
    """Finite and positive numbers: 0 below the others, what is not known above them."""
    positive = values[np.isfinite(values) & (values > 0)]
    low, high = (positive.min(), positive.max()) if len(positive) else (1.0, 1.0)
    return values.where(np.isfinite(values), 3 * high).clip(lower=low / 3)
