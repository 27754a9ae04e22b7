"""Scenes of the library against exact or independent values; .ci/run has those marked slow."""

import numpy as np
import pytest
import skfem
from cases import slow, worst_certificate

from sweepopt.fem import read_scene

SUDDEN = pytest.mark.filterwarnings("ignore::sweepopt.errors.InitialStateWarning")


# ---- pipe, square_pipe: Bingham's flow ----

G, ETA, R = 120.0, 2.5, 5e-3
PEAK = 96e3  # Pa/m


def steady(name, P, **domain):
    """The velocity at the nodes under a constant pressure gradient."""
    changes = {f"domain.{key}": value for key, value in domain.items()}
    changes["effects.body_force.history"] = {"waveform": "constant", "value": P / PEAK}
    scene = read_scene(name, changes=changes | {"time.end": 1.0, "time.steps": 1})
    run = scene.solve()
    assert run.plan.path == "cones"
    assert worst_certificate(run) <= 1e-6
    return scene, scene.velocity(run)[0]


def mean_of(scene, values):
    """The integral over the section, of values at its nodes in the last axis."""
    integrals = skfem.LinearForm(lambda v, _: 1.0 * v).assemble(scene.discretisation.basis)
    return values @ integrals[scene.discretisation.nodes[0]]


def flux(P):
    """Of Buckingham and Reiner."""
    phi = np.minimum(2 * G / (np.maximum(P, 1.0) * R), 1.0)
    return np.pi * P * R**4 / (8 * ETA) * (1 - 4 * phi / 3 + phi**4 / 3)


@SUDDEN
def test_the_flux_of_the_pipe_converges_to_the_formula():
    runs = (steady("pipe", PEAK, refinements=refinements) for refinements in range(3))
    errors = [abs(mean_of(*run) / flux(PEAK) - 1) for run in runs]
    assert np.diff(np.log2(errors)).max() < -1.8, errors


@SUDDEN
@pytest.mark.parametrize("phi", [slow(0.1), slow(0.5), 0.9])
def test_the_flux_and_the_plug_of_the_pipe_agree_with_the_formulas(phi):
    P = 2 * G / (phi * R)
    scene, z = steady("pipe", P)
    assert mean_of(scene, z) == pytest.approx(flux(P), rel=2e-3)  # 4992 triangles
    r = np.hypot(*scene.discretisation.points.T)
    near = (z < 0.98 * z.max()) & (z > 0.5 * z.max())
    slope, value = np.polyfit(r[near], np.sqrt(z.max() - z[near]), 1)
    assert -value / slope == pytest.approx(phi * R, rel=5e-3)
    assert np.unique(z[r < 0.9 * phi * R]).tolist() == [z.max()]


@SUDDEN
def test_the_pipe_is_at_rest_up_to_its_limit_and_moves_above_that_of_the_mesh():
    limit, h = 2 * G / R, 0.06 / 2  # width of the ring at the wall, in radii
    for P, moves in ((limit, False), (1.002 * limit * (1 + 0.53 * h), True)):
        assert steady("pipe", P, refinements=1)[1].any() == moves


@SUDDEN
@pytest.mark.slow
def test_the_square_pipe_is_at_rest_up_to_its_limit_and_its_corners_stay_at_rest():
    limit = (2 + np.sqrt(np.pi)) * G / (2 * R)
    assert not steady("square_pipe", limit)[1].any()
    scene, z = steady("square_pipe", 1.05 * limit)
    x, y = scene.discretisation.points.T
    # what moves first is the square with corners of this radius, beyond that the corners are dead
    radius = 2 * R / (2 + np.sqrt(np.pi))
    corner = np.hypot(np.maximum(radius - R - x, 0), np.maximum(y + radius - R, 0)) / radius
    free = (x > -0.999 * R) & (y < 0.999 * R)
    assert (z[free & (corner < 0.999)] > 0).all()
    assert not z[corner > 1.15].any()


@SUDDEN
@pytest.mark.slow
def test_p2_elements_have_rigid_plugs_too_and_the_flux_of_the_formula():
    mesh = {"sizes": [5e-3, 5e-3], "cells": [8, 8], "points": ["x - 5e-3", "y"]}
    assert not steady("square_pipe", 45e3, element="P2", mesh=mesh)[1].any()
    assert steady("square_pipe", 50e3, element="P2", mesh=mesh)[1].any()
    scene, z = steady("pipe", 2 * PEAK, element="P2", refinements=1)
    assert mean_of(scene, z) == pytest.approx(flux(2 * PEAK), rel=1e-3)
    inside = np.hypot(*scene.discretisation.points.T) < 0.8 * G / PEAK
    assert np.unique(z[inside]).tolist() == [z.max()]


def test_the_flux_follows_the_pressure_as_the_pipe_starts_and_stops():
    scene = read_scene("pipe", changes={"domain.refinements": 1, "time.steps": 16})
    run = scene.solve()
    t = (run.t[1:] + run.t[:-1]) / 2
    P = PEAK * np.interp(t, [0.0, 3.0, 5.0, 8.0], [0.0, 1.0, 1.0, 0.0])
    velocity = scene.velocity(run)
    assert worst_certificate(run) <= 1e-6
    assert mean_of(scene, velocity) == pytest.approx(flux(P), abs=4e-3 * flux(PEAK))
    assert not velocity[P <= 2 * G / R].any()
    assert velocity[P > 1.1 * 2 * G / R].any(axis=1).all()


# ---- gel: Kelvin, Voigt and Bingham ----


@pytest.mark.slow
def test_the_gel_of_the_loading_ramp_agrees_with_its_closed_form():
    g, eta, kappa, p, end = 0.38, 3.71, 2.53, 456.0 / 4.0, 4.0
    r = np.linspace(0, R, 4001)[1:]
    s, theta = np.maximum(end - 2 * g / (p * r), 0.0), eta / kappa
    shear = p * r / (2 * kappa) * (s - theta * (1 - np.exp(-s / theta)))
    exact = np.trapezoid(shear * np.pi * r**2, r)  # of u over the section, by parts
    errors = []
    for refinements, steps in ((0, 6), (1, 12), (2, 24)):
        changes = {"domain.refinements": refinements, "time.end": end, "time.steps": steps}
        scene = read_scene("gel", changes=changes)
        run = scene.solve()
        assert worst_certificate(run) <= 1e-6
        u = scene.displacement(run)[-1]
        errors.append(abs(mean_of(scene, u) / exact - 1))
    assert np.diff(np.log2(errors)).max() < -1.8, errors
    assert errors[-1] < 5e-3
    assert u.max() == pytest.approx(np.trapezoid(shear, r), rel=5e-3)
