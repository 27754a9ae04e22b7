"""A semismooth Newton method for small programs: exact to rounding, warm started.

-z in N_C(M z + q) is the equation  w = P_C(w - T z),  w = M z + q, for steps T > 0. With D a
generalised derivative of P_C the Newton step solves  (M - D (M - T)) dz = P_C(v) - w. For a box it
is the primal-dual active-set method: stuck entries get z = 0 at once, slipping ones solve a linear
system (Hintermueller, Ito, Kunisch, SIAM J. Optim. 13(3), 2002). It may cycle far from the
solution: then the certificate says so and another solver takes over.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack  # the plain calls: no checks in the loop

from sweepopt.checks import count
from sweepopt.linalg import dense
from sweepopt.program import VelocityProgram
from sweepopt.sets import ConvexSet
from sweepopt.solvers.base import Answer, Solve, Solver


@dataclass(frozen=True)
class Newton:
    """Semismooth Newton for sets whose projection has a derivative.

    Parameters
    ----------
    max_iter : int
    max_dim : int
        Larger programs are left to the other solvers; a step solves a dense system.

    Raises
    ------
    InputError
        If max_iter or max_dim is not positive.

    Examples
    --------
    >>> from sweepopt.sets import Ball, Polytope
    >>> Newton().treats(Ball([0.0, 0.0], 1.0)), Newton().treats(Polytope([[0.0], [1.0]]))
    (True, False)
    """

    max_iter: int = 15
    max_dim: int = 1500
    name = "newton"

    def __post_init__(self) -> None:
        count("max_iter", self.max_iter)
        count("max_dim", self.max_dim)

    def treats(self, C: ConvexSet) -> bool:
        """Whether C is small and the derivative of its projection is known."""
        return C.dim <= self.max_dim and C.derivative(C.anchor) is not None

    def refined(self) -> Solver | None:
        """None: it goes to rounding."""
        return None

    def compile(self, program: VelocityProgram) -> Solve:
        """A function that starts from the velocity it found last."""
        M = dense(program.M.M)
        z = np.zeros(program.M.dim)

        def solve(q: np.ndarray, C: ConvexSet) -> Answer:
            nonlocal z
            z, iterations = newton(M, q, C, z, self.max_iter)
            return Answer(z, np.zeros(C.offsets.size), iterations, "iterated")

        return solve


def newton(
    M: np.ndarray, q: np.ndarray, C: ConvexSet, z: np.ndarray, max_iter: int
) -> tuple[np.ndarray, int]:
    """Newton steps from z until nothing changes; returns the last z and their number."""
    T = C.steps(M.diagonal())
    smallest = np.inf
    for iteration in range(max_iter):
        w = M @ z + q
        v = w - T * z
        missed = C.project(v) - w
        size = float(np.linalg.norm(missed / np.sqrt(T)))
        rounding = np.finfo(float).eps * float(
            np.linalg.norm((np.abs(w) + T * np.abs(z)) / np.sqrt(T))
        )
        # at rounding the equation cannot get better: stop when it does not
        if size <= rounding or (size <= 1e3 * rounding and size >= smallest):
            return z, iteration
        smallest = min(smallest, size)
        D = C.derivative(v)
        assert D is not None
        try:
            following = z + _step(M, T, D, z, missed)
        except np.linalg.LinAlgError:
            return z, iteration
        if not np.isfinite(following).all():
            return z, iteration
        z = following
    return z, max_iter


def _step(
    M: np.ndarray, T: np.ndarray, D: np.ndarray, z: np.ndarray, missed: np.ndarray
) -> np.ndarray:
    """Solve (M - D (M - T)) dz = missed, with the rows where D is the identity taken out."""
    if D.ndim == 1:
        stuck = D == 1
    else:
        stuck = (D.diagonal() == 1) & (np.abs(D).sum(axis=1) == 1)
    dz = np.where(stuck, -z, 0.0)
    free = ~stuck
    if not free.any():
        return dz
    rows = M[free]
    if D.ndim == 2:
        rows = rows - D[free] @ M + D[free] * T
    matrix, right = rows[:, free], missed[free] - rows[:, stuck] @ dz[stuck]
    if D.ndim == 1:
        # slipping entries of a separable set: a principal block of M
        _, dz[free], info = lapack.dposv(matrix, right)
        if info:
            raise np.linalg.LinAlgError("the block is not positive definite to rounding")
    else:
        dz[free] = np.linalg.solve(matrix, right)
    return dz
