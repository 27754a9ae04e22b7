"""L L^T = M for a sparse M: by CHOLMOD where cvxopt is installed, else by SuperLU.

CHOLMOD factorises one triangle only and has both substitutions as calls of their own. On the unit
square with P1 elements a step's pair of them takes, on one core,

    unknowns    CHOLMOD    SuperLU    factorised with some unknowns last
    10,100       0.21 ms    0.51 ms    0.02 s    0.03 s
    100,172      9.6  ms   11    ms    0.6  s    0.6  s
    1,001,000    150  ms    246  ms    5    s     17  s
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.util import find_spec
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from sweepopt.checks import Matrix

SYMMETRIC: dict[str, Any] = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
BLOCKED = 300_000  # unknowns from which on columns are put together: quick to factorise
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
        The last rows and columns of L.
    """

    pivots: np.ndarray
    tail: np.ndarray

    def solve(self, w: np.ndarray) -> np.ndarray:
        """M^-1 w, of one vector or of columns."""
        ...

    def forward(self, w: np.ndarray) -> np.ndarray:
        """L^-1 P w."""
        ...

    def backward(self, y: np.ndarray) -> np.ndarray:
        """P^T L^-T y."""
        ...


def whole(M: Matrix) -> Whole:
    """M factorised in an order of its own."""
    return _Cholmod(M) if installed() else _SuperLU(M)


def halves(M: Matrix, order: np.ndarray, m: int) -> Halves:
    """M factorised in a given order, whose last m unknowns have their block of L at hand."""
    return _Cholmod(M, order, m) if installed() else _Substitutions(M, order, m)


@cache
def installed() -> bool:
    """Whether CHOLMOD is there."""
    return find_spec("cvxopt") is not None


def unit_of(M: Matrix) -> float:
    """A power of two in the units of M: the roots of M / unit are the same to the last bit."""
    return math.ldexp(1.0, math.frexp(float(M.diagonal().max()))[1])


class _Cholmod:
    """P^T L D L^T P = M / unit; D is 1 where columns are put together."""

    def __init__(self, M: Matrix, order: np.ndarray | None = None, m: int = 0) -> None:
        from cvxopt import amd, cholmod, matrix, spmatrix

        self._matrix, self._solve = matrix, cholmod.solve
        self._unit = unit_of(M)
        lower = sp.tril(M, format="coo")
        place = lower.row.astype(np.int64), lower.col.astype(np.int64)
        A = spmatrix(lower.data / self._unit, *place, M.shape)
        self.order = np.ravel(amd.order(A)) if order is None else order
        blocked = len(self.order) >= BLOCKED

        def factor() -> Any:
            found = cholmod.symbolic(A, p=matrix(self.order.astype(np.int64)))
            cholmod.numeric(A, found)
            return found

        with _settings(cholmod, blocked):
            self._factor = factor()
            D = 1 / self._system(6, np.ones(len(self.order)))
            self._root = np.sqrt(np.abs(D))
            pivots = np.ravel(cholmod.diag(self._factor)) ** 2 if blocked else D
            self.pivots = np.empty_like(pivots)
            self.pivots[self.order] = self._unit * pivots
            if m and pivots.min() > 0:
                # which takes the numbers out of the factor
                tail = np.array(matrix(cholmod.getfactor(self._factor)[-m:, -m:]))
                if not blocked:
                    np.fill_diagonal(tail, 1.0)  # where D was
                self.tail = tail * self._root[-m:]
                self._factor = factor()

    def solve(self, w: np.ndarray) -> np.ndarray:
        z = self._system(0, w)
        z /= self._unit
        return z

    def forward(self, w: np.ndarray) -> np.ndarray:
        y = self._system(4, w[self.order])
        y /= self._root
        return y

    def backward(self, y: np.ndarray) -> np.ndarray:
        z = np.empty_like(y)
        z[self.order] = self._system(5, y / self._root)
        return z

    def _system(self, which: int, w: np.ndarray) -> np.ndarray:
        """The solution for one of CHOLMOD's matrices: 0 is M / unit, 4 L, 5 L^T, 6 D."""
        x = self._matrix(w)
        self._solve(self._factor, x, sys=which)
        return np.asarray(x).reshape(w.shape, order="F")


@contextmanager
def _settings(cholmod: Any, blocked: bool) -> Iterator[None]:
    """The order as it is given; the settings are the module's, of all its users."""
    with _settings_lock:
        before = dict(cholmod.options)
        cholmod.options.update(supernodal=2 * blocked, nmethods=1, postorder=False)
        try:
            yield
        finally:
            cholmod.options.clear()
            cholmod.options.update(before)


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
