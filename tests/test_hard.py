"""Programs on which solvers alone fail, judged by velocities that are exact to 60 digits."""

from __future__ import annotations

import csv
import warnings
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sweepopt as so
from sweepopt.cli import main
from sweepopt.study.hard import FAMILIES, Program, suite
from sweepopt.study.hard.bodies import chain, one_step, spectral
from sweepopt.study.hard.combinations import combination
from sweepopt.study.hard.judge import Judge
from sweepopt.study.hard.suite import PATHS, HardRow, rows

RNG = np.random.default_rng(0)
N = 60
A = 2.001 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1)
LOAD, G = 3 * RNG.normal(size=N), RNG.uniform(0.5, 2, N)
ILL = spectral(RNG, np.logspace(-12, 0, N))
UNITS = np.logspace(-6, 6, N)
Data = tuple[np.ndarray, np.ndarray, np.ndarray]

# M, load, g and the certificate that can be asked for
HARD: dict[str, tuple[Data, float]] = {
    "plain": ((A, LOAD, G), 1e-12),
    "beta 1e-8": ((A - (np.linalg.eigvalsh(A)[0] - 1e-8) * np.eye(N), LOAD, G), 1e-12),
    "condition 1e12": ((ILL, LOAD, G), 1e-9),
    "glued beside nearly free": ((A, LOAD, np.where(np.arange(N) % 2, 1e12, 1e-3)), 1e-12),
    "g from 1e-12 to 1e12": ((A, LOAD, np.logspace(-12, 12, N)), 1e-11),
    "forces x 1e-9": ((1e-9 * A, 1e-9 * LOAD, 1e-9 * G), 1e-12),
    "lengths x 1e9": ((1e-18 * A, LOAD, G), 1e-12),
    "units mixed inside A": ((UNITS[:, None] * A * UNITS, LOAD * UNITS, G * UNITS), 1e-12),
    "at the threshold": ((A, np.where(np.arange(N) % 2, G, -G), G), 0.0),
}


def solve_once(process: so.SweepingProcess, **settings: Any) -> so.Solution:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", so.InitialStateWarning)
        settings = {"t_end": 1.0, "steps": 1, "scheme": "implicit-euler", "tol": 1e-9, **settings}
        return so.solve(process, **settings)


@pytest.mark.parametrize("solver", ["auto", "daqp", "newton", "osqp", "clarabel"])
@pytest.mark.parametrize("name", HARD)
def test_hard_programs_are_solved_with_a_proof(name: str, solver: str) -> None:
    (M, load, g), certificate = HARD[name]
    C = so.Moving(so.Box(-g, g), load)
    tol = max(certificate, 1e-12)
    sol = solve_once(so.SweepingProcess(M, None, C, np.zeros(N)), solver=solver, tol=tol)
    z = sol.velocity[0]
    assert sol.stats["relative"][0] <= certificate
    # the proof once more, from the inclusion itself: stuck inside, slipping against the bound
    force, slips = M @ z - load, z != 0
    size = np.abs(M) @ np.abs(z) + np.abs(load)
    assert (np.abs(force[~slips]) <= g[~slips] + 1e-5 * size[~slips]).all()
    assert (np.abs(force + g * np.sign(z))[slips] <= 1e-5 * size[slips]).all()


def test_the_active_set_solver_stands_alone() -> None:
    process = so.SweepingProcess(ILL, None, so.Moving(so.Box(-G, G), LOAD), np.zeros(N))
    sol = solve_once(process, solver="active-set", tol=1e-9)
    program = Program(ILL)
    exact = program.solve(np.zeros(N), process.C.at(1.0))
    error = program.error(sol.velocity[0], exact) / exact.size
    assert error <= 1e-9
    assert error <= sol.stats["relative"][0]
    assert sol.stats["solver"][0] == "active-set"


# ---- every family, judged by its exact velocity -----------------------------------------------


@pytest.mark.parametrize("family", FAMILIES)
def test_hard_families_are_met_within_their_certificates(family: str) -> None:
    solvers = ["auto", "osqp", "clarabel"]
    found = list(rows([family], [0], solvers=solvers, tol=1e-9))
    assert found
    assert [row for row in found if not row.good] == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 7))
@pytest.mark.parametrize("family", FAMILIES)
def test_hard_families_are_met_for_every_seed_and_solver(family: str, seed: int) -> None:
    assert [row for row in rows([family], [seed], tol=1e-9) if not row.good] == []


@pytest.mark.parametrize("seed", range(3))
def test_combinations_drawn_by_chance_are_met(seed: int) -> None:
    found = list(rows([], [seed], solvers=["auto", "osqp", "clarabel"], combinations=4))
    assert len({row.drawn for row in found}) == 4
    assert [row for row in found if not row.good] == []  # all true answers are known, too


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 106))
def test_combinations_are_met_for_every_seed_and_solver(seed: int) -> None:
    assert [row for row in rows([], [seed], combinations=10) if not row.good] == []


@pytest.mark.parametrize(
    ("seed", "number"),
    [
        pytest.param(211, 2, id="a polyhedron beside jumps of 1e8, in mixed units, A = 0"),
        pytest.param(317, 7, id="a polyhedron beside jumps of 1e8, A = 0"),
        pytest.param(23, 5, id="discs in mixed units, condition 1e12"),
        pytest.param(0, 3, id="a polyhedron in mixed units, B up to 1e10"),
        pytest.param(2, 0, id="B of rank one"),
        pytest.param(118, 39, id="a polyhedron in mixed units, condition 1e7"),
        pytest.param(114, 41, id="discs across cells from 1 to 1e-6"),
    ],
)
def test_combinations_that_were_wrong_once(seed: int, number: int) -> None:
    process = (made := combination(np.random.default_rng([seed, number]))).process()
    judge = Judge(process, made.t_end / made.steps)
    for solver in ("auto", "clarabel"):
        states, errors = [process.u0], []

        def look(step: so.StepInfo, states: list = states, errors: list = errors) -> None:
            exact = judge.of(states[-1], step.t)
            errors.append((judge.program.error(step.velocity, exact), step.certificate, exact.size))
            states.append(step.u)

        solve_once(process, t_end=made.t_end, steps=made.steps, solver=solver, callback=look)
        for error, certificate, size in errors:
            assert error <= min(1e-9 * size, certificate)


def test_a_path_that_does_not_apply_leaves_no_row() -> None:
    # all unknowns are in contact: there is nothing to eliminate
    found = rows(["condition_all", "proportional"], [0], solvers=["auto"])
    assert [(row.family, row.path) for row in found] == [
        ("condition_all", "full"),
        *(("proportional", path) for path in PATHS),
    ]


# ---- the judge --------------------------------------------------------------------------------


def test_the_exact_velocity_is_that_of_a_closed_form() -> None:
    # M = diag, a box: z = (P(q) - q) / M; a ball in the plane, M = 2 I: the same
    q = np.array([3.0, -0.5, -4.0])
    z = Program(np.diag([2.0, 1.0, 4.0])).solve(q, so.Box([-1] * 3, [1] * 3)).z
    assert [float(x) for x in z] == [-1.0, 0.0, 0.75]
    ball = Program(2 * np.eye(2)).solve(np.array([3.0, 4.0]), so.Ball([0, 0], 1.0)).z
    assert [float(x) for x in ball] == pytest.approx([-1.2, -1.6], abs=1e-15)
    half = so.Polyhedron([[1.0, 1.0]], [1.0])
    rows_ = Program(np.eye(2)).solve(np.array([1.0, 2.0]), half).z
    assert [float(x) for x in rows_] == [-1.0, -1.0]


def test_the_exact_velocity_of_discs_of_any_size_is_known() -> None:
    # radii 3e-24 to 0.2 at the threshold: Newton's method on z alone crawled from most starts
    process = combination(np.random.default_rng([103, 7])).process()
    exact = Program(process.A).solve(np.zeros(process.dim), process.C.at(1.0))
    assert exact.length == pytest.approx(2.0657034296726056e-15, rel=1e-14)


def test_the_judge_does_not_round_the_sum_and_the_product_of_the_data() -> None:
    # 1 + 1e-9 * 3e-9 is 1 in doubles, and so is the product with the state
    u = np.array([1 + 2.0**-30])
    program = Program(np.eye(1), np.array([[3e-9]]), 1e-9)
    assert program.M[0, 0] != 1
    assert abs(float(program.M[0, 0] - 1) - 3e-18) <= 1e-33
    moved = program.term(u) - program.term(np.ones(1))
    assert float(moved[0]) == pytest.approx(3e-9 * 2.0**-30, rel=1e-12)


@pytest.mark.parametrize("family", ["condition", "lengths_down", "forces_up", "stiff"])
def test_the_judge_sees_wrong_answers_and_certificates(
    monkeypatch: pytest.MonkeyPatch, family: str
) -> None:
    def judged(wrong: Callable[[so.StepInfo], so.StepInfo]) -> HardRow:
        """The row of a run whose steps are not what the library found."""

        def lying(process: so.SweepingProcess, *, callback: Any, **settings: Any) -> so.Solution:
            return so.solve(process, callback=lambda step: callback(wrong(step)), **settings)

        monkeypatch.setattr(suite, "solve", lying)
        return next(iter(rows([family], [2], solvers=["auto"], paths=["full"])))

    right = judged(lambda step: step)
    assert right.verdict == "met"
    row = judged(lambda step: step._replace(velocity=(1 + 1e-6) * step.velocity))
    assert row.verdict == "error above 1e-08"
    assert 1e-7 < row.error < 1.01e-6  # in units of the load where that is more
    row = judged(lambda step: step._replace(velocity=(1 + 1e-9) * step.velocity, certificate=0.0))
    assert row.verdict == "certificate below the error"
    assert 1e-10 < row.error < 1.01e-9 + right.error
    assert not row.good


def test_an_error_of_the_library_is_a_wrong_row_whatever_its_words(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def failing(*_: Any, **settings: Any) -> so.Solution:
        raise so.InputError(f"path={settings['path']!r} is in the text")

    monkeypatch.setattr(suite, "solve", failing)
    found = list(rows(["small_beta"], [0], solvers=["auto"]))
    assert [row.path for row in found] == list(PATHS)
    assert all(row.verdict.startswith("InputError: path=") and not row.good for row in found)


# ---- laws of the process ----------------------------------------------------------------------


def test_units_change_nothing() -> None:
    few, M = np.array([1, 4, 7, 9]), chain(np.random.default_rng(3), 12)
    f, g = 3 * np.random.default_rng(4).normal(size=12), np.array([0.1, 0.5, 1.0, 2.0])

    def velocity(force: float, length: float, **settings: str) -> np.ndarray:
        # energies in force * length: A in force / length, loads in force
        made = one_step(force / length * M, force * f, so.Box(-force * g, force * g), few)
        return solve_once(made.process(), **settings).velocity[0] / length

    for solver in ("auto", "osqp", "clarabel"):
        for path in ("full", "eliminated", "proportional"):
            plain = velocity(1.0, 1.0, solver=solver, path=path)
            for force, length in ((2.0**40, 1.0), (2.0**-40, 1.0), (1.0, 2.0**40), (1.0, 2.0**-40)):
                scaled = velocity(force, length, solver=solver, path=path)
                assert np.abs(scaled - plain).max() <= 1e-12 * np.abs(plain).max()
                assert ((scaled == 0) == (plain == 0)).all()


@pytest.mark.parametrize("share", [0.5, 0.999, 1.0])
@pytest.mark.parametrize("steps", [1000, pytest.param(100_000, marks=pytest.mark.slow)])
def test_a_body_at_rest_does_not_drift(share: float, steps: int) -> None:
    rng = np.random.default_rng(5)
    M, g, u0 = chain(rng, 6), rng.uniform(0.5, 2.0, 6), rng.normal(size=6)
    load = M @ u0 + share * g * rng.choice([-1.0, 1.0], 6)
    C = so.Moving(so.Box(-g, g), load)
    sol = so.solve(so.SweepingProcess(M, M, C, u0), t_end=100.0, steps=steps)
    assert not sol.velocity.any()
    assert (sol.u == u0).all()


def test_small_viscosity_tends_to_the_rate_independent_process() -> None:
    rng = np.random.default_rng(6)
    A, B, g = chain(rng, 8), chain(rng, 8), rng.uniform(0.2, 1.0, 8)
    shape = 3 * rng.normal(size=8)
    C = so.Moving(so.Box(-g, g), lambda t: np.sin(t) * shape)

    def run(nu: float) -> np.ndarray:
        process = so.SweepingProcess(nu * A, B, C, np.zeros(8))
        return so.solve(process, t_end=6.0, steps=120, scheme="implicit-euler").u

    limit, size = run(0.0), np.abs(run(0.0)).max()
    errors = [np.abs(run(10.0**-k) - limit).max() / size for k in range(13)]
    assert all(later < 0.2 * earlier for earlier, later in pairwise(errors[2:9]))
    assert max(errors[9:]) < 1e-8


@pytest.mark.parametrize("solver", ["auto", "newton", "daqp", "osqp", "clarabel", "cvxpy"])
def test_glued_unknowns_have_exactly_no_velocity(solver: str) -> None:
    g = np.array([np.inf, 0.3, 0.0, np.inf, 1e12])
    load = so.Separable([(so.Sine(3.0, 4.0), np.ones(5))])
    vi = so.EvolutionVI(A[:5, :5], A[:5, :5], load=load, dissipation=so.Box(-g, g), u0=np.ones(5))
    with pytest.warns(so.InitialStateWarning):
        sol = so.solve(vi, t_end=4.0, steps=20, solver=solver)
    assert (sol.u[:, [0, 3, 4]] == 1.0).all()
    assert sol.velocity[:, [1, 2]].any(axis=0).all()


def test_a_contact_that_is_named_twice_has_the_sum_of_its_bounds() -> None:
    E, rng = np.eye(4)[:, [2, 0, 2, 2]], np.random.default_rng(1)
    named = so.image(E, so.Box([-1, -2, -3, -np.inf], [1, 2, 3, 4]))
    once = so.image(np.eye(4)[:, [0, 2]], so.Box([-2, -np.inf], [2, 8]))
    for w in 9 * rng.normal(size=(20, 4)):
        assert named.project(w) == pytest.approx(once.project(w), abs=1e-12)
        z = w * [1, 0, 0, 0] + [0, 0, abs(w[2]), 0]
        assert named.support(z) == pytest.approx(once.support(z), rel=1e-12)


# ---- the command -------------------------------------------------------------------------------


def test_the_command_writes_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "few.toml"
    path.write_text(
        '[hard]\nseeds = [3]\nfamilies = ["threshold", "empty"]\nsolvers = ["osqp"]\n'
        "combinations = 0\n"
    )
    assert main(["study", str(path), "--out", str(tmp_path / "out")]) == 0
    assert "4 runs, 0 wrong" in capsys.readouterr().out
    with (tmp_path / "out" / "hard.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    assert [row["verdict"] for row in table] == ["met", "refused", "refused", "refused"]
    assert float(table[0]["error"]) <= 1e-8
    assert "36 move" in table[0]["answer"]
    assert {row["answer"] for row in table[1:]} == {"refuse: EmptySetError"}
    assert "Each load is its friction bound" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("hard = 3", "hard must be a table"),
        ("[hard]\nseed = [1]", "hard.seed: unknown key; there are: seeds"),
        ("[hard]\nseeds = []", "hard.seeds must be a list with one entry or more"),
        ("[hard]\nseeds = [-1]", "hard.seeds[0] must be a whole number >= 0, got -1"),
        ("[hard]\ntol = 0.0", "hard.tol must be > 0"),
        ('[hard]\nfamilies = ["soft"]', "hard.families[0]: 'soft' is not known; there are: thr"),
        ('[hard]\nsolvers = ["magic"]', "hard.solvers[0]: 'magic' is not known; there are: auto"),
    ],
)
def test_a_bad_table_is_refused(
    text: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text)
    assert main(["study", str(path), "--out", str(tmp_path / "out")]) == 2
    assert words in capsys.readouterr().err
