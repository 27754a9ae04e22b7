"""Loads as data: scalar histories and ``f(t) = sum_k phi_k(t) f_k``.

A guaranteed error bound needs the variation of the load on a step, and a cheap step needs the
load's few shapes. A black-box callable has neither, so histories here are small records that know
their exact variation and their kinks, and `Separable` keeps shapes and histories apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sweepopt.checks import HUGE, number, times, vector
from sweepopt.csvtable import read_columns
from sweepopt.errors import InputError, shown

Array = NDArray[np.float64]

KINKS = 10_000_000  # of one history that are looked at
TIME_SLACK = 1e-12
"""Share of the time scale by which a time may miss a table's range: rounding of ``t0 + i mu``."""


@runtime_checkable
class History(Protocol):
    """A scalar function of time that knows its variation; `phi(t)` takes a scalar or an array."""

    def __call__(self, t: ArrayLike) -> Array: ...

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


@dataclass(frozen=True)
class Constant:
    """``phi(t) = value``.

    Examples
    --------
    >>> Constant(3.0)(10.0)
    array(3.)
    """

    value: float = 1.0

    def __post_init__(self) -> None:
        _numbers(self, "value")

    def __call__(self, t: ArrayLike) -> Array:
        return np.full(np.shape(_times(t)), self.value)

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

    Examples
    --------
    >>> ramp = Polynomial([0.0, 1.5])
    >>> ramp(2.0), Polynomial([0.0, 2.0, -1.0]).variation(0.0, 2.0)
    (array(3.), 2.0)
    """

    coefficients: Array

    def __init__(self, coefficients: ArrayLike) -> None:
        object.__setattr__(self, "coefficients", _frozen_vector("coefficients", coefficients))

    def __call__(self, t: ArrayLike) -> Array:
        with np.errstate(over="ignore", invalid="ignore"):
            values = np.asarray(np.polynomial.polynomial.polyval(_times(t), self.coefficients))
        if not np.isfinite(values).all():
            raise InputError(f"{self!r:.80} overflows at t = {shown(t)}; choose other units")
        return values

    def variation(self, a: float, b: float) -> float:
        """Total variation on [a, b]."""
        a, b = _interval(a, b)
        self(np.array([a, b]))  # refuses what overflows
        # in units of the larger time; a leading term that is nothing beside the others has no root
        unit = max(abs(a), abs(b)) or 1.0
        slope = np.polynomial.polynomial.polyder(self.coefficients)
        slope = slope * unit ** np.arange(slope.size)
        slope[np.abs(slope) < 1e-30 * np.abs(slope).max()] = 0.0
        slope = np.trim_zeros(slope, "b")
        turns = unit * np.polynomial.polynomial.polyroots(slope) if slope.size else slope
        turns = np.sort(turns.real)  # more points than needed do no harm
        return _variation_through(self, [a, *turns[(turns > a) & (turns < b)], b])

    def breakpoints(self, a: float, b: float) -> Array:
        """None: a polynomial is smooth."""
        return np.empty(0)

    def piece(self, a: float, b: float) -> Piece:
        """Itself."""
        return Piece(0.0, tuple(self.coefficients.tolist()))

    def __repr__(self) -> str:
        return f"Polynomial({self.coefficients.tolist()})"


@dataclass(frozen=True)
class Sine:
    """``phi(t) = offset + amplitude sin(2 pi t / period + phase)``, phase in radians.

    Examples
    --------
    >>> wave = Sine(amplitude=2.0, period=4.0)
    >>> round(float(wave(1.0)), 12), wave.variation(0.0, 4.0)
    (2.0, 8.0)
    """

    amplitude: float
    period: float
    phase: float = 0.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        _numbers(self, "amplitude", "period", "phase", "offset")

    def __call__(self, t: ArrayLike) -> Array:
        angle = 2.0 * np.pi * (_times(t) / self.period) + self.phase
        return np.asarray(self.offset + self.amplitude * np.sin(angle))

    def variation(self, a: float, b: float) -> float:
        """Total variation on [a, b]: four amplitudes a period, the rest from crest to crest."""
        crest = (0.25 - self.phase / (2.0 * math.pi)) * self.period
        return _periodic_variation(self, self.amplitude, self.period, crest, a, b)

    def breakpoints(self, a: float, b: float) -> Array:
        """None: a sine is smooth."""
        return np.empty(0)

    def piece(self, a: float, b: float) -> Piece:
        """Itself."""
        wave = (self.amplitude, 2.0 * math.pi / self.period, self.phase)
        return Piece(a, (self.offset,), (wave,))


@dataclass(frozen=True)
class Triangle:
    """Triangular wave from 0 at t = 0 up to `amplitude` at a quarter of the period.

    Examples
    --------
    >>> wave = Triangle(amplitude=2.0, period=4.0)
    >>> wave([0.0, 0.5, 1.0, 2.0, 3.0])
    array([ 0.,  1.,  2.,  0., -2.])
    >>> wave.breakpoints(0.0, 4.0), wave.variation(0.5, 1.5)
    (array([1., 3.]), 2.0)
    """

    amplitude: float
    period: float

    def __post_init__(self) -> None:
        _numbers(self, "amplitude", "period")

    def __call__(self, t: ArrayLike) -> Array:
        quarters = (4.0 * (_times(t) / self.period)) % 4.0
        if type(quarters) is float:
            rising = min(quarters, 2.0 - quarters) if quarters <= 3.0 else quarters - 4.0
            return np.asarray(self.amplitude * rising)
        rising = np.where(quarters <= 3.0, np.minimum(quarters, 2.0 - quarters), quarters - 4.0)
        return np.asarray(self.amplitude * rising)

    def variation(self, a: float, b: float) -> float:
        """Total variation on [a, b]."""
        return _periodic_variation(self, self.amplitude, self.period, self.period / 4.0, a, b)

    def breakpoints(self, a: float, b: float) -> Array:
        """The peaks strictly between a and b."""
        a, b = _interval(a, b)
        return _lattice(self.period / 4.0, self.period / 2.0, a, b)

    def piece(self, a: float, b: float) -> Piece:
        """The line between a and b, where no peak lies between them."""
        return _line(self, a, b)


@dataclass(frozen=True, eq=False)
class Table:
    """Piecewise linear history through measured points.

    Parameters
    ----------
    times : array_like, shape (m,)
        Strictly increasing; nothing is said, hence nothing answered, outside them.
    values : array_like, shape (m,)

    Examples
    --------
    >>> force = Table([0.0, 1.0, 3.0], [0.0, 2.0, 1.0])
    >>> force([0.5, 2.0]), force.variation(0.5, 2.0)
    (array([1. , 1.5]), 1.5)
    """

    times: Array
    values: Array

    def __init__(self, times: ArrayLike, values: ArrayLike) -> None:
        points = check_points("times", times, values)
        object.__setattr__(self, "times", points[0])
        object.__setattr__(self, "values", points[1])

    @classmethod
    def from_csv(
        cls, path: str | Path, column: str, *, time: str = "t", scale: float = 1.0
    ) -> Table:
        """Read two columns of a CSV file.

        Parameters
        ----------
        path : str or Path
            First line that is neither empty nor a ``#`` comment: the column names.
        column, time : str
            Names of the value and of the time column.
        scale : float
            Factor on the values, e.g. 1e3 for kPa to Pa.

        Raises
        ------
        InputError
            Naming the file, the column and the row (line of the file) at fault.
        """
        factor = number("scale", scale)
        (times, values), rows = read_columns(path, time, column)
        late = np.flatnonzero(np.diff(times) <= 0.0)
        if late.size:
            k = int(late[0]) + 1
            raise InputError(
                f"{path}, column {time!r}, row {rows[k]}: time {times[k]:g} does not come after "
                f"{times[k - 1]:g}; times must increase strictly"
            )
        if len(times) < 2:
            raise InputError(f"{path}: {len(times)} data rows; a history needs two or more")
        return cls(times, factor * values)

    def __call__(self, t: ArrayLike) -> Array:
        at = _times(t)
        first, last = self.times[0], self.times[-1]
        if type(at) is float and first <= at <= last:
            return np.asarray(np.interp(at, self.times, self.values))
        slack = TIME_SLACK * max(abs(first), abs(last))
        outside = ~((at >= first - slack) & (at <= last + slack))
        if np.any(outside):
            raise InputError(
                f"t = {np.asarray(at)[outside].flat[0]:g} lies outside the table, which covers "
                f"[{first:g}, {last:g}]; extend the table or shorten the run"
            )
        return np.asarray(np.interp(at, self.times, self.values))

    def variation(self, a: float, b: float) -> float:
        """Total variation on [a, b]."""
        a, b = _interval(a, b)
        return _variation_through(self, [a, *self.breakpoints(a, b), b])

    def breakpoints(self, a: float, b: float) -> Array:
        """The table's times strictly between a and b."""
        a, b = _interval(a, b)
        inside = slice(
            np.searchsorted(self.times, a, side="right"), np.searchsorted(self.times, b, "left")
        )
        return self.times[inside]

    def piece(self, a: float, b: float) -> Piece:
        """The line between a and b, where no time of the table lies between them."""
        return _line(self, a, b)

    def __repr__(self) -> str:
        return f"Table({self.times.size} points on [{self.times[0]:g}, {self.times[-1]:g}])"


DATA = (Constant, Polynomial, Sine, Triangle, Table)  # histories that take all times at once


class Separable:
    """A load ``f(t) = sum_k phi_k(t) f_k``.

    Parameters
    ----------
    terms : iterable of (callable, array_like of shape (dim,))
        Histories ``phi_k`` and shapes ``f_k``.

    Attributes
    ----------
    terms : tuple of (callable, ndarray)
    shapes : ndarray, shape (dim, k)
        The shapes as columns, so that one evaluation is one product.
    dim : int

    Examples
    --------
    >>> f = Separable([(Constant(1.0), [1.0, 0.0]), (Sine(1.0, period=4.0), [0.0, 2.0])])
    >>> f(1.0)
    array([1., 2.])
    >>> f.variation(0.0, 4.0)
    8.0
    """

    def __init__(self, terms: Iterable[tuple[Callable[[float], ArrayLike], ArrayLike]]) -> None:
        try:
            pairs = list(terms)
        except TypeError:  # also of an array without axes, which has an __iter__
            pairs = []
        if not pairs:
            raise InputError(f"terms must hold one pair (phi, f) or more, got {shown(terms)}")
        columns = []
        for k, pair in enumerate(pairs):
            try:
                history, shape = pair
            except (TypeError, ValueError):
                raise InputError(f"terms[{k}] must be a pair (phi, f), got {shown(pair)}") from None
            if not callable(history):
                raise InputError(f"terms[{k}][0] must be callable, got {shown(history)}")
            columns.append(_frozen_vector(f"terms[{k}][1]", shape))
            if columns[k].size != columns[0].size:
                raise InputError(
                    f"terms[{k}][1] has {columns[k].size} entries, terms[0][1] has "
                    f"{columns[0].size}; all must agree"
                )
        self.shapes: Array = np.column_stack(columns)
        self.shapes.setflags(write=False)
        self.terms = tuple((pair[0], column) for pair, column in zip(pairs, columns, strict=True))
        self.dim: int = self.shapes.shape[0]

    def coefficients(self, t: float) -> Array:
        """Values ``phi_k(t)``, shape (k,)."""
        return np.array([self.value(k, t) for k in range(len(self.terms))])

    def values(self, times: Array) -> Array:
        """Values ``phi_k(t)`` at many times, shape (len(times), k)."""
        table = np.empty((len(times), len(self.terms)))
        for k, (history, _) in enumerate(self.terms):
            values = history(times) if isinstance(history, DATA) else None
            if values is None or not np.isfinite(values).all():
                values = [self.value(k, t) for t in times.tolist()]
            table[:, k] = values
        return table

    def value(self, k: int, t: float) -> float:
        """phi_k(t)."""
        value = self.terms[k][0](t)
        if type(value) is np.ndarray and value.size == 1 and value.dtype == float:
            value = value.item()
        if type(value) is float and math.isfinite(value):
            return value
        if type(value) is not float:
            entries = np.asarray(value, dtype=object)
            value = entries.item() if entries.size == 1 else entries.tolist()
        if not isinstance(value, Real) or not math.isfinite(value):
            raise InputError(
                f"terms[{k}][0] is {shown(value)} at t = {t:g}; it must be one finite number"
            )
        return float(value)

    def at_many(self, times: Array) -> Array:
        """The load at many times, shape (len(times), dim)."""
        return np.asarray(self.values(times) @ self.shapes.T)

    def __call__(self, t: float) -> Array:
        return np.asarray(self.shapes.dot(self.coefficients(t)))

    def variation(self, a: float, b: float, norm: Callable[[Array], float] | None = None) -> float:
        """Upper bound ``sum_k var(phi_k; a, b) |f_k|`` of the load's variation on [a, b].

        Parameters
        ----------
        norm : callable, optional
            The norm of forces; Euclidean by default. The theory's is the dual norm of A.
        """
        total = 0.0
        for k, (history, shape) in enumerate(self.terms):
            if not hasattr(history, "variation"):
                raise InputError(
                    f"terms[{k}][0], {shown(history)}, does not tell its variation; use Table, "
                    "Sine, Triangle, Polynomial or Constant, or give it a method variation(a, b)"
                )
            size = np.linalg.norm(shape) if norm is None else norm(shape)
            total += float(history.variation(a, b)) * float(size)
        return total

    def breakpoints(self, a: float, b: float) -> Array:
        """Kinks of all histories strictly between a and b, increasing."""
        return kinks((history for history, _ in self.terms), a, b)

    def __repr__(self) -> str:
        return f"Separable({len(self.terms)} terms, dim {self.dim})"


def kinks(histories: Iterable[Any], a: float, b: float) -> Array:
    """Breakpoints strictly between a and b, increasing, of those histories that tell them."""
    found = [one.breakpoints(a, b) for one in histories if hasattr(one, "breakpoints")]
    return np.unique(np.concatenate([np.empty(0), *found]))


def check_points(name: str, times: ArrayLike, values: ArrayLike) -> tuple[Array, Array]:
    """The points of a table as read-only vectors; `name` is what errors call its times."""
    t, phi = _frozen_vector(name, times), _frozen_vector("values", values)
    if t.size < 2:
        raise InputError(f"{name} must have two entries or more; for one value, use Constant")
    if phi.shape != t.shape:
        raise InputError(f"values has {phi.size} entries for {t.size} times; give one each")
    late = np.flatnonzero(np.diff(t) < 1 / HUGE)
    if late.size:
        k = int(late[0])
        raise InputError(
            f"{name} must increase strictly, but entry {k + 1} ({t[k + 1]:g}) follows "
            f"entry {k} ({t[k]:g}); sort the table and keep one value a time"
        )
    return t, phi


def _times(t: Any) -> Any:
    """The times as floats; one float stays what it is, as numpy is slow with one number."""
    return t if type(t) is float and abs(t) <= HUGE else times("t", t)


def _numbers(record: object, *names: str) -> None:
    """Make the named fields finite floats; a period must be positive."""
    for name in names:
        minimum = 0.0 if name == "period" else None
        value = number(name, getattr(record, name), minimum, strict=True)
        object.__setattr__(record, name, value)


def _frozen_vector(name: str, values: ArrayLike) -> Array:
    array = vector(name, values)
    if array.size == 0:
        raise InputError(f"{name} must not be empty")
    array.setflags(write=False)
    return array


def _line(history: Callable[[ArrayLike], Array], a: float, b: float) -> Piece:
    start, end = history(np.array([a, b]))
    return Piece(a, (float(start), float(end - start) / (b - a)))


def _variation_through(history: Callable[[ArrayLike], Array], times: Sequence[float]) -> float:
    """Variation of a history that is monotone between consecutive `times`."""
    return float(np.sum(np.abs(np.diff(history(np.asarray(times, dtype=float))))))


def _interval(a: Any, b: Any) -> tuple[float, float]:
    a, b = number("a", a), number("b", b)
    if b < a:
        raise InputError(f"b = {b:g} is before a = {a:g}; give an interval [a, b]")
    return a, b


def _lattice(origin: float, step: float, a: float, b: float) -> Array:
    """Points ``origin + k step`` strictly between a and b."""
    if (b - a) / step > KINKS:
        raise InputError(
            f"period {2 * step:g} is too short: there are more than {KINKS:g} of them between "
            f"t = {a:g} and {b:g}"
        )
    first = math.floor((a - origin) / step)
    k = float(first) + np.arange(math.ceil((b - origin) / step) + 1 - first)
    points = origin + k * step
    return np.asarray(points[(points > a) & (points < b)])


def _periodic_variation(
    history: Callable[[ArrayLike], Array],
    amplitude: float,
    period: float,
    crest: float,
    a: float,
    b: float,
) -> float:
    """Whole periods count four amplitudes each, so a long interval costs no more than a short."""
    a, b = _interval(a, b)
    part = math.fmod(b - a, period)  # exact, however many periods there are
    whole = round((b - a - part) / period)
    rest = a + part if whole else b
    turns = _lattice(crest, period / 2.0, a, rest)
    return 4.0 * abs(amplitude) * whole + _variation_through(history, [a, *turns, rest])
