"""Sums of powers and exponentials: all that moves between two switches.

    f(tau) = Re( sum_k a_k (tau / length)^k + sum_j c_j exp(z_j tau) ),   Re z_j <= 0,

on [0, length]: a wave is an exponential of imaginary rate. Exponentials with |z| length <= SLOW are
written as power series: where they cancel powers, no digits are lost.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from typing import Any

import numpy as np

from sweepopt.loads import Piece

SLOW = 1.0  # |z| length up to which an exponential is a power series: 1 / z would cancel
TERMS = 20  # of that series, and 1 / 20! is below rounding


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

    weights: np.ndarray
    rates: np.ndarray
    length: float

    @cached_property
    def degree(self) -> int:
        """The highest power."""
        return self.weights.shape[1] - self.rates.size - 1

    @cached_property
    def _powers(self) -> np.ndarray:
        return np.arange(self.degree + 1)

    @cached_property
    def sizes(self) -> np.ndarray:
        """Absolute weights; times `bound` they bound the function."""
        return np.abs(self.weights)

    def basis(self, tau: Any) -> np.ndarray:
        """The powers and exponentials at tau, shape (..., degree + 1 + l)."""
        tau = np.asarray(tau, dtype=float)[..., None]
        return np.concatenate(
            [(tau / self.length) ** self._powers, np.exp(self.rates * tau)], axis=-1
        )

    def bound(self, tau: float) -> np.ndarray:
        """Bounds of their absolute values on [tau, length]."""
        return np.append(np.ones(self.degree + 1), np.exp(self.rates.real * tau))

    def __call__(self, tau: Any) -> np.ndarray:
        """Values, shape (rows,) or (k, rows)."""
        return (self.basis(tau) @ self.weights.T).real

    def with_weights(self, weights: np.ndarray) -> ExponentialSum:
        """Another sum of the same functions."""
        return ExponentialSum(weights, self.rates, self.length)

    def derivative(self) -> ExponentialSum:
        """The derivative in tau."""
        W, end = self.weights, self.degree
        D = np.zeros_like(W)
        D[:, :end] = W[:, 1 : end + 1] * (self._powers[1:] / self.length)
        D[:, end + 1 :] = W[:, end + 1 :] * self.rates
        return self.with_weights(D)

    def taylor(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Coefficients of 1, tau, tau^2, ... and the size of the terms that they are sums of."""
        f, start = self, self.basis(0.0).real
        for k in count(1):
            yield (f.weights @ start).real, f.sizes @ start
            f = f.with_weights(f.derivative().weights / k)

    def extended(self, lam: np.ndarray) -> ExponentialSum:
        """The same function, with room for exp(-lam tau): see `decay`."""
        fast = lam[lam * self.length > SLOW]
        terms = TERMS if fast.size < lam.size else 0
        powers, exponentials = np.split(self.weights, [self.degree + 1], axis=1)
        more = np.zeros((len(powers), terms)), np.zeros((len(powers), fast.size))
        weights = np.hstack([powers, more[0], exponentials, more[1]])
        return ExponentialSum(weights, np.append(self.rates, -fast), self.length)


def histories(pieces: list[Piece], s: float, length: float) -> ExponentialSum:
    """phi(s + tau) for 0 <= tau <= length of histories in closed form, a row each.

    Powers of slow waves have an imaginary part: `taylor` then has the size of the wave, which is
    that of its rounding, also where the wave is zero.
    """
    rates = {w for piece in pieces for _, w, _ in piece.waves}
    fast = sorted(w for w in rates if abs(w) * length > SLOW)
    terms = TERMS + 1 if len(fast) < len(rates) else 1
    terms = max(terms, *(len(piece.polynomial) for piece in pieces))
    weights = np.zeros((len(pieces), terms + len(fast)), dtype=complex)
    for row, piece in zip(weights, pieces, strict=True):
        powers = np.zeros(terms)
        for coefficient in reversed(piece.polynomial):  # Horner's rule, in powers of tau
            powers = (s - piece.origin) * powers + np.append(coefficient, powers[:-1])
        row[:terms] = powers * length ** np.arange(terms)
        for a, w, p in piece.waves:
            wave = -1j * a * np.exp(1j * (p + w * s))
            if w in fast:
                row[terms + fast.index(w)] += wave
            else:
                row[:terms] += wave * np.cumprod([1, *(1j * w * length / np.arange(1, terms))])
    return ExponentialSum(weights, 1j * np.array(fast), length)


def decay(lam: np.ndarray, forces: ExponentialSum) -> ExponentialSum:
    """p with p' + lam p = r, p(0) = 0; one row a mode, r a sum that is `extended` by lam."""
    length, powers = forces.length, forces.degree + 1
    slow = lam * length <= SLOW
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
