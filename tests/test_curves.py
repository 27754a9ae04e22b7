"""Curves on spheres: bounded everywhere, not only where somebody looked."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from sweepopt.sets.curves import ball_arcs, basis, products, to_bernstein


@given(st.integers(0, 10_000), st.integers(2, 4), st.floats(1e-4, 1.0))
@settings(max_examples=100, deadline=None)
def test_an_arc_is_no_further_from_its_curve_than_it_says(seed: int, dim: int, turn: float) -> None:
    random = np.random.default_rng(seed)
    radius = float(random.uniform(0.5, 2))
    ahead = random.normal(size=dim)
    p = ahead + turn * random.normal(size=(3, dim))
    w = ahead + turn * random.normal(size=(6, dim))
    w *= radius / np.maximum(np.linalg.norm(w, axis=1, keepdims=True), 1e-9)
    away = float(ball_arcs(p, w, radius))
    theta = np.linspace(0, 1, 201)
    at, along = basis(2, theta) @ p, basis(5, theta) @ w
    arc = radius * at / np.linalg.norm(at, axis=1, keepdims=True)
    assert np.linalg.norm(arc - along, axis=1).max() <= away * (1 + 1e-9) + 1e-14


def test_an_arc_beside_a_smooth_motion_is_of_second_order() -> None:
    found = []
    for h in (0.1, 0.05, 0.025, 0.0125):
        angles = h * np.array([0.0, 0.5, 1.0])
        circle = np.column_stack([np.cos(angles), np.sin(angles)])
        found.append(
            ball_arcs(to_bernstein(np.array([0.0, 0.5, 1.0])) @ circle, circle[[0, 2]], 1.0)
        )
    rates = np.log2(np.array(found[:-1]) / found[1:])
    assert np.allclose(rates, 2.0, atol=0.1)


def test_directions_that_may_vanish_have_no_arc() -> None:
    p = np.array([[1.0, 0.0], [-1.0, 0.0], [1.0, 0.0]])
    assert ball_arcs(p, np.array([[1.0, 0.0], [1.0, 0.0]]), 1.0) == math.inf


def test_integrals_of_products_are_those_of_quadrature() -> None:
    x, weights = np.polynomial.legendre.leggauss(8)
    theta = 0.5 * (x + 1)
    sampled = (basis(2, theta) * weights[:, None]).T @ basis(5, theta) / 2
    assert np.allclose(products(2, 5), sampled, rtol=1e-13)
