"""Conjugate gradients in place of factors that do not fit in memory, behind the same interface.

M z = w is solved for the matrix of unit diagonal D^-1/2 M D^-1/2, D = diag(M), preconditioned by
a symmetric V-cycle of smoothed aggregation (pyamg). Elimination is the same as with factors: with
S = E M^-1 E^T, one solve for each kept unknown, N = S^-1; a step costs two solves.
"""

import math

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from sweepopt.checks import Array, Matrix
from sweepopt.errors import IndefiniteError, SolverRefusedError, brought_by
from sweepopt.linalg.matrices import Reduced, euclidean, lanczos_start

RESIDUAL = 1e-13  # of a solve, relative: a few digits above rounding
MAX_STEPS = 1000  # of one solve: a cycle that fits needs 17 to 28, measured on P1 and P2 Laplacians
# local weights: those of a spectral radius come from a random start, so that runs would differ
SMOOTHING = ("jacobi", {"omega": 4 / 3, "weighting": "local"})


class ConjugateGradients:
    """A sparse M = M^T > 0 that is not factorised; `kept` are the unknowns not to be eliminated.

    It raises IndefiniteError where a solve meets a direction of negative curvature,
    SolverRefusedError where one does not converge, MissingExtraError without pyamg.
    """

    has_factors = False
    order = None

    def __init__(self, M: Matrix, kept: Array | None) -> None:
        with brought_by("speed"):
            import pyamg
        self.pivots = M.diagonal()
        self._root = np.sqrt(self.pivots)
        weights = sp.diags_array(1 / self._root)
        self._A = sp.csr_array(weights @ M @ weights)
        hierarchy = pyamg.smoothed_aggregation_solver(
            self._A, smooth=SMOOTHING, improve_candidates=None
        )
        self._cycle = hierarchy.aspreconditioner()
        self._operator = spla.LinearOperator(M.shape, matvec=self._image, dtype=float)
        # all eigenvectors are in a random right-hand side: a negative curvature shows
        self.solve(self._root * lanczos_start(len(self._root)))
        if kept is not None:
            self._unknowns = kept
            units = np.zeros((len(kept), len(self._root)))
            units[np.arange(len(kept)), kept] = 1.0
            N = np.linalg.inv(self.solve(units.T)[kept])
            self.N = 0.5 * (N + N.T)

    def _image(self, x: Array) -> Array:
        image = self._A @ x
        if not x @ image > 0:
            raise IndefiniteError("the matrix must be positive definite: <Mx, x> <= 0 was met")
        return image

    def solve(self, w: Array) -> Array:
        """M^-1 w of one vector or of columns, to RESIDUAL or to where rounding lets it stagnate."""
        if w.ndim == 2:
            return np.column_stack([self.solve(column) for column in w.T])
        right = w / self._root
        x, residual, size = np.zeros_like(right), right, euclidean(right)
        target, before = RESIDUAL * size, math.inf
        # the residual that the iteration carries along drifts from the true one
        while target < size < 0.5 * before:
            change, failed = spla.cg(
                self._operator, residual, rtol=0.0, atol=target, maxiter=MAX_STEPS, M=self._cycle
            )
            if failed:
                raise SolverRefusedError(
                    f"conjugate gradients do not converge in {MAX_STEPS} steps for this matrix, "
                    "and its factors do not fit in memory; take a coarser mesh"
                )
            x = x + change
            residual, before = right - self._A @ x, size
            size = euclidean(residual)
        return x / self._root

    def reduce(self, r: Array) -> Reduced:
        """M^-1 r, and the force N E M^-1 r on zeta = E z."""
        solved = self.solve(r)
        return Reduced(solved, self.N @ solved[self._unknowns], math.sqrt(max(r @ solved, 0.0)))

    def recover(self, solved: Array, zeta: Array) -> Array:
        """z with M z = r + E^T s and E z = zeta, from M^-1 r."""
        pressure = np.zeros(len(self._root))
        pressure[self._unknowns] = self.N @ (zeta - solved[self._unknowns])
        return np.asarray(solved + self.solve(pressure))
