"""Histories that repeat: a sine, a triangle wave."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sweepopt.errors import InputError
from sweepopt.loads.history import (
    Array,
    Piece,
    interval,
    line,
    moments,
    numbers,
    variation_through,
)

KINKS = 10_000_000  # of one history that are looked at


@dataclass(frozen=True)
class Sine:
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

    def __post_init__(self) -> None:
        numbers(self, "amplitude", "period", "phase", "offset")

    def __call__(self, t: ArrayLike) -> Any:
        angle = 2.0 * math.pi * (moments(t) / self.period) + self.phase
        wave = math.sin(angle) if type(angle) is float else np.sin(angle)
        return self.offset + self.amplitude * wave

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

    def __post_init__(self) -> None:
        numbers(self, "amplitude", "period")

    def __call__(self, t: ArrayLike) -> Any:
        quarters = (4.0 * (moments(t) / self.period)) % 4.0
        if type(quarters) is float:
            rising = min(quarters, 2.0 - quarters) if quarters <= 3.0 else quarters - 4.0
        else:
            rising = np.where(quarters <= 3.0, np.minimum(quarters, 2.0 - quarters), quarters - 4.0)
        return self.amplitude * rising

    def variation(self, a: float, b: float) -> float:
        """Total variation on [a, b]."""
        return _periodic_variation(self, self.amplitude, self.period, self.period / 4.0, a, b)

    def breakpoints(self, a: float, b: float) -> Array:
        """The peaks strictly between a and b."""
        a, b = interval(a, b)
        return _lattice(self.period / 4.0, self.period / 2.0, a, b)

    def piece(self, a: float, b: float) -> Piece:
        """The line between a and b, where no peak lies between them."""
        return line(self, a, b)


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
    a, b = interval(a, b)
    part = math.fmod(b - a, period)  # exact, however many periods there are
    whole = round((b - a - part) / period)
    rest = a + part if whole else b
    turns = _lattice(crest, period / 2.0, a, rest)
    return 4.0 * abs(amplitude) * whole + variation_through(history, [a, *turns, rest])
