"""Return mapping: internal variables at very many points, condensed point by point.

With v the velocity of all other unknowns and p that of those the set acts on, M and q - c are

    M = [[K, -G^T], [-G, W]],    q - c = (f, g),    W a multiple of 1 on each ball of S.

Given v, -p in N_S(W p + r) with r = g - G v has the closed form p = (P_S(r) - r) / W, the return
mapping, exactly 0 at a point that does not yield. What is left for v is the convex reduced energy

    1/2 <K v, v> + <f, v> - 1/2 |r - P_S(r)|^2_{W^-1},

whose gradient is R = K v - G^T p + f. Newton's method has the consistent tangent
K - G^T W^-1 (I - DP_S(r)) G, at least the Schur complement S_u = K - G^T W^-1 G > 0, and halves
steps until the energy falls (Simo and Hughes, Computational Inelasticity, 1998, chapter 3). The
pair (P_S(r), p) is exactly normal, so that the certificate of (v, p) is |R| in S_u^-1, which is
that of (R, 0) in M^-1. All matrices are sparse.

Isotropic hardening has an unknown alpha a point with alpha' >= |p'|, and equality in every
solution: a share of its stiffness may go to p, x (|p'|^2 - alpha'^2) / 2 being 0 there. M then is a
multiple of 1 on (p, alpha), in whose units the cone is a circular one, and it is positive definite
without kinematic hardening too (`ConvexSet.exchange`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Matrix
from sweepopt.linalg import EPS, Factor
from sweepopt.sets import ROUNDING, Balls, ConvexSet, shape_of
from sweepopt.velocity.certificate import Proposal
from sweepopt.velocity.energies import Local, Step, Tangent, newton

MOST = 50  # Newton steps; a load step of a fully plastic body takes 5 to 10


def condensable(M: Matrix, unknowns: np.ndarray, S: ConvexSet) -> bool:
    """Whether M on these unknowns is diagonal, and the projection on S in its metric S's own."""
    block = sp.csr_array(sp.csr_array(M)[unknowns][:, unknowns])
    diagonal = np.asarray(block.diagonal())
    metric = diagonal + S.exchange(diagonal)
    return (
        S.exact
        and (S.block == 1 or S.block < S.dim or isinstance(shape_of(S), Balls))
        and block.count_nonzero() == np.count_nonzero(diagonal)
        and bool((np.abs(S.weights(metric) - metric) <= ROUNDING * metric).all())
    )


class State(NamedTuple):
    """v beside a base, and z = (v, p) with p the return mapping: r, the gradient R, the energy.

    `square` is |z|_M squared where the base is 0.
    """

    v: np.ndarray
    z: np.ndarray
    r: np.ndarray
    R: np.ndarray
    energy: float
    rounding: float
    square: float


class ReturnMapping:
    """(residual, z) -> the pair that Newton's method in v finds; to be used by `refined`.

    Parameters
    ----------
    M : Factor
        Sparse.
    unknowns : ndarray of int, shape (m,)
        Those of the set, on which M is diagonal.
    S : ConvexSet
        Any one of the family.
    tol : float
        Of the certificate.
    """

    def __init__(self, M: Factor, unknowns: np.ndarray, S: ConvexSet, tol: float) -> None:
        self._M, self._few, self._tol = M, unknowns, tol
        self._rest = np.setdiff1d(np.arange(M.dim), unknowns)
        rows = sp.csr_array(M.M)[self._rest]
        self._K, self._up = (sp.csr_array(rows[:, to]) for to in (self._rest, unknowns))
        self._G = sp.csr_array(-self._up.T)
        self._weights = S.weights(M.diagonal[unknowns])
        groups = [Local.of(self._G[at.ravel()], at.shape[1]) for at, _ in S.blocks(S.anchor) or ()]
        self._tangent = Tangent(self._K, groups)
        self._v, self._size = np.zeros(self._rest.size), 0.0

    def propose(self, S: ConvexSet, residual: np.ndarray, z: np.ndarray | None) -> Proposal:
        """The pair for the linear term residual - M z, from the base z.

        Newton's method moves v - v(z): what is summed of M z + q is in the residual, rounded once.
        """
        base, start = z, np.zeros_like(self._v)
        if base is None:
            base, start, self._size = np.zeros_like(residual), self._v, 0.0
        state, iterations = self._newton(S, residual, base, start)
        self._v, w = state.z[self._rest], np.zeros(residual.size)
        self._size = max(self._size, math.sqrt(max(state.square, 0.0)))
        w[self._few] = S.project(state.r)
        return Proposal(state.z, w, iterations=iterations)

    def _newton(
        self, S: ConvexSet, residual: np.ndarray, base: np.ndarray, start: np.ndarray
    ) -> tuple[State, int]:
        """The state in which R is small, from start = v - v(base), and the number of steps."""
        p_base, force = base[self._few], residual[self._rest]
        r_base, of_base = residual[self._few] - self._weights * p_base, self._up @ p_base

        def state_of(v: np.ndarray) -> State:
            """The return mapping for v(base) + v."""
            r, stiff, z = r_base - self._G @ v, self._K @ v, base.copy()
            outside = S.normal(r)
            p = 0.0 - outside / self._weights
            z[self._rest] += v
            z[self._few] = p
            terms = 0.5 * v.dot(stiff), (force - of_base).dot(v), 0.5 * p.dot(outside)
            # the rounding of sums of n terms
            rounding, of_p = EPS * z.size * sum(map(abs, terms)), self._up @ (p - p_base)
            square = v.dot(stiff) + 2 * v.dot(of_p) - p.dot(outside)
            return State(v, z, r, force + stiff + of_p, sum(terms), rounding, square)

        def converged(state: State) -> bool:
            rho = np.zeros(residual.size)
            rho[self._rest] = state.R
            size = max(self._size, math.sqrt(max(state.square, 0.0)))
            # from a base that missed the tolerance, whatever was lost to rounding: further
            return self._M.is_within(rho, (0.05 if base.any() else 0.5) * self._tol * size)

        def step(state: State) -> Step[State]:
            change = -self._tangent.solve(self._softening(S, state.r), state.R)
            return change, lambda share: state_of(state.v + share * change)

        return newton(state_of(start), step, converged, MOST)

    def _softening(self, S: ConvexSet, r: np.ndarray) -> list[np.ndarray]:
        """-W^-1 (I - DP_S(r)) at each point: by how much K is softer where it yields."""
        return [
            np.moveaxis((D - np.eye(D.shape[1])) / self._weights[at][:, :, None], 0, 2)
            for at, D in S.blocks(r) or ()
        ]
