"""Newton's method for a convex energy whose second derivative is a sparse matrix and small blocks.

    K + sum_k L_k^T D_k L_k,    D_k made of derivatives of projections, on few unknowns each,

has one pattern whatever the D_k are, which is analysed once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Array, Matrix
from sweepopt.linalg import InBlocks, euclidean

# of the residual, left by a step of Newton's method after which the tangent is kept: such steps
# cost a fifth of others; of 1e-4 to 0.2 this takes the least time on problems/tread.toml, and of
# 0 to 0.1 on a ring with plastic strains
SAME_TANGENT = 1e-2
SHARES = 0.5 ** np.arange(20)  # of a step


class State(NamedTuple):
    """w, x = E w, the force s at x, the gradient R, and the derivative of s, to be asked once."""

    w: Array
    x: Array
    s: Array
    R: Array
    derivative: Callable[[], Sequence[Array]]


Law = Callable[[Array], tuple[Array, Callable[[], Sequence[Array]]]]
"""From x to s, a gradient, and its symmetric derivative, shape (b, b, m) in each group."""


class Local(NamedTuple):
    """Blocks of b rows of a sparse matrix with n unknowns each at most.

    Attributes
    ----------
    unknowns : ndarray of int, shape (m, n)
        Those of a block, in order; what is missing is repeated.
    entries : ndarray, shape (m, b, n)
        0 where an unknown is repeated.
    counts : ndarray of int, shape (m,)
        How many unknowns a block has.
    """

    unknowns: Array
    entries: Array
    counts: Array

    @classmethod
    def of(cls, E: sp.csr_array, b: int) -> Local:
        """Those of a matrix without zeros: rows 0 to b - 1, the next b, and so on."""
        m, dim = E.shape[0] // b, E.shape[1]
        row = np.repeat(np.arange(m * b), np.diff(E.indptr))
        block = row // b
        pairs, place = np.unique(block * dim + E.indices, return_inverse=True)
        counts = np.bincount(pairs // dim, minlength=m)
        first, n = np.cumsum(counts) - counts, int(counts.max(initial=0))
        at = np.minimum(first[:, None] + np.arange(n), (first + counts - 1)[:, None])
        entries = np.zeros((m, b, n))
        entries[block, row % b, place - first[block]] = E.data
        return cls((pairs % dim)[at], entries, counts)


class Energy:
    """1/2 <K w, w> + <f, w> + psi(E w) for one K, one E and many f and psi.

    Parameters
    ----------
    K : sparse, shape (dim, dim)
    E : sparse, shape (m, dim)
    groups : sequence of Local
        The rows of E in blocks, those of one size in a group.
    """

    def __init__(self, K: Matrix, E: sp.csr_array, groups: Sequence[Local]) -> None:
        self._K, self._E, self._transposed = sp.csr_array(K), E, sp.csr_array(E.T)
        # the lower triangle, column by column
        lower, dim = sp.tril(K, format="coo"), K.shape[0]
        keys, self._groups = [lower.col.astype(np.int64) * dim + lower.row], []
        for unknowns, entries, _ in groups:
            j, i = np.triu_indices(unknowns.shape[1])
            keys.append((unknowns[:, j].astype(np.int64) * dim + unknowns[:, i]).T.ravel())
            # blocks last: products of their few entries run along them
            self._groups.append(np.ascontiguousarray(entries.transpose(1, 2, 0)))
        pattern, place = np.unique(np.concatenate(keys), return_inverse=True)
        own, *of_groups = np.split(place, np.cumsum([len(one) for one in keys[:-1]]))
        self._entries = np.bincount(own, lower.data, pattern.size)
        self._places = [
            one.reshape(-1, L.shape[2]) for one, L in zip(of_groups, self._groups, strict=True)
        ]
        starts = np.searchsorted(pattern // dim, np.arange(dim + 1))
        self._factorise = InBlocks(pattern % dim, starts)
        self._last: tuple[Sequence[Array], Any] = (), None
        self._root = np.sqrt(K.diagonal())

    def minimise(
        self, f: Array, w: Array, law: Law, converged: Callable[[State], bool]
    ) -> tuple[State, int]:
        """Newton steps from w until one converges or none is left, and how many were taken.

        As the energy is convex its derivative along a step grows: of the shares 1, 1/2, 1/4, ...
        that one is taken where it is uphill by no more than 0.9 of what it was downhill: with 10 a
        ring takes 40 times as long, a gel 11 % fewer steps. No descent is proved: what has not
        converged after 60 steps (2 to 37 were needed) goes to the next solver. A step that leaves
        less than SAME_TANGENT of the residual is followed by one with the same tangent.
        """

        def at(w: Array) -> State:
            x = self._E @ w
            s, derivative = law(x)
            return State(w, x, s, self._K @ w + f + self._transposed @ s, derivative)

        state, iterations, size, D = at(w), 0, np.inf, None
        while iterations < 60 and not converged(state):
            before, size = size, euclidean(state.R / self._root)
            if D is None or size > SAME_TANGENT * before:
                D = state.derivative()
            try:
                change = -self._solve(D, state.R)
            except (ArithmeticError, RuntimeError):  # a pivot <= 0, or 0 in SuperLU
                break
            trials = (at(state.w + share * change) for share in SHARES)
            most = -0.9 * state.R.dot(change)
            trial = next((one for one in trials if one.R.dot(change) <= most), None)
            if trial is None:
                break
            state, iterations = trial, iterations + 1
        return state, iterations

    def _solve(self, D: Sequence[Array], R: Array) -> Array:
        """The solution of K + sum_k L_k^T D_k L_k; the last factors are kept."""
        last, solve = self._last
        if solve is None or not all(map(np.array_equal, D, last)):
            data = self._entries
            for L, places, of in zip(self._groups, self._places, D, strict=True):
                some = of.any(axis=(0, 1))
                if not some.all():
                    L, places, of = (x.compress(some, axis=-1) for x in (L, places, of))
                of_L = np.einsum("ikm,knm->inm", of, L)
                stiff = [np.einsum("knm,km->nm", L[:, j:], of_L[:, j]) for j in range(L.shape[1])]
                entries = np.concatenate([np.zeros((0, places.shape[1])), *stiff])
                data = data + np.bincount(places.ravel(), entries.ravel(), data.size)
            self._last = (), None  # nothing, if there are no factors
            self._last = D, self._factorise(data)
        return self._last[1](R)
