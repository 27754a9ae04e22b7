"""Hard cases as data: each names what it is made of, and a seed makes it.

What makes a program hard was listed one by one; solvers fail where two or three of it meet.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sweepopt.io import read_toml
from sweepopt.loads import Separable
from sweepopt.problem import SweepingProcess
from sweepopt.sets import Moving, image
from sweepopt.study.hard import bodies
from sweepopt.study.hard.bodies import Contact, Random, between, chain, spectral

Names = Sequence[str]

TWICE = "a box that names contacts twice"
REFUSED = {"": "", "a strip that is missing by 1e-9": "EmptySetError"}
"""Errors that are the right answers."""

# ---- loads, stiffness, histories --------------------------------------------------------------

THRESHOLD = "each load is its friction bound, or up to 1e-14 beside it"
WEAKLY = "loads beside their bounds by 1e-3 to 1e-13 of these"
LOADS: dict[str, Any] = {
    "any load": None,
    "another load": None,
    THRESHOLD: lambda random, count: 1 + random.choice([0, 0, 0, 1e-14, -1e-14], count),
    WEAKLY: lambda random, count: (
        1 + random.choice([-1.0, 1.0], count) * between(random, 1e-13, 1e-3, count)
    ),
    "five times the bounds": 5.0,
    "half the bounds": 0.5,
    "0.999 of the bounds": 0.999,
    "exactly the bounds": 1.0,
}
"""Shares of the edge of the set, or how they are drawn; None is any load."""

STIFFNESS: dict[str, Callable[[Random, np.ndarray], Any]] = {
    "no B": lambda random, A: None,
    "B = 0": lambda random, A: None,
    "any B": lambda random, A: chain(random, len(A)),
    "B of rank one": lambda random, A: np.outer(*2 * [random.normal(size=len(A))]),
    "B = rho A, rho 1e-6 to 1e6": lambda random, A: 10.0 ** random.integers(-6, 7) * A,
    "B up to 1e10": lambda random, A: spectral(random, 0, 10, len(A)),
    "viscosity 1e-2 to 1e-12": lambda random, A: (
        10.0 ** -random.integers(2, 13) * A,
        chain(random, len(A)),
    ),
    "A = 0": lambda random, A: (0 * A, A),
    "all of B 1e10": lambda random, A: 1e10 * chain(random, len(A)),
}
"""B for a matrix A, or A and B in its place."""


def constant(t: float) -> float:
    """1 at all times."""
    return 1.0


LONG = "500 steps, loads that change their signs"
HISTORIES: dict[str, tuple[Any, ...]] = {
    "one step": (1.0, 1, constant),
    "four steps": (4.0, 4, np.sin),
    "a load that stays": (4.0, 4, lambda t: min(t, 1.0)),
    "a sine": (6.0, 12, np.sin),
    "steps of 1e-10": (1e-9, 10, lambda t: 1 + t),
    "steps of 10": (100.0, 10, np.sin),
    "a load that jumps from 1e6 to 1e-6 and back": (6.0, 12, lambda t: 1e6 ** ((-1) ** int(t))),
    "a load that rotates through zero": (
        *(6.0, 12, lambda t: np.sin(t - 0.5) * np.cos(t)),
        lambda t: np.sin(t - 0.5) * np.sin(t),
    ),
    "a corner of C(t) sweeps past": (6.0, 30, np.cos, lambda t: np.sin(2 * t)),
    LONG: (10.0, 500, lambda t: (-1) ** int(t)),
    "stick and slip at almost every step": (10.0, 200, lambda t: np.sin(40 * t)),
}
"""End, steps, and factors over time of loads that are drawn one by one."""

# ---- cases ------------------------------------------------------------------------------------

MATRICES, CONTACTS, UNITS = read_toml(Path(__file__).with_name("ingredients.toml")).values()
TABLES = (MATRICES, CONTACTS, LOADS, UNITS, STIFFNESS, HISTORIES)


def entry_of(table: Mapping[str, Any], names: Names) -> Any:
    """The entry of a table that is named, the first one if none is."""
    return table[next((name for name in names if name in table), next(iter(table)))]


def make(names: Names, random: Random) -> SweepingProcess:
    """The process that these ingredients and a seed make."""
    A = _draw(MATRICES, names, random)
    n = len(A)
    contact: Contact = _draw(CONTACTS, names, random, n)
    few, block = contact.few, contact.block
    length, force = entry_of(UNITS, names) or (2.0 ** random.integers(-40, 41, n), 1.0)
    units = length * np.ones(n)
    units[few] = np.repeat(units[few[::block]], block)
    _, _, *factors = entry_of(HISTORIES, names)
    terms: list[Any] = [
        (factor, force * units * _load(names, random, n, contact)) for factor in factors
    ]
    B = entry_of(STIFFNESS, names)(random, A)
    A, B = (
        M if M is None else force * np.outer(units, units) * M
        for M in (B if isinstance(B, tuple) else (A, B))
    )
    # a long hold starts at an equilibrium that is not 0
    u0 = random.normal(size=n) if LONG in names else np.zeros(n)
    if B is not None:
        terms.append((constant, B @ u0))
    part = contact.part(force * units[few])
    if not np.array_equal(few, np.arange(n)):
        part = image(np.eye(n)[:, few], part)
    return SweepingProcess(A, B, Moving(part, Separable(terms)), u0)


def _draw(table: Mapping[str, Any], names: Names, *given: Any) -> Any:
    ((function, arguments),) = entry_of(table, names).items()
    return getattr(bodies, function)(*given, *arguments)


def _load(names: Names, random: Random, n: int, contact: Contact) -> np.ndarray:
    shares = entry_of(LOADS, names)
    if shares is None or contact.edge is None:
        return 3 * random.normal(size=n)
    if callable(shares):
        shares = shares(random, contact.few.size)
    return np.bincount(contact.few, contact.edge * shares, n)


DRAWN = (7, 11, 4, 7, 8)
"""From how many first entries of the tables but the last one combinations are drawn."""


def combination(random: Random) -> Names:
    """A matrix, contact, load, units and stiffness, drawn by chance."""
    names = [
        list(table)[random.integers(count)] for table, count in zip(TABLES, DRAWN, strict=False)
    ]
    if names[1:3] == ["a box", "another load"]:
        names[1] = TWICE
    # what is at the threshold comes there and stays
    history = "a load that stays" if names[2] in (THRESHOLD, WEAKLY) else "four steps"
    return (*names, "one step" if names[4] == "no B" else history)


FAMILIES: dict[str, Names] = read_toml(Path(__file__).with_suffix(".toml"))
"""Families by name: of each, every seed makes a case."""
