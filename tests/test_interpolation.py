"""Histories are no further from their polynomials than their interpolation says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import sweepopt as so
from sweepopt.problem.interpolation import GAUSS, interpolate, smooth_intervals
from sweepopt.problem.motion import motion
from sweepopt.study.problems import Spiral


@pytest.mark.parametrize(
    "history",
    [
        so.Sine(2.0, 0.7, 0.3, 1.0),
        so.Triangle(1.5, 0.8),
        so.Polynomial([1.0, -2.0, 0.5, 3.0, -1.0, 0.7, 0.2]),
        so.Table([0, 0.3, 0.9, 2.0], [1, -1, 2, 0]),
        Spiral(0.8, 2.0, 0.3),
    ],
)
def test_the_interpolation_error_of_a_history_is_bounded(history: Any) -> None:
    moved = motion(so.Moving(so.Box([-1], [1]), so.Separable([(history, [1.0])])))
    intervals = smooth_intervals(moved, np.linspace(0.0, 2.0, 8))
    center = interpolate(moved.center, intervals.begin, intervals.end)
    inside = np.linspace(0.0, 1.0, 41)
    for k, (a, b) in enumerate(zip(intervals.begin, intervals.end, strict=True)):
        weights = np.linalg.solve(np.vander(GAUSS, 6), center.values[k, :, 0])
        error = np.abs(history(a + (b - a) * inside) - np.vander(inside, 6) @ weights).max()
        assert error <= center.error[k, 0] + 1e-11
