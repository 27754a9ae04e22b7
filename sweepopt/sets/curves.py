"""Polynomials on [0, 1] by their Bernstein coefficients, in whose hull they are."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from scipy.special import comb


def gauss(n: int) -> Any:
    """n points and weights on [0, 1]: exact to degree 2 n - 1."""
    return (np.polynomial.legendre.leggauss(n) + np.array([[1], [0]])) / 2


GAUSS, WEIGHTS = gauss(4)  # exact for squares of cubics
THIRDS = np.arange(4) / 3


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
