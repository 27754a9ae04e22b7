"""Curves on a sphere beside a polynomial curve of directions, bounded over a whole interval.

A polynomial lies in the hull of its Bernstein coefficients, so that their norms bound it everywhere
and not only where somebody looked.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.polynomial.chebyshev import chebpts2
from scipy.special import comb


def ball_arcs(p: np.ndarray, w: np.ndarray, radius: Any) -> np.ndarray:
    """How far radius p / |p|, whose gap is zero, is from curves w in balls.

    Parameters
    ----------
    p : ndarray, shape (..., 3, dim)
        Bernstein coefficients of quadratic curves of directions.
    w : ndarray, shape (..., k, dim)
        Bernstein coefficients of w, seen from the centre.
    radius : float or ndarray, shape (...)

    Returns
    -------
    ndarray, shape (...)
        A bound of the distance over the whole interval; inf if p may vanish or turn away.
    """
    middle, transposed = p.sum(axis=-2), np.swapaxes(w, -1, -2)
    size = np.linalg.norm(middle, axis=-1)
    with np.errstate(all="ignore"):  # what vanishes or overflows has no arc
        least = (p @ middle[..., None])[..., 0].min(axis=-1) / size  # |p| >= this
        # what of w is across p: (|p|^2 w - <p, w> p) / |p|^2, above the bar a polynomial
        theta = 0.5 + 0.5 * chebpts2(w.shape[-2] + 4)
        curve, points = basis(2, theta) @ p, basis(w.shape[-2] - 1, theta) @ w
        squares, along = (curve**2).sum(axis=-1), (curve * points).sum(axis=-1)
        across = squares[..., None] * points - along[..., None] * curve
        side = np.linalg.norm(to_bernstein(theta) @ across, axis=-1).max(axis=-1) / least**2
        shortest = (w @ transposed).min(axis=(-1, -2))  # |w|^2 >= this
        distance = np.hypot(side, radius - np.sqrt(np.maximum(shortest - side**2, 0.0)))
    ahead = (least > 0) & ((p @ transposed).min(axis=(-1, -2)) > 0)
    return np.where(ahead & ~np.isnan(distance), distance, np.inf)


def basis(degree: int, theta: np.ndarray) -> np.ndarray:
    """The Bernstein polynomials of a degree at theta, shape (..., degree + 1)."""
    k = np.arange(degree + 1)
    theta = theta[..., None]
    return comb(degree, k) * theta**k * (1 - theta) ** (degree - k)


def to_bernstein(theta: np.ndarray) -> np.ndarray:
    """The matrix from values at m points to the Bernstein coefficients of degree m - 1."""
    return np.linalg.inv(basis(len(theta) - 1, theta))


@cache
def products(first: int, second: int) -> np.ndarray:
    """int_0^1 of the products of Bernstein polynomials, shape (first + 1, second + 1)."""
    j, k = np.meshgrid(np.arange(first + 1), np.arange(second + 1), indexing="ij")
    degree = first + second
    return np.asarray(comb(first, j) * comb(second, k) / comb(degree, j + k) / (degree + 1))
