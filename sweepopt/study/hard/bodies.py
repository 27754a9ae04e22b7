"""What velocities.toml names: matrices of small bodies, and what acts on a few unknowns."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from sweepopt.checks import Array
from sweepopt.sets import Balls, Box, ConvexSet, HalfSpace, Orthant, Point, Polyhedron, product

Random = np.random.Generator


def chain(random: Random, n: int) -> Array:
    """A chain of n + 1 springs of different stiffness, held a little everywhere."""
    return rod(random.uniform(0.5, 2.0, n + 1)) + 0.01 * np.eye(n)


def rod(k: Array) -> Array:
    """Springs in a row, held at both ends."""
    return np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)


def spectral(random: Random, low: float, high: float, n: int) -> Array:
    """A full matrix with n eigenvalues from 10^low to 10^high."""
    Q = np.linalg.qr(random.normal(size=(n, n)))[0]
    M = (Q * np.logspace(low, high, n)) @ Q.T
    return 0.5 * (M + M.T)


def nearly_singular(random: Random, least: float, n: int) -> Array:
    """A chain that is held so little that its smallest eigenvalue is `least`."""
    M = chain(random, n)
    return M - (np.linalg.eigvalsh(M)[0] - least) * np.eye(n)


def graded(random: Random, low: float, n: int) -> Array:
    """A rod of cells from 1 to 10^low long, in any order."""
    return rod(1 / random.permutation(np.logspace(low, 0, n + 1)))


def jumping(random: Random, stiff: float, n: int) -> Array:
    """A rod of springs of stiffness 1 and `stiff`."""
    return rod(random.choice([1.0, stiff], n + 1))


def slivers(random: Random, thin: float) -> Array:
    """The Laplacian on a rectangle of 7 by 7 cells cut in triangles, held along its sides.

    Linear elements on right triangles: a sum of Kronecker products of two rods.
    """
    wide = np.tile([1.0, thin], 4)[:7] + 0.1 * thin * random.uniform(size=7)
    mass = np.diag(wide[:-1] + wide[1:]) / 2
    return np.kron(np.eye(6), rod(1 / wide)) + np.kron(rod(np.ones(7)), mass)


# ---- contacts ---------------------------------------------------------------------------------


class Contact(NamedTuple):
    """A set on a few unknowns.

    Attributes
    ----------
    few : ndarray of int
        The unknowns; so many in a row as `block` says have one unit.
    part : callable
        Units of these unknowns -> the set in them.
    edge : ndarray or None
        A force on the edge of the set.
    """

    few: Array
    part: Callable[[Array], ConvexSet]
    edge: Any = None
    block: int = 1


def _some(random: Random, n: int, count: int) -> Array:
    return np.sort(random.permutation(n)[:count])


def between(random: Random, low: float, high: float, count: int) -> Array:
    """Numbers from low to high; by their logarithms if they are of many sizes."""
    if high > 1e3 * low:
        return 10 ** random.uniform(np.log10(low), np.log10(high), count)
    return random.uniform(low, high, count)


def box(
    random: Random, n: int, low: float, high: float, few: int, ends: Sequence[float] = ()
) -> Contact:
    """Friction bounds from low to high, but for those that are given."""
    g = between(random, low, high, few or n)
    if ends:
        g[: len(ends)] = ends
        g = random.permutation(g)
    edge = np.where(np.isfinite(g), g, 1.0) * random.choice([-1.0, 1.0], g.size)
    return Contact(_some(random, n, g.size), lambda units: Box(-units * g, units * g), edge)


def box_twice(random: Random, n: int, *bounds: Any) -> Contact:
    """Four unknowns have two bounds each."""
    few, part, *_ = box(random, n, *bounds)
    return Contact(np.append(few[4:], few[4:8]), part)


def discs(random: Random, n: int, low: float, high: float, count: int) -> Contact:
    """Discs with radii from low to high."""
    radii = between(random, low, high, count)
    few, angle = random.permutation(n)[: 2 * count], random.uniform(0, 6, count)
    edge = (radii * np.array([np.cos(angle), np.sin(angle)])).T.ravel()
    return Contact(few, lambda units: Balls(units[::2] * radii, 2), edge, 2)


def orthant(random: Random, n: int, few: int) -> Contact:
    """One-sided contact."""
    return Contact(_some(random, n, few), lambda _: Orthant(few), np.zeros(few))


def half_space(random: Random, n: int, few: int, bound: float) -> Contact:
    """One row."""
    row = random.normal(size=min(n, few))
    edge = bound * row / (row @ row)
    return Contact(_some(random, n, row.size), lambda units: HalfSpace(row / units, bound), edge)


def polyhedron(random: Random, n: int, rows: int, columns: int, apart: float = 0.0) -> Contact:
    """Any rows; or rows that are one but for small differences."""
    G = random.normal(size=(rows, min(n, columns)))
    if apart:
        G = random.normal(size=columns) + apart * G
    return _rows(random, n, G, np.ones(rows))


def strip(random: Random, n: int, width: float) -> Contact:
    """Two opposite rows; with a negative width there is no point between them."""
    return _rows(random, n, np.outer([1, -1], random.normal(size=n)), [0.5, width - 0.5])


def _rows(random: Random, n: int, G: Array, h: Any) -> Contact:
    return Contact(_some(random, n, G.shape[1]), lambda units: Polyhedron(G / units, h))


def box_and_orthant(random: Random, n: int, first: int, others: int) -> Contact:
    """Friction beside one-sided contact."""
    return Contact(
        _some(random, n, first + others),
        lambda units: product(Box(-units[:first], units[:first]), Orthant(others)),
    )


def point(_: Random, n: int) -> Contact:
    """No friction at all."""
    return Contact(np.arange(n), Point)
