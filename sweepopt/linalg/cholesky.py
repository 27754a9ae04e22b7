"""L L^T = M for a sparse M: by CHOLMOD where cvxopt is installed and M not too large, or SuperLU.

On the unit square with P1 elements, in ms on one core, a solve and the two substitutions of a step:

    unknowns     CHOLMOD        SuperLU
    1,056        0.024  0.035   0.049  0.078
    10,100       0.21   0.28    0.56   0.80
    100,172      9.6    12.5    9.2    15.4
    1,001,000    212    205     126    146     (CHOLMOD in blocks, else it factorises 30 s)

Both take about a second to factorise 100,172 unknowns, SuperLU 14 to 17 s for 1,001,000.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from functools import cache
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from sweepopt.checks import Matrix

SYMMETRIC: dict[str, Any] = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
LIMIT = 200_000  # unknowns that CHOLMOD is faster for
SETTINGS = {"supernodal": 0, "nmethods": 1, "postorder": False}  # L D L^T in the order it is given
WHOLE, LOWER, UPPER, DIAGONAL = 0, 4, 5, 6  # CHOLMOD's numbers of M, L, L^T and D
_settings_lock = threading.Lock()


class Whole(Protocol):
    """M factorised.

    Attributes
    ----------
    order : ndarray of int
        An order of the unknowns with little fill.
    pivots : ndarray
        Those of the unknowns, as M counts them.
    """

    order: np.ndarray
    pivots: np.ndarray

    def solve(self, w: np.ndarray) -> np.ndarray:
        """M^-1 w, of one vector or of columns."""
        ...


class Halves(Protocol):
    """M / unit = P^T L L^T P with P w = w[order]; both substitutions apart.

    Attributes
    ----------
    pivots : ndarray
    tail : ndarray, shape (m, m)
        The last rows and columns of L; only where all pivots are positive.
    """

    pivots: np.ndarray
    tail: np.ndarray

    def solve(self, w: np.ndarray) -> np.ndarray:
        """M^-1 w, of one vector or of columns."""
        ...

    def forward(self, w: np.ndarray) -> np.ndarray:
        """L^-1 P w, of one vector."""
        ...

    def backward(self, y: np.ndarray) -> np.ndarray:
        """P^T L^-T y, of one vector."""
        ...


def whole(M: Matrix) -> Whole:
    """M factorised in an order of its own."""
    return _Cholmod(M) if _has_cholmod(M) else _SuperLU(M)


def halves(M: Matrix, order: np.ndarray, m: int) -> Halves:
    """M factorised in a given order, whose last m unknowns have their block of L at hand."""
    return _Cholmod(M, order, m) if _has_cholmod(M) else _Substitutions(M, order, m)


def _has_cholmod(M: Matrix) -> bool:
    return M.shape[0] <= LIMIT and installed()


@cache
def installed() -> bool:
    """Whether CHOLMOD is there."""
    try:
        from cvxopt import amd, cholmod  # noqa: F401
    except ImportError:  # not installed, or it lacks something itself
        return False
    return True


def unit_of(M: Matrix) -> float:
    """A power of two in the units of M: the roots of M / unit are the same to the last bit."""
    return math.ldexp(1.0, math.frexp(float(M.diagonal().max()))[1])


class _Cholmod:
    """M / unit = P^T L D L^T P, with ones on the diagonal of this L.

    Where a hard limit of memory (ulimit -v) is met, cvxopt 1.3 may end the process.
    """

    def __init__(self, M: Matrix, order: np.ndarray | None = None, m: int = 0) -> None:
        from cvxopt import amd, cholmod, matrix

        self._matrix, self._solve = matrix, cholmod.solve
        self._unit = unit_of(M)
        A = _triangle(M, self._unit)
        self.order = np.ravel(amd.order(A)) if order is None else order
        self._factor = _factorised(A, self.order)
        D = 1 / self._system(DIAGONAL, np.ones(len(self.order)))
        self._root = np.sqrt(np.abs(D))
        self.pivots = np.empty_like(D)
        self.pivots[self.order] = self._unit * D
        if m and D.min() > 0:
            tail = np.array(matrix(cholmod.getfactor(self._factor)[-m:, -m:]))
            np.fill_diagonal(tail, 1.0)  # where D was
            self.tail = tail * self._root[-m:]
            self._factor = _factorised(A, self.order)  # getfactor has emptied it

    def solve(self, w: np.ndarray) -> np.ndarray:
        z = self._system(WHOLE, w)
        z /= self._unit
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


def _triangle(M: Matrix, unit: float) -> Any:
    """The lower triangle of M / unit as cvxopt has it."""
    from cvxopt import spmatrix

    lower = sp.tril(M, format="coo")
    rows, columns = lower.row.astype(np.int64), lower.col.astype(np.int64)
    return spmatrix(lower.data / unit, rows, columns, M.shape)


def _factorised(A: Any, order: np.ndarray) -> Any:
    """The factor of A in this order and no other."""
    from cvxopt import cholmod, matrix

    p = matrix(order.astype(np.int64))
    factor = _with_settings(cholmod.symbolic, A, p)
    _with_settings(cholmod.numeric, A, factor)
    return factor


def _with_settings(call: Callable[..., Any], *args: Any) -> Any:
    """A call with our settings alone; they are the module's, others have theirs back at once."""
    from cvxopt.cholmod import options

    with _settings_lock:
        before = dict(options)
        try:
            options.clear()
            options.update(SETTINGS)
            return call(*args)
        finally:
            options.clear()
            options.update(before)


class _SuperLU:
    def __init__(self, M: Matrix) -> None:
        lu = spla.splu(sp.csc_matrix(M), permc_spec="MMD_AT_PLUS_A", **SYMMETRIC)
        self.solve = lu.solve
        self.order = np.argsort(lu.perm_c)
        # with pivots on the diagonal their signs are the inertia (Sylvester)
        self.pivots = lu.U.diagonal()[lu.perm_c]


class _Substitutions:
    """The factor factorised: that gives its substitutions apart, forward and transposed."""

    def __init__(self, M: Matrix, order: np.ndarray, m: int) -> None:
        self._order = order
        self._unit = unit_of(M)
        ordered = sp.csc_matrix(M[order][:, order])
        lu = spla.splu(ordered, permc_spec="NATURAL", **SYMMETRIC)
        pivots = lu.U.diagonal()
        self.pivots = np.empty_like(pivots)
        self.pivots[order] = pivots
        if pivots.min() > 0:
            lower = (lu.L @ sp.diags_array(np.sqrt(pivots / self._unit))).tocsc()
            self.tail = lower[-m:, -m:].toarray()
            self._triangle = spla.splu(lower, permc_spec="NATURAL", **SYMMETRIC)

    def solve(self, w: np.ndarray) -> np.ndarray:
        return self.backward(self.forward(w)) / self._unit

    def forward(self, w: np.ndarray) -> np.ndarray:
        return self._triangle.solve(w[self._order])

    def backward(self, y: np.ndarray) -> np.ndarray:
        z = np.empty_like(y)
        z[self._order] = self._triangle.solve(y, "T")
        return z
