"""L L^T = M for a sparse M: by CHOLMOD where cvxopt is installed and M not too large, or SuperLU.

On the unit square with P1 elements, in ms on one core, a solve and the two substitutions of a step:

    unknowns     CHOLMOD        SuperLU
    1,056        0.024  0.035   0.049  0.078
    10,100       0.21   0.28    0.56   0.80
    100,172      9.6    12.5    9.2    15.4
    1,001,000    212    205     126    146     (CHOLMOD in blocks, else it factorises 30 s)

Both take about a second to factorise 100,172 unknowns, SuperLU 14 to 17 s for 1,001,000.

Both factorise M = P^T L L^T P with P w = w[order], in an order of their own if none is given; for a
dense M there is LAPACK.
"""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from scipy.linalg import lapack  # the plain calls: no checks in the loop

from sweepopt.checks import Array, Matrix
from sweepopt.linalg.matrices import Reduced, euclidean
from sweepopt.linalg.ordering import fill_reducing, triangle

SYMMETRIC = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
LIMIT = 200_000  # unknowns that CHOLMOD is faster for
# in the order it is given: L D L^T, or where L is dense enough by CHOLMOD's count L L^T in blocks
SETTINGS = {"supernodal": 1, "nmethods": 1, "postorder": False}
IN_BLOCKS = SETTINGS | {"supernodal": 2}  # which alone refuses what is not positive definite
SYSTEMS = {"M": 0, "L": 4, "L^T": 5, "D": 6}  # CHOLMOD's numbers of its equations
_settings_lock = threading.Lock()


@dataclass
class Cholesky:
    """M = P^T L L^T P, and the elimination of all but the last m unknowns of the order.

    For M z = r + E^T s, E selecting the m, the last rows and columns T of L give the Schur
    complement N = (E M^-1 E^T)^-1 = T T^T.

    Attributes
    ----------
    pivots : ndarray
        Those of the unknowns, as M counts them.
    solve : callable
        w -> M^-1 w, of one vector or of columns.
    order : ndarray of int or None
    forward, backward : callable
        w -> L^-1 P w and y -> P^T L^-T y, of one vector, for a sparse M.
    tail : ndarray, shape (m, m)
        T.
    """

    pivots: Array
    solve: Callable[[Array], Array]
    order: Any = None
    forward: Any = None
    backward: Any = None
    tail: Array = field(default_factory=lambda: np.zeros((0, 0)))
    has_factors = True

    @property
    def N(self) -> Array:
        """The Schur complement."""
        return self.tail @ self.tail.T

    def reduce(self, r: Array) -> Reduced:
        """Forward substitution of r, whose length is |r|_{M^-1}, and the force N E M^-1 r."""
        forward = self.forward(r)
        return Reduced(forward, self.tail @ forward[-len(self.tail) :], euclidean(forward))

    def recover(self, forward: Array, zeta: Array) -> Array:
        """z from the forward substitution of r and E z = zeta."""
        y = forward.copy()
        y[-len(self.tail) :] = self.tail.T @ zeta
        return self.backward(y)


def factorised(M: Matrix, order: Array | None = None, m: int = 0) -> Cholesky:
    """M factorised; of a sparse one the last m unknowns of an order have their block of L."""
    if not sp.issparse(M):
        lower, failed = lapack.dpotrf(M, lower=True)  # scipy's own takes 18 us, this 1.4
        pivots = lower.diagonal() ** 2
        if failed or not pivots.min() > 0:  # nan, which OpenBLAS overlooks
            raise scipy.linalg.LinAlgError("not positive definite")
        return Cholesky(pivots, lambda w: lapack.dpotrs(lower, w, lower=True)[0])
    return (cholmod if M.shape[0] <= LIMIT and has_cholmod() else superlu)(M, order, m)


class InBlocks:
    """Factorises matrices of one pattern one after the other: only the last factors are kept.

    CHOLMOD's L L^T in blocks: P2, 14,820 unknowns, in ms, factors take 18 and a solve 6, else 54
    and 6; P1, 16,641 unknowns, 12 and 1.1, else 28 and 0.6.

    Parameters
    ----------
    indices, starts : ndarray of int
        Of the lower triangle, column by column as SciPy has it.
    """

    def __init__(self, indices: Array, starts: Array) -> None:
        n = len(starts) - 1
        self._pattern, self._order, self._factor = (indices, starts), None, None
        if n > LIMIT or not has_cholmod():
            return
        from cvxopt import cholmod, matrix

        lower = sp.csc_array((np.ones(len(indices)), *self._pattern), (n, n))
        self._triangle, order = triangle(lower), fill_reducing(lower + lower.T)
        with _settings(IN_BLOCKS):
            self._factor = cholmod.symbolic(self._triangle, matrix(order))

    def __call__(self, data: Array) -> Callable[[Array], Array]:
        """w -> M^-1 w for the M with these entries; ArithmeticError where M > 0 does not hold."""
        if self._factor is None:
            lower = sp.csc_array((data, *self._pattern))
            engine = superlu(lower + sp.tril(lower, -1).T, self._order, 0)
            self._order = engine.order
            if not engine.pivots.min() > 0:
                raise ArithmeticError("a pivot is not positive")
            return engine.solve
        from cvxopt import cholmod, matrix

        self._triangle.V = matrix(data)
        with _settings(IN_BLOCKS):
            cholmod.numeric(self._triangle, self._factor)
        return partial(_system, self._factor, "M")


@cache
def has_cholmod() -> bool:
    """Whether CHOLMOD is installed."""
    try:
        from cvxopt import amd, cholmod  # noqa: F401
    except ImportError:  # not installed, or it lacks something itself
        return False
    return True


def cholmod(M: Matrix, order: Array | None, m: int) -> Cholesky:
    """CHOLMOD's L D L^T, or L L^T in blocks: 6 times as fast for a solid of 2,464 unknowns.

    Where a hard limit of memory (ulimit -v) is met, cvxopt 1.3 may end the process.
    """
    from cvxopt import cholmod, matrix

    lower = triangle(M)
    order = fill_reducing(M) if order is None else order

    def factor_in_order() -> Any:
        """The factor in this order and no other."""
        with _settings(SETTINGS):
            factor = cholmod.symbolic(lower, matrix(order.astype(np.int64)))
            cholmod.numeric(lower, factor)
        return factor

    tail = np.zeros((0, 0))
    if m:  # of a factor of its own, which getfactor empties, and before the other is in memory
        tail = np.array(matrix(cholmod.getfactor(factor_in_order())[-m:, -m:]))
    factor = factor_in_order()
    system = partial(_system, factor)
    D, place = 1 / system("D", np.ones(len(order))), np.argsort(order)
    root, pivots = np.sqrt(np.abs(D)), D
    with suppress(ValueError):  # raised for L D L^T
        pivots = np.ravel(cholmod.diag(factor)) ** 2
    np.fill_diagonal(tail, (np.sqrt(np.abs(pivots)) / root)[len(order) - m :])
    return Cholesky(
        pivots[place],
        lambda w: system("M", w),
        order,
        lambda w: system("L", w[order]) / root,
        lambda y: system("L^T", y / root)[place],
        tail * root[len(order) - m :],
    )


@contextmanager
def _settings(ours: dict[str, Any]) -> Iterator[None]:
    """CHOLMOD's settings are those of its module, not ours."""
    from cvxopt import cholmod

    with _settings_lock:
        before = dict(cholmod.options)
        cholmod.options.clear()
        cholmod.options.update(ours)
        try:
            yield
        finally:
            cholmod.options.clear()
            cholmod.options.update(before)


def _system(factor: Any, matrix_of: str, w: Array) -> Array:
    """The solution of one of CHOLMOD's SYSTEMS."""
    from cvxopt import cholmod, matrix

    x = matrix(np.asarray(w, dtype=float))
    cholmod.solve(factor, x, sys=SYSTEMS[matrix_of])
    return np.asarray(x).reshape(w.shape)


def superlu(M: Matrix, order: Array | None, m: int) -> Cholesky:
    """SuperLU's L U of M, whose U is D L^T: pivots stay on the diagonal.

    Their signs are the inertia (Sylvester). For the two substitutions apart L sqrt(D) is
    factorised once more.
    """
    if order is None:
        lu = spla.splu(sp.csc_matrix(M), permc_spec="MMD_AT_PLUS_A", **SYMMETRIC)
        return Cholesky(lu.U.diagonal()[lu.perm_c], lu.solve, np.argsort(lu.perm_c))
    lu = spla.splu(sp.csc_matrix(M[order][:, order]), permc_spec="NATURAL", **SYMMETRIC)
    pivots, place = lu.U.diagonal(), np.argsort(order)

    def solve(w: Array) -> Array:
        return lu.solve(w[order])[place]

    if not m:
        return Cholesky(pivots[place], solve, order)
    lower = lu.L @ sp.diags_array(np.sqrt(np.abs(pivots)))
    triangle = spla.splu(lower, permc_spec="NATURAL", **SYMMETRIC)
    return Cholesky(
        pivots[place],
        solve,
        order,
        lambda w: triangle.solve(w[order]),
        lambda y: triangle.solve(y, "T")[place],
        lower[-m:, -m:].toarray(),
    )
