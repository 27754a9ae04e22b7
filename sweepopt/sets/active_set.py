"""The shortest vector under linear inequalities: which rows hold it, and its exact value on them.

    min |u|   subject to   G u <= slack

is a least-distance program (C. Lawson, R. Hanson, Solving Least Squares Problems, 1995, ch. 23):
with  y >= 0  that minimises  |G^T y|^2 + (<slack, y> + 1)^2  the rows with y > 0 are the active
ones. `scipy.optimize.nnls` finds them, in units of the largest violation because its tolerances are
absolute; a QR factorisation of these rows then gives u to rounding.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
import scipy.optimize
import scipy.sparse as sp

from sweepopt.errors import EmptySetError
from sweepopt.linalg import dense, row_lengths
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
    """The shortest u with G u <= slack, exact to rounding on its active rows.

    Parameters
    ----------
    G : ndarray or sparse, shape (m, dim)
    slack, rounding : ndarray, shape (m,)
        Right hand side, and how much of it is rounding: a smaller violation is none.
    near : Near, optional
        A violation that the rounding of a long u hides is looked for at the point of the face of
        the active rows that is nearest to this one.

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
    own = np.flatnonzero(lengths > 0)
    unit = sp.diags_array(1 / lengths[own])
    scaled = sp.csr_array(unit @ G[own]) if sp.issparse(G) else unit @ G[own]
    rows = _Rows(scaled, unit @ slack[own], unit @ rounding[own])
    found = rows.shortest(None if near is None else Near(*(unit @ part[own] for part in near)))
    return found and found._replace(active=own[found.active])


class _Rows(NamedTuple):
    """G u <= slack for rows of unit length; `rounding` is how much of slack is rounding."""

    G: Any
    slack: np.ndarray
    rounding: np.ndarray

    def shortest(self, near: Near | None) -> Nearest | None:
        """Rows that are violated enter the program until there are none."""
        found = Nearest(np.zeros(self.G.shape[1]), np.zeros(0, dtype=int))
        implied: set[int] = set()  # rows that follow from active ones up to rounding
        seen: set[tuple[frozenset[int], int]] = set()
        while True:
            excess = self.G @ found.u - self.slack
            hidden = self.rounding + ROUNDING * np.linalg.norm(found.u)
            excess[[*found.active, *implied]] = -np.inf
            state = (frozenset(found.active.tolist()), len(implied))
            if state in seen:
                # rounding turns in circles; good if nothing is really violated
                most = np.maximum(hidden, 1e-12 * np.abs(self.slack).max())
                return found if (excess <= most).all() else None
            seen.add(state)
            over = np.flatnonzero(excess > hidden)
            if over.size:
                rows = self._binding(np.union1d(found.active, over), implied)
            else:
                hides = -np.inf if near is None else self._over(near, found.active)
                over = np.where(excess >= -hidden, hides, -np.inf)
                if over.max(initial=-np.inf) <= 0:
                    return found
                rows = self._entered(found.active, int(np.argmax(over)), implied)
            found = self._on(rows)

    def _binding(self, rows: np.ndarray, implied: set[int]) -> np.ndarray:
        """Independent rows among these that bind the shortest u; those that follow are `implied`.

        A row that others imply with weights <= 0, and contradict, proves that there is no u.
        """
        G, slack = dense(self.G[rows]), self.slack[rows]
        goal = np.append(np.zeros(G.shape[1]), 1.0)
        y = scipy.optimize.nnls(
            np.vstack([-G.T, slack / slack.min()]), goal, maxiter=30 * len(rows)
        )[0]
        positive = y > 0
        rows, G = rows[positive], G[positive]
        Q, R, order = scipy.linalg.qr(G.T, mode="economic", pivoting=True)
        rank = int((np.abs(R.diagonal()) > DEPENDENT).sum())
        base, rest = rows[order[:rank]], rows[order[rank:]]
        for row, inside in zip(rest, G[order[rank:]] @ Q[:, :rank], strict=True):
            shares = scipy.linalg.solve_triangular(R[:rank, :rank], inside)
            limit = 100 * (self.rounding[row] + np.abs(shares) @ self.rounding[base])
            if (shares <= ROUNDING).all() and self.slack[row] - shares @ self.slack[base] < -limit:
                raise EmptySetError(EMPTY)
            implied.add(int(row))
        return base

    def _entered(self, active: np.ndarray, row: int, implied: set[int]) -> np.ndarray:
        """The active rows and one more, in place of the first whose multiplier falls to 0."""
        Q, R = np.linalg.qr(dense(self.G[active]).T)
        new = dense(self.G[[row]])[0]
        if np.linalg.norm(new - Q @ (Q.T @ new)) > DEPENDENT:
            return np.append(active, row)
        shares = scipy.linalg.solve_triangular(R, Q.T @ new)
        heights = scipy.linalg.solve_triangular(R, self.slack[active], trans=1)
        multipliers = -scipy.linalg.solve_triangular(R, heights)
        falling = shares > 0
        if not falling.any():
            implied.add(row)
            return active
        lengths = np.where(falling, multipliers / np.where(falling, shares, 1.0), np.inf)
        return np.append(np.delete(active, np.argmin(lengths)), row)

    def _on(self, rows: np.ndarray) -> Nearest:
        """The shortest u with equality on rows, without those whose multiplier is negative."""
        while rows.size:
            Q, R = np.linalg.qr(dense(self.G[rows]).T)
            heights = scipy.linalg.solve_triangular(R, self.slack[rows], trans=1)
            multipliers = -scipy.linalg.solve_triangular(R, heights)
            if multipliers.min() >= 0:
                return Nearest(Q @ heights, rows)
            rows = np.delete(rows, np.argmin(multipliers))
        return Nearest(np.zeros(self.G.shape[1]), rows)

    def _over(self, near: Near, active: np.ndarray) -> np.ndarray:
        """By how much rows are violated at the point of the face that is nearest to another one."""
        Q, R = np.linalg.qr(dense(self.G[active]).T)
        way = Q @ scipy.linalg.solve_triangular(R, near.slack[active], trans=1)
        return self.G @ way - near.slack - near.rounding - ROUNDING * np.linalg.norm(way)


def projector(rows: np.ndarray) -> np.ndarray:
    """The orthogonal projection on the span of the rows."""
    U, sizes, _ = np.linalg.svd(rows.T, full_matrices=False)
    basis = U[:, sizes > RANK * sizes.max(initial=0.0)]
    return basis @ basis.T
