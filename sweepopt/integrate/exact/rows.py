"""The process in the rows of C(t) = { w : N w <= d(t) }, d in closed form between breakpoints.

C(t) is a polyhedron S, also a sum, image, product or intersection of them, at rest or moved by
center(t) + scale(t) S = { w : N w <= scale(t) d + N center(t) }, or { w : G w <= h(t) }, all of
time as data. Multiples, translates, products and intersections of such sets that move have such
rows too; sums where each moves by its own center(t) and scale(t), images where they move by
center(t): else they are functions of time. So are products of histories.

With the rows a active from tau = 0 on, u = u_s - N_a^T q and

    (N_a A N_a^T) q' + (N_a B N_a^T) q = N_a B u_s - d_a(tau),   q(0) = 0

(MATH.md section 3). Generalised eigenvectors V split it into p' + lam p = r, each solved exactly.

Which rows hold just after a time: the velocity program, order by order in Taylor coefficients.

With -z = N^T y the program at (t, u) asks for y >= 0, sigma = s + S y >= 0 and y sigma = 0, where
s = d - N B u and S = N A N^T. Just after t the same holds for power series in tau, with signs of
their first coefficient that is not zero. A row with y > 0 is active from then on, one with
sigma > 0 is not; a row with neither is undecided and enters the program of the next order,

    s_k = d_k - N B u_k,    u_k = -N^T y_{k-1} / k .

At A = 0 only rows without slack can be active, S = N B N^T and s_k = (k + 1) d_{k+1}.

Rounding of y_{k-1} enters s_k Lam / k times: of stiff bodies it hides all orders but the first. A
row that no order decides is not active until its slack is violated by more than rounding.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import pairwise
from operator import add
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
from scipy.linalg import lapack

from sweepopt.checks import Array, at_path
from sweepopt.errors import EmptySetError, InputError, SweepoptError, shown
from sweepopt.integrate.exact.exponential_sum import ExponentialSum
from sweepopt.linalg import EPS, NEGLIGIBLE, dense
from sweepopt.loads import VectorTable
from sweepopt.problem import Motion, SweepingProcess, Terms, TimeFunction, motion
from sweepopt.sets import NoHalfspacesError, facets, parallel_rows, shortest_on


def modes(SA: Array, SB: Array) -> tuple[Array, Array]:
    """lam >= 0 and V with V^T SA V = 1, V^T SB V = diag(lam).

    From the singular values of SA^-1/2 SB^1/2 by one-sided Jacobi rotations: where units or
    stiffnesses differ, slow modes are as accurate as fast ones (Demmel and Veselic, SIAM J. Matrix
    Anal. Appl. 13(4), 1992).
    """
    n = len(SA)
    lower = scipy.linalg.cholesky(SA, lower=True)
    root, order = _root(SB)
    rank = root.shape[1]
    if not rank:
        return np.zeros(n), scipy.linalg.solve_triangular(lower, np.eye(n), lower=True).T
    K = scipy.linalg.solve_triangular(lower, root, lower=True)
    sigma, U, W, scales, *_ = lapack.dgejsv(K, joba=2, jobu=1, jobv=0)
    sigma = sigma * (scales[0] / scales[1])
    lam = np.append(sigma**2, np.zeros(n - rank))
    V = scipy.linalg.solve_triangular(lower, U, lower=True, trans=1)
    if rank == n:
        # of a slow mode root^T V = W sigma knows the small entries, by which fast forces pull
        slow = lam < 1e-2 * lam[0]
        other = scipy.linalg.solve_triangular(
            root[order], (W * sigma)[:, slow], trans=1, lower=True
        )
        V[np.ix_(order, slow)] = other
    return lam, V


def _root(SB: Array) -> tuple[Array, Array]:
    """root with root root^T = SB, of full column rank, and the rows that make it triangular."""
    n = len(SB)
    scale = np.sqrt(np.maximum(SB.diagonal(), 0.0))
    scale[scale == 0] = 1.0
    unit = SB / np.outer(scale, scale)
    factor, order, rank, _ = lapack.dpstrf(unit, tol=n * EPS, lower=1)
    root, order = np.zeros((n, rank)), order - 1
    root[order] = np.tril(factor)[:, :rank]
    return scale[:, None] * root, order


NONSMOOTH = 50  # unknowns in a set's inequalities
UNKNOWNS = 300  # all of them: a phase has a dense eigenproblem of what moves


@dataclass(frozen=True, eq=False)
class Rows:
    """The process in the rows of C(t), which are unit vectors in the metric M: A, or B for A = 0.

    Attributes
    ----------
    N : ndarray, shape (m, n)
    equations : ndarray of bool, shape (m,)
        Rows that hold with equality at all times.
    R : ndarray, shape (m, n)
        N L with M = L L^T.
    NB, S, SB : ndarray, shapes (m, n), (m, m), (m, m)
        N B, N M N^T and N B N^T.
    histories, weights : list, ndarray of shape (m, k)
        d(t) = sum_k phi_k(t) weights[:, k].
    Lam : float
        The largest rate of the process; 0 where A = 0.
    rate_independent : bool
    """

    N: Array
    equations: Array
    R: Array
    NB: Array
    S: Array
    SB: Array
    histories: list[Any]
    weights: Array
    Lam: float
    rate_independent: bool

    @cached_property
    def fixed(self) -> list[int]:
        """The rows that always hold with equality."""
        return np.flatnonzero(self.equations).tolist()

    def size_of_nearest(self, t: float, u: Array, mu: float) -> float:
        """What the d of the row with the least slack adds up, a force in |.|_{M^-1} of a step."""
        values = np.array([phi(t) for phi in self.histories])
        squares = (0.0 if self.rate_independent else 1.0) + mu * self.SB.diagonal()
        slack = np.where(self.S.diagonal() > 0, self.weights @ values - self.NB @ u, np.inf)
        k = slack.argmin()
        return float(np.abs(self.weights[k]) @ np.abs(values) / np.sqrt(squares[k]))


@at_path("scheme 'exact' does not apply: ")
def rows_of(process: SweepingProcess) -> Rows:
    """The rows of a process.

    Raises
    ------
    InputError
        If a set is curved or has no rows, the load is a black box, or there are too many unknowns.
    """
    if not (process.coercive or process.rate_independent):
        raise InputError("A is singular and not zero; use sdirk2 or auto")
    if process.dim > UNKNOWNS:
        raise InputError(
            f"the process has {process.dim} unknowns in its steps, more than {UNKNOWNS}. A body "
            "whose B is a multiple of A and whose set acts on few unknowns needs these alone; for "
            "others use auto"
        )
    N, terms, count = _halfspaces(motion(process.C))
    metric = dense(process.metric.M)
    B = np.zeros_like(metric) if process.B is None else dense(process.B)
    R = N @ scipy.linalg.cholesky(metric, lower=True)
    lengths = np.linalg.norm(R, axis=1)
    units = 1 / np.where(lengths > 0, lengths, 1.0)[:, None]
    N, R, weights = units * N, units * R, units * np.column_stack([D for _, D in terms])
    rows, equations = _distinct(R, weights, np.arange(len(N)) >= len(N) - count)
    N, R, weights = N[rows], R[rows], weights[rows]
    nonsmooth = process.dim - int(equations.sum())
    if nonsmooth > NONSMOOTH:
        raise InputError(
            f"the process has {nonsmooth} nonsmooth unknowns, more than {NONSMOOTH}; use auto"
        )
    histories, still = [phi for phi, _ in terms], process.rate_independent
    lam, NB = 0.0 if still else process.Lam, N @ B
    return Rows(N, equations, R, NB, R @ R.T, NB @ N.T, histories, weights, lam, still)


def _halfspaces(moving: Motion) -> tuple[Array, Terms, int]:
    """N and d of C(t) = { w : N w <= d(t) }, and how many of the last rows are equations."""
    if not moving.summands:
        raise InputError(
            "the process has a set that is a function of time; "
            "write it as so.Moving(shape, center=so.Separable(...)) or so.Polyhedron(G, "
            "so.Separable(...))"
        )
    scales, shapes = zip(*moving.summands, strict=True)
    load = moving.center if moving.offsets is None else moving.offsets
    terms, count = _closed_forms(load, moving.name), len(shapes)
    sizes = [_closed_forms(scale, "scale") for scale in scales]
    try:
        N, d, E, e = facets(reduce(add, shapes))
    except NoHalfspacesError as error:
        raise InputError(
            f"the process has a set that is not a polyhedron with known rows: {error}; use auto"
        ) from None
    # the first rows, 0 <= scale(t), have no solution where a scale is negative
    N = np.vstack([np.zeros((count, N.shape[1])), dense(N), E])
    of_scales = np.eye(len(N), count)
    # sum_i r_i S_i has the normals of sum_i S_i, and sides of which each is linear in the r_i
    of_scales[count:] = np.transpose(
        [np.append(d, e)] if count == 1 else [[S.support(n) for n in N[count:]] for S in shapes]
    )
    if moving.offsets is None:
        terms = tuple((phi, N @ f) for phi, f in terms)
    else:
        terms = tuple((phi, np.concatenate([[0.0], f, 0 * e])) for phi, f in terms)
    sides = zip(sizes, of_scales.T, strict=True)
    return N, (*((phi, r * side) for size, side in sides for phi, r in size), *terms), len(e)


def _closed_forms(load: TimeFunction, name: str) -> Terms:
    """The terms of a load whose histories are all known in closed form."""
    if isinstance(load.function, VectorTable):
        return load.function.terms
    if load.function is not None:
        raise InputError(
            f"the process has a black-box {name}: the breakpoints of a function are not known; "
            "write it as data, Polynomial, Sine, Triangle or Table: a scale as one of them, others "
            "as so.Separable([(history, vector), ...])"
        )
    for k, history in enumerate(load.histories):
        if not hasattr(history, "piece") or not hasattr(history, "breakpoints"):
            raise InputError(
                f"the process has {name} whose terms[{k}][0], {shown(history)}, has no closed "
                "form; use Constant, Polynomial, Sine, Triangle or Table, or give it piece(a, b) "
                "and breakpoints(a, b)"
            )
    return load.terms


def _distinct(R: Array, weights: Array, equations: Array) -> tuple[Array, Array]:
    """Rows that are not repeated, and which of them hold with equality.

    A pair n w <= d, -n w <= -d is an equation at all times; so is what a Box with equal bounds has.
    """
    pairs = parallel_rows(R, NEGLIGIBLE)
    same = pairs.equal(weights, NEGLIGIBLE * np.abs(weights).max(axis=1))
    kept, equations = np.ones(len(R), dtype=bool), equations.copy()
    for i, j, sign in zip(*(x[same].tolist() for x in pairs), strict=True):
        if kept[i] and kept[j]:
            equations[i] |= sign < 0 or equations[j]
            kept[j] = False
    return np.flatnonzero(kept), equations[kept]


# ---- which of them hold just after a time ---------------------------------------------------

ZERO = 256 * EPS  # of the terms: a coefficient that is smaller is rounding of their sums


class Face(NamedTuple):
    """The rows that hold after a time.

    Attributes
    ----------
    active : list of int
        Independent rows that hold with equality, those that always do first.
    orders : ndarray of int, shape (m,)
        How many leading coefficients of a row's multiplier, or of its slack, are zero; 0 for rows
        that are undecided.
    undecided : ndarray of bool, shape (m,)
        Rows whose slack is zero, or hidden by rounding; they are not active.
    """

    active: list[int]
    orders: Array
    undecided: Array


def face_after(
    rows: Rows, phi: ExponentialSum, t: float, u: Array, before: set[int], stalled: bool
) -> Face:
    """The face just after t.

    Parameters
    ----------
    phi : ExponentialSum
        The histories of the rows from t on.
    before : set of int
        The rows that are active up to t. While they are undecided, their rounding counts in that
        of the velocity.
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
    for k, (d, size) in zip(range(9), _taylor(rows, phi, t), strict=False):
        s = d - NB @ u
        noise = ZERO * (size + np.abs(NB) @ np.abs(u)) + rounding
        basis = _basis(rows, active, undecided, s, noise)
        if basis is None and first is not None:  # a redundant row becomes violated
            undecided[active] = ~rows.equations[active]
            sizes = np.abs(first).max(), np.abs(s).max()
            # which of several rows through a corner hold soon after t, in units of the process
            soon = first + 1e-6 * (sizes[0] / sizes[1] if sizes[0] else 1.0) * s
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
        slow = [row for row in before if undecided[row]]
        of_y = noise[basis]
        if stalled:
            of_y = np.abs(np.linalg.inv(rows.S[np.ix_(basis, basis)])) @ of_y
        worst = float(max(of_y.max(initial=0.0), noise[slow].max(initial=0.0)))
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
        rounding = worst * rows.Lam / (k + 1) if slow or u.any() else 0.0
    return Face(active, orders, undecided)


def _taylor(rows: Rows, phi: ExponentialSum, t: float) -> Iterator[tuple[Array, Array]]:
    """d_0, d_1, ... and the size of the terms that each is a sum of, with the rounding of t."""
    for k, ((value, size), (_, next_size)) in enumerate(pairwise(phi.taylor()), start=1):
        yield rows.weights @ value, np.abs(rows.weights) @ (size + abs(t) * k * next_size)


def _basis(
    rows: Rows, active: list[int], undecided: Array, s: Array, noise: Array
) -> list[int] | None:
    """The active rows, and the undecided ones that hold at the x of least norm with R x = s on
    the active and R x <= s on the undecided rows; None if there is no x.
    """
    held = np.isin(np.arange(len(s)), active)
    try:
        rounding = noise + noise[active].max(initial=0.0)
        shortest = shortest_on(held, undecided, rows.R, s, rounding)
    except EmptySetError:
        return None
    if shortest is None:
        raise SweepoptError("rounding hides which rows are active")
    return active + shortest.active[undecided[shortest.active]].tolist()
