"""Symmetric positive definite matrices: factorised, bounded, and with few unknowns left."""

from sweepopt.linalg.cholesky import InBlocks, factorised
from sweepopt.linalg.eigenvalues import kernel, largest_ratio
from sweepopt.linalg.factor import (
    NEGLIGIBLE,
    Elimination,
    Factor,
    factor_bytes,
    is_semidefinite,
    require_semidefinite,
)
from sweepopt.linalg.matrices import (
    EPS,
    UNIT,
    dense,
    euclidean,
    is_diagonal,
    largest_eigenvalue,
    rounding_weights,
    row_lengths,
)
from sweepopt.linalg.ordering import is_solid
from sweepopt.linalg.twice_precision import Precise, exact_sum, product_error
