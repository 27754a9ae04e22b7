"""What a history is, and what all of them need: a scalar function of time that knows its kinks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sweepopt.checks import HUGE, entries, number, times
from sweepopt.errors import InputError

Array = NDArray[np.float64]


@runtime_checkable
class History(Protocol):
    """A scalar function of time that knows its variation."""

    def __call__(self, t: ArrayLike) -> Any:
        """phi(t), a float of a number and an array of an array."""
        ...

    def variation(self, a: float, b: float) -> float:
        """Exact total variation on [a, b]."""
        ...

    def breakpoints(self, a: float, b: float) -> Array:
        """Kinks strictly inside (a, b), increasing."""
        ...


class Piece(NamedTuple):
    """A history in closed form between two of its kinks.

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


def kinks(histories: Iterable[Any], a: float, b: float) -> Array:
    """Breakpoints strictly between a and b, increasing, of those histories that tell them."""
    found = [one.breakpoints(a, b) for one in histories if hasattr(one, "breakpoints")]
    return np.unique(np.concatenate([np.empty(0), *found]))


def moments(t: Any) -> Any:
    """The times as floats; of one number a float, as numpy is slow with one."""
    if type(t) is float and abs(t) <= HUGE:
        return t
    found = times("t", t)
    return found if found.ndim else found.item()


def numbers(record: object, *names: str) -> None:
    """Make the named fields finite floats; a period must be positive."""
    for name in names:
        minimum = 0.0 if name == "period" else None
        value = number(name, getattr(record, name), minimum, strict=True)
        object.__setattr__(record, name, value)


def frozen_vector(name: str, values: ArrayLike) -> Array:
    array = entries(name, values)
    array.setflags(write=False)
    return array


def line(history: Callable[[ArrayLike], Array], a: float, b: float) -> Piece:
    start, end = history(np.array([a, b]))
    return Piece(a, (float(start), float(end - start) / (b - a)))


def variation_through(history: Callable[[ArrayLike], Array], times: Sequence[float]) -> float:
    """Variation of a history that is monotone between consecutive `times`."""
    return float(np.sum(np.abs(np.diff(history(np.asarray(times, dtype=float))))))


def interval(a: Any, b: Any) -> tuple[float, float]:
    a, b = number("a", a), number("b", b)
    if b < a:
        raise InputError(f"b = {b:g} is before a = {a:g}; give an interval [a, b]")
    return a, b
