"""A semismooth Newton method: exact to rounding, warm started.

-z in N_C(M z + q) is the equation  w = P_C(w - T z),  w = M z + q, for weights T > 0. With D a
generalised derivative of P_C the Newton step solves  (M - D (M - T)) dz = P_C(v) - w. For a box it
is the primal-dual active-set method: stuck entries get z = 0 at once, slipping ones solve a linear
system (Hintermueller, Ito, Kunisch, SIAM J. Optim. 13(3), 2002). There an entry does not reverse
within one step: it stops first, or a warm start would have whole contact zones flip to and fro. The
method may still cycle far from the solution: another solver takes over then. Where M is sparse and
D has small blocks, so is the system.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from sweepopt.checks import Array, Matrix
from sweepopt.linalg import EPS, NEGLIGIBLE, dense, euclidean, factorised
from sweepopt.sets import Blocks, ConvexSet, InMetric, Polyhedron, shape_of
from sweepopt.velocity.energies import SAME_TANGENT
from sweepopt.velocity.program import Answer, Small, Solve, VelocityProgram


@dataclass(frozen=True)
class Newton(Small):
    """Semismooth Newton for sets whose projection has a derivative.

    Parameters
    ----------
    max_dim : int
        Sets whose projection couples more unknowns than this are left to the other solvers.
    max_iter : int

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

    def treats(self, C: ConvexSet) -> bool:
        """Whether the derivative of C's projection is known and couples few unknowns.

        Rows are left to the active sets, which end after finitely many of them.
        """
        if C.block > self.max_dim or isinstance(shape_of(C), Polyhedron):
            return False
        return C.differentiable

    def compile(self, program: VelocityProgram) -> Solve:
        """A function that starts from the velocity it found last, or from one it is given."""
        return _Iteration(program, self.max_iter)


class _Iteration:
    """Newton steps for one M; the last velocity and the last tangent are kept.

    Where they cycled the next ones start at rest: of 16 steps of the tread block, whose drag turns
    round, 8 were left to another solver, which takes 20 times as long.
    Contact states of a box change rarely from step to step, and with them its tangent. Where M is
    ill-conditioned M z + q is computed more sharply: at condition 1e12, all in contact, plain
    products cost a digit of the certificate.
    """

    def __init__(self, program: VelocityProgram, max_iter: int) -> None:
        self._M, self._max_iter = program.M, max_iter
        # of bounded sets dom sigma is the whole space, and nothing rounds -z out of it
        self._bounded = program.cone.is_bounded
        self._proved = program.proved or not self._bounded
        self._z = np.zeros(self._M.dim)
        self._key: bytes = b""
        self._step: Callable[[Array, Array], Array] = lambda z, residual: z
        self._metric: tuple[ConvexSet | None, Any] = None, None

    def __call__(self, q: Array, C: ConvexSet, start: Array | None = None) -> Answer:
        self._z = self._z if start is None else start
        near = not C.exact and C.block == C.dim and start is None
        return (self._nearest(q, C) if near else None) or self._iterate(q, C)

    def _nearest(self, q: Array, C: ConvexSet) -> Answer | None:
        """The pair of a C whose own projection iterates: from one in the metric of M^-1.

        None where it is not known to rounding: then there is a start.
        """
        if self._metric[0] is not C:
            self._metric = C, InMetric(C, dense(self._M.M))
        near = self._metric[1](q, self._proved and self._bounded)
        self._z = near.z
        known = near.perturbation < math.inf if self._proved else near.w is not None
        if known and self._bounded:
            bound = near.perturbation
            return Answer(near.z, status="iterated", w=near.w, normal=True, perturbation=bound)
        return None

    def _iterate(self, q: Array, C: ConvexSet) -> Answer:
        """Newton steps until z is exact to rounding.

        If nothing is to be proved, until the residual is negligible, with the point of C to which
        -z is normal.
        """
        z = self._z
        T = C.weights(self._M.diagonal)
        scale = 1 / np.sqrt(T)
        smallest, stalled = math.inf, 0
        for iteration in range(self._max_iter):
            w, size_z = self._M.apply(z, q, NEGLIGIBLE if self._proved else math.inf)
            v = w - T * z
            nearest = C.project(v)
            residual = nearest - w
            size, forces = euclidean(residual * scale), euclidean(w * scale) + size_z
            rounding = EPS * forces
            # at rounding no tangent is better: stop where that gets no better, or when it cycles
            close, stalled = size <= 1e3 * rounding, stalled + (size >= smallest)
            if not self._proved and size <= NEGLIGIBLE * forces:
                self._z = (nearest - v) / T
                return Answer(
                    self._z, status="iterated", iterations=iteration, w=nearest, normal=True
                )
            if size <= rounding or (close and (stalled or 2 * size >= smallest)):
                self._z = z
                return Answer(z, status="iterated", iterations=iteration, w=w)
            if not self._key or (iteration and not close and size >= SAME_TANGENT * smallest):
                D = C.blocks(v)
                if D is None or not self._turn(D, T):
                    break
            following = self._step(z, residual)
            if C.block == 1:
                following[following * z < 0] = 0.0
            if not math.isfinite(following @ following):
                break
            smallest, z = min(smallest, size), following
        self._z = np.zeros_like(z) if size > smallest else z
        return Answer(z, status="iterated", iterations=iteration)

    def _turn(self, D: list[Blocks], T: Array) -> bool:
        """Whether there is a tangent for the derivative D."""
        key = b"".join(block.tobytes() for _, block in D)
        if key != self._key:
            self._key = b""
            try:
                self._step = _tangent(self._M.M, D, T)
            except (scipy.linalg.LinAlgError, RuntimeError, ArithmeticError, ValueError):  # or nan
                return False
        self._key = key
        return True


def _tangent(M: Matrix, D: list[Blocks], T: Array) -> Callable[..., Array]:
    """(z, residual) -> z + dz, 0 where D says that it sticks.

    The matrix for the others is M + T ((I - D)^-1 - I), which is symmetric; an eigenvalue 1 of D,
    as projectors have it, counts as 1 - 1e-6. A step with it leaves 1e-6 of the residual; with 1e-8
    a hull in units from 1e-6 to 1e6 misses 1e-9.
    """
    free, inverses = np.zeros(len(T), dtype=bool), []
    for at, block in D:
        one = np.eye(block.shape[1])
        some = (block != one).any(axis=(1, 2))
        inverses.append((at[some], np.linalg.inv(one - (1 - 1e-6) * block[some])))
        free[at[some]] = True
    J, place = M[free][:, free], np.cumsum(free) - 1
    for at, inverse in inverses:
        rows, columns = place[at][:, :, None], place[at][:, None]
        entries = T[at][:, :, None] * (inverse - np.eye(at.shape[1]))
        if sp.issparse(J):
            places = [np.broadcast_to(x, entries.shape).ravel() for x in (rows, columns)]
            J = J + sp.csr_array((entries.ravel(), places), J.shape)
        else:
            J[rows, columns] += entries
    solve = factorised(J).solve if free.any() else np.copy

    def step(z: Array, residual: Array) -> Array:
        following = np.where(free, z, 0.0)
        stopped = z - following
        right = M @ stopped if stopped.any() else stopped
        for at, inverse in inverses:
            right[at] += np.einsum("kij,kj->ki", inverse, residual[at])
        following[free] += solve(right[free])
        return following

    return step
