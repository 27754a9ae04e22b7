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

from sweepopt.integrate.exact.closed_forms import Basis, Curve
from sweepopt.linalg import EPS

SLOW = 1.0  # lam * length up to which a mode is a power series: 1 / lam would cancel
FAST = 1e-2  # of the largest lam
TERMS = 20  # of that series, and 1 / 20! is below rounding


def modes(SA: np.ndarray, SB: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """lam >= 0 and V with V^T SA V = 1, V^T SB V = diag(lam).

    From the singular values of SA^-1/2 SB^1/2 by one-sided Jacobi rotations: where units or
    stiffnesses differ, slow modes are as accurate as fast ones (Demmel and Veselic, SIAM J. Matrix
    Anal. Appl. 13(4), 1992).
    """
    if SA.shape[0] == 1:
        return SB[0] / SA[0], 1 / np.sqrt(SA)
    n = len(SA)
    lower = scipy.linalg.cholesky(SA, lower=True)
    root, order = _root(SB)
    rank = root.shape[1]
    if not rank:
        return np.zeros(n), scipy.linalg.solve_triangular(lower, np.eye(n), lower=True).T
    K = scipy.linalg.solve_triangular(lower, root, lower=True)
    sigma, U, W, scales, _, failed = lapack.dgejsv(K, joba=2, jobu=1, jobv=0)
    if failed:
        lam, V = scipy.linalg.eigh(SB, SA)
        return np.maximum(lam, 0.0), V
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


def whitening(SB: np.ndarray) -> np.ndarray:
    """V with V^T SB V = 1."""
    lower = scipy.linalg.cholesky(SB, lower=True)
    return scipy.linalg.solve_triangular(lower, np.eye(len(SB)), lower=True).T


def decay(lam: np.ndarray, forces: Curve) -> Curve:
    """p with p' + lam p = r, p(0) = 0; one row a mode. `forces` has no exponentials in it."""
    given = forces.basis
    length, degree = given.length, given.degree
    slow = lam * length <= SLOW
    if slow.any():
        degree += TERMS
    basis = Basis(np.where(slow, 0.0, lam), degree, given.waves, length)
    sine, cosine = forces.weights[:, given.sines], forces.weights[:, given.cosines]
    weights = np.zeros((lam.size, basis.size))
    rate = lam[:, None]
    squares = rate**2 + basis.waves**2
    weights[:, basis.sines] = (rate * sine + basis.waves * cosine) / squares
    weights[:, basis.cosines] = (rate * cosine - basis.waves * sine) / squares
    start = -weights[:, basis.cosines].sum(axis=1)  # of the powers and exponentials at tau = 0

    r, powers = np.zeros((2, lam.size, degree + 1))
    r[:, : given.degree + 1] = forces.weights[:, given.powers]
    fast = ~slow
    higher = np.zeros(int(fast.sum()))
    for k in reversed(range(given.degree + 1)):
        higher = (r[fast, k] - (k + 1) / length * higher) / lam[fast]
        powers[fast, k] = higher
    powers[slow, 0] = start[slow]
    for k in range(degree):
        powers[slow, k + 1] = length / (k + 1) * (r[slow, k] - lam[slow] * powers[slow, k])
    weights[:, basis.powers] = powers
    mode = np.flatnonzero(fast)
    weights[mode, mode] = (start - powers[:, 0])[fast]
    return Curve(basis, weights)
