"""How C(t) moves, as data: read here once, for the exact scheme, the proportional path and bounds.

    C(t) = center(t) + scale(t) S        or        C(t) = { w : G w <= h(t) } .

A set that moves in another way gives a `Motion` that says so.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from sweepopt.checks import vector
from sweepopt.loads import Constant, History, Separable, VectorTable
from sweepopt.sets import (
    AnySet,
    ConvexSet,
    Moving,
    MovingOffsets,
    MovingSet,
)

Terms = tuple[tuple[Any, np.ndarray], ...]


@dataclass(frozen=True, eq=False)
class TimeFunction:
    """f(t) = sum_k phi_k(t) f_k, or a function of time of which nothing else is known.

    Attributes
    ----------
    terms : tuple of (callable, ndarray of shape (dim,))
        Histories phi_k and vectors f_k.
    dim : int
    function : callable or None
        Instead of terms.
    variation : callable (a, b) -> float, or None
        At least that of a function between two times.
    """

    terms: Terms
    dim: int
    function: Callable[[float], Any] | None = None
    variation: Callable[[float, float], float] | None = None

    @classmethod
    def of(cls, value: Any, dim: int) -> TimeFunction:
        """Read what a set's center, scale or offsets may be."""
        if value is None:
            return cls((), dim)
        if isinstance(value, Separable):
            return cls(value.terms, dim)
        if isinstance(value, VectorTable):
            return cls((), dim, value, value.variation)
        if dim == 1 and hasattr(value, "variation"):
            return cls(((value, np.ones(1)),), 1)
        return cls((), dim, value)

    @property
    def bounded(self) -> bool:
        """Whether its values between two times can be bounded."""
        if self.function is not None:
            return self.variation is not None
        return all(hasattr(phi, "variation") for phi, _ in self.terms)

    def largest(self, a: float, b: float) -> Iterator[tuple[float, np.ndarray]]:
        """A bound of |phi_k| on [a, b] with each f_k; infinite of a function."""
        if self.function is not None:
            yield math.inf, np.ones(self.dim)
        for phi, f in self.terms:
            if isinstance(phi, History):
                yield phi.largest(a, b), f
            elif hasattr(phi, "variation"):
                yield abs(float(phi(a))) + phi.variation(a, b), f
            else:
                yield math.inf, f

    @property
    def constant(self) -> bool:
        """Whether it does not change."""
        return self.function is None and all(isinstance(phi, Constant) for phi, _ in self.terms)

    @property
    def histories(self) -> list[Any]:
        """The phi_k, or the function."""
        return [phi for phi, _ in self.terms] if self.function is None else [self.function]

    def at(self, times: np.ndarray) -> np.ndarray:
        """Values, shape (len(times), dim)."""
        if isinstance(self.function, VectorTable):
            return np.asarray(self.function(times))
        if self.function is not None:
            return np.array(
                [
                    vector(f"the function of C(t) at t = {t:g}", self.function(t), self.dim)
                    for t in times.tolist()
                ]
            )
        if not self.terms:
            return np.zeros((len(times), self.dim))
        return Separable(self.terms).at_many(times)


ONE = TimeFunction.of(Constant(), 1)


@dataclass(frozen=True, eq=False)
class Motion:
    """C(t) = center(t) + scale(t) S, or { w : G w <= h(t) }, or neither.

    Attributes
    ----------
    shape : ConvexSet or None
        S, or { w : G w <= 0 } where `offsets` are given; None for neither.
    center, scale : TimeFunction
        A scale of several entries goes with a box S.
    offsets : TimeFunction or None
        h.
    name : str
        How messages call the function that moves C: "center", "load" or "h".
    """

    shape: ConvexSet | None
    center: TimeFunction
    scale: TimeFunction = ONE
    offsets: TimeFunction | None = None
    name: str = "center"

    @property
    def histories(self) -> list[Any]:
        """The functions of time in them."""
        functions = (self.center, self.scale, self.offsets)
        return [phi for f in functions if f is not None for phi in f.histories]


def motion(C: AnySet) -> Motion:
    """Read how C(t) moves."""
    still = TimeFunction((), C.dim)
    if isinstance(C, Moving):
        center, scale = TimeFunction.of(C.center, C.dim), TimeFunction.of(C.scale or Constant(), 1)
        return Motion(C.shape, center, scale, name=C.center_name)
    if isinstance(C, MovingOffsets):
        offsets = TimeFunction.of(C.offsets, C.shape.offsets.size)
        return Motion(C.shape, still, offsets=offsets, name="h")
    if isinstance(C, ConvexSet):
        return Motion(C, still)
    return Motion(None, TimeFunction((), C.dim, C.at))


def histories_of(C: AnySet, inside: bool = True) -> list[Any]:
    """The functions of time that C(t) moves with, also where it is made of others that move.

    With those that a user names of a function t -> C, if `inside`.
    """
    parts, named = (C.operands, C.histories) if isinstance(C, MovingSet) else ((), ())
    own = [phi for part in parts for phi in histories_of(part, inside)] or motion(C).histories
    return [*(named if inside else ()), *own]
