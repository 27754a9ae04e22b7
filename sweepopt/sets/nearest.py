"""The point of a lifted set that is nearest, by the rows above it: no projection is iterated."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy.optimize

from sweepopt.errors import EmptySetError
from sweepopt.sets.active_set import least_distance
from sweepopt.sets.base import RANK, ROUNDING, Lifted, binary
from sweepopt.sets.flat import solutions

if TYPE_CHECKING:
    from sweepopt.sets.shapes import Box

PRESSED = 1e-9  # multipliers that are no more than this share of the largest may be rounding
BLIND = 1e-6  # weight of directions that M does not see, in units of its norm


def nearest_in_box(M: np.ndarray, box: Box, w: np.ndarray) -> np.ndarray:
    """s in the box with M s nearest to w, exact on the bounds it ends with."""
    s = box.lower.copy()
    free = box.lower < box.upper
    rest = w - M[:, ~free] @ s[~free]
    # in units of the data: the tolerances of the method are absolute
    norm = np.linalg.norm(M[:, free], 2)
    size = np.abs(rest).max() or 1.0
    bounds = np.array([box.lower[free], box.upper[free]]) * (norm / size)
    found = scipy.optimize.lsq_linear(
        M[:, free] / norm, rest / size, bounds=tuple(bounds), method="bvls", tol=1e-16
    )
    s[free] = found.x * (size / norm)
    return box.project(s)


class OnRows(NamedTuple):
    """s and the multipliers of all rows, E^T (w - c - E s) = G^T multipliers."""

    s: np.ndarray
    multipliers: np.ndarray


def nearest_on_rows(lift: Lifted, w: np.ndarray) -> OnRows | None:
    """s with G s <= h and c + E s nearest to w: the rows by an active set, then exact on these.

    What E does not see is given a small weight, so that the shortest way tells the rows. The caller
    confirms the answer; None if there is none.
    """
    if not lift.E.any():
        return None
    # units of s and of the rows, powers of two, in which columns of E and rows are near 1
    units = _units(np.abs(lift.E).max(axis=0))
    M, G, w = lift.E / units, lift.G / units, w - lift.c
    rows = _units(np.abs(G).max(axis=1))
    G, h = G / rows[:, None], lift.h / rows
    U, sizes, Vt = np.linalg.svd(M, full_matrices=M.shape[0] < M.shape[1])
    seen = sizes > RANK * sizes[0]
    weights = np.full(len(Vt), BLIND * sizes[0])
    weights[: len(sizes)][seen] = sizes[seen]
    back = Vt.T / weights  # s = s0 + back @ x
    s0 = Vt[: len(sizes)][seen].T @ ((U.T @ w)[: len(sizes)][seen] / sizes[seen])
    slack, multipliers = h - G @ s0, np.zeros(h.size)
    if (slack >= 0).all():
        return OnRows(s0 / units, multipliers)
    rounding = ROUNDING * (np.abs(h) + np.abs(G) @ np.abs(s0))
    try:
        found = least_distance(G @ back, slack, rounding)
    except EmptySetError:  # the part is not empty: rounding of what M hardly sees
        return None
    if found is None or not found.active.size:
        return None
    # on the face of these rows: s + Z y with M (s + Z y) nearest to w
    s, held = s0 + back @ found.u, G[found.active]
    change, Z = solutions(held, h[found.active] - held @ s)
    s = s + change
    s = s + Z @ np.linalg.lstsq(M @ Z, w - M @ s, rcond=RANK)[0]
    multipliers[found.active] = np.linalg.lstsq(held.T, M.T @ (w - M @ s), rcond=RANK)[0]
    pressed = found.active[multipliers[found.active] > PRESSED * np.abs(multipliers).max()]
    return OnRows(_inside(G, h, np.vstack([M, G[pressed]]), s) / units, multipliers / rows)


def _inside(G: np.ndarray, h: np.ndarray, fixed: np.ndarray, s: np.ndarray) -> np.ndarray:
    """s with rows that a far w hid in its rounding met too, moved where `fixed` does not see it."""
    slack, rounding = h - G @ s, ROUNDING * (np.abs(h) + np.abs(G) @ np.abs(s))
    if (slack >= -10 * rounding).all():
        return s
    free = solutions(fixed, np.zeros(len(fixed))).Z
    try:
        found = least_distance(G @ free, np.where(np.abs(slack) <= rounding, 0, slack), rounding)
    except EmptySetError:
        return s
    return s if found is None else s + free @ found.u


def _units(sizes: np.ndarray) -> np.ndarray:
    return np.array([binary(size) for size in sizes.tolist()])
