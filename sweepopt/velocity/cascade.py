"""The ladder: a solver, its refinements, then the other solvers, until one answer is good enough.

A solver fails on the one step in a thousand that another takes with ease.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sweepopt.checks import is_finite
from sweepopt.sets import ConvexSet
from sweepopt.velocity.elimination import ACCURATE, Solved
from sweepopt.velocity.polish import Judge
from sweepopt.velocity.program import Velocity, VelocityProgram
from sweepopt.velocity.solvers import NEWTON, Answer, Solve, Solver

SOLVED = {"Solved", "solved", "optimal"}  # how Clarabel, OSQP and cvxpy call it


def rungs(solvers: Sequence[Solver]) -> list[Solver]:
    """The first solver, its refinements, then the other solvers and theirs."""
    found: list[Solver] = []
    for solver in solvers:
        rung: Solver | None = solver
        while rung is not None:
            found.append(rung)
            rung = rung.refined()
    return found


class Ladder:
    """(q, C) -> the best answer for one cone; a rung is compiled when it is asked first.

    Parameters
    ----------
    program : VelocityProgram
    solvers : sequence of Solver
        In the order in which they are asked.
    tol : float
        Relative certificate that ends the climb.
    judge : Judge
    """

    def __init__(
        self, program: VelocityProgram, solvers: Sequence[Solver], *, tol: float, judge: Judge
    ) -> None:
        self.program = program
        self._rungs, self._tol, self._judge = rungs(solvers), tol, judge
        self._compiled: dict[int, Solve] = {}

    def serves(self, C: ConvexSet) -> bool:
        """Whether C has the cone of the program."""
        cone = self.program.cone
        return cone is C or cone.same_cone(C)

    def __call__(self, q: np.ndarray, C: ConvexSet) -> Solved:
        if not C.certifiable:
            return self._stated(q, C)
        best = nothing = _nothing(q)
        for k, rung in enumerate(self._rungs):
            answer, velocity = self._asked(k, q, C), nothing.velocity
            if is_finite(answer.z):
                velocity = self._judge(self.program, q, C, answer)
            if not velocity.relative <= self._tol:
                del self._compiled[k]  # a workspace that failed is not used again
            if velocity.relative < best.velocity.relative:
                best = Solved(velocity, rung.name, answer.iterations, 0)
            if self._is_enough(best.velocity.relative, rung, C):
                break
        return Solved(best.velocity, best.solver, best.iterations, k + 1)

    def _stated(self, q: np.ndarray, C: ConvexSet) -> Solved:
        """Nothing to compare: the first answer that its solver calls solved stands."""
        for k, rung in enumerate(self._rungs):
            answer = self._asked(k, q, C)
            if answer.status in SOLVED:
                velocity = self.program.certify(q, C, answer.z, answer.y)
                return Solved(velocity, rung.name, answer.iterations, k + 1)
            del self._compiled[k]
        return _nothing(q)._replace(attempts=len(self._rungs))

    def _asked(self, k: int, q: np.ndarray, C: ConvexSet) -> Answer:
        if k not in self._compiled:
            self._compiled[k] = self._rungs[k].compile(self.program)
        return self._compiled[k](q, C)

    def _is_enough(self, relative: float, rung: Solver, C: ConvexSet) -> bool:
        """Whether tol is met: a solver is refined for a small program that no polish made exact."""
        if not relative <= self._tol:
            return False
        return relative <= ACCURATE or rung.refined() is None or not NEWTON.treats(C)


def _nothing(q: np.ndarray) -> Solved:
    return Solved(Velocity(np.zeros_like(q), np.inf, np.inf), "none", 0, 0)
