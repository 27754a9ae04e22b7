"""A study as one HTML file that works without a network: diagrams by Plotly, tables by pandas.

Plotly's script stands in the file, and the file's policy lets nothing be loaded from elsewhere.
What comes from a table is text in it, never HTML.
"""

from __future__ import annotations

import html
import os
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.checks import choice
from sweepopt.errors import InputError, Status, brought_by
from sweepopt.io import put, writable
from sweepopt.results import Solution
from sweepopt.study.advice import advice_table, halving_table
from sweepopt.study.cell import guaranteed_bound
from sweepopt.study.diagram import ACCURACIES, BOUND, COLOURS, COLUMNS, COSTS, points
from sweepopt.study.hard.verdicts import GOOD, TARGET
from sweepopt.study.suites import SUITES
from sweepopt.study.workers import machine

if TYPE_CHECKING:
    from pandas import DataFrame, Series

SHOWN = [
    *("problem", "refinements", "element", "scheme", "solver", "steps", "tol", "status"),
    *("error", "reference_error", "bound"),
    *("certificate", "wall", "solver_calls", "unknowns", "path", "message"),
]
TOOLTIP = {
    **{"x": False, "y": False, "kind": False, "steps": True, "tol": ":g", "error": ":.2e"},
    **{"bound": ":.2e", "wall": ":.3g", "solver_calls": ":.0f", "status": True},
}
"""Columns of a cell's tooltip and their formats."""
BAND = "rgba(0, 114, 178, 0.25)"
LEAST = 1e-18
"""Hard cases: errors of 0, of bodies at rest, are drawn here."""
PAGE = Template("""\
<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>$title</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data: blob:; \
style-src 'unsafe-inline'; script-src 'unsafe-inline'">
<style>
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1500px; margin: auto; padding: 1rem; }
.about { color: #555; font-size: 13px; }
.scroll { max-height: 36rem; overflow: auto; }
table { border-collapse: collapse; font-size: 13px; font-variant-numeric: tabular-nums; }
th, td { border: 0; border-bottom: 1px solid #ddd; padding: 0.2rem 0.6rem; text-align: left; }
td { vertical-align: top; min-width: 4rem; max-width: 18rem; overflow-wrap: break-word; }
td:last-child { min-width: 20rem; max-width: 40rem; overflow-wrap: anywhere; }
thead th { position: sticky; top: 0; background: #f2f4f7; }
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
    **judged: Sequence[Any],
) -> Path:
    """Write a study as one HTML file; nothing is fetched when it is opened.

    Parameters
    ----------
    table : pandas DataFrame or None
        Of a study, one row a cell; None if there are hard cases only.
    path : path
        The file to write; one that is there is replaced.
    solutions : mapping of str to Solution, optional
        Runs to show over time, by name: the component that moves most, in its guaranteed band.
    title : str
        The report's heading.
    **judged : sequences of named tuples
        Rows of hard cases, hard=, of trajectories=, and of stiff= bodies.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If the table is not a study's or the path no place for a file.
    MissingExtraError
        If Plotly is not installed.
    """
    for name in judged:
        choice("name", name, SUITES)
    if table is None and not any(map(len, judged.values())):
        raise InputError("table is None and there are no hard cases: nothing to report")
    target = writable("path", path)
    with brought_by("study"):
        from plotly.offline import get_plotlyjs

    parts, machines = [], [machine()]
    if table is not None:
        parts += _study_section(table)
        machines = table.machine.unique()
    if solutions:
        parts.append("<h2>Trajectories in their guaranteed bands</h2>")
        parts.append(_page_of(_trajectories(solutions)))
    for name, rows in judged.items():
        if len(rows):
            parts += _judged_section(name, rows)
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
    figures = [_page_of(_cost_figure(table, cost)) for cost in COSTS]
    usual = Status.SUCCESS.value  # the one message that need not be shown
    shown = table[SHOWN].assign(message=table.message.str.replace(usual, "", regex=False))
    return [
        "<h2>The fastest way to each relative error</h2>",
        advice_table(table).to_html(border=0),
        "<h2>Where half the error is cheapest</h2>",
        "<p>For the runs that are more accurate by a tenth than all faster ones: the factor of the "
        "time that half the error takes along each axis, by the next cell measured there.</p>",
        halving_table(table).to_html(border=0),
        "<h2>What accuracy costs</h2>",
        "<p>Down is more accurate, left is cheaper; what failed stands above the others, an error "
        "of 0 below them. A click in the legend hides a line in all panels, a double click hides "
        "all others.</p>",
        *figures,
        "<h2>All cells</h2>",
        _table(shown, "status", table.success, "cells", "failed"),
    ]


def _cost_figure(table: DataFrame, cost: str) -> Any:
    """Error against a cost, a panel a problem with its mesh."""
    import plotly.express as px

    cells = points(table, cost, "error")
    figure = px.line(
        cells.sort_values("steps", kind="stable"),
        x="x",
        y="y",
        color="line",
        symbol="solver",
        line_dash="kind",
        line_dash_map={"known": "solid", BOUND: "dash"},
        category_orders={name: list(cells[name].unique()) for name in ("line", "solver")},
        hover_data=TOOLTIP,
        labels={"x": COSTS[cost], "y": f"{ACCURACIES['error']}, |·|<sub>A</sub>"},
        log_x=True,
        log_y=True,
        **_panels("panel", cells.panel.nunique()),
    )
    names: set[str] = set()
    for trace in figure.data:
        line, kind, solver = trace.name.split(", ")
        name = f"{line} · {solver}" if kind == "known" else kind
        trace.update(name=name, legendgroup=name, showlegend=name not in names)
        trace.mode = {"known": "lines+markers", BOUND: "lines"}.get(kind, "markers")
        if trace.mode == "markers":
            trace.marker.symbol = "x" if kind == "failed" else "circle-open"
        names.add(name)
    return figure


def _trajectories(solutions: Mapping[str, Solution]) -> Any:
    """A panel a run: the component that moves most, in its guaranteed band if there is one."""
    import pandas as pd
    import plotly.express as px

    curves = []
    for name, solution in solutions.items():
        k = int(np.argmax(np.ptp(solution.u, axis=0)))
        bound, band = guaranteed_bound(solution), np.full(len(solution.t), np.nan)
        if bound is not None:  # |u_k - u_n,k| <= |e|_A sqrt((A^-1)_kk)
            inverse = solution.process.metric.solve(np.eye(1, solution.process.dim, k)[0])
            band = np.sqrt(inverse[k]) * np.append(bound.of_t[:1], bound.of_t)
        curve = {"t": solution.t, "u": solution.u[:, k], "band": band, "run": f"{name}, u[{k}]"}
        curves.append(pd.DataFrame(curve))
    panels = _panels("run", len(curves))
    figure = px.line(pd.concat(curves), x="t", y="u", error_y="band", **panels)
    return figure.update_traces(error_y={"color": BAND, "thickness": 4, "width": 0})


def _judged_section(name: str, rows: Sequence[Any]) -> list[str]:
    import pandas as pd

    table, suite = pd.DataFrame(rows), SUITES[name]
    return [
        f"<h2>{suite.title}</h2>",
        f"<p>{suite.text}</p>",
        _page_of(_hard_figure(table)) if name == "hard" else "",
        _table(
            table.drop(columns="excess", errors="ignore"),
            "verdict",
            table.verdict.isin(GOOD),
            "runs",
            "wrong",
        ),
    ]


def _hard_figure(table: DataFrame) -> Any:
    """The true error of each run against its certificate."""
    import plotly.express as px

    sizes = table[["certificate", "error"]].clip(lower=LEAST)
    figure = px.scatter(
        table.assign(**sizes).dropna(subset="error"),
        x="certificate",
        y="error",
        color="solver",
        symbol="solver",
        color_discrete_sequence=COLOURS,
        hover_data=["family", "seed", "path", "solved_by", "verdict"],
        labels={"certificate": "certificate, relative", "error": "true error, relative"},
        log_x=True,
        log_y=True,
    )
    diagonal = {"text": "error = certificate&nbsp; ", "textposition": "end", "yanchor": "top"}
    figure.add_shape(type="line", x0=LEAST, y0=LEAST, x1=1, y1=1, label=diagonal)
    return figure.add_hline(
        TARGET, line_dash="dot", label={"text": "target", "textposition": "end"}
    )


def _panels(column: str, count: int) -> dict[str, Any]:
    """Arguments of Plotly Express for a panel a name, and for colours as in the picture."""
    return {
        "facet_col": column,
        "facet_col_wrap": min(count, COLUMNS),
        "facet_col_spacing": 0.06,  # for numbers at each axis
        "height": 120 + 320 * -(-count // COLUMNS),
        "color_discrete_sequence": COLOURS,
    }


def _page_of(figure: Any) -> str:
    """A diagram as a part of the page."""
    # "run=block" of a panel's title
    figure.for_each_annotation(lambda one: one.update(text=one.text.rpartition("=")[2]))
    figure.update_layout(template="plotly_white", legend_title_text="")
    figure.update_layout(margin={"t": 60, "l": 60, "r": 20, "b": 50})
    for update in (figure.update_xaxes, figure.update_yaxes):
        update(matches=None, showticklabels=True, exponentformat="power")
    config = {"displaylogo": False, "responsive": True}
    return str(figure.to_html(full_html=False, include_plotlyjs=False, config=config))


def _table(table: DataFrame, column: str, good: Series, things: str, fault: str) -> str:
    """What is not good comes first, marked in a column; text is escaped by pandas."""
    marked = table[column].where(good, "✗ " + table[column])
    table = table.assign(**{column: marked}).loc[good.sort_values(kind="stable").index]
    text = table.to_html(index=False, border=0, na_rep="-", float_format="{:.3g}".format)
    count = f"<p>{len(table)} {things}, {(~good).sum()} {fault}</p>"
    return f'{count}<div class="scroll">{text}</div>'
