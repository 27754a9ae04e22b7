"""The closed form on a face: a linear system with powers and waves on its right-hand side.

With the rows a of C(t) = { w : N w <= d(t) } active from tau = 0 on, u = u_s - N_a^T q and

    (N_a A N_a^T) q' + (N_a B N_a^T) q = N_a B u_s - d_a(tau),   q(0) = 0

(MATH.md section 3). Generalised eigenvectors V split it into p' + lam p = r, each solved exactly;
at A = 0 it is the linear system for q itself.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from sweepopt.exact.curves import Basis, Curve

SLOW = 1.0  # lam * length up to which a mode is a power series: 1 / lam would cancel
TERMS = 20  # of that series, and 1 / 20! is below rounding


def modes(SA: np.ndarray, SB: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """lam >= 0 and V with V^T SA V = 1, V^T SB V = diag(lam)."""
    if SA.shape[0] == 1:
        return SB[0] / SA[0], 1 / np.sqrt(SA)
    lam, V = scipy.linalg.eigh(SB, SA)
    return np.maximum(lam, 0.0), V


def whitening(SB: np.ndarray) -> np.ndarray:
    """V with V^T SB V = 1."""
    lower = scipy.linalg.cholesky(SB, lower=True)
    return scipy.linalg.solve_triangular(lower, np.eye(len(SB)), lower=True).T


def decay(lam: np.ndarray, forces: Curve) -> Curve:
    """p with p' + lam p = r, p(0) = 0; one row a mode. `forces` has no exponentials in it."""
    basis = forces.basis
    length = basis.length
    slow = lam * length <= SLOW
    degree = basis.degree + (TERMS if slow.any() else 0)
    full = Basis(np.where(slow, 0.0, lam), degree, basis.waves, length)
    p, s, c = full.cuts
    first, sines, cosines = basis.cuts
    r = np.zeros((lam.size, degree + 1))
    r[:, : basis.degree + 1] = forces.weights[:, first:sines]
    weights = np.zeros((lam.size, c + basis.waves.size))
    sine, cosine = forces.weights[:, sines:cosines], forces.weights[:, cosines:]
    rate = lam[:, None]
    both = rate**2 + basis.waves**2
    weights[:, s:c] = (rate * sine + basis.waves * cosine) / both
    weights[:, c:] = (rate * cosine - basis.waves * sine) / both
    start = -weights[:, c:].sum(axis=1)  # what powers and exponentials must begin with
    powers = np.zeros_like(r)
    fast = ~slow
    following = np.zeros(int(fast.sum()))
    for k in reversed(range(basis.degree + 1)):
        following = (r[fast, k] - (k + 1) / length * following) / lam[fast]
        powers[fast, k] = following
    powers[slow, 0] = start[slow]
    for k in range(degree):
        powers[slow, k + 1] = length / (k + 1) * (r[slow, k] - lam[slow] * powers[slow, k])
    weights[:, p:s] = powers
    mode = np.flatnonzero(fast)
    weights[mode, mode] = (start - powers[:, 0])[fast]
    return Curve(full, weights)
