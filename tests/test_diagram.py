"""The work-precision diagram draws the table: its lines are compared with the numbers."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from study_table import STEPS, study_table

import sweepopt as so
from sweepopt.study import work_precision
from sweepopt.study.diagram import COLOURS, FAILED


def curves(ax: Any, style: str = "-") -> list[Any]:
    """Lines with two points or more, drawn in a style."""
    return [
        line for line in ax.lines if line.get_linestyle() == style and len(line.get_xdata()) > 1
    ]


def notes(ax: Any) -> list[str]:
    return [text.get_text() for text in ax.texts]


def block() -> pd.DataFrame:
    table = study_table()
    return table[table.problem == "block"]


def test_each_problem_has_a_panel_with_a_line_for_each_scheme_and_solver(tmp_path: Path) -> None:
    table = study_table()
    ax = work_precision(table)
    assert [panel.get_title() for panel in ax.figure.axes] == ["block", "pipe"]
    for panel in ax.figure.axes:
        assert (panel.get_xscale(), panel.get_yscale()) == ("log", "log")
        assert panel.get_xlabel() == "wall time (s)"
        assert "error" in panel.get_ylabel()
        drawn = curves(panel)
        good = table[(table.problem == panel.get_title()) & table.success & (table.error > 0)]
        wanted = [group for _, group in good.groupby(["scheme", "solver"])]
        assert len(drawn) == len(wanted) == 6
        for line, group in zip(drawn, wanted, strict=True):
            np.testing.assert_array_equal(line.get_xdata(), group.wall)
            np.testing.assert_array_equal(line.get_ydata(), group.error)
    ax.figure.savefig(tmp_path / "diagram.png")
    assert (tmp_path / "diagram.png").stat().st_size > 20_000


def test_guaranteed_bounds_are_dashed_companions_of_their_errors() -> None:
    first, second = work_precision(study_table()).figure.axes
    assert not curves(second, "--")  # bounds of the pipe are not guaranteed
    for line, bound in zip(curves(first), curves(first, "--"), strict=True):
        assert line.get_color() == bound.get_color()
        np.testing.assert_allclose(bound.get_ydata(), 1.7 * line.get_ydata())


def test_failures_stand_above_the_axes_with_their_status() -> None:
    first, second = work_precision(study_table()).figure.axes
    assert "INEXACT (3)" in notes(first)
    assert "UnstableStepError (2)" in notes(second)
    assert "no error known (2)" in notes(second)
    assert notes(first).count(FAILED) == 3
    assert notes(second).count(FAILED) == 2
    cross = next(text for text in first.texts if text.get_text() == FAILED)
    assert cross.xy == pytest.approx((3e-4 * 400, 1.0))
    unknown = next(text for text in second.texts if text.get_text() == FAILED)
    assert unknown.xy == (second.get_xlim()[1], 1.0)  # nobody knows its cost


def test_an_error_of_exactly_zero_lies_on_the_floor() -> None:
    first, second = work_precision(study_table()).figure.axes
    assert "0" in notes(first)
    assert "0" not in notes(second)


def test_bounds_that_are_not_guaranteed_are_open() -> None:
    ax = work_precision(study_table(), x="steps", y="bound").figure.axes[1]
    assert ax.get_xlabel() == "time steps"
    marks = [line for line in ax.lines if line.get_markerfacecolor() == "white"]
    assert len(marks) == 6 * len(STEPS) - 2
    labels = [text.get_text() for text in ax.figure.legends[0].get_texts()]
    assert "not guaranteed" in labels


def test_the_legend_names_colours_and_markers_once() -> None:
    ax = Figure().add_subplot()
    assert work_precision(block(), ax=ax) is ax
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels[:5] == ["scheme", "catching-up", "implicit-euler", "midpoint", "exact"]
    assert labels[5:8] == ["solver", "clarabel", "osqp"]
    assert labels[-2:] == ["guaranteed bound", "failed"]
    used = {line.get_color() for line in curves(ax)}
    assert used == set(COLOURS[:3])


def test_a_study_in_which_all_failed_has_a_picture(tmp_path: Path) -> None:
    table = study_table()
    ax = work_precision(table[~table.success])
    ax.figure.savefig(tmp_path / "failed.png")
    assert "no cell has a value" in notes(ax)
    assert notes(ax).count(FAILED) == 3


def test_a_run_without_solver_calls_is_not_lost() -> None:
    table = block().assign(solver_calls=0)
    ax = work_precision(table, x="solver_calls")
    assert {"no solver calls (22)", "INEXACT (3)"} <= set(notes(ax))


def test_tolerances_are_lines_of_their_own() -> None:
    table = block()
    loose = table.assign(tol=1e-4, wall=table.wall / 2)
    assert len(curves(work_precision(pd.concat([table, loose])))) == 12


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda table: work_precision(table, x="speed"), "x must be one of wall, cpu, steps"),
        (lambda table: work_precision(table, y="wall"), "y must be one of error, bound"),
        (lambda table: work_precision(table.drop(columns="wall")), r"lacks the columns \['wall'\]"),
        (lambda table: work_precision(table[:0]), "no rows"),
        (lambda table: work_precision([1, 2]), "must be a pandas DataFrame, got list"),
        (
            lambda table: work_precision(table.assign(wall="fast")),
            r"table\['wall'\] has 'fast' in row 0; give a number",
        ),
        (
            lambda table: work_precision(table.assign(steps=0.5)),
            r"table\['steps'\] has 0.5 in row 0; give a whole number",
        ),
        (
            lambda table: work_precision(table, ax=Figure().add_subplot()),
            "ax is one panel but table has the problems block, pipe",
        ),
    ],
)
def test_what_cannot_be_drawn_is_refused(call: Callable[[pd.DataFrame], Any], words: str) -> None:
    with pytest.raises(so.InputError, match=words):
        call(study_table())


def test_missing_matplotlib_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(so.MissingExtraError, match="pip install"):
        work_precision(study_table())
