"""The small problems of the studies, their loads as data; the exact solution of each is known.

Letters of the names: S scalar, V and B on a disc or with B = 0, P polyhedral, L linear, M Moreau's
(A = 0), E elastoplastic, H a hold. All are dimensionless.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sweepopt.errors import InputError
from sweepopt.loads import Polynomial, Separable, Sine, Table, Triangle
from sweepopt.problem import SweepingProcess
from sweepopt.sets import AnySet, Ball, Box, Moving, Orthant, Point, Polyhedron


@dataclass(frozen=True)
class Problem:
    """A process and how long it runs.

    Attributes
    ----------
    name, title : str
    t_end : float
    A, B : tuples of tuples
    u0 : tuple of float
    C : callable () -> set
    """

    name: str
    title: str
    t_end: float
    A: Any
    B: Any
    u0: tuple[float, ...]
    C: Callable[[], AnySet]

    def process(self) -> SweepingProcess:
        """The process, built anew."""
        return SweepingProcess(self.A, self.B, self.C(), self.u0)


def sine(amplitude: float, rate: float, phase: float = 0.0) -> Sine:
    """amplitude sin(rate t + phase)."""
    return Sine(amplitude, 2.0 * math.pi / rate, phase)


@dataclass(frozen=True)
class Spiral:
    """speed t cos(rate t + phase): a history that declares a bound of its variation."""

    speed: float
    rate: float
    phase: float

    def __call__(self, t: Any) -> Any:
        return self.speed * np.asarray(t) * np.cos(self.rate * np.asarray(t) + self.phase)

    def variation(self, a: float, b: float) -> float:
        """At most the length of the spiral: int speed sqrt(1 + (rate t)^2)."""
        length = [0.5 * (t * math.hypot(1, self.rate * t) + math.asinh(self.rate * t) / self.rate)
                  for t in (a, b)]  # fmt: skip
        return self.speed * (length[1] - length[0])

    def breakpoints(self, a: float, b: float) -> np.ndarray:
        """None."""
        return np.empty(0)


def along(*terms: tuple[Any, Sequence[float]]) -> Separable:
    """A load from histories and their directions."""
    return Separable(terms)


def interval(g: float) -> Box:
    return Box([-g], [g])


COSINE = math.pi / 2
CHAIN = np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 2.0]])
LATTICE = ((61 / 60, 11 / 12, -0.25, -0.25), (11 / 12, 67 / 60, -0.25, -0.25),
           (-0.25, -0.25, 1.1, 1.0), (-0.25, -0.25, 1.0, 1.3))  # fmt: skip
EYE = ((1.0, 0.0), (0.0, 1.0))
ZERO = ((0.0, 0.0), (0.0, 0.0))

BURST = ((0.0, 40.0, 40.1, 40.25, 40.4, 40.55, 40.7, 40.8, 100.0),
         (0.0, 0.5, 3.0, -3.0, 3.0, -3.0, 3.0, 0.8, 0.4))  # fmt: skip

PROBLEMS = {
    problem.name: problem
    for problem in (
        Problem("S01", "a block on a spring and a dashpot, pulled by a ramp", 5.0,
            [[0.5]], [[2.0]], (0.0,),
            lambda: Moving(interval(1), along((Polynomial([0.0, 1.5]), [1])))),
        Problem("S02", "stick and slip under a triangular wave", 12.0,
            [[0.7]], [[1.3]], (0.0,),
            lambda: Moving(interval(0.5), along((Triangle(2.0, 4.0), [1])))),
        Problem("S03", "stick and slip under a sine", 8.0,
            [[0.5]], [[2.0]], (0.0,),
            lambda: Moving(interval(1), along((sine(3.0, 2.0), [1])))),
        Problem("S04", "an interval whose ends move apart and together", 10.0,
            [[0.4]], [[1.0]], (0.0,),
            lambda: Polyhedron([[1.0], [-1.0]], along(
                (Polynomial([1.0]), [1, 1]), (sine(0.6, 2.0), [1, 0]), (sine(0.5, 1.0), [1, 0]),
                (sine(-1.0, 1.0), [0, 1]), (sine(0.3, 3.0, COSINE), [0, 1])))),
        Problem("V05", "plane friction on a disc, pulled round", 4.0,
            EYE, EYE, (0.196, -0.672),
            lambda: Moving(Ball([0, 0], 1), along(
                (sine(2.5, 2.0, COSINE), [1, 0]), (sine(2.5, 2.0), [0, 1])))),
        Problem("P09", "three blocks in a chain", 10.0,
            0.5 * CHAIN + np.eye(3), 2.0 * CHAIN, (0.0, 0.0, 0.0),
            lambda: Moving(Box([-1, -0.6, -0.4], [1, 0.6, 0.4]), along(
                (sine(3.0, 1.0), [1, 0, 0]), (sine(1.0, 1.0), [0, 1, 0]),
                (sine(1.0, 2.0), [0, 1, 0]), (sine(2.0, 2.0), [0, 0, 1])))),
        Problem("P10", "a velocity that may not be negative", 16.0,
            [[0.5]], [[1.0]], (0.0,),
            lambda: Moving(Orthant(1), along((sine(2.0, 1.0), [1]), (Polynomial([0, 0.25]), [1])))),
        Problem("L13", "no friction: a linear problem", 6.0,
            ((2.0, 0.5, 0.0), (0.5, 1.0, 0.25), (0.0, 0.25, 1.5)),
            ((3.0, -1.0, 0.5), (-1.0, 2.0, 0.0), (0.5, 0.0, 1.0)), (0.5, -0.5, 1.0),
            lambda: Moving(Point([0, 0, 0]), along(
                (Polynomial([1.0]), [1, 0, 0]), (sine(1.0, 3.0), [1, 0, 0]),
                (Polynomial([0, 0.5]), [0, 1, 0]), (sine(1.0, 3.0, COSINE), [0, 0, 1])))),
        Problem("B14", "no spring: a disc pulled along a spiral", 6.0,
            ((1.5, 0.0), (0.0, 1.5)), ZERO, (0.0, 0.0),
            lambda: Moving(Ball([0, 0], 1), along(
                (Spiral(0.8, 2.0, 0.0), [1, 0]), (Spiral(0.8, 2.0, -COSINE), [0, 1])))),
        Problem("B15", "no spring: two blocks under a record", 9.0,
            ((2.0, 1.0), (1.0, 2.0)), ZERO, (0.0, 0.0),
            lambda: Moving(Box([-1, -0.5], [1, 0.5]), along(
                (Table([0, 3, 6, 9], [0, 3, -3, 0]), [1, 0]),
                (Table([0, 3, 6, 9], [0, 1, 2.5, -2]), [0, 1])))),
        Problem("M16", "no dashpot: play under two sines", 8.0,
            [[0.0]], [[2.0]], (0.0,),
            lambda: Moving(interval(1), along((sine(3.0, 2.0), [1]), (sine(1.5, 5.0), [1])))),
        Problem("M17", "Moreau's process: a disc that passes", 5.0,
            ZERO, EYE, (0.2, 0.6),
            lambda: Moving(Ball([0, 0], 1), along((Polynomial([0, 1.0]), [1, 0])))),
        Problem("E20", "an elastoplastic lattice with hardening", 10.0,
            np.zeros((4, 4)), LATTICE, (0.0, 0.0, 0.0, 0.0),
            lambda: Moving(Box([-1, -1.1, -0.8, -0.9], [1, 1.1, 0.8, 0.9]), along(
                (Table([0, 2, 6, 10], [0, 6, -6, 6]), [2 / 3, 2 / 3, 3 / 4, 3 / 4])))),
        Problem("H18", "a long hold with a short burst in it", 100.0,
            [[0.02]], [[2.0]], (0.0,),
            lambda: Moving(interval(1), along((Table(*BURST), [1])))),
    )
}  # fmt: skip

BLOCK = Problem(
    "block", "a block that other packages integrate too", 10.0, [[1.0]], [[1.0]], (0.0,),
    lambda: Moving(interval(0.3), along((sine(1.0, 1.0), [1]))),
)  # fmt: skip


def problem(name: str) -> Problem:
    """The problem of that name, in `PROBLEMS` or `BLOCK`.

    Raises
    ------
    InputError
        If there is none.

    Examples
    --------
    >>> problem("S03").process().dim
    1
    """
    if name == BLOCK.name:
        return BLOCK
    if name not in PROBLEMS:
        raise InputError(f"there is no problem {name!r}; there are: {', '.join(PROBLEMS)}, block")
    return PROBLEMS[name]
