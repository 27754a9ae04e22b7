"""A semismooth Newton method: exact to rounding, warm started.

-z in N_C(M z + q) is the equation  w = P_C(w - T z),  w = M z + q, for weights T > 0. With D a
generalised derivative of P_C the Newton step solves  (M - D (M - T)) dz = P_C(v) - w. For a box it
is the primal-dual active-set method: stuck entries get z = 0 at once, slipping ones solve a linear
system (Hintermueller, Ito, Kunisch, SIAM J. Optim. 13(3), 2002). There an entry does not reverse
within one step: it stops first, or a warm start would have whole contact zones flip to and fro. The
method may still cycle far from the solution: then each step is halved until the residual of the
equation falls. Where that ends, another solver takes over. Where M is sparse and D has small
blocks, so is the system.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from sweepopt.checks import Matrix, count
from sweepopt.linalg import EPS, NEGLIGIBLE, Factor, dense, euclidean
from sweepopt.sets import Blocks, ConvexSet, InMetric, Lifted, Polyhedron, Start, shape_of
from sweepopt.velocity.program import VelocityProgram
from sweepopt.velocity.solvers.contract import Answer, Small, Solve

PATIENCE = 5  # steps that may fail to improve on the best one: more are a cycle
# of the residual, left by a step with the tangent of another point: such steps cost a sixth of one
# with a new tangent, and where its residual falls so far the tangent is as near
KEPT = 1e-3
SHORTEST = 1e-5  # share of a step: discs across cells of stiffness 1 and 1e8 miss tol at 1e-3

STEEPEST = 1e8  # of (I - D)^-1: a symmetric system loses as many digits

SolveLinear = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Newton(Small):
    """Semismooth Newton for sets whose projection has a derivative.

    Parameters
    ----------
    max_dim : int
        Sets whose projection couples more unknowns than this are left to the other solvers.
    max_iter : int
        Of whole steps, and again of halved ones.

    Raises
    ------
    InputError
        If max_dim or max_iter is not positive.

    Examples
    --------
    >>> from sweepopt.sets import Ball, HalfSpace
    >>> Newton().treats(Ball([0.0, 0.0], 1.0)), Newton().treats(HalfSpace([1.0, 1.0], 0.0))
    (True, False)
    """

    max_dim: int = 1500
    max_iter: int = 15
    name = "newton"

    def __post_init__(self) -> None:
        super().__post_init__()
        count("max_iter", self.max_iter)

    def treats(self, C: ConvexSet) -> bool:
        """Whether the derivative of C's projection is known and couples few unknowns.

        Rows are left to the active sets, which end after finitely many of them.
        """
        if C.block > self.max_dim or isinstance(shape_of(C), Polyhedron):
            return False
        return C.differentiable

    def compile(self, program: VelocityProgram) -> Solve:
        """A function that starts from the velocity it found last, or from one it is given."""
        return _Iteration(program.M, self.max_iter)


class _Iteration:
    """Newton steps for one M; the last velocity and the last tangent are kept.

    Contact states of a box change rarely from step to step, and with them its tangent. Where M is
    ill-conditioned M z + q is computed more sharply: at condition 1e12, all in contact, plain
    products cost a digit of the certificate.
    """

    def __init__(self, M: Factor, max_iter: int) -> None:
        self._M, self._max_iter = M, max_iter
        self._z = np.zeros(M.dim)
        self._last: tuple[bytes, Any] = b"", None
        self._metric: tuple[ConvexSet | None, Any] = None, None
        self._start: Start | None = None

    def __call__(self, q: np.ndarray, C: ConvexSet, start: np.ndarray | None = None) -> Answer:
        self._z, iterations = self._z if start is None else start, 0
        near = not C.exact and C.block == C.dim and start is None
        if near:
            self._z = self._nearest(q, C)
        for damped in (False, True):
            self._z, converged, steps = self._iterated(q, C, self._z, damped, near)
            iterations += steps
            if converged:
                break
        return Answer(self._z, iterations=iterations, status="iterated")

    def _nearest(self, q: np.ndarray, C: ConvexSet) -> np.ndarray:
        """About z, for a C whose own projection iterates: from one in the metric of M^-1."""
        if self._metric[0] is not C:
            self._metric = C, InMetric(C, dense(self._M.M))
        z, self._start = self._metric[1](q, self._start)
        if isinstance(C, Lifted):
            w, _ = self._M.apply(z, q, NEGLIGIBLE)
            T = C.weights(self._M.diagonal)
            C.start_at(w - T * z, Start(self._start.s, T[0] * self._start.n))
        return z

    def _iterated(
        self, q: np.ndarray, C: ConvexSet, z: np.ndarray, damped: bool, stalled: int
    ) -> tuple[np.ndarray, bool, int]:
        """Newton steps from z: the last z, whether it is exact to rounding, and their number."""
        T = C.weights(self._M.diagonal)
        scale = 1 / np.sqrt(T)
        smallest, iteration = math.inf, 0
        start, change, share = z, np.zeros_like(z), 1.0
        while iteration < self._max_iter:
            w, size_z = self._M.apply(z, q, NEGLIGIBLE)
            v = w - T * z
            residual = C.project(v) - w
            size, forces = euclidean(residual * scale), euclidean(w * scale) + size_z
            rounding = EPS * forces
            # at rounding the equation cannot get better: stop when it does not, or when it cycles
            stalled += size >= smallest
            if size <= rounding or (size <= 1e3 * rounding and stalled):
                return z, True, iteration
            if damped and size >= smallest and share > SHORTEST:
                share /= 2
                z = start + share * change
                continue
            if stalled == PATIENCE and not damped:
                break
            kept = not iteration or size < KEPT * smallest
            smallest = min(smallest, size)
            D = C.blocks(v)
            if D is None:
                break
            try:
                following = self._following(D, T, z, residual, kept)
            except (scipy.linalg.LinAlgError, RuntimeError):  # singular
                break
            if not math.isfinite(following @ following):
                break
            start, change, share = z, following - z, 1.0
            z, iteration = following, iteration + 1
        return z, False, iteration

    def _following(
        self, D: list[Blocks], T: np.ndarray, z: np.ndarray, residual: np.ndarray, kept: bool
    ) -> np.ndarray:
        """z + dz, with the last tangent if it may be kept; entries of a box do not reverse."""
        key = b"".join(block.tobytes() for _, block in D)
        if key != self._last[0] and not (kept and self._last[0]):
            self._last = key, self._tangent(D, T)
        stuck, solve = self._last[1]
        following = np.where(stuck, 0.0, z)
        following[~stuck] += solve(residual[~stuck], z[stuck])
        if all(block.shape[1] == 1 for _, block in D):
            following[following * z < 0] = 0.0
        return following

    def _tangent(self, D: list[Blocks], T: np.ndarray) -> tuple[np.ndarray, Any]:
        """What sticks, and (residual of the others, z of what sticks) -> dz of the others."""
        M = self._M.M
        if not sp.issparse(M):
            soft = self._symmetric(M, D, T)
            if soft is not None:
                return soft
        P = _matrix(D, M.shape[0])
        stuck = (P.diagonal() == 1) & (abs(P).sum(axis=1) == 1)
        free = ~stuck
        P = P[free]
        rows = M[free] - P @ M + P * T
        beside = rows[:, stuck]
        # in units of T: pivots are chosen by size
        units = 1 / np.sqrt(T[free])
        solve = _factorised(rows[:, free] * units * units[:, None]) if free.any() else np.copy
        return stuck, lambda right, z: units * solve(units * (right + beside @ z))

    def _symmetric(self, M: np.ndarray, D: list[Blocks], T: np.ndarray) -> Any:
        """The same of a dense M from M + T ((I - D)^-1 - I), whose factors cost half of others.

        None where a block, such as a projector, has an eigenvalue near 1 and does not stick, and
        where all stick.
        """
        free, inverses = np.zeros(len(M), dtype=bool), []
        for at, block in D:
            less = np.eye(block.shape[1]) - block
            moves = less.any(axis=(1, 2))
            try:
                inverse = np.linalg.inv(less[moves])
            except np.linalg.LinAlgError:
                return None
            if not (np.abs(inverse) < STEEPEST).all():
                return None
            free[at[moves]] = True
            inverses.append((at[moves], inverse))
        if not free.any():
            return None
        J, place = M[np.ix_(free, free)], np.cumsum(free) - 1
        for at, inverse in inverses:
            more = T[at][:, :, None] * (inverse - np.eye(inverse.shape[1]))
            J[place[at][:, :, None], place[at][:, None]] += more
        lower, failed = scipy.linalg.lapack.dpotrf(J.T, lower=1, overwrite_a=1)
        if failed:
            return None

        def solve(right: np.ndarray, z: np.ndarray) -> np.ndarray:
            scaled = M[np.ix_(free, ~free)] @ z if z.any() else np.zeros_like(right)
            for at, inverse in inverses:
                scaled[place[at]] += np.einsum("kij,kj->ki", inverse, right[place[at]])
            change: np.ndarray = scipy.linalg.lapack.dpotrs(lower, scaled, lower=1)[0]
            return change

        return ~free, solve


def _factorised(J: Matrix) -> SolveLinear:
    """b -> the solution of J x = b."""
    if sp.issparse(J):
        return spla.splu(sp.csc_array(J)).solve
    lu, pivots, singular = scipy.linalg.lapack.dgetrf(J)
    if singular:
        raise scipy.linalg.LinAlgError("a pivot is 0")
    return partial(scipy.linalg.lu_solve, (lu, pivots), check_finite=False)


def _matrix(D: list[Blocks], n: int) -> sp.csr_array:
    """The blocks in one matrix."""
    parts = [
        (block.ravel(), *(np.broadcast_to(index, block.shape).ravel() for index in indices))
        for at, block in D
        for indices in [(at[:, :, None], at[:, None])]
    ]
    entries, rows, columns = map(np.concatenate, zip(*parts, strict=True))
    return sp.csr_array((entries, (rows, columns)), (n, n))
