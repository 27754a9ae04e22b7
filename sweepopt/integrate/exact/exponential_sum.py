"""Sums of powers and exponentials: all that moves between two switches.

    f(tau) = Re( sum_k a_k (tau / length)^k + sum_j c_j exp(z_j tau) ),   Re z_j <= 0,

on [0, length]: a wave is an exponential of imaginary rate. Exponentials with |z| length <= 1 are
written as power series: where they cancel powers, no digits are lost.

The first time at which one of several turns negative cannot be missed: a bound M of |f''| on all of
the rest proves f > 0 up to the root of f + f' h - M h^2 / 2. Each step is the largest that is
proved free of roots; from the left it converges to a simple root like Newton's method. An entry
whose slowest decay outweighs all others needs no steps: it stays positive.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from typing import Any

import numpy as np

from sweepopt.checks import Array
from sweepopt.errors import SweepoptError
from sweepopt.linalg import EPS
from sweepopt.loads import Piece
from sweepopt.sets import ROUNDING

TERMS = 20  # of the power series where |z| length <= 1, and 1 / 20! is below rounding


@dataclass(frozen=True, eq=False)
class ExponentialSum:
    """A vector-valued sum of powers and exponentials on [0, length].

    Attributes
    ----------
    weights : ndarray, complex, shape (rows, degree + 1 + l)
        Those of the powers first; only the real part of the sum counts.
    rates : ndarray, complex, shape (l,)
    length : float
    """

    weights: Array
    rates: Array
    length: float

    @cached_property
    def degree(self) -> int:
        """The highest power."""
        return self.weights.shape[1] - self.rates.size - 1

    @cached_property
    def powers(self) -> Array:
        """0, 1, ..., degree."""
        return np.arange(self.degree + 1)

    @cached_property
    def sizes(self) -> Array:
        """Absolute weights; times `bound` they bound the function."""
        return np.abs(self.weights)

    def basis(self, tau: Any) -> Array:
        """The powers and exponentials at tau, shape (..., degree + 1 + l)."""
        tau = np.asarray(tau, dtype=float)[..., None]
        return np.concatenate(
            [(tau / self.length) ** self.powers, np.exp(self.rates * tau)], axis=-1
        )

    def bound(self, tau: float) -> Array:
        """Bounds of their absolute values on [tau, length]."""
        return np.append(np.ones(self.degree + 1), np.exp(self.rates.real * tau))

    def __call__(self, tau: Any) -> Array:
        """Values, shape (rows,) or (k, rows)."""
        return (self.basis(tau) @ self.weights.T).real

    def with_weights(self, weights: Array) -> ExponentialSum:
        """Another sum of the same functions."""
        return ExponentialSum(weights, self.rates, self.length)

    def derivative(self) -> ExponentialSum:
        """The derivative in tau."""
        W, end = self.weights, self.degree
        D = np.zeros_like(W)
        D[:, :end] = W[:, 1 : end + 1] * (self.powers[1:] / self.length)
        D[:, end + 1 :] = W[:, end + 1 :] * self.rates
        return self.with_weights(D)

    def taylor(self) -> Iterator[tuple[Array, Array]]:
        """Coefficients of 1, tau, tau^2, ... and the size of the terms that they are sums of."""
        f, start = self, self.basis(0.0).real
        for k in count(1):
            yield (f.weights @ start).real, f.sizes @ start
            f = f.with_weights(f.derivative().weights / k)

    def extended(self, lam: Array) -> ExponentialSum:
        """The same function, with room for exp(-lam tau): see `decay`."""
        fast = lam[lam * self.length > 1]
        terms = TERMS if fast.size < lam.size else 0
        powers, exponentials = np.split(self.weights, [self.degree + 1], axis=1)
        more = np.zeros((len(powers), terms)), np.zeros((len(powers), fast.size))
        weights = np.hstack([powers, more[0], exponentials, more[1]])
        return ExponentialSum(weights, np.append(self.rates, -fast), self.length)


def histories(pieces: list[Piece], s: float, length: float) -> ExponentialSum:
    """phi(s + tau) for 0 <= tau <= length of histories in closed form, a row each.

    Powers have an imaginary part: `taylor` then has the size of the slow wave, or of the terms of a
    polynomial at s, which is that of its rounding, also where the wave or the polynomial is zero.
    """
    rates = {w for piece in pieces for _, w, _ in piece.waves}
    fast = sorted(w for w in rates if abs(w) * length > 1)
    terms = TERMS + 1 if len(fast) < len(rates) else 1
    terms = max(terms, *(len(piece.polynomial) for piece in pieces))
    weights = np.zeros((len(pieces), terms + len(fast)), dtype=complex)
    for row, piece in zip(weights, pieces, strict=True):
        powers = np.zeros(terms, dtype=complex)
        for coefficient in reversed(piece.polynomial):  # Horner's rule, in powers of tau
            shift = (s - piece.origin) * powers.real + 1j * abs(s - piece.origin) * powers.imag
            powers = shift + np.append(coefficient + 1j * abs(coefficient), powers[:-1])
        row[:terms] = powers * length ** np.arange(terms)
        for a, w, p in piece.waves:
            wave = -1j * a * np.exp(1j * (p + w * s))
            if w in fast:
                row[terms + fast.index(w)] += wave
            else:
                row[:terms] += wave * np.cumprod([1, *(1j * w * length / np.arange(1, terms))])
    return ExponentialSum(weights, 1j * np.array(fast), length)


def decay(lam: Array, forces: ExponentialSum) -> ExponentialSum:
    """p with p' + lam p = r, p(0) = 0; one row a mode, r a sum that is `extended` by lam."""
    length, powers = forces.length, forces.degree + 1
    slow = lam * length <= 1
    fast, rate = ~slow, lam[~slow]
    r, weights = forces.weights, np.zeros_like(forces.weights)
    waves = slice(powers, weights.shape[1] - rate.size)
    weights[:, waves] = r[:, waves] / (lam[:, None] + forces.rates[: forces.rates.size - rate.size])
    start = -weights[:, waves].sum(axis=1).real  # of powers and exp(-lam tau) at tau = 0
    higher = np.zeros(rate.size, dtype=complex)
    for k in reversed(range(powers)):
        higher = (r[fast, k] - (k + 1) / length * higher) / rate
        weights[fast, k] = higher
    weights[slow, 0] = start[slow]
    for k in range(powers - 1):
        weights[slow, k + 1] = length / (k + 1) * (r[slow, k] - lam[slow] * weights[slow, k])
    weights[fast, waves.stop + np.arange(rate.size)] = start[fast] - weights[fast, 0]
    return forces.with_weights(weights)


ITERATIONS = 100_000  # a simple root takes about ten
TINY = np.sqrt(np.finfo(float).tiny)  # a product with it does not underflow


@np.errstate(over="ignore", divide="ignore", invalid="ignore")
def first_root(f: ExponentialSum, orders: Array) -> float:
    """The first tau in (0, length) at which an entry of f turns negative; length if none does.

    Parameters
    ----------
    f : ExponentialSum
    orders : ndarray of int, shape (rows,)
        How many leading Taylor coefficients of an entry are zero at tau = 0; the next one is
        positive, so that an entry that starts from zero rises from it.
    """
    length, df = f.length, f.derivative()
    ddf, tau = df.derivative(), 0.0
    for _ in range(ITERATIONS):
        b = f.basis(tau)
        value, slope = (f.weights @ b).real, (df.weights @ b).real
        noise = ROUNDING * (f.sizes @ np.abs(b))
        zero = value <= noise
        falls = zero & (slope <= ROUNDING * (df.sizes @ np.abs(b)))
        M = np.maximum(ddf.sizes @ f.bound(tau), TINY)
        height = np.where(zero, 0.0, value)
        root = np.sqrt(slope**2 + 2 * M * height)
        h = np.where(slope < 0, 2 * height / (root - slope), (slope + root) / M)
        h = np.where(zero, np.maximum(h, np.sqrt(noise / M)), h)
        h[~zero & _stays_positive(f, b, tau)] = np.inf
        if tau == 0.0:
            until = _positive_until(f, orders)
            # until = 0: rounding hides the leading derivative, and the values decide
            falls, h = falls & (orders == 0), np.where((orders > 0) & (until > 0), until, h)
        if falls.any():
            beyond = _beyond_touch(f, np.flatnonzero(falls), tau, noise[falls])
            if beyond is None:
                return tau
            h[falls] = beyond
        tau += max(float(h.min(initial=np.inf)), EPS * tau)
        if tau >= length:
            return length
    raise SweepoptError(
        f"no event in {ITERATIONS} steps that are proved free of events; the rates of the "
        "process are too far apart for scheme='exact', use implicit-euler or sdirk2"
    )


def _stays_positive(f: ExponentialSum, b: Array, tau: float) -> Array:
    """Entries whose slowest terms, constants or decays, exceed the sizes of all others at tau.

    The others decay at least as fast, or are bounded by their sizes: such an entry stays positive
    up to the end. By M alone proved steps are no longer than about 1 / rate.
    """
    rates = np.append(np.zeros(f.degree + 1), -f.rates.real)
    slow = rates == np.where(f.weights == 0, np.inf, rates).min(axis=1, keepdims=True)
    slow[:, np.append(f.powers > 0, f.rates.imag != 0)] = False
    slowest = (f.weights * b * slow).real.sum(axis=1)
    return slowest > (f.sizes * f.bound(tau) * ~slow).sum(axis=1)


def _beyond_touch(f: ExponentialSum, rows: Array, tau: float, noise: Array) -> Array | None:
    """Steps after which entries at zero are positive again, where they only touch it.

    Where f'' stays above half of its value c up to h = 4 |f'| / c, f falls by f'^2 / c at most:
    this must be rounding. None if an entry may turn negative.
    """
    first = f.with_weights(f.weights[rows]).derivative()
    second = first.derivative()
    third = second.derivative()
    slope, c = np.minimum(first(tau), 0.0), second(tau)
    if not (c > 0).all():
        return None
    h = 4 * np.abs(slope) / c
    steady = third.sizes @ f.bound(tau) * h <= 0.5 * c
    return h if (steady & (slope**2 <= 4 * noise * c)).all() else None


def _positive_until(f: ExponentialSum, orders: Array) -> Array:
    """Up to where an entry that rises from zero with its k-th derivative stays positive."""
    until, curve = np.full(orders.size, np.inf), f
    for order in range(1, int(orders.max(initial=0)) + 1):
        curve = curve.derivative()
        leading = np.maximum(curve(0.0), 0.0)
        ratio = 0.5 * leading / (curve.derivative().sizes @ f.bound(0.0))
        # 0 / 0 is a constant
        until = np.where((orders == order) & (ratio >= 0), ratio, until)
    return until
