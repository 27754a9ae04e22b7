"""What is asked of any symmetric matrix, dense or sparse."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from sweepopt.checks import Array, Matrix

EPS = float(np.finfo(float).eps)
UNIT = float(np.finfo(float).epsneg)  # unit roundoff: the largest relative error of one operation
PIVOT = 16 * EPS  # in units of the diagonal: a smaller pivot of a matrix is none
SEMIDEFINITE = 1e-10  # of the diagonal: eigenvalues that rounding may have made of 0


class Reduced(NamedTuple):
    """What is left of a force r on all unknowns where few of them are kept.

    Attributes
    ----------
    forward : object
        What `recover` needs of r.
    force : ndarray
        On the unknowns that are kept.
    size : float or None
        |r|_{M^-1}; None where that takes a solve.
    """

    forward: Any
    force: Array
    size: float | None = None


def rounding_weights(M: Matrix, root: Array) -> Array:
    """Weights with |D^-1/2 (fl(M x) - M x)| <= UNIT |weights * x|, `root` the diagonal of D^1/2.

    An entry of k products rounds about sqrt(k) times its |M| |x| (Higham and Mary, SIAM J. Sci.
    Comput. 41, 2019), three more are for M, the factor of M and what the entry is added to. For
    K >= 0 |K y|^2 <= <K^T K 1, y^2> (Schur's test).
    """
    size = abs(M)
    entries = np.diff(M.indptr) if sp.issparse(M) else len(M)
    roundings = (3 + np.sqrt(entries)) / root
    sums = roundings * (size @ (1 / root))
    return np.sqrt(root * (size @ (roundings * sums)))


def row_lengths(G: Matrix) -> Any:
    """The Euclidean length of each row, also of many dense matrices."""
    # einsum takes a quarter of the time of a sum for 20,000 rows
    return np.sqrt((G * G).sum(axis=1) if sp.issparse(G) else np.einsum("...k,...k->...", G, G))


def is_dominant(M: Matrix) -> bool:
    """Whether no diagonal entry is less than the others of its row: semidefinite (Gershgorin)."""
    diagonal = M.diagonal()
    rest = abs(M).sum(axis=1) - np.abs(diagonal)
    return bool((rest <= diagonal).all())


def is_diagonal(M: Matrix) -> bool:
    entries = M.count_nonzero() if sp.issparse(M) else np.count_nonzero(M)
    return bool(entries == np.count_nonzero(M.diagonal()))


def euclidean(x: Array) -> float:
    """|x| of a vector: numpy's norm looks at its shape first."""
    return math.sqrt(x.dot(x))


def dense(M: Matrix) -> Array:
    """M as an ndarray."""
    return M.toarray() if sp.issparse(M) else M


def lanczos_start(dim: int) -> Array:
    """A start for Lanczos that no structure of a matrix is orthogonal to, the same every time."""
    return np.random.default_rng(0).normal(size=dim)


def largest_eigenvalue(product: Callable[[Array], Array], dim: int, tol: float) -> float:
    """The largest eigenvalue of the symmetric matrix of these products."""
    if dim < 50:  # cheaper than Lanczos
        return float(np.linalg.eigvalsh(np.array([product(e) for e in np.eye(dim)]))[-1])
    matrix = spla.LinearOperator((dim, dim), matvec=product, dtype=float)
    start = lanczos_start(dim)
    return float(spla.eigsh(matrix, 1, which="LA", v0=start, tol=tol, return_eigenvectors=False)[0])
