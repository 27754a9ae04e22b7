"""Exact trajectories of one unknown, and what a scheme should make of them, apart from the library.

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
from itertools import pairwise, product
from typing import Any

import numpy as np

from sweepopt.integrate import Scheme

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

    def marks(self, times: Sequence[float]) -> list[float]:
        """The times, all knots and turning points of f - r and f + r between them, in order."""
        knots = sorted({*times, *self.load[0], *self.friction[0]})
        knots = [t for t in knots if times[0] <= t <= times[-1]]
        amplitude, frequency = self.wave
        if not amplitude:
            return knots
        marks = set(knots)
        for a, b in pairwise(knots):
            slope, less = _line(self.load, 0.5 * (a + b))[1], _line(self.friction, 0.5 * (a + b))[1]
            for side in (slope - less, slope + less):
                cosine = -side / (amplitude * frequency)
                if abs(cosine) <= 1:
                    angle = math.acos(cosine)
                    first = math.floor(a * frequency / math.tau) - 1
                    last = math.ceil(b * frequency / math.tau) + 1
                    places = product(range(first, last + 1), (-angle, angle))
                    turns = [(math.tau * k + one) / frequency for k, one in places]
                    marks.update(t for t in turns if a < t < b)
        return sorted(marks)

    def ways(self, times: Sequence[float]) -> np.ndarray:
        """How far f and r go between the times, together."""
        marks = self.marks(times)
        forces = [[self.f(t), self.r(t)] for t in marks]
        way = np.append(0.0, np.cumsum(abs(np.diff(forces, axis=0)).sum(axis=1)))
        return np.diff(way[np.searchsorted(marks, times)])

    def states(self, times: Sequence[float]) -> np.ndarray:
        """u at increasing times, the first of which is the start."""
        u, side, known = self.u0, 0, {times[0]: self.u0}
        force = self.f(times[0]) - self.B * u
        if abs(force) > self.r(times[0]):
            side = 1 if force > 0 else -1
        for a, b in pairwise(self.marks(times)):
            u, side = self._advanced(u, side, a, b)
            known[b] = u
        return np.array([known[t] for t in times])

    def _advanced(self, u: float, side: int, a: float, b: float) -> tuple[float, int]:
        """State and direction of slip at b, f - r and f + r being smooth and monotone before."""
        if self.A == 0:
            low, high = (self.f(b) - s * self.r(b) for s in (1, -1))
            return min(max(u, low / self.B), high / self.B), 0
        while a < b:
            if side == 0:
                # f - r may come to B u before f + r does, or after
                exits = [(self._exit(u, s, a, b), s) for s in (1, -1) if self._outside(u, b) == s]
                if not exits:
                    return u, 0
                a, side = min(exits)
                continue
            if side * self._slip(u, side, a, b)[1] >= 0:
                return self._slip(u, side, a, b)[0], side
            end = self._stop(u, side, a, b)
            u, side, a = self._slip(u, side, a, end)[0], 0, end
        return u, side

    def _exit(self, u: float, side: int, a: float, b: float) -> float:
        """When a body at rest is moved."""
        return _first(lambda t: self._outside(u, t) == side, a, b)

    def _stop(self, u: float, side: int, a: float, b: float) -> float:
        """When a body that slips comes to rest."""
        return _first(lambda t: side * self._slip(u, side, a, t)[1] < 0, a, b)

    def _outside(self, u: float, t: float) -> int:
        """Whether B u lies below C(t), 1, above, -1, or in it."""
        force, r = self.f(t) - self.B * u, self.r(t)
        return (force > r) - (force < -r)

    def _slip(self, u: float, side: int, a: float, t: float) -> tuple[float, float]:
        """u and u' at t of a body that slips from u at a on: the closed form."""
        A, B, tau = self.A, self.B, t - a
        middle = 0.5 * (a + t)
        (_, slope), (_, less) = _line(self.load, middle), _line(self.friction, middle)
        force = _line(self.load, a)[0] - side * self.r(a) - B * u
        slope -= side * less
        x = B * tau / A
        decay = math.exp(-x)
        once = -math.expm1(-x) / x if x else 1.0
        twice = (x + math.expm1(-x)) / x**2 if x > 0.1 else _series(x)
        moved = u + force / A * tau * once + slope / A * tau**2 * twice
        velocity = force / A * decay + slope / A * tau * once
        amplitude, frequency = self.wave
        share = amplitude / (B**2 + (A * frequency) ** 2)

        def wave(at: float) -> float:
            return share * (B * math.sin(frequency * at) - A * frequency * math.cos(frequency * at))

        rate = B * math.cos(frequency * t) + A * frequency * math.sin(frequency * t)
        moved += wave(t) - wave(a) * decay
        return moved, velocity + share * frequency * rate + B / A * wave(a) * decay

    def step(self, scheme: Scheme, u: float, t: float, mu: float) -> tuple[float, list[float]]:
        """The state after a step of a scheme from u at t, and the velocities of its stages."""
        stages: list[float] = []
        for row, c in zip(scheme.a, scheme.c, strict=True):
            at = t + c * mu
            state = u + mu * sum(a * z for a, z in zip(row, stages, strict=False))
            force, r = self.f(at) - self.B * state, self.r(at)
            slip = math.copysign(max(abs(force) - r, 0.0), force)
            stages.append(slip / (self.A + mu * row[-1] * self.B))
        return u + mu * sum(b * z for b, z in zip(scheme.b, stages, strict=True)), stages


def least_slope(scheme: Scheme, mu_Lam: float) -> float:
    """The least slope of u_i -> u_{i+1} in a step of a scheme; the largest is 1, at rest.

    It is linear while each stage slips or rests; slipping ones have the velocities of a linear
    problem.
    """
    found = []
    for slips in product((0, 1), repeat=len(scheme.b)):
        stages: list[float] = []
        for on, row in zip(slips, scheme.a, strict=True):
            known = 1 + sum(a * z for a, z in zip(row, stages, strict=False))
            implicit = row[-1] + (1 / mu_Lam if mu_Lam else math.inf)
            stages.append(-on * known / implicit if implicit else -on * known * mu_Lam)
        found.append(1 + sum(b * z for b, z in zip(scheme.b, stages, strict=True)))
    return min(found)


def _line(points: Points, t: float) -> tuple[float, float]:
    """Value and slope of lines through points."""
    times, values = points
    k = min(max(bisect_right(times, t), 1), len(times) - 1)
    slope = (values[k] - values[k - 1]) / (times[k] - times[k - 1])
    return values[k - 1] + slope * (t - times[k - 1]), slope


def _series(x: float) -> float:
    """(x - 1 + exp(-x)) / x^2 for small x."""
    return sum((-x) ** k / math.factorial(k + 2) for k in range(12))


def _first(holds: Callable[[float], Any], a: float, b: float) -> float:
    """The first number in (a, b] for which it holds, as it does for b and all after the first."""
    while a < (middle := 0.5 * (a + b)) < b:
        a, b = (a, middle) if holds(middle) else (middle, b)
    return b
