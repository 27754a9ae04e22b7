"""Polish: Newton steps from another solver's answer, on the unknowns that the set acts on."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from sweepopt.linalg import Elimination, Factor, dense
from sweepopt.sets import ConvexSet
from sweepopt.sets.base import same_array
from sweepopt.solvers.newton import Iteration, Newton

NEWTON = Newton()
Polish = Callable[[np.ndarray, ConvexSet, np.ndarray], np.ndarray | None]


def polisher(M: Factor, order: np.ndarray | None) -> Polish:
    """(q, C, z) -> a better z, or None where Newton's method does not apply.

    The caller keeps it only if its certificate is better.

    Parameters
    ----------
    M : Factor
    order : ndarray of int or None
        An order of the unknowns with little fill.
    """
    whole = cache(lambda: Iteration(dense(M.M)))

    elimination: Elimination | None = None
    iterate: Iteration | None = None

    def polish(q: np.ndarray, C: ConvexSet, z: np.ndarray) -> np.ndarray | None:
        nonlocal elimination, iterate
        selection = C.selection
        if selection is None or not NEWTON.treats(selection.part):
            return whole()(q, C, z, NEWTON.max_iter)[0] if NEWTON.treats(C) else None
        few = selection.unknowns
        if elimination is None or iterate is None or not same_array(few, elimination.unknowns):
            elimination = Elimination(M.M, few, order)
            iterate = Iteration(elimination.N)
        forward, pull = elimination.reduce(-q if selection.shift is None else selection.shift - q)
        zeta, _ = iterate(-pull, selection.part, z[few], NEWTON.max_iter)
        z = elimination.recover(forward, elimination.N @ zeta)
        z[few] = zeta  # to the last bit: stuck is 0.0
        return z

    return polish
