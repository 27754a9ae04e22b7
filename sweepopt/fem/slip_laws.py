"""Laws of friction that depends on the slip: the share of the bound that is left after a slip.

|q| <= g(x) phi(s) at a node whose slip, the length of its tangential displacement, is s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from sweepopt.checks import number
from sweepopt.errors import InputError
from sweepopt.fem.fields import Array
from sweepopt.loads import check_points


class SlipLaw(Protocol):
    """A function phi >= 0 of an array of slips (m) that knows its Lipschitz constant."""

    @property
    def lipschitz(self) -> float:
        """The largest |phi'| (1/m)."""
        ...

    def __call__(self, slip: Array) -> Array:
        """phi(s), of the shape of s, without unit."""
        ...


@dataclass(frozen=True)
class SlipWeakening:
    """``phi(s) = r + (1 - r) exp(-s / d)``: from g at rest to r g after a long way.

    Parameters
    ----------
    distance : float
        d (m), > 0, in which most of the change happens.
    residual : float
        r >= 0, without unit; above 1 friction grows with the slip.

    Raises
    ------
    InputError
        If a number is out of its range.

    Examples
    --------
    >>> law = SlipWeakening(distance=0.5, residual=0.2)
    >>> law.lipschitz, float(law(np.array(0.0)))
    (1.6, 1.0)
    """

    distance: float
    residual: float = 0.0

    def __post_init__(self) -> None:
        number("distance", self.distance, 0.0, strict=True)
        number("residual", self.residual, 0.0)

    @property
    def lipschitz(self) -> float:
        """The largest |phi'| (1/m)."""
        return abs(1 - self.residual) / self.distance

    def __call__(self, slip: Array) -> Array:
        return self.residual + (1 - self.residual) * np.exp(-slip / self.distance)


@dataclass(frozen=True, eq=False)
class SlipTable:
    """phi(s) by a table, linear between its points and constant beyond them.

    Parameters
    ----------
    at : array_like, shape (m,)
        Slips (m), strictly increasing.
    values : array_like, shape (m,)
        phi >= 0 there, without unit.

    Raises
    ------
    InputError
        If the slips do not increase, or a value is negative.

    Examples
    --------
    >>> SlipTable([0.0, 0.5], [1.0, 0.2]).lipschitz
    1.6
    """

    at: ArrayLike
    values: ArrayLike

    def __post_init__(self) -> None:
        at, values = check_points("at", self.at, self.values)
        if values.min() < 0:
            raise InputError(f"values must be >= 0, got {values.min():g}")
        object.__setattr__(self, "at", at)
        object.__setattr__(self, "values", values)

    @property
    def lipschitz(self) -> float:
        """The largest |phi'| (1/m)."""
        return float(np.max(np.abs(np.diff(self.values) / np.diff(self.at)), initial=0.0))

    def __call__(self, slip: Array) -> Array:
        return np.interp(slip, np.asarray(self.at), np.asarray(self.values))
