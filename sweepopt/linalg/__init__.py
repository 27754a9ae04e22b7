"""Symmetric positive definite matrices: factorised, bounded, and with few unknowns left."""

from __future__ import annotations

from sweepopt.linalg.choice import (
    eliminate,
    factor_bytes,
    factorise,
)
from sweepopt.linalg.conjugate_gradients import (
    IterativeElimination,
)
from sweepopt.linalg.eigenvalues import (
    exceeds_none,
    is_semidefinite,
    largest_eigenvalue,
    largest_ratio,
)
from sweepopt.linalg.factor import (
    NEGLIGIBLE,
    Elimination,
    Factor,
)
from sweepopt.linalg.matrices import (
    EPS,
    PIVOT,
    SMALL,
    UNIT,
    dense,
    euclidean,
    row_lengths,
    row_sum,
)
from sweepopt.linalg.twice_precision import (
    Precise,
    product_error,
    sum_error,
)

__all__ = [
    "EPS",
    "NEGLIGIBLE",
    "PIVOT",
    "SMALL",
    "UNIT",
    "Elimination",
    "Factor",
    "IterativeElimination",
    "Precise",
    "dense",
    "eliminate",
    "euclidean",
    "exceeds_none",
    "factor_bytes",
    "factorise",
    "is_semidefinite",
    "largest_eigenvalue",
    "largest_ratio",
    "product_error",
    "row_lengths",
    "row_sum",
    "sum_error",
]
