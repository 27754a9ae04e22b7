"""A semismooth Newton method for small programs: exact to rounding, warm started.

-z in N_C(M z + q) is the equation  w = P_C(w - T z),  w = M z + q, for weights T > 0. With D a
generalised derivative of P_C the Newton step solves  (M - D (M - T)) dz = P_C(v) - w. For a box it
is the primal-dual active-set method: stuck entries get z = 0 at once, slipping ones solve a linear
system (Hintermueller, Ito, Kunisch, SIAM J. Optim. 13(3), 2002). There an entry does not reverse
within one step: it stops first, or a warm start would have whole contact zones flip to and fro. The
method may still cycle far from the solution: then each step is halved until the residual of the
equation falls. Where that ends, another solver takes over.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg

from sweepopt.checks import count
from sweepopt.linalg import EPS, NEGLIGIBLE, Factor, dense, euclidean
from sweepopt.sets import ConvexSet, Polyhedron, shape_of
from sweepopt.velocity.program import VelocityProgram
from sweepopt.velocity.solvers.contract import Answer, Small, Solve

PATIENCE = 5  # steps that may fail to improve on the best one: more are a cycle
SHORTEST = 1e-5  # share of a step: discs across cells of stiffness 1 and 1e8 miss tol at 1e-3


@dataclass(frozen=True)
class Newton(Small):
    """Semismooth Newton for sets whose projection has a derivative.

    Parameters
    ----------
    max_dim : int
        Larger programs are left to the other solvers; a step solves a dense system.
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
        """Whether C is small and the derivative of its projection is known.

        Rows are left to the active sets, which end after finitely many of them.
        """
        if C.dim > self.max_dim:
            return False
        D = C.derivative(C.anchor)
        return D is not None and (D.ndim == 1 or not isinstance(shape_of(C), Polyhedron))

    def compile(self, program: VelocityProgram) -> Solve:
        """A function that starts from the velocity it found last, or from one it is given."""
        return _Iteration(program.M, self.max_iter)


class _Iteration:
    """Newton steps for one M; the last velocity and the last factorised block are kept.

    Contact states change rarely from step to step, and with them the block: that of M for the
    slipping entries, or that of M^-1 for the stuck ones where these are fewer. Where M is
    ill-conditioned M z + q is computed more sharply: at condition 1e12, all in contact, plain
    products cost a digit of the certificate.
    """

    def __init__(self, M: Factor, max_iter: int) -> None:
        self._factor, self.M, self._max_iter = M, dense(M.M), max_iter
        self._z = np.zeros(M.dim)
        self._stuck = b""
        self._block: Any = None

    def __call__(self, q: np.ndarray, C: ConvexSet, start: np.ndarray | None = None) -> Answer:
        self._z, iterations = self._z if start is None else start, 0
        for damped in (False, True):
            self._z, converged, steps = self._iterated(q, C, self._z, damped)
            iterations += steps
            if converged:
                break
        return Answer(self._z, iterations=iterations, status="iterated")

    def _iterated(
        self, q: np.ndarray, C: ConvexSet, z: np.ndarray, damped: bool
    ) -> tuple[np.ndarray, bool, int]:
        """Newton steps from z: the last z, whether it is exact to rounding, and their number."""
        T = C.weights(self._factor.diagonal)
        scale = 1 / np.sqrt(T)
        smallest, stalled, iteration, enough = math.inf, 0, 0, 1e3 * NEGLIGIBLE
        start, change, share = z, np.zeros_like(z), 1.0
        while iteration < self._max_iter:
            w, size_z = self._factor.apply(z, q, enough)
            v = w - T * z
            residual = C.project(v) - w
            size, forces = euclidean(residual * scale), euclidean(w * scale) + size_z
            if enough > NEGLIGIBLE and not size > 1e3 * enough * forces:
                enough = NEGLIGIBLE  # what the residual is far above needs no such digits
                continue
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
            smallest = min(smallest, size)
            D = C.derivative(v)
            if D is None:
                break
            try:
                if D.ndim == 1:
                    following = self._separable(D == 1, z, residual)
                else:
                    following = z + self._coupled(T, D, z, residual)
            except np.linalg.LinAlgError:
                break
            if not math.isfinite(following @ following):
                break
            start, change, share = z, following - z, 1.0
            z, iteration = following, iteration + 1
        return z, False, iteration

    def _separable(self, stuck: np.ndarray, z: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """Stuck entries get 0, slipping ones solve M dz = residual; nothing reverses."""
        inverted = 2 * stuck.sum() < stuck.size
        kept = np.flatnonzero(stuck if inverted else ~stuck)
        if stuck.tobytes() != self._stuck:
            matrix = self._factor.inverse if inverted else self.M
            block = matrix[np.ix_(kept, kept)]
            self._block = kept.size and scipy.linalg.cho_factor(block, check_finite=False)
            self._stuck = stuck.tobytes()
        change = np.where(stuck, -z, 0.0)
        if inverted:
            # the few stuck entries: the forces on them that hold them, in the inverse
            force = np.where(stuck, 0.0, residual)
            if kept.size:
                inner = change[kept] - self._factor.inverse[kept] @ force
                force[kept] = scipy.linalg.cho_solve(self._block, inner, check_finite=False)
            change = self._factor.inverse @ force
        elif kept.size:
            right = (residual - self.M @ change if change.any() else residual)[kept]
            change[kept] = scipy.linalg.cho_solve(self._block, right, check_finite=False)
        following = np.where(stuck, 0.0, z + change)
        return np.where(following * z < 0, 0.0, following)

    def _coupled(
        self, T: np.ndarray, D: np.ndarray, z: np.ndarray, residual: np.ndarray
    ) -> np.ndarray:
        """Solve (M - D (M - T)) dz = residual, with the rows where D is the identity taken out."""
        stuck = (D.diagonal() == 1) & (np.abs(D).sum(axis=1) == 1)
        dz = np.where(stuck, -z, 0.0)
        free = ~stuck
        if not free.any():
            return dz
        rows = self.M[free]
        rows = rows - D[free] @ self.M + D[free] * T
        right = residual[free] - rows[:, stuck] @ dz[stuck]
        # in units of T: pivots are chosen by size
        units = np.sqrt(T[free])
        dz[free] = np.linalg.solve(rows[:, free] / np.outer(units, units), right / units) / units
        return dz
