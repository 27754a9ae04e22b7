"""Grids of steps that are halved where the differences of the velocities are large."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

FLOOR = 0.4  # no step is longer than 1 / FLOOR times what the average density asks for
JUMP = 0.75  # a jump at a breakpoint as second difference of steps there, times the step squared
BASES = 4  # so many longest steps are tried, which differ by less than two


@dataclass(frozen=True, eq=False)
class Density:
    """How many steps a unit of time needs, between `edges`, up to a common factor.

    Attributes
    ----------
    rho : ndarray
        One value between two edges; the local error of a step h is about (h rho)^(order + 1).
    """

    edges: np.ndarray
    rho: np.ndarray
    order: int

    @property
    def total(self) -> float:
        return float(self.rho @ np.diff(self.edges))

    def errors(self, times: np.ndarray) -> float:
        """The sum of the local errors on a grid, up to a factor."""
        parts = np.append(0.0, np.cumsum(self.rho ** (self.order + 1) * np.diff(self.edges)))
        inside = np.diff(np.interp(times, self.edges, parts))
        return float(inside @ np.diff(times) ** self.order)


def density(
    times: np.ndarray,
    cuts: np.ndarray,
    sizes: np.ndarray,
    order: int,
    jumps: Mapping[int, float] | None = None,
) -> Density:
    """Steps per time that spread the local errors evenly.

    A kink of the velocity is in two windows of three steps, but in both only from the middle of
    one step to that of the next: the lesser of both windows finds the place. Windows across a
    breakpoint count only where a segment has no window of its own, and the greater of them. A jump
    of the velocity at the end of a step, where it has none, is a kink in one of the halves there.
    """
    n = len(times) - 1
    segment = np.searchsorted(cuts[1:-1], times[:-1], side="right")
    own = segment[order:] == segment[: n - order]
    gaps = _least(np.where(own, sizes, np.inf), order)
    across = sizes
    if order == 2:
        across = np.maximum(np.append(0.0, sizes), np.append(sizes, 0.0))
    gaps[(segment[1:] != segment[:-1]) | ~np.isfinite(gaps)] = np.nan
    left, right = np.append(np.nan, gaps), np.append(gaps, np.nan)
    left, right = np.where(np.isnan(left), right, left), np.where(np.isnan(right), left, right)
    alone = np.maximum(np.append(0.0, across), np.append(across, 0.0))
    halves = np.column_stack([np.where(np.isnan(side), alone, side) for side in (left, right)])
    for i, jump in (jumps or {}).items():
        beside = JUMP * jump / np.diff(times[i : i + 3]) ** 2
        halves[i, 1] = max(halves[i, 1], beside[0])
        if i + 1 < n:
            halves[i + 1, 0] = max(halves[i + 1, 0], beside[1])
    factor = 2.0 if order == 1 else 6.0
    middle = 0.5 * (times[1:] + times[:-1])
    edges = np.append(times[0], np.column_stack([middle, times[1:]]).ravel())
    rho = (halves.ravel() / factor) ** (1 / (order + 1))
    mean = float(rho @ np.diff(edges)) / (edges[-1] - edges[0])
    rho = np.maximum(rho, FLOOR * mean) if mean > 0 else np.ones(2 * n)
    return Density(edges, rho, order)


def _least(windows: np.ndarray, order: int) -> np.ndarray:
    """Between two steps the lesser of the windows that have both."""
    if order == 1:
        return windows.copy()
    return np.minimum(np.append(np.inf, windows), np.append(windows, np.inf))


def first_grid(cuts: np.ndarray, longest: float) -> np.ndarray:
    """Each segment in equal steps that are not too long."""
    return _parts(cuts, np.ceil(np.diff(cuts) / longest * (1 - 1e-9)))


def finer_grid(wanted: Density, cuts: np.ndarray, longest: float, n: float) -> np.ndarray:
    """About n steps that follow the density, in each segment halves of halves of equal parts.

    Steps twice as long have eight times the local error: how many equal parts a segment has before
    they are halved is tried, so that few steps are much shorter than they need be.
    """
    span = float(cuts[-1] - cuts[0])
    least = max(math.ceil(span / longest - 1e-9), 1)
    counts = {round(least * 2 ** (k / BASES)) for k in range(BASES)}
    if n >= least:
        counts.add(round(n / 2 ** math.floor(math.log2(n / least))))
    grids = [
        _following(wanted, _parts(cuts, np.diff(cuts) * count / span), longest, n)
        for count in sorted(counts)
    ]
    return min(grids, key=lambda times: wanted.errors(times) * len(times) ** wanted.order)


def _parts(cuts: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Each segment in about so many equal parts."""
    numbers = np.maximum(np.round(counts), 1).astype(int).tolist()
    ends = zip(cuts, cuts[1:], numbers, strict=False)
    return np.append(
        np.concatenate([np.linspace(a, b, k, endpoint=False) for a, b, k in ends]), cuts[-1]
    )


def _following(wanted: Density, cuts: np.ndarray, longest: float, n: float) -> np.ndarray:
    """About n steps, each a segment's length over 2^k, that follow the density."""
    n = max(math.ceil(n), 1)
    middle = 0.5 * (wanted.edges[1:] + wanted.edges[:-1])

    def grid(count: float) -> np.ndarray:
        # 2^(1/2): halving rounds to the nearer power
        sizes = math.sqrt(2) * wanted.total / count / wanted.rho
        sizes = np.minimum(sizes, 2 * longest)
        # the next step is at most about twice as long
        sizes = np.minimum(sizes, middle + np.minimum.accumulate(sizes - middle))
        sizes = np.minimum.accumulate((sizes + middle)[::-1])[::-1] - middle
        return _halve(
            cuts, lambda starts, h: h <= _smallest(wanted.edges, sizes, starts, h, longest)
        )

    few, many, count = grid(n / 4), None, float(n)
    low, high = n / 4, 4.0 * n
    for _ in range(8):
        found = grid(count)
        if len(found) - 1 > n:
            many, high = found, count
        else:
            few, low = found, count
        if len(found) - 1 == n:
            break
        count = math.sqrt(low * high)
    if many is None or len(few) - 1 >= n:
        return few
    # steps that ask for the same length change it together: some of them go first, evenly spread
    more = np.intersect1d(many, 0.5 * (few[1:] + few[:-1]))
    chosen = np.linspace(0, len(more) - 1, min(n + 1 - len(few), len(more)))
    return np.union1d(few, more[np.unique(chosen.astype(int))])


def _halve(cuts: np.ndarray, fine: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
    """The nodes of steps that are halved until they are fine; the same step has the same floats."""
    starts, ends, nodes = cuts[:-1], cuts[1:], [cuts]
    while starts.size:
        coarse = ~fine(starts, ends - starts)
        starts, ends = starts[coarse], ends[coarse]
        middle = 0.5 * (starts + ends)
        inside = (middle > starts) & (middle < ends)
        starts, middle, ends = starts[inside], middle[inside], ends[inside]
        nodes.append(middle)
        starts, ends = np.append(starts, middle), np.append(middle, ends)
        order = np.argsort(starts, kind="stable")
        starts, ends = starts[order], ends[order]
    return np.unique(np.concatenate(nodes))


def _smallest(
    edges: np.ndarray, sizes: np.ndarray, starts: np.ndarray, h: np.ndarray, longest: float
) -> np.ndarray:
    """The smallest size that is asked for within each step."""
    slack = 1e-6 * h
    i = np.searchsorted(edges, starts + slack, side="right") - 1
    j = np.maximum(np.searchsorted(edges, starts + h - slack, side="left"), i + 1)
    within = np.minimum.reduceat(np.append(sizes, np.inf), np.column_stack([i, j]).ravel())[::2]
    return np.minimum(within, longest) * (1 + 1e-9)
