"""Hard cases as data: each names what it is made of, and a seed makes it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

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

Names = tuple[str, ...]


def chosen(table: Mapping[str, Any], names: Names) -> Any:
    """The entry of a table that is named, the first one if none is."""
    return table[next((name for name in names if name in table), next(iter(table)))]


def make(names: Names, random: Random) -> SweepingProcess:
    """The process that these ingredients and a seed make."""
    matrix, history = chosen(MATRICES, names)(random), chosen(HISTORIES, names)
    n = len(matrix)
    contact = chosen(CONTACTS, names)(random, n)
    units, force = _units(names, random, n, contact)
    terms: list[Any] = [
        (factor, force * units * _load(names, random, n, contact)) for factor in history.factors
    ]
    scale = force * np.outer(units, units)
    A, B = (M if M is None else scale * M for M in chosen(STIFFNESS, names)(random, matrix))
    u0 = random.normal(size=n) if history.displaced else np.zeros(n)
    if B is not None:
        terms.append((constant, B @ u0))
    part = contact.part(force * units[contact.few])
    if not np.array_equal(contact.few, np.arange(n)):
        part = image(np.eye(n)[:, contact.few], part)
    return SweepingProcess(A, B, Moving(part, Separable(terms)), u0)


def _units(names: Names, random: Random, n: int, contact: Contact) -> tuple[np.ndarray, float]:
    length, force = chosen(UNITS, names) or (2.0 ** random.integers(-40, 41, n), 1.0)
    units, few = length * np.ones(n), contact.few
    units[few] = np.repeat(units[few[:: contact.block]], contact.block)
    return units, force


def _load(names: Names, random: Random, n: int, contact: Contact) -> np.ndarray:
    shares = chosen(LOADS, names)
    if shares is None or contact.edge is None:
        return 3 * random.normal(size=n)
    f = np.zeros(n)
    few = contact.few
    f[few] = contact.edge * (shares(random, few.size) if callable(shares) else shares)
    return f


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


ON_ALL = "a box on all"
HOLD = ("ten springs", ON_ALL, "any B", "500 steps, loads that change their signs")
FAMILIES: dict[str, Names] = {
    "threshold": (THRESHOLD, ON_ALL),
    "weakly_active": (WEAKLY, ON_ALL),
    "small_beta": ("beta 1e-8",),
    "condition": ("cond 1e12",),
    "condition_all": ("cond 1e12", ON_ALL),
    "mixed_bounds": ("g from 0 to inf",),
    "mixed_bounds_all": ("g from 0 to inf on all",),
    "forces_up": ("forces x 2^40",),
    "forces_down": ("forces x 2^-40",),
    "lengths_up": ("lengths x 2^40",),
    "lengths_down": ("lengths x 2^-40",),
    "mixed_units": ("units from 2^-40 to 2^40",),
    "graded": ("cells 1 to 1e-6",),
    "jumps": ("jumps of 1e8",),
    "sliver_triangles": ("triangles 1e-6 as wide as high",),
    "singleton": ("one point",),
    "thin": ("a thin box",),
    "unbounded": ("an orthant",),
    "half_space": ("four springs", "a half-space", "a sine"),
    "near_parallel": ("four springs", "rows that differ by 1e-7", "a sine"),
    "near_empty": ("four springs", "a strip 1e-9 wide"),
    "empty": ("four springs", "a strip that is missing by 1e-9"),
    "wedge": ("a polyhedron",),
    "cone_units": ("discs", "forces x 2^-40"),
    "cone_threshold": ("ten springs", "discs", WEAKLY),
    "repeated": (TWICE,),
    "parts": ("a box beside an orthant",),
    "combined_box": ("cond 1e12", "g from 0 to inf", "units from 2^-40 to 2^40"),
    "combined_balls": ("cond 1e12", "mixed radii"),
    "combined_rows": ("cond 1e7", "rows that differ by 1e-7", "forces x 2^40"),
    "corner": ("two springs", "a polyhedron", "any B", "a corner of C(t) sweeps past"),
    "rotating": ("discs", "any B", "a load that rotates through zero"),
    "no_stiffness": ("B = 0", "a sine"),
    "singular_stiffness": ("B of rank one", "a sine"),
    "proportional": ("B = rho A, rho 1e-6 to 1e6", "a sine"),
    "viscosity": ("viscosity 1e-2 to 1e-12", "a sine"),
    "no_viscosity": ("A = 0", "a sine"),
    "stiff": ("B up to 1e10", "a sine"),
    "stiff_uniform": ("all of B 1e10", "a sine"),
    "short_steps": ("any B", "steps of 1e-10"),
    "long_steps": ("any B", "steps of 10"),
    "jumping": ("any B", "a load that jumps from 1e6 to 1e-6 and back"),
    "hold_half": ("half the bounds", *HOLD),
    "hold_almost": ("0.999 of the bounds", *HOLD),
    "hold_exactly": ("exactly the bounds", *HOLD),
    "switches": (
        "one spring",
        ON_ALL,
        "five times the bounds",
        "any B",
        "stick and slip at almost every step",
    ),
}
"""Families by name: of each, every seed makes a case."""
