"""One unknown in plain numbers: the same as in arrays."""

from __future__ import annotations

import math

import numpy as np
import pytest

import sweepopt as so
from sweepopt.interval import Interval, interval_of, velocity_in
from sweepopt.linalg import Factor
from sweepopt.program import closed_form

RNG_SIZES = 10.0 ** np.arange(-12, 13, 3)
EXACT = {
    "box": so.Box([-1.0], [2.0]),
    "half-line": so.Orthant(1),
    "other half-line": -3.0 * so.Orthant(1),
    "line": so.WholeSpace(1),
    "ball": so.Balls([1.5], 1),
    "polytope": so.Polytope([[0.25], [-4.0], [1.0]]),
    "half-space": so.HalfSpace([-2.0], 3.0),
    "scaled": 2.0 * so.Box([-1.0], [np.inf]),
}


@pytest.mark.parametrize("name", EXACT)
def test_the_ends_of_an_interval_are_where_far_points_are_projected_to(name: str) -> None:
    C, found = EXACT[name], interval_of(EXACT[name])
    assert found is not None
    for end, side in zip(found, (-1.0, 1.0), strict=True):
        assert C.project(side * np.array([1e9])) == (end if math.isfinite(end) else side * 1e9)


def test_what_is_no_interval_with_an_exact_projection_is_left_to_arrays() -> None:
    assert interval_of(so.Box([-1.0, -1.0], [1.0, 1.0])) is None
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
    monkeypatch.setattr("sweepopt.unrounded.interval_of", lambda C: None)
    expected = run()
    np.testing.assert_allclose(found.u, expected.u, rtol=0, atol=1e-15 * abs(expected.u).max())
    assert found.stats["certificate"].max() <= 2 * expected.stats["certificate"].max()
    assert (found.stats["solver"] == expected.stats["solver"]).all()
