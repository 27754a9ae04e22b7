"""Which of the two treats a matrix: factors, or conjugate gradients where these do not fit."""

from __future__ import annotations

import math
import os

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Matrix
from sweepopt.errors import MissingExtraError, SolverRefusedError
from sweepopt.linalg.cholesky import Cholesky, cholesky, lapack_factor
from sweepopt.linalg.conjugate_gradients import ConjugateGradients

MEMORY_SHARE = 0.6  # of the physical memory, for factors: the rest is for mesh, states and Python


def engine(
    M: Matrix, order: np.ndarray | None = None, kept: np.ndarray | None = None
) -> Cholesky | ConjugateGradients:
    """What solves with M, and eliminates all unknowns but those that are kept.

    Parameters
    ----------
    order : ndarray of int, optional
        An order of the unknowns with little fill; the kept ones go to its end.
    """
    need, there = factor_bytes(M), _physical_memory()
    if need > MEMORY_SHARE * there:
        try:
            return ConjugateGradients(M, kept)
        except MissingExtraError as error:
            raise SolverRefusedError(
                f"factors of {M.shape[0]} unknowns would need about {need / 1e9:.3g} GB, this "
                f"machine has {there / 1e9:.3g} GB, and conjugate gradients need a package: {error}"
            ) from error
    if kept is None:
        return cholesky(M) if sp.issparse(M) else lapack_factor(M)
    M = sp.csc_array(M)
    order = cholesky(M).order if order is None else order
    return cholesky(M, np.concatenate([order[~np.isin(order, kept)], kept]), kept.size)


def factor_bytes(M: Matrix) -> float:
    """The memory that factors of M need, about.

    A factor of P1 elements in the plane has about 2 n log2 n entries (measured from 1e4 to 1e6
    unknowns), and a run holds about 120 bytes for each. A diagonal matrix is its own factor; a
    dense one is in memory already.
    """
    n = M.shape[0]
    return 240.0 * n * math.log2(n + 1) if sp.issparse(M) and M.nnz > n else 0.0


def _physical_memory() -> float:
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):  # not on every system
        return 8e9
