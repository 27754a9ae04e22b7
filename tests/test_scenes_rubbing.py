"""The scenes of problems/ against exact solutions and independent programs; .ci/run has all."""

import numpy as np
import pytest
from cases import close_bound, worst_certificate

from sweepopt.fem import read_scene
from sweepopt.fem.output import Report
from sweepopt.io import find_scene, read_toml

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
    assert worst_certificate(solution) <= 1e-10
    assert Report(scene, solution).units["traction"] == "N/m"  # as g has it


# The sheet on an orbiting table


@pytest.mark.slow
def test_the_orbiting_load_of_the_sheet_is_data_and_its_bound_close():
    data = read_toml(find_scene("sheet"))
    data["domain"]["mesh"]["cells"] = [6, 4]
    scene = read_scene(data)
    for t in (0.0, 1.2, 3.5, 7.8):
        force = 2.5 * min(t / np.pi, 1.0) * np.array([np.cos(2 * t), np.sin(2 * t)])
        total = scene.process.C.center(t).reshape(-1, 2).sum(axis=0)
        np.testing.assert_allclose(total, 1.5 * force, atol=1e-13)
    turn = {"t_end": np.pi}
    reference = scene.solve(steps=50, **turn)
    for scheme, most in (("implicit-euler", 2), ("auto", 6)):
        sol = scene.solve(steps=10, scheme=scheme, **turn)
        close_bound(sol, reference.t, reference.u, most)


# The tread block


def test_steps_of_the_tread_block_are_exact_when_its_drag_has_turned_round():
    """Newton steps cycled there and began each later step where they had: 1e-8, by Clarabel."""
    sol = read_scene("tread").solve(steps=16, scheme="implicit-euler")
    assert worst_certificate(sol) <= 1e-10


@pytest.mark.slow
def test_the_bound_of_a_body_of_more_than_a_thousand_unknowns_is_close():
    scene = read_scene("tread", changes={"domain.mesh.cells": [11, 7, 4]})
    assert scene.process.dim > 1000
    half = {"t_end": 0.5 * scene.t_end}
    reference = scene.solve(steps=20, **half)
    close_bound(scene.solve(steps=5, **half), reference.t, reference.u, 2)
