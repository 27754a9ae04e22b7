"""The projection on a polyhedron: a dual active-set method, exact on the rows it ends with."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from sweepopt.errors import EmptySetError
from sweepopt.sets.base import ROUNDING

DEPENDENT = 1e-14  # the part of a unit row outside of the span of others that counts as none


class Nearest(NamedTuple):
    """The shortest u, and the independent rows that hold it: their multipliers are >= 0."""

    u: np.ndarray
    active: np.ndarray


def least_distance(G: Any, slack: np.ndarray, rounding: np.ndarray) -> Nearest | None:
    """The shortest u with G u <= slack, exact to rounding on the active set it finds.

    Goldfarb and Idnani, A numerically stable dual method for solving strictly convex quadratic
    programs, Math. Programming 27 (1983), for the identity: the most violated row enters, rows
    whose multiplier would turn negative leave, and u is solved anew from the active rows.

    Parameters
    ----------
    G : ndarray or sparse, shape (m, dim)
    slack, rounding : ndarray, shape (m,)
        Right hand side, and how much of it is rounding: a smaller violation is none.

    Returns
    -------
    Nearest or None
        None if rounding keeps the method from an answer.

    Raises
    ------
    EmptySetError
        If no u exists: some rows with weights >= 0 add up to 0 <w> <= (negative number).
    """
    empty = "Polyhedron has no point: { w : G w <= h } is empty"
    lengths = np.sqrt(np.asarray((G * G).sum(axis=1), dtype=float)).ravel()
    if (slack < -rounding)[lengths == 0].any():
        raise EmptySetError(empty + ", a zero row of G has a negative h")
    rows = np.flatnonzero(lengths > 0)
    weights = 1 / lengths[rows]
    G = (
        sp.csr_array(sp.diags_array(weights) @ G[rows])
        if sp.issparse(G)
        else (weights[:, None] * G[rows])
    )
    slack, rounding = weights * slack[rows], weights * rounding[rows]
    dim = G.shape[1]
    u = np.zeros(dim)
    active: list[int] = []
    multipliers = np.zeros(0)
    Q, R = np.eye(dim), np.zeros((dim, 0))  # Q R = the active rows, transposed
    implied: list[int] = []  # rows that follow from the active ones up to rounding
    seen: set[frozenset[int]] = set()
    while frozenset(active) not in seen:
        seen.add(frozenset(active))
        excess = G @ u - slack
        over = excess - rounding - ROUNDING * np.linalg.norm(u)
        over[active + implied] = -np.inf
        if over.max(initial=-np.inf) <= 0:
            return Nearest(u, rows[active])
        new = int(np.argmax(over))
        row = G[[new]].toarray()[0] if sp.issparse(G) else G[new]
        entering = 0.0
        while True:
            k = len(active)
            inside, outside = np.split(Q.T @ row, [k])
            shares = scipy.linalg.solve_triangular(R[:k], inside)
            falling = shares > 0
            limits = np.where(falling, multipliers / np.where(falling, shares, 1.0), np.inf)
            last = int(np.argmin(limits)) if k else -1
            longest = float(limits[last]) if k else np.inf
            free = float(outside @ outside)
            wanted = float(row @ u - slack[new]) / free if free > DEPENDENT**2 else np.inf
            length = min(wanted, longest)
            if np.isinf(length):
                # row = sum of shares <= 0 times active rows: a proof that no u exists, or rounding
                value = slack[new] - shares @ slack[active]
                if value < -100 * (rounding[new] + np.abs(shares) @ rounding[active]):
                    raise EmptySetError(empty)
                implied.append(new)
                break
            multipliers = multipliers - length * shares
            entering += length
            if np.isfinite(wanted):
                u = u - length * (Q[:, k:] @ outside)
            if wanted <= longest:
                Q, R = _append(Q, R, row)
                active.append(new)
                heights = scipy.linalg.solve_triangular(R[: k + 1], slack[active], trans=1)
                u = Q[:, : k + 1] @ heights
                multipliers = np.maximum(-scipy.linalg.solve_triangular(R[: k + 1], heights), 0.0)
                break
            Q, R = scipy.linalg.qr_delete(Q, R, last, which="col")
            del active[last]
            multipliers = np.delete(multipliers, last)
    # an active set came back: rounding turns in circles; good if nothing is really violated
    met = (G @ u - slack).max() <= 1e-12 * np.abs(slack).max()
    return Nearest(u, rows[active]) if met else None


def _append(Q: np.ndarray, R: np.ndarray, column: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """QR of the matrix with one column more."""
    if R.shape[1] == 0:
        return scipy.linalg.qr(column[:, None])
    return scipy.linalg.qr_insert(Q, R, column, R.shape[1], which="col")


def projector(rows: np.ndarray) -> np.ndarray:
    """The orthogonal projection on the span of the rows."""
    U, sizes, _ = np.linalg.svd(rows.T, full_matrices=False)
    basis = U[:, sizes > 1e-13 * sizes.max(initial=0.0)]
    return basis @ basis.T
