"""Which rows hold just after a time: the velocity program, order by order in Taylor coefficients.

With -z = N^T y the program at (t, u) asks for y >= 0, sigma = s + S y >= 0 and y sigma = 0, where
s = d - N B u and S = N A N^T. Just after t the same holds for power series in tau, with signs of
their first coefficient that is not zero. A row with y > 0 is active from then on, one with
sigma > 0 is not; a row with neither is undecided and enters the program of the next order,

    s_k = d_k - N B u_k,    u_k = -N^T y_{k-1} / k .

At A = 0 only rows without slack can be active, S = N B N^T and s_k = (k + 1) d_{k+1}.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.optimize

from sweepopt.errors import EmptySetError, SweepoptError
from sweepopt.integrate.exact.rows import Rows, SmoothOffsets
from sweepopt.linalg import EPS
from sweepopt.sets import least_distance

ZERO = 256 * EPS  # of the terms: a coefficient that is smaller is rounding of their sums
EVENT = 1e3  # times that: what rounding of an event's time leaves of a row that is zero there
ORDERS = 8  # a row undecided by them is taken for redundant
SPANNED = 1e-10  # a unit row is dependent on others if less of it is outside of their span


@dataclass(frozen=True, eq=False)
class Face:
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


class _Infeasible(Exception):
    """A row that depends on those that hold is violated: others must hold."""


def face_after(rows: Rows, d: SmoothOffsets, t: float, u: np.ndarray, events: np.ndarray) -> Face:
    """The face just after t.

    Parameters
    ----------
    events : ndarray of int
        Rows whose multiplier or slack has just vanished.

    Raises
    ------
    EmptySetError
        If C is empty there.
    """
    force, size = d.taylor(t, ORDERS + 2)
    open_ = ~rows.equations
    if rows.rate_independent:
        slack = force[:, 0] - rows.NB @ u
        open_ &= slack <= ZERO * (size[:, 0] + np.abs(rows.NB) @ np.abs(u))
        open_[events] = ~rows.equations[events]
        factors = np.arange(1, ORDERS + 2)
        force, size = factors * force[:, 1:], factors * size[:, 1:]
    expansion = _Expansion(rows, list(rows.fixed), open_, np.zeros(len(rows.N), dtype=int), u)
    try:
        for k in range(ORDERS + 1):
            expansion.decide(k, force[:, k], size[:, k], events if k == 0 else events[:0])
            if not expansion.open.any():
                break
    except _Infeasible:
        raise EmptySetError(f"C(t) at t = {t:g} is empty: its rows contradict") from None
    return Face(expansion.active, expansion.orders, expansion.open)


@dataclass(eq=False)
class _Expansion:
    """The rows that are active or open (undecided) up to an order, and u_k for the next one."""

    rows: Rows
    active: list[int]
    open: np.ndarray
    orders: np.ndarray
    u: np.ndarray
    force: np.ndarray | None = None  # R^T y of order 0
    rounding: float = 0.0  # of u_k, in units of s

    def decide(self, k: int, force: np.ndarray, size: np.ndarray, events: np.ndarray) -> None:
        """Solve the program of order k and decide what its signs decide."""
        rows, s, noise = self.rows, force, ZERO * size + self.rounding
        if not rows.rate_independent:
            s = s - rows.NB @ self.u
            noise = noise + ZERO * (np.abs(rows.NB) @ np.abs(self.u))
        try:
            entering = self._entering(s, noise)
        except _Infeasible:
            if self.force is None:
                raise
            self._change_basis(s, self.force)
            entering = self._entering(s, noise)
        basis = self.active + entering
        matrix = rows.SB if rows.rate_independent else rows.S
        y = -np.linalg.solve(matrix[basis][:, basis], s[basis]) if basis else np.zeros(0)
        value = s + matrix[:, basis] @ y  # the slack of a row, or its multiplier
        value[basis] = y
        worst = float(noise[basis].max(initial=0.0))
        noise = noise + worst
        noise[events] *= EVENT
        decided = self.open & (value > noise)
        inactive = decided.copy()
        inactive[entering] = False
        self.open = self.open & ~decided
        self.orders[decided] = k
        self.orders[inactive] += rows.rate_independent  # its s is the derivative of the slack
        if self.force is None:
            self.force = rows.R[basis].T @ y
        self.active = self.active + [row for row in entering if decided[row]]
        if not rows.rate_independent:
            self.u = -(value[self.active] @ rows.N[self.active]) / (k + 1)
            self.rounding = worst * rows.Lam / (k + 1) if self.u.any() else 0.0

    def _entering(self, s: np.ndarray, noise: np.ndarray) -> list[int]:
        """The open rows that hold at the x of least norm with R x = s on the active rows and
        R x <= s on the open ones.

        Raises
        ------
        _Infeasible
            If there is none.
        """
        R, active, open_ = self.rows.R, self.active, np.flatnonzero(self.open)
        if not open_.size:
            return []
        G, slack, rounding = R[open_], s[open_], noise[open_]
        if active:  # x = Q_1 T^-T s + Q_2 y for the QR factors of R^T on the active rows
            Q, T = np.linalg.qr(R[active].T, mode="complete")
            k = len(active)
            x = Q[:, :k] @ scipy.linalg.solve_triangular(T[:k], s[active], trans=1)
            G, slack, rounding = G @ Q[:, k:], slack - G @ x, rounding + noise[active].max()
            free = np.linalg.norm(G, axis=1) > SPANNED
            if (slack < -rounding)[~free].any():
                raise _Infeasible
            open_, G, slack, rounding = open_[free], G[free], slack[free], rounding[free]
        if (slack >= 0).all():
            return []
        try:
            nearest = least_distance(G, slack, rounding)
        except EmptySetError as error:
            raise _Infeasible from error
        if nearest is None:
            raise SweepoptError("rounding keeps the active rows from being found")
        return open_[nearest.active].tolist()

    def _change_basis(self, s: np.ndarray, force: np.ndarray) -> None:
        """Let other rows carry the same velocity, where a redundant one becomes violated.

        Of all multipliers of the velocity, R^T y = force, those of least <s, y>: a linear program.
        """
        rows, open_ = self.rows, np.flatnonzero(self.open)
        tight = [*self.active, *open_.tolist()]
        program = scipy.optimize.linprog(
            s[tight] / (np.abs(s[tight]).max() or 1.0),
            A_eq=rows.R[tight].T,
            b_eq=force / (np.abs(force).max() or 1.0),
            bounds=[(None if rows.equations[row] else 0.0, None) for row in tight],
            method="highs-ds",
        )
        if program.x is None:
            raise EmptySetError("C(t) becomes empty: its rows contradict")
        loaded = [row for row, y in zip(tight, program.x, strict=True) if y > ZERO]
        chosen = list(rows.fixed)
        for row in [*loaded, *self.active]:
            span = rows.R[chosen].T
            rest = rows.R[row] - span @ np.linalg.lstsq(span, rows.R[row], rcond=None)[0]
            if np.linalg.norm(rest) > SPANNED:
                chosen.append(row)
        self.open[self.active] = True
        self.active = chosen
        self.open[chosen] = self.open[rows.equations] = False
