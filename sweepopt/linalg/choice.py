"""Which of the two treats a matrix: factors, or conjugate gradients where these do not fit."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Matrix
from sweepopt.errors import MissingExtraError, SolverRefusedError
from sweepopt.linalg.conjugate_gradients import ConjugateGradients, IterativeElimination
from sweepopt.linalg.factor import Elimination, Factor

SHARE = 0.6  # of the physical memory for factors: the rest is for the mesh, the states and Python


def factorise(M: Matrix, name: str = "M") -> Factor:
    """M factorised, or treated by conjugate gradients where its factors would not fit in memory."""
    if _fits(M):
        return Factor(M, name)
    with _memory_named(M):
        return ConjugateGradients(M, name)


def eliminate(
    M: Matrix, unknowns: np.ndarray, order: np.ndarray | None = None
) -> Elimination | IterativeElimination:
    """M for the elimination of all but a few unknowns, by factors where these fit in memory."""
    if _fits(M):
        return Elimination(M, unknowns, order)
    with _memory_named(M):
        return IterativeElimination(M, unknowns)


def factor_bytes(M: Matrix) -> float:
    """The memory that factors of M need, about.

    A factor of P1 elements in the plane has about 2 n log2 n entries (measured from 1e4 to 1e6
    unknowns), and a run holds about 120 bytes for each. A diagonal matrix is its own factor; a
    dense one is in memory already.
    """
    n = M.shape[0]
    return 240.0 * n * math.log2(n + 1) if sp.issparse(M) and M.nnz > n else 0.0


@contextmanager
def _memory_named(M: Matrix) -> Iterator[None]:
    """A missing package is missed because factors need more memory than there is: say how much."""
    try:
        yield
    except MissingExtraError as error:
        need, there = factor_bytes(M) / 1e9, _physical_memory() / 1e9
        raise SolverRefusedError(
            f"factors of {M.shape[0]} unknowns would need about {need:.3g} GB, this machine has "
            f"{there:.3g} GB, and conjugate gradients need a package: {error}"
        ) from error


def _fits(M: Matrix) -> bool:
    return factor_bytes(M) <= SHARE * _physical_memory()


def _physical_memory() -> float:
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):  # not on every system
        return 8e9
