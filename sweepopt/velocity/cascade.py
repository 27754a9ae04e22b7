"""The solver cascade of one cone: the first solver whose velocity meets the tolerance.

A solver fails on the one step in a thousand that another takes with ease: Newton steps from its
answer and the other solvers stand behind it. The certificate judges them all alike.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from sweepopt.linalg import Elimination, Factor
from sweepopt.sets import ConvexSet
from sweepopt.velocity.certificate import CLOSED_FORM, Inclusion, Instance, Velocity, at_rest
from sweepopt.velocity.program import VelocityProgram, untranslated
from sweepopt.velocity.refinement import UNSOLVED, by_formula, by_program, refined
from sweepopt.velocity.solvers import NEWTON, Answer, Solve, Solver, choose

WRONG = 1e-2  # a larger relative certificate is that of a failure, not of a loose solver


@dataclass
class Attempt:
    """A solver for a program of some unknowns of a set, compiled when it is asked first.

    Attributes
    ----------
    solver : Solver
    M : Factor
        Its `unknowns` are those of the program.
    cone : ConvexSet
        A set on these unknowns.
    from_best : bool
        Whether it starts from the best velocity that is known.
    """

    solver: Solver
    M: Factor
    cone: ConvexSet
    from_best: bool = False
    compiled: Solve | None = None

    def __call__(
        self, inclusion: Inclusion, of: Instance, start: np.ndarray, tol: float
    ) -> Velocity:
        """The velocity that the solver finds, refined."""
        M, starts = self.M, [start] if self.from_best and start.any() else []
        if self.compiled is None:
            self.compiled = self.solver.compile(VelocityProgram(M.small, self.cone))
        compiled = self.compiled

        def solve(linear: np.ndarray, C: ConvexSet) -> Answer:
            c, S = untranslated(C)
            given = [starts.pop()[M.unknowns]] if starts else []
            return compiled(linear if S is C else linear - c, S, *given)

        S = of.whole if isinstance(M.unknowns, slice) else of.S
        velocity = refined(inclusion, by_program(M, solve, S, tol), of, tol)
        if not velocity.relative <= WRONG:
            self.compiled = None  # a workspace that failed is not used again
        return velocity


def attempts(solver: Any, M: Factor, S: ConvexSet, tol: float) -> Iterator[Attempt]:
    """The solvers of a program, in the order in which they are asked.

    A program of all unknowns whose set acts on few of them has that of the few behind it, which is
    better conditioned.
    """
    solvers, selection = choose(solver, S, tol), S.selection
    if M.small is not M or selection is None or selection.shift is not None:
        yield from _chain(solvers, M, S)
        return
    yield from _chain(solvers[:1], M, S)
    few = Elimination(M.M, selection.unknowns, M.order)
    yield from _chain(choose("auto", selection.part, tol), few, selection.part)


def _chain(solvers: tuple[Solver, ...], M: Factor, cone: ConvexSet) -> Iterator[Attempt]:
    """Each solver, and Newton steps from its answer: they find the active set to rounding."""
    cone = untranslated(cone).S
    for solver in solvers:
        yield Attempt(solver, M, cone)
        if solver.name != NEWTON.name and NEWTON.treats(cone):
            yield Attempt(NEWTON, M, cone, from_best=True)


class Cascade:
    """Instance -> its velocity: at rest, by a formula, or by the first solver that meets `tol`.

    Where no solver does it is the best. A solver is compiled when it is asked first.

    Parameters
    ----------
    inclusion : Inclusion
    solver : str or Solver
        The user's choice.
    cone : ConvexSet
        Any member of the family on the unknowns of the inclusion's program.
    tol : float
    """

    def __init__(self, inclusion: Inclusion, solver: Any, cone: ConvexSet, tol: float) -> None:
        self.inclusion, self._cone, self._tol = inclusion, cone, tol
        self._auto = solver == "auto"
        self._formula: bool | None = None
        self._attempts: list[Attempt] = []
        self._others = attempts(solver, inclusion.M, cone, tol)

    def serves(self, C: ConvexSet) -> bool:
        """Whether C has the cone of the program."""
        return self._cone is C or self._cone.same_cone(C)

    def __call__(self, of: Instance) -> Velocity:
        if self._formula is None:
            self._formula = self._auto and self._has_formula(of.S, of.unknowns)
        if self._formula:
            return self._by_formula(of)
        if self.inclusion.rests(of, self._tol):
            return at_rest(of.q)
        best, solver, iterations, count = UNSOLVED, "none", 0, 0
        for attempt in self._each():
            velocity = attempt(self.inclusion, of, best.z, self._tol)
            iterations += velocity.iterations
            count += 1
            if velocity.relative < best.relative or math.isnan(velocity.relative):
                if not (attempt.from_best and best.relative <= WRONG):  # else it is improved
                    solver = attempt.solver.name
                best = velocity
            if not best.relative > self._tol:
                break
            if count == 1 and self.inclusion.rests_exactly(of):
                return at_rest(of.q)
        z = np.zeros_like(of.force) if best is UNSOLVED else best.z
        return Velocity(z, best.certificate, best.relative, solver, iterations, count)

    def _each(self) -> Iterator[Attempt]:
        """The attempts; the matrix of the few unknowns is factorised when it is needed."""
        yield from self._attempts
        for attempt in self._others:
            self._attempts.append(attempt)
            yield attempt

    def _has_formula(self, S: ConvexSet, few: Any) -> bool:
        """Whether M is diagonal and the projection in its metric is the set's own: box, ball."""
        M = self.inclusion.M
        if not (M.is_diagonal and S.exact):
            return False
        weights = M.diagonal[few]
        return np.array_equal(S.weights(weights), weights)

    def _by_formula(self, of: Instance) -> Velocity:
        inclusion, tol = self.inclusion, self._tol
        propose = by_formula(inclusion.M, of)
        pair = propose(of.force, None)
        if inclusion.rests(of, tol, inclusion.M.diagonal * pair.z):
            return at_rest(of.q, CLOSED_FORM)
        velocity = inclusion.certify(of, pair, tol)
        if velocity.relative <= tol:
            return velocity
        return refined(inclusion, propose, of, tol)
