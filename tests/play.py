"""Exact trajectories of one unknown, apart from the library.

    -u'(t) in N_{C(t)}(A u' + B u),      C(t) = [f(t) - r(t), f(t) + r(t)]

The body rests while |f - B u| <= r; else it slips, A u' + B u = f - r (forward) or f + r, of which
the solution is known in closed form where f and r are linear beside one sine. Between the zeros of
the derivative F' of that force F, exp(B t / A) u' is monotone, as its derivative is F' exp(B t / A)
/ A: it changes its sign once at most, and bisection finds where. For A = 0 it is the play operator.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import exprel

Points = tuple[list[float], list[float]]


@dataclass(frozen=True)
class Play:
    """One unknown, its load and its friction bound.

    Attributes
    ----------
    A, B, u0 : float
    load, friction : pair of lists
        Times and values; linear between them.
    wave : tuple of float
        Amplitude and frequency of amplitude * sin(frequency * t), which is added to the load.
    """

    A: float
    B: float
    u0: float
    load: Points
    friction: Points
    wave: tuple[float, float] = (0.0, 1.0)

    def f(self, t: float) -> float:
        """The load."""
        amplitude, frequency = self.wave
        return _line(self.load, t)[0] + amplitude * math.sin(frequency * t)

    def r(self, t: float) -> float:
        """The friction bound."""
        return _line(self.friction, t)[0]

    def monotone(self, times: Sequence[float]) -> list[float]:
        """The times, and those between which f - r and f + r are smooth and monotone."""
        inner = {t for t in self.load[0] + self.friction[0] if times[0] < t < times[-1]}
        knots = sorted({*times} | inner)
        amplitude, frequency = self.wave
        turns: set[float] = set()
        for a, b in pairwise(knots if amplitude else ()):
            first, last = (int(t * frequency / math.tau) for t in (a, b))
            (_, slope), (_, less) = (_line(x, 0.5 * (a + b)) for x in (self.load, self.friction))
            for side in (slope - less, slope + less):
                cosine = -side / (amplitude * frequency)
                angle = math.acos(cosine) if abs(cosine) <= 1 else math.inf
                angles = [math.tau * k + x for k in range(first, last + 2) for x in (-angle, angle)]
                turns |= {t for x in angles if a < (t := x / frequency) < b}
        return sorted({*knots} | turns)

    def states(self, times: Sequence[float]) -> np.ndarray:
        """u at increasing times, the first of which is the start."""
        u, known = self.u0, {times[0]: self.u0}
        side = self._outside(u, times[0])
        for a, b in pairwise(self.monotone(times)):
            u, side = self._advanced(u, side, a, b)
            known[b] = u
        return np.array([known[t] for t in times])

    def _advanced(self, u: float, side: int, a: float, b: float) -> tuple[float, int]:
        """State and direction of slip at b, f - r and f + r being smooth and monotone before."""
        if self.A == 0:
            low, high = (self.f(b) - s * self.r(b) for s in (1, -1))
            return min(max(u, low / self.B), high / self.B), 0
        if a == b:
            return u, side
        if side:
            end, velocity = self._slip(u, side, a, b)
            if side * velocity >= 0:
                return end, side
            stop = _first(lambda t: side * self._slip(u, side, a, t)[1] < 0, a, b)
            return self._advanced(self._slip(u, side, a, stop)[0], 0, stop, b)
        exit_ = self._outside(u, b)
        if not exit_:
            return u, 0
        # f - r may come to B u before f + r does, or after
        return self._advanced(u, exit_, _first(lambda t: self._outside(u, t) == exit_, a, b), b)

    def _outside(self, u: float, t: float) -> int:
        """Whether B u lies below C(t), 1, above, -1, or in it."""
        force, r = self.f(t) - self.B * u, self.r(t)
        return (force > r) - (force < -r)

    def _slip(self, u: float, side: int, a: float, t: float) -> tuple[float, float]:
        """u and u' at t of a body that slips from u at a on: the closed form."""
        A, B, tau = self.A, self.B, t - a
        (_, slope), (_, less) = (_line(x, 0.5 * (a + t)) for x in (self.load, self.friction))
        force = _line(self.load, a)[0] - side * self.r(a) - B * u
        slope -= side * less
        x = B * tau / A
        decay, once = math.exp(-x), float(exprel(-x))  # exprel(x) = (exp(x) - 1) / x
        twice = (1 - once) / x if x > 1e-3 else 0.5 - x / 6 + x**2 / 24
        amplitude, frequency = self.wave
        share = amplitude / (B**2 + (A * frequency) ** 2)

        def wave(at: float) -> complex:
            """The steady response: u, and u' / frequency as the imaginary part."""
            sine, cosine = math.sin(frequency * at), math.cos(frequency * at)
            A_w = A * frequency
            return share * complex(B * sine - A_w * cosine, B * cosine + A_w * sine)

        start, end = wave(a).real, wave(t)
        moved = u + tau * (force * once + slope * tau * twice) / A + end.real - start * decay
        velocity = (force * decay + slope * tau * once + start * B * decay) / A
        return moved, velocity + frequency * end.imag


def _line(points: Points, t: float) -> tuple[float, float]:
    """Value and slope of lines through points."""
    times, values = points
    k = min(max(bisect_right(times, t), 1), len(times) - 1)
    slope = (values[k] - values[k - 1]) / (times[k] - times[k - 1])
    return values[k - 1] + slope * (t - times[k - 1]), slope


def _first(holds: Callable[[float], bool], a: float, b: float) -> float:
    """The first number in (a, b] for which it holds, as it does for b and all after the first."""
    while a < (middle := 0.5 * (a + b)) < b:
        a, b = (a, middle) if holds(middle) else (middle, b)
    return b
