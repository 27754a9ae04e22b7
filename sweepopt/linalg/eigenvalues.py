"""Bounds of eigenvalues, proved by factorisations."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp
import scipy.sparse.csgraph as csgraph
import scipy.sparse.linalg as spla

from sweepopt.checks import Matrix
from sweepopt.errors import InputError
from sweepopt.linalg.definiteness import MARGINS, dominates
from sweepopt.linalg.matrices import SEMIDEFINITE, dense, is_diagonal, lanczos_start
from sweepopt.linalg.twice_precision import product_error

if TYPE_CHECKING:
    from sweepopt.linalg.factor import Factor

MOST_COUPLED = 3000  # unknowns of a dense eigenproblem: 70 MB and some seconds


def kernel(M: Matrix) -> Matrix:
    """A basis of the kernel of a positive semidefinite matrix, shape (dim, k), of its own kind.

    Found on each set of coupled unknowns, as the eigenvectors of D^-1/2 M D^-1/2, D = diag(M).

    Raises
    ------
    InputError
        If too many unknowns are coupled.
    """
    rows, columns = sp.csr_array(M, copy=True), []
    rows.eliminate_zeros()
    _, group = csgraph.connected_components(rows, directed=False)
    alone = np.bincount(group)[group] == 1
    diagonal = np.asarray(M.diagonal(), dtype=float)
    one = sp.eye_array(len(group), format="csc")
    columns.append(one[:, np.flatnonzero(diagonal == 0)])
    for name in np.unique(group[~alone]):
        some = np.flatnonzero(group == name)
        if some.size > MOST_COUPLED:
            raise InputError(
                f"A is singular on {some.size} coupled unknowns, and its kernel is computed of "
                f"{MOST_COUPLED} at most; give it a little viscosity where it has none"
            )
        units = 1 / np.sqrt(diagonal[some])
        values, vectors = scipy.linalg.eigh(units[:, None] * dense(rows[some][:, some]) * units)
        vectors = units[:, None] * vectors[:, values <= SEMIDEFINITE]
        columns.append(one[:, some] @ sp.csc_array(vectors / np.linalg.norm(vectors, axis=0)))
    basis = sp.csc_array(sp.hstack(columns))
    return basis if sp.issparse(M) else basis.toarray()


def largest_ratio(A: Factor, B: Matrix) -> float:
    """A number that no eigenvalue of A^-1 B exceeds, for B positive semidefinite.

    Iterations find the largest eigenvalue from below, or miss it: what they find, and a little
    more, is proved by `dominates`, or raised until it is: inf, if nothing is proved. So it is above
    the eigenvalue by 1e-9 of it where rounding lets that be seen, and by no more than the rounding
    of a quotient where both matrices are diagonal. Without factors nothing is proved but what row
    sums show: then it is what the iteration finds.
    """
    # in a body of few materials the eigenvalue itself
    least = float((np.asarray(B.diagonal(), dtype=float) / A.diagonal).max())
    if A.is_diagonal and is_diagonal(B):
        short = (least * A.diagonal - B.diagonal()) + product_error(least, A.diagonal)
        return least if (short >= 0).all() else math.nextafter(least, math.inf)
    s = (1 + MARGINS[0]) * least
    if dominates(s * A.M, B, A.has_factors):
        return s
    estimate = _estimate(A, B, least)
    if not A.has_factors:
        return (1 + MARGINS[0]) * estimate
    candidates = ((1 + margin) * estimate for margin in MARGINS)
    return next((s for s in candidates if dominates(s * A.M, B)), math.inf)


def _estimate(A: Factor, B: Matrix, least: float) -> float:
    """The largest eigenvalue of A^-1 B, or what of it can be seen."""
    inverse = spla.LinearOperator((A.dim, A.dim), matvec=A.solve, dtype=float)
    how: dict[str, Any] = {"M": A.M, "Minv": inverse, "which": "LA", "v0": lanczos_start(A.dim)}
    try:  # the eigenvalue is as exact as the square of tol
        largest = spla.eigsh(B, k=1, tol=1e-6, return_eigenvectors=False, **how)[0]
        return max(float(largest), least)
    except spla.ArpackError:  # it does not converge
        return least
