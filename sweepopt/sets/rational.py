"""The nearest point of a polyhedron in rational arithmetic, where rounding hides its face.

Doubles are rational numbers: at the apex of a needle, at a vertex of many rows and on rows that fix
a point only together, nothing has to be told from rounding. The method is that of D. Goldfarb and
A. Idnani, A numerically stable dual method for solving strictly convex quadratic programs, Math.
Programming 27 (1983): a violated row enters, rows whose multiplier would be negative leave, and the
distance grows.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

rational = np.frompyfunc(Fraction, 1, 1)


def exact_multipliers(G: np.ndarray, h: np.ndarray, v: np.ndarray, tau: np.ndarray) -> Any:
    """y >= 0 for which w = v - tau G^T y is the point of { w : G w <= h } nearest to v.

    Parameters
    ----------
    G, h, v, tau : ndarray of Fraction, shapes (m, dim), (m,), (dim,) and (dim,)
        The metric is that of 1 / tau.

    Returns
    -------
    ndarray of Fraction, shape (m,), or None
        None if the set is empty.
    """
    active: list[int] = []
    y, slack = 0 * h, h - G @ v
    products = np.full((len(h), len(h)), Fraction(0))
    while (slack < 0).any():
        new = int(slack.argmin())
        products[:, new] = G @ (tau * G[new])
        while True:
            direction = 0 * y
            direction[active] = -_solution(products[np.ix_(active, active)], products[active, new])
            direction[new] = Fraction(1)
            moving = [*active, new]
            change = products[:, moving] @ direction[moving]
            falling = [k for k in active if direction[k] < 0]
            limits = [-y[k] / direction[k] for k in falling]
            if change[new] > 0:  # else the row depends on the active ones
                falling.append(new)
                limits.append(-slack[new] / change[new])
            if not falling:
                return None
            length = min(limits)
            last = falling[limits.index(length)]
            y, slack = y + length * direction, slack + length * change
            if last == new:
                active.append(new)
                break
            active.remove(last)
    return y


def _solution(H: np.ndarray, b: np.ndarray) -> np.ndarray:
    """H^-1 b, H symmetric positive definite."""
    S = np.column_stack([H, b])
    for k in range(len(S)):
        S[k] /= S[k, k]
        others = np.arange(len(S)) != k
        S[others] -= np.outer(S[others, k], S[k])
    return S[:, -1]
