"""The benchmark at a size that takes seconds: who computes what, and to which accuracy.

Nothing here looks at how long anything takes.
"""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest

import sweepopt as so
from sweepopt.linalg import Factor
from sweepopt.study import Row, bench, machine, table
from sweepopt.study.bench import entrants
from sweepopt.study.by_hand import _same_program
from sweepopt.study.cases import Case, blocks, square
from sweepopt.study.contestants import CONTESTANTS, TINY, reference
from sweepopt.study.memory import peak
from sweepopt.velocity.program import VelocityProgram

STEPS = 5
PATHS = {contestant.path: contestant for contestant in (*CONTESTANTS, *TINY)}
REFERENCES = ["reference", "reference, frictionless"]


@pytest.fixture(scope="module")
def case() -> Case:
    return square(8, STEPS)


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    return bench([8], steps=STEPS, rounds=1)


# ---- the case and its reference ---------------------------------------------------------------


def test_the_square_is_proportional_and_has_the_size_it_says() -> None:
    case = square(32, STEPS)
    assert (case.dim, case.contact.size) == (1056, 33)
    assert abs(case.B - 2 * case.problem.A).max() <= 1e-12
    assert case.threshold.sum() == pytest.approx(0.5)


def test_the_reference_satisfies_coulombs_law_at_every_step(case: Case) -> None:
    # stated anew from A, B and the load: r = A z + B u - f is the friction force, up to its sign
    u = reference(case).u
    forces = np.diff(u, axis=0) / case.mu @ case.problem.A + u[1:] @ case.B
    forces -= np.outer(case.phi(case.times[1:]), case.shape)
    velocity = np.diff(u[:, case.contact], axis=0) / case.mu
    inner = np.delete(forces, case.contact, axis=1)
    friction = -forces[:, case.contact] / case.threshold
    assert np.abs(inner).max() <= 1e-12 * np.abs(case.shape).max()
    assert (np.abs(friction) <= 1 + 1e-11).all()
    # of a stuck u the compensated sum may still change the last bit
    slips = np.abs(velocity) > 1e-14
    np.testing.assert_allclose(friction[slips], np.sign(velocity[slips]), atol=1e-10)
    # neither all stuck nor all slipping: the set matters
    assert 0.2 < slips.mean() < 0.9
    assert (slips.any(axis=1) & ~slips.all(axis=1)).any()


def test_the_frictionless_reference_solves_its_linear_systems(case: Case) -> None:
    u = reference(case, friction=False).u
    forces = np.diff(u, axis=0) / case.mu @ case.problem.A + u[1:] @ case.B
    forces -= np.outer(case.phi(case.times[1:]), case.shape)
    assert np.abs(forces).max() <= 1e-12 * np.abs(case.shape).max()


@pytest.mark.parametrize("solver", ["CLARABEL", "OSQP"])
def test_the_floor_is_the_program_that_the_library_compiles(case: Case, solver: str) -> None:
    C = case.problem.as_sweeping().C.at(1.0)
    theirs = VelocityProgram(Factor(case.M), C).canonical(solver)
    ours = _same_program(case, solver)[1]
    assert abs(ours.P - theirs.P).max() == 0
    for name in ("A", "b", *(["F", "G"] if solver == "OSQP" else [])):
        difference = ours.data[name] - theirs.data[name]
        assert not abs(difference).sum(), name
    assert str(ours.data["dims"]) == str(theirs.data["dims"])


# ---- the rows ---------------------------------------------------------------------------------


def test_every_contestant_has_one_row_on_each_case(rows: list[Row]) -> None:
    for name, table_ in (
        (square(8, STEPS).name, CONTESTANTS),
        (blocks(1, 2).name, TINY),
        (blocks(200, 2).name, TINY),
    ):
        paths = [row.path for row in rows if row.case == name and row.path not in REFERENCES]
        assert paths == [contestant.path for contestant in table_]


@pytest.mark.parametrize("path", PATHS)
def test_a_contestant_is_as_accurate_as_it_says(path: str, rows: list[Row]) -> None:
    for row in rows:
        if row.path == path:
            assert row.difference is not None
            assert row.difference <= PATHS[path].accuracy


def test_library_paths_are_certified_and_loops_by_hand_are_not(rows: list[Row]) -> None:
    for row in rows:
        by_hand = "hand" in row.path or "floor" in row.path or "cvxpy" in row.path
        assert (row.certificate is None) == by_hand, row.path
        assert (row.attempts is None) == by_hand, row.path
        if row.certificate is not None:
            # a step near equilibrium, |z| = |u| / 400, sees more of what B u rounds
            assert row.certificate <= (1e-10 if row.path in REFERENCES else 1e-6), row.path


def test_times_and_ratios_are_complete(rows: list[Row]) -> None:
    square_rows = {row.path: row for row in rows if row.unknowns == 72}
    assert square_rows["cvxpy-rebuilt"].naive == square_rows["frictionless"].linear == 1.0
    for row in rows:
        if row.path in REFERENCES:
            assert row.ms is None
            continue
        assert row.ms is not None
        assert row.ms > 0
        assert row.setup is not None
        assert row.setup >= 0
        assert row.spread == 0.0  # one round
        assert (row.overhead is not None) == bool(PATHS[row.path].floor)
        assert (row.naive is not None) == (row.linear is not None) == (row.unknowns == 72)
    path, floor = square_rows["full-osqp"], square_rows["osqp-floor"]
    assert path.overhead == pytest.approx(path.ms / floor.ms)  # type: ignore[operator]


def test_slow_contestants_are_left_out_of_large_cases() -> None:
    def paths(dim: int, only: list[str] | None = None) -> set[str]:
        return {contestant.path for contestant in entrants(CONTESTANTS, dim, only)}

    ours = {"proportional", "eliminated", "multigrid", "frictionless"}
    assert paths(10_100) == {contestant.path for contestant in CONTESTANTS}
    assert paths(1_001_000) == {*ours, "linear-by-hand"}
    assert "osqp-by-hand" in paths(25_000)
    assert paths(1_001_000, ["eliminated", "full-osqp"]) == {"eliminated"}


def test_rounds_alternate_and_only_chosen_paths_run() -> None:
    told: list[str] = []
    only = ["frictionless", "eliminated"]
    found = bench([4], steps=3, rounds=2, only=only, tiny=False, progress=told.append)
    assert [line.split(": ")[1:] for line in told] == [
        ["reference"],
        ["round 1 of 2", "eliminated"],
        ["round 1 of 2", "frictionless"],
        ["round 2 of 2", "eliminated"],
        ["round 2 of 2", "frictionless"],
    ]
    assert [row.path for row in found] == [*REFERENCES, "eliminated", "frictionless"]
    assert found[2].naive is None
    assert found[2].linear is not None


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"only": ["magic"]}, "only: there is no path 'magic'; there are: proportional, elim"),
        ({"steps": 2}, "steps must be at least 3"),
        ({"rounds": 0}, "rounds must be a positive whole number"),
        ({"cells": [0]}, "cells must be a positive whole number"),
    ],
)
def test_bad_arguments_are_refused_before_anything_runs(arguments: dict, words: str) -> None:
    with pytest.raises(so.InputError, match=words):
        bench(**arguments)


# ---- memory, table ----------------------------------------------------------------------------


def test_the_peak_of_memory_is_that_of_a_process_of_its_own() -> None:
    scene = peak(8, 2)
    if scene is None:
        pytest.skip("this system does not tell a process its peak")
    run = peak(8, 2, "eliminated")
    assert run is not None
    assert 20 < scene < 2000
    assert run > 0.9 * scene


def test_the_table_is_aligned_and_says_what_it_ran_on(rows: list[Row]) -> None:
    text = table(rows)
    assert text.startswith(machine())
    assert f"numpy {np.__version__}" in machine()
    assert "unit square, 8 cells a side: 72 unknowns, 9 with friction, 5 steps, 1 rounds" in text
    lines = text.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("path"))
    block = lines[start : start + 3 + len(CONTESTANTS)]
    assert [line.split("  ")[0] for line in block[3:]] == [c.path for c in CONTESTANTS]
    assert len({len(line) for line in block}) == 1


def test_rows_are_fit_for_csv(rows: list[Row]) -> None:
    file = io.StringIO()
    csv.writer(file).writerows([Row._fields, *rows])
    file.seek(0)
    read = list(csv.DictReader(file))
    assert [line["path"] for line in read] == [row.path for row in rows]
    assert read[0]["ms"] == ""  # the reference is not timed
