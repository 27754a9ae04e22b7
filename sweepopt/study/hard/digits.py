"""Numbers of 60 digits: doubles as they are, and linear equations with symmetric matrices."""

from __future__ import annotations

from typing import Any

import numpy as np

DIGITS = 60


def exactly(x: Any) -> np.ndarray:
    """Doubles as mpmath numbers, without rounding; what is one stays as it is."""
    import mpmath

    mpmath.mp.dps = DIGITS
    x = np.asarray(x)
    x = x if x.dtype == object else x.astype(float)
    result = np.empty(x.shape, dtype=object)
    result.ravel()[:] = [mpmath.mpf(entry) for entry in x.ravel()]
    return result


def factor(M: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """L and D with L D L^T = M."""
    S, n = M.copy(), len(M)
    L, D = exactly(np.eye(n)), exactly(np.zeros(n))
    for k in range(n):
        D[k] = S[k, k]
        L[k + 1 :, k] = S[k + 1 :, k] / D[k]
        S[k + 1 :, k + 1 :] -= np.outer(L[k + 1 :, k], S[k, k + 1 :])
    return L, D


def forward(L: np.ndarray, b: np.ndarray) -> np.ndarray:
    b = b.copy()
    for k in range(len(b)):
        b[k + 1 :] -= L[k + 1 :, k] * b[k]
    return b


def backward(L: np.ndarray, b: np.ndarray) -> np.ndarray:
    b = b.copy()
    for k in range(len(b) - 1, -1, -1):
        b[:k] -= L[k, :k] * b[k]
    return b


def solve(M: np.ndarray, b: np.ndarray) -> np.ndarray:
    L, D = factor(M)
    return backward(L, forward(L, b) / D)


def sqrt(x: Any) -> Any:
    import mpmath

    return mpmath.sqrt(x)


def root(x: Any) -> float:
    return float(sqrt(x)) if x > 0 else 0.0
