"""The small problems of the studies, stated in problems.toml; the exact solution of each is known.

Letters of the names: S scalar, V and B on a disc or with B = 0, P polyhedral, L linear, M Moreau's
(A = 0), E elastoplastic, H a hold. All are dimensionless.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sweepopt import loads, sets
from sweepopt.errors import InputError
from sweepopt.io import read_toml
from sweepopt.problem import SweepingProcess

FILE = Path(__file__).with_suffix(".toml")


@dataclass(frozen=True)
class Spiral:
    """speed t cos(rate t + phase): a history that declares a bound of its variation."""

    speed: float
    rate: float
    phase: float

    def __call__(self, t: Any) -> Any:
        return self.speed * np.asarray(t) * np.cos(self.rate * np.asarray(t) + self.phase)

    def variation(self, a: float, b: float) -> float:
        """At most int speed (1 + rate t) dt."""
        return self.speed * (b - a) * (1 + self.rate * (a + b) / 2)

    def breakpoints(self, a: float, b: float) -> np.ndarray:
        """None."""
        return np.empty(0)


@dataclass(frozen=True)
class Problem:
    """A process and how long it runs, as they stand in the file.

    Attributes
    ----------
    name, title : str
    t_end : float
    A, B, u0 : lists of numbers
    set, load : dict, list of dict
        Names of `sweepopt.sets` and of `sweepopt.loads`, with what these are called with.
    """

    name: str
    title: str
    t_end: float
    A: Any
    B: Any
    u0: Any
    set: dict[str, Any]
    load: list[dict[str, Any]]

    def process(self) -> SweepingProcess:
        """The process, built anew."""
        terms = []
        for term in self.load:
            (history, arguments), (_, direction) = term.items()
            make = Spiral if history == "Spiral" else getattr(loads, history)
            terms.append((make(*arguments), direction))
        ((kind, arguments),) = self.set.items()
        shape, load = getattr(sets, kind), loads.Separable(terms)
        C = (
            shape(*arguments, load)
            if kind == "Polyhedron"
            else sets.Moving(shape(*arguments), load)
        )
        return SweepingProcess(self.A, self.B, C, self.u0)


PROBLEMS = {name: Problem(name, **data) for name, data in read_toml(FILE).items()}
BLOCK = PROBLEMS["block"]


def problem(name: str) -> Problem:
    """The problem of that name.

    Raises
    ------
    InputError
        If there is none.

    Examples
    --------
    >>> problem("S03").process().dim
    1
    """
    if name not in PROBLEMS:
        raise InputError(f"there is no problem {name!r}; there are: {', '.join(PROBLEMS)}")
    return PROBLEMS[name]
