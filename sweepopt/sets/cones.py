"""The second-order cone; `Orthant` is a box."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sweepopt.checks import dimension, vector
from sweepopt.sets.balls import norms_below
from sweepopt.sets.base import ROUNDING, ConvexSet, Features

if TYPE_CHECKING:
    import cvxpy as cp


class SecondOrderCone(ConvexSet):
    """{ w : |w[1:]| <= w[0] }, its own dual:  sigma is the indicator of the polar cone -C.

    Parameters
    ----------
    dim : int

    Raises
    ------
    InputError
        If dim is not a positive whole number.

    Examples
    --------
    >>> SecondOrderCone(2).project([0.0, 2.0])
    array([1., 1.])
    """

    offsets = np.zeros(0)

    def __init__(self, dim: int) -> None:
        self.dim = dimension(dim)
        self.polyhedral = self.dim <= 2

    def support(self, z: np.ndarray) -> float:
        z = vector("z", z, self.dim)
        excess = z[0] + np.linalg.norm(z[1:])
        return 0.0 if excess <= ROUNDING * np.linalg.norm(z) else float("inf")

    def normal(self, v: np.ndarray) -> np.ndarray:
        # the polar cone is -C
        return 0.0 - self.project(-v)

    def project(self, w: np.ndarray) -> np.ndarray:
        w = vector("w", w, self.dim)
        height, length = w[0], float(np.linalg.norm(w[1:]))
        if length <= height:
            return w
        if length <= -height:
            return np.zeros(self.dim)
        top = 0.5 * (height + length)
        return np.concatenate([[top], top / length * w[1:]])

    def derivative(self, v: np.ndarray) -> np.ndarray:
        height, length = v[0], float(np.linalg.norm(v[1:]))
        if length <= height:
            return np.eye(self.dim)
        if length <= -height:
            return np.zeros((self.dim, self.dim))
        n, slope = v[1:] / length, height / length
        D = np.diag(np.full(self.dim, 0.5 * (1 + slope)))
        D[1:, 1:] -= 0.5 * slope * np.outer(n, n)
        D[0] = D[:, 0] = 0.5 * np.append(1.0, n)
        return D

    def features(self, p: cp.Expression) -> Features:
        if self.dim == 1:
            return Features([], [p <= 0])
        return Features([], norms_below(p[1:], -p[:1], self.dim - 1))

    def polar(self) -> ConvexSet:
        return -self
