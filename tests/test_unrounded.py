"""The velocity of A, B and u themselves, beside solvers that see their rounded sum and product."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp

pytest.importorskip("mpmath")

import sweepopt as so
from sweepopt.integrate.schemes import SCHEMES
from sweepopt.linalg.twice_precision import product_error, sum_error
from sweepopt.sets import ConvexSet
from sweepopt.study.hard import Program
from sweepopt.study.hard.bodies import chain, spectral
from sweepopt.velocity.elimination import ACCURATE
from sweepopt.velocity.exact_residual import StateVelocity, _Unrounded, matrix, of_state
from sweepopt.velocity.plan import make_plan

N = 12
FEW = np.eye(N)[:, [1, 4, 5, 9]]
RNG = np.random.default_rng(7)
EDGE = RNG.uniform(0.2, 1.0, N)
SETS: dict[str, Callable[[], ConvexSet]] = {
    "a point": lambda: so.Point(np.zeros(N)),
    "a box": lambda: so.Box(-EDGE, EDGE),
    "a box on a few": lambda: so.image(FEW, so.Box(-EDGE[:4], EDGE[:4])),
    "a ball": lambda: so.Ball(np.zeros(N), 0.5),
    "discs on a few": lambda: so.image(FEW, so.Balls(EDGE[:2], 2)),
    "a polyhedron": lambda: so.Polyhedron(np.random.default_rng(8).normal(size=(9, N)), np.ones(9)),
}


def of(process: so.SweepingProcess, gamma: float, solver: str = "auto") -> StateVelocity:
    members = [(0.0, process.C.at(0.0))]
    plan = make_plan(process, members, SCHEMES["implicit-euler"], solver, 1e-6)
    return of_state(process, plan, gamma, plan.factors(matrix(process, gamma)))


@pytest.mark.parametrize("form", [np.array, sp.csc_array])
@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("gamma", [0.0, 1 / 3])
@pytest.mark.parametrize("seed", range(9, 13))
def test_stiffness_of_1e10_costs_no_digits(
    seed: int, gamma: float, name: str, form: Callable[[np.ndarray], np.ndarray]
) -> None:
    random = np.random.default_rng(seed)
    # the states that a stiff body comes to: large where it is soft, B u is small beside |B| |u|
    A, B = chain(random, N), spectral(random, np.logspace(0, 10, N))
    u = np.linalg.solve(B, random.normal(size=N))
    C = so.Moving(SETS[name](), 3 * random.normal(size=N))
    process = so.SweepingProcess(form(A), form(B), C, np.zeros(N))
    found = of(process, gamma)(u, process.C.at(0.0)).velocity
    program = Program(A, B, gamma)
    exact = program.solve(program.term(u), process.C.at(0.0), found.z)
    error = program.error(found.z, exact)
    assert error <= found.certificate
    # what every velocity is refined to; without that the errors are 5e-8
    assert found.certificate <= ACCURATE * exact.size


def test_a_state_that_only_rounding_moves_rests() -> None:
    # B u = (0.1, -0.1) is in C, but the two products in it are rounded to 1e-7
    B, u = np.array([[1e10 + 1, 1e10], [1e10, 1e10 + 1]]), np.array([0.1, -0.1]) * (1 + 2.0**-20)
    assert np.abs(B @ u - u).max() > 1e-8
    process = so.SweepingProcess(np.eye(2), B, so.Moving(so.Box([-1e-9] * 2, [1e-9] * 2), u), u)
    found = of(process, 0.1)(u, process.C.at(0.0)).velocity
    assert (found.z == 0).all()
    assert found.certificate == 0.0


@pytest.mark.parametrize("scheme", ["implicit-euler", "midpoint", "sdirk2", "trapezoid"])
def test_a_body_that_creeps_to_its_equilibrium_is_certified_there(scheme: str) -> None:
    random = np.random.default_rng(10)
    A, B, load = chain(random, N), chain(random, N), random.normal(size=N)
    process = so.SweepingProcess(A, B, so.Point(load), np.zeros(N))
    with pytest.warns(so.InitialStateWarning):
        sol = so.solve(process, t_end=400.0, steps=800, scheme=scheme)
    assert sol.success
    last = sol.velocity[-1]
    assert np.abs(last).max() < 1e-12
    if scheme == "implicit-euler":
        u, program = sol.u[-2], Program(A, B, 0.5)
        exact = program.solve(program.term(u), process.C.at(400.0), last)
        assert program.error(last, exact) <= 1e-8 * exact.size


@pytest.mark.parametrize("scheme", ["catching-up", "implicit-euler", "trapezoid", "sdirk2"])
def test_a_body_that_starts_at_its_equilibrium_is_certified_there(scheme: str) -> None:
    random = np.random.default_rng(13)
    A, row, u0 = chain(random, N), random.normal(size=N), 1e3 * random.normal(size=N)
    B = np.outer(row, row)
    process = so.SweepingProcess(A, B, so.Point(B @ u0), u0)  # but for the rounding of B u0
    sol = so.solve(process, t_end=3e-6, steps=3, scheme=scheme)
    assert np.abs(sol.velocity).max() < 1e-9
    if scheme == "implicit-euler":
        program = Program(A, B, 1e-6)
        exact = program.solve(program.term(u0), process.C, sol.velocity[0])
        assert program.error(sol.velocity[0], exact) <= 1e-8 * exact.size


def test_easy_data_never_take_the_precise_way(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise AssertionError("the bound of what is rounded is too large")

    monkeypatch.setattr(_Unrounded, "_precise", refused)
    random = np.random.default_rng(11)
    A, B, g = chain(random, 300), chain(random, 300), random.uniform(0.2, 1.0, 6)
    few = so.image(np.eye(300)[:, ::50], so.Box(-g, g))
    C = so.Moving(few, so.Separable([(so.Sine(1.0, 4.0), random.normal(size=300))]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", so.InitialStateWarning)
        sol = so.solve(so.SweepingProcess(A, B, C, np.zeros(300)), t_end=8.0, steps=100)
    assert sol.velocity.any()
    assert 0 < sol.stats["relative"].max() < 1e-10


@pytest.mark.parametrize("name", ["a point", "a box on a few"])
@pytest.mark.parametrize("stiffness", [None, 0.5])
def test_a_tolerance_near_rounding_is_met_by_a_closer_look(
    name: str, stiffness: float | None
) -> None:
    n = 600
    K = sp.csc_array(sp.diags_array([-1.0, 2.0 + 1e-6, -1.0], offsets=[-1, 0, 1], shape=(n, n)))
    few = sp.csc_array((np.ones(3), ([5, 100, 400], range(3))), shape=(n, 3))
    C = so.Point(np.zeros(n)) if name == "a point" else so.image(few, so.Box([-1.0] * 3, [1.0] * 3))
    f = np.random.default_rng(0).normal(size=n)
    moving = so.Moving(C, center=lambda t: t * f)
    process = so.SweepingProcess(K, stiffness and stiffness * K, moving, np.zeros(n))
    rough, fine = (so.solve(process, t_end=1.0, steps=5, tol=tol) for tol in (1e-6, 1e-11))
    assert fine.success
    assert 0 < fine.stats["relative"].max() <= 1e-11 < rough.stats["relative"].max()


def test_errors_of_sums_and_products_are_exact() -> None:
    random = np.random.default_rng(12)
    A, B = (random.normal(size=(4, 4)) * 10.0 ** random.integers(-12, 12, (4, 4)) for _ in "AB")
    product, total = 0.3 * B, A + B
    for i, j in np.ndindex(4, 4):
        a, b = Fraction(A[i, j]), Fraction(B[i, j])
        lost = product_error(0.3, B)[i, j], sum_error(A, B, total)[i, j]
        assert Fraction(product[i, j]) + Fraction(lost[0]) == Fraction(0.3) * b
        assert Fraction(total[i, j]) + Fraction(lost[1]) == a + b
    assert (sum_error(*map(sp.csc_array, (A, B, total))).toarray() == sum_error(A, B, total)).all()
