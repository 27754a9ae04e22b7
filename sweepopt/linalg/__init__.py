"""Symmetric positive definite matrices: factorised, bounded, and with few unknowns left."""

from sweepopt.linalg.eigenvalues import (
    exceeds_none,
    is_semidefinite,
    largest_eigenvalue,
    largest_ratio,
)
from sweepopt.linalg.factor import NEGLIGIBLE, Elimination, Factor
from sweepopt.linalg.matrices import EPS, PIVOT, SMALL, UNIT, dense, euclidean, row_lengths, row_sum

__all__ = [
    "EPS",
    "NEGLIGIBLE",
    "PIVOT",
    "SMALL",
    "UNIT",
    "Elimination",
    "Factor",
    "dense",
    "euclidean",
    "exceeds_none",
    "is_semidefinite",
    "largest_eigenvalue",
    "largest_ratio",
    "row_lengths",
    "row_sum",
]
