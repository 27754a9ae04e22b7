"""What hard cases are made of: contact, load, units, stiffness and history beside a matrix.

What makes a program hard was listed one by one; solvers fail where two or three of it meet. The
first entry of each table is the usual one; a name stands in one table only.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from sweepopt.sets import Balls, Box, ConvexSet, HalfSpace, Orthant, Point, Polyhedron, product
from sweepopt.study.hard.bodies import Random, chain, spectral

Pair = tuple[Any, Any]


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

    few: np.ndarray
    part: Callable[[np.ndarray], ConvexSet]
    edge: np.ndarray | None = None
    block: int = 1


Draw = Callable[[Random, int], Contact]


def _some(random: Random, n: int, count: int) -> np.ndarray:
    return np.sort(random.permutation(n)[:count])


def _between(random: Random, low: float, high: float, count: int) -> np.ndarray:
    """Numbers from low to high; by their logarithms if they are of many sizes."""
    if high > 1e3 * low:
        return 10 ** random.uniform(np.log10(low), np.log10(high), count)
    return random.uniform(low, high, count)


def _box(low: float, high: float, few: int | None = None, ends: bool = False) -> Draw:
    """Friction bounds from low to high, on all unknowns or a few; some are 0, inf, huge, tiny."""

    def contact(random: Random, n: int) -> Contact:
        g = _between(random, low, high, few or n)
        if ends:
            g[:4] = [0.0, np.inf, 1e12, 1e-12]
            g = random.permutation(g)
        edge = np.where(np.isfinite(g), g, 1.0) * random.choice([-1.0, 1.0], g.size)
        return Contact(_some(random, n, g.size), lambda units: Box(-units * g, units * g), edge)

    return contact


def _box_twice(random: Random, n: int) -> Contact:
    box = _box(0.2, 1.0, 18)(random, n)
    return box._replace(few=np.append(box.few[4:], box.few[4:8]), edge=None)


def _discs(low: float, high: float, count: int) -> Draw:
    def contact(random: Random, n: int) -> Contact:
        radii = _between(random, low, high, count)
        few, angle = random.permutation(n)[: 2 * count], random.uniform(0, 6, count)
        edge = (radii * np.array([np.cos(angle), np.sin(angle)])).T.ravel()
        return Contact(few, lambda units: Balls(units[::2] * radii, 2), edge, 2)

    return contact


def _rows(random: Random, n: int, G: np.ndarray, h: Any = 1.0) -> Contact:
    h = np.broadcast_to(h, len(G))
    return Contact(_some(random, n, G.shape[1]), lambda units: Polyhedron(G / units, h))


def _strip(width: float) -> Draw:
    def contact(random: Random, n: int) -> Contact:
        return _rows(random, n, np.outer([1, -1], random.normal(size=n)), [0.5, width - 0.5])

    return contact


def _half_space(random: Random, n: int) -> Contact:
    row = random.normal(size=min(n, 6))
    edge = 0.3 * row / (row @ row)
    return Contact(_some(random, n, row.size), lambda units: HalfSpace(row / units, 0.3), edge)


def _product(random: Random, n: int) -> Contact:
    few = _some(random, n, 8)
    return Contact(few, lambda units: product(Box(-units[:5], units[:5]), Orthant(3)))


TWICE = "a box that names contacts twice"
CONTACTS: dict[str, Draw] = {
    "a box": _box(0.2, 2.0, 14),
    "a box on all": _box(0.2, 2.0),
    "g from 0 to inf": _box(1e-12, 1e12, 14, ends=True),
    "g from 0 to inf on all": _box(1e-6, 1e2, ends=True),
    "a thin box": _box(1e-14, 1.0),
    "discs": _discs(0.2, 1.0, 5),
    "mixed radii": _discs(1e-12, 1e12, 6),
    "an orthant": lambda random, n: Contact(_some(random, n, 9), lambda _: Orthant(9), np.zeros(9)),
    "a half-space": _half_space,
    "a polyhedron": lambda random, n: _rows(random, n, random.normal(size=(10, min(n, 5)))),
    "rows that differ by 1e-7": lambda random, n: _rows(
        random, n, random.normal(size=4) + 1e-7 * random.normal(size=(3, 4))
    ),
    TWICE: _box_twice,
    "a box beside an orthant": _product,
    "one point": lambda random, n: Contact(np.arange(n), Point),
    "a strip 1e-9 wide": _strip(1e-9),
    "a strip that is missing by 1e-9": _strip(-1e-9),
}
REFUSED = {"": "", "a strip that is missing by 1e-9": "EmptySetError"}
"""Errors that are the right answers."""

# ---- loads ------------------------------------------------------------------------------------


THRESHOLD = "each load is its friction bound, or up to 1e-14 beside it"
WEAKLY = "loads beside their bounds by 1e-3 to 1e-13 of these"


def _weakly(random: Random, count: int) -> np.ndarray:
    return 1 + random.choice([-1.0, 1.0], count) * _between(random, 1e-13, 1e-3, count)


LOADS: dict[str, Any] = {
    "any load": None,
    "another load": None,
    THRESHOLD: lambda random, count: 1 + random.choice([0, 0, 0, 1e-14, -1e-14], count),
    WEAKLY: _weakly,
    "five times the bounds": 5.0,
    "half the bounds": 0.5,
    "0.999 of the bounds": 0.999,
    "exactly the bounds": 1.0,
}
"""Shares of the edge of the set, or how they are drawn; None is any load."""

# ---- units ------------------------------------------------------------------------------------

UNITS: dict[str, tuple[float, float] | None] = {
    "plain": (1.0, 1.0),
    "no units": (1.0, 1.0),
    "forces x 2^40": (1.0, 2.0**40),
    "forces x 2^-40": (1.0, 2.0**-40),
    "lengths x 2^40": (2.0**-40, 1.0),
    "lengths x 2^-40": (2.0**40, 1.0),
    "units from 2^-40 to 2^40": None,
}
"""Units of lengths, and factors of all forces; None if each unknown has another unit."""

# ---- stiffness --------------------------------------------------------------------------------


def _rank_one(random: Random, A: np.ndarray) -> Pair:
    row = random.normal(size=len(A))
    return A, np.outer(row, row)


def _viscosity(random: Random, A: np.ndarray) -> Pair:
    return 10.0 ** -random.integers(2, 13) * A, chain(random, len(A))


STIFFNESS: dict[str, Callable[[Random, np.ndarray], Pair]] = {
    "no B": lambda random, A: (A, None),
    "B = 0": lambda random, A: (A, None),
    "any B": lambda random, A: (A, chain(random, len(A))),
    "B of rank one": _rank_one,
    "B = rho A, rho 1e-6 to 1e6": lambda random, A: (A, 10.0 ** random.integers(-6, 7) * A),
    "B up to 1e10": lambda random, A: (A, spectral(random, np.logspace(0, 10, len(A)))),
    "viscosity 1e-2 to 1e-12": _viscosity,
    "A = 0": lambda random, A: (0 * A, A),
    "all of B 1e10": lambda random, A: (A, 1e10 * chain(random, len(A))),
}
"""A and B, made from a matrix."""

# ---- histories --------------------------------------------------------------------------------


class History(NamedTuple):
    """Steps of a run, and factors over time of loads that are drawn one by one.

    Attributes
    ----------
    displaced : bool
        Whether the run starts at an equilibrium B u0 that is not 0.
    """

    t_end: float
    steps: int
    factors: tuple[Callable[[float], float], ...]
    displaced: bool = False


def constant(t: float) -> float:
    """1 at all times."""
    return 1.0


HISTORIES: dict[str, History] = {
    "one step": History(1.0, 1, (constant,)),
    "four steps": History(4.0, 4, (np.sin,)),
    "a load that stays": History(4.0, 4, (lambda t: min(t, 1.0),)),
    "a sine": History(6.0, 12, (np.sin,)),
    "steps of 1e-10": History(1e-9, 10, (lambda t: 1 + t,)),
    "steps of 10": History(100.0, 10, (np.sin,)),
    "a load that jumps from 1e6 to 1e-6 and back": History(
        6.0, 12, (lambda t: 1e6 ** ((-1) ** int(t)),)
    ),
    "a load that rotates through zero": History(
        6.0, 12, (lambda t: np.sin(t - 0.5) * np.cos(t), lambda t: np.sin(t - 0.5) * np.sin(t))
    ),
    "a corner of C(t) sweeps past": History(6.0, 30, (np.cos, lambda t: np.sin(2 * t))),
    "500 steps, loads that change their signs": History(
        10.0, 500, (lambda t: (-1) ** int(t),), displaced=True
    ),
    "stick and slip at almost every step": History(10.0, 200, (lambda t: np.sin(40 * t),)),
}
