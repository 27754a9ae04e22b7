"""A symmetric positive definite matrix factorised once: solves and the two norms it defines."""

from __future__ import annotations

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

    Raises
    ------
    InputError
        If M is not positive definite.
    """

    def __init__(self, M: Matrix, name: str = "M") -> None:
        self.M, self.dim = M, M.shape[0]
        self.diagonal = np.asarray(M.diagonal(), dtype=float)
        if not (self.diagonal > 0).all():
            i = int(np.flatnonzero(self.diagonal <= 0)[0])
            raise InputError(
                f"{name} must be positive definite, but {name}[{i}, {i}] = {self.diagonal[i]:g}"
            )
        # unit diagonal: the test for definiteness and the solves do not depend on units
        self._root = np.sqrt(self.diagonal)
        if sp.issparse(M):
            weights = sp.diags_array(1 / self._root)
            self._lu = spla.splu(
                sp.csc_matrix(weights @ M @ weights),
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
            # with pivots on the diagonal their signs are the inertia (Sylvester)
            pivots = self._lu.U.diagonal()
        else:
            try:
                self._cholesky = scipy.linalg.cho_factor(M / np.outer(self._root, self._root))
                pivots = self._cholesky[0].diagonal() ** 2
            except scipy.linalg.LinAlgError:
                pivots = np.zeros(1)
        if not pivots.min() > 16 * np.finfo(float).eps:
            raise InputError(f"{name} must be positive definite; it has an eigenvalue <= 0")

    def solve(self, w: np.ndarray) -> np.ndarray:
        """M^-1 w."""
        scaled = w / self._root
        if sp.issparse(self.M):
            return self._lu.solve(scaled) / self._root
        return scipy.linalg.cho_solve(self._cholesky, scaled, check_finite=False) / self._root

    def norm(self, z: np.ndarray) -> float:
        """|z|_M = sqrt<Mz, z>."""
        return float(np.sqrt(max(z @ (self.M @ z), 0.0)))

    def dual_norm(self, w: np.ndarray) -> float:
        """|w|_{M^-1} = sqrt<M^-1 w, w>."""
        return float(np.sqrt(max(w @ self.solve(w), 0.0))) if w.any() else 0.0

    def smallest_eigenvalue(self) -> float:
        """beta: the largest number with <Mx, x> >= beta |x|^2."""
        if not sp.issparse(self.M) or self.dim < 50:
            return float(np.linalg.eigvalsh(_dense(self.M))[0])
        inverse = spla.LinearOperator((self.dim, self.dim), matvec=self.solve, dtype=float)
        start = np.ones(self.dim)
        return float(
            1 / spla.eigsh(inverse, k=1, which="LA", v0=start, return_eigenvectors=False)[0]
        )

    def largest_ratio(self, B: Matrix) -> float:
        """Lam: the largest eigenvalue of M^-1 B, for B positive semidefinite."""
        if not sp.issparse(self.M) or self.dim < 50:
            return float(scipy.linalg.eigh(_dense(B), _dense(self.M), eigvals_only=True)[-1])
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
        return float(np.linalg.eigvalsh(_dense(M))[-1])
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


def _dense(M: Matrix) -> np.ndarray:
    return M.toarray() if sp.issparse(M) else M
