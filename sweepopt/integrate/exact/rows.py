"""The process in the rows of C(t) = { w : N w <= d(t) }, d in closed form piece by piece."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.linalg

from sweepopt.errors import InputError
from sweepopt.integrate.exact.exponential_sum import SLOW, TERMS, ExponentialSum
from sweepopt.linalg import dense
from sweepopt.loads import Piece, breakpoints
from sweepopt.problem import SweepingProcess, motion

NONSMOOTH = 50  # unknowns in a set's inequalities
UNKNOWNS = 300  # all of them: a phase has a dense eigenproblem of what moves
SAME = 1e-14  # entries of unit rows, and offsets, that differ by less are equal: a few roundings


@dataclass(frozen=True, eq=False)
class SmoothOffsets:
    """d between two breakpoints; `pieces` are its histories in closed form."""

    weights: np.ndarray
    pieces: list[Piece]

    def on(self, s: float, length: float) -> ExponentialSum:
        """d(s + tau) for 0 <= tau <= length."""
        fast = sorted({w for p in self.pieces for _, w, _ in p.waves if abs(w) * length > SLOW})
        slow = [tuple(wave for wave in p.waves if wave[1] not in fast) for p in self.pieces]
        terms = TERMS + 1 if any(slow) else 1
        powers = np.arange(max(terms, *(len(p.polynomial) for p in self.pieces)))
        rows = np.zeros((len(self.pieces), powers.size + len(fast)), dtype=complex)
        for row, piece, waves in zip(rows, self.pieces, slow, strict=True):
            series = _taylor(piece._replace(waves=waves), s, powers.size)
            row[: powers.size] = series.real * length**powers
            for a, w, p in piece.waves:
                if w in fast:
                    row[powers.size + fast.index(w)] -= 1j * a * np.exp(1j * (p + w * s))
        return ExponentialSum(self.weights @ rows, 1j * np.array(fast), length)

    def taylor(self, s: float, terms: int) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of d(s + tau) in tau, and the size of the terms that they are sums of.

        The size has the effect of the rounding of s in it.

        Returns
        -------
        coefficients, sizes : ndarray, shape (m, terms)
        """
        series = np.array([_taylor(piece, s, terms + 1) for piece in self.pieces])
        sizes = np.abs(series)
        sizes = sizes[:, :-1] + abs(s) * np.arange(1, terms + 1) * sizes[:, 1:]
        return self.weights @ series[:, :-1].real, np.abs(self.weights) @ sizes


def _taylor(piece: Piece, s: float, terms: int) -> np.ndarray:
    """Coefficients of phi(s + tau) in tau: their real part, and beside it how large waves are."""
    series, shift = np.zeros(terms, dtype=complex), s - piece.origin
    for coefficient in reversed(piece.polynomial):  # Horner's rule, in powers of tau
        series = shift * series + np.append(coefficient, series[:-1])
    for a, w, p in piece.waves:
        powers = np.cumprod(np.append(1.0, 1j * w / np.arange(1, terms)))
        series -= 1j * a * np.exp(1j * (p + w * s)) * powers
    return series


@dataclass(frozen=True, eq=False)
class Rows:
    """The process in the rows of C(t), which are unit vectors in the metric M: A, or B for A = 0.

    Attributes
    ----------
    N : ndarray, shape (m, n)
    equations : ndarray of bool, shape (m,)
        Rows that hold with equality at all times.
    R : ndarray, shape (m, n)
        N L with M = L L^T.
    NB, S, SB : ndarray, shapes (m, n), (m, m), (m, m)
        N B, N M N^T and N B N^T.
    histories, weights : list, ndarray of shape (m, k)
        d(t) = sum_k phi_k(t) weights[:, k].
    Lam : float
        The largest rate of the process; 0 where A = 0.
    rate_independent : bool
    """

    N: np.ndarray
    equations: np.ndarray
    R: np.ndarray
    NB: np.ndarray
    S: np.ndarray
    SB: np.ndarray
    histories: list[Any]
    weights: np.ndarray
    Lam: float
    rate_independent: bool

    @cached_property
    def fixed(self) -> list[int]:
        """The rows that always hold with equality."""
        return np.flatnonzero(self.equations).tolist()

    def smooth_offsets(
        self, start: float, end: float
    ) -> Iterator[tuple[float, float, SmoothOffsets]]:
        """Neighbouring breakpoints a and b between the two times, and d between a and b."""
        ends = [start, *breakpoints(self.histories, start, end).tolist(), end]
        for a, b in pairwise(ends):
            yield a, b, SmoothOffsets(self.weights, [phi.piece(a, b) for phi in self.histories])


def rows_of(process: SweepingProcess) -> Rows:
    """The rows of a process.

    Raises
    ------
    InputError
        If a set is curved or has no rows, the load is a black box, or there are too many unknowns.
    """
    try:
        return _rows_of(process)
    except InputError as error:
        raise InputError(f"scheme 'exact' does not apply: {error}") from error


def _rows_of(process: SweepingProcess) -> Rows:
    if process.dim > UNKNOWNS:
        raise InputError(
            f"the process has {process.dim} unknowns in its steps, more than {UNKNOWNS}. A body "
            "whose B is a multiple of A and whose set acts on few unknowns needs these alone; for "
            "others use midpoint or sdirk2"
        )
    halfspaces = motion(process.C).rows()
    metric = dense(process.metric.M)
    B = np.zeros_like(metric) if process.B is None else dense(process.B)
    R = halfspaces.N @ scipy.linalg.cholesky(metric, lower=True)
    lengths = np.linalg.norm(R, axis=1)
    rows = np.flatnonzero(lengths > 0)
    units = 1 / lengths[rows, None]
    N, R = units * halfspaces.N[rows], units * R[rows]
    weights = units * np.column_stack([D for _, D in halfspaces.d])[rows]
    rows, equations = _distinct(R, weights, rows >= len(lengths) - halfspaces.equations)
    N, R, weights = N[rows], R[rows], weights[rows]
    nonsmooth = process.dim - int(equations.sum())
    if nonsmooth > NONSMOOTH:
        raise InputError(
            f"the process has {nonsmooth} nonsmooth unknowns, more than {NONSMOOTH}; use midpoint "
            "or sdirk2"
        )
    histories, still = [phi for phi, _ in halfspaces.d], process.rate_independent
    lam, NB = 0.0 if still else process.Lam, N @ B
    return Rows(N, equations, R, NB, R @ R.T, NB @ N.T, histories, weights, lam, still)


def _distinct(
    R: np.ndarray, weights: np.ndarray, equations: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rows that are not repeated, and which of them hold with equality.

    A pair n w <= d, -n w <= -d is an equation at all times; so is what a Box with equal bounds has.
    """
    rounding, parallel = SAME * np.abs(weights).max(axis=1), R @ R.T
    kept, equations = np.ones(len(R), dtype=bool), equations.copy()
    for i, j in np.argwhere(np.tril(np.abs(parallel) > 1 - 1e-12, -1)).tolist():
        sign = np.sign(parallel[i, j])
        change = np.abs(weights[i] - sign * weights[j]).max()
        same = change <= max(rounding[i], rounding[j]) and np.abs(R[i] - sign * R[j]).max() <= SAME
        if kept[i] and kept[j] and same:
            equations[j] |= sign < 0 or equations[i]
            kept[i] = False
    return np.flatnonzero(kept), equations[kept]
