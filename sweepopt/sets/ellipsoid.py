"""Ellipsoids, projected through the secular equation in their axes."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.checks import HUGE, entries, symmetric, vector
from sweepopt.errors import InputError
from sweepopt.linalg import Precise, dense
from sweepopt.sets.balls import norms_below
from sweepopt.sets.base import RANK, ConvexSet, Features, NormalPair, binary, same_array

if TYPE_CHECKING:
    import cvxpy as cp

TINY = np.finfo(float).tiny  # 0 / TINY = 0
STEPS = 100  # of Newton's method, a bound that is not met: each change of regime takes a few


class Ellipsoid(ConvexSet):
    """{ w : (w-c)^T shape^-1 (w-c) <= 1 }:  sigma(z) = <c, z> + sqrt(<shape z, z>).

    Parameters
    ----------
    center : array_like, shape (dim,)
    shape : array_like, shape (dim, dim)
        Symmetric positive definite.

    Raises
    ------
    InputError
        If shape is not symmetric positive definite, or the center is empty.

    Examples
    --------
    >>> Ellipsoid([0.0, 0.0], [[4.0, 0.0], [0.0, 1.0]]).support([1.0, 0.0])
    2.0
    """

    def __init__(self, center: Any, shape: Any) -> None:
        center = entries("center", center)
        shape = dense(symmetric("shape", shape, center.size))
        squares = np.linalg.eigvalsh(shape)
        if squares[0] <= max(1e-14 * squares[-1], 1 / HUGE):
            raise InputError(
                f"shape must be positive definite, its smallest eigenvalue is {squares[0]:g}"
            )
        # by a factor, as eigenvectors round the short axes most
        self._set(center, 1.0, np.linalg.cholesky(shape).T)
        self._shape = shape

    def _set(self, center: np.ndarray, radius: float, root: np.ndarray) -> None:
        """{ center + radius root^T s : |s| <= 1 }."""
        self.center, self.dim, self.matrix = center, center.size, root
        self.root = radius * root
        _, semiaxes, axes = np.linalg.svd(root)
        semiaxes[semiaxes <= RANK * semiaxes[0]] = 0.0
        self._squares, self._axes = np.zeros(self.dim), axes.T
        self._squares[: semiaxes.size] = (radius * semiaxes) ** 2
        self._unit = binary(semiaxes[0])
        self.offsets = np.append(center, radius * self._unit)

    @cached_property
    def _times_shape(self) -> Precise:
        return Precise(self._shape)

    def support(self, z: np.ndarray) -> float:
        z = vector("z", z, self.dim)
        return float(self.center @ z + np.linalg.norm(self.root @ z))

    def project(self, w: np.ndarray) -> np.ndarray:
        # x_i = e_i d_i / (e_i + lam)
        w = vector("w", w, self.dim)
        d, e = self._axes.T @ (w - self.center), self._squares
        lam = self._memo(d, self._multiplier)
        if not lam and e.all():
            return w
        return self.center + self._axes @ (e / np.maximum(e + lam, TINY) * d)

    def derivative(self, v: np.ndarray) -> np.ndarray:
        d, e = self._axes.T @ (v - self.center), self._squares
        lam = self._memo(d, self._multiplier)
        inner = np.diag(e / np.maximum(e + lam, TINY))
        if lam:
            fall = e * d / (e + lam) ** 2  # -dx/dlam
            inner -= np.outer(fall, fall) / (fall @ (d / (e + lam)))
        return self._axes @ inner @ self._axes.T

    def _multiplier(self, d: np.ndarray) -> float:
        """The root lam > 0 of |x(lam)| = 1,  x_i = sqrt(e_i) d_i / (e_i + lam);  0 inside.

        1 / |x(lam)| is concave and grows, so that Newton's method from lam = 0 rises to the root
        and never passes it, whatever the e_i (J. More, D. Sorensen, Computing a trust region step,
        SIAM J. Sci. Stat. Comput. 4(3), 1983).
        """
        real = self._squares > 0
        e, lam = self._squares[real], 0.0
        a = d[real] / np.sqrt(e)
        if a @ a <= 1:
            return 0.0
        for _ in range(STEPS):
            falling = 1 + lam / e
            x = a / falling
            square = float(x @ x)
            step = (np.sqrt(square) - 1) * square / float(x @ (x / e / falling))
            lam += max(float(step), 0.0)  # a step back is rounding
            if step <= 1e-15 * lam:
                break
        return lam

    def normal_pair(self, p: np.ndarray, w: np.ndarray, tau: np.ndarray) -> NormalPair | None:
        pair = super().normal_pair(p, w, tau)
        if pair is None or not pair.p.any():
            return pair
        # the point with this normal by the shape itself: axes and roots are rounded, and short axes
        # beside long ones are lost in plain products
        arm = self._times_shape(pair.p)
        return pair._replace(w=self.center + arm / np.sqrt(pair.p @ arm))

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        size = cp.Variable(1)
        return Features(
            [p, size], norms_below(self.matrix / self._unit @ p, size, len(self.matrix))
        )

    def same_cone(self, other: ConvexSet) -> bool:
        return isinstance(other, Ellipsoid) and same_array(self.matrix, other.matrix)

    def magnitude(self) -> float:
        return float(np.linalg.norm(self.center) + np.sqrt(self._squares.max()))

    def _distance(self, other: ConvexSet) -> float | None:
        if not isinstance(other, Ellipsoid):
            return None
        # | |R z| - |S z| | <= |(R - S) z| for the symmetric roots R, S of the shapes
        R, S = ((E._axes * np.sqrt(E._squares)) @ E._axes.T for E in (self, other))
        return float(np.linalg.norm(self.center - other.center) + np.linalg.norm(R - S, 2))


class BallImage(Ellipsoid):
    """{ center + radius root^T s : |s| <= 1 }, flat where the root has no full rank."""

    def __init__(self, center: np.ndarray, radius: float, root: np.ndarray) -> None:
        self._set(center, radius, root)

    def normal_pair(self, p: np.ndarray, w: np.ndarray, tau: np.ndarray) -> NormalPair | None:
        return ConvexSet.normal_pair(self, p, w, tau)
