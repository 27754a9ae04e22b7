"""What a study says: the cheapest run that is accurate enough, where half its error is cheapest.

As text, or as one HTML file that works without a network: diagrams by Plotly, tables by pandas.
Plotly's script and the pictures stand in the file, and its policy lets nothing be loaded from
elsewhere. What comes from a table is text in it, never HTML.
"""

import base64
import html
import io
import os
import warnings
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from inspect import getdoc
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

import numpy as np
from pandas import DataFrame, Series, concat
from plotly.offline import get_plotlyjs
from plotly.subplots import make_subplots

from sweepopt.checks import choice, require_columns
from sweepopt.display import FORMAT
from sweepopt.errors import InputError, Status, SweepoptWarning
from sweepopt.io import put, writable
from sweepopt.results import Solution
from sweepopt.study.cell import CellRow, machine, solution_of
from sweepopt.study.diagram import COSTS, ERROR, LOOK, lines_and_columns, points, trajectories
from sweepopt.study.hard import GOOD, SUITES

if TYPE_CHECKING:
    from sweepopt.study.study import Study

TARGETS = (1e-2, 1e-4, 1e-6)
AXES = {
    "more steps": ("steps", False),
    "a smaller tol": ("tol", True),
    "a finer mesh": ("refinements", False),
    "a higher degree": ("element", False),
}
"""What makes a run more accurate: a column of the table, and whether by smaller values."""
SETTINGS = ("problem", "scheme", "solver", *(column for column, _ in AXES.values()))


def advice(table: DataFrame, targets: Sequence[float] = TARGETS) -> DataFrame:
    """The fastest successful run of each problem whose error is at most target * size.

    Parameters
    ----------
    table : pandas DataFrame
        Of a study.
    targets : sequence of float
        Errors relative to sup |u_i|_A, the same for every problem and in all units.

    Returns
    -------
    pandas DataFrame
        A row a problem and target, with the columns of the run and its target; a target
        that no run meets has no row.
    """
    require_columns(table, CellRow._fields)
    known = table[table.success & table.error.notna()].sort_values("wall", kind="stable")
    chosen = [
        known[known.error <= target * known["size"]]
        .drop_duplicates("problem")
        .assign(target=target)
        for target in targets
    ]
    return concat(chosen, ignore_index=True)


def fastest_runs(study: "Study", table: DataFrame) -> dict[str, Solution]:
    """The fastest run of each problem that meets the first target, solved again.

    Its relative error is so large that its band can be seen.
    """
    chosen = set(advice(table, TARGETS[:1]).run)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SweepoptWarning)  # the table has them
        return {
            f"{cell.problem.name}: {cell.scheme}, {cell.steps} steps": solution_of(cell)
            for cell in study.runs()
            if cell.id in chosen
        }


MOST_COSTLY = 100.0  # a larger factor of the time for half the error is inf: an order below 0.15


def halving(table: DataFrame) -> DataFrame:
    """What half the error would cost, along each axis, from the best runs on.

    The best runs are those that are more accurate by a tenth than all faster ones of the problem.
    Along an axis the next run of the same scheme and solver is taken, all other settings equal.
    Through the two, error = constant * wall^-p, so that half the error takes 2^(1/p) times the
    time: a local estimate from what was measured.

    Parameters
    ----------
    table : pandas DataFrame
        Of a study.

    Returns
    -------
    pandas DataFrame
        A row a run, with its columns, one for each axis in `AXES` called "more steps"
        for example: the factor of the time, inf where it is above 100, here or before the error
        is half, nan where no next run was measured; and `cheapest`, the axis of the least factor.
        If all are inf, it names the axes along which the fastest run with half the error is
        further, if they are two or more, else "".
    """
    require_columns(table, CellRow._fields)
    known = table[table.success & (table.error > 0)].sort_values(["wall", "error"], kind="stable")
    factors = {}
    for words, (axis, smaller) in AXES.items():
        cells = known.sort_values(axis, ascending=not smaller)
        same = [column for column in SETTINGS if column != axis]
        runs = cells.groupby(same)[["error", "wall"]]
        following, least = runs.shift(-1), cells[::-1].groupby(same).error.cummin()
        fall = np.log(cells.error / following.error)
        # more accurate in less time is possible: times are measured
        rise = np.log(following.wall / cells.wall).clip(lower=0.0)
        steep = fall > rise / np.log2(MOST_COSTLY)
        factor = np.exp2((rise / fall).where(steep, np.inf)).where(rise.notna())
        # no run further along has half the error, and between the last two it hardly falls
        last = factor.groupby([cells[column] for column in same]).transform("last")
        factors[words] = factor.where((least / cells.error <= 0.5) | (last != np.inf), np.inf)
    cells = known.assign(**factors)
    faster = cells.groupby("problem").error.transform(lambda x: x.cummin().shift(fill_value=np.inf))
    best = cells[cells.error < 0.9 * faster].sort_values("problem", kind="stable")
    possible = best[list(AXES)].fillna(np.inf)
    cheapest = possible.idxmin(axis="columns")
    alone = possible.min(axis="columns") < np.inf
    cheapest[~alone] = [_axes_together(known, run) for run in best.index[~alone]]
    return best.assign(cheapest=cheapest)


def _axes_together(cells: DataFrame, run: Any) -> str:
    """Along which axes, two or more, the fastest run with half the error of this one is further."""
    same = ["problem", "scheme", "solver"]
    alike = (cells[same] == cells.loc[run, same]).all(axis=1)
    others = cells[alike & (cells.error <= cells.error[run] / 2)]
    for axis, smaller in AXES.values():
        own = cells.loc[run, axis]
        others = others[others[axis] <= own if smaller else others[axis] >= own]
    ahead = [
        words
        for words, (axis, _) in AXES.items()
        if len(others) and others.iloc[0][axis] != cells.loc[run, axis]
    ]
    return " and ".join(ahead) if len(ahead) > 1 else ""


def readable(cells: DataFrame, *columns: str) -> DataFrame:
    """Columns of advice behind settings, relative error and time of its cells."""
    shown = cells.assign(**{"relative error": cells.error / cells["size"], "ms": 1e3 * cells.wall})
    return shown[[*SETTINGS, "relative error", "ms", *columns]]


def summary(table: DataFrame, targets: Sequence[float] = TARGETS) -> str:
    """The advice as text, and the failures below."""
    chosen = readable(advice(table, targets), "target")
    failures = table[~table.success].status.value_counts()
    unknown = int((table.success & table.error.isna()).sum())
    words = chosen.to_string(**FORMAT) if len(chosen) else f"no run meets {max(targets):g}"
    lines = ["the fastest way to each relative error", words, ""]
    lines += ["factor of the time for half the error, from the best runs on"]
    lines += [readable(halving(table), "cheapest", *AXES).to_string(**FORMAT)]
    lines += ["", f"{len(table)} runs, {failures.sum()} failed"]
    lines += [f"  {count:4}  {status}" for status, count in failures.items()]
    if unknown:
        lines.append(f"  {unknown:4}  succeeded, but no reference is good enough for an error")
    return "\n".join(lines)


# ---- the page ----

HIDDEN = ["repeats", "run", "success", "size", "cpu", "steps_done", "machine", "message"]
"""Columns of a study's table that its page does not show, but for the message, which is last."""
SYMBOLS = "osDPx^v"
"""Matplotlib's names of Plotly's symbols 0 to 6, of which 100 to 106 are the open ones."""
TOOLTIP = """\
{0.scheme}<br>solver={0.solver}<br>steps={0.steps}<br>tol={0.tol:g}<br>error={0.error:.3g}<br>\
bound={0.bound:.3g}<br>wall={0.wall:.3g} s<br>solver calls={0.solver_calls:.0f}<br>{0.status}"""
"""Of a row of the study's table."""
PAGE = Template("""\
<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>$title</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data: blob:; \
style-src 'unsafe-inline'; script-src 'unsafe-inline'">
<style>
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1500px; margin: auto; padding: 1rem; }
.about { color: #555; font-size: 13px; }
table { display: block; max-height: 36rem; overflow: auto; }
table { border-collapse: collapse; font-size: 13px; font-variant-numeric: tabular-nums; }
th, td { border: 0; border-bottom: 1px solid #ddd; padding: 0.2rem 0.6rem; text-align: left; }
td { vertical-align: top; min-width: 4rem; max-width: 18rem; overflow-wrap: break-word; }
td:last-child { min-width: 20rem; max-width: 40rem; overflow-wrap: anywhere; }
thead th { position: sticky; top: 0; background: #f2f4f7; }
img { max-width: 100%; }
</style>
<script>$plotly</script></head>
<body><h1>$title</h1><p class="about">$about</p>
$body
</body></html>
""")


def write_report(
    table: DataFrame | None,
    path: str | os.PathLike[str],
    *,
    solutions: Mapping[str, Solution] | None = None,
    title: str = "Accuracy and what it costs",
    **suites: Sequence[Any],
) -> Path:
    """Write a study as one HTML file; nothing is fetched when it is opened.

    Parameters
    ----------
    table : pandas DataFrame or None
        Of a study, one row a run; None if there are hard cases only.
    path : path
        The file to write; one that is there is replaced.
    solutions : mapping of str to Solution, optional
        Runs to show over time, by name: the component that moves most, in its guaranteed band.
    title : str
        The report's heading.
    **suites : sequences of named tuples
        Rows of hard cases, hard=, of trajectories=, and of stiff= bodies.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If the table is not a study's or the path no place for a file.
    """
    for name in suites:
        choice("name", name, SUITES)
    if table is None and not any(map(len, suites.values())):
        raise InputError("table is None and there are no hard cases: nothing to report")
    target = writable("path", path)
    parts, machines = [], [machine()]
    if table is not None:
        parts += _study_section(table)
        machines = table.machine.unique()
    if solutions:
        parts += ["<h2>Trajectories in their guaranteed bands</h2>", _picture(solutions)]
    for name, rows in suites.items():
        if len(rows):
            parts += _suite_section(name, rows)
    date = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    page = PAGE.substitute(
        title=html.escape(title),
        about=html.escape("; ".join([date, *machines])),
        plotly=get_plotlyjs(),
        body="\n".join(parts),
    )
    put(target, page.encode("utf-8"))
    return target


def _study_section(table: DataFrame) -> list[str]:
    diagrams = [_diagram(table, cost) for cost in COSTS]
    usual = Status.SUCCESS.value  # the one message that need not be shown
    message = table.message.str.replace(usual, "", regex=False)
    return [
        "<h2>The fastest way to each relative error</h2>",
        readable(advice(table), "target").to_html(border=0, **FORMAT),
        "<h2>Where half the error is cheapest</h2>",
        "<p>For the runs that are more accurate by a tenth than all faster ones: the factor of the "
        "time that half the error takes along each axis, by the next run measured there.</p>",
        readable(halving(table), "cheapest", *AXES).to_html(border=0, **FORMAT),
        "<h2>What accuracy costs</h2>",
        "<p>Down is more accurate, left is cheaper; what failed stands above the others, an error "
        "of 0 below them. A click in the legend hides a line in all panels, a double click hides "
        "all others.</p>",
        *diagrams,
        "<h2>All runs</h2>",
        _table(
            table.drop(columns=HIDDEN).assign(message=message),
            "status",
            table.success,
            "failed",
        ),
    ]


def _suite_section(name: str, rows: Sequence[Any]) -> list[str]:
    table = DataFrame(rows)
    title, text = str(getdoc(SUITES[name])).split("\n\n")[:2]
    good = table.verdict.isin(GOOD)
    return [
        f"<h2>{title.rstrip('.')}</h2><p>{html.escape(text)}</p>",
        _table(table, "verdict", good, "wrong"),
    ]


def _diagram(table: DataFrame, cost: str) -> str:
    """What `work_precision` draws, with a legend that filters and a tooltip a cell."""
    places = points(table, cost)
    names = places.panel.unique().tolist()
    rows, columns = lines_and_columns(len(names))
    figure = make_subplots(rows, columns, subplot_titles=names, horizontal_spacing=0.06)
    labels: set[str] = set()
    for (panel, label, marker, line, colour, _), cells in places.groupby(LOOK, sort=False):
        row, column = divmod(names.index(panel), columns)
        figure.add_scatter(
            x=cells.x,
            y=cells.y,
            mode="+".join(["lines"] * bool(line) + ["markers"] * bool(marker)),
            line_color=colour,
            line_dash="dash" if line == "--" else "solid",
            marker_symbol=SYMBOLS.find(marker) + 100 * (not line),
            name=label,
            legendgroup=label,
            showlegend=label not in labels,
            hovertext=list(map(TOOLTIP.format, cells.itertuples())),
            hoverinfo="text",
            row=row + 1,
            col=column + 1,
        )
        labels.add(label)
    figure.update_xaxes(type="log", exponentformat="power", title=COSTS[cost])
    figure.update_yaxes(type="log", exponentformat="power", title=f"{ERROR}, |·|<sub>A</sub>")
    figure.update_layout(template="plotly_white", height=120 + 320 * rows)
    config = {"displaylogo": False, "responsive": True}
    return figure.to_html(full_html=False, include_plotlyjs=False, config=config)


def _picture(solutions: Mapping[str, Solution]) -> str:
    file = io.BytesIO()
    trajectories(solutions).figure.savefig(file, format="svg")
    return f'<img src="data:image/svg+xml;base64,{base64.b64encode(file.getvalue()).decode()}">'


def _table(table: DataFrame, column: str, good: Series, fault: str) -> str:
    """What is not good comes first, marked in a column; text is escaped by pandas."""
    marked = table[column].where(good, "✗ " + table[column])
    table = table.assign(**{column: marked}).loc[good.sort_values(kind="stable").index]
    count = f"<p>{len(table)} runs, {(~good).sum()} {fault}</p>"
    return count + table.to_html(border=0, **FORMAT)
