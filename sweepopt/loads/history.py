"""Histories: scalar functions of time phi(t) whose variation and breakpoints are known.

The error bound of MATH.md section 4 integrates over steps on which the load is smooth and needs its
variation there, so a history that is data says both.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sweepopt.checks import HUGE, entries, number, times
from sweepopt.errors import InputError

Array = NDArray[np.float64]


class Piece(NamedTuple):
    """A history in closed form between two of its breakpoints.

    phi(t) = sum_k polynomial[k] (t - origin)^k + sum_j a_j sin(w_j t + p_j).

    Attributes
    ----------
    origin : float
    polynomial : tuple of float
        Coefficients, the constant one first.
    waves : tuple of (a, w, p)
    """

    origin: float
    polynomial: tuple[float, ...]
    waves: tuple[tuple[float, float, float], ...] = ()


class History:
    """Data of the library: monotone between turning points, straight unless a class says more.

    A user's own history is any function of time; one with `variation` and `breakpoints` too gets
    error bounds.
    """

    def __call__(self, t: ArrayLike) -> Any:
        """phi(t), a float of a number and an array of an array."""
        raise NotImplementedError

    def turning_points(self, a: float, b: float) -> Array:
        """Points strictly inside (a, b), increasing, between which phi is monotone."""
        return self.breakpoints(a, b)

    def variation(self, a: float, b: float) -> float:
        """Exact total variation on [a, b]."""
        return float(np.sum(np.abs(np.diff(self._extremes(a, b)))))

    def largest(self, a: float, b: float) -> float:
        """The maximum of |phi| on [a, b]."""
        return float(np.abs(self._extremes(a, b)).max())

    def _extremes(self, a: float, b: float) -> Array:
        a, b = interval(a, b)
        return np.asarray(self(np.concatenate([[a], self.turning_points(a, b), [b]])))

    def breakpoints(self, a: float, b: float) -> Array:
        """Where phi is not smooth, strictly inside (a, b), increasing."""
        return np.empty(0)

    def piece(self, a: float, b: float) -> Piece:
        """Its closed form on [a, b], where no breakpoint lies between a and b."""
        start, end = self(np.array([a, b]))
        return Piece(a, (float(start), float(end - start) / (b - a)))


def breakpoints(histories: Iterable[Any], a: float, b: float) -> Array:
    """Breakpoints strictly inside (a, b), increasing, of those histories that know them."""
    known = [one.breakpoints(a, b) for one in histories if hasattr(one, "breakpoints")]
    return np.unique(np.concatenate([np.empty(0), *known]))


def as_times(t: Any) -> Any:
    """The times as floats; of one number a float, as numpy is slow with one."""
    if type(t) is float and abs(t) <= HUGE:
        return t
    array = times("t", t)
    return array if array.ndim else array.item()


def read_only(name: str, values: ArrayLike) -> Array:
    """A vector of finite numbers that nobody can change."""
    array = entries(name, values)
    array.setflags(write=False)
    return array


def interval(a: Any, b: Any) -> tuple[float, float]:
    """The ends of [a, b] as floats, in order."""
    a, b = number("a", a), number("b", b)
    if b < a:
        raise InputError(f"b = {b:g} is before a = {a:g}; give an interval [a, b]")
    return a, b
