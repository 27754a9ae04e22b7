"""Histories: scalar functions of time phi(t) whose variation and breakpoints are known.

The error bound of MATH.md section 4 integrates over steps on which the load is smooth and needs its
variation there, so a history that is data says both. Here are those given by a formula: constant,
polynomial, sine, triangle wave.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sweepopt.checks import HUGE, TIME_SLACK, Array, entries, meaning, number, times
from sweepopt.errors import InputError, shown


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


class NoArithmetic:
    """Says how a sum or a multiple is stated, as data."""

    def _refuse(self, _: Any = None) -> Any:
        raise InputError(
            "loads and histories are not added or multiplied: a sum is one "
            "so.Separable([(phi, f), (psi, g)]), a factor goes into f, an amplitude or a table's "
            "values, a product of two histories is so.Modulated(phi, psi), and a set that a load "
            "moves is so.Moving(C, center=load)"
        )

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __neg__ = _refuse


class History(NoArithmetic):
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
        return self(np.concatenate([[a], self.turning_points(a, b), [b]]))

    def breakpoints(self, a: float, b: float) -> Array:
        """Where phi is not smooth, strictly inside (a, b), increasing."""
        return np.empty(0)

    def piece(self, a: float, b: float) -> Piece:
        """Its closed form on [a, b], where no breakpoint lies between a and b."""
        start, end = self(np.array([a, b]))
        return Piece(a, (float(start), float(end - start) / (b - a)))

    def rate(self) -> History:
        """phi', from the left where it jumps."""
        return Slope(self)

    def slope(self, t: Any) -> Any:
        """phi' at times that are no breakpoints."""
        raise InputError(f"the rate of {shown(self)} is not known; give a Table, Sine or Triangle")


@dataclass(frozen=True)
class Slope(History):
    """phi' of a history that is straight between its breakpoints, from the left where it jumps."""

    history: History

    def __call__(self, t: ArrayLike) -> Any:
        at = as_times(t)
        return self.history.slope(at - TIME_SLACK * abs(at))

    def breakpoints(self, a: float, b: float) -> Array:
        """Those of the history."""
        return self.history.breakpoints(a, b)

    def piece(self, a: float, b: float) -> Piece:
        """A constant."""
        return Piece(a, (float(self.history.slope(0.5 * (a + b))),))


def breakpoints(histories: Iterable[Any], a: float, b: float) -> Array:
    """Breakpoints strictly inside (a, b), increasing, of those histories that know them."""
    known = [one.breakpoints(a, b) for one in histories if hasattr(one, "breakpoints")]
    return np.unique(np.concatenate([np.empty(0), *known]))


def as_times(t: Any) -> Any:
    """The times as floats; of one number a float, as numpy is slow with one."""
    if type(t) is float and abs(t) <= HUGE:
        return t
    array = times(t)
    return array if array.ndim else array.item()


def interval(a: Any, b: Any) -> tuple[float, float]:
    """The ends of [a, b] as floats, in order."""
    a, b = number("a", a), number("b", b)
    if b < a:
        raise InputError(f"b = {b:g} is before a = {a:g}; give an interval [a, b]")
    return a, b


# ---- given by a formula ---------------------------------------------------------------------

MOST_TURNS = 10_000_000
"""Turning points of one history on one interval: 80 MB of them; more are a mistake of units."""


class _Formula(History):
    """A history whose fields are finite numbers, and a period among them positive."""

    def __post_init__(self) -> None:
        for field in fields(self):  # type: ignore[arg-type]
            minimum = 0.0 if field.name == "period" else None
            value = number(field.name, getattr(self, field.name), minimum, strict=True)
            object.__setattr__(self, field.name, value)


@dataclass(frozen=True)
class Constant(_Formula):
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

    def __call__(self, t: ArrayLike) -> Any:
        return self.value + 0.0 * as_times(t)

    def rate(self) -> History:
        """0."""
        return Constant(0.0)


@dataclass(frozen=True, eq=False)
class Polynomial(History):
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
        object.__setattr__(self, "coefficients", entries("coefficients", coefficients))

    def __call__(self, t: ArrayLike) -> Any:
        at = as_times(t)
        with np.errstate(over="ignore", invalid="ignore"):
            value = 0.0 * at
            for coefficient in reversed(self.coefficients.tolist()):
                value = coefficient + value * at
        if not np.isfinite(value).all():
            raise InputError(f"{self!r:.80} overflows at t = {shown(t)}; choose other units")
        return value

    def turning_points(self, a: float, b: float) -> Array:
        """Real parts of the roots of the derivative: more points than needed do no harm."""
        self(np.array([a, b]))  # refuses what overflows
        # in units of the larger time; a leading term that is nothing beside the others has no root
        unit = max(abs(a), abs(b)) or 1.0
        scaled = self.coefficients * unit ** np.arange(self.coefficients.size)
        slope = np.polynomial.Polynomial(scaled).deriv()
        roots = unit * np.sort(slope.trim(1e-30 * np.abs(slope.coef).max()).roots().real)
        return roots[(roots > a) & (roots < b)]

    def piece(self, a: float, b: float) -> Piece:
        """Itself."""
        return Piece(0.0, tuple(self.coefficients.tolist()))

    def rate(self) -> History:
        """The derivative."""
        return Polynomial(np.polynomial.Polynomial(self.coefficients).deriv().coef)

    def __repr__(self) -> str:
        return f"Polynomial({self.coefficients.tolist()})"


class _Periodic(_Formula):
    """A wave with one crest and one trough a period; its first crest is at `crest`."""

    amplitude: float
    period: float

    @property
    def crest(self) -> float:
        """Where one of the crests is."""
        return self.period / 4.0

    def turning_points(self, a: float, b: float) -> Array:
        """Crests and troughs strictly inside (a, b)."""
        half = self.period / 2.0
        if (b - a) / half > MOST_TURNS:
            raise InputError(
                f"period {self.period:g} is too short: there are more than {MOST_TURNS:g} of them "
                f"between t = {a:g} and {b:g}"
            )
        first = math.floor((a - self.crest) / half)
        k = float(first) + np.arange(math.ceil((b - self.crest) / half) + 1 - first)
        points: Any = self.crest + k * half
        return points[(points > a) & (points < b)]

    def variation(self, a: float, b: float) -> float:
        """Total variation on [a, b]: four amplitudes a period, the rest from crest to trough."""
        a, b = interval(a, b)
        part = math.fmod(b - a, self.period)  # exact, however many periods there are
        whole = round((b - a - part) / self.period)
        rest = super().variation(a, a + part if whole else b)
        return 4.0 * abs(self.amplitude) * whole + rest

    def largest(self, a: float, b: float) -> float:
        """The maximum of |phi| on [a, b]: that of one period, however many there are."""
        return super().largest(a, min(b, a + self.period))


@meaning(frequency="; give period, 1 / frequency", omega="; give period, 2 pi / omega")
@dataclass(frozen=True)
class Sine(_Periodic):
    """``phi(t) = offset + amplitude sin(2 pi t / period + phase)``, phase in radians.

    Parameters
    ----------
    amplitude, period, phase, offset : float
        The period is > 0.

    Raises
    ------
    InputError
        If a number is not finite, or the period not positive.

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

    def __call__(self, t: ArrayLike) -> Any:
        angle = 2.0 * math.pi * (as_times(t) / self.period) + self.phase
        wave = math.sin(angle) if type(angle) is float else np.sin(angle)
        return self.offset + self.amplitude * wave

    @property
    def crest(self) -> float:
        """Where 2 pi t / period + phase = pi / 2."""
        return (0.25 - self.phase / (2.0 * math.pi)) * self.period

    def piece(self, a: float, b: float) -> Piece:
        """Itself."""
        wave = (self.amplitude, 2.0 * math.pi / self.period, self.phase)
        return Piece(a, (self.offset,), (wave,))

    def rate(self) -> History:
        """The cosine."""
        speed = 2.0 * math.pi / self.period * self.amplitude
        return Sine(speed, self.period, self.phase + math.pi / 2)


@meaning(frequency="; give period, 1 / frequency")
@dataclass(frozen=True)
class Triangle(_Periodic):
    """Triangular wave from 0 at t = 0 up to `amplitude` at a quarter of the period.

    Parameters
    ----------
    amplitude, period : float
        The period is > 0.

    Raises
    ------
    InputError
        If a number is not finite, or the period not positive.

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

    def __call__(self, t: ArrayLike) -> Any:
        quarters = (4.0 * (as_times(t) / self.period) - 1.0) % 4.0  # after the crest
        return self.amplitude * (abs(quarters - 2.0) - 1.0)

    def breakpoints(self, a: float, b: float) -> Array:
        """Crests and troughs strictly inside (a, b)."""
        return self.turning_points(*interval(a, b))

    def slope(self, t: Any) -> Any:
        """phi' at times that are no breakpoints."""
        falls = (4.0 * (t / self.period) - 1.0) % 4.0 < 2.0
        return self.amplitude * (4.0 - 8.0 * falls) / self.period


@dataclass(frozen=True)
class Modulated(History):
    """``phi(t) = envelope(t) wave(t)``, such as a wave whose amplitude grows.

    Parameters
    ----------
    wave, envelope : History
        Of data, such as Sine and Table.

    Raises
    ------
    InputError
        If one of them is no data, or a product itself.

    Examples
    --------
    >>> from sweepopt.loads import Table
    >>> starts = Modulated(Sine(2.0, period=4.0), Table([0.0, 1.0, 8.0], [0.0, 1.0, 1.0]))
    >>> starts([0.0, 1.0, 3.0]).round(12), starts.breakpoints(0.0, 8.0)
    (array([ 0.,  2., -2.]), array([1.]))
    """

    wave: History
    envelope: History

    def __post_init__(self) -> None:
        for name, one in (("wave", self.wave), ("envelope", self.envelope)):
            if not isinstance(one, History) or isinstance(one, Modulated) or hasattr(one, "dim"):
                raise InputError(
                    f"{name} must be data, such as Sine or Table, no VectorTable and no product "
                    f"itself, got {shown(one)}"
                )

    @property
    def factors(self) -> tuple[History, ...]:
        """The histories that phi is the product of."""
        return self.wave, self.envelope

    def __call__(self, t: ArrayLike) -> Any:
        return self.wave(t) * self.envelope(t)

    def breakpoints(self, a: float, b: float) -> Array:
        """Those of both."""
        return breakpoints(self.factors, a, b)

    def variation(self, a: float, b: float) -> float:
        """A bound of the total variation on [a, b], sup |f| var(g) + sup |g| var(f)."""
        f, g = self.factors
        return f.largest(a, b) * g.variation(a, b) + g.largest(a, b) * f.variation(a, b)

    def largest(self, a: float, b: float) -> float:
        """A bound of |phi| on [a, b]."""
        return self.wave.largest(a, b) * self.envelope.largest(a, b)

    def piece(self, a: float, b: float) -> Piece:
        """Refused: a product has no closed form of this kind."""
        raise InputError(
            "a Modulated history has no closed form of polynomials and sines, as the scheme exact "
            'needs it; take scheme="auto"'
        )

    def rate(self) -> History:
        """Refused: phi' is no product."""
        return self.slope(0.0)
