"""C(t) = center(t) + scale(t) S with histories as data: values, and what lies between them.

A guaranteed bound must know a load at all times of an interval. Here a history is replaced on each
interval by the polynomial through its values at the five Gauss points, and `away` bounds what it
differs from that: zero for tables, by the fifth derivative for sines and polynomials, by the
variation for a history that only declares this.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import number, vector
from sweepopt.errors import InputError
from sweepopt.loads import Constant, Piece, Separable, kinks
from sweepopt.sets import AnySet, Box, ConvexSet, Moving, MovingOffsets, basis, to_bernstein


def _gauss(count: int) -> tuple[np.ndarray, np.ndarray]:
    points, weights = np.polynomial.legendre.leggauss(count)
    return 0.5 + 0.5 * points, 0.5 * weights


NODES = _gauss(5)[0]  # where histories are looked at
GAUSS, WEIGHTS = _gauss(6)
"""Points and weights on [0, 1]: exact for squares of polynomials of degree 5."""
TO_BERNSTEIN = to_bernstein(GAUSS)
DERIVATIVE = 5 * basis(4, GAUSS) @ np.diff(TO_BERNSTEIN, axis=0)  # of values at GAUSS, there
LIFT = basis(4, GAUSS) @ to_bernstein(NODES)  # from values at NODES to values at GAUSS
NODAL = math.factorial(5) ** 2 / math.factorial(10)  # max of prod |x - x_g| on [0, 1]
PARTS = 64  # of an interval, for a history that declares its variation only
ON_PARTS = basis(4, np.arange(PARTS + 1) / PARTS) @ to_bernstein(NODES)


@dataclass(frozen=True, eq=False)
class Data:
    """f(t) = sum_k phi_k(t) f_k, or a function of time of which nothing else is known.

    Attributes
    ----------
    terms : tuple of (callable, ndarray)
    function : callable or None
        Instead of terms.
    dim : int
    """

    terms: tuple[tuple[Callable[[Any], Any], np.ndarray], ...]
    dim: int
    function: Callable[[float], Any] | None = None
    variation: Callable[[float], float] | None = None

    @classmethod
    def of(cls, value: Any, dim: int) -> Data:
        """Read what a set's center, scale or offsets may be."""
        if value is None:
            return cls((), dim)
        if isinstance(value, Separable):
            return cls(value.terms, dim)
        if hasattr(value, "variation"):
            return cls(((value, np.ones(dim)),), dim)
        if callable(value):
            return cls((), dim, value)
        return cls(((Constant(1.0), np.broadcast_to(np.asarray(value, float), (dim,))),), dim)

    @property
    def known(self) -> bool:
        """Whether what lies between values can be bounded."""
        if self.function is not None:
            return self.variation is not None
        return all(hasattr(phi, "variation") for phi, _ in self.terms)

    @property
    def constant(self) -> bool:
        """Whether it does not change."""
        return self.function is None and all(isinstance(phi, Constant) for phi, _ in self.terms)

    def at(self, times: np.ndarray) -> np.ndarray:
        """Values, shape (len(times), dim)."""
        if self.function is not None:
            return np.array(
                [
                    vector(f"the function of C(t) at t = {t:g}", self.function(t), self.dim)
                    for t in times.tolist()
                ]
            )
        values = np.zeros((len(times), self.dim))
        if self.terms:
            values += Separable(self.terms).at_many(times)
        return values

    def on(self, begin: np.ndarray, end: np.ndarray) -> Between:
        """The polynomials of the histories on intervals without a kink, and how far they are."""
        h = end - begin
        times = begin[:, None] + h[:, None] * NODES
        if self.function is not None:
            return self._sampled(begin, end, times)
        values = np.zeros((len(h), 5, self.dim))
        away, bent = np.zeros((2, len(h), len(self.terms)))
        for k, (phi, f) in enumerate(self.terms):
            found = Separable([(phi, [1.0])]).values(times.ravel()).reshape(len(h), 5)
            values += found[:, :, None] * f
            pairs = list(zip(begin.tolist(), end.tolist(), strict=True))
            if hasattr(phi, "piece"):
                fifth = np.array([_fifth_derivative(phi.piece(a, b), a, b) for a, b in pairs])
                # Rolle: the error's derivative has four zeros
                away[:, k], bent[:, k] = fifth * h**5 * NODAL / 120, fifth * h**5 / 24
            elif hasattr(phi, "variation"):
                away[:, k], bent[:, k] = np.array(
                    [_rough(phi, *x) for x in zip(pairs, found, strict=False)]
                ).T
        return Between(LIFT @ values, away, bent)

    def _sampled(self, begin: np.ndarray, end: np.ndarray, times: np.ndarray) -> Between:
        m = len(begin)
        if self.variation is None:
            values = self.at(times.ravel()).reshape(m, 5, self.dim)
            return Between(LIFT @ values, np.zeros((m, 1)), np.zeros((m, 1)))
        ends = self.at(np.append(begin, end[-1]))
        chords = ends[:-1, None] + np.diff(ends, axis=0)[:, None] * GAUSS[:, None]
        away = increments(self.variation, np.append(begin, end[-1]))[:, None]
        return Between(chords, away, away + np.linalg.norm(np.diff(ends, axis=0), axis=1)[:, None])


def increments(variation: Callable[[float], float], times: np.ndarray) -> np.ndarray:
    """v(t_{i+1}) - v(t_i) of a variation, which never falls."""
    grown = np.diff([number(f"variation({t:g})", variation(t)) for t in times.tolist()])
    if (grown < 0).any():
        i = int(np.argmin(grown))
        raise InputError(
            f"variation must not fall, but it does between t = {times[i]:g} and {times[i + 1]:g}; "
            "give v with d_H(C(t), C(s)) <= v(t) - v(s) for s <= t"
        )
    return grown


class Between(NamedTuple):
    """A function on m intervals: polynomials, and a bound for each of its k terms.

    Attributes
    ----------
    values : ndarray, shape (m, 6, dim)
        Of the polynomials, at GAUSS.
    away : ndarray, shape (m, k)
        sup of |phi_k - its polynomial|.
    bent : ndarray, shape (m, k)
        int of |phi_k' - the derivative of its polynomial|.
    """

    values: np.ndarray
    away: np.ndarray
    bent: np.ndarray


def _rough(phi: Any, ends: tuple[float, float], values: np.ndarray) -> tuple[float, float]:
    """`away` and `bent` of a history that declares its variation only, from samples on parts.

    On a part an error e is at most (|e| at one end + |e| at the other + its variation) / 2.
    """
    a, b = ends
    times = a + (b - a) * np.arange(PARTS + 1) / PARTS
    e = Separable([(phi, [1.0])]).values(times)[:, 0] - ON_PARTS @ values
    slope = float(np.abs(np.diff(to_bernstein(NODES) @ values)).max()) * 4 / PARTS
    varies = [phi.variation(*part) + slope for part in itertools.pairwise(times.tolist())]
    worst = 0.5 * (np.abs(e[:-1]) + np.abs(e[1:]) + varies)
    return float(worst.max()), float(np.sum(varies))


def _fifth_derivative(piece: Piece, a: float, b: float) -> float:
    """A bound of |phi^(5)| on [a, b]."""
    total = sum(abs(amplitude) * abs(rate) ** 5 for amplitude, rate, _ in piece.waves)
    reach = max(abs(a - piece.origin), abs(b - piece.origin))
    for k, c in enumerate(piece.polynomial[5:], start=5):
        total += abs(c) * math.perm(k, 5) * reach ** (k - 5)
    return total


@dataclass(frozen=True, eq=False)
class Motion:
    """C(t) = center(t) + scale(t) S; a scale of several entries goes with a box S."""

    center: Data
    scale: Data
    shape: ConvexSet

    @cached_property
    def known(self) -> bool:
        """Whether center and scale are data."""
        return self.center.known and self.scale.known

    def on(self, grid: Grid) -> tuple[Between, Between]:
        """Center and scale on intervals."""
        return self.center.on(grid.begin, grid.end), self.scale.on(grid.begin, grid.end)

    def grid(self, t: np.ndarray) -> Grid:
        """The steps between the times t, cut at the kinks of the histories."""
        histories = [phi for phi, _ in (*self.center.terms, *self.scale.terms)]
        cuts = np.unique(np.concatenate([t, kinks(histories, t[0], t[-1])]))
        step = np.searchsorted(t, cuts[:-1], side="right") - 1
        return Grid(step, cuts[:-1], cuts[1:])


class Grid(NamedTuple):
    """Intervals inside the steps: the step of each, and its ends."""

    step: np.ndarray
    begin: np.ndarray
    end: np.ndarray


def motion(C: AnySet) -> Motion | None:
    """C(t) in this form; None for a set that moves in another way."""
    if isinstance(C, ConvexSet):
        return Motion(Data.of(None, C.dim), Data.of(1.0, 1), C)
    if isinstance(C, Moving):
        scale = Data.of(1.0 if C.scale is None else C.scale, 1)
        return Motion(Data.of(C.center, C.dim), scale, C.shape)
    if isinstance(C, MovingOffsets) and isinstance(C.offsets, Separable):
        return _box(C.shape.rows(), C.offsets)
    return None


def _box(rows: tuple[Any, np.ndarray] | None, h: Separable) -> Motion | None:
    """{ w : G w <= h(t) } with one entry a row, as l(t) + (u(t) - l(t)) [0, 1] in each entry."""
    if rows is None:
        return None
    G = rows[0].toarray() if sp.issparse(rows[0]) else np.asarray(rows[0])
    dim = G.shape[1]
    if (np.count_nonzero(G, axis=1) != 1).any():
        return None
    column = np.abs(G).argmax(axis=1)
    entry = G[np.arange(len(G)), column]
    center, scale = np.zeros((2, dim, h.shapes.shape[1]))
    lower, upper, constant = np.full(dim, -np.inf), np.full(dim, np.inf), np.zeros(dim)
    for k in range(dim):
        above, below = (np.flatnonzero((column == k) & (s * entry > 0)) for s in (1, -1))
        if len(above) > 1 or len(below) > 1:
            return None
        if len(below):
            center[k] = h.shapes[below[0]] / entry[below[0]]
            lower[k], constant[k] = 0.0, float(not len(above))
        if len(above):
            end = h.shapes[above[0]] / entry[above[0]]
            upper[k] = float(len(below))
            scale[k] = end - center[k] if len(below) else 0.0
            if not len(below):
                center[k], constant[k] = end, 1.0
        elif not len(below):
            constant[k] = 1.0
    phis = [phi for phi, _ in h.terms]
    moving = Separable([*zip(phis, scale.T, strict=True), (Constant(1.0), constant)])
    centers = Separable(zip(phis, center.T, strict=True))
    return Motion(Data.of(centers, dim), Data.of(moving, dim), Box(lower, upper))
