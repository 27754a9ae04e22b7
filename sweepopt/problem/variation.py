"""How far C(t) moves: its total variation in |.|_{A^-1} (MATH 1), and where it jumps."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from sweepopt.errors import InputError
from sweepopt.linalg import Factor, dense
from sweepopt.loads import Constant, Polynomial, Separable, Sine, Triangle, breakpoints
from sweepopt.problem.motion import TimeFunction, motion
from sweepopt.sets import AnySet, Box, ConvexSet

BLOCK = 256  # columns of A^-1 at a time: those of all unknowns would not fit in memory
SAMPLES = 500  # times, beside the breakpoints of data, between which jumps are looked for
JUMP = 1e-9  # of the run: what changes in no more is a jump to every step
MOST_JUMPS = 100  # that are located: a load with more is known by then
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


class Jump(NamedTuple):
    """C(t) before and after t: their distance in |.|_{A^-1} (inf if unknown) and its cause."""

    t: float
    distance: float
    name: str
    change: float

    def __str__(self) -> str:
        by = f"by {self.distance:g}" if self.distance < np.inf else "by an unknown distance"
        return f"at t = {self.t:g} {by} ({self.name} changes by {self.change:g})"


class _Move(NamedTuple):
    """A function that C(t) moves with; `distance` bounds that of its changes, shape (k, dim)."""

    name: str
    function: TimeFunction
    distance: Callable[[np.ndarray], np.ndarray]


def variation(C: AnySet, metric: Factor, times: np.ndarray) -> Variation:
    """The sum of the variations of all that C(t) moves with, or of the distances of members."""
    moves = _moves(C, metric)
    if moves is None:
        members = pairwise(map(C.at, times.tolist()))
        each = [C.distance_bound(D) for C, D in members]
        known = [np.inf if d is None else d for d in each]
        total = _require_known(float(np.sum(known)) / _root_beta(metric))
        return Variation.make(total, False)
    total, guaranteed = 0.0, metric.method == "factors"
    for move in moves:
        f = move.function
        if f.function is None and f.bounded:
            ends = float(times[0]), float(times[-1])
            vectors = [vector for _, vector in f.terms]
            sizes = [phi.variation(*ends) for phi in f.histories]
            changes = np.reshape(sizes, (-1, 1)) * np.reshape(vectors, (-1, f.dim))
        else:
            changes, guaranteed = np.diff(f.at(times), axis=0), False
        total += _distances(move, changes).sum()
    return Variation.make(_require_known(float(total)), guaranteed)


def jumps(C: AnySet, metric: Factor, start: float, end: float) -> list[Jump]:
    """Where center(t), scale(t) or h(t) changes by a finite amount in no time, in order of t."""
    found = []
    for move in _moves(C, metric) or ():
        f = move.function
        scalars = [Separable([(phi, [1.0])]) for phi, _ in f.terms if type(phi) not in CONTINUOUS]
        each = scalars if f.function is None else [lambda t, f=f: f.at(np.array([t]))[0]]
        for function in each:
            for lo, hi in _discontinuities(function, f.histories, start, end):
                change = np.diff(f.at(np.array([lo, hi])), axis=0)
                size = float(np.linalg.norm(change))
                found.append(Jump(hi, float(_distances(move, change)[0]), move.name, size))
    return sorted(found)


def _discontinuities(
    f: Callable[[float], np.ndarray], histories: list[object], start: float, end: float
) -> list[tuple[float, float]]:
    """Short intervals in which f changes by more than a share of what it does around them.

    A change that is continuous halves again and again with its interval. The steepest are looked at
    first, until a few in a row are continuous.
    """
    # irregular times: no period is in step with them
    shares = np.sort(np.arange(1, SAMPLES) * (np.sqrt(1.25) - 0.5) % 1)
    times = start + (end - start) * np.concatenate([[0.0], shares, [1.0]])
    times = np.union1d(times, breakpoints(histories, start, end))
    before, sizes, changes = f(float(times[0])), [0.0], []
    for t in times[1:].tolist():
        value = f(t)
        changes.append(float(np.linalg.norm(value - before)))
        sizes.append(float(np.linalg.norm(value)))
        before = value
    found: list[tuple[float, float]] = []
    continuous = 0
    for i in np.argsort(np.array(changes) / -np.diff(times)).tolist():
        if changes[i] <= JUMP * max(sizes) or continuous == 8 or len(found) == MOST_JUMPS:
            break
        interval = _halved(f, float(times[i]), float(times[i + 1]), JUMP * (end - start))
        if interval is None:
            continuous += 1
        else:
            found.append(interval)
            continuous = 0
    return found


def _halved(
    f: Callable[[float], np.ndarray], lo: float, hi: float, width: float
) -> tuple[float, float] | None:
    """An interval no longer than `width` with most of the change of f; None if it has little."""
    low, high = f(lo), f(hi)
    least = float(np.linalg.norm(high - low)) / 8
    while hi - lo > width:
        middle = 0.5 * (lo + hi)
        value = f(middle)
        first, second = (float(np.linalg.norm(d)) for d in (value - low, high - value))
        if max(first, second) < least:
            return None
        if first > second:
            hi, high = middle, value
        else:
            lo, low = middle, value
    return lo, hi


def _distances(move: _Move, changes: np.ndarray) -> np.ndarray:
    """The distances of changes; none is asked for where nothing changes."""
    result = np.zeros(len(changes))
    some = changes.any(axis=1)
    if some.any():
        result[some] = move.distance(changes[some])
    return result


def _require_known(total: float) -> float:
    if total == np.inf:
        raise InputError(
            "the distance of C(t) to C(s) is not known for this kind of set; write C as a Moving "
            "set with a bounded shape, a box or a ball to have its variation"
        )
    return total


def _moves(C: AnySet, metric: Factor) -> list[_Move] | None:
    """All that C(t) moves with, as data; None if C(t) moves in another way."""
    moving = motion(C)
    if moving.shape is None:
        return None
    if moving.offsets is not None:
        return [_Move("h", moving.offsets, _of_offsets(moving.shape.halfspaces().N, metric))]
    shape = moving.shape
    return [
        _Move(moving.name, moving.center, lambda v: np.array([metric.dual_norm(one) for one in v])),
        # sup |sigma(S, z)| / |z|_A = sup |w|_{A^-1} over S, as |sigma(S, z)| <= sigma(S, +-z)
        _Move("scale", moving.scale, lambda r: np.abs(r[:, 0]) * _magnitude(shape, metric)),
    ]


def _of_offsets(G: object, metric: Factor) -> Callable[[np.ndarray], np.ndarray]:
    """Bounds of the distance of { w : G w <= h } to that with h + dh, for rows dh."""
    rows = sp.csr_array(G)
    rows.eliminate_zeros()
    count = np.diff(rows.indptr)
    if (count <= 1).all():  # intervals of single unknowns: their ends move

        def of_ends(dh: np.ndarray) -> np.ndarray:
            m = np.zeros((metric.dim, len(dh)))
            ends = np.abs(dh[:, count > 0] / rows.data)
            np.maximum.at(m, rows.indices, ends.T)
            return np.array([_box(one, metric) for one in m.T])

        return of_ends
    if np.linalg.matrix_rank(dense(rows)) < len(count):
        return lambda dh: np.full(len(dh), np.inf)
    # independent rows: a translation by the least x with G x = dh
    gram = dense(rows @ metric.M @ rows.T)
    return lambda dh: np.sqrt((dh * np.linalg.solve(gram, dh.T).T).sum(axis=1))


def _box(m: np.ndarray, metric: Factor) -> float:
    """At least |w|_{A^-1} for all |w_i| <= m_i: exact where no entry of A^-1 is negative."""
    unknowns, total = np.flatnonzero(m), 0.0
    for at in range(0, unknowns.size, BLOCK):
        block = unknowns[at : at + BLOCK]
        columns = np.zeros((block.size, metric.dim))
        columns[np.arange(block.size), block] = m[block]
        total += float((np.abs(metric.solve_many(columns)) @ m).sum())
    return float(np.sqrt(total))


def _magnitude(S: ConvexSet, metric: Factor) -> float:
    """At least |w|_{A^-1} for all w of S; of a box its infinite ends, which do not move, aside."""
    selection = S.selection
    part = S if selection is None else selection.part
    if isinstance(part, Box):
        ends = np.abs([part.lower, part.upper])
        m = np.where(ends < np.inf, ends, 0.0).max(axis=0)
    elif not np.isfinite(S.magnitude()):
        return float("inf")
    else:
        m = np.array([max(part.support(e), part.support(-e)) for e in np.eye(part.dim)])
    away = 0.0
    if selection is not None:
        inner, m = m, np.zeros(S.dim)
        m[selection.unknowns] = inner
        away = 0.0 if selection.shift is None else metric.dual_norm(selection.shift)
    entrywise = away + _box(m, metric)
    return min(entrywise, S.magnitude() / _root_beta(metric)) if part is S else entrywise


def _root_beta(metric: Factor) -> float:
    """|w|_{A^-1} <= |w| / this."""
    return float(np.sqrt(metric.smallest_eigenvalue() * (1 - 1e-6)))
