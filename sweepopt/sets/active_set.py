"""The projection on a polyhedron: a dual active-set method, exact on the rows it ends with."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from sweepopt.errors import EmptySetError
from sweepopt.linalg import row_lengths
from sweepopt.sets.base import RANK, ROUNDING

DEPENDENT = 1e-14  # the part of a unit row outside of the span of others that counts as none
EMPTY = "Polyhedron has no point: { w : G w <= h } is empty"


class Nearest(NamedTuple):
    """The shortest u, and the independent rows that hold it: their multipliers are >= 0."""

    u: np.ndarray
    active: np.ndarray


class Near(NamedTuple):
    """The slack at a point from which there is less way to go than u, and what rounding it has."""

    slack: np.ndarray
    rounding: np.ndarray


def least_distance(
    G: Any, slack: np.ndarray, rounding: np.ndarray, near: Near | None = None
) -> Nearest | None:
    """The shortest u with G u <= slack, exact to rounding on the active set it finds.

    Goldfarb and Idnani, A numerically stable dual method for solving strictly convex quadratic
    programs, Math. Programming 27 (1983), for the identity.

    Parameters
    ----------
    G : ndarray or sparse, shape (m, dim)
    slack, rounding : ndarray, shape (m,)
        Right hand side, and how much of it is rounding: a smaller violation is none.
    near : Near, optional
        Of rows that the rounding of u hides, the point nearest to this one on the face of the
        active ones tells.

    Returns
    -------
    Nearest or None
        None if rounding keeps the method from an answer.

    Raises
    ------
    EmptySetError
        If no u exists: some rows with weights >= 0 add up to 0 <w> <= (negative number).
    """
    lengths = row_lengths(G)
    if (slack < -rounding)[lengths == 0].any():
        raise EmptySetError(EMPTY + ", a zero row of G has a negative h")
    rows = np.flatnonzero(lengths > 0)
    weights = 1 / lengths[rows]
    unit = (
        sp.csr_array(sp.diags_array(weights) @ G[rows])
        if sp.issparse(G)
        else (weights[:, None] * G[rows])
    )
    near = None if near is None else Near(*(weights * part[rows] for part in near))
    method = _DualMethod(unit, weights * slack[rows], weights * rounding[rows], near)
    return Nearest(method.u, rows[method.active]) if method.run() else None


class _Step(NamedTuple):
    """The directions in which multipliers and u go for one more row, and how far.

    Attributes
    ----------
    shares : ndarray, shape (k,)
        What the row is of the active ones: by this their multipliers fall.
    outside : ndarray, shape (dim - k,)
        The rest of the row in the columns of Q beside them: by this u moves.
    full, partial : float
        The length at which the row holds, and that at which the multiplier `last` is 0.
    """

    shares: np.ndarray
    outside: np.ndarray
    full: float
    partial: float
    last: int


class _DualMethod:
    """u, the active rows that hold it and their multipliers; rows of G are unit vectors."""

    def __init__(self, G: Any, slack: np.ndarray, rounding: np.ndarray, near: Near | None) -> None:
        self._G, self._slack, self._rounding, self._near = G, slack, rounding, near
        dim = G.shape[1]
        self.u = np.zeros(dim)
        self.active: list[int] = []
        self._multipliers = np.zeros(0)
        self._Q, self._R = np.eye(dim), np.zeros((dim, 0))  # Q R = the active rows, transposed
        self._implied: list[int] = []  # rows that follow from the active ones up to rounding

    def run(self) -> bool:
        """The most violated row enters until none is violated; False if rounding keeps it."""
        seen: set[frozenset[int]] = set()
        while frozenset(self.active) not in seen:
            seen.add(frozenset(self.active))
            new = self._most_violated()
            if new is None:
                return True
            self._enter(new)
        # an active set came back: rounding turns in circles; good if nothing is really violated
        excess = self._G @ self.u - self._slack
        return bool((excess <= np.maximum(self._hidden(), 1e-12 * np.abs(self._slack).max())).all())

    def _most_violated(self) -> int | None:
        excess = self._G @ self.u - self._slack
        hidden = self._hidden()
        over = excess - hidden
        over[self.active + self._implied] = -np.inf
        if over.max(initial=-np.inf) <= 0 and self._near is not None:
            hides = (excess >= -hidden) & np.isfinite(over)
            over = np.where(hides, self._over(self._near), -np.inf)
        return int(np.argmax(over)) if over.max(initial=-np.inf) > 0 else None

    def _hidden(self) -> np.ndarray:
        """What rounding of the rows and of u hides of a violation."""
        return np.asarray(self._rounding + ROUNDING * np.linalg.norm(self.u))

    def _over(self, near: Near) -> np.ndarray:
        """By how much rows are violated at the point of the face that is nearest to another one."""
        k = len(self.active)
        heights = scipy.linalg.solve_triangular(self._R[:k], near.slack[self.active], trans=1)
        way = self._Q[:, :k] @ heights
        return self._G @ way - near.slack - near.rounding - ROUNDING * np.linalg.norm(way)

    def _enter(self, new: int) -> None:
        """Partial steps, each of which drops a row, until a full one adds the new row."""
        row = self._G[[new]].toarray()[0] if sp.issparse(self._G) else self._G[new]
        while True:
            step = self._step(row, new)
            length = min(step.full, step.partial)
            if np.isinf(length):
                self._imply(new, step.shares)
                return
            self._multipliers = self._multipliers - length * step.shares
            if np.isfinite(step.full):
                self.u = self.u - length * (self._Q[:, len(self.active) :] @ step.outside)
            if step.full <= step.partial:
                self._add(new, row)
                return
            self._drop(step.last)

    def _step(self, row: np.ndarray, new: int) -> _Step:
        k = len(self.active)
        inside, outside = np.split(self._Q.T @ row, [k])
        shares = scipy.linalg.solve_triangular(self._R[:k], inside)
        falling = shares > 0
        limits = np.where(falling, self._multipliers / np.where(falling, shares, 1.0), np.inf)
        last = int(np.argmin(limits)) if k else -1
        free, over = float(outside @ outside), max(float(row @ self.u - self._slack[new]), 0.0)
        full = over / free if free > DEPENDENT**2 else np.inf
        return _Step(shares, outside, full, float(limits[last]) if k else np.inf, last)

    def _imply(self, new: int, shares: np.ndarray) -> None:
        """The row is a sum of shares <= 0 of active ones: a proof that no u exists, or rounding."""
        slack, rounding = self._slack, self._rounding
        value = slack[new] - shares @ slack[self.active]
        if value < -100 * (rounding[new] + np.abs(shares) @ rounding[self.active]):
            raise EmptySetError(EMPTY)
        self._implied.append(new)

    def _add(self, new: int, row: np.ndarray) -> None:
        """One active row more, and u anew from all of them."""
        self._Q, self._R = _append(self._Q, self._R, row)
        self.active.append(new)
        k = len(self.active)
        R = self._R[:k]
        heights = scipy.linalg.solve_triangular(R, self._slack[self.active], trans=1)
        self.u = self._Q[:, :k] @ heights
        self._multipliers = np.maximum(-scipy.linalg.solve_triangular(R, heights), 0.0)

    def _drop(self, last: int) -> None:
        """One active row less, whose multiplier is 0."""
        self._Q, self._R = scipy.linalg.qr_delete(self._Q, self._R, last, which="col")
        del self.active[last]
        self._multipliers = np.delete(self._multipliers, last)


def _append(Q: np.ndarray, R: np.ndarray, column: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """QR of the matrix with one column more."""
    if R.shape[1] == 0:
        return scipy.linalg.qr(column[:, None])
    return scipy.linalg.qr_insert(Q, R, column, R.shape[1], which="col")


def projector(rows: np.ndarray) -> np.ndarray:
    """The orthogonal projection on the span of the rows."""
    U, sizes, _ = np.linalg.svd(rows.T, full_matrices=False)
    basis = U[:, sizes > RANK * sizes.max(initial=0.0)]
    return basis @ basis.T
