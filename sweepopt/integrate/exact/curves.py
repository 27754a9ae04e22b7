"""Finite sums of exponentials, powers and waves: all that moves between two switches."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np


class Cuts(NamedTuple):
    """Where the powers, the sines and the cosines of a basis begin."""

    powers: int
    sines: int
    cosines: int


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
    def _powers(self) -> np.ndarray:
        return np.arange(self.degree + 1)

    @property
    def cuts(self) -> Cuts:
        """Where its parts begin."""
        sines = self.rates.size + self.degree + 1
        return Cuts(self.rates.size, sines, sines + self.waves.size)

    def at(self, tau: Any) -> np.ndarray:
        """The functions at tau, shape (..., size)."""
        tau = np.asarray(tau, dtype=float)[..., None]
        angle = self.waves * tau
        powers = (tau / self.length) ** self._powers
        return np.concatenate(
            [np.exp(-self.rates * tau), powers, np.sin(angle), np.cos(angle)], axis=-1
        )

    def bound(self, tau: float) -> np.ndarray:
        """Bounds of their absolute values on [tau, length], shape (size,); 1 for the waves."""
        k = self.rates.size
        bounds = np.ones(self.cuts.cosines + self.waves.size)
        bounds[:k] = np.exp(-self.rates * tau)
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
        p, s, c = basis.cuts
        D = np.zeros_like(C)
        D[:, :p] = -basis.rates * C[:, :p]
        D[:, p : s - 1] = C[:, p + 1 : s] * (basis._powers[1:] / basis.length)
        D[:, s:c] = -basis.waves * C[:, c:]
        D[:, c:] = basis.waves * C[:, s:c]
        return Curve(basis, D)

    @cached_property
    def sizes(self) -> np.ndarray:
        """Absolute weights, those of a wave as one amplitude; times `Basis.bound` they bound it."""
        _, s, c = self.basis.cuts
        sizes = np.abs(self.weights)
        sizes[:, s:c] = np.hypot(self.weights[:, s:c], self.weights[:, c:])
        sizes[:, c:] = 0.0
        return sizes
