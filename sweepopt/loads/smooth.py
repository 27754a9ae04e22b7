"""Histories without kinks: a constant, a polynomial."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sweepopt.errors import InputError, shown
from sweepopt.loads.history import (
    Array,
    Piece,
    frozen_vector,
    interval,
    moments,
    numbers,
    variation_through,
)


@dataclass(frozen=True)
class Constant:
    """``phi(t) = value``.

    Parameters
    ----------
    value : float

    Raises
    ------
    InputError
        If the value is not a finite number.

    Examples
    --------
    >>> Constant(3.0)(10.0)
    3.0
    """

    value: float = 1.0

    def __post_init__(self) -> None:
        numbers(self, "value")

    def __call__(self, t: ArrayLike) -> Any:
        at = moments(t)
        return self.value if type(at) is float else np.full(np.shape(at), self.value)

    def variation(self, a: float, b: float) -> float:
        """Zero."""
        return 0.0

    def breakpoints(self, a: float, b: float) -> Array:
        """None."""
        return np.empty(0)

    def piece(self, a: float, b: float) -> Piece:
        """The value."""
        return Piece(a, (self.value,))


@dataclass(frozen=True, eq=False)
class Polynomial:
    """``phi(t) = sum_k coefficients[k] t^k``.

    Parameters
    ----------
    coefficients : array_like, shape (m,)
        The constant one first.

    Raises
    ------
    InputError
        If there are none, or one is not finite; when called, if the value overflows.

    Examples
    --------
    >>> ramp = Polynomial([0.0, 1.5])
    >>> ramp(2.0), Polynomial([0.0, 2.0, -1.0]).variation(0.0, 2.0)
    (3.0, 2.0)
    """

    coefficients: Array

    def __init__(self, coefficients: ArrayLike) -> None:
        object.__setattr__(self, "coefficients", frozen_vector("coefficients", coefficients))

    def __call__(self, t: ArrayLike) -> Any:
        at = moments(t)
        if type(at) is float:
            values = self._at(at)
            finite = math.isfinite(values)
        else:
            with np.errstate(over="ignore", invalid="ignore"):
                values = self._at(at)
            finite = bool(np.isfinite(values).all())
        if not finite:
            raise InputError(f"{self!r:.80} overflows at t = {shown(t)}; choose other units")
        return values

    def _at(self, t: Any) -> Any:
        *lower, highest = self.coefficients.tolist()
        value = highest + 0.0 * t
        for coefficient in reversed(lower):
            value = coefficient + value * t
        return value

    def variation(self, a: float, b: float) -> float:
        """Total variation on [a, b]."""
        a, b = interval(a, b)
        self(np.array([a, b]))  # refuses what overflows
        # in units of the larger time; a leading term that is nothing beside the others has no root
        unit = max(abs(a), abs(b)) or 1.0
        slope = np.polynomial.polynomial.polyder(self.coefficients)
        slope = slope * unit ** np.arange(slope.size)
        slope[np.abs(slope) < 1e-30 * np.abs(slope).max()] = 0.0
        slope = np.trim_zeros(slope, "b")
        turns = unit * np.polynomial.polynomial.polyroots(slope) if slope.size else slope
        turns = np.sort(turns.real)  # more points than needed do no harm
        return variation_through(self, [a, *turns[(turns > a) & (turns < b)], b])

    def breakpoints(self, a: float, b: float) -> Array:
        """None: a polynomial is smooth."""
        return np.empty(0)

    def piece(self, a: float, b: float) -> Piece:
        """Itself."""
        return Piece(0.0, tuple(self.coefficients.tolist()))

    def __repr__(self) -> str:
        return f"Polynomial({self.coefficients.tolist()})"
