"""Bounds of eigenvalues, and their proofs, which count every rounding.

The criterion is that of S. M. Rump (Verification of positive definiteness, BIT 46, 2006): if M less
a little diagonal matrix has factors L D L^T with D > 0, and the backward error of the factors is
below that diagonal matrix, then M is positive definite.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg
import scipy.sparse as sp
import scipy.sparse.csgraph as csgraph
import scipy.sparse.linalg as spla

from sweepopt.checks import Array, Matrix
from sweepopt.errors import InputError
from sweepopt.linalg.cholesky import SYMMETRIC, InBlocks, has_cholmod
from sweepopt.linalg.matrices import EPS, SEMIDEFINITE, UNIT, dense, is_diagonal, lanczos_start
from sweepopt.linalg.ordering import is_solid
from sweepopt.linalg.twice_precision import product_error

if TYPE_CHECKING:
    from sweepopt.linalg.factor import Factor

MARGINS = 1e-9 * 1e3 ** np.arange(9)  # of a bound of an eigenvalue, from next to rounding upwards
SAFE = float(np.finfo(float).tiny) / EPS**2  # beside it what underflows is less than a rounding
SUMS = 1.001  # more than sums of positive numbers, and 1 / (1 - k u), round
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
    diagonal = M.diagonal()
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
    basis = sp.hstack(columns)
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
    least = float((B.diagonal() / A.diagonal).max())
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
    try:  # the eigenvalue is as exact as the square of tol
        largest = spla.eigsh(
            B,
            1,
            A.M,
            which="LA",
            v0=lanczos_start(A.dim),
            tol=1e-6,
            return_eigenvectors=False,
            Minv=inverse,
        )[0]
        return max(float(largest), least)
    except spla.ArpackError:  # it does not converge
        return least


def dominates(P: Matrix, Q: Matrix, by_factors: bool = True) -> bool:
    """Whether P - Q is proved to be positive semidefinite, P itself rounded entry by entry or not.

    An error |E_ij| <= H_ij = H_ji changes <Mx, x> by at most sum_i (H w)_i / w_i x_i^2, for any
    w > 0 (Schur's test), here 1 / sqrt(diagonal): so much is taken from the diagonal. The backward
    error is known from the factors; the first ones may show that more is to be taken.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        M = P - Q
        diagonal, one = M.diagonal(), np.ones(M.shape[0])
        sums = abs(M) @ one
        rounding = UNIT * (abs(P) @ one + 3 * sums)
        if not (diagonal.min() > SAFE and np.isfinite(rounding).all()):
            return False
    # no diagonal entry is less than the others of its row (Gershgorin)
    if ((1 + len(one) * EPS) * sums + SUMS * rounding <= 2 * diagonal).all():
        return True
    w = 1 / np.sqrt(diagonal)
    rounding = UNIT * (abs(P) @ w + 3 * (abs(M) @ w))
    # what factors of bodies of n unknowns round
    shift = rounding / w + 64 * math.sqrt(len(w)) * UNIT * diagonal
    for _ in range(2 * by_factors):
        shifts = sp.diags_array(shift) if sp.issparse(M) else np.diag(shift)
        error = SUMS * (rounding + _backward_error(M - shifts, w)) / w
        if (error <= shift).all():
            return True
        if error.max() == math.inf:
            return False
        shift = np.maximum(shift, 1.1 * error)
    return False


def _backward_error(M: Matrix, w: Array) -> Array:
    """H w for a bound H of |M - L D L^T|; the error is symmetric, so that its rows are enough.

    inf if there are no such factors, D > 0.

    |M - L U| <= gamma_k |L| |U|, gamma_k = k u / (1 - k u), with k the most entries of a row of L
    and a little, in whatever order the products are summed (Higham, Accuracy and Stability of
    Numerical Algorithms, 2002, Theorem 9.3). SuperLU's U is D L^T up to a remainder.

    Of solids both fill the memory, and CHOLMOD does not show its L L^T: its rows i have k_i entries
    and the length sqrt(M_ii), so that the sum of all gamma_(k_i + 2) is a bound in units of the
    diagonal (Rump), and of all k_i no more than n (n + 1) / 2.
    """
    n = len(w)
    try:
        if not sp.issparse(M):
            L = abs(scipy.linalg.cholesky(M, lower=True))
            return (n + 4) * UNIT * (L @ (L.T @ w))
        if has_cholmod() and is_solid(M):
            lower = sp.csc_array(sp.tril(M))
            lower.sort_indices()
            InBlocks(lower.indices, lower.indptr)(lower.data)
            return SUMS * UNIT * n * (n + 5) / 2 * M.diagonal() * w
        lu = spla.splu(sp.csc_matrix(M), permc_spec="MMD_AT_PLUS_A", **SYMMETRIC)
    except (scipy.linalg.LinAlgError, ArithmeticError, RuntimeError, MemoryError):
        return np.full(n, math.inf)
    L, U, place, rows = lu.L, lu.U, lu.perm_c, lu.perm_r
    del lu  # factors of a solid fill the memory: each is there once
    pivots = U.diagonal()
    if not (pivots.min() > 0 and (rows == place).all()):
        return np.full(n, math.inf)
    gamma, y = (np.bincount(L.indices).max() + 4) * UNIT, w[np.argsort(place)]
    remainder = abs(U - (L @ sp.diags_array(pivots)).T)
    return (abs(L) @ (remainder @ y + gamma * (abs(U) @ y)))[place]
