"""Bad input to the problems and the driver: our own error, which names the culprit."""

import contextlib
import io
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse as sp

import sweepopt as so

EYE = np.eye(2)
BOX = so.Box([-1, -1], [1, 1])


def process(A=EYE, B=EYE, C=BOX, u0=(0, 0)):
    return so.SweepingProcess(A, B, C, u0)


def vi(A=EYE, B=EYE, **others):
    return so.EvolutionVI(A, B, **{"u0": [0, 0], **others})


def run(problem=None, **others):
    problem = process() if problem is None else problem
    return so.solve(problem, **{"t_end": 1.0, "steps": 4, **others})


def sparse_with(value):
    return sp.csr_array(np.array([[1.0, value], [value, 1.0]]))


class Sublinear(so.Ball):
    """A user's set whose support function is wrong."""

    def support(self, z):
        return super().support(z) + 1.0


CASES = [
    # matrices
    ("A not square", lambda: process(A=np.ones((2, 3))), r"A must be square"),
    ("A with nan", lambda: process(A=[[1, np.nan], [np.nan, 1]]), r"A\[0, 1\] is nan"),
    ("A sparse with inf", lambda: process(A=sparse_with(np.inf)), r"A\[.\, .\] is inf"),
    ("A nearly symmetric", lambda: process(A=[[1, 0.5], [0.5 + 1e-9, 1]]), r"= 0.500000001; pass"),
    ("A masked", lambda: process(A=np.ma.array(EYE, mask=1 - EYE)), r"A\[0, 1\] is nan"),
    ("u0 masked", lambda: process(u0=np.ma.array([1.0, 2.0], mask=[0, 1])), r"u0\[1\] is nan"),
    ("table masked", lambda: so.Table([0, 1], np.ma.array([0, 1], mask=[0, 1])), r"values\[1\]"),
    ("phi masked", lambda: so.Separable([(lambda t: np.ma.masked, [1])])(0.0), r"terms\[0\]\[0\]"),
    ("A indefinite", lambda: process(A=[[1, 2], [2, 1]]), r"A must be positive semidefinite"),
    ("A negative", lambda: process(A=-EYE), r"A\[0, 0\] = -1"),
    ("A and B zero", lambda: process(A=0 * EYE, B=None), r"A and B are both zero"),
    ("A zero, B singular", lambda: process(A=0 * EYE, B=np.diag([1, 0])), r"B must be positive def"),
    ("B indefinite", lambda: process(B=np.diag([1, -1])), r"B must be positive semidefinite"),
    # sets and start
    ("C of another dim", lambda: process(C=so.Ball([0, 0, 0], 1)), r"C has dim 3"),
    ("u0 too long", lambda: process(u0=[0, 0, 0]), r"u0 has dim 3, but A and B and C 2"),
    ("u0 outside at A = 0", lambda: run(process(A=0 * EYE, u0=[5, 0])), r"B u0 is not in C\(0\)"),
    ("wrong support", lambda: run(process(C=Sublinear([0, 0], 1))), r"not positively homogeneous"),
    # variational inequality
    ("dissipation dim", lambda: vi(dissipation=so.Ball([0], 1)), r"dissipation has dim 1"),
    ("cone not a cone", lambda: vi(cone=BOX), r"not a cone"),
    ("load nan", lambda: vi(load=[1.0, np.nan]), r"load\[1\] is nan"),
    ("load(t) nan", lambda: run(vi(load=lambda t: [np.nan, 0])), r"load\(t\) at t = 0"),
    ("scale(t) < 0", lambda: run(process(C=so.Moving(BOX, None, lambda t: 0.3 - t))), r"t = 0\.323"),
    ("C(t) changes dim", lambda: run(process(C=so.MovingSet(
        lambda t: BOX if t < 0.5 else so.Ball([0], 1)))), r"t = 0\.5"),
    ("C(t) not a set", lambda: run(process(C=so.MovingSet(
        lambda t: BOX if t < 0.5 else None))), r"t = 0\.5 must be a set"),
    ("C(t) empties", lambda: run(process(C=so.MovingSet(
        lambda t: so.Box([-1, -0.5], [1, 0.25 - t])))), r"t = 0\.823\d*: Box is empty: lower\[1\]"),
    # the driver
    ("process a matrix", lambda: run(EYE), r"process must be a SweepingProcess"),
    ("times decrease", lambda: run(steps=[0, 0.5, 0.2]), r"strictly increasing"),
    ("times end elsewhere", lambda: run(steps=[0, 0.5, 2.0]), r"steps end at 2"),
    ("explicit scheme at A = 0", lambda: run(process(A=0 * EYE), scheme="catching-up"), r"A = 0"),
    ("cvxpy solver unknown", lambda: run(
        vi(load=[3.0, 0], dissipation=BOX), solver=so.Cvxpy("NOPE")), r"no solver 'NOPE'"),
    ("tol true", lambda: run(tol=True), r"tol must be one number, got True .entries are bool; give numbers"),
    ("tol in a list", lambda: run(tol=[1e-6]), r"tol must be one number, got 1 of them in a list"),
    ("true in an array", lambda: so.Sine(np.array(True), 1), r"amplitude must be one number, got ar"),
    ("tol zero", lambda: run(tol=0), r"tol must be > 0"),
    ("on_unstable", lambda: run(on_unstable="maybe"), r"on_unstable must be one of"),
    ("t_end text beside times", lambda: run(steps=[0, 1], t_end="1"), r"t_end must be one number"),
    ("callback a number", lambda: run(callback=3), r"callback must be a function"),
    ("cvxpy solver a number", lambda: so.Cvxpy(5), r"the name of a solver"),
    ("OSQP tol", lambda: so.OSQP(tol=0), r"tol must be > 0"),
    ("Newton max_iter", lambda: so.Newton(max_iter=-1), r"max_iter must be a positive"),
    ("cvxpy settings", lambda: run(vi(load=[3.0, 0], dissipation=BOX),
        solver=so.Cvxpy("CLARABEL", {"nope": 1})), r"does not take the settings"),
    ("A empty", lambda: process(A=np.zeros((0, 0))), r"A has no entries"),
    ("interpolate text", lambda: run()("a"), r"t must be a time"),
    ("times empty", lambda: process().velocity_bound([]), r"at least two strictly increasing"),
    ("interpolate outside", lambda: run()(7.0), r"t = 7 is outside"),
    # found by fuzzing (test_fuzz.py), shrunken
    ("A beyond floats", lambda: process(A=[[10**400, 0], [0, 1]]), r"A must be a matrix of numbers"),
    ("u0 not to be printed", lambda: process(u0=10**5000), r"u0 must .* int too long to print"),
    ("A too large", lambda: process(A=1e300 * EYE), r"A\[0, 0\] is 1e\+300, beyond 1e\+75"),
    ("A too small", lambda: process(A=1e-320 * EYE), r"A\[0, 0\] is .*, below 1e-75"),
    ("u0 too large", lambda: process(u0=[0, -1e155]), r"u0\[1\] is -1e\+155, beyond 1e\+75"),
    ("t_end too small", lambda: run(t_end=5e-324), r"t_end is .*, below 1e-75"),
    ("steps without end", lambda: run(steps=10**15), r"steps is 1000000000000000, more than 1e\+08"),
    ("steps of two lengths", lambda: run(steps=[[1, 2], [3]]), r"steps must be an array of numb"),
    ("save of two lengths", lambda: run(save=[[1, 2], [3]]), r"save must be an array of numbers"),
    ("steps beyond floats", lambda: run(steps=10**400), r"steps is 1000"),
    ("on_unstable an array", lambda: run(on_unstable=np.ones(2)), r"on_unstable must be one of"),
    ("field's solver an array", lambda: so.velocity_field(
        so.SweepingProcess([[1]], None, so.Box([0], [1]), [0]), solver=np.ones(2)), r"solver must be"),
    ("error out of reach", lambda: run(vi(load=so.Separable([(so.Sine(3, 1), [1, 1])]),
        dissipation=BOX), error=1e-70), r"error = 1e-70 was asked for, but the bound is"),
    ("first without end", lambda: run(steps=so.Adaptive(0.5, first=1e-70)), r"make first longer"),
    ("adaptive below rounding", lambda: run(
        process(u0=[1e20, 0]), steps=so.Adaptive(0.5)), r"tol = 0.5 is less than the rounding of u"),
    ("variation a number", lambda: run().error_bound(variation=np.nan), r"variation must be a func"),
    ("scale(t) of two", lambda: so.Moving(BOX, scale=lambda t: [1, 2]).at(0.0), r"t = 0 must be one"),
    ("center wrong between nodes", lambda: run(process(C=so.Moving(
        BOX, lambda t: [0, 0] if t in (0, 1, 0.5) else 10**30)), steps=[0, 1],
        scheme="midpoint").error_bound(), r"at t = .* must have 2 entries"),
    ("dim too large", lambda: so.Orthant(10**5000), r"dim is int too long to print, more than 1e\+09"),
    ("scale too small", lambda: 5e-324 * so.Orthant(2), r"scale 0 of an unbounded set"),
    ("ellipsoid too small", lambda: so.Ellipsoid([1], [[1e-323]]), r"shape must be positive def"),
    ("no number times a set", lambda: (BOX + [1, 1]).support(["a", 1]), r"z must be an array"),
    ("terms without an axis", lambda: so.Separable(np.array("x")), r"terms must hold one pair"),
    ("history of complex times", lambda: so.Constant(1)(np.array([1j])), r"t must be a time"),
    ("period too small", lambda: so.Sine(1, 5e-324), r"period is .*, below 1e-75"),
    ("kinks without end", lambda: so.Triangle(1, 1e-30).breakpoints(0, 1), r"period 1e-30 is too sh"),
    ("variation without end", lambda: so.Sine(1, 1).variation(0, np.inf), r"b is inf"),
    ("interval reversed", lambda: so.Sine(1, 1).variation(1e20, 0), r"b = 0 is before a = 1e\+20"),
    ("polynomial overflows", lambda: so.Polynomial(np.ones(9))(1e74), r"overflows at t = 1e\+74"),
]  # fmt: skip


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
@pytest.mark.parametrize(("call", "message"), [c[1:] for c in CASES], ids=[c[0] for c in CASES])
def test_bad_input_is_refused_by_name(call, message):
    with pytest.raises(so.SweepoptError, match=message):
        call()


def test_an_asymmetry_of_rounding_is_taken_out():
    A = process(A=[[1, 0.5], [np.nextafter(0.5, 1), 1]]).A
    assert A[0, 1] == A[1, 0] == pytest.approx(0.5)


def test_what_a_callback_returns_is_a_yes_or_a_no():
    for wrong in (np.zeros(2), np.ones(3)):
        with pytest.raises(so.InputError, match="callback must return True to stop"):
            run(callback=lambda _, wrong=wrong: wrong)
    for right in (None, False, np.False_, 0, np.zeros(1)):
        assert run(callback=lambda _, right=right: right).status is so.Status.SUCCESS
    for stop in (True, np.True_, 1):
        sol = run(callback=lambda _, stop=stop: stop)
        assert sol.status is so.Status.STOPPED
        assert len(sol.stats) == 1


@pytest.mark.parametrize("lacks", ["name", "treats", "compile"])
def test_an_object_that_lacks_a_part_of_a_solver_is_refused(lacks):
    parts = {"name", "treats", "compile"} - {lacks}
    half = SimpleNamespace(**dict.fromkeys(parts, lambda *_: None))
    with pytest.raises(so.SolverRefusedError, match=f"it has no {lacks}"):
        run(solver=half)


BARE = SimpleNamespace(write=len)  # the least that `print` and redirect_stdout ask of a stream


@pytest.mark.parametrize("stream", [BARE, io.StringIO(), None], ids=["bare", "text", "none"])
@pytest.mark.parametrize("solver", ["osqp", "cvxpy"])
def test_output_may_be_redirected_to_anything(stream, solver):
    with contextlib.redirect_stdout(stream):
        assert run(process(C=so.Moving(BOX, lambda t: [3 * t, t])), solver=solver).success
    assert not isinstance(stream, io.StringIO) or not stream.getvalue()
