"""An active-set method for small polyhedra, the last of the cascade: for ill-conditioned bodies.

For C = { w : G w <= h } the velocity program is the projection of q on C in the M^-1 metric. With
M = L L^T and w = q + L x this is the shortest x with  G L x <= h - G q,  z = L^-T x: the condition
of L is the square root of that of M, and no tolerance enters.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from sweepopt.errors import EmptySetError
from sweepopt.linalg import NEGLIGIBLE, dense, euclidean
from sweepopt.sets import ROUNDING, ConvexSet, NoHalfspacesError, least_distance
from sweepopt.velocity.program import VelocityProgram
from sweepopt.velocity.solvers.contract import Answer, Small, Solve

REFINEMENTS = 3  # of what L rounds: without them polyhedra beside jumps of 1e8 are not met


@dataclass(frozen=True)
class ActiveSet(Small):
    """The library's own active-set method, for small sets whose rows are known.

    Parameters
    ----------
    max_dim : int
        Larger programs are left to the other solvers: a row that enters costs dim^2 operations.

    Raises
    ------
    InputError
        If max_dim is not positive.

    Examples
    --------
    >>> from sweepopt.sets import Ball, Box
    >>> ActiveSet().treats(Box([-1.0], [1.0])), ActiveSet().treats(Ball([0.0, 0.0], 1.0))
    (True, False)
    """

    name = "active-set"

    def treats(self, C: ConvexSet) -> bool:
        """Whether C is small and its rows are known."""
        return C.polyhedral and C.dim <= self.max_dim and _rows(C) is not None

    def compile(self, program: VelocityProgram) -> Solve:
        """Factorise M once; a call starts from no active rows."""
        M, L = program.M, np.zeros((0, 0))
        with contextlib.suppress(scipy.linalg.LinAlgError):  # M may be indefinite to rounding
            L = scipy.linalg.cholesky(dense(M.M), lower=True)

        def nearest(q: np.ndarray, G: np.ndarray, h: np.ndarray) -> np.ndarray | None:
            rounding = ROUNDING * (np.abs(h) + np.abs(G) @ np.abs(q))
            projection = least_distance(G @ L, h - G @ q, rounding)
            return None if projection is None else projection.u

        def solve(q: np.ndarray, C: ConvexSet) -> Answer:
            rows = _rows(C)
            assert rows is not None
            G, h = rows
            z, nothing = np.zeros_like(q), np.zeros(C.offsets.size)
            corrected = q
            if not L.size:
                return Answer(z, nothing, 0, "failed: rounding")
            for _ in range(1 + REFINEMENTS):
                try:
                    x = nearest(corrected, G, h)
                except EmptySetError:  # C was looked at before: M L^-T is rounding here
                    x = None
                if x is None:
                    return Answer(z, nothing, 0, "failed: rounding")
                z = scipy.linalg.solve_triangular(L, x, lower=True, trans=1)
                rounding = M.rounding(euclidean(M.root * z), euclidean(q / M.root))
                if rounding <= NEGLIGIBLE * euclidean(x):
                    break
                # what L L^T misses of M goes to the linear term
                corrected = M.precisely(z, q, -(L @ (L.T @ z)))
            return Answer(z, nothing, 1, "solved")

        return solve


def _rows(C: ConvexSet) -> tuple[np.ndarray, np.ndarray] | None:
    """G and h with C = { w : G w <= h }, an equation as two rows."""
    try:
        N, d, E, e = C.halfspaces()
    except NoHalfspacesError:
        return None
    return np.vstack([dense(N), E, -E]), np.concatenate([d, e, -e])
