"""Solvers compared by certificate, and the commands that study and compare."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from test_cli import make_scene

import sweepopt as so
from sweepopt import cli
from sweepopt.study.cell import CellRow
from sweepopt.study.comparison import LEGEND, TOLS, compare, comparison_text


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return compare("P09", steps=8)


def test_every_installed_solver_is_compared_at_three_accuracies(table: pd.DataFrame) -> None:
    assert list(table.columns) == [*CellRow._fields, "ms", "ratio", "calls"]
    solvers = "auto clarabel osqp newton daqp cvxpy:clarabel cvxpy:osqp cvxpy:scs"
    for solver in solvers.split():
        assert set(table[table.solver == solver].tol) == set(TOLS)
    assert table.success.all()
    assert (table.certificate <= table.tol).all()  # whichever solver it is
    assert (table.wall > 0.0).all()
    assert (table.ms == 1e3 * table.wall / 8).all()
    assert (table.groupby("tol").ratio.min() == 1.0).all()
    # finite methods need no one to repair them; SCS ends at its own tolerance, 1e-4
    assert (table.calls[table.solver.isin(["newton", "daqp"])] <= 1.0).all()
    scs = table[table.solver == "cvxpy:scs"].set_index("tol").calls
    assert scs[1e-9] > scs[1e-3]


def test_only_solvers_that_treat_the_set_take_part(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sweepopt.study.comparison.TOLS", (1e-6,))
    names = set(compare("V05", steps=2).solver)  # a disc
    assert {"auto", "clarabel", "cvxpy:clarabel"} <= names
    assert not names & {"osqp", "cvxpy:daqp"}


@pytest.mark.parametrize("name", ["CLARABEL", "OSQP"])
def test_what_a_solver_reaches_through_cvxpy_does_not_depend_on_units(name: str) -> None:
    M, load = np.array([[2.0, 0.5], [0.5, 1.0]]), np.array([-3.0, 1.0])
    C = so.Moving(so.Box([-1, -1], [1, 1]), load)
    forces = []
    for stiff in (1.0, 2.0**40):
        process = so.SweepingProcess(stiff * M, None, C, np.zeros(2))
        with pytest.warns(so.InitialStateWarning):
            sol = so.solve(process, t_end=1.0, steps=1, solver=so.Cvxpy(name))
        assert sol.stats["attempts"][0] == 1
        assert sol.stats["relative"][0] <= 1e-7
        forces.append(stiff * sol.velocity[0])
    np.testing.assert_allclose(forces[1], forces[0], rtol=1e-12)


def test_the_comparison_prints_a_line_a_row(table: pd.DataFrame) -> None:
    lines = comparison_text(table).splitlines()
    assert lines[0].split() == [
        *("tol", "solver", "status", "ms", "a", "step", "x", "best", "calls", "certificate")
    ]
    assert len(lines) == 1 + len(table) + len(LEGEND.splitlines())


# ---- commands -------------------------------------------------------------------------------


def test_compare_prints_its_table_and_writes_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sweepopt.study.comparison.TOLS", (1e-6,))
    make_scene(tmp_path)
    assert cli.main(["compare", "ring.toml", "--steps", "5", "--csv", "rows.csv"]) == 0
    shown = capsys.readouterr()
    assert "cvxpy:clarabel" in shown.out
    assert "ring auto cvxpy:clarabel 5 steps tol 1e-06: SUCCESS" in shown.err
    assert len(pd.read_csv("rows.csv")) >= 8
    assert cli.main(["compare", "nowhere"]) == 2
    assert "'nowhere' is neither a scene file nor a problem" in capsys.readouterr().err


def test_a_bad_study_gives_one_clean_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bad.toml").write_text('step = 5\nproblems = ["S03"]')
    for study, words in (
        (str(tmp_path / "bad.toml"), "step: unknown key"),
        ("nowhere", "'nowhere' is neither a study file nor a study; there are: accuracy"),
    ):
        assert cli.main(["study", study]) == 2
        shown = capsys.readouterr().err
        assert words in shown
        assert shown.count("\n") == 1
