"""The contract of a solver: compile once per program, then only vectors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from sweepopt.checks import count
from sweepopt.sets import ConvexSet
from sweepopt.velocity.program import VelocityProgram


class Answer(NamedTuple):
    """What a solver says; nothing of it is believed before the program has certified it.

    The multipliers y are not used; a solver of yours may give them.
    """

    z: np.ndarray
    y: np.ndarray = np.zeros(0)
    iterations: int = 0
    status: str = ""


Solve = Callable[..., Answer]


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
        """A function (q, C) -> Answer for C with this cone; not to be shared by threads.

        A solver that can start from a velocity, like Newton, takes one as a third argument.
        """
        ...


@dataclass(frozen=True)
class Small:
    """What solvers of small programs have in common: they go to rounding, or fail.

    Parameters
    ----------
    max_dim : int
        Larger programs are left to the other solvers.

    Raises
    ------
    InputError
        If max_dim is not positive.
    """

    max_dim: int = 300

    def __post_init__(self) -> None:
        count("max_dim", self.max_dim)
