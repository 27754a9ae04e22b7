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

from sweepopt.errors import InputError, Status, brought_by
from sweepopt.io import put
from sweepopt.results import Solution
from sweepopt.study.advice import advice_table
from sweepopt.study.band import most_moving
from sweepopt.study.diagram import (
    ACCURACIES,
    COLOURS,
    COLUMNS,
    COSTS,
    check_table,
    curves,
    indices,
    placed,
)
from sweepopt.study.hard import FAMILIES
from sweepopt.study.hard.table import TARGET, HardRow
from sweepopt.study.machine import processor, versions

if TYPE_CHECKING:
    from pandas import DataFrame

SYMBOLS = ("circle", "square", "triangle-up", "diamond", "triangle-down", "cross", "star")
SHOWN = [
    *("problem", "scheme", "solver", "steps", "tol", "status", "error", "bound", "guaranteed"),
    *("certificate", "wall", "solver_calls", "unknowns", "path", "message"),
]
LEAST = 1e-18  # hard cases: errors of 0, of bodies at rest, are drawn here
NUMBERS = {
    "tol": "g",
    "error": ".2e",
    "bound": ".2e",
    "certificate": ".1e",
    "seconds": ".3g",
    "solver_calls": ".0f",
    "unknowns": ".0f",
}
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
    if table is not None:
        check_table(table)
        parts += _study_section(table)
    if solutions:
        parts += ["<h2>Trajectories</h2>", _html(_trajectory_figure(solutions))]
    if hard:
        parts += _hard_section(hard)
    page = PAGE.substitute(
        title=html.escape(title),
        about=html.escape(_about(table)),
        plotly=get_plotlyjs(),
        body="\n".join(parts),
    )
    put(target, page.encode("utf-8"))
    return target


def _about(table: DataFrame | None) -> str:
    """When the report was written, and where its cells ran."""
    date = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    here = {"machine": processor(), **versions()}
    if table is not None:
        here = {name: " / ".join(map(str, table[name].unique())) for name in here}
    machine = here.pop("machine")
    return "; ".join([date, machine, ", ".join(" ".join(pair) for pair in here.items())])


# ---- the study --------------------------------------------------------------------------------


def _study_section(table: DataFrame) -> list[str]:
    failed = int((~table.success).sum())
    usual = Status.SUCCESS.value  # the one message that need not be shown
    status = ["" if good else "✗ " for good in table.success] + table.status
    message = table.message.str.replace(usual, "", regex=False)
    shown = table[SHOWN].assign(status=status, message=message).rename(columns={"wall": "seconds"})
    return [
        "<h2>The fastest way to each relative error</h2>",
        advice_table(table).to_html(border=0),
        "<h2>What accuracy costs</h2>",
        "<p>Down is more accurate, left is cheaper; what failed stands above the others, an error "
        "of 0 below them. A click in the legend hides a line in all panels, a double click hides "
        "all others.</p>",
        _html(_cost_figure(table)),
        f'<h2>All cells</h2><p class="{"bad" if failed else "good"}">{len(table)} cells, '
        f"{failed} failed</p>",
        _table(shown.iloc[np.argsort(table.success, kind="stable")]),
    ]


def _cost_figure(table: DataFrame) -> Any:
    """Error against cost, a panel a problem; a menu chooses the cost."""
    from plotly.subplots import make_subplots

    problems = list(table.problem.unique())
    columns = min(len(problems), COLUMNS)
    titles = [html.escape(problem) for problem in problems]
    figure = make_subplots(-(-len(problems) // columns), columns, subplot_titles=titles)
    schemes, solvers = indices(table, "scheme"), indices(table, "solver")
    cells: list[DataFrame] = []  # those of each trace, for the menu

    def add(k: int, rows: DataFrame, y: str, name: str, **style: Any) -> None:
        if len(rows):
            cells.append(rows)
            figure.add_scatter(
                x=rows.wall.tolist(),
                y=rows[y].tolist(),
                name=name,
                legendgroup=name,
                showlegend=name not in {trace.name for trace in figure.data},
                legendrank=1000 + (style["mode"] != "lines+markers"),
                hovertext=[_tooltip(row) for row in table.loc[rows.index].to_dict("records")],
                hoverinfo="text",
                row=k // columns + 1,
                col=k % columns + 1,
                **style,
            )

    for k, problem in enumerate(problems):
        for name, rows in curves(placed(table[table.problem == problem])):
            colour = COLOURS[schemes[rows.scheme.iloc[0]] % len(COLOURS)]
            symbol = SYMBOLS[solvers[rows.solver.iloc[0]] % len(SYMBOLS)]
            known = rows[rows.kind == "known"]
            marker = {"symbol": symbol, "size": 8}
            add(k, known, "y", name, mode="lines+markers", line_color=colour, marker=marker)
            proved = known[known.guaranteed & np.isfinite(known.bound)]
            dashed = {"dash": "dash", "width": 1, "color": colour}
            add(k, proved, "bound", "guaranteed bound", mode="lines", line=dashed)
            for kind, others in rows[rows.kind != "known"].groupby("kind"):
                sign = "x" if kind == "failed" else "circle-open"
                marker = {"symbol": sign, "size": 9, "color": colour}
                add(k, others, "y", kind, mode="markers", marker=marker)
    axis = {"type": "log", "exponentformat": "power"}
    figure.update_xaxes(title_text=COSTS["wall"], **axis)
    figure.update_yaxes(**axis)
    figure.update_yaxes(title_text=f"{ACCURACIES['error']}, |·|<sub>A</sub>", col=1)
    titles = [f"{name}.title.text" for name in figure.layout if name.startswith("xaxis")]
    buttons = [
        {
            "label": words,
            "method": "update",
            "args": [{"x": [rows[cost].tolist() for rows in cells]}, dict.fromkeys(titles, words)],
        }
        for cost, words in COSTS.items()
    ]
    menu = {"buttons": buttons, "x": 1.02, "xanchor": "left", "y": 1.0, "yanchor": "bottom"}
    height = 120 + 330 * -(-len(problems) // columns)
    figure.update_layout(updatemenus=[menu], height=height)
    return figure


def _tooltip(row: dict[str, Any]) -> str:
    """A cell in the lines of a tooltip, escaped: Plotly reads some HTML in it."""
    lines = [
        f"{row['scheme']} · {row['solver']}, {row['steps']} steps, tol {row['tol']:g}",
        f"{row['wall']:.3g} s, {row['solver_calls']:.0f} solver calls",
        f"error {row['error']:.2e}, bound {row['bound']:.2e}",
    ]
    if not row["success"]:
        lines = [lines[0], row["status"], row["message"][:200]]
    return "<br>".join(html.escape(str(line)) for line in lines)


# ---- trajectories -----------------------------------------------------------------------------


def _trajectory_figure(solutions: Mapping[str, Solution]) -> Any:
    """A panel a run, with its guaranteed band."""
    from plotly.subplots import make_subplots

    curves = {name: most_moving(solution) for name, solution in solutions.items()}
    columns = min(len(curves), COLUMNS)
    titles = [html.escape(f"{name}, u[{curve.component}]") for name, curve in curves.items()]
    figure = make_subplots(-(-len(curves) // columns), columns, subplot_titles=titles)
    for k, (t, u, band, _) in enumerate(curves.values()):
        place = {"row": k // columns + 1, "col": k % columns + 1}
        known = band is not None
        figure.add_scatter(
            x=t.tolist(),
            y=u.tolist(),
            name="computed",
            legendgroup="computed",
            showlegend=k == 0,
            line_color=COLOURS[0],
            customdata=band.tolist() if band is not None else None,
            hovertemplate="t = %{x:.5g}<br>u = %{y:.5g}" + known * " ± %{customdata:.2g}",
            **place,
        )
        if band is not None:
            figure.add_scatter(
                x=np.concatenate([t, t[::-1]]).tolist(),
                y=np.concatenate([u + band, (u - band)[::-1]]).tolist(),
                name="guaranteed band",
                legendgroup="guaranteed band",
                showlegend="guaranteed band" not in {trace.name for trace in figure.data},
                fill="toself",
                mode="none",
                opacity=0.3,
                fillcolor=COLOURS[0],
                hoverinfo="skip",
                **place,
            )
    figure.update_layout(height=80 + 300 * -(-len(curves) // columns))
    figure.update_xaxes(title_text="t")
    return figure


# ---- hard cases -------------------------------------------------------------------------------


def _hard_section(rows: Sequence[HardRow]) -> list[str]:
    import pandas as pd

    wrong = sum(not row.good for row in rows)
    table = pd.DataFrame(rows)
    table["verdict"] = [("✓ " if row.good else "✗ ") + row.verdict for row in rows]
    table = table.iloc[np.argsort([row.good for row in rows], kind="stable")]
    about = pd.DataFrame(
        [(name, FAMILIES[name].__doc__) for name in table.family.unique() if name in FAMILIES],
        columns=["family", "what is hard about it"],
    )
    return [
        "<h2>Hard cases</h2>",
        f'<p class="{"bad" if wrong else "good"}">{len(rows)} runs, {wrong} wrong</p>',
        "<p>The worst step of each run, judged by its exact velocity: the true error stays below "
        f"{TARGET:g} and below the certificate. A click in the legend hides a solver.</p>",
        _html(_hard_figure(rows)),
        _table(table.drop(columns="excess")),
        "<h3>The families</h3>" + _table(about),
    ]


def _hard_figure(rows: Sequence[HardRow]) -> Any:
    """The true error of each run against its certificate."""
    import plotly.graph_objects as go

    figure = go.Figure()
    for k, solver in enumerate(dict.fromkeys(row.solver for row in rows)):
        mine = [row for row in rows if row.solver == solver and row.error == row.error]
        figure.add_scatter(
            x=[max(row.certificate, LEAST) for row in mine],
            y=[max(row.error, LEAST) for row in mine],
            mode="markers",
            name=solver or "refused",
            marker={"color": COLOURS[k % len(COLOURS)], "symbol": SYMBOLS[k % len(SYMBOLS)]},
            hovertext=[
                "<br>".join(
                    html.escape(line)
                    for line in (
                        f"{row.family}, seed {row.seed}, {row.path}, {row.solver}",
                        f"error {row.error:.1e}, certificate {row.certificate:.1e}",
                        f"solved by {row.solved_by}: {row.verdict}",
                    )
                )
                for row in mine
            ],
            hoverinfo="text",
        )
    ends = [LEAST, 1.0]
    figure.add_scatter(x=ends, y=ends, mode="lines", name="error = certificate", line_color="#888")
    figure.add_scatter(
        x=ends, y=[TARGET] * 2, mode="lines", name="target", line={"color": "#888", "dash": "dot"}
    )
    axes = {"type": "log", "exponentformat": "power"}
    figure.update_xaxes(title_text="certificate, relative", **axes)
    figure.update_yaxes(title_text="true error, relative", **axes)
    figure.update_layout(height=480)
    return figure


# ---- both -------------------------------------------------------------------------------------


def _html(figure: Any) -> str:
    figure.update_layout(template="plotly_white", margin={"t": 60, "l": 60, "r": 20, "b": 50})
    config = {"displaylogo": False, "responsive": True}
    return str(figure.to_html(full_html=False, include_plotlyjs=False, config=config))


def _table(table: DataFrame) -> str:
    """Numbers in few digits, what is missing as a dash; text is escaped by pandas."""

    def written(form: str) -> Any:
        return lambda x: "-" if x != x else format(x, form)

    formats = {
        name: written(form)
        for name, form in NUMBERS.items()
        if name in table and table[name].dtype.kind == "f"
    }
    text = table.to_html(index=False, border=0, na_rep="-", formatters=formats)
    return f'<div class="scroll">{text}</div>'
