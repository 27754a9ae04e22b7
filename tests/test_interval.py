"""One unknown in plain numbers: the same as in arrays."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import sweepopt as so
from sweepopt.linalg import Factor
from sweepopt.velocity.interval import Interval, interval_of, velocity_in
from sweepopt.velocity.program import closed_form

RNG_SIZES = 10.0 ** np.arange(-12, 13, 3)
INTERVALS = {
    "box": so.Box([-1.0], [2.0]),
    "half-line": so.Orthant(1),
    "other half-line": -3.0 * so.Orthant(1),
    "line": so.WholeSpace(1),
    "scaled": 2.0 * so.Box([-1.0], [np.inf]),
}


@pytest.mark.parametrize("name", INTERVALS)
def test_the_ends_of_an_interval_are_where_far_points_are_projected_to(name: str) -> None:
    C, found = INTERVALS[name], interval_of(INTERVALS[name])
    assert found is not None
    for end, side in zip(found, (-1.0, 1.0), strict=True):
        assert C.project(side * np.array([1e9])) == (end if math.isfinite(end) else side * 1e9)


def test_what_does_not_know_its_ends_is_left_to_arrays() -> None:
    assert interval_of(so.Box([-1.0, -1.0], [1.0, 1.0])) is None
    assert interval_of(so.Balls([1.5], 1)) is None
    assert interval_of(so.Box([-1.0], [1.0]) + so.Balls([1.0], 1)) is None
    assert interval_of(so.Box([-1.0], [1.0]) + [1.0]) is None


def test_a_number_is_what_an_array_of_one_gives_to_the_last_bit() -> None:
    rng = np.random.default_rng(0)
    rest = 0
    for _ in range(2000):
        M, q, c, width = rng.normal(size=4) * rng.choice(RNG_SIZES, size=4)
        M, width = abs(M), abs(width)
        C = so.Box([-width], [0.5 * width])
        expected = closed_form(Factor(np.array([[M]])), np.array([q]), C + [c])
        found = velocity_in(Interval(-width, 0.5 * width), c, M, q)
        assert found[0] == expected.z[0]
        np.testing.assert_allclose(found[1:], expected[1:], rtol=1e-13)
        rest += not found[0]
    assert 100 < rest < 1900


@pytest.mark.parametrize("scheme", ["catching-up", "implicit-euler", "trapezoid", "sdirk2"])
@pytest.mark.parametrize("B", [1.0, 1e12])
def test_a_run_is_that_in_arrays(scheme: str, B: float, monkeypatch: pytest.MonkeyPatch) -> None:
    load = so.Separable([(so.Sine(2.0, 3.0), [1.0]), (so.Constant(0.25), [1.0])])
    C = so.Moving(so.Box([-0.75], [0.5]), load)
    process = so.SweepingProcess([[0.5]], [[B]], C, [0.3 / B])

    def run() -> so.Solution:
        return so.solve(process, t_end=7.0, steps=100, scheme=scheme, on_unstable="ignore")

    if scheme == "catching-up" and B > 1:
        process = so.SweepingProcess([[1e12]], [[B]], C, [0.3 / B])
    found = run()
    monkeypatch.setattr("sweepopt.velocity.exact_residual.interval_of", lambda C: None)
    expected = run()
    np.testing.assert_allclose(found.u, expected.u, rtol=0, atol=1e-15 * abs(expected.u).max())
    assert found.stats["certificate"].max() <= 2 * expected.stats["certificate"].max()
    assert (found.stats["solver"] == expected.stats["solver"]).all()


def test_rows_that_are_nearly_the_same_are_told_apart() -> None:
    C = so.Polyhedron([[2.0], [0.5], [-1.0]], [2.0, 0.499999995, 1e4])
    process = so.SweepingProcess([[1.0]], [[1.0]], C, [1.5])
    with pytest.warns(so.InitialStateWarning):
        sol = so.solve(process, t_end=0.5, steps=1, scheme="catching-up")
    for z in (sol.velocity[0, 0], so.velocity_field(process, tol=1e-10)(0.0, [1.5])[0]):
        assert abs(z + 0.50000001) <= 1e-15 + sol.stats["certificate"][0]
    assert sol.stats["certificate"][0] < 1e-14


@pytest.mark.parametrize("C", [so.Box([-1.0], [1.0]), so.Balls([1.0], 1), so.HalfSpace([1.0], 1.0)])
def test_a_velocity_field_looks_closer_where_plain_numbers_round_too_much(C: Any) -> None:
    moving = so.Moving(C, so.Separable([(so.Constant(1e12), [1.0])]))
    velocity = so.velocity_field(so.SweepingProcess([[1.0]], [[1.0]], moving, [0.0]))
    np.testing.assert_allclose(velocity(0.0, [1e12 + 3]), [-2.0], rtol=1e-12)


@pytest.mark.parametrize("state", [np.inf, -np.inf, np.nan])
def test_a_velocity_field_refuses_a_state_that_is_not_finite(state: float) -> None:
    velocity = so.velocity_field(so.SweepingProcess([[1.0]], [[1.0]], so.Box([-1], [1]), [0.0]))
    with pytest.raises(so.InputError, match=r"u\[0\] is"):
        velocity(0.0, np.array([state]))


def test_a_load_of_two_entries_does_not_move_one_unknown() -> None:
    load = so.Separable([(so.Constant(5.0), [1.0, 2.0])])
    with pytest.raises(so.InputError, match="center must have 1 entries, got 2"):
        so.Moving(so.Box([-1.0], [1.0]), load)
