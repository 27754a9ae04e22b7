"""A pass whose error grows too large: the steps to halve, and where to begin again.

What a step adds to the error at a later time is known from what each step keeps of the error
before it. The fewest steps are halved that bring the error down; all steps before the first of
them are as they would be, and need not be made again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sweepopt.integrate.error_model import SPREAD, Carried, Missed
from sweepopt.integrate.error_propagation import Flow

GAIN = 0.75  # of what a step misses goes where it is halved, at order 2
MOST = 0.3  # of the steps, or ...
FEW = 3  # ... so many: where more are to be halved, the grid is wrong as a whole
FORGOTTEN = 1e-6  # of an error that no later time knows any more


class Mended(NamedTuple):
    """A grid, and how many of its steps are those of the one before."""

    times: np.ndarray
    known: int


def mended(
    flow: Flow,
    times: np.ndarray,
    missed: Missed,
    carried: Carried,
    limit: float,
    goal: float,
    shortest: float,
) -> Mended | None:
    """A grid whose error is about `goal` where that of `times` is beyond the limit.

    `missed` and `carried` are of the steps that are made. Nothing where too many were to be halved,
    or some that would be shorter than the shortest step.
    """
    sizes = carried.sizes(flow)
    beyond = int(np.argmax(sizes > limit))
    k = beyond + int(np.argmax(sizes[beyond:]))
    size = max(float(flow.norms(carried.errors[k : k + 1])[0]), np.finfo(float).tiny)
    toward = flow.dual(carried.errors[k] / size)
    kept, rest = np.ones_like(toward), 1.0
    added, variance = np.zeros(k + 1), np.zeros(k + 1)
    for i in range(k, -1, -1):
        added[i] = (missed.own[i] * kept) @ toward
        variance[i] = (missed.scatter[i] * rest) ** 2
        kept, rest = kept * missed.kept[i], rest * missed.rest[i]
        if np.abs(kept).max() < FORGOTTEN:
            break
    deviation = max(float(np.sqrt(variance.sum())), np.finfo(float).tiny)
    gains = GAIN * (np.maximum(added, 0.0) + SPREAD * variance / deviation)
    largest = np.argsort(-gains, kind="stable")
    enough = int(np.searchsorted(np.cumsum(gains[largest]), sizes[k] - goal)) + 1
    halved = np.sort(largest[:enough][gains[largest[:enough]] > 0])
    if not 0 < len(halved) <= max(MOST * k, FEW):
        return None
    if np.diff(times)[halved].min() < 2 * shortest:
        return None
    middle = 0.5 * (times[halved] + times[halved + 1])
    return Mended(np.sort(np.append(times, middle)), int(halved[0]))
