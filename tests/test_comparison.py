"""Solvers compared by certificate, and the commands that study and compare."""

from unittest.mock import Mock

import numpy as np
import pandas as pd
import pytest
from cases import refuses
from test_cli import make_scene

import sweepopt as so
from sweepopt import cli
from sweepopt.study.comparison import (
    ACCURACIES,
    compare,
    record,
    solvers_for,
    trials,
)
from sweepopt.study.problems import find_source

pytestmark = pytest.mark.slow  # .ci/run runs them


@pytest.fixture(scope="module")
def table():
    return compare("P09", steps=4)


def test_every_installed_solver_is_compared_at_three_accuracies(table):
    columns = "solver setting accuracy programs solved time ratio certificate worst message"
    assert list(table.columns) == columns.split()
    for solver in ("clarabel", "osqp", "cvxpy:clarabel", "cvxpy:osqp", "cvxpy:scs"):
        assert set(table[table.solver == solver].setting) == set(ACCURACIES)
    assert table.programs.nunique() == 1
    assert (table.time > 0.0).all()
    exact = table[table.solver.isin(["newton", "daqp"])]
    assert (exact.solved == 1.0).all()
    assert (table.certificate <= table.worst).all()
    for _, group in table.groupby("accuracy"):
        assert group[group.solved == 1.0].ratio.min() == 1.0


def test_a_solver_is_judged_by_its_certificates_and_not_by_what_it_says():
    class Liar(so.Clarabel):
        def compile(self, program):
            solve = super().compile(program)
            return lambda q, C: solve(q, C)._replace(z=np.ones_like(q))

    programs = record(find_source("P09"), 4)
    assert all(trial.certificate > 1e-3 for trial in trials(Liar(), programs))
    broken = Mock(so.Clarabel, compile=Mock(side_effect=ArithmeticError("no")))
    failures = trials(broken, programs)
    assert [trial.message for trial in failures] == ["ArithmeticError: no"] * len(programs)
    assert all(trial.certificate == np.inf for trial in failures)


def test_only_solvers_that_treat_the_set_take_part():
    names = {solver.name for _, solver in solvers_for(so.Ball([0.0, 0.0], 1.0))}
    assert "clarabel" in names
    assert not names & {"osqp", "cvxpy:daqp"}
    with refuses("L13 has no program to compare solvers on"):
        compare(find_source("L13"), steps=5)
    with refuses("a process is given as own_source"):
        compare(so.SweepingProcess(1.0, 1.0, so.Box(-1, 1), 0.0))


# ---- commands -------------------------------------------------------------------------------


def test_compare_prints_its_table_and_writes_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    make_scene(tmp_path)
    assert cli.main(["compare", "ring.toml", "--steps", "2", "--csv", "rows.csv"]) == 0
    shown = capsys.readouterr()
    columns, *lines = map(str.split, shown.out.splitlines())
    assert " ".join(columns) == "solver setting accuracy solved ms x best median worst"
    assert len(lines) == len(pd.read_csv("rows.csv")) + 4 >= 16
    assert "cvxpy:clarabel" in shown.out
    assert "programs of" in shown.err
    assert cli.main(["compare", "nowhere"]) == 2
    assert "'nowhere' is neither a scene file nor a problem" in capsys.readouterr().err


def test_a_bad_study_gives_one_clean_line(tmp_path, capsys):
    (tmp_path / "bad.toml").write_text('step = 5\nproblems = ["S03"]')
    for study, words in (
        (str(tmp_path / "bad.toml"), "step: unknown key"),
        ("nowhere", "'nowhere' is neither a study file nor a study; there are: accuracy"),
    ):
        assert cli.main(["study", study]) == 2
        shown = capsys.readouterr().err
        assert words in shown
        assert shown.count("\n") == 1
    with pytest.raises(SystemExit):
        cli.main(["study", "accuracy", "--workers", "2", "--scheduler", "tcp://127.0.0.1:1"])
