"""Where in a step the velocity has a kink: something starts to slip, or stops.

A kink between two midpoints is in the second differences there alone: their sum is the jump of the
slope, their ratio the place. What they have beyond those beside them is taken for a kink where it
is more than the curvature on one side at least; the rest of it for curvature.

At A = 0 with flat faces what moves is where it should be at the end of each step: only what stops
within a step is not. The way there is a parabola or a cubic through the nodes before, and its
vertex the place.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

BEYOND = 1.5  # times the curvature beside it that a second difference at a kink has
SLACK = 0.1  # of a step that a kink may seem to be outside of it
EARLY = 0.5  # of a step that a stop may seem to be before it


class Kinks(NamedTuple):
    """Kinks of single unknowns, an entry each.

    Attributes
    ----------
    t : ndarray
    unknown : ndarray of int
    jump : ndarray
        Of the slope of the velocity.
    step : ndarray of int
        The step whose end is wrong because of it.
    missed : ndarray
        By how much, where that is known from u itself; nan elsewhere.
    sure : ndarray of bool
        Whether the place is known to a higher order than the step's.
    """

    t: np.ndarray
    unknown: np.ndarray
    jump: np.ndarray
    step: np.ndarray
    missed: np.ndarray
    sure: np.ndarray

    def within(self, start: int, stop: int) -> Kinks:
        """Those of the steps from `start` to `stop`, which are counted from `start` on."""
        chosen = (self.step >= start) & (self.step < stop)
        return Kinks(*(part[chosen] for part in self))._replace(step=self.step[chosen] - start)


NONE = Kinks(*(np.zeros(0, kind) for kind in (float, int, float, int, float, bool)))


def joined(parts: list[Kinks]) -> Kinks:
    """All of them in one."""
    return Kinks(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def find_kinks(
    times: np.ndarray,
    z: np.ndarray,
    segment: np.ndarray,
    parts: Callable[[np.ndarray], np.ndarray],
) -> tuple[Kinks, np.ndarray]:
    """The kinks, and the second difference quotients without them.

    Parameters
    ----------
    times : ndarray, shape (n+1,)
    z : ndarray, shape (n, dim)
    segment : ndarray of int, shape (n,)
        Between which breakpoints each step is; nothing is compared across one.
    parts : callable
        Norms of rows, a column for all unknowns together or one for each: these have kinks apart.

    Returns
    -------
    Kinks
    ndarray, shape (n-2, dim)
        Window k has the velocities of the steps from k to k + 2.
    """
    middle = 0.5 * (times[1:] + times[:-1])
    slopes = np.diff(z, axis=0) / np.diff(middle)[:, None]
    width = (0.5 * (middle[2:] - middle[:-2]))[:, None]
    inner = (segment[2:] == segment[:-2])[:, None]
    curvature = np.diff(slopes, axis=0) / width
    if len(curvature) < 3:
        return NONE, curvature
    # between the midpoints k + 1 and k + 2 are the windows k and k + 1
    steps = curvature * width
    sizes = parts(steps)
    change = np.where(inner[1:] & inner[:-1], parts(steps[1:] + steps[:-1]), 0.0)
    edge = np.full((1, change.shape[1]), np.inf)
    outer = np.where(inner, sizes / width, np.inf)
    beside = np.minimum(np.vstack([edge, outer[:-2]]), np.vstack([outer[2:], edge]))
    none = np.zeros_like(edge)
    there = change >= np.vstack([none, change[:-1]])
    there &= (change > np.vstack([change[1:], none])) & np.isfinite(beside)
    there &= np.abs(_share(sizes, change) - 0.5) <= 0.5 + SLACK
    there &= change > BEYOND * beside * (width[:-1] + width[1:])

    k, unknown = np.nonzero(np.broadcast_to(there, (len(change), z.shape[1])))
    smooth = _filled(curvature, k, unknown, inner)
    excess = (curvature - smooth) * width
    jump = excess[:-1] + excess[1:]
    place = np.clip(_share(parts(excess), parts(jump)), 0.0, 1.0)
    place = np.broadcast_to(place, jump.shape)[k, unknown]
    t = (1 - place) * middle[k + 1] + place * middle[k + 2]
    step = k + 1 + (t >= times[k + 2])
    known, sure = np.full(len(k), np.nan), np.ones(len(k), dtype=bool)
    kinks = Kinks(t, unknown, jump[k, unknown], step, known, sure)
    return Kinks(*(column[~np.isnan(t)] for column in kinks)), smooth


def _share(sizes: np.ndarray, sums: np.ndarray) -> np.ndarray:
    """The second one's share of the sum of two vectors, from the norms; nan where there is none."""
    shares = np.full_like(sums, np.nan)
    second = sizes[1:] ** 2 + sums**2 - sizes[:-1] ** 2
    np.divide(second, 2 * sums**2, out=shares, where=sums > 0)
    return shares


def _filled(
    curvature: np.ndarray, k: np.ndarray, unknown: np.ndarray, inner: np.ndarray
) -> np.ndarray:
    """The curvature; in both windows of a kink that beside it on their side, or none."""
    clean = np.where(inner, curvature, 0.0)
    clean[k, unknown] = clean[k + 1, unknown] = 0.0
    clean = np.pad(clean, ((1, 1), (0, 0)))
    filled = curvature.copy()
    filled[k, unknown], filled[k + 1, unknown] = clean[k, unknown], clean[k + 3, unknown]
    return filled


def find_stops(times: np.ndarray, z: np.ndarray, segment: np.ndarray) -> Kinks:
    """Where unknowns stop at A = 0: the vertices of the ways before.

    Parameters
    ----------
    times : ndarray, shape (n+1,)
    z : ndarray, shape (n, dim)
    segment : ndarray of int, shape (n,)
    """
    n = len(z)
    if n < 5:
        return NONE
    moves = z != 0
    # three steps of one motion before the one in which it stops, the first of them from rest on
    k, j = np.nonzero(moves[3:-1] & moves[2:-2] & moves[1:-3] & ~moves[4:])
    k += 3
    alike = (segment[k - 2] == segment[k]) & (z[k - 1, j] * z[k - 2, j] > 0)
    begun = moves[k - 3, j] & (segment[k - 3] == segment[k - 2])
    k, j = k[alike & begun], j[alike & begun]
    if not k.size:
        return NONE
    four = np.maximum(k - 4, 0)
    third = (k >= 4) & moves[four, j] & (segment[four] == segment[k])
    third &= z[k - 3, j] * z[k - 1, j] > 0
    a, b, c = (times[k - i] - times[k] for i in (1, 2, 3))
    f1, f2 = z[k - 1, j], (z[k - 2, j] - z[k - 1, j]) / b
    f3 = np.where(third, ((z[k - 3, j] - z[k - 2, j]) / (c - a) - f2) / c, 0.0)
    tau = _vertex(f1 - f2 * a + f3 * a * b, 2 * (f2 - f3 * (a + b)), 3 * f3)
    h, then = times[k + 1] - times[k], times[np.minimum(k + 2, n)] - times[k]
    seen = (tau >= -EARLY * h) & (tau <= then)
    tau = np.maximum(tau, 0.0)
    slope = 2 * (f2 - f3 * (a + b)) + 6 * f3 * tau
    seen &= slope * f1 < 0
    way = tau * (f1 + (tau - a) * (f2 + (tau - b) * f3))
    found = Kinks(times[k] + tau, j, -slope, k, h * z[k, j] - way, third)
    return Kinks(*(part[seen] for part in found))


def _vertex(c0: np.ndarray, c1: np.ndarray, c2: np.ndarray) -> np.ndarray:
    """The root of c0 + c1 t + c2 t^2 that is nearest to 0; nan where there is none."""
    square = c1**2 - 4 * c2 * c0
    below = c1 + np.copysign(np.sqrt(np.maximum(square, 0.0)), c1)
    root = np.full_like(c0, np.nan)
    np.divide(-2 * c0, below, out=root, where=(square >= 0) & (below != 0))
    return root
