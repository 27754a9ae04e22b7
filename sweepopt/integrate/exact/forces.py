"""The offsets d(t) of a set's rows, in closed form from any time to the next kink."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from sweepopt.integrate.exact.curves import Basis, Curve
from sweepopt.loads import Piece, kinks

FLAT = 0.5  # a wave with less than this angle left is a power series: 1 / w would cancel
TERMS = 16  # of that series, and FLAT^17 / 17! is below rounding


class Forces:
    """d(t) = sum_k phi_k(t) weights[:, k].

    Attributes
    ----------
    histories : list
    weights : ndarray, shape (m, k)
    """

    def __init__(self, histories: list[Any], columns: list[np.ndarray]) -> None:
        self.histories = histories
        self.weights = np.column_stack(columns)

    def only(self, rows: np.ndarray) -> Forces:
        """Some of the rows."""
        return Forces(self.histories, list(self.weights[rows].T))

    @property
    def sizes(self) -> np.ndarray:
        """The largest absolute weight of each row, shape (m, 1)."""
        return np.abs(self.weights).max(axis=1, keepdims=True)

    def breakpoints(self, a: float, b: float) -> np.ndarray:
        """All kinks strictly between a and b, increasing."""
        return kinks(self.histories, a, b)

    def between(self, a: float, b: float) -> Smooth:
        """d between two neighbouring kinks."""
        return Smooth(self.weights, [phi.piece(a, b) for phi in self.histories])


@dataclass(frozen=True, eq=False)
class Smooth:
    """d where it has no kink.

    Attributes
    ----------
    weights : ndarray, shape (m, k)
    pieces : list of Piece
    """

    weights: np.ndarray
    pieces: list[Piece]

    def on(self, s: float, length: float) -> Curve:
        """d(s + tau) for 0 <= tau <= length."""
        waves = sorted({
            abs(w) for piece in self.pieces for a, w, _ in piece.waves if abs(w) * length > FLAT
        })  # fmt: skip
        degree = max(len(piece.polynomial) - 1 for piece in self.pieces)
        flat = any(abs(w) * length <= FLAT for piece in self.pieces for _, w, _ in piece.waves)
        degree = max(degree, TERMS) if flat else degree
        basis = Basis(np.zeros(0), degree, np.array(waves), length)
        _, sines, cosines = basis.cuts
        rows = np.zeros((len(self.pieces), cosines + len(waves)))
        for row, piece in zip(rows, self.pieces, strict=True):
            powers = _moved(piece.polynomial, s - piece.origin)
            row[: len(powers)] = powers * length ** np.arange(len(powers))
            for a, w, p in piece.waves:
                angle = p + w * s
                if abs(w) * length <= FLAT:
                    row[: TERMS + 1] += a * _series(angle, w * length, TERMS)
                else:
                    j = waves.index(abs(w))
                    row[sines + j] += math.copysign(1.0, w) * a * math.cos(angle)
                    row[cosines + j] += a * math.sin(angle)
        return Curve(basis, self.weights @ rows)

    def taylor(self, s: float, terms: int) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of d(s + tau) in tau, and how large the terms are that make them.

        The second one holds what the rounding of s does too.

        Returns
        -------
        coefficients, sizes : ndarray, shape (m, terms)
        """
        values, sizes = np.zeros((2, len(self.pieces), terms + 1))
        for value, size, piece in zip(values, sizes, self.pieces, strict=True):
            shift, known = s - piece.origin, min(len(piece.polynomial), terms + 1)
            value[:known] = _moved(piece.polynomial, shift)[:known]
            size[:known] = _moved([abs(c) for c in piece.polynomial], abs(shift))[:known]
            for a, w, p in piece.waves:
                value += a * _series(p + w * s, w, terms)
                size += abs(a) * np.cumprod([1.0, *(abs(w) / np.arange(1, terms + 1))])
        late = abs(s) * np.arange(1, terms + 1) * sizes[:, 1:]
        return self.weights @ values[:, :-1], np.abs(self.weights) @ (sizes[:, :-1] + late)


def _moved(polynomial: Any, shift: float) -> np.ndarray:
    """Coefficients in tau of a polynomial in shift + tau (Horner's scheme, repeated)."""
    c = np.array(polynomial, dtype=float)
    if shift:
        for i in range(c.size - 1):
            for k in reversed(range(i, c.size - 1)):
                c[k] += shift * c[k + 1]
    return c


def _series(angle: float, w: float, terms: int) -> np.ndarray:
    """Taylor coefficients of sin(angle + w tau)."""
    powers = np.cumprod([1.0, *(w / np.arange(1, terms + 1))])
    sine, cosine = math.sin(angle), math.cos(angle)
    turn = np.array([sine, cosine, -sine, -cosine])
    return powers * turn[np.arange(terms + 1) % 4]
