"""Which rows hold just after a time: the velocity program, order by order in Taylor coefficients.

With -z = N^T y the program at (t, u) asks for y >= 0, sigma = s + S y >= 0 and y sigma = 0, where
s = d - N B u and S = N A N^T. Just after t the same holds for power series in tau, with signs of
their first coefficient that is not zero. A row with y > 0 is active from then on, one with
sigma > 0 is not; a row with neither is undecided and enters the program of the next order,

    s_k = d_k - N B u_k,    u_k = -N^T y_{k-1} / k .

At A = 0 only rows without slack can be active, S = N B N^T and s_k = (k + 1) d_{k+1}.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy.linalg

from sweepopt.errors import EmptySetError, SweepoptError
from sweepopt.integrate.exact.exponential_sum import ExponentialSum
from sweepopt.integrate.exact.rows import Rows
from sweepopt.linalg import EPS
from sweepopt.sets import least_distance

ZERO = 256 * EPS  # of the terms: a coefficient that is smaller is rounding of their sums
ORDERS = 8  # a row undecided by them is taken for redundant
SOON = 1e-6  # after t in units of the process: which of several rows through a corner hold there
SPANNED = 1e-10  # a unit row is dependent on others if less of it is outside of their span


class Face(NamedTuple):
    """The rows that hold after a time.

    Attributes
    ----------
    active : list of int
        Independent rows that hold with equality, those that always do first.
    orders : ndarray of int, shape (m,)
        How many leading coefficients of a row's multiplier, or of its slack, are zero.
    redundant : ndarray of bool, shape (m,)
        Rows whose slack stays zero by itself.
    """

    active: list[int]
    orders: np.ndarray
    redundant: np.ndarray


def face_after(
    rows: Rows, phi: ExponentialSum, t: float, u: np.ndarray, stalled: bool = False
) -> Face:
    """The face just after t.

    Parameters
    ----------
    phi : ExponentialSum
        The histories of the rows from t on.
    stalled : bool
        Whether the face that was found held for no time: a multiplier of rows that are nearly
        dependent was rounding. That of S^-1 counts then.

    Raises
    ------
    EmptySetError
        If C is empty there.
    """
    undecided, orders = ~rows.equations, np.zeros(len(rows.N), dtype=int)
    active, first, rounding = list(rows.fixed), None, 0.0
    NB = rows.NB
    if rows.rate_independent:
        d, size = next(_taylor(rows, phi, t))
        undecided &= d - NB @ u <= ZERO * (size + np.abs(NB) @ np.abs(u))
        NB, phi = 0 * NB, phi.derivative()
    for k, (d, size) in zip(range(ORDERS + 1), _taylor(rows, phi, t), strict=False):
        s = d - NB @ u
        noise = ZERO * (size + np.abs(NB) @ np.abs(u)) + rounding
        basis = _basis(rows, active, undecided, s, noise)
        if basis is None and first is not None:  # a redundant row becomes violated
            undecided[active] = ~rows.equations[active]
            sizes = np.abs(first).max(), np.abs(s).max()
            soon = first + SOON * (sizes[0] / sizes[1] if sizes[0] else 1.0) * s
            active = _basis(rows, rows.fixed, undecided, soon, noise) or active
            undecided[active] = False
            basis = _basis(rows, active, undecided, s, noise)
        if basis is None:
            raise EmptySetError(
                f"C(t) at t = {t:g} is empty: its rows contradict, or its scale is negative"
            )
        y = -np.linalg.solve(rows.S[np.ix_(basis, basis)], s[basis])
        values = s + rows.S[:, basis] @ y  # the slack of a row, or its multiplier
        values[basis] = y
        of_y = noise[basis]
        if stalled:
            of_y = np.abs(np.linalg.inv(rows.S[np.ix_(basis, basis)])) @ of_y
        worst = float(of_y.max(initial=0.0))
        decided = undecided & (values > noise + worst)
        undecided &= ~decided
        orders[decided] = k
        slacks = decided.copy()
        slacks[basis] = False
        orders[slacks] += rows.rate_independent  # its s is the derivative of the slack
        if first is None:
            first = s
        active += [row for row in basis[len(active) :] if decided[row]]
        if not undecided.any():
            break
        u = -(values[active] @ rows.N[active]) / (k + 1)
        rounding = worst * rows.Lam / (k + 1) if u.any() else 0.0
    return Face(active, orders, undecided)


def _taylor(rows: Rows, phi: ExponentialSum, t: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """d_0, d_1, ... and the size of the terms that each is a sum of, with the rounding of t."""
    for k, ((value, size), (_, next_size)) in enumerate(pairwise(phi.taylor()), start=1):
        yield rows.weights @ value, np.abs(rows.weights) @ (size + abs(t) * k * next_size)


def _basis(
    rows: Rows, active: list[int], undecided: np.ndarray, s: np.ndarray, noise: np.ndarray
) -> list[int] | None:
    """The active rows, and the undecided ones that hold at the x of least norm with R x = s on
    the active and R x <= s on the undecided rows; None if there is no x.
    """
    others = np.flatnonzero(undecided)
    G, slack, noise_of = rows.R[others], s[others], noise[others]
    if active:  # x = Q_1 T^-T s + Q_2 y for the QR factors of R^T on the active rows
        Q, T = np.linalg.qr(rows.R[active].T, mode="complete")
        k = len(active)
        x = Q[:, :k] @ scipy.linalg.solve_triangular(T[:k], s[active], trans=1)
        G, slack, noise_of = G @ Q[:, k:], slack - G @ x, noise_of + noise[active].max()
        free = np.linalg.norm(G, axis=1) > SPANNED
        if (slack < -noise_of)[~free].any():
            return None
        others, G, slack, noise_of = others[free], G[free], slack[free], noise_of[free]
    if (slack >= 0).all():
        return active
    try:
        shortest = least_distance(G, slack, noise_of)
    except EmptySetError:
        return None
    if shortest is None:
        raise SweepoptError("rounding hides which rows are active")
    return active + others[shortest.active].tolist()
