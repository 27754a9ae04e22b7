"""The program of a step in cvxpy: what it says, and that its answer is the step of the run."""

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from cases import SQUARE, refuses

import sweepopt as so
from sweepopt.linalg import Factor
from tests.test_stepping import thin

n = 3
A, B = 2.0 * np.eye(n), np.diag([1.0, 2.0, 3.0])
U0 = np.array([0.1, -0.2, 0.3])


def load(t):
    return np.array([3 * t, 1.0, -2 * t])


def program_of(C, **settings):
    return so.step_program(so.SweepingProcess(A, B, C, U0), 1.0, U0, 0.5, **settings)


def chain(rho=0.5, **settings):
    """Nine blocks in a chain, three of them with friction; B = rho A."""
    stiff = sp.csc_array(2.05 * np.eye(9) - np.eye(9, k=1) - np.eye(9, k=-1))
    C = so.Moving(
        so.image(np.eye(9)[:, ::4], so.Box([-0.3] * 3, [0.3] * 3)),
        so.Separable([(so.Sine(1.0, 4.0), np.ones(9))]),
    )
    process = so.SweepingProcess(stiff, rho * stiff, C, np.zeros(9))
    return so.solve(process, t_end=2.0, steps=20, **settings)


def optimum(program, solver="CLARABEL"):
    settings = {"CLARABEL": {"tol_gap_abs": 1e-12, "tol_gap_rel": 1e-12}}.get(solver, {})
    program.problem.solve(solver=solver, **settings)
    return np.array(program.z.value)


def same_as_the_run(sol, i):
    program = sol.step_program(i)
    answer = program.certify(optimum(program))
    certificates = answer.certificate + sol.stats["certificate"][sol.steps[i]]
    assert Factor(program.M).norm(answer.z - sol.velocity[i]) <= certificates <= 1e-4


# ---- what it says ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "D, J",
    [
        (so.Box([-1, -2, 0], [1, 2, 0]), "g @ abs(z)"),
        (so.Box([-1, -2, 0], [1, 3, 0]), "lower"),
        (so.Ball(np.zeros(n), 1.5), "1.5 * P"),
        (2 * so.Ball(np.zeros(n), 1.0), "+ 2.0 * P"),
        (so.Balls([1.0, 2.0, 3.0], 1), "g @ norm1(reshape(z"),
        (so.Polytope(np.eye(n)), "max(V @ z"),
        (so.Polyhedron(np.eye(n), np.ones(n)), "h @ y"),
        (so.Ellipsoid(np.zeros(n), np.eye(n)), "R @ z"),
        (so.image(np.eye(n)[:, :2], SQUARE), "g @ abs(E.T @ z)"),
        (so.product(so.Box(-1, 1), so.Ball([0, 0], 2.0)), "g @ abs(E.T @ z) + 2.0 * P"),
        (so.Polytope(np.eye(n)) + so.Ball(np.zeros(n), 1.5), "max(V @ z"),
        (so.Ball(np.zeros(n), 1.5) & so.Box([-1] * n, [1, 2, 3]), "(z + lam, 2)"),
    ],
)
def test_it_prints_the_form_of_the_card_with_the_atoms_of_the_set(D, J):
    process = so.EvolutionVI(A, B, load=load, dissipation=D, u0=U0)
    # versions of cvxpy print a number's product and a minus in two ways
    shown = str(so.step_program(process, 1.0, U0, 0.5)).replace(" @ ", " * ")
    assert shown.startswith("minimize 0.5 * QuadForm(z, psd_wrap(M)) + Bu * z + ")
    assert J.replace(" @ ", " * ") in shown
    assert "+ -(f * z)" in shown or "+ -f * z" in shown
    assert " 1.0 *" not in shown
    assert " 0.0" not in shown.splitlines()[0]


def test_a_cone_is_a_constraint_and_data_that_come_twice_are_numbered():
    K = so.Orthant(n)
    process = so.EvolutionVI(A, B, load=load, cone=K, u0=U0)
    assert str(so.step_program(process, 1.0, U0, 0.5)).endswith("subject to 0.0 <= z")
    free = so.SweepingProcess(A, B, so.WholeSpace(n), U0)
    assert str(so.step_program(free, 1.0, U0, 0.5)).endswith("subject to z == 0.0")
    K = so.image(np.array([[1.0, 0.3], [0.2, 1.0], [1.0, 1.0]]), so.Orthant(2)).polar()
    process = so.EvolutionVI(A, B, load=load, cone=K, u0=U0)
    assert str(so.step_program(process, 1.0, U0, 0.5)).endswith("subject to E.T @ z <= 0.0")
    rows = so.Polyhedron(np.vstack([np.eye(n), -np.eye(n)]), np.ones(2 * n))
    twice = program_of(rows + so.Polyhedron(2 * np.eye(n), np.ones(n)))
    assert set(twice.problem.var_dict) == {"z", "y", "y_2"}
    assert {"M", "G", "G_2", "h", "h_2"} <= {one.name() for one in twice.problem.constants()}


@pytest.mark.filterwarnings("ignore::sweepopt.SweepoptWarning")
def test_constraints_of_a_user_print_as_a_cone_of_multipliers_with_named_data():
    shown = str(program_of(so.Constraints(n, lambda w: [cp.norm(w, 1) <= 1])))
    assert "+ h @ Hstack(y)" in shown
    assert "G.T @ y == -z" in shown
    assert "H.T @ y == 0.0" in shown
    assert "var" not in shown


def test_its_data_are_those_of_the_user_without_a_scale():
    g = np.array([1e-7, 1.0, 1e9])
    program = program_of(so.Moving(so.Box(-g, g), load))
    named = {one.name(): one.value for one in program.problem.constants() if one.shape}
    assert (named["M"] == A).all()
    assert (named["g"] == g).all()
    values = {name: one.value for name, one in program.problem.param_dict.items()}
    assert (values["Bu"] == B @ U0).all()
    assert (values["f"] == load(1.5)).all()
    assert program.problem.var_dict["z"] is program.z
    assert program.problem.is_dcp(dpp=True)


# ---- which step ------------------------------------------------------------------------------


@pytest.mark.parametrize("path", ["proportional", "eliminated", "full"])
@pytest.mark.parametrize("save", [None, 3, "last"])
def test_every_plan_has_the_program_of_all_unknowns_of_the_steps_it_kept(path, save):
    sol = chain(path=path, save=save, scheme="midpoint")
    assert sol.plan.path == path
    assert sol.step_program(0).z.shape == (9,)
    for i in {0, len(sol.steps) // 2, -1}:
        same_as_the_run(sol, i)


@pytest.mark.parametrize("scheme", ["trapezoid", "sdirk2"])
def test_the_velocity_of_a_scheme_with_stages_is_their_weighted_sum(scheme):
    sol = chain(scheme=scheme, tol=1e-9)
    programs = [sol.step_program(7, stage=k) for k in range(2)]
    answers = [program.certify(optimum(program)) for program in programs]
    mean = np.add(*(b * answer.z for b, answer in zip(sol.plan.scheme.b, answers, strict=True)))
    assert max(answer.relative for answer in answers) <= 1e-5
    assert mean == pytest.approx(sol.velocity[7], abs=1e-5)
    assert not np.allclose(answers[0].z, answers[1].z, atol=1e-4)


def test_auto_is_the_scheme_that_solve_takes():
    sol = chain(tol=1e-9)
    begin, end = sol.t[7:9]
    program = so.step_program(sol.process, begin, sol.u[7], end - begin, scheme="auto", stage=2)
    assert optimum(program) == pytest.approx(optimum(sol.step_program(7, stage=2)), abs=1e-7)


@pytest.mark.parametrize("path", ["proportional", "eliminated"])
def test_where_sdirk32_took_steps_of_implicit_euler_their_programs_are_given(path):
    sol = chain(40.0, scheme="sdirk32", tol=1e-9, path=path)  # mu Lam = 4
    took = [str(solver).endswith(" (implicit-euler)") for solver in sol.stats["solver"]]
    assert 0 < sum(took) < len(took)
    for i, weights in ((took.index(True), (0.2,) * 5), (took.index(False), sol.plan.scheme.b)):
        programs = [sol.step_program(i, stage=k) for k in range(len(weights))]
        answers = [b * optimum(one) for b, one in zip(weights, programs, strict=True)]
        assert sum(answers) == pytest.approx(sol.velocity[i], abs=1e-5)
        with refuses("no program of stage"):
            sol.step_program(i, stage=len(weights))


def test_a_set_of_which_nothing_is_known_enters_by_its_support_function():
    C = so.MovingSet(lambda t: so.Ball([t, 0, 0], 1 + t))
    program = program_of(C)
    assert not program.problem.param_dict["f"].value.any()
    z = optimum(program)
    expected = 0.5 * z @ A @ z + B @ U0 @ z + C.at(1.5).support(-z)
    assert program.problem.value == pytest.approx(expected, rel=1e-9)


@pytest.mark.filterwarnings("ignore:Solution may be inaccurate", "ignore::sweepopt.SweepoptWarning")
def test_a_step_that_was_taken_in_parts_has_the_program_of_the_whole_step():
    process = thin(lambda t: 1e-14 + abs(t - 0.5))
    sol = so.solve(process, t_end=1.0, steps=1, scheme="midpoint")
    assert sol.stats["solver"][0].endswith("/2")
    program = sol.step_program(0)
    assert (program.M == process.A + 0.5 * process.B).all()
    assert program.problem.param_dict["f"].value == pytest.approx([1.5, 1.0])
    with refuses("only touch"):  # nothing could be projected on it
        program.certify(optimum(program))


def four(scheme="implicit-euler"):
    """A run of four steps, for data/refused.txt."""
    C = so.Moving(so.Box([-1] * n, [1] * n), so.Separable([(so.Sine(3.0, 2.0), np.ones(n))]))
    process = so.SweepingProcess(A, B, C, np.zeros(n))
    return so.solve(process, t_end=1.0, steps=4, scheme=scheme)
