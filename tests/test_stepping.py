"""A step that contains breakpoints of the load, or misses its tolerance, is taken in parts."""

from itertools import cycle

import numpy as np
import pytest
from cases import SQUARE, block, isotropic, slow, worst_certificate
from laws import ZOO
from test_checkpoint import Killed, same, stiff, stopping

import sweepopt as so

LOAD = so.Sine(3.0, 6.0)


def one():
    C = so.Moving(so.Box(-1, 1), LOAD)
    return isotropic(C)


def thin(gap, speed=3.0, height=0.0):
    """Two discs that meet in a lens of the width 2 gap(t); u starts at that height."""

    def lens(t):
        d = 1 - gap(t)
        return (so.Ball([-d, 0.0], 1.0) & so.Ball([d, 0.0], 1.0)) + np.array([speed * t, 1.0])

    A = np.array([[2.0, 0.5], [0.5, 1.0]])
    return so.SweepingProcess(A, np.eye(2), so.MovingSet(lens), [0.0, height])


def parts(sol):
    """In how many parts each step was taken."""
    return [int(name.partition("/")[2] or 1) for name in sol.stats["solver"]]


@pytest.mark.parametrize("scheme", ["implicit-euler", "midpoint", "trapezoid", "sdirk2"])
def test_a_step_that_is_too_long_for_its_matrix_is_rescued(scheme):
    sol = so.solve(stiff(4e15), t_end=2.0, steps=2, scheme=scheme, on_unstable="ignore")
    assert sol.success
    assert max(parts(sol)) > 1
    assert worst_certificate(sol) <= 1e-6
    assert sol.velocity == pytest.approx(np.diff(sol.u, axis=0) / np.diff(sol.t)[:, None])
    assert np.abs(sol.u).max() > 0.3
    if scheme != "trapezoid":  # whose explicit stage makes motion of what B u rounds
        # the same as so many steps of the same scheme
        pieces = zip(sol.t, sol.t[1:], parts(sol), strict=False)
        fine = np.concatenate([np.linspace(a, b, k, endpoint=False) for a, b, k in pieces])
        by_hand = so.solve(one(), steps=np.append(fine, 2.0), scheme=scheme, on_unstable="ignore")
        # velocities of 1 that are right to tol, for 2 units of time
        assert sol.u[:, 0] == pytest.approx(by_hand(sol.t)[:, 0], abs=2e-6)


def test_the_bound_of_steps_in_parts_is_not_below_their_error():
    sol = so.solve(stiff(4e15), t_end=0.5, steps=1, scheme="midpoint", on_unstable="ignore")
    assert max(parts(sol)) > 1
    exact = so.solve(one(), t_end=0.5, steps=1, scheme="exact").exact
    times = np.linspace(0.0, 0.5, 201)
    error = np.sqrt(2) * np.abs(sol(times)[:, 0] - exact(times)[:, 0]).max()
    bound = sol.error_bound()
    assert bound.guaranteed
    assert 1e-3 < error <= bound


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
def test_a_step_where_the_set_is_thin_is_taken_in_parts():
    process = thin(lambda t: 1e-14 + abs(t - 0.5))
    sol = so.solve(process, t_end=1.0, steps=1, scheme="midpoint")
    assert [name.partition("/")[2] for name in sol.stats["solver"]] == ["2"]
    assert sol.message.endswith(" 1 step missed tol as a whole and met it in equal parts.")
    assert sol.stats["attempts"][0] >= 3  # the whole step and its two parts
    halves = so.solve(process, t_end=1.0, steps=2, scheme="midpoint")
    assert sol.u[-1] == pytest.approx(halves.u[-1], abs=1e-12)
    assert sol.stats["relative"][0] == pytest.approx(worst_certificate(halves))


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
def test_a_step_in_parts_that_overshoots_is_warned_of():
    process = thin(lambda t: 1e-14 + abs(t - 5.0) / 500, speed=0.0, height=-2.0)
    with pytest.warns(so.StabilityWarning, match="can overshoot into a wrong stuck state"):
        sol = so.solve(process, t_end=10.0, steps=1, scheme="midpoint")
    assert parts(sol) == [2]
    right = so.solve(process, t_end=10.0, steps=29, scheme="implicit-euler")
    assert np.abs(sol.u[-1] - right.u[-1]).max() > 0.2


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
def test_sets_that_touch_in_one_point_are_refused_after_two_attempts():
    # smaller parts than halves meet the same set: 16 took 15 s
    C = so.Ball([0.0, 0.0], 1.0) & so.Box([1.0, -1.0], [2.0, 1.0])
    process = so.SweepingProcess(
        [[0.3, 0.1], [0.1, 0.2]], [[2.0, -1.0], [-1.0, 2.0]], C, [0.0, 0.0]
    )
    with pytest.raises(so.StepError, match=r"none of 2 attempts .* C\(t\) is nearly empty"):
        so.solve(process, t_end=1.0, steps=1, scheme="implicit-euler")


def test_a_step_that_no_parts_help_ends_the_run_and_says_where_and_why():
    times = [0.0, 1e-3, 2e-3, 1.0]
    with pytest.raises(so.StepError, match="not positive definite to rounding") as failure:
        so.solve(stiff(1e17), steps=times, scheme="midpoint", on_unstable="ignore")
    error = failure.value
    assert (error.t, error.step, error.certificate) == (2e-3, 2, np.inf)
    assert "step 2 from t = 0.002" in str(error)
    assert "in parts does not help. B is so large" in str(error)
    how = {"on_failure": "stop", "on_unstable": "ignore"}
    sol = so.solve(stiff(1e17), steps=times, scheme="midpoint", **how)
    assert sol.status is so.Status.INEXACT
    assert np.array_equal(sol.t, times[:3])
    assert np.array_equal(sol.u[-1], error.u)
    assert sol.message.endswith(str(error))


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
def test_a_set_that_is_empty_between_the_times_of_the_grid_is_named():
    process = thin(lambda t: 1e-14 + abs(t - 0.5) if t in (0.0, 0.5, 1.0) else -0.5)
    with pytest.raises(so.StepError, match=r"parts: C\(t\) at t = 0.25 is empty") as failure:
        so.solve(process, t_end=1.0, steps=1, scheme="midpoint")
    assert failure.value.certificate > 1e-6
    assert failure.value.step == 0


# ---- breakpoints of the load -------------------------------------------------------------------

TURNS = so.Table([0.0, 0.31, 0.52, 0.58, 0.83, 1.0], [0.0, 2.5, -1.0, 1.5, -2.0, 0.5])
ONES, PULL, E2 = np.ones(3), np.array([1.0, 0.5, -1.0]), np.eye(3)[:, 1:]
A3 = np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 2.0]])
BOX, ALONG = so.Box(-ONES, ONES), so.Separable([(TURNS, PULL)])
ROWS = np.vstack([np.eye(3), -np.eye(3)])
OFFSETS = so.Separable([(TURNS, np.append(PULL, -PULL)), (so.Constant(1.0), np.ones(6))])
ON_TWO = so.Moving(so.image(E2, SQUARE), ALONG)
VECTORS = so.VectorTable(TURNS.times, np.outer(TURNS.values, PULL))
WAVE, SCALE = so.Separable([(so.Sine(2.0, 1.0), PULL)]), so.Table(TURNS.times, [1, 0.2, 1, 0, 2, 1])
STATE = so.StateDependent(
    lambda t, u: (1 + 0.01 * np.exp(-(u @ u))) * BOX + ALONG(t), 0.02 * np.eye(3), [TURNS]
)
MEETING = {
    "Separable": (so.Moving(BOX, ALONG), np.eye(3), "auto"),
    "VectorTable": (so.Moving(BOX, VECTORS), np.eye(3), "auto"),
    "scale": (so.Moving(BOX, WAVE, scale=SCALE), np.eye(3), "auto"),
    "rows": (so.Polyhedron(ROWS, OFFSETS), np.eye(3), "auto"),
    "sum": (so.Moving(BOX, ALONG) + so.Ball(np.zeros(3), 0.3), np.eye(3), "auto"),
    "image": (so.image(np.eye(3), so.Moving(BOX, ALONG)), np.eye(3), "auto"),
    "function": (so.MovingSet(lambda t: BOX + ALONG(t), histories=[TURNS]), np.eye(3), "auto"),
    "state": (STATE, np.eye(3), "auto"),
    "eliminated": (ON_TWO, np.eye(3), "eliminated"),
    "full": (ON_TWO, np.eye(3), "full"),
    "proportional": (ON_TWO, 1.5 * A3, "proportional"),
}


@pytest.mark.parametrize(
    "stiffness, name",
    [*zip(cycle([1.0, 1e5]), MEETING), *(slow(*each) for each in zip(cycle([1e5, 1.0]), MEETING))],
)
def test_auto_takes_steps_with_breakpoints_in_parts_that_end_there(name, stiffness):
    C, B, path = MEETING[name]
    process = so.SweepingProcess(A3 / stiffness, B, C, np.zeros(3))
    how = {"path": path, "tol": 1e-9}
    sol = so.solve(process, t_end=1.0, steps=10, **how)
    nodes = np.union1d(sol.t, TURNS.times)
    by_hand = so.solve(process, steps=nodes, **how, scheme=sol.plan.scheme.name)
    assert sol.plan.path == (by_hand.plan.path if path == "auto" else path)
    assert len(sol.t) == 11
    assert parts(sol) == [1, 1, 1, 2, 1, 3, 1, 1, 2, 1]
    assert "in parts" not in sol.message  # tol was met
    assert sol.u == pytest.approx(by_hand(sol.t), abs=1e-7)
    assert sol.velocity == pytest.approx(np.diff(sol.u, axis=0) / 0.1, abs=1e-7)
    assert "4 of the load lie inside of steps" in str(sol.plan)
    # a scheme by name is its tableau on the given grid
    assert set(parts(so.solve(process, t_end=1.0, steps=10, **how, scheme="sdirk2"))) == {1}


def test_breakpoints_at_nodes_up_to_rounding_and_functions_of_time_divide_no_step():
    for load in (so.Table(0.1 * np.arange(11) * 3, np.arange(11) % 2), lambda t: [np.sin(t)]):
        center = so.Separable([(load, 2.0)]) if isinstance(load, so.Table) else load
        sol = so.solve(block(center, 1.0, 1.0), t_end=3.0, steps=30)
        assert set(parts(sol)) == {1}
        assert "breakpoints" not in str(sol.plan)


def test_rough_loads_are_not_met_and_the_plan_says_so():
    def run(dim, points):
        random = np.random.default_rng(4)
        times = np.concatenate([[0.0], np.sort(random.uniform(0, 1, points)), [1.0]])
        table = so.Table(times, (-1.0) ** np.arange(points + 2))
        ones = np.ones(dim)
        C = so.Moving(so.Box(-ones, ones), so.Separable([(table, 2 * ones)]))
        process = so.SweepingProcess(np.eye(dim), 2 * np.eye(dim), C, -2 * ones)
        with pytest.warns(so.InitialStateWarning):
            return so.solve(process, t_end=1.0, steps=60)

    for dim, most in ((1, 30), (600, 6)):
        assert sum(parts(run(dim, most))) == 60 + most
        assert set(parts(rough := run(dim, most + 1))) == {1}
        assert f"{most + 1} inside of steps, over {most} are not met" in str(rough.plan)


# ---- bit for bit after a kill ----------------------------------------------------------------


@pytest.mark.parametrize("name", ["Separable", slow("eliminated"), "proportional"])
def test_a_resumed_run_that_meets_breakpoints_is_the_whole_run(name, tmp_path):
    C, B, path = MEETING[name]
    process = so.SweepingProcess(A3, B, C, np.zeros(3))
    how = {"steps": 20, "t_end": 1.0, "path": path}
    whole = so.solve(process, checkpoint=so.Checkpoint(tmp_path / "a", steps=7), **how)
    assert sum(parts(whole)) == 24
    for killed in (13, 14):
        file = tmp_path / f"{killed}"
        checkpoint = so.Checkpoint(file, steps=7)
        with pytest.raises(Killed):
            so.solve(process, checkpoint=checkpoint, callback=stopping(killed), **how)
        assert same(so.resume(file, process), whole)
    last = so.solve(process, **how, save="last")  # its bound runs the steps again
    every = so.solve(process, **how)
    assert last.error_bound() == pytest.approx(every.error_bound())


# ---- workspaces ------------------------------------------------------------------------------


def curved(name):
    C = ZOO[name].sample(0).C
    return C.certifiable and not C.polyhedral


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
@pytest.mark.parametrize("name", [*filter(curved, ZOO)])
def test_sets_with_curved_faces_meet_a_tight_tolerance_as_a_whole(name):
    S = ZOO[name].sample(0).C
    load = so.Separable([(so.Sine(3.0, 2 * np.pi), np.random.default_rng(0).normal(size=S.dim))])
    C = so.Moving(S, load)
    sol = so.solve(isotropic(C, 1.0, 1.0), t_end=6.0, steps=20, tol=1e-11, scheme="midpoint")
    assert worst_certificate(sol) <= 1e-11
    assert set(parts(sol)) == {1}
    # the velocity of diagonal matrices is a projection in the Euclidean norm: midpoint's
    t, mu = 0.5 * (sol.t[0] + sol.t[1]), sol.t[1]
    nearest = C.at(t).project(np.zeros(C.dim))
    assert sol.velocity[0] * (1 + mu / 2) == pytest.approx(nearest, abs=1e-9)
