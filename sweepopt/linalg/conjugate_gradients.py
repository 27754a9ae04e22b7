"""Conjugate gradients in place of factors that do not fit in memory, behind the same interface.

M z = w is solved for the matrix of unit diagonal D^-1/2 M D^-1/2, D = diag(M), preconditioned by
a symmetric V-cycle of smoothed aggregation (pyamg). Elimination is the same as with factors: with
S = E M^-1 E^T, one solve for each kept unknown, N = S^-1; a step costs two solves.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from sweepopt.checks import Matrix
from sweepopt.errors import IndefiniteError, SolverRefusedError, brought_by
from sweepopt.linalg.factor import Factor

RESIDUAL = 1e-13  # of a solve, in the norm of the V-cycle: a few digits above rounding
MAX_STEPS = 1000  # of one solve: a cycle that fits needs 17 to 28, measured on P1 and P2 Laplacians
HIERARCHY: dict[str, Any] = {
    "strength": ("symmetric", {"theta": 0.08}),  # pyamg's value for Laplacians in the plane
    # local weights: those of a spectral radius come from a random start, so that runs would differ
    "smooth": ("jacobi", {"omega": 4 / 3, "weighting": "local"}),
    "presmoother": ("gauss_seidel", {"sweep": "forward"}),
    "postsmoother": ("gauss_seidel", {"sweep": "backward"}),
    "improve_candidates": None,
}


class ConjugateGradients(Factor):
    """A sparse M = M^T > 0 that is not factorised.

    Parameters
    ----------
    M : sparse, shape (dim, dim)
    name : str
        How error messages call M.

    Raises
    ------
    IndefiniteError
        If a solve meets a direction of negative curvature.
    SolverRefusedError
        If a solve does not converge.
    MissingExtraError
        If pyamg is not installed.
    """

    method = "conjugate gradients"

    def __init__(self, M: Matrix, name: str = "M") -> None:
        super().__init__(sp.csr_array(M.T), name)  # M = M^T: no copy of a CSC matrix

    def _factorise_sparse(self) -> np.ndarray:
        with brought_by("speed"):
            import pyamg
        weights = sp.diags_array(1 / self.root)
        self._A = sp.csr_array(weights @ self.M @ weights)
        # constants, in the scaled unknowns or in the given ones: whatever costs less energy
        candidates = np.ones(self.dim), self.root / self.root.max()
        smoothest = min(candidates, key=lambda x: (x @ (self._A @ x)) / (x @ x))
        hierarchy = pyamg.smoothed_aggregation_solver(self._A, B=smoothest[:, None], **HIERARCHY)
        self._cycle = hierarchy.aspreconditioner("V").matvec
        # all eigenvectors are in a random right-hand side: a negative curvature shows
        self._iterate(np.random.default_rng(0).normal(size=self.dim), RESIDUAL)
        return self.diagonal / self.diagonal

    def solve(self, w: np.ndarray) -> np.ndarray:
        """M^-1 w of one vector or of columns, to RESIDUAL or to where rounding lets it stagnate."""
        if w.ndim == 2:
            return np.column_stack([self.solve(column) for column in w.T])
        right = w / self.root
        x, residual, size = np.zeros_like(right), right, self._size(right)
        target = RESIDUAL * size
        while size > target:
            change = self._iterate(residual, target / size)
            # the residual that the iteration carries along drifts from the true one
            residual, before = right - self._A @ (x + change), size
            size = self._size(residual)
            if size < before:
                x = x + change
            if size > 0.5 * before:
                break
        return x / self.root

    def _size(self, r: np.ndarray) -> float:
        return math.sqrt(max(r @ self._cycle(r), 0.0))

    def _iterate(self, r: np.ndarray, reduction: float) -> np.ndarray:
        """Preconditioned conjugate gradients (Hestenes, Stiefel) that look at the curvature."""
        x, direction, size, first = np.zeros_like(r), np.zeros_like(r), 0.0, math.inf
        for step in range(MAX_STEPS):
            y = self._cycle(r)
            before, size = size, float(r @ y)
            first = size if step == 0 else first
            if 0 <= size <= reduction**2 * first:
                return x
            direction = y + (size / before if step else 0.0) * direction
            image = self._A @ direction
            curvature = float(direction @ image)
            if not (size > 0 and curvature > 0):
                raise IndefiniteError("the matrix must be positive definite: <Mx, x> <= 0 was met")
            x += size / curvature * direction
            r = r - size / curvature * image
        raise SolverRefusedError(
            f"conjugate gradients do not converge in {MAX_STEPS} steps for this matrix, "
            "and its factors do not fit in memory; take a coarser mesh"
        )


class IterativeElimination(ConjugateGradients):
    """As `Elimination`, by solves with M: E M^-1 E^T costs one for each unknown that is kept."""

    def __init__(self, M: Matrix, unknowns: np.ndarray) -> None:
        super().__init__(M)
        self.unknowns = unknowns
        columns = []
        for unknown in unknowns:
            unit = np.zeros(self.dim)
            unit[unknown] = 1.0
            columns.append(self.solve(unit)[unknowns])
        S = np.column_stack(columns)
        self.N = scipy.linalg.inv(0.5 * (S + S.T))
        self.N = 0.5 * (self.N + self.N.T)

    def reduce(self, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The rows r and M^-1 r, and the force N E M^-1 r on zeta = E z."""
        solved = self.solve(r)
        return np.stack([r, solved]), self.N @ solved[self.unknowns]

    def size(self, forward: np.ndarray) -> float:
        """|r|_{M^-1} from what `reduce` gave for r."""
        r, solved = forward
        return math.sqrt(max(float(r @ solved), 0.0))

    def recover(self, forward: np.ndarray, force: np.ndarray) -> np.ndarray:
        """z with M z = r + E^T s and E z = zeta, from `reduce` of r and the force N zeta."""
        _, solved = forward
        pressure = np.zeros(self.dim)
        pressure[self.unknowns] = force - self.N @ solved[self.unknowns]
        return np.asarray(solved + self.solve(pressure))
