"""The velocity field: the certified minimiser as a callable, alone and in SciPy's ODE solvers."""

import warnings

import cvxpy as cp
import numpy as np
import pytest
from cases import isotropic, refuses
from reference_cases import SETS, case
from scipy.integrate import solve_ivp
from test_plan import process as chain

import sweepopt as so

COERCIVE = [name for name in SETS if name not in ("M16", "M17", "E20")]


@pytest.mark.parametrize("name", COERCIVE)
def test_it_is_the_first_velocity_of_a_step_of_the_paper(name):
    this = case(name)
    velocity = so.velocity_field(this.process)
    for t in np.array([0.1, 0.35, 0.6, 0.9]) * this.t_end:
        mu = 1e-3
        u = np.random.default_rng(int(1e3 * t)).normal(size=this.process.dim)
        moved = so.SweepingProcess(this.process.A, this.process.B, this.process.C, u)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", so.InitialStateWarning)
            sol = so.solve(moved, steps=[t - mu, t], scheme="catching-up")
        z = velocity(t, u)
        assert z.shape == u.shape
        assert this.process.metric.norm(z - sol.velocity[0]) <= 1e-9 * (1 + np.abs(z).max())
        assert inclusion(this.process, t, u, z) <= 1e-9 * (1 + np.abs(z).max())


def inclusion(process, t, u, z):
    """How far -z in N_C(A z + B u) is missed: sigma(C, -z) + <z, w>, and w beside C."""
    C, force = process.C.at(float(t)), process.A @ z + process.times_B(u)
    distance = np.linalg.norm(force - C.project(force))
    return float(abs(C.support(-z) + z @ force) / (1 + np.linalg.norm(z)) + distance)


def test_at_the_threshold_to_rounding_nothing_moves():
    C = so.Moving(so.Box(-0.3, 0.3), so.Separable([(so.Constant(1.0), 0.1)]))
    velocity = so.velocity_field(isotropic(C, 1.0, 1.0))
    assert velocity(0.0, [0.1 + 0.2 + 0.1]).tolist() == [0.0]
    assert velocity(0.0, [0.4 + 1e-13])[0] < 0.0


def test_contact_unknowns_are_eliminated_as_in_a_run():
    body, random = chain("box"), np.random.default_rng(1)
    velocity = so.velocity_field(body)
    whole = so.velocity_field(body, solver="clarabel", tol=1e-5)
    u = random.normal(size=body.dim)
    z = velocity(1.4, u)
    assert inclusion(body, 1.4, u, z) <= 1e-8 * np.linalg.norm(z)
    assert whole(1.4, u) == pytest.approx(z, abs=1e-4 * np.abs(z).max())


@pytest.mark.parametrize("name", ["S03", "V05", "P09"])
def test_scipy_follows_the_reference(name):
    this = case(name)
    solution = solve_ivp(
        so.velocity_field(this.process), (0.0, this.t_end), this.process.u0, method="LSODA",
        rtol=1e-9, atol=1e-10, max_step=0.1, t_eval=np.linspace(0, this.t_end, 102),
    )  # fmt: skip
    assert np.abs(solution.y.T - this.exact(101)).max() <= 1e-7


ONE_NORM = so.Constraints(2, lambda w: [cp.norm(w, 1) <= 1])


@pytest.mark.parametrize("name", ["S03", "P09"])
def test_a_missed_tolerance_raises_with_its_time(name):
    velocity = so.velocity_field(case(name).process, tol=1e-19)
    with pytest.raises(
        so.VelocityError, match=r"at t = 1\.5 is known to .* tol is 1e-19"
    ) as caught:
        velocity(1.5, np.full(case(name).process.dim, 5.0))
    assert caught.value.t == 1.5
    assert caught.value.certificate > 1e-19
    assert caught.value.u.tolist() == [5.0] * case(name).process.dim


def test_a_set_that_is_known_later_only_is_compiled_by_the_first_call():
    record = so.Table([2.0, 3.0, 4.0], [0.0, 2.0, 2.0])
    C = so.Moving(so.Ball([0.0, 0.0], 1.0), so.Separable([(record, [1.0, 0.0])]))
    velocity = so.velocity_field(isotropic(C))
    assert velocity(3.5, [0.0, 0.0]) == pytest.approx([1.0, 0.0])
    with refuses("lies outside the table"):
        velocity(1.0, [0.0, 0.0])


def test_a_set_that_moves_away_from_a_body_at_rest_at_0_is_found():
    E = np.array([[1.0, 0.3, 0.2], [0.1, 1.0, -0.4]])
    C = so.MovingSet(lambda t: so.image(E, so.Box(np.full(3, 2 * t - 1), np.full(3, 2 * t + 1))))
    velocity = so.velocity_field(so.SweepingProcess(np.eye(2), 2 * np.eye(2), C, np.zeros(2)))
    assert velocity(0.0, [10.0, 3.0]).all()
    assert velocity(0.0, [0.0, 0.0]).tolist() == [0.0, 0.0]  # solvers start from 0 next
    np.testing.assert_allclose(velocity(1.0, [0.0, 0.0]), E @ [1.0, 1.0, 1.0])
