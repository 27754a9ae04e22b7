"""The work-precision diagram draws the table: its lines are compared with the numbers."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from study_table import study_table

import sweepopt as so
from sweepopt.study import work_precision

TABLE = study_table()
BLOCK = TABLE[TABLE.problem == "block"]


def drawn(ax: Any, label: str) -> list[Any]:
    """The lines of that name."""
    return [line for line in ax.lines if label in line.get_label()]


def test_each_problem_has_a_panel_with_a_line_for_each_scheme_and_solver() -> None:
    ax = work_precision(TABLE)
    assert [panel.get_title() for panel in ax.figure.axes] == ["block", "pipe"]
    for panel in ax.figure.axes:
        assert (panel.get_xscale(), panel.get_yscale()) == ("log", "log")
        assert panel.get_xlabel() == "wall time (s)"
        here = TABLE[(TABLE.problem == panel.get_title()) & TABLE.success & (TABLE.error > 0)]
        for (scheme, solver), rows in here.groupby(["scheme", "solver"]):
            (line,) = drawn(panel, f"{scheme} · {solver}")
            np.testing.assert_array_equal(line.get_data(), (rows.wall, rows.error))
    ax.figure.draw_without_rendering()


def test_guaranteed_bounds_are_dashed_companions_of_their_errors() -> None:
    first, second = work_precision(TABLE).figure.axes
    assert not drawn(second, "guaranteed bound")  # bounds of the pipe are not guaranteed
    errors = drawn(first, "·")[:6]
    for error, bound in zip(errors, drawn(first, "guaranteed bound"), strict=True):
        assert (bound.get_linestyle(), bound.get_color()) == ("--", error.get_color())
        np.testing.assert_allclose(bound.get_ydata(), 1.7 * error.get_ydata())


def test_what_has_no_place_on_the_axes_is_beside_the_others() -> None:
    first, second = work_precision(TABLE).figure.axes
    for panel, failed, unknown in ((first, 3, 0), (second, 2, 2)):
        high = TABLE[(TABLE.problem == panel.get_title()) & TABLE.success].error.max()
        for word, count in (("failed", failed), ("error not known", unknown)):
            places = [y for line in drawn(panel, word) for y in line.get_ydata()]
            assert len(places) == count
            assert all(y > high for y in places)
    (exact,) = drawn(first, "exact · clarabel")
    assert 0.0 < exact.get_ydata()[0] < BLOCK.error[BLOCK.error > 0].min()


def test_an_axis_can_be_chosen_and_a_panel_given() -> None:
    ax = Figure().add_subplot()
    assert work_precision(BLOCK, x="steps", y="bound", ax=ax) is ax
    assert (ax.get_xlabel(), ax.get_ylabel()[:18]) == ("time steps", "bound of the error")
    names = [text.get_text() for text in ax.get_legend().get_texts()]
    assert names[0] == "catching-up · clarabel"
    assert len(names) == len(set(names))


def test_tolerances_are_lines_of_their_own_and_all_may_have_failed() -> None:
    both = pd.concat([BLOCK, BLOCK.assign(tol=1e-4, wall=BLOCK.wall / 2)], ignore_index=True)
    assert drawn(work_precision(both), "midpoint · tol 0.0001 · osqp")
    failed = work_precision(BLOCK[~BLOCK.success])
    assert drawn(failed, "failed") == list(failed.lines)
    # a run without a solver call is there too
    (line, *_) = work_precision(BLOCK.assign(solver_calls=0), x="solver_calls").lines
    assert (line.get_xdata() > 0).all()


@pytest.mark.parametrize(
    ("table", "settings", "words"),
    [
        (TABLE, {"x": "speed"}, "x must be one of wall, cpu, steps"),
        (TABLE, {"y": "wall"}, "y must be one of error, bound"),
        (TABLE.drop(columns="wall"), {}, r"lacks the columns \['wall'\]"),
        (TABLE[:0], {}, "no rows"),
        ([1, 2], {}, "pass the table of a study as it is"),
        (TABLE, {"ax": "a panel"}, "ax is one panel but table has the problems block, pipe"),
    ],
)
def test_what_cannot_be_drawn_is_refused(table: Any, settings: Any, words: str) -> None:
    with pytest.raises(so.InputError, match=words):
        work_precision(table, **settings)


def test_missing_matplotlib_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(so.MissingExtraError, match="pip install"):
        work_precision(TABLE)
