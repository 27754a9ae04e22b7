"""The work-precision diagram draws the table: its lines are compared with the numbers."""

import numpy as np
import pandas as pd
import pytest
from cases import block as slider
from study_table import study_table

import sweepopt as so
from sweepopt.study import work_precision
from sweepopt.study.diagram import trajectories
from sweepopt.study.problems import problem

TABLE = study_table()
BLOCK = TABLE[TABLE.problem == "block"]


def drawn(ax, label):
    """The lines of that name."""
    return [line for line in ax.lines if label in line.get_label()]


def test_each_problem_has_a_panel_with_a_line_for_each_scheme_and_solver():
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


def test_guaranteed_bounds_are_dashed_companions_of_their_errors():
    first, second = work_precision(TABLE).figure.axes
    assert not drawn(second, "guaranteed bound")  # bounds of the pipe are not guaranteed
    errors = drawn(first, "·")[:6]
    for error, bound in zip(errors, drawn(first, "guaranteed bound"), strict=True):
        assert (bound.get_linestyle(), bound.get_color()) == ("--", error.get_color())
        np.testing.assert_allclose(bound.get_ydata(), 1.7 * error.get_ydata())


def test_what_has_no_place_on_the_axes_is_beside_the_others():
    first, second = work_precision(TABLE).figure.axes
    for panel, failed, unknown in ((first, 3, 0), (second, 2, 2)):
        high = TABLE[(TABLE.problem == panel.get_title()) & TABLE.success].error.max()
        for word, count in (("failed", failed), ("error not known", unknown)):
            places = [y for line in drawn(panel, word) for y in line.get_ydata()]
            assert len(places) == count
            assert all(y > high for y in places)
    (exact,) = drawn(first, "exact · clarabel")
    assert 0.0 < exact.get_ydata()[0] < BLOCK.error[BLOCK.error > 0].min()


def test_an_error_that_is_not_known_is_drawn_at_its_bound():
    rows = BLOCK.assign(error=BLOCK.error.where(BLOCK.steps != 200))
    places = [
        xy
        for line in drawn(work_precision(rows), "at its bound")
        for xy in line.get_xydata().tolist()
    ]
    hidden = rows[rows.success & rows.error.isna()]
    assert len(hidden) > 2
    assert sorted(places) == sorted(map(list, zip(hidden.wall, hidden.bound, strict=True)))


def test_a_cost_can_be_chosen_and_the_legend_names_each_line_once():
    ax = work_precision(TABLE, x="steps")
    assert ax.get_xlabel() == "time steps"
    assert drawn(ax, "catching-up · clarabel")[0].get_xdata().tolist() == [50, 100, 200, 400]
    names = [text.get_text() for text in ax.figure.legends[0].get_texts()]
    assert names[0] == "catching-up · clarabel"
    assert len(names) == len(set(names))


def test_the_band_of_a_run_is_its_guaranteed_one():
    block = problem("S03")
    process = block.process()
    run = so.solve(process, t_end=block.t_end, steps=80)
    sampled = so.solve(slider(lambda t: [3 * t]), t_end=1.0, steps=20)
    band, none = trajectories({"block": run, "sampled": sampled}).figure.axes
    np.testing.assert_array_equal(band.lines[0].get_ydata(), run.u[:, 0])
    exact = so.solve(process, steps=run.t, scheme="exact").u[:, 0]
    edges = band.collections[0].get_paths()[0].vertices
    for t, u in zip(run.t, exact, strict=True):
        low, high = np.sort(edges[edges[:, 0] == t, 1])[[0, -1]]
        assert low <= u <= high
    bound = float(run.error_bound()) / np.sqrt(0.5)  # |u|_A = sqrt(0.5) |u|
    widths = [np.ptp(edges[edges[:, 0] == t, 1]) for t in run.t]
    assert max(widths) == pytest.approx(2 * bound, rel=1e-12)
    assert not none.collections  # nothing guarantees it


def test_tolerances_are_lines_of_their_own_and_all_may_have_failed():
    both = pd.concat([BLOCK, BLOCK.assign(tol=1e-4, wall=BLOCK.wall / 2)], ignore_index=True)
    assert drawn(work_precision(both), "midpoint · tol 0.0001 · osqp")
    failed = work_precision(BLOCK[~BLOCK.success])
    assert drawn(failed, "failed") == list(failed.lines)
    # a run without a solver call is there too
    (line, *_) = work_precision(BLOCK.assign(solver_calls=0), x="solver_calls").lines
    assert (line.get_xdata() > 0).all()
