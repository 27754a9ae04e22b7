"""Which rows hold just after a time: the velocity program, order by order in Taylor coefficients.

With -z = N^T y the program at (t, u) asks for y >= 0, sigma = s + S y >= 0 and y sigma = 0, where
s = d - N B u and S = N A N^T. Just after t the same holds for power series in tau, with signs of
their first coefficient that is not zero. A row with y > 0 holds from then on as an equation, one
with sigma > 0 is off; a row with neither is undecided and enters the program of the next order,

    s_k = d_k - N B u_k,    u_k = -N^T y_{k-1} / k .

At A = 0 only rows without slack can move, S = N B N^T and s_k = (k + 1) d_{k+1}.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.optimize

from sweepopt.errors import EmptySetError, SweepoptError
from sweepopt.integrate.exact.forces import Smooth
from sweepopt.integrate.exact.rows import Rows
from sweepopt.linalg import EPS
from sweepopt.sets import least_distance

NOTHING = 256 * EPS  # of the terms: a smaller coefficient is none
NEAR = 1e3  # roundings by which a row may miss what an event says of it
ORDERS = 8  # a row undecided by them is taken for redundant
SPANNED = 1e-10  # the part of a unit row outside of a span that counts as none


@dataclass(frozen=True, eq=False)
class Active:
    """The rows that hold after a time.

    Attributes
    ----------
    rows : list of int
        Independent rows that hold as equations, the frozen ones first.
    orders : ndarray of int, shape (m,)
        How many leading coefficients of a row's multiplier, or of its slack, are zero.
    redundant : ndarray of bool, shape (m,)
        Rows whose slack stays zero by itself.
    """

    rows: list[int]
    orders: np.ndarray
    redundant: np.ndarray


class _Cut(Exception):
    """A row that follows from those that hold is violated: others must hold."""


def just_after(rows: Rows, load: Smooth, t: float, u: np.ndarray, touched: np.ndarray) -> Active:
    """The rows that hold just after t.

    Parameters
    ----------
    touched : ndarray of int
        Rows whose multiplier or slack was just seen to vanish.

    Raises
    ------
    EmptySetError
        If C is empty there.
    """
    force, size = load.taylor(t, ORDERS + 2)
    undecided = ~rows.frozen
    if rows.rate_independent:
        slack = force[:, 0] - rows.NB @ u
        undecided &= slack <= NOTHING * (size[:, 0] + np.abs(rows.NB) @ np.abs(u))
        undecided[touched] = ~rows.frozen[touched]
        grown = np.arange(1, ORDERS + 2)
        force, size = grown * force[:, 1:], grown * size[:, 1:]
    state = _State(rows, list(rows.fixed), undecided, np.zeros(len(rows.N), dtype=int), u)
    try:
        for k in range(ORDERS + 1):
            state.decide(k, force[:, k], size[:, k], touched if k == 0 else touched[:0])
            if not state.undecided.any():
                break
    except _Cut:
        raise EmptySetError(f"C(t) at t = {t:g} is empty: its rows contradict") from None
    return Active(state.holding, state.orders, state.undecided)


@dataclass(eq=False)
class _State:
    """What is decided up to an order, and the coefficient of u that enters the next one."""

    rows: Rows
    holding: list[int]
    undecided: np.ndarray
    orders: np.ndarray
    u: np.ndarray
    pull: np.ndarray | None = None  # R^T y of order 0
    carried: float = 0.0  # rounding of u in units of s

    def decide(self, k: int, force: np.ndarray, size: np.ndarray, touched: np.ndarray) -> None:
        """Solve the program of order k and decide what its signs decide."""
        rows, s, noise = self.rows, force, NOTHING * size + self.carried
        if not rows.rate_independent:
            s = s - rows.NB @ self.u
            noise = noise + NOTHING * (np.abs(rows.NB) @ np.abs(self.u))
        try:
            active = self._program(s, noise)
        except _Cut:
            if self.pull is None:
                raise
            self._change_corner(s)
            active = self._program(s, noise)
        basis = self.holding + active
        matrix = rows.SB if rows.rate_independent else rows.S
        y = -np.linalg.solve(matrix[basis][:, basis], s[basis]) if basis else np.zeros(0)
        slack = s + matrix[:, basis] @ y
        worst = float(noise[basis].max(initial=0.0))
        noise = noise + worst
        noise[touched] *= NEAR
        value = slack.copy()
        value[basis] = y
        decided = self.undecided & (value > noise)
        off = decided.copy()
        off[active] = False
        self.undecided = self.undecided & ~decided
        self.orders[decided] = k
        self.orders[off] += rows.rate_independent  # there the program has the slack's derivative
        self.pull = rows.R[basis].T @ y if self.pull is None else self.pull
        self.holding = self.holding + [row for row in active if decided[row]]
        if not rows.rate_independent:
            self.u = -(value[self.holding] @ rows.N[self.holding]) / (k + 1)
            self.carried = worst * rows.Lam / (k + 1) if self.u.any() else 0.0

    def _program(self, s: np.ndarray, noise: np.ndarray) -> list[int]:
        return _program(self.rows.R, self.holding, np.flatnonzero(self.undecided), s, noise)

    def _change_corner(self, s: np.ndarray) -> None:
        """Let other rows carry the velocity, where a redundant one begins to cut."""
        assert self.pull is not None
        open_ = np.flatnonzero(self.undecided)
        self.undecided[self.holding] = True
        self.holding = _other_corner(self.rows, self.holding, open_, s, self.pull)
        self.undecided[self.holding] = self.undecided[self.rows.frozen] = False


def _program(
    R: np.ndarray, holding: list[int], open_: np.ndarray, s: np.ndarray, noise: np.ndarray
) -> list[int]:
    """The open rows that hold at the x of least norm with R x = s on `holding`, <= s on the others.

    Raises
    ------
    _Cut
        If there is none.
    """
    if not open_.size:
        return []
    G, slack, rounding = R[open_], s[open_], noise[open_]
    if holding:
        Q, T = np.linalg.qr(R[holding].T, mode="complete")
        k = len(holding)
        heights = scipy.linalg.solve_triangular(T[:k], s[holding], trans=1)
        slack = slack - G @ (Q[:, :k] @ heights)
        rounding = rounding + noise[holding].max()
        G = G @ Q[:, k:]
        free = np.linalg.norm(G, axis=1) > SPANNED
        if (slack < -rounding)[~free].any():
            raise _Cut
        open_, G, slack, rounding = open_[free], G[free], slack[free], rounding[free]
    if (slack >= 0).all():
        return []
    try:
        found = least_distance(G, slack, rounding)
    except EmptySetError as error:
        raise _Cut from error
    if found is None:
        raise SweepoptError("rounding keeps the active rows from being found")
    return open_[found.active].tolist()


def _other_corner(
    rows: Rows, holding: list[int], open_: np.ndarray, s: np.ndarray, pull: np.ndarray
) -> list[int]:
    """Rows that carry the same velocity where a redundant row begins to cut.

    Of all multipliers of the velocity, R^T y = pull, those of least <s, y>: a linear program.
    """
    tight = [*holding, *open_.tolist()]
    force, size = np.abs(s[tight]).max() or 1.0, np.abs(pull).max() or 1.0
    found = scipy.optimize.linprog(
        s[tight] / force,
        A_eq=rows.R[tight].T,
        b_eq=pull / size,
        bounds=[(None if rows.frozen[row] else 0.0, None) for row in tight],
        method="highs-ds",
    )
    if found.x is None:
        raise EmptySetError("C(t) becomes empty: its rows contradict")
    carried = [row for row, y in zip(tight, found.x, strict=True) if y > NOTHING]
    chosen = list(rows.fixed)
    for row in [*carried, *holding]:
        if row in chosen:
            continue
        span = rows.R[chosen]
        rest = rows.R[row] - span.T @ np.linalg.lstsq(span.T, rows.R[row], rcond=None)[0]
        if np.linalg.norm(rest) > SPANNED:
            chosen.append(row)
    return chosen
