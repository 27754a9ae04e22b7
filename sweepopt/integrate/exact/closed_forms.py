"""Finite sums of exponentials, powers and waves: all that moves between two switches."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np


@dataclass(frozen=True, eq=False)
class Basis:
    """exp(-rate tau), (tau / length)^k, sin(w tau), cos(w tau), in this order, on [0, length].

    Attributes
    ----------
    rates : ndarray, shape (r,), >= 0
    degree : int
    waves : ndarray, shape (l,), > 0
    length : float
    """

    rates: np.ndarray
    degree: int
    waves: np.ndarray
    length: float

    @cached_property
    def exponentials(self) -> slice:
        """Where they are among the functions."""
        return slice(0, self.rates.size)

    @cached_property
    def powers(self) -> slice:
        return slice(self.rates.size, self.rates.size + self.degree + 1)

    @cached_property
    def sines(self) -> slice:
        return slice(self.powers.stop, self.powers.stop + self.waves.size)

    @cached_property
    def cosines(self) -> slice:
        return slice(self.sines.stop, self.size)

    @cached_property
    def size(self) -> int:
        """How many functions there are."""
        return self.rates.size + self.degree + 1 + 2 * self.waves.size

    @cached_property
    def exponents(self) -> np.ndarray:
        """Those of the powers."""
        return np.arange(self.degree + 1)

    def at(self, tau: Any) -> np.ndarray:
        """The functions at tau, shape (..., size)."""
        tau = np.asarray(tau, dtype=float)[..., None]
        angle = self.waves * tau
        powers = (tau / self.length) ** self.exponents
        return np.concatenate(
            [np.exp(-self.rates * tau), powers, np.sin(angle), np.cos(angle)], axis=-1
        )

    def bound(self, tau: float) -> np.ndarray:
        """Bounds of their absolute values on [tau, length], shape (size,); 1 for the waves."""
        bounds = np.ones(self.size)
        bounds[self.exponentials] = np.exp(-self.rates * tau)
        return bounds


@dataclass(frozen=True, eq=False)
class Curve:
    """A vector-valued function of tau with known derivatives and bounds.

    Attributes
    ----------
    basis : Basis
    weights : ndarray, shape (rows, size)
    """

    basis: Basis
    weights: np.ndarray

    def __call__(self, tau: Any) -> np.ndarray:
        """Values, shape (rows,) or (k, rows)."""
        return self.basis.at(tau) @ self.weights.T

    def mapped(self, matrix: np.ndarray) -> Curve:
        """matrix @ curve."""
        return Curve(self.basis, matrix @ self.weights)

    def derivative(self) -> Curve:
        """The derivative in tau."""
        basis, C = self.basis, self.weights
        D = np.zeros_like(C)
        D[:, basis.exponentials] = -basis.rates * C[:, basis.exponentials]
        first, end = basis.powers.start, basis.powers.stop
        D[:, first : end - 1] = C[:, first + 1 : end] * (basis.exponents[1:] / basis.length)
        D[:, basis.sines] = -basis.waves * C[:, basis.cosines]
        D[:, basis.cosines] = basis.waves * C[:, basis.sines]
        return Curve(basis, D)

    @cached_property
    def sizes(self) -> np.ndarray:
        """Absolute weights, those of a wave as one amplitude; times `Basis.bound` they bound it."""
        sines, cosines = self.basis.sines, self.basis.cosines
        sizes = np.abs(self.weights)
        sizes[:, sines] = np.hypot(self.weights[:, sines], self.weights[:, cosines])
        sizes[:, cosines] = 0.0
        return sizes
