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

from collections.abc import Callable
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Matrix
from sweepopt.errors import IndefiniteError
from sweepopt.linalg import EPS, Factor, InBlocks
from sweepopt.sets import ROUNDING, Balls, ConvexSet, shape_of
from sweepopt.velocity.certificate import Proposal

MOST = 50  # Newton steps; a load step of a fully plastic body takes 5 to 10
SUFFICIENT = 1e-4  # of the decrease that the tangent promises (Armijo)
SHORTEST = 2.0**-20  # share of a step


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
    """(v, p) = z with p the return mapping of v: r, the gradient R, the energy and its rounding."""

    z: np.ndarray
    r: np.ndarray
    R: np.ndarray
    energy: float
    rounding: float


def line_search(
    at: Callable[[np.ndarray], Any], state: Any, x: np.ndarray, change: np.ndarray
) -> tuple[Any, float] | None:
    """The first of the shares 1, 1/2, 1/4, ... of a Newton step after which the energy is less.

    Where the energy only rounds, the derivative along the step decides (Hager and Zhang, SIAM J.
    Optim. 16(1), 2005). None where rounding hides that too.

    Parameters
    ----------
    at : callable
        x -> the state there, with its `energy`, its `rounding` and its gradient R.
    """
    slope, share = float(state.R.dot(change)), 1.0
    while share > SHORTEST:
        trial = at(x + share * change)
        hidden = -share * slope <= trial.rounding
        if trial.energy <= state.energy + SUFFICIENT * share * slope or (
            hidden and trial.R.dot(change) <= -0.5 * slope
        ):
            return trial, share
        share /= 2
    return None


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
        self._factorise = InBlocks()
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
        rounding = EPS * q.size * sum(map(abs, terms))
        return State(z, r, force + self._up @ p + f, sum(terms), rounding)

    def _newton(self, S: ConvexSet, q: np.ndarray) -> tuple[State, int]:
        """From the velocity found last: the state in which R is small, and the number of steps."""
        state, rho = self._state(S, q, self._v), np.zeros(q.size)
        iterations = 0
        while iterations < MOST:
            rho[self._rest] = state.R
            if self._M.dual_norm(rho) <= 0.5 * self._tol * self._M.norm(state.z):
                break
            try:
                change = -self._tangent(S, state.r).solve(state.R)
            except IndefiniteError:
                break
            found = line_search(partial(self._state, S, q), state, state.z[self._rest], change)
            if found is None:
                break
            state = found[0]
            iterations += 1
        return state, iterations

    def _tangent(self, S: ConvexSet, r: np.ndarray) -> Factor:
        """K - G^T W^-1 (I - DP_S(r)) G."""
        tangent = self._K
        for at, D in S.blocks(r) or ():
            size = D.shape[1]
            D = (np.eye(size) - D) / self._weights[at][:, :, None]
            yields = D.any(axis=(1, 2))
            if yields.any():
                rows = self._G[at[yields].ravel()]
                blocks = sp.bsr_array(
                    (D[yields], np.arange(yields.sum()), np.arange(yields.sum() + 1)),
                    shape=(len(rows.indptr) - 1,) * 2,
                )
                tangent = tangent - rows.T @ sp.csr_array(blocks @ rows)
        if tangent is self._K:
            return self._elastic
        return Factor(sp.csc_array(tangent), "the tangent", factorise=self._factorise)

    @cached_property
    def _elastic(self) -> Factor:
        """The tangent where no point yields."""
        return Factor(sp.csc_array(self._K), "the tangent")
