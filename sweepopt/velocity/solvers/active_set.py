"""An active-set method for small polyhedra, the last of the cascade: for ill-conditioned bodies.

For C = { w : G w <= h } the velocity program is the projection of q on C in the M^-1 metric. With
M = L L^T and w = q + L x this is the shortest x with  G L x <= h - G q,  z = L^-T x: the condition
of L is the square root of that of M, and no tolerance enters.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy.linalg

from sweepopt.errors import EmptySetError
from sweepopt.linalg import NEGLIGIBLE, dense, euclidean
from sweepopt.sets import (
    HULL,
    ROUNDING,
    ConvexSet,
    NoHalfspacesError,
    Polytope,
    least_distance,
    shape_of,
)
from sweepopt.velocity.program import Answer, Small, Solve, VelocityProgram

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
    >>> ActiveSet().treats(Box(-1.0, 1.0)), ActiveSet().treats(Ball([0.0, 0.0], 1.0))
    (True, False)
    """

    name = "active-set"

    def treats(self, C: ConvexSet) -> bool:
        """Whether C is small and its rows are known; those of a polytope wait until they count."""
        if not C.polyhedral or C.dim > self.max_dim:
            return False
        return C.dim <= HULL if isinstance(shape_of(C), Polytope) else _rows(C) is not None

    def compile(self, program: VelocityProgram) -> Solve:
        """Factorise M once; a call starts from no active rows."""
        M = program.M
        lower = cache(lambda: scipy.linalg.cholesky(dense(M.M), lower=True))

        def solve(q: np.ndarray, C: ConvexSet) -> Answer:
            rows, z, corrected = _rows(C), np.zeros_like(q), q
            if rows is None:  # a polytope that is flat to rounding
                return Answer(z, status="failed: no rows")
            G, h = rows
            # C has points and M is positive definite: where that is not seen it is rounding
            with contextlib.suppress(EmptySetError, scipy.linalg.LinAlgError):
                for _ in range(1 + REFINEMENTS):
                    L, rounding = lower(), ROUNDING * (np.abs(h) + np.abs(G) @ np.abs(corrected))
                    shortest = least_distance(G @ L, h - G @ corrected, rounding)
                    if shortest is None:
                        break
                    z = scipy.linalg.solve_triangular(L, shortest.u, lower=True, trans=1)
                    rounded = M.rounding(z, euclidean(q / M.root))
                    if rounded <= NEGLIGIBLE * euclidean(shortest.u):
                        break
                    # what L L^T misses of M goes to the linear term
                    corrected = M.precisely(z, q, -(L @ (L.T @ z)))
            return Answer(z, iterations=1, status="solved")

        return solve


def _rows(C: ConvexSet) -> tuple[np.ndarray, np.ndarray] | None:
    try:
        return C.halfspaces().inequalities()
    except NoHalfspacesError:
        return None
