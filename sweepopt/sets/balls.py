"""Sets that a Euclidean norm bounds: balls, their products and images, the second-order cone.

Ellipsoids are projected on through the secular equation in their axes.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.checks import HUGE, Array, dimension, entries, number, symmetric
from sweepopt.errors import InputError
from sweepopt.linalg import Precise, dense, row_lengths
from sweepopt.sets.base import (
    RANK,
    ROUNDING,
    TINY,
    Blocks,
    ConvexSet,
    Features,
    Form,
    Halfspaces,
    NormalPair,
    binary,
    neighbours,
    once,
)
from sweepopt.sets.curves import THIRDS, basis, gauss, products, to_bernstein
from sweepopt.sets.shapes import Box, Point

if TYPE_CHECKING:
    import cvxpy as cp


# Semiaxes of images that are projected on by their balls, which have one unit for all of them. Of
# 2,300 random images with columns of 1e-4 to 1e4 3 were StepErrors with 1e2, 4 with 1e3, 6 with it.
EVEN = 1e4

DEGREES = np.add.outer(np.arange(4), np.arange(4))[..., None]
SQUARE = 7 * products(3, 3)[..., None] * (np.arange(7) == DEGREES)
"""From products of the Bernstein coefficients of a cubic to those of its square."""
SIX, OF_SIX = gauss(6)  # points and weights, exact to degree 11: size, |p|^2 and 1 / l have 10


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

    center: Array | float = 0.0
    sharp_gaps = differentiable = True

    def __init__(self, radii: Any, dim: int) -> None:
        self.radii = self.offsets = entries("radii", radii)
        if (self.radii < 0).any():
            i = int(np.flatnonzero(self.radii < 0)[0])
            raise InputError(f"radii[{i}] must be >= 0, got {self.radii[i]:g}")
        self.block = dimension(dim)
        self.dim = self.block * self.radii.size
        self.polyhedral = self.block == 1

    def _arms(self, w: Array) -> Array:
        """From the centres, one row for each ball."""
        return (w - self.center).reshape(-1, self.block)

    def support(self, z: Array) -> float:
        return float(np.sum(self.center * z) + self.radii @ row_lengths(z.reshape(-1, self.block)))

    def project(self, w: Array) -> Array:
        return self.project_rows(w[None])[0]

    def project_rows(self, rows: Array) -> Array:
        arms = self._arms(rows).reshape(len(rows), -1, self.block)
        sizes = row_lengths(arms)
        outside = sizes > self.radii
        if not outside.any():
            return rows
        factor = np.divide(self.radii, sizes, out=np.ones_like(sizes), where=outside)
        moved = self.center + (factor[..., None] * arms).reshape(rows.shape)
        return np.where(outside.any(axis=1)[:, None], moved, rows)

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        sizes = cp.Variable(self.radii.size)
        return Features([sizes], norms_below(p, sizes, self.block))

    def gaps_along_curves(self, p: Array, w: Array, sizes: Array) -> Array:
        """By 2 |p| <= |p|^2 / l + l with a straight l > 0, that of |p| at both ends.

        1 / l is below the cubic through its values at 0, 1/2 (twice) and 1, which is off by x (1 -
        x) (x - 1/2)^2 (l(1) - l(0))^4 / (l(0) l(1/2)^2 l(1) l(x)).
        """
        shift = p @ np.broadcast_to(self.center, self.dim)  # of sums, for their rounding
        p, arms = self._curves(p), self._curves(w - self.center)
        weights = products(2, 3) * sizes[:, None]
        lengths = row_lengths(p)
        convex = np.einsum("mjk,mbj->mb", weights, lengths)
        size, squares = sizes @ basis(3, SIX).T, row_lengths(basis(2, SIX) @ p) ** 2
        with np.errstate(all="ignore"):  # where p vanishes |p_k| are left
            first, last = lengths[..., :1], lengths[..., 2:]
            line = first + SIX * (last - first)
            off = SIX * (1 - SIX) * (SIX - 0.5) ** 2 * (last - first) ** 4
            off /= first * (0.5 * (first + last)) ** 2 * last
            sharp = 0.5 * (squares * (1 + off) / line + line) @ (OF_SIX * size)[..., None]
        along = (weights[:, None] * (p @ np.swapaxes(arms, 2, 3))).sum(axis=(2, 3))
        gaps = np.maximum(self.radii * np.fmin(convex, sharp[..., 0]) - along, 0.0).sum(axis=1)
        rounding = convex @ self.radii + (np.abs(shift) * weights.sum(axis=2)).sum(axis=1)
        return gaps + ROUNDING * rounding

    def curves_within(self, curves: Array, sizes: Array) -> Array:
        """Those of projected coefficients, or through four projected points, whichever are nearer.

        Beside a circle curves through points are off by order four in their length, the others by
        order two; where a curve enters a ball, curves through points go further off. They are made
        shorter until radius^2 size^2 - |size w|^2 has no coefficient below 0.
        """
        size, at = sizes[..., None], basis(3, THIRDS)
        near = super().curves_within(curves, sizes) - self.center
        aim = size * (curves - self.center)
        with np.errstate(all="ignore"):  # where sizes vanish these are not better
            points = self.center + (at @ aim) / (at @ size)
            points = self.project_rows(points.reshape(-1, self.dim)).reshape(curves.shape)
            arms = self._curves(to_bernstein(THIRDS) @ ((at @ size) * (points - self.center)))
            room = (
                np.tensordot(size * sizes[:, None], SQUARE, 2)[:, None] * self.radii[:, None] ** 2
            )
            squares = np.tensordot(arms @ np.swapaxes(arms, 2, 3), SQUARE, 2)
            share = np.where(squares > 0, room / squares, 1.0).min(axis=2).clip(0, 1)
            arms *= np.sqrt(share)[..., None, None]
        both = np.stack([self._curves(size * near), arms])
        off = both - self._curves(aim)
        squares = (products(3, 3) * (off @ np.swapaxes(off, 3, 4))).sum(axis=(3, 4))
        arms = np.where((squares[1] < squares[0])[..., None, None], *both[::-1])
        arms = np.moveaxis(arms, 1, 2).reshape(curves.shape)
        return self.center + np.divide(arms, size, out=near, where=size > 0)

    def _curves(self, x: Array) -> Array:
        """Coefficients of each ball, shape (m, balls, k, block)."""
        return np.moveaxis(x.reshape(*x.shape[:2], -1, self.block), 2, 1)

    def blocks(self, v: Array) -> list[Blocks]:
        """I in a ball, r/|a| (I - n n^T) outside of it, n = a/|a|."""
        arms = self._arms(v)
        sizes = row_lengths(arms)
        out = sizes > self.radii
        # the balls last: products of few entries run along them
        n = np.divide(arms.T, sizes, out=np.zeros(arms.T.shape), where=out)
        share = np.divide(self.radii, sizes, out=np.ones_like(sizes), where=out)
        D = share * (np.eye(self.block)[:, :, None] - n[:, None] * n)
        return [neighbours(D.transpose(2, 0, 1))]

    def is_inside(self, w: Array, distance: float) -> bool:
        short = self.radii - row_lengths(self._arms(w))
        return bool((short >= distance + ROUNDING * (np.abs(w).max() + self.radii)).all())

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
        n = center.size
        own = {"center": center, "radii": np.array([self.radius]), "dim": n, "block": n}
        vars(self).update(own, offsets=np.append(center, self.radius), polyhedral=n == 1)

    def features(self, p: cp.Expression) -> Features:
        sizes, constraints = super().features(p)
        return Features([p, *sizes], constraints)

    def support(self, z: Array) -> float:
        return float(z.dot(self.center) + self.radius * math.sqrt(z.dot(z)))

    def project(self, w: Array) -> Array:
        # as `project_rows`, in a tenth of the time: composed sets ask it ten times a step
        arm = w - self.center
        size = math.sqrt(arm.dot(arm))
        return w if size <= self.radius else self.center + self.radius / size * arm

    def blocks(self, v: Array) -> list[Blocks]:
        arm, D = v - self.center, np.eye(self.dim)
        size = math.sqrt(arm.dot(arm))
        if size > self.radius:
            n = arm / size
            D = self.radius / size * (D - n[:, None] * n)
        return [neighbours(D[None])]

    @property
    def shift_sizes(self) -> Array:
        return np.abs(self.center)

    def factors(self) -> list[ConvexSet]:
        return [self]


def features_of_balls(p: cp.Expression, dim: int) -> Features:
    """Of a product of balls in R^dim, one after the other: two expressions, however many."""
    import cvxpy as cp

    m = p.size // dim
    sizes = cp.Variable(m)
    each = cp.hstack([cp.reshape(p, (m, dim), order="C"), cp.reshape(sizes, (m, 1), order="C")])
    return Features([cp.vec(each, order="C")], norms_below(p, sizes, dim))


class SecondOrderCone(ConvexSet):
    """{ w : |w[1:]| <= slope w[0] }: sigma is the indicator of its polar cone.

    Several slopes make the product of as many cones, one after the other in the vector. Shifted
    along its axis it is the elastic domain of isotropic hardening.

    Parameters
    ----------
    dim : int
        Dimension of each cone.
    slopes : array_like, shape (m,), or float, > 0

    Raises
    ------
    InputError
        If dim is not a positive whole number, or a slope not positive and finite.

    Examples
    --------
    >>> SecondOrderCone(2).project([0.0, 2.0])
    array([1., 1.])
    """

    offsets, fixed = np.zeros(0), ("slopes",)

    def __init__(self, dim: int, slopes: Any = 1.0) -> None:
        self.block = dimension(dim)
        self.slopes = entries("slopes", [slopes] if np.ndim(slopes) == 0 else slopes)
        if not (self.slopes > 0).all():
            raise InputError(f"slopes must be > 0, got {self.slopes.min():g}")
        self.dim = self.block * self.slopes.size
        self.polyhedral = self.block <= 2

    def _split(self, w: Array) -> tuple[Array, Array, Array]:
        """Heights over the apex, arms from the axis and their lengths, one for each cone."""
        rows = w.reshape(-1, self.block)
        return rows[:, 0], rows[:, 1:], row_lengths(rows[:, 1:])

    def support(self, z: Array) -> float:
        height, _, length = self._split(z)
        excess = height + self.slopes * length
        inside = excess <= ROUNDING * (np.abs(height) + self.slopes * length)
        return 0.0 if inside.all() else float("inf")

    def normal(self, v: Array) -> Array:
        # the polar cone is that of the slopes 1 / slopes, turned around
        return 0.0 - self._onto(-v, 1 / self.slopes)

    def project(self, w: Array) -> Array:
        return self._onto(w, self.slopes)

    def _onto(self, w: Array, slopes: Array) -> Array:
        height, arms, length = self._split(w)
        beside = length > slopes * height
        if not beside.any():
            return w
        top = np.maximum((height + slopes * length) / (1 + slopes**2), 0.0)
        along = np.divide(slopes * top, length, out=np.zeros_like(length), where=length > 0)
        moved = np.column_stack([top, along[:, None] * arms])
        return np.where(beside[:, None], moved, w.reshape(-1, self.block)).ravel()

    def blocks(self, v: Array) -> list[Blocks]:
        height, arms, length = self._split(v)
        k, one = self.slopes, np.eye(self.block)
        beside = length > k * height
        out = beside & (k * length > -height)
        # top = <a, w> for a = (1, k n) / (1 + k^2), and w goes to top (1, k n)
        n = np.divide(arms.T, length, out=np.zeros(arms.T.shape), where=out).T
        ray = np.column_stack([np.ones_like(k), k[:, None] * n])
        turn = np.divide(k * (height + k * length), length, out=np.zeros_like(k), where=out)
        D = ray[:, :, None] * ray[:, None]
        D[:, 1:, 1:] += turn[:, None, None] * (one[1:, 1:] - n[:, :, None] * n[:, None])
        D *= (out / (1 + k**2))[:, None, None]
        return [neighbours(np.where(beside[:, None, None], D, one))]

    def exchange(self, diagonal: Array) -> Array:
        each = diagonal.reshape(-1, self.block)
        axis, k = each[:, 0], self.slopes
        # <H z, z> = x (|z[1:]|^2 - (z[0] / k)^2)
        x = (axis - each[:, -1]) / (1 + k**-2)
        return np.column_stack([-x / k**2, *[x] * (self.block - 1)]).ravel()

    def exchanges(self, force: Array) -> bool:
        return bool((force[:: self.block] >= 0).all())

    def factors(self) -> list[ConvexSet]:
        if self.slopes.size == 1:
            return [self]
        return [SecondOrderCone(self.block, slope) for slope in self.slopes]

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        if self.block == 1:
            return Features([], [p <= 0])
        axis = np.arange(self.dim) % self.block == 0
        arms = cp.multiply(np.repeat(self.slopes, self.block - 1), p[np.flatnonzero(~axis)])
        return Features([], norms_below(arms, -p[np.flatnonzero(axis)], self.block - 1))

    def magnitude(self) -> float:
        return float("inf")

    def polar(self) -> ConvexSet:
        return -SecondOrderCone(self.block, 1 / self.slopes)


def norms_below(p: cp.Expression, sizes: cp.Expression, block: int) -> list[cp.Constraint]:
    """|p_k| <= sizes_k for the blocks p_k of p; linear where the blocks have one entry."""
    import cvxpy as cp

    if block == 1:
        return [p <= sizes, -p <= sizes]
    return [cp.SOC(sizes, cp.reshape(p, (sizes.size, block), order="C"), axis=1)]


@once
def _axes(root: Array) -> tuple[Array, Array]:
    """The semiaxes of { root^T s : |s| <= 1 } that are no rounding, and the rows of axes."""
    _, semiaxes, axes = np.linalg.svd(root)
    semiaxes[semiaxes <= RANK * semiaxes[0]] = 0.0
    return semiaxes, axes


@once
def _is_even(root: Array) -> bool:
    """Whether the short semiaxes are not lost beside the long ones."""
    semiaxes, _ = _axes(root)
    lengths = semiaxes[semiaxes > 0]
    return lengths.size > 0 and bool(lengths[0] <= EVEN * lengths[-1])


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

    fixed, differentiable = ("matrix",), True
    _shape: Array | None = None

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

    def _set(self, center: Array, radius: float, root: Array) -> None:
        """{ center + radius root^T s : |s| <= 1 }."""
        self.center, self.dim, self.matrix = center, center.size, root
        self.root = radius * root
        semiaxes, axes = _axes(root)
        self._squares, self._axes = np.zeros(self.dim), axes.T
        self._squares[: semiaxes.size] = (radius * semiaxes) ** 2
        self._unit = binary(semiaxes[0])
        self.offsets = np.append(center, radius * self._unit)

    @property
    def shift_sizes(self) -> Array:
        return np.full(self.dim, np.linalg.norm(self.center))  # axes mix the entries

    @cached_property
    def _times_shape(self) -> Precise:
        return Precise(self._shape)

    def support(self, z: Array) -> float:
        return float(self.center @ z + np.linalg.norm(self.root @ z))

    def support_rows(self, rows: Array) -> Array:
        sigma: Array = rows @ self.center + row_lengths(rows @ self.root.T)
        return sigma

    def project(self, w: Array) -> Array:
        # x_i = e_i d_i / (e_i + lam)
        d, e = self._axes.T @ (w - self.center), self._squares
        lam = self._memo(d, self._multiplier)
        if not lam and e.all():
            return w
        return self.center + self._axes @ (e / np.maximum(e + lam, TINY) * d)

    def derivative(self, v: Array) -> Array:
        d, e = self._axes.T @ (v - self.center), self._squares
        lam = self._memo(d, self._multiplier)
        inner = np.diag(e / np.maximum(e + lam, TINY))
        if lam:
            fall = e * d / (e + lam) ** 2  # -dx/dlam
            inner -= np.outer(fall, fall) / (fall @ (d / (e + lam)))
        return self._axes @ inner @ self._axes.T

    def _multiplier(self, d: Array) -> float:
        """The root lam > 0 of |x(lam)| = 1,  x_i = sqrt(e_i) d_i / (e_i + lam);  0 inside.

        1 / |x(lam)| is concave and grows, so that Newton's method from lam = 0 rises to the root
        and never passes it, whatever the e_i (J. More, D. Sorensen, Computing a trust region step,
        SIAM J. Sci. Stat. Comput. 4(3), 1983). Its error is then 3/2 step^2 / lam at most.
        """
        real = self._squares > 0
        e, lam = self._squares[real], 0.0
        a = d[real] / np.sqrt(e)
        if a @ a <= 1:
            return 0.0
        step = np.inf
        while step > 1e-8 * lam:
            falling = 1 + lam / e
            x = a / falling
            square = float(x @ x)
            step = float(np.sqrt(square) - 1) * square / float(x @ (x / e / falling))
            lam += max(step, 0.0)  # a step back is rounding
        return lam

    def normal_pair(self, p: Array, w: Array, tau: Array) -> NormalPair | None:
        pair = super().normal_pair(p, w, tau)
        if pair is None or self._shape is None or not pair.p.any():
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

    def magnitude(self) -> float:
        return float(np.linalg.norm(self.center) + np.sqrt(self._squares.max()))


class BallImage(Ellipsoid):
    """v + M s for s in a ball, flat where M has no full rank."""

    def __init__(self, v: Array | float, M: Array, ball: Ball) -> None:
        self._set(v + M @ ball.center, ball.radius, M.T)
        self._v, self._ball = v, ball

    def form(self) -> Form:
        """By the ball, which is projected on in a tenth of the time, where M is not too uneven."""
        if not _is_even(self.matrix):
            return super().form()
        form = Form.alone(self._ball).image(self.matrix.T)
        return Form.added(form, Point(self._v).form()) if np.any(self._v) else form
