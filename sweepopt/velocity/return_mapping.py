"""Return mapping: internal variables at very many points, condensed point by point.

With v the velocity of all other unknowns and p that of those the set acts on, M and q - c are

    M = [[K, -G^T], [-G, W]],    q - c = (f, g),    W a multiple of 1 on each ball of S.

Given v, -p in N_S(W p + r) with r = g - G v has the closed form p = (P_S(r) - r) / W, the return
mapping, exactly 0 at a point that does not yield. What is left for v is the convex reduced energy

    1/2 <K v, v> + <f, v> - 1/2 |r - P_S(r)|^2_{W^-1},

whose gradient is R = K v - G^T p + f. Newton's method has the consistent tangent
K - G^T W^-1 (I - DP_S(r)) G, at least the Schur complement S_u = K - G^T W^-1 G > 0 (Simo and
Hughes, Computational Inelasticity, 1998, chapter 3). The pair (P_S(r), p) is exactly normal, so
that the certificate of (v, p) is |R| in S_u^-1, which is that of (R, 0) in M^-1. All matrices are
sparse.

Isotropic hardening has an unknown alpha a point with alpha' >= |p'|, and equality in every
solution: a share of its stiffness may go to p, x (|p'|^2 - alpha'^2) / 2 being 0 there. M then is a
multiple of 1 on (p, alpha), in whose units the cone is a circular one, and it is positive definite
without kinematic hardening too (`ConvexSet.exchange`).
"""

import math
from typing import Any

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Array, Matrix
from sweepopt.linalg import Factor
from sweepopt.sets import ROUNDING, Balls, ConvexSet, shape_of
from sweepopt.velocity.certificate import Proposal
from sweepopt.velocity.energies import Energy, Local, State


def condensable(M: Matrix, unknowns: Array, S: ConvexSet) -> bool:
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

    def __init__(self, M: Factor, unknowns: Array, S: ConvexSet, tol: float) -> None:
        self._M, self._few, self._tol = M, unknowns, tol
        self._rest = np.setdiff1d(np.arange(M.dim), unknowns)
        rows = sp.csr_array(M.M)[self._rest]
        K, up = (sp.csr_array(rows[:, to]) for to in (self._rest, unknowns))
        self._weights, G = S.weights(M.diagonal[unknowns]), sp.csr_array(up.T)
        groups = [Local.of(G[at.ravel()], at.shape[1]) for at, _ in S.blocks(S.anchor) or ()]
        self._energy = Energy(K, G, groups)
        self._v, self._size = np.zeros(self._rest.size), 0.0

    def propose(self, S: ConvexSet, residual: Array, z: Array | None) -> Proposal:
        """The pair for the linear term residual - M z, from the base z.

        Newton's method moves v - v(z): what is summed of M z + q is in the residual, rounded once.
        """
        W, few, rest = self._weights, self._few, self._rest
        base, start = (0 * residual, self._v) if z is None else (z, 0 * self._v)
        # of the tolerance, as the certificate adds rounding (with 0.5 a ring takes 41 steps instead
        # of 33); a base missed it by rounding: further
        share = 0.9 if z is None else 0.05
        f, p_base = residual[rest], base[few]
        r_base = residual[few] - W * p_base

        def mapped(r: Array) -> Array:
            return (0.0 - S.normal(r)) / W

        def law(x: Array) -> tuple[Array, Any]:
            return mapped(r_base + x) - p_base, lambda: self._softening(S, r_base + x)

        def converged(state: State) -> bool:
            if z is None:  # |z|_M
                square = state.w.dot(state.R - f) + state.s.dot(state.x + W * state.s)
                self._size = math.sqrt(max(square, 0.0))
            rho = 0 * residual
            rho[rest] = state.R
            return self._M.is_within(rho, share * self._tol * self._size)

        state, iterations = self._energy.minimise(f, start, law, converged)
        r, z, w = r_base + state.x, base.copy(), 0 * residual
        z[rest] += state.w
        z[few], w[few] = mapped(r), S.project(r)
        self._v = z[rest]
        return Proposal(z, w, iterations=iterations)

    def _softening(self, S: ConvexSet, r: Array) -> list[Array]:
        """-W^-1 (I - DP_S(r)) at each point: by how much K is softer where it yields."""
        return [
            np.moveaxis((D - np.eye(D.shape[1])) / self._weights[at[:, :1], None], 0, 2)
            for at, D in S.blocks(r) or ()
        ]
