"""Numbers of 60 digits: doubles as they are, and linear equations with definite matrices."""

from __future__ import annotations

import decimal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

DIGITS = 60
"""Twice those of data with units from 2^-40 to 2^40 and condition 1e12, and some to spare."""


@contextmanager
def precise() -> Iterator[None]:
    """All that is computed within has 60 digits; also a decorator."""
    with decimal.localcontext(decimal.Context(prec=DIGITS)):
        yield


def exactly(x: Any) -> np.ndarray:
    """Doubles as decimal numbers, without rounding; what is one stays as it is."""
    x = np.asarray(x)
    x = x if x.dtype == object else x.astype(float)
    result = np.empty(x.shape, dtype=object)
    result.ravel()[:] = [decimal.Decimal(entry) for entry in x.ravel().tolist()]
    return result


def solve(M: np.ndarray, b: np.ndarray) -> np.ndarray:
    """M^-1 b by elimination, M symmetric positive definite and b a vector or a matrix."""
    n, S = len(M), np.column_stack([M, b])
    for k in range(n):
        S[k + 1 :, k:] -= np.outer(S[k + 1 :, k] / S[k, k], S[k, k:])
    for k in reversed(range(n)):
        S[k, n:] /= S[k, k]
        S[:k, n:] -= np.outer(S[:k, k], S[k, n:])
    return S[:, n:].reshape(b.shape)


def sqrt(x: Any) -> Any:
    """Of each entry."""
    return np.frompyfunc(decimal.Decimal.sqrt, 1, 1)(x)
