"""The work-precision diagram draws the table: its lines are compared with the numbers."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from study_table import study_table

import sweepopt as so
from sweepopt.study import work_precision


def block() -> pd.DataFrame:
    table = study_table()
    return table[table.problem == "block"]


def labels(ax: Any) -> list[str]:
    """Names of the lines in the order in which they were drawn."""
    return [line.get_label() for line in ax.lines]


def test_each_problem_has_a_panel_with_a_line_for_each_scheme_and_solver() -> None:
    table = study_table()
    ax = work_precision(table)
    assert [panel.get_title() for panel in ax.figure.axes] == ["block", "pipe"]
    for panel in ax.figure.axes:
        assert (panel.get_xscale(), panel.get_yscale()) == ("log", "log")
        assert panel.get_xlabel() == "wall time (s)"
        here = table[(table.problem == panel.get_title()) & table.success & (table.error > 0)]
        for (scheme, solver), rows in here.groupby(["scheme", "solver"]):
            (line,) = [one for one in panel.lines if one.get_label() == f"{scheme} · {solver}"]
            np.testing.assert_array_equal(line.get_xdata(), rows.wall)
            np.testing.assert_array_equal(line.get_ydata(), rows.error)
    ax.figure.draw_without_rendering()


def test_guaranteed_bounds_are_dashed_companions_of_their_errors() -> None:
    first, second = work_precision(study_table()).figure.axes
    assert "guaranteed bound" not in labels(second)  # bounds of the pipe are not guaranteed
    bounds = [line for line in first.lines if line.get_label() == "guaranteed bound"]
    errors = [line for line in first.lines if "·" in line.get_label()][:6]
    for error, bound in zip(errors, bounds, strict=True):
        assert (bound.get_linestyle(), bound.get_color()) == ("--", error.get_color())
        np.testing.assert_allclose(bound.get_ydata(), 1.7 * error.get_ydata())


def test_what_has_no_place_on_the_axes_is_beside_the_others() -> None:
    first, second = work_precision(study_table()).figure.axes
    table = study_table()
    for panel, failed, unknown in ((first, 3, 0), (second, 2, 2)):
        high = table[(table.problem == panel.get_title()) & table.success].error.max()
        for word, count in (("failed", failed), ("error not known", unknown)):
            marks = [line for line in panel.lines if line.get_label() == word]
            assert sum(len(line.get_xdata()) for line in marks) == count
            assert all((line.get_ydata() > high).all() for line in marks)
    (exact,) = [line for line in first.lines if line.get_label() == "exact · clarabel"]
    assert 0.0 < exact.get_ydata()[0] < block().error[block().error > 0].min()
    assert exact.get_ydata()[0] == min(line.get_ydata().min() for line in first.lines)


def test_an_axis_can_be_chosen_and_a_panel_given() -> None:
    ax = Figure().add_subplot()
    assert work_precision(block(), x="steps", y="bound", ax=ax) is ax
    assert (ax.get_xlabel(), ax.get_ylabel()[:18]) == ("time steps", "bound of the error")
    names = [text.get_text() for text in ax.get_legend().get_texts()]
    assert names[0] == "catching-up · clarabel"
    assert len(names) == len(set(names))


def test_tolerances_are_lines_of_their_own_and_all_may_have_failed() -> None:
    table = block()
    both = pd.concat([table, table.assign(tol=1e-4, wall=table.wall / 2)], ignore_index=True)
    assert "midpoint · osqp · tol 0.0001" in labels(work_precision(both))
    assert set(labels(work_precision(table[~table.success]))) == {"failed"}
    # a run without a solver call is there too
    assert (work_precision(table.assign(solver_calls=0), x="solver_calls").lines[0]
            .get_xdata() > 0).all()  # fmt: skip


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda table: work_precision(table, x="speed"), "x must be one of wall, cpu, steps"),
        (lambda table: work_precision(table, y="wall"), "y must be one of error, bound"),
        (lambda table: work_precision(table.drop(columns="wall")), r"lacks the columns \['wall'\]"),
        (lambda table: work_precision(table[:0]), "no rows"),
        (lambda table: work_precision([1, 2]), "pass the table of a study as it is"),
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
