"""The work-precision diagram: what accuracy costs, and what failed.

A panel is a problem with its mesh, a colour a scheme and tolerance, a marker a solver, a dashed
line the guaranteed bound of the error in time. An error that is not known is drawn at its bound.
Cells that have no place on logarithmic axes are not left out: an error of 0 lies below the others
of its panel, a cell that failed or of which neither error nor bound is known above them.
"""

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from pandas import DataFrame, Series, concat

from sweepopt.checks import choice, require_columns
from sweepopt.display import COLOURS
from sweepopt.errors import InputError
from sweepopt.plot import new_figure
from sweepopt.results import ErrorBound, Solution, guaranteed_bound
from sweepopt.study.problems import body_name

ERROR = "largest error over the steps"
MARKERS = "osDP^v"
COSTS = {
    "wall": "wall time (s)",
    "cpu": "processor time (s)",
    "steps": "time steps",
    "solver_calls": "solver calls",
}
UNKNOWN = "error not known (at its bound, else on top)"
LOOK = ["panel", "label", "marker", "line", "colour", "solver"]
"""What a line of the diagram has in common: marker, line and colour as matplotlib names them; there
is no line, or there are no markers, where one is ""."""


def work_precision(table: DataFrame, *, x: str = "wall") -> Any:
    """Errors against cost on logarithmic axes, a line for each scheme, solver and tolerance.

    Parameters
    ----------
    table : pandas DataFrame
        Of a study, one row a run.
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
    """
    places = points(table, x)
    axes = panels(places.panel.unique())
    for ax in axes.values():
        ax.set(xscale="log", yscale="log", xlabel=COSTS[x], ylabel=f"{ERROR}, $|\\cdot|_A$")
        # labels at 2 and 4 between powers of ten have room in a panel
        ax.xaxis.get_minor_locator().set_params(subs=(2, 4))
    for (panel, label, marker, line, colour, _), rows in places.groupby(LOOK, sort=False):
        fill = "full" if line else "none"
        axes[panel].plot(
            rows.x, rows.y, f"{marker}{line}", color=colour, fillstyle=fill, label=label
        )
    named = {line.get_label(): line for ax in axes.values() for line in ax.lines}
    ax.figure.legend(named.values(), named.keys(), fontsize="small", loc="outside right upper")
    return ax.figure.axes[0]


def points(table: DataFrame, x: str) -> DataFrame:
    """The points of the diagram, for `work_precision` and for the report.

    Returns
    -------
    pandas DataFrame
        Rows of the study's table by their number of steps, one for each point, with its place `x`
        and `y` on logarithmic axes and the columns LOOK.

    Raises
    ------
    InputError
        As `work_precision`.
    """
    choice("x", x, COSTS)
    columns = "problem refinements element scheme solver steps tol success error bound"
    require_columns(table, [*columns.split(), x])
    if not len(table):
        raise InputError("table has no rows; run the study first")
    known = table.success & np.isfinite(table.error)
    tols = table.tol.map(" · tol {:g}".format) if table.tol.nunique() > 1 else ""
    bodies, scheme = table[["problem", "refinements", "element"]], table.scheme + tols
    names = [body_name(*body) for body in bodies.itertuples(index=False)]
    bound = table.bound.where(table.success & (len(set(names)) == table.problem.nunique()))
    cells = table.assign(
        panel=names,
        label=scheme + " · " + table.solver,
        marker=_in_turn(table.solver, MARKERS),
        line="-",
        colour=_in_turn(scheme, COLOURS),
        x=table[x].groupby(table.problem).transform(_on_axis),
        y=table.error.where(known, bound).groupby(table.problem).transform(_on_axis),
    )
    parts = [
        cells[known],
        cells[np.isfinite(bound)].assign(label="guaranteed bound", marker="", line="--", y=bound),
        cells[~table.success].assign(label="failed", marker="x", line=""),
        cells[table.success & ~known].assign(label=UNKNOWN, marker="v", line=""),
    ]
    # lines in the order of the table, the points of each by their steps
    places = concat(parts)
    order = places.groupby(LOOK, sort=False).ngroup()
    return places.assign(order=order).sort_values(["order", "steps"], kind="stable")


def trajectories(solutions: Mapping[str, Solution]) -> Any:
    """Axes, a panel a run by name: the component that moves most, in its guaranteed band."""
    axes = panels(list(solutions))
    for ax, solution in zip(axes.values(), solutions.values(), strict=True):
        k = int(np.argmax(np.ptp(solution.u, axis=0)))
        t, u, bound = solution.t, solution.u[:, k], guaranteed_bound(solution)
        ax.plot(t, u)
        ax.set(xlabel="t", ylabel=f"u[{k}]")
        if isinstance(bound, ErrorBound):  # |u_k - u_n,k| <= |e|_A sqrt((A^-1)_kk)
            width = solution.process.metric.dual_norm(np.eye(1, solution.process.dim, k)[0])
            band = width * np.append(bound.of_t[:1], bound.of_t)
            ax.fill_between(t, u - band, u + band, alpha=0.25)
    return ax


def lines_and_columns(panels: int) -> tuple[int, int]:
    """Up to three panels side by side."""
    return -(-panels // 3), min(panels, 3)


def panels(names: Sequence[str]) -> dict[str, Any]:
    """Axes of a new figure by their titles, side by side."""
    lines, columns = lines_and_columns(len(names))
    figure = new_figure((4.4 * columns + 1.8, 4.0 * lines))
    axes = {}
    for k, name in enumerate(names, start=1):
        axes[name] = figure.add_subplot(lines, columns, k, title=name)
        axes[name].grid(alpha=0.3)
    return axes


def _in_turn(names: Series, looks: Sequence[str]) -> Series:
    """A look for each name, from the first one on again where there are more names."""
    return names.map(dict(zip(names.unique(), cycle(looks), strict=False)))


def _on_axis(values: Series) -> Series:
    """Finite and positive numbers: 0 below the others, what is not known above them."""
    positive = values[np.isfinite(values) & (values > 0)]
    low, high = (positive.min(), positive.max()) if len(positive) else (1.0, 1.0)
    return values.where(np.isfinite(values), 3 * high).clip(lower=low / 3)
