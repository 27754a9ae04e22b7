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
from sweepopt.exact.curves import EPS
from sweepopt.exact.forces import Smooth
from sweepopt.exact.rows import Rows
from sweepopt.sets.active_set import least_distance

ROUNDING = 256 * EPS  # of the terms: a smaller coefficient is none
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
    m = len(rows.N)
    first = int(rows.rate_independent)
    force, size = load.taylor(t, ORDERS + 2)
    holding, orders = list(rows.fixed), np.zeros(m, dtype=int)
    undecided = ~rows.frozen
    if rows.rate_independent:
        slack = force[:, 0] - rows.NB @ u
        undecided &= slack <= ROUNDING * (size[:, 0] + np.abs(rows.NB) @ np.abs(u))
        undecided[touched] = ~rows.frozen[touched]
        touched = np.zeros(0, dtype=int)
    matrix = rows.SB if rows.rate_independent else rows.S
    carried, pull = 0.0, np.zeros(rows.R.shape[1])
    for k in range(ORDERS + 1):
        s, noise = force[:, k + first].copy(), ROUNDING * size[:, k + first] + carried
        if rows.rate_independent:
            s, noise = (k + 1) * s, (k + 1) * noise
        else:
            s -= rows.NB @ u
            noise += ROUNDING * (np.abs(rows.NB) @ np.abs(u))
        open_ = np.flatnonzero(undecided)
        try:
            active = _program(rows.R, holding, open_, s, noise)
        except _Cut:
            if k == 0:
                raise EmptySetError(f"C(t) at t = {t:g} is empty: its rows contradict") from None
            undecided[holding] = True
            holding = _other_corner(rows, holding, open_, s, pull)
            undecided[holding] = undecided[rows.frozen] = False
            open_ = np.flatnonzero(undecided)
            active = _program(rows.R, holding, open_, s, noise)
        basis = holding + active
        y = -np.linalg.solve(matrix[np.ix_(basis, basis)], s[basis]) if basis else np.zeros(0)
        slack = s + matrix[:, basis] @ y
        pull = rows.R[basis].T @ y if k == 0 else pull
        worst = float(noise[basis].max(initial=0.0))
        late = np.isin(open_, touched) if k == 0 else np.zeros(open_.size, dtype=bool)
        positive = np.zeros(m, dtype=bool)
        positive[basis] = y > worst
        for row, waits in zip(open_.tolist(), late.tolist(), strict=True):
            if waits:
                continue
            if row in active:
                if not positive[row]:
                    continue
                holding.append(row)
                orders[row] = k
            elif slack[row] <= noise[row] + worst:
                continue
            else:
                orders[row] = k + first
            undecided[row] = False
        if not undecided.any():
            break
        if not rows.rate_independent:
            moving = dict(zip(basis, y.tolist(), strict=True))
            y = np.array([moving.get(row, 0.0) for row in holding])
            u = -(y @ rows.N[holding]) / (k + 1)
            carried = worst * rows.Lam / (k + 1) if y.any() else 0.0
    return Active(holding, orders, undecided)


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
        if not open_.size:
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
    carried = [row for row, y in zip(tight, found.x, strict=True) if y > ROUNDING]
    chosen = list(rows.fixed)
    for row in [*carried, *holding]:
        if row in chosen:
            continue
        span = rows.R[chosen]
        rest = rows.R[row] - span.T @ np.linalg.lstsq(span.T, rows.R[row], rcond=None)[0]
        if np.linalg.norm(rest) > SPANNED:
            chosen.append(row)
    return chosen
