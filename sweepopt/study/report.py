"""A study as one HTML file that works without a network: diagrams by Plotly, tables by pandas.

Plotly's script stands in the file, and the file's policy lets nothing be loaded from elsewhere.
What comes from a table is text in it, never HTML.
"""

from __future__ import annotations

import html
import os
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

from sweepopt.errors import InputError, Status, brought_by
from sweepopt.io import put
from sweepopt.results import Solution
from sweepopt.study.advice import advice_table
from sweepopt.study.band import most_moving
from sweepopt.study.diagram import ACCURACIES, COLOURS, COLUMNS, COSTS, check_table, placed
from sweepopt.study.hard import FAMILIES
from sweepopt.study.hard.suite import TARGET, HardRow
from sweepopt.study.machine import processor, versions

if TYPE_CHECKING:
    from pandas import DataFrame, Series

SHOWN = [
    *("problem", "scheme", "solver", "steps", "tol", "status", "error", "bound", "guaranteed"),
    *("certificate", "wall", "solver_calls", "unknowns", "path", "message"),
]
NUMBERS = {"tol": ":g", "error": ":.2e", "bound": ":.2e", "wall": ":.3g", "solver_calls": ":.0f"}
TOOLTIP: dict[str, Any] = {"y": False, "kind": False, "steps": True, **NUMBERS, "status": True}
"""Columns of a cell's tooltip and their formats."""
STYLES: dict[str, Any] = {
    "known": {"mode": "lines+markers", "marker_size": 8},
    "guaranteed bound": {"mode": "lines"},
    "failed": {"mode": "markers", "marker": {"symbol": "x", "size": 9}},
}
UNKNOWN: dict[str, Any] = {"mode": "markers", "marker": {"symbol": "circle-open", "size": 9}}
"""How a line is drawn, by the kind of its cells."""
BAND = "guaranteed band"
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
td { vertical-align: top; white-space: nowrap; }
td:last-child { white-space: normal; min-width: 20rem; overflow-wrap: anywhere; }
thead th { position: sticky; top: 0; background: #f2f4f7; }
.bad { color: #b3261e; font-weight: 600; }
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
    hard: Sequence[HardRow] = (),
    title: str = "Accuracy and what it costs",
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
    hard : sequence of HardRow
        Runs of hard cases of this session.
    title : str
        The report's heading.

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
    if table is None and not hard:
        raise InputError("table is None and there are no hard cases: nothing to report")
    target = Path(path)
    if not target.absolute().parent.is_dir():
        raise InputError(f"path {str(target)!r} lies in a folder that does not exist; make it")
    if target.is_dir():
        raise InputError(f"path {str(target)!r} is a folder; name a file in it")
    with brought_by("study"):
        from plotly.offline import get_plotlyjs

    parts = []
    here = {"machine": processor(), **versions()}
    if table is not None:
        check_table(table)
        here = {name: " / ".join(map(str, table[name].unique())) for name in here}
        parts += _study_section(table)
    if solutions:
        parts += ["<h2>Trajectories</h2>", _page_of(_trajectories(solutions))]
    if hard:
        parts += _hard_section(hard)
    date = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    about = [date, here.pop("machine"), ", ".join(" ".join(pair) for pair in here.items())]
    page = PAGE.substitute(
        title=html.escape(title),
        about=html.escape("; ".join(about)),
        plotly=get_plotlyjs(),
        body="\n".join(parts),
    )
    put(target, page.encode("utf-8"))
    return target


def _study_section(table: DataFrame) -> list[str]:
    usual = Status.SUCCESS.value  # the one message that need not be shown
    shown = table[SHOWN].assign(message=table.message.str.replace(usual, "", regex=False))
    return [
        "<h2>The fastest way to each relative error</h2>",
        advice_table(table).to_html(border=0),
        "<h2>What accuracy costs</h2>",
        "<p>Down is more accurate, left is cheaper; what failed stands above the others, an error "
        "of 0 below them. A click in the legend hides a line in all panels, a double click hides "
        "all others.</p>",
        _page_of(_cost_figure(table)),
        "<h2>All cells</h2>",
        _count(len(table), "cells", int((~table.success).sum()), "failed"),
        _table(shown, "status", table.success),
    ]


def _cost_figure(table: DataFrame) -> Any:
    """Error against cost, a panel a problem; a menu chooses the cost."""
    import plotly.express as px

    figure = px.line(
        _points(table),
        x=COSTS["wall"],
        y="y",
        color="scheme",
        symbol="solver",
        line_dash="kind",
        line_dash_map={"known": "solid", "guaranteed bound": "dash"},
        line_group="tol",
        category_orders={name: list(table[name].unique()) for name in ("scheme", "solver")},
        custom_data=list(COSTS.values()),
        hover_data=TOOLTIP,
        **_panels("problem", table.problem),
    )
    names: set[str] = set()
    for trace in figure.data:
        scheme, kind, solver = trace.name.split(", ")
        name = f"{scheme} · {solver}" if kind == "known" else kind
        trace.update(name=name, legendgroup=name, showlegend=name not in names)
        trace.update(STYLES.get(kind, UNKNOWN))
        names.add(name)
    axis = {"type": "log", "exponentformat": "power", "matches": None, "showticklabels": True}
    figure.update_xaxes(title_text=COSTS["wall"], **axis)
    figure.update_yaxes(title_text="", **axis)
    figure.update_yaxes(title_text=f"{ACCURACIES['error']}, |·|<sub>A</sub>", col=1)
    return figure.update_layout(updatemenus=[_cost_menu(figure)])


def _points(table: DataFrame) -> DataFrame:
    """The cells of all panels, with a place for each cost, and their guaranteed bounds."""
    import pandas as pd

    panels = []
    for _, rows in table.sort_values("steps", kind="stable").groupby("problem", sort=False):
        for cost, words in COSTS.items():
            rows = placed(rows, cost, "error").rename(columns={"x": words})
        panels.append(rows)
    cells = pd.concat(panels)
    proved = cells[(cells.kind == "known") & cells.guaranteed]
    return pd.concat([cells, proved.assign(y=proved.bound, kind="guaranteed bound")])


def _cost_menu(figure: Any) -> dict[str, Any]:
    """A menu that moves all points to another cost."""
    titles = [f"{name}.title.text" for name in figure.layout if name.startswith("xaxis")]
    buttons = []
    for k, words in enumerate(COSTS.values()):
        costs = [trace.customdata[:, k].tolist() for trace in figure.data]
        change = [{"x": costs}, dict.fromkeys(titles, words)]
        buttons.append({"label": words, "method": "update", "args": change})
    return {"buttons": buttons, "x": 1.02, "xanchor": "left", "y": 1.0, "yanchor": "bottom"}


def _trajectories(solutions: Mapping[str, Solution]) -> Any:
    """A panel a run: the component that moves most, in its guaranteed band."""
    import pandas as pd
    import plotly.express as px

    curves = []
    for name, solution in solutions.items():
        t, u, band, k = most_moving(solution)
        curve = {"t": t, "lower": u - band, BAND: u + band, "computed": u}
        curves.append(pd.DataFrame(curve).assign(run=f"{name}, u[{k}]"))
    frame = pd.concat(curves)
    figure = px.line(frame, x="t", y=["lower", BAND, "computed"], **_panels("run", frame.run))
    figure.update_traces(line_color=COLOURS[0])
    figure.update_traces(line_width=0, showlegend=False, selector={"name": "lower"})
    figure.update_traces(line_width=0, fill="tonexty", selector={"name": BAND})
    figure.update_xaxes(matches=None, showticklabels=True, title_text="t")
    return figure.update_yaxes(matches=None, showticklabels=True, title_text="")


def _hard_section(hard: Sequence[HardRow]) -> list[str]:
    import pandas as pd

    table, good = pd.DataFrame(hard), pd.Series([row.good for row in hard])
    families = [name for name in table.family.unique() if name in FAMILIES]
    about = pd.DataFrame(
        {"what is hard about it": [", ".join(FAMILIES[name]) for name in families]}
    )
    return [
        "<h2>Hard cases</h2>",
        _count(len(table), "runs", int((~good).sum()), "wrong"),
        "<p>The worst step of each run, judged by its exact velocity: the true error stays below "
        f"{TARGET:g} and below the certificate. A click in the legend hides a solver.</p>",
        _page_of(_hard_figure(table)),
        _table(table.drop(columns="excess"), "verdict", good),
        "<h3>The families</h3>" + about.set_axis(families).to_html(border=0),
    ]


def _hard_figure(table: DataFrame) -> Any:
    """The true error of each run against its certificate."""
    import plotly.express as px

    figure = px.scatter(
        table.dropna(subset="error").assign(
            certificate=table.certificate.clip(lower=LEAST), error=table.error.clip(lower=LEAST)
        ),
        x="certificate",
        y="error",
        color="solver",
        symbol="solver",
        color_discrete_sequence=COLOURS,
        hover_data=["family", "seed", "path", "solved_by", "verdict"],
        log_x=True,
        log_y=True,
    )
    diagonal = {"text": "error = certificate&nbsp; ", "textposition": "end", "yanchor": "top"}
    figure.add_shape(type="line", x0=LEAST, y0=LEAST, x1=1, y1=1, label=diagonal)
    figure.add_hline(TARGET, line_dash="dot", label={"text": "target", "textposition": "end"})
    figure.update_xaxes(title_text="certificate, relative", exponentformat="power")
    return figure.update_yaxes(title_text="true error, relative", exponentformat="power")


def _panels(column: str, names: Iterable[str]) -> dict[str, Any]:
    """Arguments of Plotly Express for a panel a name, and for colours as in the picture."""
    count = len(set(names))
    return {
        "facet_col": column,
        "facet_col_wrap": min(count, COLUMNS),
        "height": 120 + 320 * -(-count // COLUMNS),
        "color_discrete_sequence": COLOURS,
    }


def _page_of(figure: Any) -> str:
    """A diagram as a part of the page."""
    # "run=block" of a panel's title
    figure.for_each_annotation(lambda one: one.update(text=one.text.rpartition("=")[2]))
    figure.update_layout(template="plotly_white", legend_title_text="")
    figure.update_layout(margin={"t": 60, "l": 60, "r": 20, "b": 50})
    config = {"displaylogo": False, "responsive": True}
    return str(figure.to_html(full_html=False, include_plotlyjs=False, config=config))


def _count(total: int, things: str, bad: int, how: str) -> str:
    return f'<p class="{"bad" if bad else "good"}">{total} {things}, {bad} {how}</p>'


def _table(table: DataFrame, column: str, good: Series) -> str:
    """What is not good comes first, marked in a column; text is escaped by pandas."""
    marked = table[column].where(good, "✗ " + table[column])
    table = table.assign(**{column: marked}).loc[good.sort_values(kind="stable").index]
    text = table.to_html(index=False, border=0, na_rep="-", float_format="{:.3g}".format)
    return f'<div class="scroll">{text}</div>'
