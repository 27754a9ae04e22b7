"""Numbers of 80 digits: doubles as they are, and inverses of definite matrices."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from decimal import Context, Decimal, localcontext
from typing import Any

import numpy as np

DIGITS = 80
"""Of radii from 1 to 1e24 at condition 4e9, 60 left 4e-25 of the smallest: more than is enough."""


@contextmanager
def precise() -> Iterator[None]:
    """All that is computed within has 80 digits; also a decorator."""
    with localcontext(Context(prec=DIGITS)):
        yield


def exactly(x: Any) -> Any:
    """Doubles as decimal numbers, without rounding; what is one stays as it is."""
    return np.frompyfunc(Decimal, 1, 1)(x)


def sqrt(x: Any) -> Any:
    """Of each entry."""
    return np.frompyfunc(Decimal.sqrt, 1, 1)(x)


def norm(M: np.ndarray, z: np.ndarray) -> float:
    """sqrt(<z, M z>)."""
    return float((z @ M @ z).sqrt())


def eliminate(S: np.ndarray, row: Any, column: int) -> None:
    """Make a column of S that of the unit matrix, with its 1 in a row."""
    others = np.arange(len(S)) != row
    S[row] /= S[row, column]
    S[others] -= np.outer(S[others, column], S[row])


def inverse(M: np.ndarray) -> np.ndarray:
    """M^-1, M symmetric positive definite."""
    n = len(M)
    S = np.column_stack([M, exactly(np.eye(n))])
    for k in range(n):
        eliminate(S, k, k)
    return S[:, n:]
