"""Hard cases drawn by chance: a matrix, units, a set, a load and a history, each easy or hard.

What makes a program hard was listed one by one; solvers fail where two or three of it meet.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from sweepopt.loads import Separable
from sweepopt.problem import SweepingProcess
from sweepopt.sets import Balls, Box, ConvexSet, HalfSpace, Orthant, Polyhedron
from sweepopt.study.hard.bodies import (
    Hard,
    N,
    Random,
    chain,
    contacts,
    nearly_singular,
    rod,
    slivers,
    spectral,
    translate,
)

STEPS = 4  # of a run


class Shape(NamedTuple):
    """A set on few unknowns: `scaled(units)` is it in other units; `edge` a force on its edge.

    So many unknowns in a row as `block` says have one unit.
    """

    scaled: Callable[[np.ndarray], ConvexSet]
    edge: np.ndarray | None
    block: int = 1


def combination(random: Random) -> Hard:
    """Any matrix, units, set, load and history of those that are hard."""
    tables: tuple[Mapping[str, Any], ...] = MATRICES, SHAPES, LOADS, UNITS, HISTORIES
    names = [list(table)[random.integers(len(table))] for table in tables]
    draws = [table[name] for table, name in zip(tables, names, strict=True)]
    draw_matrix, draw_shape, draw_load, draw_units, draw_history = draws
    _, _, load, _, history = names
    A = draw_matrix(random)
    few, shape = draw_shape(random)
    units, force = draw_units(random, few, shape.block)
    f = draw_load(random, few, shape.edge)
    start, B = draw_history(random, A)
    part = shape.scaled(force * units[few])
    if shape.block == 1 and random.uniform() < 0.2:
        again = random.permutation(few.size)[:4]  # contacts that are named twice
        if isinstance(part, Box):
            few, part = np.concatenate([few, few[again]]), _shared(part, again)
            names.append("contacts named again")
    scale = force * np.outer(units, units)
    A, B = scale * start, None if B is None else scale * B
    steps = 1 if history == "one step" else STEPS
    center: Any = force * units * f
    if steps > 1:
        # what is at the threshold comes there and stays
        rise = np.sin if load in EASY else lambda t: np.minimum(t, 1.0)
        center = Separable([(rise, center)])
    C = translate(part, center, few)
    return Hard(
        lambda: SweepingProcess(A, B, C, np.zeros(N)),
        float(steps),
        steps,
        drawn=", ".join(name for name in names if name not in EASY),
    )


def _shared(part: Box, again: np.ndarray) -> Box:
    """The same set if the contacts at those places share their bounds between two names."""
    share = np.ones(part.dim)
    share[again] = 0.5
    lower, upper = share * part.lower, share * part.upper
    return Box(np.concatenate([lower, lower[again]]), np.concatenate([upper, upper[again]]))


# ---- matrices ---------------------------------------------------------------------------------


MATRICES: dict[str, Callable[..., np.ndarray]] = {
    "a chain": chain,
    "cond 1e12": lambda random: spectral(random, np.logspace(-12, 0, N)),
    "cond 1e7": lambda random: spectral(random, np.logspace(-7, 0, N)),
    "beta 1e-8": nearly_singular,
    "cells 1 to 1e-6": lambda random: rod(1 / random.permutation(np.logspace(-6, 0, N + 1))),
    "jumps of 1e8": lambda random: rod(random.choice([1.0, 1e8], N + 1)),
    "slivers": slivers,
}

# ---- sets -------------------------------------------------------------------------------------


def _box(random: Random, g: np.ndarray) -> tuple[np.ndarray, Shape]:
    def scaled(units: np.ndarray) -> Box:
        return Box(-units * g, units * g)

    edge = np.where(np.isfinite(g), g, 1.0) * random.choice([-1.0, 1.0], g.size)
    return contacts(random, g.size), Shape(scaled, edge)


def _mixed(random: Random, count: int, low: float, high: float) -> np.ndarray:
    g = 10 ** random.uniform(low, high, count)
    return random.permutation(np.concatenate([[0.0, np.inf, 1e12, 1e-12], g[4:]]))


def _discs(random: Random, radii: np.ndarray) -> tuple[np.ndarray, Shape]:
    few, angle = random.permutation(N)[: 2 * radii.size], random.uniform(0, 6, radii.size)
    edge = (radii * np.array([np.cos(angle), np.sin(angle)])).T.ravel()
    return few, Shape(lambda units: Balls(units[::2] * radii, 2), edge, 2)


def _rows(random: Random, G: np.ndarray) -> tuple[np.ndarray, Shape]:
    def scaled(units: np.ndarray) -> Polyhedron:
        return Polyhedron(G / units, np.ones(len(G)))

    return contacts(random, G.shape[1]), Shape(scaled, None)


def _half_space(random: Random) -> tuple[np.ndarray, Shape]:
    row = random.normal(size=6)
    edge = 0.3 * row / (row @ row)
    return contacts(random, 6), Shape(lambda units: HalfSpace(row / units, 0.3), edge)


SHAPES: dict[str, Callable[..., tuple[np.ndarray, Shape]]] = {
    "a box": lambda random: _box(random, random.uniform(0.2, 2.0, 14)),
    "a box on all": lambda random: _box(random, random.uniform(0.2, 2.0, N)),
    "g from 0 to inf": lambda random: _box(random, _mixed(random, 14, -12, 12)),
    "g from 0 to inf on all": lambda random: _box(random, _mixed(random, N, -6, 2)),
    "a thin box": lambda random: _box(random, 10 ** random.uniform(-14, 0, N)),
    "discs": lambda random: _discs(random, random.uniform(0.2, 1.0, 5)),
    "radii from 1e-12 to 1e12": lambda random: _discs(random, 10 ** random.uniform(-12, 12, 6)),
    "an orthant": lambda random: (
        contacts(random, 9),
        Shape(lambda units: Orthant(9), np.zeros(9)),
    ),
    "a half-space": _half_space,
    "a polyhedron": lambda random: _rows(random, random.normal(size=(10, 5))),
    "rows that differ by 1e-7": lambda random: _rows(
        random, random.normal(size=4) + 1e-7 * random.normal(size=(3, 4))
    ),
}


# ---- loads ------------------------------------------------------------------------------------


def _anything(random: Random, few: np.ndarray, edge: Any) -> np.ndarray:
    return 3 * random.normal(size=N)


def _beside(shares: Callable[[Random, int], np.ndarray]) -> Callable[..., np.ndarray]:
    """Loads beside the edge of the set by shares of them; any load if it has no edge."""

    def load(random: Random, few: np.ndarray, edge: Any) -> np.ndarray:
        if edge is None:
            return _anything(random, few, edge)
        f = np.zeros(N)
        f[few] = edge * (1 + shares(random, few.size))
        return f

    return load


def _weakly(random: Random, count: int) -> np.ndarray:
    return random.choice([-1.0, 1.0], count) * 10 ** random.uniform(-13, -3, count)


LOADS: dict[str, Callable[..., np.ndarray]] = {
    "any load": _anything,
    "another load": _anything,
    "at the threshold": _beside(lambda random, m: random.choice([0, 0, 0, 1e-14, -1e-14], m)),
    "weakly active": _beside(_weakly),
}

# ---- units ------------------------------------------------------------------------------------


def _mixed_units(random: Random, few: np.ndarray, block: int) -> tuple[np.ndarray, float]:
    units = 2.0 ** random.integers(-40, 41, N)
    units[few] = np.repeat(units[few[::block]], block)
    return units, 1.0


UNITS: dict[str, Callable[..., tuple[np.ndarray, float]]] = {
    "plain": lambda random, few, block: (np.ones(N), 1.0),
    "no units": lambda random, few, block: (np.ones(N), 1.0),
    "forces x 2^40": lambda random, few, block: (np.ones(N), 2.0**40),
    "forces x 2^-40": lambda random, few, block: (np.ones(N), 2.0**-40),
    "lengths x 2^40": lambda random, few, block: (np.full(N, 2.0**-40), 1.0),
    "lengths x 2^-40": lambda random, few, block: (np.full(N, 2.0**40), 1.0),
    "units from 2^-40 to 2^40": _mixed_units,
}

# ---- history ----------------------------------------------------------------------------------


def _singular(random: Random, A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    row = random.normal(size=N)
    return A, np.outer(row, row)


def _small_viscosity(random: Random, A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return 10.0 ** -random.integers(2, 13) * A, chain(random)


HISTORIES: dict[str, Callable[..., tuple[np.ndarray, Any]]] = {
    "one step": lambda random, A: (A, None),
    "B = 0": lambda random, A: (A, None),
    "any B": lambda random, A: (A, chain(random)),
    "B of rank one": _singular,
    "B = rho A": lambda random, A: (A, 10.0 ** random.integers(-6, 7) * A),
    "B up to 1e10": lambda random, A: (A, spectral(random, np.logspace(0, 10, N))),
    "a small viscosity": _small_viscosity,
    "A = 0": lambda random, A: (np.zeros((N, N)), A),
}
EASY = ("a chain", "a box", "any load", "another load", "plain", "no units", "one step", "any B")
