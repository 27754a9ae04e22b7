"""Turn what a user passes into finite float arrays, or say which entry is wrong and why."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import scipy.sparse as sp
from scipy.linalg import blas

from sweepopt.errors import InputError, shown

Matrix: TypeAlias = Any  # np.ndarray or scipy.sparse.csc_array, as `matrix` returns them

HUGE = 1e75
"""Numbers beyond this overflow when a few of them are multiplied."""
TIME_SLACK = 1e-12
"""Share of the time scale by which a time may miss a node or a range: rounding of t0 + i mu."""
MOST_UNKNOWNS = 10**9
"""A vector of more of them takes 8 GB, and a step needs a few."""


def number(name: str, value: Any, minimum: float | None = None, strict: bool = False) -> float:
    """A finite float, at least (or above) `minimum`."""
    array = floats(name, value, "one number")
    if array.size != 1:
        raise InputError(f"{name} must be one number, got {array.size} of them")
    result = float(array.ravel()[0])
    if not abs(result) <= HUGE:
        raise _refused(name, result, "a finite number")
    if minimum is not None and (result < minimum or (strict and result == minimum)):
        raise InputError(f"{name} must be {'>' if strict else '>='} {minimum:g}, got {result:g}")
    if strict and minimum == 0:
        divisor(name, result)
    return result


def instant(name: str, value: Any) -> float:
    """A finite time; one that is a float already costs nothing."""
    return value if type(value) is float and value - value == 0 else number(name, value)


def axes(value: Any) -> int:
    """How many axes an array_like has; one if its lists have different lengths."""
    try:
        return np.ndim(value)
    except ValueError:
        return 1


def divisor(name: str, value: float) -> None:
    """Refuse a positive number by which nothing can be divided without overflow."""
    if value < 1 / HUGE:
        raise InputError(
            f"{name} is {value:g}, below {1 / HUGE:g}: what it divides would overflow; choose "
            "other units"
        )


def count(name: str, value: Any, least: int = 1) -> int:
    """A whole number, positive or at least 0."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        wanted = "a positive whole number" if least else "a whole number >= 0"
        raise InputError(f"{name} must be {wanted}, got {shown(value)}")
    return int(value)


def dimension(dim: Any) -> int:
    """A positive whole number of unknowns."""
    size = count("dim", dim)
    if size > MOST_UNKNOWNS:
        raise InputError(
            f"dim is {shown(size)}, more than {MOST_UNKNOWNS:.0e}; no vector fits in memory"
        )
    return size


def choice(name: str, value: Any, allowed: Iterable[str]) -> str:
    """One of the words that are allowed."""
    words = tuple(allowed)
    if not isinstance(value, str) or value not in words:
        raise InputError(f"{name} must be one of {', '.join(words)}; got {shown(value)}")
    return value


def listed(name: str, value: Any) -> tuple[Any, ...]:
    """A list with one entry or more."""
    if not isinstance(value, (list, tuple)) or not value:
        raise InputError(f"{name} must be a list with one entry or more, got {shown(value)}")
    return tuple(value)


def vector(name: str, value: Any, dim: int | None = None, finite: bool = True) -> np.ndarray:
    """A float array of shape (dim,); a scalar counts as one entry."""
    try:  # most are right, and nothing else is looked at
        ready = np.array(unmasked(value))
        if ready.dtype == float and dim and ready.shape == (dim,) and blas.dnrm2(ready) <= HUGE:
            return ready
    except (TypeError, ValueError, OverflowError):
        pass  # said in full below
    array = floats(name, value, "an array of numbers", ndmin=1)
    if array.ndim != 1:
        raise InputError(f"{name} must have one axis, got shape {array.shape}")
    if dim is not None and array.size != dim:
        raise InputError(f"{name} must have {dim} entries, got {array.size}")
    allowed = np.abs(array) <= HUGE
    if not finite:
        allowed |= np.isinf(array)
    if not allowed.all():
        i = int(np.argmin(allowed))
        raise _refused(f"{name}[{i}]", array[i], "finite numbers" if finite else "numbers")
    return array


def entries(name: str, value: Any, finite: bool = True) -> np.ndarray:
    """A float vector with at least one entry: no set lives in a space of dim 0."""
    result = vector(name, value, finite=finite)
    if not result.size:
        raise InputError(f"{name} must have at least one entry")
    return result


def times(name: str, value: Any) -> np.ndarray:
    """Finite times as floats, of any shape; () for one of them."""
    array = floats(name, value, "a time or an array of times")
    allowed = np.abs(array) <= HUGE
    if not allowed.all():
        raise _refused(name, array[~allowed].flat[0], "finite times")
    return array


def is_finite(array: np.ndarray) -> bool:
    """Whether all entries of a vector are finite."""
    # the plain call: scaled, so that it neither overflows nor warns, and quick
    return not array.size or math.isfinite(blas.dnrm2(array))


def matrix(name: str, value: Any) -> Matrix:
    """A finite float matrix with two axes: dense as an ndarray, sparse as CSC."""
    if sp.issparse(value):
        result = sp.csc_array(value)
        entries = result.data = floats(name, result.data, "a matrix of numbers")
    else:
        result = entries = floats(name, value, "a matrix of numbers")
    if result.ndim != 2:
        raise InputError(f"{name} must have two axes, got shape {result.shape}")
    if not (np.abs(entries) <= HUGE).all():
        i, j, entry = _first(result, lambda data: ~(np.abs(data) <= HUGE))
        raise _refused(f"{name}[{i}, {j}]", entry, "finite numbers")
    return result


def symmetric(name: str, value: Any, dim: int | None = None) -> Matrix:
    """A finite symmetric matrix; an asymmetry above rounding is refused with its entry.

    One of rounding is taken out: factors look at one triangle, residuals at both.
    """
    result = matrix(name, value)
    rows, columns = result.shape
    if not rows:
        raise InputError(f"{name} has no entries; give at least one unknown")
    if rows != columns or (dim is not None and rows != dim):
        wanted = "square" if dim is None else f"of shape ({dim}, {dim})"
        raise InputError(f"{name} must be {wanted}, got shape {result.shape}")
    difference = abs(result - result.T)
    if difference.max() > 1e-12 * abs(result).max():
        i, j, _ = _first(difference, lambda data: data == data.max())
        raise InputError(
            f"{name} must be symmetric: {name}[{i}, {j}] = {result[i, j]:.15g} but "
            f"{name}[{j}, {i}] = {result[j, i]:.15g}; pass ({name} + {name}.T) / 2 if that is meant"
        )
    if difference.max() > 0:
        result = matrix(name, 0.5 * (result + result.T))
    return result


def floats(name: str, value: Any, what: str, ndmin: int = 0) -> np.ndarray:
    """A float copy of value; complex numbers and words are refused, not cast."""
    try:
        array = np.array(unmasked(value), ndmin=ndmin)
        if array.dtype.kind not in "biufO":
            raise TypeError(f"entries are {array.dtype}")
        return array.astype(float)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} must be {what}, got {shown(value)} ({error})") from error


def unmasked(value: Any) -> Any:
    """What is masked as nan: under a mask there is any number, a measurement that is missing."""
    if not isinstance(value, np.ma.MaskedArray):
        return value
    return np.ma.filled(value.astype(float), np.nan)


def _refused(name: str, value: float, wanted: str) -> InputError:
    """The error for an entry that is not finite, or too large to be multiplied."""
    if not math.isfinite(value):
        return InputError(f"{name} is {value}; give {wanted}")
    return InputError(
        f"{name} is {value:g}, beyond {HUGE:g}: products overflow; choose other units"
    )


class _Entry(NamedTuple):
    row: int
    column: int
    value: float


def _first(value: Matrix, condition: Callable[[np.ndarray], np.ndarray]) -> _Entry:
    """The first stored entry for which a condition holds."""
    entries = sp.coo_array(value)
    k = int(np.flatnonzero(condition(entries.data))[0])
    return _Entry(int(entries.row[k]), int(entries.col[k]), float(entries.data[k]))
