"""Bounded and conic shapes with closed forms: each states its support function and projection."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from sweepopt.checks import HUGE, count, number, symmetric, vector
from sweepopt.errors import EmptySetError, InputError, shown
from sweepopt.secular import secular
from sweepopt.sets.base import (
    ROUNDING,
    Companion,
    ConvexSet,
    Features,
    Sphere,
    binary,
    difference,
    same_array,
)
from sweepopt.sets.curves import ball_arc

if TYPE_CHECKING:
    import cvxpy as cp


MOST = 10**9  # unknowns


class Point(ConvexSet):
    """The single point {p}:  sigma(z) = <p, z>.  Its process is linear.

    Parameters
    ----------
    p : array_like, shape (dim,)

    Raises
    ------
    InputError
        If p is empty or not finite.

    Examples
    --------
    >>> Point([1.0, 2.0]).support([3.0, 4.0])
    11.0
    """

    polyhedral = True
    singleton = True

    def __init__(self, p: Any) -> None:
        self.offsets = entries("p", p)
        self.dim = self.offsets.size

    def support(self, z: np.ndarray) -> float:
        return float(self.offsets @ vector("z", z, self.dim))

    def project(self, w: np.ndarray) -> np.ndarray:
        vector("w", w, self.dim)
        return self.offsets.copy()

    def derivative(self, v: np.ndarray) -> np.ndarray:
        return np.zeros(self.dim)

    def features(self, p: cp.Expression) -> Features:
        return Features([p], [])

    def magnitude(self) -> float:
        return float(np.linalg.norm(self.offsets))

    def _distance(self, other: ConvexSet) -> float | None:
        known = isinstance(other, Point)
        return float(np.linalg.norm(self.offsets - other.offsets)) if known else None

    @property
    def anchor(self) -> np.ndarray:
        return self.offsets

    @property
    def nonsmooth_dim(self) -> int:
        return 0

    def polar(self) -> ConvexSet:
        if self.offsets.any():
            return super().polar()
        return WholeSpace(self.dim)

    def __neg__(self) -> Point:
        return Point(-self.offsets)


class Box(ConvexSet):
    """{ w : lower <= w <= upper }, entries may be infinite:  sigma(z) = sum max(lower z, upper z).

    Parameters
    ----------
    lower, upper : array_like, shape (dim,)

    Raises
    ------
    InputError
        If the bounds are empty, nan or of two lengths.
    EmptySetError
        If lower > upper in an entry.

    Examples
    --------
    >>> Box([-1, -2], [1, 2]).support([1, 1])
    3.0
    """

    polyhedral = True

    def __init__(self, lower: Any, upper: Any) -> None:
        self.lower = entries("lower", lower, finite=False)
        self.upper = vector("upper", upper, self.lower.size, finite=False)
        self.dim = self.lower.size
        bad = (self.lower > self.upper) | (self.lower == np.inf) | (self.upper == -np.inf)
        if bad.any():
            i = int(np.flatnonzero(bad)[0])
            raise EmptySetError(
                f"Box is empty: lower[{i}] = {self.lower[i]:g}, upper[{i}] = {self.upper[i]:g}"
            )
        self._low, self._up = np.isfinite(self.lower), np.isfinite(self.upper)
        both = self._low & self._up
        center = 0.5 * self.lower[both] + 0.5 * self.upper[both]
        halfwidth = 0.5 * self.upper[both] - 0.5 * self.lower[both]
        above, below = self.upper[self._up & ~both], self.lower[self._low & ~both]
        self.offsets = np.concatenate([center, halfwidth, above, below])

    def support(self, z: np.ndarray) -> float:
        z = vector("z", z, self.dim)
        moving = z != 0
        side = np.where(z > 0, self.upper, self.lower)
        return float(side[moving] @ z[moving])

    def project(self, w: np.ndarray) -> np.ndarray:
        return np.minimum(np.maximum(vector("w", w, self.dim), self.lower), self.upper)

    def normal(self, v: np.ndarray) -> np.ndarray:
        return v - np.minimum(np.maximum(v, self.lower), self.upper)

    def gap(self, p: np.ndarray, w: np.ndarray) -> float:
        return float(self._gaps(p[None], w[None])[0, 0])

    def _gaps(self, p: np.ndarray, w: np.ndarray) -> np.ndarray:
        # entry by entry: what cancels cancels to 0.0
        side = np.where(p == 0, 0.0, np.where(p > 0, self.upper, self.lower))
        slack = np.where(p[:, None] == 0, 0.0, side[:, None] - w)
        return np.maximum(np.einsum("jkd,jd->jk", slack, p), 0.0)

    def features(self, p: cp.Expression) -> Features:
        # bounded entries: centre * p + halfwidth * |p|; a one-sided entry allows one sign of p
        import cvxpy as cp

        both = self._low & self._up
        above, below, free = self._up & ~both, self._low & ~both, ~(self._low | self._up)
        y: list[Any] = []
        constraints: list[Any] = []
        if both.any():
            size = cp.Variable(int(both.sum()))
            y += [p[both], size]
            constraints += [p[both] <= size, -p[both] <= size]
        if above.any():
            y.append(p[above])
            constraints.append(p[above] >= 0)
        if below.any():
            y.append(p[below])
            constraints.append(p[below] <= 0)
        if free.any():
            constraints.append(p[free] == 0)
        return Features(y, constraints)

    def steps(self, tau: np.ndarray) -> np.ndarray:
        return tau

    def derivative(self, v: np.ndarray) -> np.ndarray:
        return ((v >= self.lower) & (v <= self.upper)).astype(float)

    def within(self, center: np.ndarray, reach: np.ndarray) -> Box:
        # finite bounds only: an infinite one is part of the cone
        lower = np.maximum(self.lower, np.minimum(center - reach, self.upper))
        upper = np.minimum(self.upper, np.maximum(center + reach, self.lower))
        return Box(np.where(self._low, lower, self.lower), np.where(self._up, upper, self.upper))

    def same_cone(self, other: ConvexSet) -> bool:
        return (
            isinstance(other, Box)
            and same_array(self._low, other._low)
            and same_array(self._up, other._up)
        )

    def magnitude(self) -> float:
        return float(np.linalg.norm(np.maximum(abs(self.lower), abs(self.upper))))

    def _distance(self, other: ConvexSet) -> float | None:
        if not isinstance(other, Box):
            return None
        below, above = difference(other.lower, self.lower), difference(self.upper, other.upper)
        return max(  # each the largest distance of a point of one box to the other box
            float(np.linalg.norm(np.maximum(0.0, np.maximum(below, above)))),
            float(np.linalg.norm(np.maximum(0.0, np.maximum(-below, -above)))),
        )

    def rows(self) -> tuple[Any, np.ndarray] | None:
        above, below = np.isfinite(self.upper), np.isfinite(self.lower)
        identity = sp.eye_array(self.dim, format="csr") if self.dim > 100 else np.eye(self.dim)
        stack = sp.vstack if self.dim > 100 else np.vstack
        G = stack([identity[above], -identity[below]])
        return G, np.concatenate([self.upper[above], -self.lower[below]])

    def polar(self) -> ConvexSet:
        ends = np.concatenate([self.lower, self.upper])
        if not np.all((ends == 0) | np.isinf(ends)):
            return super().polar()
        # componentwise: {0} <-> R, [0, inf) <-> (-inf, 0]
        return Box(np.where(self._low, -np.inf, 0.0), np.where(self._up, np.inf, 0.0))

    def __neg__(self) -> Box:
        return Box(-self.upper, -self.lower)

    def __add__(self, other: Any) -> Any:
        if isinstance(other, Box) and other.dim == self.dim:
            return Box(self.lower + other.lower, self.upper + other.upper)
        return super().__add__(other)

    __radd__ = __add__

    def scaled(self, factor: float) -> Box:
        """factor * C for factor > 0: nothing is divided by it, however small it gets."""
        return Box(factor * self.lower, factor * self.upper)

    def __and__(self, other: Any) -> Any:
        if isinstance(other, Box) and other.dim == self.dim:
            return Box(np.maximum(self.lower, other.lower), np.minimum(self.upper, other.upper))
        return super().__and__(other)


class Orthant(Box):
    """The cone { w : w >= 0 }:  sigma is the indicator of { z <= 0 }.

    Parameters
    ----------
    dim : int

    Raises
    ------
    InputError
        If dim is not a positive whole number.

    Examples
    --------
    >>> Orthant(2).project([1.0, -1.0])
    array([1., 0.])
    """

    def __init__(self, dim: int) -> None:
        dim = dimension(dim)
        super().__init__(np.zeros(dim), np.full(dim, np.inf))


class WholeSpace(Box):
    """R^dim:  sigma(z) = 0 at z = 0 and +inf elsewhere; a body that it governs never moves.

    Parameters
    ----------
    dim : int

    Raises
    ------
    InputError
        If dim is not a positive whole number.

    Examples
    --------
    >>> WholeSpace(2).support([0.0, 1.0])
    inf
    """

    def __init__(self, dim: int) -> None:
        dim = dimension(dim)
        super().__init__(np.full(dim, -np.inf), np.full(dim, np.inf))


class Ball(ConvexSet):
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
        self.center = entries("center", center)
        self.radius = number("radius", radius, minimum=0.0)
        self.dim = self.center.size
        self.offsets = np.append(self.center, self.radius)
        self.polyhedral = self.dim == 1

    def support(self, z: np.ndarray) -> float:
        z = vector("z", z, self.dim)
        return float(self.center @ z + self.radius * np.linalg.norm(z))

    def derivative(self, v: np.ndarray) -> np.ndarray:
        return _ball_derivative(v - self.center, self.radius)

    def project(self, w: np.ndarray) -> np.ndarray:
        w = vector("w", w, self.dim)
        arm = w - self.center
        length = float(np.linalg.norm(arm))
        return w if length <= self.radius else self.center + self.radius / length * arm

    def companion(self, p: np.ndarray, w: np.ndarray, ratio: float) -> Companion:
        given = super().companion(p, w, ratio)
        away = ball_arc(p, w - self.center, self.radius)
        return Companion(0.0, away) if ratio * away**2 < 2 * given.gap else given

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        size = cp.Variable(1)
        return Features([p, size], _norms_below(p, size, self.dim))

    def within(self, center: np.ndarray, reach: np.ndarray) -> Ball:
        farthest = float(np.linalg.norm(np.abs(center - self.center) + reach))
        return Ball(self.center, min(self.radius, farthest))

    def magnitude(self) -> float:
        return float(np.linalg.norm(self.center) + self.radius)

    def _distance(self, other: ConvexSet) -> float | None:
        if not isinstance(other, Ball):
            return None
        return float(np.linalg.norm(self.center - other.center) + abs(self.radius - other.radius))

    @property
    def sphere(self) -> Sphere:
        return Sphere(self.center, self.radius)


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

    def __init__(self, radii: Any, dim: int) -> None:
        self.radii = self.offsets = entries("radii", radii)
        if (self.radii < 0).any():
            i = int(np.flatnonzero(self.radii < 0)[0])
            raise InputError(f"radii[{i}] must be >= 0, got {self.radii[i]:g}")
        self.block = dimension(dim)
        self.dim = self.block * self.radii.size
        self.polyhedral = self.block == 1

    def support(self, z: np.ndarray) -> float:
        return float(self.radii @ np.linalg.norm(self._blocks("z", z), axis=1))

    def project(self, w: np.ndarray) -> np.ndarray:
        blocks = self._blocks("w", w)
        lengths = np.linalg.norm(blocks, axis=1)
        outside = lengths > self.radii
        factor = np.ones_like(lengths)
        factor[outside] = self.radii[outside] / lengths[outside]
        return (factor[:, None] * blocks).ravel()

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        sizes = cp.Variable(self.radii.size)
        return Features([sizes], _norms_below(p, sizes, self.block))

    def companion(self, p: np.ndarray, w: np.ndarray, ratio: float) -> Companion:
        each = [
            Ball(np.zeros(self.block), radius).companion(directions, points, ratio)
            for radius, directions, points in zip(
                self.radii,
                p.reshape(3, -1, self.block).swapaxes(0, 1),
                w.reshape(len(w), -1, self.block).swapaxes(0, 1),
                strict=True,
            )
        ]
        gaps, away = np.array(each).T
        return Companion(float(gaps.sum()), float(np.linalg.norm(away)))

    def within(self, center: np.ndarray, reach: np.ndarray) -> Balls:
        farthest = np.linalg.norm((np.abs(center) + reach).reshape(-1, self.block), axis=1)
        return Balls(np.minimum(self.radii, farthest), self.block)

    def steps(self, tau: np.ndarray) -> np.ndarray:
        return np.repeat(tau.reshape(-1, self.block).mean(axis=1), self.block)

    def derivative(self, v: np.ndarray) -> np.ndarray:
        arms = v.reshape(-1, self.block)
        return scipy.linalg.block_diag(*map(_ball_derivative, arms, self.radii))

    def same_cone(self, other: ConvexSet) -> bool:
        return isinstance(other, Balls) and (self.block, self.dim) == (other.block, other.dim)

    def magnitude(self) -> float:
        return float(np.linalg.norm(self.radii))

    def _distance(self, other: ConvexSet) -> float | None:
        if not self.same_cone(other):
            return None
        more = self.offsets - other.offsets
        return float(max(np.linalg.norm(np.maximum(x, 0.0)) for x in (more, -more)))

    @property
    def sphere(self) -> Sphere | None:
        one = self.radii.size == 1
        return Sphere(np.zeros(self.dim), float(self.radii[0])) if one else None

    def _blocks(self, name: str, z: Any) -> np.ndarray:
        return vector(name, z, self.dim).reshape(-1, self.block)


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
        self.center = entries("center", center)
        self.dim = self.center.size
        full = symmetric("shape", shape, self.dim)
        self.shape = full if isinstance(full, np.ndarray) else full.toarray()
        self._squares, self._axes = np.linalg.eigh(self.shape)  # semi-axes squared, directions
        if self._squares[0] <= max(1e-14 * self._squares[-1], 1 / HUGE):
            raise InputError(
                f"shape must be positive definite, its smallest eigenvalue is {self._squares[0]:g}"
            )
        self._unit = binary(np.sqrt(self._squares[-1]))
        self.offsets = np.append(self.center, self._unit)

    def support(self, z: np.ndarray) -> float:
        z = vector("z", z, self.dim)
        return float(self.center @ z + np.sqrt(self._squares @ (self._axes.T @ z) ** 2))

    def project(self, w: np.ndarray) -> np.ndarray:
        # x_i = e_i d_i / (e_i + lam)
        w = vector("w", w, self.dim)
        d, e = self._axes.T @ (w - self.center), self._squares
        lam = self._multiplier(d)
        return w if lam is None else self.center + self._axes @ (e * d / (e + lam))

    def derivative(self, v: np.ndarray) -> np.ndarray:
        d, e = self._axes.T @ (v - self.center), self._squares
        lam = self._multiplier(d)
        if lam is None:
            return np.eye(self.dim)
        fall = e * d / (e + lam) ** 2  # -dx/dlam
        inner = np.diag(e / (e + lam)) - np.outer(fall, fall) / (fall @ (d / (e + lam)))
        return self._axes @ inner @ self._axes.T

    def _multiplier(self, d: np.ndarray) -> float | None:
        """The root lam >= 0 of sum e_i d_i^2 / (e_i + lam)^2 = 1; None inside."""
        e = self._squares
        a = d / np.sqrt(e)
        return None if a @ a <= 1 else secular(a, 1 / e, 1.0)

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        size = cp.Variable(1)
        root = np.sqrt(self._squares)[:, None] / self._unit * self._axes.T
        return Features([p, size], _norms_below(root @ p, size, self.dim))

    def same_cone(self, other: ConvexSet) -> bool:
        return isinstance(other, Ellipsoid) and same_array(self.shape, other.shape)

    def magnitude(self) -> float:
        return float(np.linalg.norm(self.center) + np.sqrt(self._squares[-1]))

    def _distance(self, other: ConvexSet) -> float | None:
        if not isinstance(other, Ellipsoid):
            return None
        # | |R z| - |S z| | <= |(R - S) z| for the symmetric roots R, S of the shapes
        R, S = ((E._axes * np.sqrt(E._squares)) @ E._axes.T for E in (self, other))
        apart = 0.0 if self.same_cone(other) else np.linalg.norm(R - S, 2)
        return float(np.linalg.norm(self.center - other.center) + apart)


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
        return Features([], _norms_below(p[1:], -p[:1], self.dim - 1))

    def polar(self) -> ConvexSet:
        return -self


def entries(name: str, value: Any, finite: bool = True) -> np.ndarray:
    """A float vector with at least one entry: no set lives in a space of dim 0."""
    result = vector(name, value, finite=finite)
    if not result.size:
        raise InputError(f"{name} must have at least one entry")
    return result


def dimension(dim: Any) -> int:
    """A positive whole number of unknowns."""
    found = count("dim", dim)
    if found > MOST:
        raise InputError(f"dim is {shown(found)}, more than {MOST:.0e}; no vector fits in memory")
    return found


def _ball_derivative(arm: np.ndarray, radius: float) -> np.ndarray:
    """Derivative of the projection on a ball around 0: I inside, r/|a| (I - n n^T) outside."""
    length = float(np.linalg.norm(arm))
    if length <= radius:
        return np.eye(arm.size)
    n = arm / length
    return radius / length * (np.eye(arm.size) - np.outer(n, n))


def _norms_below(p: cp.Expression, sizes: cp.Expression, block: int) -> list[cp.Constraint]:
    """|p_k| <= sizes_k for the blocks p_k of p; linear where the blocks have one entry."""
    import cvxpy as cp

    if block == 1:
        return [p <= sizes, -p <= sizes]
    return [cp.SOC(sizes, cp.reshape(p, (sizes.size, block), order="C"), axis=1)]
