"""Curves on a sphere beside a polynomial curve of directions, bounded over a whole interval.

A polynomial lies in the hull of its Bernstein coefficients, so that their norms bound it everywhere
and not only where somebody looked.
"""

from __future__ import annotations

import math

import numpy as np


def ball_arc(p: np.ndarray, ends: np.ndarray, radius: float) -> float:
    """How far radius p / |p|, whose gap is zero, is from the chord of two points of the ball.

    Parameters
    ----------
    p : ndarray, shape (3, dim)
        Bernstein coefficients of a quadratic curve of directions.
    ends : ndarray, shape (2, dim)
        The ends of the chord, seen from the centre.
    radius : float

    Returns
    -------
    float
        A bound of the distance over the whole interval; inf if p may vanish or turn away.
    """
    middle = p.sum(axis=0)
    size = float(np.linalg.norm(middle))
    least = float((p @ middle).min()) / size if size else 0.0  # |p| >= this
    if least <= 0 or (p @ ends.T).min() <= 0:
        return math.inf
    # what of the chord w is across p: (|p|^2 w - <p, w> p) / |p|^2, a polynomial of degree 5
    theta = chebyshev(6)
    curve, chord = bernstein(p, theta), bernstein(ends, theta)
    squares, products = (curve**2).sum(axis=1), (curve * chord).sum(axis=1)
    across = squares[:, None] * chord - products[:, None] * curve
    side = float(np.linalg.norm(to_bernstein(theta) @ across, axis=1).max()) / least**2
    shortest = min(float(w @ v) for w in ends for v in ends)  # |w|^2 >= this
    along = math.sqrt(max(shortest - side**2, 0.0))
    return math.hypot(side, radius - along)


def bernstein(coefficients: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """The polynomial with Bernstein coefficients, shape (degree + 1, dim), at theta, shape (m,)."""
    return basis(len(coefficients) - 1, theta) @ coefficients


def basis(degree: int, theta: np.ndarray) -> np.ndarray:
    """The Bernstein polynomials of a degree at theta, shape (..., degree + 1)."""
    k = np.arange(degree + 1)
    binomials = np.array([math.comb(degree, int(j)) for j in k])
    theta = theta[..., None]
    return binomials * theta**k * (1 - theta) ** (degree - k)


def chebyshev(count: int) -> np.ndarray:
    """Points in [0, 1], both ends among them, at which polynomials are told apart well."""
    return 0.5 - 0.5 * np.cos(np.pi * np.arange(count) / (count - 1))


def to_bernstein(theta: np.ndarray) -> np.ndarray:
    """The matrix from values at m points to the Bernstein coefficients of degree m - 1."""
    return np.linalg.inv(basis(len(theta) - 1, theta))
