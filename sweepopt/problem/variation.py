"""How far C(t) moves: its total variation in |.|_{A^-1} (MATH 1), and where it jumps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.sparse as sp

from sweepopt.errors import InputError
from sweepopt.linalg import Factor, dense
from sweepopt.loads import Constant, Polynomial, Sine, Table, Triangle, breakpoints
from sweepopt.problem.motion import TimeFunction, motion
from sweepopt.sets import AnySet, Box, ConvexSet

BLOCK = 256  # columns of A^-1 at a time: those of all unknowns would not fit in memory
JUMP = 1e-9  # of the run: what changes in no more is a jump to every step
CONTINUOUS = (Constant, Polynomial, Sine, Triangle)


class Variation(float):
    """The total variation of C(t), int |dC|, in |.|_{A^-1}.

    Attributes
    ----------
    guaranteed : bool
        Whether it is no less than the variation: where C(t) moves by data (`Separable`, `Table`
        and other histories). Otherwise it is what the times that were given show of it.
    """

    guaranteed: bool

    @classmethod
    def make(cls, value: float, guaranteed: bool) -> Variation:
        variation = cls(value)
        variation.guaranteed = guaranteed
        return variation


Move = tuple[str, TimeFunction, Callable[[np.ndarray], float]]
"""A function that C(t) moves with, and the distance, at most, for a change of it."""


def variation(C: AnySet, metric: Factor, times: np.ndarray) -> Variation:
    """The sum of the variations of all that C(t) moves with, or of the distances of members."""
    moves = _moves(C, metric)
    total, guaranteed = 0.0, moves is not None and metric.method == "factors"
    for _, f, distance in moves or ():
        if f.function is None and f.bounded:
            ends = float(times[0]), float(times[-1])
            vectors = [vector for _, vector in f.terms]
            changes = [
                phi.variation(*ends) * v for phi, v in zip(f.histories, vectors, strict=True)
            ]
        else:
            changes, guaranteed = list(np.diff(f.at(times), axis=0)), False
        total += sum(map(distance, changes))
    if moves is None:
        each = [C.distance_bound(D) for C, D in pairwise(map(C.at, times.tolist()))]
        total = _in_metric(sum(np.inf if d is None else d for d in each), metric)
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
    found, width = [], JUMP * (end - start)
    for name, f, distance in _moves(C, metric) or ():
        for t in _discontinuities(f.histories, start, end, width) if f.bounded else ():
            before, after = f.at(np.clip([t - width, t + width], start, end))
            size = distance(after - before)
            by = f"by {size:g}" if size < np.inf else "by an unknown distance"
            change = np.linalg.norm(after - before)
            found.append((t, f"at t = {t:g} {by} ({name} changes by {change:g})"))
    return sorted(found)


def _discontinuities(
    histories: list[Any], start: float, end: float, width: float
) -> Iterator[float]:
    """Breakpoints whose neighbourhood keeps its variation as it shrinks, one of each cluster."""
    last = -np.inf
    known = [phi for phi in histories if not _is_continuous(phi, width)]
    for t in breakpoints(known, start, end).tolist():
        near, around = (
            sum(phi.variation(max(t - w, start), min(t + w, end)) for phi in known)
            for w in (width, 8 * width)
        )
        if near > 0.5 * around and t > last + width:
            last = t
            yield t


def _is_continuous(phi: Any, width: float) -> bool:
    """Whether phi is data that needs more than this time for any change."""
    if isinstance(phi, Table):
        return bool(np.diff(phi.times).min() > width)
    return isinstance(phi, CONTINUOUS)


def _moves(C: AnySet, metric: Factor) -> list[Move] | None:
    """All that C(t) moves with, as data; None if C(t) moves in another way."""
    moving = motion(C)
    if moving.shape is None:
        return None
    if moving.offsets is not None:
        return [("h", moving.offsets, _of_offsets(moving.shape.halfspaces().N, metric))]
    # sup |sigma(S, z)| / |z|_A = sup |w|_{A^-1} over S, as |sigma(S, z)| <= sigma(S, +-z)
    extent = 0.0 if moving.scale.constant else _magnitude(moving.shape, metric)
    return [
        (moving.name, moving.center, metric.dual_norm),
        ("scale", moving.scale, lambda r: float(abs(r[0])) * extent if r.any() else 0.0),
    ]


def _of_offsets(G: Any, metric: Factor) -> Callable[[np.ndarray], float]:
    """A bound of the distance of { w : G w <= h } to that with h + dh, of dh."""
    rows = sp.csr_array(G)
    rows.eliminate_zeros()
    count = np.diff(rows.indptr)
    if (count <= 1).all():  # intervals of single unknowns: their ends move

        def of_ends(dh: np.ndarray) -> float:
            m = np.zeros(metric.dim)
            np.maximum.at(m, rows.indices, np.abs(dh[count > 0] / rows.data))
            return _box(m, metric)

        return of_ends
    if np.linalg.matrix_rank(dense(rows)) < len(count):
        return lambda dh: np.inf if dh.any() else 0.0
    # independent rows: a translation by the least x with G x = dh
    return Factor(dense(rows @ metric.M @ rows.T)).dual_norm


def _box(m: np.ndarray, metric: Factor) -> float:
    """At least |w|_{A^-1} for all |w_i| <= m_i: exact where no entry of A^-1 is negative."""
    unknowns, total = np.flatnonzero(m), 0.0
    for block in np.array_split(unknowns, unknowns.size // BLOCK + 1):
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
    beta = metric.smallest_eigenvalue()
    return length / float(np.sqrt(beta)) if beta else (np.inf if length else 0.0)
