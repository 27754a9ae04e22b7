"""The shortest vector under linear inequalities, exact to rounding on its active rows.

    min |u|   subject to   G u <= slack

is a least-distance program (C. Lawson, R. Hanson, Solving Least Squares Problems, 1995, ch. 23):
with  y >= 0  that minimises  |G^T y|^2 + (<slack, y> + 1)^2  the rows with y > 0 are the active
ones. `scipy.optimize.nnls` finds them, in units of the largest violation because its tolerances are
absolute; a QR factorisation of these rows then gives u to rounding.

n w <= d beside -n w <= -d is n w = d: a set with such rows has no inner points, and which of the
two rows binds is rounding.

Doubles are rational numbers: at the apex of a needle, at a vertex of many rows and on rows that fix
a point only together, nothing has to be told from rounding. There the method is that of D. Goldfarb
and A. Idnani, A numerically stable dual method for solving strictly convex quadratic programs,
Math. Programming 27 (1983): a violated row enters, rows whose multiplier would be negative leave,
and the distance grows.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
import scipy.optimize
import scipy.sparse as sp
from scipy.linalg.lapack import dtrtrs

from sweepopt.checks import Array
from sweepopt.errors import EmptySetError
from sweepopt.linalg import dense, product_error, row_lengths
from sweepopt.sets.base import RANK, ROUNDING

EMPTY = "Polyhedron has no point: { w : G w <= h } is empty"


class Shortest(NamedTuple):
    """The shortest u, and independent rows with equality whose multipliers are >= 0."""

    u: Array
    active: Array


class Flat(NamedTuple):
    """The equations among the rows of a polyhedron, each a pair of opposite rows.

    Attributes
    ----------
    equations : ndarray of bool, shape (m,)
        One row for each direction in which the set is flat.
    widths : ndarray, shape (m,)
        What rounding leaves between it and its opposite row, 0 of other rows.
    others : ndarray of bool, shape (m,)
        Rows that are parallel to none of these.
    """

    equations: Array
    widths: Array
    others: Array


def shortest_on(
    equations: Array, others: Array, G: Any, slack: Array, rounding: Array
) -> Shortest | None:
    """As `least_distance` of the others, with equality on equations, the first active rows.

    With an orthonormal basis Z of the kernel of the equations u = u_0 + Z s, s the shortest with
    G Z s <= slack - G u_0. Both are masks of the rows; what is in none of them does not count.
    """
    equations, others = np.flatnonzero(equations), np.flatnonzero(others)
    if not equations.size:
        shortest = least_distance(G[others], slack[others], rounding[others])
        return shortest and shortest._replace(active=others[shortest.active])
    Q, R, order = scipy.linalg.qr(dense(G[equations]).T, pivoting=True)
    diagonal = np.abs(R.diagonal())
    rank = int((diagonal > RANK * diagonal[0]).sum())
    equations = equations[order[:rank]]
    u, Z = Q[:, :rank] @ dtrtrs(R[:rank, :rank], slack[equations], trans=1)[0], Q[:, rank:]
    rows, products = dense(G[others]), G[others] @ u
    inner = rows @ Z
    lengths = row_lengths(rows)
    inner[row_lengths(inner) <= RANK * lengths] = 0.0  # constant where the equations hold
    rounding = rounding[others] + ROUNDING * lengths * np.linalg.norm(u)
    shortest = least_distance(inner, slack[others] - products, rounding)
    if shortest is None:
        return None
    return Shortest(u + Z @ shortest.u, np.append(equations, others[shortest.active]))


def least_distance(G: Any, slack: Array, rounding: Array) -> Shortest | None:
    """The shortest u with G u <= slack, exact to rounding on its active rows.

    Parameters
    ----------
    G : ndarray or sparse, shape (m, dim)
    slack, rounding : ndarray, shape (m,)
        Right hand side, and how much of it is rounding: a smaller violation is none.

    Returns
    -------
    Shortest or None
        None if rounding keeps the method from an answer.

    Raises
    ------
    EmptySetError
        If no u exists: some rows with weights >= 0 add up to 0 <w> <= (negative number).
    """
    u, active = np.zeros(G.shape[1]), np.zeros(0, dtype=int)
    if (slack >= 0).all():
        return Shortest(u, active)
    lengths = row_lengths(G)
    if (slack < -rounding)[lengths == 0].any():
        raise EmptySetError(EMPTY + ", a zero row of G has a negative h")
    lengths = np.where(lengths > 0, lengths, np.inf)  # no point violates a zero row then
    G = sp.diags_array(1 / lengths) @ sp.csr_array(G) if sp.issparse(G) else G / lengths[:, None]
    slack, rounding = slack / lengths, rounding / lengths
    visited: set[tuple[int, ...]] = set()
    while True:
        excess = G @ u - slack
        excess[active] = -np.inf
        violated = np.flatnonzero(excess > rounding + ROUNDING * np.linalg.norm(u))
        if not violated.size:
            return Shortest(u, active)
        state = (*np.sort(active),)
        if state in visited:  # rounding turns in circles
            small = excess.max() <= 1e-12 * np.abs(slack).max()
            return Shortest(u, active) if small else None
        visited.add(state)
        rows = np.union1d(active, violated)
        u, active = _on(G, slack, _binding(G, slack, rounding, rows) if rows.size > 1 else rows)


def _binding(G: Any, slack: Array, rounding: Array, rows: Array) -> Array:
    """Independent ones of these rows that bind the shortest u.

    A row that others imply with weights <= 0, and contradict, proves that there is no u.
    """
    columns, s = dense(G[rows]).T, slack[rows]
    goal = np.append(np.zeros(len(columns)), 1.0)
    system = np.vstack([-columns, s / s.min()])
    positive = nonnegative_least_squares(system, goal).y > 0
    rows, columns = rows[positive], columns[:, positive]
    # entries of very different sizes, as in mixed units, each with its own rounding: sorted by size
    # they keep it in R (A. Cox, N. Higham, Stability of Householder QR factorization, 1998)
    sizes = np.abs(columns).max(axis=1, initial=0.0)
    by_size = np.argsort(-sizes)
    R, order = scipy.linalg.qr(columns[by_size], mode="r", pivoting=True)
    diagonal = np.abs(R.diagonal())
    rank = int((diagonal > RANK * sizes[by_size][: diagonal.size]).sum())
    basis, dependent = rows[order[:rank]], rows[order[rank:]]
    if dependent.size:
        shares = scipy.linalg.solve_triangular(R[:rank, :rank], R[:rank, rank:])
        excess = shares.T @ slack[basis] - slack[dependent]
        limits = 100 * (rounding[dependent] + np.abs(shares.T) @ rounding[basis])
        if ((shares <= ROUNDING).all(axis=0) & (excess > limits)).any():
            raise EmptySetError(EMPTY)
    return basis


def _on(G: Any, slack: Array, rows: Array) -> tuple[Array, Array]:
    """The shortest u with equality on rows, without those whose multiplier is negative."""
    while rows.size:
        Q, R = np.linalg.qr(dense(G[rows]).T)
        heights = dtrtrs(R, slack[rows], trans=1)[0]
        multipliers = -dtrtrs(R, heights)[0]
        if multipliers.min() >= 0:
            return Q @ heights, rows
        rows = np.delete(rows, np.argmin(multipliers))
    return np.zeros(G.shape[1]), rows


class NonnegativeSolution(NamedTuple):
    """y >= 0 with the least |A y - b|, and that."""

    y: Array
    residual: float


def nonnegative_least_squares(A: Array, b: Array) -> NonnegativeSolution:
    """The y >= 0 that minimises |A y - b|, by an active set.

    Up to SciPy 1.17 `nnls` may return a y that is no minimiser, with a residual that is not that of
    y (scipy#25389, mended by #26180): then the method for bounded variables is asked.
    """
    y, residual = scipy.optimize.nnls(A, b, maxiter=30 * A.shape[1])
    rounding = 1e-8 * np.linalg.norm(np.abs(A) @ y + np.abs(b))  # much more than A y rounds
    if np.linalg.norm(A @ y - b) > residual + rounding:
        y = scipy.optimize.lsq_linear(A, b, (0, np.inf), method="bvls").x
        residual = float(np.linalg.norm(A @ y - b))
    return NonnegativeSolution(y, residual)


def projector(rows: Array) -> Array:
    """The orthogonal projection on the span of the rows."""
    return np.linalg.pinv(rows, RANK) @ rows


# ---- rows with one direction ----------------------------------------------------------------


class Parallel(NamedTuple):
    """Pairs of rows n_i = sign n_j, i < j, each array of shape (k,)."""

    i: Array
    j: Array
    sign: Array

    def equal(self, d: Array, margin: Array) -> Array:
        """Which of the pairs have one side, d_i = sign d_j, but for the larger margin of the two.

        Sides are shape (m,), or (m, k) for k histories.
        """
        i, j, sign = self
        change = np.abs(d[i].T - sign * d[j].T).T.reshape(i.size, d[:1].size)
        return change.max(axis=1, initial=0.0) <= np.maximum(margin[i], margin[j])

    def among(self, some: Array) -> Parallel:
        """Some of the pairs."""
        return Parallel(*(x[some] for x in self))

    def opposite_but_for_rounding(self, R: Any) -> Array:
        """Which pairs of rows R are a wedge: opposite, but no row is a multiple of the other."""
        wedge = (self.sign < 0) & (row_lengths(R[self.i] + R[self.j]) > 0)
        for k in np.flatnonzero(wedge):  # one by one, as all the rows may fill no memory
            wedge[k] = not _multiples(*dense(R[[self.i[k], self.j[k]]]))
        return wedge


def _multiples(x: Array, y: Array) -> bool:
    """Whether y is a multiple of x, in exact arithmetic."""
    k = np.abs(x).argmax()
    equal = (y[k] * x == x[k] * y) & (product_error(y[k], x) == product_error(x[k], y))
    return bool(equal.all())


def parallel_rows(R: Any, rounding: float = ROUNDING) -> Parallel:
    """The pairs among unit rows, dense or sparse; rows of zeros are in none.

    They differ by no more than the rounding of a multiple of a row.

    Examples
    --------
    >>> parallel_rows(np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]]))
    Parallel(i=array([0]), j=array([2]), sign=array([-1.]))
    """
    # parallel rows are neighbours in the order of their products with any vector
    direction = np.random.default_rng(0).normal(size=R.shape[1])
    heights = R @ direction
    order = np.argsort(np.abs(heights), kind="stable")
    ends = np.flatnonzero(np.diff(np.abs(heights[order])) > rounding * np.abs(direction).sum())
    groups = np.split(order, ends + 1)
    pairs = [pair for group in groups for pair in combinations(np.sort(group).tolist(), 2)]
    i, j = np.array(pairs, dtype=int).reshape(-1, 2).T
    sign = np.sign(heights[i] * heights[j])
    parallel = (row_lengths(R[i] - sign[:, None] * R[j]) <= rounding) & (sign != 0)
    return Parallel(i[parallel], j[parallel], sign[parallel])


# ---- in exact numbers: rational ones, or decimals of many digits ------------------------------

rational = np.frompyfunc(Fraction, 1, 1)


def exact_multipliers(
    G: Array, slack: Array, metric: Callable[[Array], Array], noise: Any = 0, zero: Any = 0
) -> Any:
    """y >= 0 for which w = v - P G^T y is the point of { w : G w <= h } nearest to v.

    Parameters
    ----------
    G, slack : ndarray of object, shapes (m, dim) and (m,)
        The rows, and h - G v.
    metric : callable
        x -> P x; distances are those of P^-1.
    noise, zero
        What decimals round: of a slack, and of a multiplier beside 1.

    Returns
    -------
    ndarray of object, shape (m,), or None
        None if the set is empty.
    """
    active: list[int] = []
    y, products = 0 * slack, np.zeros((len(slack), len(slack)), dtype=object)
    while (slack < -noise).any():
        new = int(slack.argmin())
        products[:, new] = G @ metric(G[new])
        while True:
            direction = 0 * y
            block = products[np.ix_(active, active)]
            direction[active] = -exact_solution(block, products[active, new])
            direction[new] = 1
            moving = [*active, new]
            change = products[:, moving] @ direction[moving]
            falling = [k for k in active if direction[k] < -zero]
            limits = [-y[k] / direction[k] for k in falling]
            if change[new] > zero:  # else the row depends on the active ones
                falling.append(new)
                limits.append(-slack[new] / change[new])
            if not falling:
                return None
            length = min(limits)
            last = falling[limits.index(length)]
            y, slack = y + length * direction, slack + length * change
            if last == new:
                active.append(new)
                slack[active] = 0  # without what decimals round
                break
            active.remove(last)
    return y


def exact_solution(H: Array, b: Array) -> Array:
    """H^-1 b, H symmetric positive definite, of a vector or of columns."""
    S = np.column_stack([H, b])
    for k in range(len(S)):
        S[k] /= S[k, k]
        others = np.arange(len(S)) != k
        S[others] -= np.outer(S[others, k], S[k])
    return S[:, len(S) :].reshape(b.shape)
