"""The scenes of problems/ against exact solutions and independent programs."""

from __future__ import annotations

import numpy as np
import pytest

from sweepopt.fem import read_scene

# The bar in a frictional bed


def test_the_bar_follows_the_parabola_of_its_slip_front_and_masings_rule():
    scene = read_scene("bar")
    solution = scene.solve()
    EA, g, F = 4.021e7, 7.54e4, 3.016e4
    end = -scene.displacement(solution)[:, 0]
    peak = F**2 / (2 * EA * g)
    # first loading, whole reversal and reloading: the front meets a node at each of these times
    np.testing.assert_allclose(end[[40, 120, 200]] / peak, [1.0, -1.0, 1.0], rtol=1e-10)
    # unloaded: Masing, 2 (F/2)^2 / (2 EA g) back from the peak
    np.testing.assert_allclose(end[80] / peak, 0.5, rtol=1e-10)
    slipped = np.abs(scene.displacement(solution)[40]) > 0.0
    assert scene.discretisation.points[slipped, 0].max() == pytest.approx(F / g - 0.005)
    assert solution.stats["relative"].max() <= 1e-6
