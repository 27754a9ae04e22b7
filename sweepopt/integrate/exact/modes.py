"""The closed form on a face: a linear system with powers and waves on its right-hand side.

With the rows a of C(t) = { w : N w <= d(t) } active from tau = 0 on, u = u_s - N_a^T q and

    (N_a A N_a^T) q' + (N_a B N_a^T) q = N_a B u_s - d_a(tau),   q(0) = 0

(MATH.md section 3). Generalised eigenvectors V split it into p' + lam p = r, each solved exactly;
at A = 0 it is the linear system for q itself.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
from scipy.linalg import lapack

from sweepopt.linalg import EPS

FAST = 1e-2  # of the largest lam


def modes(SA: np.ndarray, SB: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """lam >= 0 and V with V^T SA V = 1, V^T SB V = diag(lam).

    From the singular values of SA^-1/2 SB^1/2 by one-sided Jacobi rotations: where units or
    stiffnesses differ, slow modes are as accurate as fast ones (Demmel and Veselic, SIAM J. Matrix
    Anal. Appl. 13(4), 1992).
    """
    n = len(SA)
    lower = scipy.linalg.cholesky(SA, lower=True)
    root, order = _root(SB)
    rank = root.shape[1]
    if not rank:
        return np.zeros(n), scipy.linalg.solve_triangular(lower, np.eye(n), lower=True).T
    K = scipy.linalg.solve_triangular(lower, root, lower=True)
    sigma, U, W, scales, *_ = lapack.dgejsv(K, joba=2, jobu=1, jobv=0)
    sigma = sigma * (scales[0] / scales[1])
    lam = np.append(sigma**2, np.zeros(n - rank))
    V = scipy.linalg.solve_triangular(lower, U, lower=True, trans=1)
    if rank == n:
        # of a slow mode root^T V = W sigma knows the small entries, by which fast forces pull
        slow = lam < FAST * lam[0]
        other = scipy.linalg.solve_triangular(
            root[order], (W * sigma)[:, slow], trans=1, lower=True
        )
        V[np.ix_(order, slow)] = other
    return lam, V


def _root(SB: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """root with root root^T = SB, of full column rank, and the rows that make it triangular."""
    n = len(SB)
    scale = np.sqrt(np.maximum(SB.diagonal(), 0.0))
    scale[scale == 0] = 1.0
    unit = SB / np.outer(scale, scale)
    factor, order, rank, _ = lapack.dpstrf(unit, tol=n * EPS, lower=1)
    root, order = np.zeros((n, rank)), order - 1
    root[order] = np.tril(factor)[:, :rank]
    return scale[:, None] * root, order
