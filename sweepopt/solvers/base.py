"""The contract of a solver: compile once per program, then only vectors."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from sweepopt.program import VelocityProgram
from sweepopt.sets import ConvexSet


class Answer(NamedTuple):
    """What a solver says; nothing of it is believed before the program has certified it."""

    z: np.ndarray
    y: np.ndarray
    iterations: int
    status: str


Solve = Callable[[np.ndarray, ConvexSet], Answer]


class Solver(Protocol):
    """A way to solve velocity programs.

    Attributes
    ----------
    name : str
    """

    @property
    def name(self) -> str: ...

    def treats(self, C: ConvexSet) -> bool:
        """Whether programs with this set can be solved."""
        ...

    def compile(self, program: VelocityProgram) -> Solve:
        """A function (q, C) -> Answer for C with this cone; not to be shared by threads."""
        ...

    def refined(self) -> Solver | None:
        """The same solver with tighter settings, for a step that missed its tolerance."""
        ...
