"""Newton's method for a convex energy whose second derivative is a sparse matrix and small blocks.

    K + sum_k L_k^T D_k L_k,    D_k made of derivatives of projections, on few unknowns each,

has one pattern whatever the D_k are, which is analysed once. Steps are halved until the energy
falls.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Matrix
from sweepopt.errors import IndefiniteError
from sweepopt.linalg import InBlocks

SUFFICIENT = 1e-4  # of the decrease that the tangent promises (Armijo)
SHORTEST = 2.0**-20  # share of a step


State = TypeVar("State")  # a point, its `energy`, a bound of its `rounding`, its gradient `R`
Step = tuple[np.ndarray, Callable[[float], State]]
"""The change of a Newton step, and the state after a share of it."""


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

    unknowns: np.ndarray
    entries: np.ndarray
    counts: np.ndarray

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


class Tangent:
    """K + sum_k L_k^T D_k L_k for one K, one choice of L and many D; the last factors are kept.

    Parameters
    ----------
    K : sparse, shape (dim, dim)
    groups : sequence of Local
        Blocks of one size each.
    """

    def __init__(self, K: Matrix, groups: Sequence[Local]) -> None:
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
        self._K = np.bincount(own, lower.data, pattern.size)
        self._places = [
            one.reshape(-1, L.shape[2]) for one, L in zip(of_groups, self._groups, strict=True)
        ]
        starts = np.searchsorted(pattern // dim, np.arange(dim + 1))
        self._factorise = InBlocks(pattern % dim, starts)
        self._last: tuple[Sequence[np.ndarray], Any] = (), None

    def solve(self, D: Sequence[np.ndarray], R: np.ndarray) -> np.ndarray:
        """The solution for symmetric D_k, shape (b, b, m) in each group.

        Raises
        ------
        IndefiniteError
            If the matrix is not positive definite, to rounding.
        """
        last, solve = self._last
        if solve is None or not all(map(np.array_equal, D, last)):
            data = self._K
            for L, places, of in zip(self._groups, self._places, D, strict=True):
                some = of.any(axis=(0, 1))
                if not some.all():
                    L, places, of = L[:, :, some], places[:, some], of[:, :, some]
                of_L = sum(of[:, k, None] * L[k] for k in range(len(L)))
                stiff = [(L[:, j:] * of_L[:, j, None]).sum(axis=0) for j in range(L.shape[1])]
                entries = np.concatenate([np.zeros((0, places.shape[1])), *stiff])
                data = data + np.bincount(places.ravel(), entries.ravel(), data.size)
            self._last = (), None  # nothing, if there are no factors
            try:
                solve = self._factorise(data)
            except (ArithmeticError, RuntimeError) as error:  # a pivot <= 0, or 0 in SuperLU
                raise IndefiniteError("the tangent is not positive definite") from error
            self._last = D, solve
        return solve(R)


def newton(
    state: State,
    step: Callable[[State], Step[State]],
    converged: Callable[[State], bool],
    most: int,
) -> tuple[State, int]:
    """Steps until one converges, at most so many, or none is left; and how many were taken."""
    iterations = 0
    while iterations < most and not converged(state):
        try:
            change, after = step(state)
        except IndefiniteError:
            break
        trial = line_search(state, change, after)
        if trial is None:
            break
        state, iterations = trial, iterations + 1
    return state, iterations


def line_search(state: Any, change: np.ndarray, after: Callable[[float], Any]) -> Any:
    """After the first of the shares 1, 1/2, 1/4, ... of a step with which the energy is less.

    Where the energy only rounds, the derivative along the step decides (Hager and Zhang, SIAM J.
    Optim. 16(1), 2005). None where rounding hides that too.
    """
    slope, share = float(state.R.dot(change)), 1.0
    while share > SHORTEST:
        trial = after(share)
        hidden = -share * slope <= trial.rounding
        if trial.energy <= state.energy + SUFFICIENT * share * slope or (
            hidden and trial.R.dot(change) <= -0.5 * slope
        ):
            return trial
        share /= 2
    return None
