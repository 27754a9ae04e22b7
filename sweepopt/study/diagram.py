"""Work-precision diagrams: how much accuracy costs, and what failed.

A colour is a scheme, a marker is a solver, a dashed line is the guaranteed bound of the error.
Cells that have no place on the axes are not left out: each status that failed has a row of crosses
above the axes, at the cost where it failed.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from math import inf
from typing import TYPE_CHECKING, Any, NamedTuple

from sweepopt.checks import choice
from sweepopt.errors import InputError
from sweepopt.plot import new_figure
from sweepopt.study.cells import ACCURACIES, COSTS, Cell, distinct, read_cells

if TYPE_CHECKING:
    from pandas import DataFrame

# Okabe and Ito, told apart with every common colour vision; the report's page has the same order
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#8C8C8C")
MARKERS = ("o", "s", "^", "D", "v", "P", "*", "h")
FAILED, UNKNOWN = "\N{MULTIPLICATION SIGN}", "\N{WHITE CIRCLE}"
MOST_COLUMNS = 3
ROW = 12.0  # height of a row above the axes in points
NEEDED = ("problem", "scheme", "solver", "steps", "tol", "status", "success")


class Look(NamedTuple):
    """Colour of each scheme and marker of each solver, the same in all panels."""

    colours: dict[str, str]
    markers: dict[str, str]

    def of(self, cell: Cell) -> dict[str, Any]:
        """How a cell is drawn; solvers that agree are seen, as each marker is smaller."""
        size = max(8.0 - 2.0 * list(self.markers).index(cell["solver"]), 4.0)
        marker = {"marker": self.markers[cell["solver"]], "ms": size, "mew": 0.8, "mec": "white"}
        return {"color": self.colours[cell["scheme"]], "lw": 1.5, **marker}


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

    Examples
    --------
    >>> import pandas as pd
    >>> cell = {"problem": "block", "scheme": "midpoint", "solver": "osqp", "tol": 1e-8}
    >>> cell |= {"status": "SUCCESS", "success": True, "bound": 0.1, "guaranteed": True}
    >>> table = pd.DataFrame(
    ...     [cell | {"steps": n, "wall": 1e-4 * n, "error": n**-2.0} for n in (10, 100, 1000)]
    ... )
    >>> ax = work_precision(table)
    >>> ax.get_xlabel(), ax.lines[0].get_ydata().tolist()
    ('wall time (s)', [0.01, 0.0001, 1e-06])
    """
    choice("x", x, COSTS)
    choice("y", y, ACCURACIES)
    cells = read_cells(table, (*NEEDED, "bound", "guaranteed", x, y))
    problems = distinct(cells, "problem")
    if ax is not None and len(problems) > 1:
        raise InputError(
            f"ax is one panel but table has the problems {', '.join(problems)}; leave ax out or "
            f"pass one problem, table[table.problem == {problems[0]!r}]"
        )
    panels = [ax] if ax is not None else _panels(len(problems))
    look = Look(
        dict(zip(distinct(cells, "scheme"), COLOURS * len(cells), strict=False)),
        dict(zip(distinct(cells, "solver"), MARKERS * len(cells), strict=False)),
    )
    for panel, problem in zip(panels, problems, strict=True):
        here = [cell for cell in cells if cell["problem"] == problem]
        rows = _draw(panel, here, x, y, look)
        panel.set_title(problem, pad=6.0 + ROW * rows)
        panel.set(xlabel=COSTS[x], ylabel=f"{ACCURACIES[y]}, $|\\cdot|_A$")
    if ax is None:
        _legend(panels[0].figure, cells, y, look, loc="outside right upper")
    else:
        _legend(ax, cells, y, look)
    return panels[0]


def _panels(count: int) -> list[Any]:
    columns = min(count, MOST_COLUMNS)
    rows = -(-count // columns)
    size = (7.0, 5.5) if count == 1 else (4.4 * columns, 4.0 * rows + 0.6)
    panels = new_figure(size).subplots(rows, columns, squeeze=False).ravel()
    for panel in panels[count:]:
        panel.set_axis_off()
    return list(panels[:count])


def _draw(ax: Any, cells: Sequence[Cell], x: str, y: str, look: Look) -> int:
    """Draw one problem; the number of rows above the axes."""
    ax.set(xscale="log", yscale="log")
    ax.grid(alpha=0.3)
    placed: list[Cell] = []
    rows: dict[str, list[Cell]] = {}
    for cell in cells:
        if cell["success"] and 0.0 < cell[x] < inf > cell[y] >= 0.0:
            placed.append(cell)
        else:
            rows.setdefault(_reason(cell, x, y), []).append(cell)
    for line in _lines(placed):
        _draw_line(ax, line, x, y, look)
    if not placed:
        ax.tick_params(labelleft=False)
        ax.text(0.5, 0.5, "no cell has a value", transform=ax.transAxes, ha="center")
    costs = [cell[x] for cell in cells if 0.0 < cell[x] < inf] or [1.0]
    room = max((max(costs) / min(costs)) ** 0.06, 1.2)
    ax.set_xlim(min(costs) / room, max(costs) * room)
    _ticks(ax)
    for k, (reason, members) in enumerate(rows.items()):
        _draw_row(ax, f"{reason} ({len(members)})", members, ROW * (k + 0.6), x, look)
    return len(rows)


def _reason(cell: Cell, x: str, y: str) -> str:
    """Why a cell has no place on the axes."""
    if not cell["success"]:
        return str(cell["status"])
    return f"no {x.replace('_', ' ')}" if cell[y] < inf else f"no {y} known"


def _ticks(ax: Any) -> None:
    """Powers of ten; 2 and 5 between them where there would be too few."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    for axis in (ax.xaxis, ax.yaxis):
        low, high = axis.get_view_interval()
        if high < 100.0 * low:
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())


def _lines(cells: Sequence[Cell]) -> list[list[Cell]]:
    """The cells of each scheme, solver and tolerance, in the order of their steps."""

    def key(cell: Cell) -> tuple[str, str, float]:
        return cell["scheme"], cell["solver"], cell["tol"]

    ordered = sorted(cells, key=lambda cell: (*key(cell), cell["steps"]))
    return [list(line) for _, line in groupby(ordered, key)]


def _draw_line(ax: Any, cells: Sequence[Cell], x: str, y: str, look: Look) -> None:
    """Cells of one scheme, solver and tolerance; what is exactly 0 lies on the floor."""
    style = look.of(cells[0])
    positive = [cell for cell in cells if cell[y] > 0.0]
    ax.plot([cell[x] for cell in positive], [cell[y] for cell in positive], **style)
    for cell in cells:
        if cell[y] == 0.0:
            on_floor = {"transform": ax.get_xaxis_transform(), "clip_on": False, "zorder": 4}
            ax.plot(cell[x], 0.0, **style, **on_floor)
            _note(ax, "0", (cell[x], 0.0), (0.0, 8.0), ha="center", fontsize="x-small")
        elif y == "bound" and not cell["guaranteed"]:
            ax.plot(cell[x], cell[y], **{**style, "mfc": "white", "mec": style["color"]})
    proved = [cell for cell in cells if cell["guaranteed"] and 0.0 < cell["bound"] < inf]
    if y == "error" and proved:
        bounds = [cell["bound"] for cell in proved]
        ax.plot([cell[x] for cell in proved], bounds, "--", color=style["color"], lw=1.0)


def _draw_row(
    ax: Any, reason: str, cells: Sequence[Cell], height: float, x: str, look: Look
) -> None:
    """Marks above the axes for cells without a place; those of unknown cost end at the right."""
    left, right = ax.get_xlim()
    _note(ax, reason, (left, 1.0), (-4.0, height), ha="right", fontsize="x-small")
    unknown = 0
    for cell in cells:
        mark = UNKNOWN if cell["success"] else FAILED
        style = {"ha": "center", "color": look.colours[cell["scheme"]], "weight": "bold"}
        if 0.0 < cell[x] < inf:
            _note(ax, mark, (cell[x], 1.0), (0.0, height), **style)
        else:
            _note(ax, mark, (right, 1.0), (-8.0 * unknown, height), **style)
            unknown += 1


def _note(
    ax: Any, text: str, place: tuple[float, float], shift: tuple[float, float], **style: Any
) -> None:
    """Text at a cost and a fraction of the axes' height, moved by some points."""
    coords = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
    ax.annotate(text, place, shift, **coords, va="center", **style)


def _legend(target: Any, cells: Sequence[Cell], y: str, look: Look, **place: Any) -> None:
    """What colours, markers and lines mean, beside the panels or in the given axes."""
    from matplotlib.lines import Line2D

    def entry(label: str, **style: Any) -> Any:
        return Line2D([], [], **{"color": "#444444", "linestyle": "none", **style}, label=label)

    entries = [entry("scheme")]
    entries += [entry(name, color=c, linestyle="-", lw=2.5) for name, c in look.colours.items()]
    entries += [entry("solver")]
    entries += [entry(name, marker=m, ms=6.0) for name, m in look.markers.items()]
    entries += [entry("")]
    if y == "error" and any(cell["guaranteed"] for cell in cells):
        entries += [entry("guaranteed bound", linestyle="--")]
    if y == "bound" and not all(cell["guaranteed"] for cell in cells):
        entries += [entry("not guaranteed", marker="o", markerfacecolor="white")]
    if not all(cell["success"] for cell in cells):
        entries += [entry("failed", marker="x", markeredgewidth=1.5)]
    legend = target.legend(handles=entries, fontsize="small", **place)
    for text in legend.get_texts():
        text.set_weight("bold" if text.get_text() in ("scheme", "solver") else "normal")
