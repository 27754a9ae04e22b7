"""One ball and any M: the velocity from the root of a scalar equation.

For C = { w : |w - c| <= r } a moving z has the force  w = M z + q = c - lam z,  lam = r / |z|. With
nu = 1 / lam this is  w - c = (I + nu M)^-1 (q - c),  whose length r determines nu: in the
eigenvectors of M, computed once, the secular equation of `sweepopt/secular.py`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sweepopt.linalg import EPS, dense
from sweepopt.sets import ROUNDING, ConvexSet, secular
from sweepopt.velocity.program import VelocityProgram
from sweepopt.velocity.solvers.base import Answer, Small, Solve


@dataclass(frozen=True)
class Secular(Small):
    """The formula for a set that is one ball.

    Parameters
    ----------
    max_dim : int
        Larger programs are left to the other solvers: M is kept with its eigenvectors.

    Raises
    ------
    InputError
        If max_dim is not positive.

    Examples
    --------
    >>> from sweepopt.sets import Ball, Balls
    >>> Secular().treats(Ball([0.0, 0.0], 1.0)), Secular().treats(Balls([1.0, 1.0], 2))
    (True, False)
    """

    name = "secular"

    def treats(self, C: ConvexSet) -> bool:
        """Whether C is small and one ball."""
        return C.dim <= self.max_dim and C.sphere is not None

    def compile(self, program: VelocityProgram) -> Solve:
        """Find the eigenvectors of M once; a call solves for one number."""
        M = dense(program.M.M)
        k, axes = np.linalg.eigh(M)
        # M was factorised: what is smaller is rounding
        k = np.maximum(k, EPS * k[-1])
        back = np.ascontiguousarray(axes.T)

        def solve(q: np.ndarray, C: ConvexSet) -> Answer:
            ball = C.sphere
            assert ball is not None
            force, radius = q - ball.center, ball.radius
            a = back @ force
            size = math.sqrt(a @ a)
            no_features = np.zeros(C.offsets.size)
            if size <= radius:
                return Answer(np.zeros_like(q), no_features, 0, "solved")
            if radius <= ROUNDING * size:
                z = axes @ (-a / k)  # refined by what the ball still does
            else:
                nu = secular(a, k, radius)
                z = axes @ (-nu * a / (1 + nu * k))
            return Answer(refined(force, radius, z), no_features, 1, "solved")

        def refined(force: np.ndarray, radius: float, z: np.ndarray) -> np.ndarray:
            """A Newton step on M z + q - c + r z / |z| = 0: from the data, not from k."""
            length = math.sqrt(z @ z)
            if length == 0:
                return z  # the load is above the threshold by less than rounding
            direction, lam = z / length, radius / length
            missed = back @ (M @ z + force + radius * direction)
            # (D + lam) - lam n n^T; 1 - lam n^T (D + lam)^-1 n without cancellation
            n, D = back @ direction, k + lam
            step, pulled = missed / D, n / D
            share = lam * float(n @ step) / float(pulled @ (n * k))
            return z - axes @ (step + share * pulled)

        return solve
