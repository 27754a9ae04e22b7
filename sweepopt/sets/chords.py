"""Chords between points of sets C_k = { E s : s in S_k, F s = 0 } that are made in one way.

(1 - x) S_0 + x S_1 has the points (1 - x) s_0 + x s_1, on which F s = 0, and the support function
(1 - x) sigma(S_0, .) + x sigma(S_1, .). With any multipliers lam and y = E^T p - F^T lam that is at
least sigma(C, p), and <p, E s> = <y, s>: the gap of the parts bounds that of C.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sweepopt.checks import Array
from sweepopt.errors import EmptySetError
from sweepopt.linalg import dense
from sweepopt.sets.aligned import product_of
from sweepopt.sets.base import ROUNDING, ConvexSet, same_array
from sweepopt.sets.curves import products
from sweepopt.sets.projection import Projector, shortest


class Chords(NamedTuple):
    """Points s_k of sets inside of the C_k and multipliers, and the S_k of sets around the C_k."""

    E: Array
    F: Array
    points: Array
    multipliers: Array
    around: list[ConvexSet]

    @classmethod
    def through(
        cls, inside: Sequence[ConvexSet], around: Sequence[ConvexSet], v: Array, c: float
    ) -> Chords:
        """Through the points next to v, with the multipliers of the normals there over c.

        Raises
        ------
        EmptySetError
            If a set inside has no point, or is of another form.
        """
        (E, F, _), start, points, multipliers, outer = inside[0].form(), None, [], [], []
        for C, D, goal in zip(inside, around, v, strict=True):
            form, wider = C.form(), D.form()
            if not all(same_array(E, one.E) and same_array(F, one.F) for one in (form, wider)):
                raise EmptySetError("a part is a point")
            near = Projector(form)(goal, start)
            if not near.exact:
                raise EmptySetError("the parts hardly meet")
            start = near.start
            points.append(start.s)
            multipliers.append(shortest(F.T.toarray(), E.T @ (goal - near.w) - start.n) / c)
            outer.append(product_of(wider.parts))
        return cls(dense(E), dense(F), np.array(points), np.array(multipliers), outer)

    def along(self, k: Array, x: Array, p: Array) -> tuple[Array, Array]:
        """w at the shares x of the chords from k to k + 1, shape (m, len(x), dim), and its gap.

        That is the mean of a bound along each chord, beside quadratic curves p of directions with
        Bernstein coefficients of shape (m, 3, dim).
        """
        first, last = self.points[k, None], self.points[k + 1, None]
        w = (first + x[:, None] * (last - first)) @ self.E.T
        before, after = self.multipliers[k], self.multipliers[k + 1]
        y = p @ self.E - np.stack([before, 0.5 * (before + after), after], axis=1) @ self.F
        total = np.zeros(len(k))
        for end, s in enumerate((first, last)):
            sets = zip((self.around[i] for i in k + end), y, strict=True)
            sigma = np.array([S.support_rows(rows) for S, rows in sets])
            gaps = np.maximum(sigma - (y * s).sum(axis=2), 0.0) + ROUNDING * np.abs(sigma)
            total += gaps @ products(2, 1)[:, end]
        return w, total


def ball_inside(S: ConvexSet) -> tuple[Array, float]:
    """A point a and the radius of a ball around it in S, 0 if none is found.

    The cross-polytope of the points a + r e_i and a - r e_i is in S if these are.
    """
    axes, size = np.eye(S.dim), S.magnitude()
    r = size if np.isfinite(size) else 1.0
    a = S.project_rows(4 * r * np.vstack([axes, -axes])).mean(axis=0)
    for _ in range(30):
        corners = a + r * np.vstack([axes, -axes])
        if np.abs(S.project_rows(corners) - corners).max() <= ROUNDING * (r + np.abs(a).max()):
            return a, r / np.sqrt(S.dim)
        r /= 2
    return a, 0.0
