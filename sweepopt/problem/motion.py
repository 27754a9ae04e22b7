"""How C(t) moves, as data: read here once, for the exact scheme, the proportional path and bounds.

    C(t) = center(t) + sum_i r_i(t) S_i        or        C(t) = { w : G w <= h(t) } .

The first one is often a single S with its scale r(t). A set that moves in another way gives a
`Motion` that says so. Below: how far C(t) moves, its total variation in |.|_{A^-1} (MATH 1), and
where it jumps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import TIME_SLACK, Array, vector
from sweepopt.errors import InputError
from sweepopt.linalg import Factor, dense
from sweepopt.loads import (
    Constant,
    History,
    Polynomial,
    Separable,
    Sine,
    Slope,
    Table,
    Triangle,
    VectorTable,
    breakpoints,
)
from sweepopt.sets import (
    AnySet,
    Box,
    ConvexSet,
    Moving,
    MovingOffsets,
    MovingSet,
)

Terms = tuple[tuple[Any, Array], ...]


@dataclass(frozen=True, eq=False)
class TimeFunction:
    """f(t) = sum_k phi_k(t) f_k, or a function of time of which nothing else is known.

    Attributes
    ----------
    terms : tuple of (callable, ndarray of shape (dim,))
        Histories phi_k and vectors f_k.
    dim : int
    function : callable or None
        Instead of terms.
    variation : callable times -> ndarray, or None
        At least that of a function between each two times.
    """

    terms: Terms
    dim: int
    function: Callable[[float], Any] | None = None
    variation: Callable[[Array], Array] | None = None

    @classmethod
    def of(cls, value: Any, dim: int) -> TimeFunction:
        """Read what a set's center, scale or offsets may be."""
        if value is None:
            return cls((), dim)
        if isinstance(value, VectorTable) and dim > 1:
            return cls((), dim, value, partial(variations, value))
        if isinstance(value, (Separable, VectorTable)):
            return cls(value.terms, dim)
        if dim == 1 and hasattr(value, "variation"):
            return cls(((value, np.ones(1)),), 1)
        return cls((), dim, value)

    @property
    def bounded(self) -> bool:
        """Whether its values between two times can be bounded."""
        if self.function is not None:
            return self.variation is not None
        return all(hasattr(phi, "variation") for phi, _ in self.terms)

    def largest(self, a: float, b: float) -> Iterator[tuple[float, Array]]:
        """A bound of |phi_k| on [a, b] with each f_k; infinite of a function."""
        if self.function is not None:
            yield math.inf, np.ones(self.dim)
        for phi, f in self.terms:
            if isinstance(phi, History):
                yield phi.largest(a, b), f
            elif hasattr(phi, "variation"):
                yield abs(float(phi(a))) + phi.variation(a, b), f
            else:
                yield math.inf, f

    @property
    def constant(self) -> bool:
        """Whether it does not change."""
        return self.function is None and all(isinstance(phi, Constant) for phi, _ in self.terms)

    @property
    def histories(self) -> list[Any]:
        """The phi_k, or the function."""
        return [phi for phi, _ in self.terms] if self.function is None else [self.function]

    def at(self, times: Array) -> Array:
        """Values, shape (len(times), dim)."""
        if isinstance(self.function, VectorTable):
            return np.asarray(self.function(times))
        if self.function is not None:
            return np.array(
                [
                    vector(f"the function of C(t) at t = {t:g}", self.function(t), self.dim)
                    for t in times.tolist()
                ]
            )
        if not self.terms:
            return np.zeros((len(times), self.dim))
        return Separable(self.terms).at_many(times)


def variations(history: Any, times: Array) -> Array:
    """Of a history, between each two times."""
    return np.array([history.variation(*ends) for ends in pairwise(times.tolist())])


ONE = TimeFunction.of(Constant(), 1)


@dataclass(frozen=True, eq=False)
class Motion:
    """C(t) = center(t) + sum_i r_i(t) S_i, or { w : G w <= h(t) }.

    Attributes
    ----------
    summands : tuple of (TimeFunction, ConvexSet)
        r_i and S_i; where `offsets` are given 1 and { w : G w <= 0 }; none where C(t) moves in
        another way.
    center : TimeFunction
    offsets : TimeFunction or None
        h.
    name : str
        How messages call the function that moves C: "center", "load" or "h".
    """

    summands: tuple[tuple[TimeFunction, ConvexSet], ...]
    center: TimeFunction
    offsets: TimeFunction | None = None
    name: str = "center"

    @property
    def disjoint(self) -> bool:
        """Whether no unknown belongs to two summands."""
        chosen = [S.selection for _, S in self.summands]
        if len(chosen) < 2:
            return True
        known = [one.unknowns for one in chosen if one is not None and one.shift is None]
        return len(known) == len(chosen) and len(set(np.concatenate(known))) == sum(map(len, known))

    @property
    def scales_known(self) -> bool:
        """Whether no scale is a function of time of which nothing is known."""
        return all(scale.function is None for scale, _ in self.summands)

    @property
    def histories(self) -> list[Any]:
        """The functions of time in them."""
        functions = (self.center, *(r for r, _ in self.summands), self.offsets)
        return [phi for f in functions if f is not None for phi in f.histories]


def motion(C: AnySet) -> Motion:
    """Read how C(t) moves."""
    if isinstance(C, Moving):
        scale = ONE if C.scale is None else TimeFunction.of(C.scale, 1)
        return Motion(((scale, C.shape),), TimeFunction.of(C.center, C.dim), name=C.center_name)
    zero = TimeFunction((), C.dim)
    if isinstance(C, MovingOffsets):
        offsets = TimeFunction.of(C.offsets, C.shape.offsets.size)
        return Motion(((ONE, C.shape),), zero, offsets, "h")
    if isinstance(C, ConvexSet):
        return Motion(((ONE, C),), zero)
    if C.summands is None:
        return Motion((), TimeFunction((), C.dim, C.at))
    terms, S, scaled = C.summands
    summands = [(TimeFunction.of(r, 1), T) for r, T in scaled]
    if S.singleton:
        terms += ((Constant(), S.anchor),)
    else:
        summands.append((ONE, S))
    return Motion(tuple(summands), TimeFunction(terms, C.dim))


def histories_of(C: AnySet, inside: bool = True) -> list[Any]:
    """The functions of time that C(t) moves with, also where it is made of others that move.

    With those that a user names of a function t -> C, if `inside`.
    """
    parts, named = (C.operands, C.histories) if isinstance(C, MovingSet) else ((), ())
    own = [phi for part in parts for phi in histories_of(part, inside)] or motion(C).histories
    factors = (one for phi in own for one in getattr(phi, "factors", (phi,)))
    return [*(named if inside else ()), *factors]


# ---- how far it moves ---------------------------------------------------------------------------

COLUMNS = 256  # columns of A^-1 at a time: those of all unknowns would not fit in memory
EXEMPT = (Constant, Polynomial, Sine, Triangle, Slope)
"""Histories of whose jumps nobody is warned: only `Slope` has some, where the velocity of a
prescribed motion changes."""
Distance = Callable[[Array], float]


class Variation(float):
    """The total variation of C(t), int |dC|, in |.|_{A^-1}.

    Attributes
    ----------
    guaranteed : bool
        Whether it is no less than the variation: where C(t) moves by data (`Separable`, `Table`
        and other histories). Otherwise it is what the times that were given show of it.
    """

    guaranteed = False

    @classmethod
    def make(cls, value: float, guaranteed: bool) -> Variation:
        variation = cls(value)
        variation.guaranteed = guaranteed
        return variation


class Move(NamedTuple):
    """A function that C(t) moves with, and the distance, at most, for a change of it."""

    name: str
    f: TimeFunction
    distance: Distance


def variation(C: AnySet, metric: Factor, times: Array) -> Variation:
    """The sum of the variations of all that C(t) moves with, or of the distances of members."""
    moves, guaranteed = _moves(C, metric), metric.has_factors
    if moves is None:
        each = [C.distance_bound(D) for C, D in pairwise(map(C.at, times.tolist()))]
        total = _in_metric(sum(np.inf if d is None else d for d in each), metric)
        guaranteed = False
    else:
        total = 0.0
        for _, f, distance in moves:
            known = f.function is None and f.bounded
            if isinstance(f.function, VectorTable):
                total += f.function.variation(times[0], times[-1], distance)
                continue
            changes: Any = np.diff(f.at(times), axis=0)
            if known:
                changes = (phi.variation(times[0], times[-1]) * v for phi, v in f.terms)
            total, guaranteed = total + sum(map(distance, changes)), guaranteed and known
    if total == np.inf:
        raise InputError(
            "the distance of C(t) to C(s) is not known for this kind of set; write C as a Moving "
            "set with a bounded shape, a box or a ball to have its variation"
        )
    return Variation.make(total, guaranteed)


def jumps(C: AnySet, metric: Factor, start: float, end: float) -> list[tuple[float, str]]:
    """Where data of center(t), scale(t) or h(t) change by a finite amount in no time, and by what.

    Functions of which nothing is known are not looked at: they may have values on the grid only.
    """
    # between times that are the same to the library
    sentences, width = [], TIME_SLACK * max(abs(start), abs(end))
    moves = _moves(C, metric)
    if moves is None:  # such as an intersection: by how much is not known
        moves = [Move(name, f, lambda _: np.inf) for name, f in _functions(C)]
    for name, f, distance in moves:
        if not f.bounded:
            continue
        if f.function is None:  # beside large terms that cannot jump others are rounded
            f = TimeFunction(tuple(term for term in f.terms if _may_jump(term[0], width)), f.dim)
        last = -np.inf
        for t in breakpoints([phi for phi in f.histories if _may_jump(phi, width)], start, end):
            before, after, *around = f.at(np.clip(t + width * np.array([-1, 1, -8, 8]), start, end))
            change = np.linalg.norm(after - before)
            # one of each cluster of breakpoints: what f changes by does not shrink with the time
            if t > last + width and change > 0.5 * np.linalg.norm(around[1] - around[0]):
                size, last = distance(after - before), t
                most = "" if distance == metric.dual_norm else "at most "
                by = f"by {most}{size:g}" if size < np.inf else "by an unknown distance"
                sentences.append((t, f"at t = {t:g} {by} ({name} changes by {change:g})"))
    return sorted(sentences)


def _functions(C: AnySet) -> Iterator[tuple[str, TimeFunction]]:
    """Names and functions of time that the sets move with of which C(t) is made."""
    moving = motion(C)
    if moving.summands:
        yield moving.name, moving.center if moving.offsets is None else moving.offsets
        yield from (("scale", scale) for scale, _ in moving.summands)
    elif isinstance(C, MovingSet):
        for part in C.operands:
            yield from _functions(part)


def _may_jump(history: Any, width: float) -> bool:
    """Whether a history may change within so short a time."""
    steep = not isinstance(history, Table) or np.diff(history.times).min() <= width
    return bool(steep) and not isinstance(history, EXEMPT)


def _moves(C: AnySet, metric: Factor) -> list[Move] | None:
    """All that C(t) moves with, as data; None if C(t) moves in another way."""
    moving = motion(C)
    if not moving.summands:
        return None
    if moving.offsets is not None:
        G, _, E, _ = moving.summands[0][1].halfspaces()
        # of equations, 0 beside some unknowns, no distance is known
        of_offsets = _of_offsets(G, metric) if not E.size else lambda dh: np.inf * dh.any()
        return [Move(moving.name, moving.offsets, of_offsets)]
    # sup |sigma(S, z)| / |z|_A = sup |w|_{A^-1} over S, as |sigma(S, z)| <= sigma(S, +-z)
    moves = [Move(moving.name, moving.center, metric.dual_norm)]
    for scale, S in moving.summands:
        extent = 0.0 if scale.constant else _magnitude(S, metric)
        moves.append(Move("scale", scale, partial(_of_scale, extent)))
    return moves


def _of_scale(extent: float, r: Array) -> float:
    return float(abs(r[0])) * extent if r.any() else 0.0


def _of_offsets(G: Any, metric: Factor) -> Distance:
    """A bound of the distance of { w : G w <= h } to that with h + dh, of dh."""
    rows = sp.csr_array(G, copy=True)
    rows.eliminate_zeros()
    count = np.diff(rows.indptr)
    if (count <= 1).all():  # intervals of single unknowns: their ends move

        def of_ends(dh: Array) -> float:
            m = np.zeros(metric.dim)
            np.maximum.at(m, rows.indices, np.abs(dh[count > 0] / rows.data))
            return _box(m, metric)

        return of_ends
    if np.linalg.matrix_rank(dense(rows)) < len(count):
        return lambda dh: np.inf if dh.any() else 0.0
    # independent rows: a translation by the least x with G x = dh
    return Factor(dense(rows @ metric.M @ rows.T)).dual_norm


def _box(m: Array, metric: Factor) -> float:
    """At least |w|_{A^-1} for all |w_i| <= m_i: exact where no entry of A^-1 is negative."""
    unknowns, total = np.flatnonzero(m), 0.0
    for block in np.array_split(unknowns, unknowns.size // COLUMNS + 1):
        columns = np.zeros((block.size, metric.dim))
        columns[np.arange(block.size), block] = m[block]
        total += float((np.abs(metric.solve_many(columns)) @ m).sum()) if block.size else 0.0
    return float(np.sqrt(total))


def _magnitude(S: ConvexSet, metric: Factor) -> float:
    """At least |w|_{A^-1} for all w of S; of a box its infinite ends, which do not move, aside."""
    unknowns, part, shift = S.selection or (np.arange(S.dim), S, None)
    if not isinstance(part, Box):
        return _in_metric(S.magnitude(), metric)
    ends, m = np.abs([part.lower, part.upper]), np.zeros(S.dim)
    m[unknowns] = np.where(ends < np.inf, ends, 0.0).max(axis=0)
    return _box(m, metric) + (0.0 if shift is None else metric.dual_norm(shift))


def _in_metric(length: float, metric: Factor) -> float:
    """|w|_{A^-1} at most, for |w| = length: inf where no coercivity is proved."""
    beta = metric.smallest_eigenvalue
    return length / float(np.sqrt(beta)) if beta else (np.inf if length else 0.0)
