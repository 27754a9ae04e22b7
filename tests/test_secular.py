"""One ball and any M: the formula against solutions that are known and against other solvers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sweepopt as so
from sweepopt.linalg import Factor
from sweepopt.sets.secular import secular
from sweepopt.velocity.program import Velocity, VelocityProgram
from sweepopt.velocity.routes import programmed
from sweepopt.velocity.solvers import choose
from tests.laws import ZOO

EPS = float(np.finfo(float).eps)


def spectral(rng: np.random.Generator, values: np.ndarray) -> np.ndarray:
    axes = np.linalg.qr(rng.normal(size=(values.size, values.size)))[0]
    M = (axes * values) @ axes.T
    return 0.5 * (M + M.T)


def solved(M: np.ndarray, q: np.ndarray, C: so.Ball, solver: object = None) -> Velocity:
    program = VelocityProgram(Factor(M), C)
    answer = (solver or so.Secular()).compile(program)(q, C)
    return program.certify(q, C, answer.z, answer.y)


@settings(derandomize=True, deadline=None, max_examples=150, database=None)
@given(
    seed=st.integers(0, 10**6),
    dim=st.integers(2, 30),
    decades=st.sampled_from([0, 1, 3, 6, 9, 12]),
    slow=st.floats(-8, 8),
)
def test_a_known_velocity_is_found_to_rounding_and_proved(
    seed: int, dim: int, decades: int, slow: float
) -> None:
    rng = np.random.default_rng(seed)
    M = spectral(rng, np.logspace(-decades, 0, dim))
    exact, center = 10**slow * rng.normal(size=dim), rng.normal(size=dim)
    # -z in N_C(M z + q) with w = c - r z / |z|
    q = center - exact / np.linalg.norm(exact) - M @ exact
    velocity = solved(M, q, so.Ball(center, 1.0))
    # what rounding does to M z + q - c, in the norm that 1 / lambda_min enlarges
    rounding = dim * EPS * (np.abs(M @ exact).max() + 3) * 10 ** (decades / 2)
    size = Factor(M).norm(exact)
    assert Factor(M).norm(velocity.z - exact) <= velocity.certificate + 10 * rounding
    assert velocity.certificate <= 10 * rounding + 4 * dim * EPS * 10**decades * size


@pytest.mark.parametrize("solver", [so.Newton(), so.Clarabel(tol=1e-11)], ids=lambda s: s.name)
@pytest.mark.parametrize("seed", range(15))
def test_other_solvers_agree_within_the_certificates(seed: int, solver: object) -> None:
    rng = np.random.default_rng(seed)
    dim = int(rng.integers(2, 51))
    M = spectral(rng, rng.uniform(0.1, 100, dim))
    q = rng.normal(size=dim)
    C = so.Ball(0.1 * rng.normal(size=dim), 10 ** rng.uniform(-3, 0) * float(np.linalg.norm(q)))
    ours, theirs = solved(M, q, C), solved(M, q, C, solver)
    assert ours.relative <= 1e-12
    apart = Factor(M).norm(ours.z - theirs.z)
    assert apart <= ours.certificate + theirs.certificate + 1e-14 * Factor(M).dual_norm(q)


@pytest.mark.parametrize("force", [2.0**-40, 1.0, 2.0**40])
@pytest.mark.parametrize("length", [2.0**-40, 1.0, 2.0**40])
def test_units_change_nothing_but_the_units(force: float, length: float) -> None:
    rng = np.random.default_rng(2)
    M, q, center = spectral(rng, np.logspace(0, 4, 8)), 3 * rng.normal(size=8), rng.normal(size=8)
    plain = solved(M, q, so.Ball(center, 1.0)).z
    scaled = solved(force / length * M, force * q, so.Ball(force * center, force))
    assert np.array_equal(scaled.z, length * plain)


@pytest.mark.parametrize("unit", [2.0**-40, 1.0, 2.0**40])
def test_a_load_on_the_threshold_moves_nothing_and_one_above_it_does(unit: float) -> None:
    rng = np.random.default_rng(4)
    M, center = unit * spectral(rng, np.logspace(0, 5, 6)), 7 * unit * rng.normal(size=6)
    C = so.Ball(np.zeros(6), 0.3 * unit) + center
    velocity = programmed(Factor(M), "auto", 1e-6, None)
    for _ in range(50):
        edge = rng.normal(size=6)
        edge *= 0.3 * unit / np.linalg.norm(edge)  # on the sphere to rounding
        assert not velocity(center + edge, C).velocity.z.any()
        above = velocity(center + (1 + 1e-12) * edge, C)
        assert above.solver == "secular"
        assert above.velocity.z.any()
        assert above.velocity.relative <= 1e-12


@pytest.mark.parametrize("radius", [0.0, 5e-324, 1e-300, 1e-14])
def test_a_ball_that_is_nearly_a_point_leaves_the_linear_system(radius: float) -> None:
    rng = np.random.default_rng(5)
    M, q = spectral(rng, np.logspace(0, 3, 5)), rng.normal(size=5)
    velocity = solved(M, q, so.Ball(np.zeros(5), radius))
    assert velocity.relative <= 1e-12
    assert velocity.z == pytest.approx(np.linalg.solve(M, -q), rel=1e-9)


def test_a_load_above_the_threshold_by_the_last_bit_is_answered() -> None:
    M = spectral(np.random.default_rng(0), np.array([1.0, 10.0]))
    for radius in (1.0, np.nextafter(2.0, 0.0), 1e-160):
        for load in (np.nextafter(radius, 9.0), (1 + 1e-15) * radius, 3 * radius):
            C = so.Ball(np.zeros(2), radius)
            answer = so.Secular().compile(VelocityProgram(Factor(M), C))(np.array([0.0, load]), C)
            assert np.isfinite(answer.z).all()
            assert np.linalg.norm(answer.z) <= 4 * (load - radius) + 1e-15 * radius


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
def test_a_ball_is_recognised_however_it_is_written() -> None:
    rng = np.random.default_rng(6)
    A = spectral(rng, np.logspace(0, 2, 3))
    pulled = 4 * rng.normal(size=3)
    E = np.eye(7)[:, [0, 3, 5]]
    full = np.diag(np.linspace(1, 2, 7)) + E @ A @ E.T
    ways = [
        so.Moving(so.Ball([0, 0, 0], 1.5), lambda t: t * pulled),
        so.Moving(so.Balls([1.5], 3), lambda t: t * pulled),
        so.MovingSet(lambda t: so.Ball(t * pulled, 1.5)),
        so.Moving(-(0.5 * so.Ball([1.0, 2.0, 3.0], 3)) + [0.5, 1, 1.5], lambda t: t * pulled),
    ]
    runs = [
        so.solve(so.SweepingProcess(A, A @ A, C, np.zeros(3)), t_end=2.0, steps=20) for C in ways
    ]
    for sol in runs:
        assert sol.u == pytest.approx(runs[0].u, abs=1e-13)
        assert "secular" in sol.stats["solver"]
    few = so.Moving(so.image(E, so.Ball([0, 0, 0], 1.5)), lambda t: t * (E @ pulled))
    sol = so.solve(so.SweepingProcess(full, full @ full, few, np.zeros(7)), t_end=2.0, steps=20)
    assert sol.plan.path == "eliminated"
    assert "secular" in sol.stats["solver"]


@pytest.mark.parametrize("name", ZOO)
def test_a_set_that_says_it_is_a_ball_is_one(name: str) -> None:
    for seed in range(8):
        C = ZOO[name].sample(seed).C
        if C.sphere is not None:
            z = np.random.default_rng(seed).normal(size=C.dim)
            center, radius = C.sphere
            assert C.support(z) == pytest.approx(center @ z + radius * np.linalg.norm(z), rel=1e-12)


def test_what_is_not_one_small_ball_is_left_to_others() -> None:
    for C in (so.Balls([1.0, 1.0], 2), so.Box([-1], [1]), so.Ball([0, 0], 1) & so.Ball([1, 0], 1)):
        assert not so.Secular().treats(C)
    assert not so.Secular(max_dim=2).treats(so.Ball([0, 0, 0], 1))
    names = [solver.name for solver in choose("auto", so.Ball([0, 0, 0], 1))]
    assert names == ["secular", "newton", "clarabel"]


def test_the_root_is_reached_through_many_regimes() -> None:
    k = np.logspace(-12, 12, 25)
    for seed in range(50):
        rng = np.random.default_rng(seed)
        a = 10 ** rng.uniform(-6, 6, 25)
        radius = 10 ** rng.uniform(-9, -1e-6) * float(np.linalg.norm(a))
        nu = secular(a, k, radius)
        assert np.linalg.norm(a / (1 + nu * k)) == pytest.approx(radius, rel=1e-13)
