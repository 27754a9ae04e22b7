"""Programs on which solvers alone fail, judged by velocities that are exact to 80 digits."""

from decimal import Decimal
from itertools import chain as joined
from unittest.mock import Mock

import numpy as np
import pytest
from cases import SQUARE, slow
from study_table import lie

import sweepopt as so
from sweepopt.study.hard import FAMILIES, Program, exact, suite
from sweepopt.study.hard.bodies import chain
from sweepopt.study.hard.suite import GOOD
from sweepopt.study.hard.velocities import (
    HISTORIES,
    PATHS,
    TABLES,
    combination,
    entry_of,
    hard_programs,
    make,
)

pytestmark = pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")


def judged(*families, **settings):
    return list(hard_programs(families=families, **{"combinations": 0, **settings}))


def wrong(found):
    return [row for row in found if row.verdict not in GOOD]


# ---- every family, judged by its exact velocity -----------------------------------------------


def test_families_are_made_of_ingredients_that_there_are():
    names = [name for table in TABLES for name in table]
    assert len(names) == len(set(names))
    assert set(joined(*FAMILIES.values())) <= set(names)


LONG = ("condition_all", "jumps", "thin", "rotating", "no_stiffness", "viscosity")
LONG += ("singular_stiffness", "no_viscosity", "stiff", "short_steps", "long_steps", "jumping")
LONG += ("hold_half", "hold_almost", "hold_exactly")  # most steps or most digits


@pytest.mark.parametrize(
    "turn, family",
    [slow(*each) if each[1] in LONG else each for each in enumerate(FAMILIES)],
)
def test_hard_families_are_met_within_their_certificates(turn, family):
    # some solvers and paths in turn here, all of them with -m slow
    solvers = ["auto", ("osqp", "clarabel")[turn % 2]]
    paths = ["full", ("eliminated", "proportional")[turn // 2 % 2]]
    found = judged(family, solvers=solvers, paths=paths, tol=1e-9)
    assert found
    assert wrong(found) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(7))
@pytest.mark.parametrize("family", FAMILIES)
def test_hard_families_are_met_for_every_seed_and_solver(family, seed):
    assert wrong(judged(family, seeds=[seed])) == []


@pytest.mark.parametrize("seed", [slow(0), slow(1)])
def test_combinations_drawn_by_chance_are_met(seed):
    found = judged("unbounded", seeds=[seed], solvers=["auto", "osqp", "clarabel"], combinations=4)
    assert len({row.drawn for row in found}) == 5
    assert wrong(found) == []


@pytest.mark.parametrize(
    "seed, number",
    [
        pytest.param(211, 2, id="a polyhedron beside jumps of 1e8, in mixed units, A = 0"),
        pytest.param(23, 5, id="discs in mixed units, condition 1e12"),
        pytest.param(0, 3, id="a polyhedron in mixed units, B up to 1e10"),
        pytest.param(2, 0, id="B of rank one"),
        pytest.param(114, 41, id="discs across cells from 1 to 1e-6"),
        pytest.param(90210, 36, id="discs across needles of triangles, in mixed units"),
    ],
)
def test_combinations_that_were_wrong_once(seed, number):
    random = np.random.default_rng([seed, number])
    names = combination(random)
    process, (t_end, steps, *_) = make(names, random), entry_of(HISTORIES, names)
    program = Program(process.A, process.B, t_end / steps)
    how = {"t_end": t_end, "steps": steps, "scheme": "implicit-euler", "tol": 1e-9}
    for solver in ("auto", "clarabel"):
        sol = so.solve(process, solver=solver, **how)
        ends = zip(sol.t[1:], sol.u, sol.velocity, sol.stats["certificate"], strict=False)
        for t, u, z, certificate in ends:
            exact_velocity = program.solve(u, process.C.at(t))
            error, stated, _ = program.compare(exact_velocity, z, certificate)
            assert error <= min(1e-9, stated)


def test_the_judge_has_digits_for_radii_from_1_to_1e24():
    found = judged(
        "unbounded", seeds=[413], solvers=["clarabel"], paths=["eliminated"], combinations=3
    )
    assert wrong(found) == []
    assert found[-1].family == "combination 2"


def test_a_path_that_does_not_apply_leaves_no_row():
    # all unknowns are in contact: there is nothing to eliminate
    found = judged("mixed_bounds_all", "forces_up", solvers=["auto"])
    assert [(row.family, row.path) for row in found] == [
        ("mixed_bounds_all", "full"),
        *(("forces_up", path) for path in PATHS),
    ]


# ---- the judge --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "M, q, C, z",
    [  # z = P(q) - q in the metric of M
        ([2.0, 1.0, 4.0], [3.0, -0.5, -4.0], so.Box([-1] * 3, [1] * 3), [-1.0, 0.0, 0.75]),
        ([2.0, 2.0], [3.0, 4.0], so.Balls([1.0], 2), [-1.2, -1.6]),
        ([1.0, 1.0], [1.0, 2.0], so.Polyhedron([[1.0, 1.0]], [1.0]), [-1.0, -1.0]),
    ],
)
def test_the_exact_velocity_is_that_of_a_closed_form(M, q, C, z):
    found = Program(np.diag(M), np.eye(len(M))).solve(np.array(q), C).z
    assert [float(x) for x in found] == pytest.approx(z, abs=1e-15)


@pytest.mark.parametrize(
    "seed, number, length",
    [
        pytest.param(103, 7, 2.0657034296726056e-15, id="radii 3e-24 to 0.2 at the threshold"),
        pytest.param(1146, 8, 16.600349923118195, id="full steps go round in circles"),
    ],
)
def test_the_exact_velocity_of_discs_of_any_size_is_known(seed, number, length):
    # the numbers are those of a smoothed problem, solved by Newton's method
    random = np.random.default_rng([seed, number])
    process = make(combination(random), random)
    program = Program(process.A, process.B, 1.0)
    exact = program.solve(process.u0, process.C.at(1.0))
    assert program.error(0, exact) == pytest.approx(length, rel=1e-14)


def test_the_judge_does_not_round_the_sum_and_the_product_of_the_data():
    # 1 + 1e-9 * 3e-9 is 1 in doubles, and so is the product with the state
    u = np.array([1 + 2.0**-30])
    program = Program(np.eye(1), np.array([[3e-9]]), 1e-9)
    assert program.M[0, 0] != 1
    assert abs(float(program.M[0, 0] - 1) - 3e-18) <= 1e-33
    # C is 3e-9, which the product is in doubles
    moves = program.solve(u, so.Point(3e-9)).z
    assert float(moves[0]) == pytest.approx(-3e-9 * 2.0**-30, rel=1e-12)


@pytest.mark.parametrize("family", ["condition", "lengths_down", slow("stiff")])
def test_the_judge_sees_wrong_answers_and_certificates(monkeypatch, family):
    def judged_as(factor, stated=1.0):
        """The row of a run whose velocities and certificates are not those of the library."""

        def stats(sol):
            named = {name: sol.stats[name] for name in ("solver", "certificate")}
            return named | {"certificate": stated * named["certificate"]}

        lie(monkeypatch, stats=stats, velocity=lambda sol: factor * sol.velocity)
        return judged(family, seeds=[2], solvers=["auto"], paths=["full"])[0]

    right, far, near = judged_as(1.0), judged_as(1 + 1e-6), judged_as(1 + 1e-9, stated=0.0)
    assert (right.verdict, far.verdict) == ("met", "error above 1e-08")
    assert 1e-7 < far.error < 1.01e-6  # in units of the load where that is more
    assert near.verdict == "certificate below the error"
    assert 1e-10 < near.error < 1.01e-9 + right.error


def test_the_judge_does_not_trust_its_own_method(monkeypatch):
    plain = exact.exact_multipliers
    program, q = Program(np.eye(2), np.eye(2)), np.array([3.0, 0.0])
    for wrong_by in (1e-12, -1e-12):  # a polyhedron that is left, or whose face is not touched
        monkeypatch.setattr(
            exact, "exact_multipliers", lambda *data, by=wrong_by: plain(*data) * (1 + Decimal(by))
        )
        with pytest.raises(so.SweepoptError, match="was not found"):
            program.solve(q, SQUARE)


def test_an_error_of_the_library_is_a_wrong_row_whatever_its_words(monkeypatch):
    monkeypatch.setattr(suite, "solve", Mock(side_effect=so.InputError("path= is in the text")))
    found = judged("small_beta", solvers=["auto"])
    assert [row.path for row in found] == list(PATHS)
    assert all(row.verdict.startswith("InputError: path=") for row in found)


# ---- laws of the process ----------------------------------------------------------------------


@pytest.mark.parametrize("solver", ["auto", "newton", "daqp", "osqp", "clarabel", "cvxpy"])
def test_glued_unknowns_have_exactly_no_velocity(solver):
    g = np.array([np.inf, 0.3, 0.0, np.inf, 1e12])
    load = so.Separable([(so.Sine(3.0, 4.0), np.ones(5))])
    A = chain(np.random.default_rng(0), 5)
    vi = so.EvolutionVI(A, A, load=load, dissipation=so.Box(-g, g), u0=np.ones(5))
    sol = so.solve(vi, t_end=4.0, steps=20, solver=solver)
    assert (sol.u[:, [0, 3, 4]] == 1.0).all()
    assert sol.velocity[:, [1, 2]].any(axis=0).all()
