"""A semismooth Newton method for small programs: exact to rounding, warm started.

-z in N_C(M z + q) is the equation  w = P_C(w - T z),  w = M z + q, for weights T > 0. With D a
generalised derivative of P_C the Newton step solves  (M - D (M - T)) dz = P_C(v) - w. For a box it
is the primal-dual active-set method: stuck entries get z = 0 at once, slipping ones solve a linear
system (Hintermueller, Ito, Kunisch, SIAM J. Optim. 13(3), 2002). There an entry does not reverse
within one step: it stops first, or a warm start would have whole contact zones flip to and fro. The
method may still cycle far from the solution: then it stops early and another solver takes over.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import lapack  # the plain calls: no checks in the loop

from sweepopt.checks import count
from sweepopt.linalg import EPS, NEGLIGIBLE, Factor, dense, euclidean
from sweepopt.sets import ConvexSet, Polyhedron, binary, shape_of
from sweepopt.velocity.program import VelocityProgram
from sweepopt.velocity.solvers.contract import Answer, Small, Solve

FEW_SLIPPING = 40  # up to so many slipping entries an inverse is not worth it
PATIENCE = 5  # steps that may fail to improve on the best one: more are a cycle


@dataclass(frozen=True)
class Newton(Small):
    """Semismooth Newton for sets whose projection has a derivative.

    Parameters
    ----------
    max_dim : int
        Larger programs are left to the other solvers; a step solves a dense system.
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
        self._factor, self.M, self._diagonal = M, dense(M.M), M.diagonal
        self._max_iter, self._z = max_iter, np.zeros(M.dim)
        self._take(self._diagonal)
        self._stuck = b""
        self._kept = np.zeros(0, dtype=int)
        self._block, self._inverted = self.M, False

    def __call__(self, q: np.ndarray, C: ConvexSet, start: np.ndarray | None = None) -> Answer:
        self._z, iterations = self._iterated(q, C, self._z if start is None else start)
        return Answer(self._z, np.zeros(C.offsets.size), iterations, "iterated")

    def _iterated(self, q: np.ndarray, C: ConvexSet, z: np.ndarray) -> tuple[np.ndarray, int]:
        """Newton steps from z until nothing changes; returns the last z and their number."""
        T = C.weights(self._diagonal)
        if T is not self._T:
            self._take(T)
        scale = self._scale
        smallest, stalled = math.inf, 0
        for iteration in range(self._max_iter):
            pulled = T * z
            if self._factor.is_sharp:
                w, size_z = self.M @ z + q, euclidean(pulled * scale)
            else:
                w, size_z = self._factor.apply(z, q, NEGLIGIBLE)
                size_z *= self._unit
            v = w - pulled
            residual = C.project(v) - w
            size = euclidean(residual * scale)
            rounding = EPS * (euclidean(w * scale) + size_z)
            # at rounding the equation cannot get better: stop when it does not, or when it cycles
            stalled += size >= smallest
            if size <= rounding or (size <= 1e3 * rounding and stalled) or stalled == PATIENCE:
                return z, iteration
            smallest = min(smallest, size)
            D = C.derivative(v)
            if D is None:
                return z, iteration
            try:
                if D.ndim == 1:
                    following = self._separable(D == 1, z, residual)
                else:
                    following = z + self._coupled(T, D, z, residual)
            except np.linalg.LinAlgError:
                return z, iteration
            if not math.isfinite(following @ following):
                return z, iteration
            z = following
        return z, self._max_iter

    def _take(self, T: np.ndarray) -> None:
        """Roots of T in its own units: the same numbers whatever power of two the units are."""
        unit = binary(T.max())
        self._T, self._roots, self._unit = T, np.sqrt(T / unit), math.sqrt(unit)
        self._scale = 1 / self._roots

    def _separable(self, stuck: np.ndarray, z: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """Stuck entries get 0, slipping ones solve M dz = residual; nothing reverses."""
        if stuck.tobytes() != self._stuck:
            self._stuck = b""
            free = np.flatnonzero(~stuck)
            self._inverted = free.size > max(stuck.size // 2, FEW_SLIPPING)
            self._kept = np.flatnonzero(stuck) if self._inverted else free
            matrix = self._inverse if self._inverted else self.M
            block = matrix[self._kept][:, self._kept]
            self._block, info = lapack.dpotrf(block, lower=True)
            if info:
                raise np.linalg.LinAlgError("the block is not positive definite to rounding")
            self._stuck = stuck.tobytes()
        following = np.where(stuck, 0.0, z)
        change, kept = following - z, self._kept
        if self._inverted:
            # the few stuck entries: the forces on them that hold them, in the inverse
            force = np.where(stuck, 0.0, residual)
            if kept.size:
                inner = change[kept] - self._inverse[kept] @ force
                force[kept] = lapack.dpotrs(self._block, inner, lower=True)[0]
            following = np.where(stuck, 0.0, z + self._inverse @ force)
        elif kept.size:
            right = residual - self.M @ change if change.any() else residual
            following[kept] += lapack.dpotrs(self._block, right[kept], lower=True)[0]
        return np.where(following * z < 0, 0.0, following)

    @cached_property
    def _inverse(self) -> np.ndarray:
        factor, info = lapack.dpotrf(self.M, lower=True)
        if info:
            raise np.linalg.LinAlgError("M is not positive definite to rounding")
        lower = lapack.dpotri(factor, lower=True)[0]
        return np.tril(lower) + np.tril(lower, -1).T

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
        units = self._roots[free]
        dz[free] = np.linalg.solve(rows[:, free] / np.outer(units, units), right / units) / units
        return dz
