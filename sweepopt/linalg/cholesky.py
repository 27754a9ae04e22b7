"""L L^T = M for a sparse M: by CHOLMOD where cvxopt is installed and M not too large, or SuperLU.

On the unit square with P1 elements, in ms on one core, a solve and the two substitutions of a step:

    unknowns     CHOLMOD        SuperLU
    1,056        0.024  0.035   0.049  0.078
    10,100       0.21   0.28    0.56   0.80
    100,172      9.6    12.5    9.2    15.4
    1,001,000    212    205     126    146     (CHOLMOD in blocks, else it factorises 30 s)

Both take about a second to factorise 100,172 unknowns, SuperLU 14 to 17 s for 1,001,000.

Both factorise M / unit = P^T L L^T P with P w = w[order], `unit` a power of two, in an order of
their own if none is given; for a dense M there is LAPACK.
"""

from __future__ import annotations

import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from scipy.linalg import lapack  # the plain calls: no checks in the loop

from sweepopt.checks import Matrix
from sweepopt.linalg.matrices import euclidean

SYMMETRIC: dict[str, Any] = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
LIMIT = 200_000  # unknowns that CHOLMOD is faster for
SETTINGS = {"supernodal": 0, "nmethods": 1, "postorder": False}  # L D L^T in the order it is given
WHOLE, LOWER, UPPER, DIAGONAL = 0, 4, 5, 6  # CHOLMOD's numbers of M, L, L^T and D
_settings_lock = threading.Lock()


def cholesky(M: Matrix, order: np.ndarray | None = None, m: int = 0) -> Cholesky:
    """A sparse M factorised; the last m unknowns of a given order have their block of L at hand."""
    return (Cholmod if M.shape[0] <= LIMIT and has_cholmod() else SuperLU)(M, order, m)


@cache
def has_cholmod() -> bool:
    """Whether CHOLMOD is installed."""
    try:
        from cvxopt import amd, cholmod  # noqa: F401
    except ImportError:  # not installed, or it lacks something itself
        return False
    return True


def unit_of(M: Matrix) -> float:
    """A power of two in the units of M: the roots of M / unit are the same to the last bit."""
    return math.ldexp(1.0, math.frexp(float(M.diagonal().max()))[1])


class Cholesky(ABC):
    """M / unit = P^T L L^T P, and the elimination of all but the last m unknowns of the order.

    For M z = r + E^T s, E selecting the m, the last rows and columns T of L give the Schur
    complement N = (E M^-1 E^T)^-1 = unit T T^T.

    Attributes
    ----------
    order : ndarray of int
    unit : float
    pivots : ndarray
        Those of the unknowns, as M counts and measures them.
    tail : ndarray, shape (m, m)
        T; only where all pivots are positive.
    """

    method = "factors"
    order: np.ndarray
    unit: float
    pivots: np.ndarray
    tail: np.ndarray

    @abstractmethod
    def solve(self, w: np.ndarray) -> np.ndarray:
        """M^-1 w, of one vector or of columns."""

    @abstractmethod
    def forward(self, w: np.ndarray) -> np.ndarray:
        """L^-1 P w, of one vector."""

    @abstractmethod
    def backward(self, y: np.ndarray) -> np.ndarray:
        """P^T L^-T y, of one vector."""

    @property
    def N(self) -> np.ndarray:
        """The Schur complement."""
        return self.unit * (self.tail @ self.tail.T)

    def reduce(self, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forward substitution of r, and the force N E M^-1 r."""
        forward = self.forward(r)
        return forward, self.tail @ forward[-len(self.tail) :]

    def size(self, forward: np.ndarray) -> float:
        """|r|_{M^-1} from the forward substitution of r."""
        return euclidean(forward) / math.sqrt(self.unit)

    def recover(self, forward: np.ndarray, zeta: np.ndarray) -> np.ndarray:
        """z from the forward substitution of r and E z = zeta."""
        y = forward / self.unit
        y[-len(self.tail) :] = self.tail.T @ zeta
        return self.backward(y)


class Dense:
    """LAPACK's factor of a dense M."""

    method, order = "factors", None

    def __init__(self, M: np.ndarray) -> None:
        self._lower = scipy.linalg.cholesky(M, lower=True)
        self.pivots = self._lower.diagonal() ** 2

    def solve(self, w: np.ndarray) -> np.ndarray:
        """M^-1 w, of one vector or of columns."""
        return lapack.dpotrs(self._lower, w, lower=True)[0]


class Cholmod(Cholesky):
    """CHOLMOD's L D L^T of M / unit, with ones on the diagonal of its L.

    Where a hard limit of memory (ulimit -v) is met, cvxopt 1.3 may end the process.
    """

    def __init__(self, M: Matrix, order: np.ndarray | None, m: int) -> None:
        from cvxopt import amd, cholmod, matrix, spmatrix

        self._matrix, self._solve = matrix, cholmod.solve
        self.unit = unit_of(M)
        lower = sp.tril(M, format="coo")
        rows, columns = lower.row.astype(np.int64), lower.col.astype(np.int64)
        triangle = spmatrix(lower.data / self.unit, rows, columns, M.shape)
        self.order = np.ravel(amd.order(triangle)) if order is None else order
        self._factor = _factorised(triangle, self.order)
        D = 1 / self._system(DIAGONAL, np.ones(len(self.order)))
        self._root = np.sqrt(np.abs(D))
        self.pivots = np.empty_like(D)
        self.pivots[self.order] = self.unit * D
        if m and D.min() > 0:
            tail = np.array(matrix(cholmod.getfactor(self._factor)[-m:, -m:]))
            np.fill_diagonal(tail, 1.0)  # where D was
            self.tail = tail * self._root[-m:]
            self._factor = _factorised(triangle, self.order)  # getfactor has emptied it

    def solve(self, w: np.ndarray) -> np.ndarray:
        z = self._system(WHOLE, w)
        z /= self.unit
        return z

    def forward(self, w: np.ndarray) -> np.ndarray:
        y = self._system(LOWER, w[self.order])
        y /= self._root
        return y

    def backward(self, y: np.ndarray) -> np.ndarray:
        z = np.empty_like(y)
        z[self.order] = self._system(UPPER, y / self._root)
        return z

    def _system(self, which: int, w: np.ndarray) -> np.ndarray:
        x = self._matrix(np.asarray(w, dtype=float))
        self._solve(self._factor, x, sys=which)
        return np.asarray(x).reshape(w.shape)


def _factorised(A: Any, order: np.ndarray) -> Any:
    """The factor of A in this order and no other."""
    from cvxopt import cholmod, matrix

    with _own_settings(cholmod.options):
        factor = cholmod.symbolic(A, matrix(order.astype(np.int64)))
        cholmod.numeric(A, factor)
    return factor


@contextmanager
def _own_settings(options: dict[str, Any]) -> Iterator[None]:
    """Our settings alone; they are the module's, others have theirs back."""
    with _settings_lock:
        before = dict(options)
        options.clear()
        options.update(SETTINGS)
        try:
            yield
        finally:
            options.clear()
            options.update(before)


class SuperLU(Cholesky):
    """SuperLU's L U of M, whose U is D L^T: pivots stay on the diagonal.

    Their signs are the inertia (Sylvester). For the two substitutions apart L sqrt(D) is
    factorised once more.
    """

    def __init__(self, M: Matrix, order: np.ndarray | None, m: int) -> None:
        self._whole: Any = None
        if order is None:
            lu = spla.splu(sp.csc_matrix(M), permc_spec="MMD_AT_PLUS_A", **SYMMETRIC)
            self.order, self._whole = np.argsort(lu.perm_c), lu
            self.pivots = lu.U.diagonal()[lu.perm_c]
            return
        self.order, self.unit = order, unit_of(M)
        lu = spla.splu(sp.csc_matrix(M[order][:, order]), permc_spec="NATURAL", **SYMMETRIC)
        pivots = lu.U.diagonal()
        self.pivots = np.empty_like(pivots)
        self.pivots[order] = pivots
        if pivots.min() > 0:
            lower = (lu.L @ sp.diags_array(np.sqrt(pivots / self.unit))).tocsc()
            self.tail = lower[-m:, -m:].toarray()
            self._triangle = spla.splu(lower, permc_spec="NATURAL", **SYMMETRIC)

    def solve(self, w: np.ndarray) -> np.ndarray:
        if self._whole is not None:
            return self._whole.solve(w)
        return self.backward(self.forward(w)) / self.unit

    def forward(self, w: np.ndarray) -> np.ndarray:
        return self._triangle.solve(w[self.order])

    def backward(self, y: np.ndarray) -> np.ndarray:
        z = np.empty_like(y)
        z[self.order] = self._triangle.solve(y, "T")
        return z
