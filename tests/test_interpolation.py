"""Histories as polynomials on the intervals of a grid: no further off than their bound says."""

import numpy as np
import pytest

import sweepopt as so
from sweepopt.problem import motion
from sweepopt.results.interpolation import GAUSS, interpolate, smooth_intervals


class Varies:
    """A history of which only the variation is known."""

    def __call__(self, t):
        return np.cos(7 * t)

    def variation(self, a, b):
        return 7 * (b - a)


HISTORIES = [
    so.Sine(2.0, period=0.7, phase=0.3),
    so.Sine(1.0, period=0.11),
    so.Polynomial([0.0, 1.0, -2.0, 0.0, 0.0, 3.0, 0.0, -1.0]),
    so.Triangle(1.0, period=0.3),
    so.Table([0.0, 0.21, 0.8, 1.0], [0.0, 1.0, -1.0, 0.5]),
    so.Modulated(so.Sine(2.0, period=0.7, phase=0.3), so.Table([0.0, 0.4, 1.0], [0.0, 1.0, -2.0])),
    so.Modulated(so.Polynomial([1.0, -3.0, 2.0, 0.5, 4.0]), so.Sine(1.0, period=0.4, offset=2.0)),
    Varies(),
]


@pytest.mark.parametrize("history", HISTORIES, ids=lambda history: type(history).__name__)
@pytest.mark.parametrize("steps", [3, 10])
def test_a_history_is_no_further_from_its_polynomial_than_the_bound(history, steps):
    moving = motion(so.Moving(so.Box(-1, 1), so.Separable([(history, [1.0])])))
    _, begin, end = smooth_intervals(moving.histories, np.linspace(0, 1, steps + 1))
    polynomials = interpolate(moving.center, begin, end)
    parts = np.linspace(0, 1, 401)
    for k, (a, b) in enumerate(zip(begin, end, strict=True)):
        values = polynomials.values[k, :, 0]
        polynomial = np.polynomial.Polynomial.fit(GAUSS, values, 3, (0, 1), window=(0, 1))
        off = [history(t) for t in (a + (b - a) * parts).tolist()] - polynomial(parts)
        assert abs(off).max() <= polynomials.error[k, 0] + 1e-14
        assert abs(np.diff(off)).sum() <= polynomials.slope_error[k, 0] + 1e-12
