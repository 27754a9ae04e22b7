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
    """(v, p) = z with p the return mapping of v: r, the gradient R, the energy, |z|_M squared."""

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
        self._v = np.zeros(self._rest.size)

    def propose(self, S: ConvexSet, residual: np.ndarray, z: np.ndarray | None) -> Proposal:
        """The pair for the linear term residual - M z."""
        q = residual if z is None else self._M.precisely(-z, residual)
        state, iterations = self._newton(S, q)
        self._v, w = state.z[self._rest], np.zeros(q.size)
        w[self._few] = S.project(state.r)
        return Proposal(state.z, w, iterations=iterations)

    def _state(self, S: ConvexSet, q: np.ndarray, v: np.ndarray) -> State:
        """The return mapping for v."""
        f, z = q[self._rest], np.empty(q.size)
        r, force = q[self._few] - self._G @ v, self._K @ v
        outside = S.normal(r)
        p = 0.0 - outside / self._weights
        z[self._rest], z[self._few] = v, p
        terms = 0.5 * v.dot(force), f.dot(v), 0.5 * p.dot(outside)
        # the rounding of sums of n terms
        rounding, of_p = EPS * q.size * sum(map(abs, terms)), self._up @ p
        square = v.dot(force) + 2 * v.dot(of_p) - p.dot(outside)
        return State(z, r, force + of_p + f, sum(terms), rounding, square)

    def _newton(self, S: ConvexSet, q: np.ndarray) -> tuple[State, int]:
        """From the velocity found last: the state in which R is small, and the number of steps."""

        def converged(state: State) -> bool:
            rho = np.zeros(q.size)
            rho[self._rest] = state.R
            return self._M.is_within(rho, 0.5 * self._tol * math.sqrt(max(state.square, 0.0)))

        def step(state: State) -> Step[State]:
            change = -self._tangent.solve(self._softening(S, state.r), state.R)
            v = state.z[self._rest]
            return change, lambda share: self._state(S, q, v + share * change)

        return newton(self._state(S, q, self._v), step, converged, MOST)

    def _softening(self, S: ConvexSet, r: np.ndarray) -> list[np.ndarray]:
        """-W^-1 (I - DP_S(r)) at each point: by how much K is softer where it yields."""
        return [
            np.moveaxis((D - np.eye(D.shape[1])) / self._weights[at][:, :, None], 0, 2)
            for at, D in S.blocks(r) or ()
        ]
