"""Hard cases as data: each names what it is made of, and a seed makes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sweepopt.io import read_toml
from sweepopt.loads import Separable
from sweepopt.problem import SweepingProcess
from sweepopt.sets import Moving, image
from sweepopt.study.hard.bodies import MATRICES, Random
from sweepopt.study.hard.ingredients import (
    CONTACTS,
    HISTORIES,
    LOADS,
    STIFFNESS,
    THRESHOLD,
    TWICE,
    UNITS,
    WEAKLY,
    Contact,
    constant,
)
from sweepopt.study.records import each, known

Names = Sequence[str]


def chosen(table: Mapping[str, Any], names: Names) -> Any:
    """The entry of a table that is named, the first one if none is."""
    return table[next((name for name in names if name in table), next(iter(table)))]


def make(names: Names, random: Random) -> SweepingProcess:
    """The process that these ingredients and a seed make."""
    matrix, history = chosen(MATRICES, names)(random), chosen(HISTORIES, names)
    n = len(matrix)
    contact = chosen(CONTACTS, names)(random, n)
    few, block = contact.few, contact.block
    length, force = chosen(UNITS, names) or (2.0 ** random.integers(-40, 41, n), 1.0)
    units = length * np.ones(n)
    units[few] = np.repeat(units[few[::block]], block)
    terms: list[Any] = [
        (factor, force * units * _load(names, random, n, contact)) for factor in history.factors
    ]
    scale = force * np.outer(units, units)
    A, B = (M if M is None else scale * M for M in chosen(STIFFNESS, names)(random, matrix))
    u0 = random.normal(size=n) if history.displaced else np.zeros(n)
    if B is not None:
        terms.append((constant, B @ u0))
    part = contact.part(force * units[few])
    if not np.array_equal(few, np.arange(n)):
        part = image(np.eye(n)[:, few], part)
    return SweepingProcess(A, B, Moving(part, Separable(terms)), u0)


def _load(names: Names, random: Random, n: int, contact: Contact) -> np.ndarray:
    shares = chosen(LOADS, names)
    if shares is None or contact.edge is None:
        return 3 * random.normal(size=n)
    if callable(shares):
        shares = shares(random, contact.few.size)
    return np.bincount(contact.few, contact.edge * shares, n)


DRAWN: tuple[tuple[Mapping[str, Any], int], ...] = (
    (MATRICES, 7),
    (CONTACTS, 11),
    (LOADS, 4),
    (UNITS, 7),
    (STIFFNESS, 8),
)
"""Tables, and how many of their first entries combinations are drawn from."""


def combination(random: Random) -> Names:
    """A matrix, contact, load, units and stiffness, drawn by chance."""
    names = [list(table)[random.integers(count)] for table, count in DRAWN]
    if names[1:3] == ["a box", "another load"]:
        names[1] = TWICE
    # what is at the threshold comes there and stays
    history = "a load that stays" if names[2] in (THRESHOLD, WEAKLY) else "four steps"
    return (*names, "one step" if names[4] == "no B" else history)


TABLES = (MATRICES, CONTACTS, LOADS, UNITS, STIFFNESS, HISTORIES)


def read_families(path: Path) -> dict[str, Names]:
    """Families of a file by name; InputError names an ingredient that there is not."""
    ingredients, families = [name for table in TABLES for name in table], read_toml(path)
    return {
        name: each(f"{path.name}: {name}", names, known, ingredients, "there are:")
        for name, names in families.items()
    }


FAMILIES: dict[str, Names] = read_families(Path(__file__).with_suffix(".toml"))
"""Families by name: of each, every seed makes a case."""
