"""Rows of a polyhedron with one direction: repeated ones, and pairs that can be equations.

n w <= d beside -n w <= -d is n w = d. A set with such rows has no inner points, and which of the
two rows binds is rounding.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from sweepopt.linalg import EPS, dense, product_error, row_lengths

SAME = 4 * EPS  # of unit rows: k n is rounded once, and both lengths three times


class Parallel(NamedTuple):
    """Pairs of rows n_i = sign n_j, i < j, each array of shape (k,)."""

    i: np.ndarray
    j: np.ndarray
    sign: np.ndarray

    def equal(self, d: np.ndarray, margin: np.ndarray) -> np.ndarray:
        """Which of the pairs have one side, d_i = sign d_j, but for the larger margin of the two.

        Sides are shape (m,), or (m, k) for k histories.
        """
        i, j, sign = self
        change = np.abs(d[i].T - sign * d[j].T).T.reshape(i.size, d[:1].size)
        return change.max(axis=1, initial=0.0) <= np.maximum(margin[i], margin[j])

    def among(self, some: np.ndarray) -> Parallel:
        """Some of the pairs."""
        return Parallel(*(x[some] for x in self))

    def opposite_but_for_rounding(self, R: Any) -> np.ndarray:
        """Which pairs of rows R are a wedge: opposite, but no row is a multiple of the other."""
        wedges = self.sign < 0
        # most are n and -n, to the last bit: the others are few, and dense
        wedges[wedges] = abs(R[self.i[wedges]] + R[self.j[wedges]]).sum(axis=1) > 0
        x, y = dense(R[self.i[wedges]]), dense(R[self.j[wedges]])
        largest = np.abs(x).argmax(axis=1)[:, None]
        of_x, of_y = (np.take_along_axis(z, largest, axis=1) for z in (x, y))
        other = (of_y * x != of_x * y) | (product_error(of_y, x) != product_error(of_x, y))
        wedges[wedges] = other.any(axis=1)
        return wedges


def parallel_rows(R: Any, rounding: float = SAME) -> Parallel:
    """The pairs among unit rows, dense or sparse; rows of zeros are in none.

    They differ by no more than the rounding of a multiple of a row.

    Examples
    --------
    >>> parallel_rows(np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]]))
    Parallel(i=array([0]), j=array([2]), sign=array([-1.]))
    """
    # parallel rows are neighbours in the order of their products with any vector
    direction = np.random.default_rng(0).normal(size=R.shape[1])
    heights = R @ direction
    order = np.argsort(np.abs(heights), kind="stable")
    ends = np.flatnonzero(np.diff(np.abs(heights[order])) > rounding * np.abs(direction).sum())
    groups = np.split(order, ends + 1)
    pairs = [pair for group in groups for pair in combinations(np.sort(group).tolist(), 2)]
    i, j = np.array(pairs, dtype=int).reshape(-1, 2).T
    sign = np.sign(heights[i] * heights[j])
    parallel = (row_lengths(R[i] - sign[:, None] * R[j]) <= rounding) & (sign != 0)
    return Parallel(i[parallel], j[parallel], sign[parallel])
