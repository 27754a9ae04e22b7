"""A factorisation that ends with a few unknowns: all others leave a problem exactly."""

from __future__ import annotations

import numpy as np
import scipy.linalg
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from scipy.linalg import lapack  # the plain calls: no checks in the loop

from sweepopt.checks import Matrix
from sweepopt.linalg.factor import Factor
from sweepopt.linalg.matrices import SYMMETRIC


class Elimination(Factor):
    """A factorisation L L^T that ends with a few unknowns, to eliminate all others exactly.

    For M z = r + E^T s, E selecting the unknowns, one forward and one backward substitution frame
    a problem for zeta = E z alone, with the Schur complement N = (E M^-1 E^T)^-1, which is the
    trailing block of the factor: a step costs as much as one without the set.

    Parameters
    ----------
    M : ndarray or sparse, shape (dim, dim)
    unknowns : ndarray of int, shape (m,)
        The unknowns to keep.
    order : ndarray of int, optional
        An order with little fill, as a `Factor` of a matrix of the same pattern tells it.
    """

    def __init__(self, M: Matrix, unknowns: np.ndarray, order: np.ndarray | None = None) -> None:
        self.unknowns = unknowns
        if order is None:
            order = Factor(M).order
        everyone = np.arange(M.shape[0]) if order is None else order
        first = everyone[~np.isin(everyone, unknowns)]
        self._order = np.concatenate([first, unknowns])
        super().__init__(M)
        self.N = self._tail @ self._tail.T

    def _factorise_sparse(self) -> np.ndarray:
        ordered = sp.csc_matrix(self.M[self._order][:, self._order])
        lu = spla.splu(ordered, permc_spec="NATURAL", **SYMMETRIC)
        pivots = lu.U.diagonal()
        relative = pivots / self.diagonal[self._order]
        if relative.min() > 0:
            lower = (lu.L @ sp.diags_array(np.sqrt(pivots))).tocsc()
            m = self.unknowns.size
            self._tail = lower[-m:, -m:].toarray()
            # the factor factorised gives its substitutions apart, forward and transposed
            self._triangle = spla.splu(lower, permc_spec="NATURAL", **SYMMETRIC)
        return relative

    def _factorise_dense(self) -> np.ndarray:
        ordered = self.M[np.ix_(self._order, self._order)]
        self._lower = scipy.linalg.cholesky(ordered, lower=True)
        m = self.unknowns.size
        self._tail = self._lower[-m:, -m:]
        return self._lower.diagonal() ** 2 / self.diagonal[self._order]

    def _substitute(self, w: np.ndarray, transposed: bool = False) -> np.ndarray:
        """L^-1 w or L^-T w."""
        if sp.issparse(self.M):
            return self._triangle.solve(w, "T" if transposed else "N")
        return lapack.dtrtrs(self._lower, w, lower=True, trans=int(transposed))[0]

    def solve(self, w: np.ndarray) -> np.ndarray:
        """M^-1 w."""
        return self._backward(self._substitute(w[self._order]))

    def _backward(self, forward: np.ndarray) -> np.ndarray:
        z = np.empty_like(forward)
        z[self._order] = self._substitute(forward, transposed=True)
        return z

    def reduce(self, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forward substitution of r, and the force N E M^-1 r on zeta.

        The Euclidean norm of the first is |r|_{M^-1}.
        """
        forward = self._substitute(r[self._order])
        return forward, self._tail @ forward[-self.unknowns.size :]

    def recover(self, forward: np.ndarray, force: np.ndarray) -> np.ndarray:
        """z from the forward substitution and the total force N zeta on zeta."""
        forward[-self.unknowns.size :] = lapack.dtrtrs(self._tail, force, lower=True)[0]
        return self._backward(forward)
