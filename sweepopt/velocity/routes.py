"""From (q, C) to a certified velocity: the routes a plan chooses from.

A point needs a linear solve, a set on few unknowns a program for these alone,
any other set the whole program.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sweepopt.linalg import Factor, sum_error
from sweepopt.sets import ConvexSet
from sweepopt.velocity.cascade import Ladder
from sweepopt.velocity.elimination import Solved
from sweepopt.velocity.polish import judged
from sweepopt.velocity.program import (
    Velocity,
    VelocityProgram,
    closed_form,
    has_closed_form,
    untranslated,
)
from sweepopt.velocity.solvers import choose


class Programmed:
    """The velocities of one M: at rest, by formula, or by the solvers of the cone that C has.

    What is compiled is that of one cone, the last one.
    """

    def __init__(self, M: Factor, solver: Any, tol: float, order: np.ndarray | None) -> None:
        self._M, self._solver, self._tol, self._order = M, solver, tol, order
        self._ladder: Ladder | None = None
        self._has_formula = False

    def __call__(self, q: np.ndarray, C: ConvexSet) -> Solved:
        translate = untranslated(C)
        c, S = translate
        ladder = self._ladder_of(S)
        if self._has_formula:
            return Solved(closed_form(self._M, q, C), "closed form", 0, 0)
        rest = ladder.program.at_rest(q, translate)
        if rest is not None:
            return Solved(rest, "at rest", 0, 0)
        return _without(self._M, ladder(q - c, S), q, c)

    def _ladder_of(self, shape: ConvexSet) -> Ladder:
        if self._ladder is not None and self._ladder.serves(shape):
            return self._ladder
        self._has_formula = self._solver == "auto" and has_closed_form(self._M, shape)
        self._ladder = Ladder(
            VelocityProgram(self._M, shape),
            choose(self._solver, shape),
            tol=self._tol,
            judge=judged(self._M, self._order),
        )
        return self._ladder


def _without(M: Factor, found: Solved, q: np.ndarray, c: np.ndarray) -> Solved:
    """What is found for q - c, rounded, as the answer for q and C = c + S."""
    z, certificate, relative = found.velocity
    if M.is_sharp or not 0 < relative < math.inf:
        return found
    lost = M.dual_norm_bound(sum_error(q, -c, q - c))
    velocity = Velocity(z, certificate + lost, relative * (1 + lost / certificate))
    return found._replace(velocity=velocity)
