"""Sets that a Euclidean norm bounds: balls, products of balls and the second-order cone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.linalg

from sweepopt.checks import dimension, entries, number, vector
from sweepopt.errors import InputError
from sweepopt.sets.base import ROUNDING, ConvexSet, CurveGap, Features, Halfspaces, total_gap
from sweepopt.sets.curves import ball_arc
from sweepopt.sets.shapes import Box

if TYPE_CHECKING:
    import cvxpy as cp


class Balls(ConvexSet):
    """The product of m balls around 0 in R^dim, one after the other in the vector.

    sigma(z) = sum_k radii_k |z_k|: friction bounds at m contact points, as arrays.

    Parameters
    ----------
    radii : array_like, shape (m,), >= 0
    dim : int
        Dimension of each ball; the set has dim * m unknowns.

    Raises
    ------
    InputError
        If there is no radius, one is < 0 or not finite, or dim is not positive.

    Examples
    --------
    >>> Balls([1.0, 2.0], 2).support([3.0, 4.0, 0.0, 1.0])
    7.0
    """

    center: np.ndarray | float = 0.0

    def __init__(self, radii: Any, dim: int) -> None:
        self.radii = self.offsets = entries("radii", radii)
        if (self.radii < 0).any():
            i = int(np.flatnonzero(self.radii < 0)[0])
            raise InputError(f"radii[{i}] must be >= 0, got {self.radii[i]:g}")
        self.block = dimension(dim)
        self.dim = self.block * self.radii.size
        self.polyhedral = self.block == 1

    def _arms(self, w: np.ndarray) -> np.ndarray:
        """From the centres, one row for each ball."""
        return (w - self.center).reshape(-1, self.block)

    def support(self, z: np.ndarray) -> float:
        z = vector("z", z, self.dim)
        lengths = np.linalg.norm(z.reshape(-1, self.block), axis=1)
        return float(np.sum(self.center * z) + self.radii @ lengths)

    def project(self, w: np.ndarray) -> np.ndarray:
        w = vector("w", w, self.dim)
        arms = self._arms(w)
        lengths = np.linalg.norm(arms, axis=1)
        outside = lengths > self.radii
        if not outside.any():
            return w
        factor = np.divide(self.radii, lengths, out=np.ones_like(lengths), where=outside)
        return self.center + (factor[:, None] * arms).ravel()

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        sizes = cp.Variable(self.radii.size)
        return Features([sizes], norms_below(p, sizes, self.block))

    def gap_along_curve(self, p: np.ndarray, w: np.ndarray, ratio: float) -> CurveGap:
        blocks = (np.split(x, self.radii.size, axis=1) for x in (p, w))
        each = zip(self.factors(), *blocks, strict=True)
        return total_gap(ball.gap_along_curve(*curves, ratio) for ball, *curves in each)

    def weights(self, tau: np.ndarray) -> np.ndarray:
        return np.repeat(tau.reshape(-1, self.block).mean(axis=1), self.block)

    def blocks(self, v: np.ndarray) -> np.ndarray:
        """I in a ball, r/|a| (I - n n^T) outside of it, n = a/|a|."""
        arms = self._arms(v)
        D = np.tile(np.eye(self.block), (self.radii.size, 1, 1))
        lengths = np.linalg.norm(arms, axis=1)
        out = lengths > self.radii
        n = arms[out] / lengths[out, None]
        share = (self.radii[out] / lengths[out])[:, None, None]
        D[out] = share * (D[out] - n[:, :, None] * n[:, None, :])
        return D

    def derivative(self, v: np.ndarray) -> np.ndarray:
        D = self.blocks(v)
        return D[0] if len(D) == 1 else scipy.linalg.block_diag(*D)

    def factors(self) -> list[ConvexSet]:
        return [Ball(np.zeros(self.block), radius) for radius in self.radii]

    def halfspaces(self) -> Halfspaces:
        if self.block > 1:
            return super().halfspaces()
        return Box(self.center - self.radii, self.center + self.radii).halfspaces()

    def magnitude(self) -> float:
        return float(np.linalg.norm(self.center) + np.linalg.norm(self.radii))

    def _distance(self, other: ConvexSet) -> float | None:
        if not (isinstance(other, Balls) and self.same_cone(other)):
            return None
        more = self.radii - other.radii
        grown = max(np.linalg.norm(np.maximum(x, 0.0)) for x in (more, -more))
        return float(np.linalg.norm(self.center - other.center) + grown)


class Ball(Balls):
    """{ w : |w - center| <= radius }:  sigma(z) = <center, z> + radius |z|.

    Parameters
    ----------
    center : array_like, shape (dim,)
    radius : float, >= 0

    Raises
    ------
    InputError
        If the center is empty, radius < 0, or a number is not finite.

    Examples
    --------
    >>> Ball([0.0, 0.0], 2.0).support([3.0, 4.0])
    10.0
    """

    def __init__(self, center: Any, radius: float) -> None:
        center = entries("center", center)
        self.radius = number("radius", radius, minimum=0.0)
        super().__init__([self.radius], center.size)
        self.center, self.offsets = center, np.append(center, self.radius)

    def features(self, p: cp.Expression) -> Features:
        sizes, constraints = super().features(p)
        return Features([p, *sizes], constraints)

    def gap_along_curve(self, p: np.ndarray, w: np.ndarray, ratio: float) -> CurveGap:
        of_w = ConvexSet.gap_along_curve(self, p, w, ratio)
        distance = ball_arc(p, w - self.center, self.radius)
        return CurveGap(0.0, distance) if ratio * distance**2 < 2 * of_w.gap else of_w

    def factors(self) -> list[ConvexSet]:
        return [self]


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
        if length <= abs(height):
            return w if height >= 0 else np.zeros(self.dim)
        top = 0.5 * (height + length)
        return np.concatenate([[top], top / length * w[1:]])

    def derivative(self, v: np.ndarray) -> np.ndarray:
        height, length = v[0], float(np.linalg.norm(v[1:]))
        if length <= abs(height):
            return np.eye(self.dim) * (height >= 0)
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


def norms_below(p: cp.Expression, sizes: cp.Expression, block: int) -> list[cp.Constraint]:
    """|p_k| <= sizes_k for the blocks p_k of p; linear where the blocks have one entry."""
    import cvxpy as cp

    if block == 1:
        return [p <= sizes, -p <= sizes]
    return [cp.SOC(sizes, cp.reshape(p, (sizes.size, block), order="C"), axis=1)]
