"""Elastoplastic bodies: plastic strains at many points are condensed by return mapping."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import sweepopt as so
from sweepopt.errors import PathError

sys.path.insert(0, str(Path(__file__).parent.parent / "benchmarks"))
from plasticity import antiplane_pipe, ring

# Hk and Hi of the shear stress over gamma
PIPE: dict[str, tuple[tuple[float, float], dict[int, float]]] = {
    "kinematic": ((0.1, 0.0), {5: 1.15, 15: -1.15}),
    "isotropic": ((0.0, 0.1), {5: 1.15, 10: 0.9}),
    "both": ((0.05, 0.05), {5: 1.15, 15: -0.25}),
}
"""Displacements of its centre by the step, in closed form: 5 ends at the load 1, 15 at -1."""
RING = {20: 0.006869859, 22: 0.044179585, 44: 0.039493079, 66: -0.044175687}
"""Displacement of the ring's inner side by the number of the step, of an independent code."""


def run(process: so.EvolutionVI, steps: int, **options: object) -> so.Solution:
    settings = {"t_end": 3.0, "scheme": "implicit-euler", "tol": 1e-10} | options
    return so.solve(process, steps=steps, **settings)


@pytest.mark.parametrize("name", PIPE)
def test_the_pipe_converges_to_its_closed_form_with_every_step_proved(name: str) -> None:
    moduli, exact = PIPE[name]
    errors = []
    for refinements in (2, 3, 4):
        process, _, centre = antiplane_pipe(refinements, *moduli)
        sol = run(process, 15, path="return mapping")
        assert sol.plan.path == "return mapping"
        assert sol.stats["relative"].max() <= 1e-10
        errors.append(np.abs(sol.u[[*exact], centre] - [*exact.values()]).max())
    slopes = np.log2(errors[:-1]) - np.log2(errors[1:])
    assert slopes.min() > 1.2, slopes
    assert errors[-1] < 4e-3


def test_the_thick_ring_agrees_with_an_independent_code_over_a_cycle() -> None:
    process, points, watched = ring(8)
    sol = run(process, 66)
    assert sol.plan.path == "return mapping", "chosen where internal variables are many"
    assert (points, sol.plan.eliminated) == (1920, 3 * points)
    assert sol.stats["relative"].max() <= 1e-10
    for step, displacement in RING.items():
        assert sol.u[step, watched] == pytest.approx(displacement, rel=1e-3)


def test_a_point_that_does_not_yield_has_a_plastic_velocity_of_exactly_zero() -> None:
    process, points, _ = antiplane_pipe(3)
    sol = run(process, 15, path="return mapping")
    plastic = sol.velocity[:, -2 * points :].reshape(15, points, 2)
    still = (plastic == 0.0).all(axis=2)
    elastic = [0, 1, 5, 6, 7, 8]  # below the yield stress, and after the load turns
    assert still[elastic].all()
    assert (np.delete(still.mean(axis=1), elastic) * points >= 100).all()
    assert not np.delete(still, elastic, axis=0).all(axis=1).any()


@pytest.mark.parametrize("moduli", [(0.1, 0.0), (0.05, 0.05)])
def test_it_agrees_with_the_program_for_all_unknowns_to_both_certificates(
    moduli: tuple[float, float],
) -> None:
    process, _, _ = antiplane_pipe(2, *moduli)
    B = process.B
    condensed, full = (
        run(process, 9, path=path, tol=tol)
        for path, tol in (("return mapping", 1e-10), ("full", 1e-6))
    )
    difference = condensed.u[1] - full.u[1]
    certificates = condensed.stats["certificate"][0] + full.stats["certificate"][0]
    mu = condensed.t[1]
    # certificates are in |.|_M with M = mu B, and u[1] = mu z
    assert np.sqrt(difference @ (B @ difference)) <= np.sqrt(mu) * certificates * (1 + 1e-9)
    assert np.abs(condensed.u - full.u).max() <= 1e-5 * np.abs(full.u).max()


def test_a_set_without_diagonal_blocks_is_told_what_the_path_needs() -> None:
    process = so.SweepingProcess([[2.0, 1.0], [1.0, 2.0]], None, so.Box([-1, -1], [1, 1]), [0, 0])
    with pytest.raises(PathError, match="A and B are diagonal"):
        so.solve(process, t_end=1.0, steps=2, path="return mapping")
