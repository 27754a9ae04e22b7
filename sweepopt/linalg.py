"""A symmetric positive definite matrix factorised once: solves and the two norms it defines."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from sweepopt.checks import Matrix
from sweepopt.errors import InputError


class Factor:
    """M = M^T > 0 with its factorisation.

    Parameters
    ----------
    M : ndarray or sparse, shape (dim, dim)
    name : str
        How error messages call M.
    last : ndarray of int, optional
        Unknowns to be eliminated last: their Schur complement is then the trailing block of the
        factor, for free.

    Raises
    ------
    InputError
        If M is not positive definite.
    """

    def __init__(self, M: Matrix, name: str = "M", last: np.ndarray | None = None) -> None:
        self.M, self.dim = M, M.shape[0]
        self.diagonal = np.asarray(M.diagonal(), dtype=float)
        if not (self.diagonal > 0).all():
            i = int(np.flatnonzero(self.diagonal <= 0)[0])
            raise InputError(
                f"{name} must be positive definite, but {name}[{i}, {i}] = {self.diagonal[i]:g}"
            )
        # unit diagonal: the test for definiteness and the solves do not depend on units
        self._root = np.sqrt(self.diagonal)
        self._last = np.zeros(0, dtype=int) if last is None else last
        first = np.setdiff1d(np.arange(self.dim), self._last)
        try:
            if sp.issparse(M):
                weights = sp.diags_array(1 / self._root)
                pivots = self._factorise_sparse(sp.csr_array(weights @ M @ weights), first)
            else:
                pivots = self._factorisedense(M / np.outer(self._root, self._root), first)
        except (scipy.linalg.LinAlgError, RuntimeError):
            pivots = np.zeros(1)
        if not pivots.min() > 16 * np.finfo(float).eps:
            raise InputError(f"{name} must be positive definite; it has an eigenvalue <= 0")

    def _factorise_sparse(self, M: sp.csr_array, first: np.ndarray) -> np.ndarray:
        options: dict[str, Any] = {
            "diag_pivot_thresh": 0.0,
            "options": {"SymmetricMode": True},
        }
        if self._last.size:
            inner = sp.csc_matrix(M[first][:, first])
            # a factorisation of the others tells their order of little fill
            order = spla.splu(inner, permc_spec="MMD_AT_PLUS_A", **options).perm_c
            first = first[np.argsort(order)]
            self._order = np.concatenate([first, self._last])
            ordered = sp.csc_matrix(M[self._order][:, self._order])
            self._lu = spla.splu(ordered, permc_spec="NATURAL", **options)
        else:
            self._order = first
            self._lu = spla.splu(sp.csc_matrix(M), permc_spec="MMD_AT_PLUS_A", **options)
        # with pivots on the diagonal their signs are the inertia (Sylvester)
        return self._lu.U.diagonal()

    def _factorisedense(self, M: np.ndarray, first: np.ndarray) -> np.ndarray:
        self._order = np.concatenate([first, self._last])
        ordered = M[np.ix_(self._order, self._order)]
        self._cholesky = scipy.linalg.cho_factor(ordered, lower=True)
        return self._cholesky[0].diagonal() ** 2

    def schur(self) -> np.ndarray:
        """N = (E M^-1 E^T)^-1 for the selection E of the unknowns put last, shape (m, m)."""
        m = self._last.size
        if sp.issparse(self.M):
            lower, upper = self._lu.L[-m:, -m:], self._lu.U[-m:, -m:]
            trailing = (lower @ upper).toarray()
        else:
            lower = np.tril(self._cholesky[0][-m:, -m:])
            trailing = lower @ lower.T
        root = self._root[self._last]
        return 0.5 * (trailing + trailing.T) * np.outer(root, root)

    def solve(self, w: np.ndarray) -> np.ndarray:
        """M^-1 w."""
        ordered = (w / self._root)[self._order]
        if sp.issparse(self.M):
            solved = self._lu.solve(ordered)
        else:
            solved = scipy.linalg.cho_solve(self._cholesky, ordered, check_finite=False)
        z = np.empty_like(solved)
        z[self._order] = solved
        return z / self._root

    def dual_norm_bound(self, w: np.ndarray) -> float:
        """A bound of |w|_{M^-1} that costs no solve: |D^-1/2 w| / sqrt(lambda_min), D = diag(M).

        lambda_min is that of D^-1/2 M D^-1/2.
        """
        return float(np.linalg.norm(w / self._root)) * self._bound_factor

    @cached_property
    def _bound_factor(self) -> float:
        # Lanczos meets the largest eigenvalue of the inverse from below: 1 % on top covers it
        inverse = spla.LinearOperator(
            (self.dim, self.dim),
            matvec=lambda x: self._root * self.solve(self._root * x),
            dtype=float,
        )
        if self.dim < 50:
            columns = [inverse.matvec(e) for e in np.eye(self.dim)]
            return float(np.sqrt(np.linalg.eigvalsh(np.array(columns))[-1]))
        start = np.ones(self.dim)
        largest = spla.eigsh(
            inverse, k=1, which="LA", v0=start, tol=1e-3, return_eigenvectors=False
        )
        return float(1.01 * np.sqrt(largest[0]))

    def norm(self, z: np.ndarray) -> float:
        """|z|_M = sqrt<Mz, z>."""
        return float(np.sqrt(max(z @ (self.M @ z), 0.0)))

    def dual_norm(self, w: np.ndarray) -> float:
        """|w|_{M^-1} = sqrt<M^-1 w, w>."""
        return float(np.sqrt(max(w @ self.solve(w), 0.0))) if w.any() else 0.0

    def smallest_eigenvalue(self) -> float:
        """beta: the largest number with <Mx, x> >= beta |x|^2."""
        if not sp.issparse(self.M) or self.dim < 50:
            return float(np.linalg.eigvalsh(dense(self.M))[0])
        inverse = spla.LinearOperator((self.dim, self.dim), matvec=self.solve, dtype=float)
        start = np.ones(self.dim)
        return float(
            1 / spla.eigsh(inverse, k=1, which="LA", v0=start, return_eigenvectors=False)[0]
        )

    def largest_ratio(self, B: Matrix) -> float:
        """Lam: the largest eigenvalue of M^-1 B, for B positive semidefinite."""
        if not sp.issparse(self.M) or self.dim < 50:
            return float(scipy.linalg.eigh(dense(B), dense(self.M), eigvals_only=True)[-1])
        inverse = spla.LinearOperator((self.dim, self.dim), matvec=self.solve, dtype=float)
        start = np.ones(self.dim)
        return float(
            spla.eigsh(
                B, k=1, M=self.M, Minv=inverse, which="LA", v0=start, return_eigenvectors=False
            )[0]
        )


def largest_eigenvalue(M: Matrix) -> float:
    """The largest eigenvalue of a symmetric matrix, |M| for a positive semidefinite one."""
    if M.shape[0] < 50 or not sp.issparse(M):
        return float(np.linalg.eigvalsh(dense(M))[-1])
    start = np.ones(M.shape[0])
    return float(spla.eigsh(M, k=1, which="LA", v0=start, return_eigenvectors=False)[0])


def is_semidefinite(M: Matrix) -> bool:
    """Whether a symmetric matrix is positive semidefinite up to rounding, in its own units."""
    diagonal = np.asarray(M.diagonal(), dtype=float)
    if (diagonal < 0).any():
        return False
    # a zero on the diagonal of a semidefinite matrix has a zero row
    empty = diagonal == 0
    if abs(M[empty]).sum() > 0:
        return False
    shift = np.where(empty, 1.0, 1e-10 * diagonal)
    shifted = M + (sp.diags_array(shift, format="csc") if sp.issparse(M) else np.diag(shift))
    try:
        Factor(shifted)
    except InputError:
        return False
    return True


def dense(M: Matrix) -> np.ndarray:
    """M as an ndarray."""
    return M.toarray() if sp.issparse(M) else M
