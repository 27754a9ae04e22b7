"""A study as one HTML file that works without a network: pictures by matplotlib, tables by pandas.

The pictures stand in the file, and its policy lets nothing be loaded from elsewhere or run. What
comes from a table is text in it, never HTML.
"""

from __future__ import annotations

import base64
import html
import io
import os
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from inspect import getdoc
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

from sweepopt.checks import choice
from sweepopt.errors import InputError, Status
from sweepopt.io import put, writable
from sweepopt.results import Solution
from sweepopt.study.advice import advice_table, halving_table
from sweepopt.study.diagram import trajectories, work_precision
from sweepopt.study.hard import GOOD, SUITES
from sweepopt.study.workers import machine

if TYPE_CHECKING:
    from pandas import DataFrame, Series

HIDDEN = ["repeats", "cell", "success", "size", "cpu", "steps_done", "machine", "message"]
"""Columns of a study's table that its page does not show, but for the message, which is last."""
PAGE = Template("""\
<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>$title</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; \
style-src 'unsafe-inline'">
<style>
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1500px; margin: auto; padding: 1rem; }
.about { color: #555; font-size: 13px; }
.scroll { max-height: 36rem; overflow: auto; }
table { border-collapse: collapse; font-size: 13px; font-variant-numeric: tabular-nums; }
th, td { border: 0; border-bottom: 1px solid #ddd; padding: 0.2rem 0.6rem; text-align: left; }
td { vertical-align: top; min-width: 4rem; max-width: 18rem; overflow-wrap: break-word; }
td:last-child { min-width: 20rem; max-width: 40rem; overflow-wrap: anywhere; }
thead th { position: sticky; top: 0; background: #f2f4f7; }
img { max-width: 100%; }
</style></head>
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
        Of a study, one row a cell; None if there are hard cases only.
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
    MissingExtraError
        If matplotlib is not installed.
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
        parts += [
            "<h2>Trajectories in their guaranteed bands</h2>",
            _picture(trajectories(solutions)),
        ]
    for name, rows in suites.items():
        if len(rows):
            parts += _suite_section(name, rows)
    date = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    page = PAGE.substitute(
        title=html.escape(title),
        about=html.escape("; ".join([date, *machines])),
        body="\n".join(parts),
    )
    put(target, page.encode("utf-8"))
    return target


def _study_section(table: DataFrame) -> list[str]:
    pictures = [_picture(work_precision(table, x=cost)) for cost in ("wall", "steps")]
    usual = Status.SUCCESS.value  # the one message that need not be shown
    message = table.message.str.replace(usual, "", regex=False)
    return [
        "<h2>The fastest way to each relative error</h2>",
        advice_table(table).to_html(border=0),
        "<h2>Where half the error is cheapest</h2>",
        "<p>For the runs that are more accurate by a tenth than all faster ones: the factor of the "
        "time that half the error takes along each axis, by the next cell measured there.</p>",
        halving_table(table).to_html(border=0),
        "<h2>What accuracy costs</h2>",
        "<p>Down is more accurate, left is cheaper; what failed stands above the others, an error "
        "of 0 below them.</p>",
        *pictures,
        "<h2>All cells</h2>",
        _table(
            table.drop(columns=HIDDEN).assign(message=message),
            "status",
            table.success,
            "cells",
            "failed",
        ),
    ]


def _suite_section(name: str, rows: Sequence[Any]) -> list[str]:
    import pandas as pd

    table = pd.DataFrame(rows)
    title, text = str(getdoc(SUITES[name])).split("\n\n")[:2]
    good, shown = table.verdict.isin(GOOD), table.drop(columns="excess", errors="ignore")
    return [
        f"<h2>{title.rstrip('.')}</h2><p>{html.escape(text)}</p>",
        _table(shown, "verdict", good, "runs", "wrong"),
    ]


def _picture(ax: Any) -> str:
    """A figure as a part of the page."""
    file = io.BytesIO()
    ax.figure.savefig(file, format="svg")
    return f'<img src="data:image/svg+xml;base64,{base64.b64encode(file.getvalue()).decode()}">'


def _table(table: DataFrame, column: str, good: Series, things: str, fault: str) -> str:
    """What is not good comes first, marked in a column; text is escaped by pandas."""
    marked = table[column].where(good, "✗ " + table[column])
    table = table.assign(**{column: marked}).loc[good.sort_values(kind="stable").index]
    text = table.to_html(index=False, border=0, na_rep="-", float_format="{:.3g}".format)
    count = f"<p>{len(table)} {things}, {(~good).sum()} {fault}</p>"
    return f'{count}<div class="scroll">{text}</div>'
