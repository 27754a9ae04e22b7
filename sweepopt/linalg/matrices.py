"""What is asked of any symmetric matrix, dense or sparse."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from sweepopt.checks import Matrix

EPS = float(np.finfo(float).eps)
UNIT = 0.5 * EPS  # unit roundoff: the largest relative error of one operation
PIVOT = 16 * EPS  # in units of the diagonal: a smaller pivot of a matrix is none
SMALL = 50  # below this dense eigenvalues are cheaper than Lanczos


def row_sum(M: Matrix, root: np.ndarray) -> float:
    """The largest row sum of |D^-1/2 M D^-1/2|, `root` the diagonal of D^1/2."""
    return float((np.asarray(abs(M) @ (1 / root)).ravel() / root).max())


def row_lengths(G: Matrix) -> np.ndarray:
    """The Euclidean length of each row."""
    return np.sqrt(np.asarray((G * G).sum(axis=1), dtype=float)).ravel()


def is_dominant(M: Matrix, slack: float = 0.0) -> bool:
    """Whether no diagonal entry is less than the others of its row: semidefinite (Gershgorin)."""
    diagonal = np.asarray(M.diagonal(), dtype=float)
    rest = np.asarray(abs(M).sum(axis=1)).ravel() - np.abs(diagonal)
    return bool((rest <= (1 + slack) * diagonal).all())


def is_diagonal(M: Matrix) -> bool:
    entries = M.count_nonzero() if sp.issparse(M) else np.count_nonzero(M)
    return bool(entries == np.count_nonzero(M.diagonal()))


def euclidean(x: np.ndarray) -> float:
    """|x| of a vector: numpy's norm looks at its shape first."""
    return math.sqrt(x.dot(x))


def dense(M: Matrix) -> np.ndarray:
    """M as an ndarray."""
    return M.toarray() if sp.issparse(M) else M


def lanczos_start(dim: int) -> np.ndarray:
    """A start for Lanczos that no structure of a matrix is orthogonal to, the same every time."""
    return np.random.default_rng(0).normal(size=dim)


def largest_eigenvalue(
    product: Callable[[np.ndarray], np.ndarray], dim: int, tol: float = 0.0
) -> float:
    """The largest eigenvalue of the symmetric matrix of these products."""
    if dim < SMALL:
        return float(np.linalg.eigvalsh(np.array([product(e) for e in np.eye(dim)]))[-1])
    matrix = spla.LinearOperator((dim, dim), matvec=product, dtype=float)
    start = lanczos_start(dim)
    return float(spla.eigsh(matrix, 1, which="LA", v0=start, tol=tol, return_eigenvectors=False)[0])
