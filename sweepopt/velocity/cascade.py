"""The solver cascade of one cone: the first solver whose velocity meets the tolerance.

A solver fails on the one step in a thousand that another takes with ease: Newton steps from its
answer and the other solvers stand behind it. The certificate judges them all alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, lru_cache
from typing import Any

import numpy as np

from sweepopt.linalg import Elimination, Factor
from sweepopt.sets import Balls, Box, ConvexSet, shape_of
from sweepopt.velocity.certificate import (
    CLOSED_FORM,
    Inclusion,
    Instance,
    Velocity,
    at_rest,
    unsolved,
)
from sweepopt.velocity.program import VelocityProgram
from sweepopt.velocity.refinement import Propose, by_formula, by_program, refined
from sweepopt.velocity.solvers import NEWTON, Answer, Solve, Solver, choose

WRONG = 1e-2  # a larger relative certificate is that of a failure, not of a loose solver


@dataclass
class Attempt:
    """A solver for a program of some unknowns of a set, compiled when it is asked first.

    Attributes
    ----------
    solver : Solver
    body : callable () -> Factor
        Its `unknowns` are those of the program.
    from_best : bool
        Whether it starts from the best velocity that is known.
    """

    solver: Solver
    body: Callable[[], Factor]
    from_best: bool = False
    compiled: Solve | None = None
    apart: Callable[[ConvexSet], ConvexSet] = field(
        default_factory=lambda: lru_cache(1)(ConvexSet.apart)
    )

    def __call__(
        self, inclusion: Inclusion, of: Instance, best: np.ndarray, tol: float
    ) -> Velocity:
        """The velocity that the solver finds, refined."""
        propose = self.proposals(inclusion, of.S, best, tol)
        velocity = refined(inclusion, propose, of, tol)
        if not velocity.relative <= WRONG:  # a workspace that failed is not used again
            self.compiled = None
        return velocity

    def proposals(
        self, inclusion: Inclusion, S: ConvexSet, best: np.ndarray, tol: float
    ) -> Propose:
        """From residuals to the solver's normal pairs."""
        M, selection = self.body(), S.selection
        if M is not inclusion.M and selection is not None:
            S = self.apart(selection.part)
        compiled = self.compiled = self.compiled or self.solver.compile(VelocityProgram(M.small, S))
        start = [best[M.unknowns]] if self.from_best and best.any() else []

        def solve(q: np.ndarray, C: ConvexSet) -> Answer:
            return compiled(q, C, start.pop()) if start else compiled(q, C)

        return by_program(M, solve, S, tol)


def attempts(solver: Any, M: Factor, S: ConvexSet, tol: float, anew: bool) -> list[Attempt]:
    """The solvers of a program, in the order in which they are asked.

    Where the cone changes from step to step Newton's method comes first: the others compile it,
    which takes 20 ms.

    A program of all unknowns whose set acts on few of them has that of the few behind it, which is
    better conditioned: without it 9 hard families miss 1e-9.
    """
    solvers, selection, behind = choose(solver, S, tol), S.selection, []
    if anew and solver == "auto":
        solvers = tuple(sorted(solvers, key=lambda one: one.name != NEWTON.name))
    if M.small is M and selection is not None and selection.shift is None:
        few, part = selection.unknowns, selection.part
        solvers = solvers[:1]
        behind = _chain(
            choose("auto", part, tol), cache(lambda: Elimination(M.M, few, M.order)), part
        )
    return _chain(solvers, lambda: M, S) + behind


def _chain(solvers: tuple[Solver, ...], body: Callable[[], Factor], S: ConvexSet) -> list[Attempt]:
    """Each solver, and Newton steps from its answer: they find the active set to rounding."""
    chain = []
    for solver in solvers:
        chain.append(Attempt(solver, body))
        if solver.name != NEWTON.name and NEWTON.treats(S):
            chain.append(Attempt(NEWTON, body, from_best=True))
    return chain


class Cascade:
    """Instance -> its velocity: at rest, by a formula, or by the first solver that meets `tol`.

    Where no solver does it is the best. A solver is compiled when it is asked first.

    Parameters
    ----------
    inclusion : Inclusion
    solver : str or Solver
        The user's choice.
    of : Instance
        Any one of the family.
    tol : float
    anew : bool
        Whether the program before had another cone.
    proved : bool
        Whether velocities are certified and refined.
    """

    def __init__(
        self,
        inclusion: Inclusion,
        solver: Any,
        of: Instance,
        tol: float,
        anew: bool = False,
        proved: bool = True,
    ) -> None:
        self._proved = proved
        self._inclusion, self._cone, self._tol = inclusion, of.S, tol
        M, weights = inclusion.M, inclusion.M.diagonal[of.unknowns]
        # M is diagonal and the projection in its metric is the set's own: box, ball
        self._has_formula = (
            solver == "auto"
            and M.is_diagonal
            and of.S.exact
            and np.array_equal(of.S.weights(weights), weights)
        )
        # active sets are hidden by rounding where faces are nearly parallel: these ask for a proof
        self._is_formula = self._has_formula and all(
            isinstance(part, (Box, Balls)) or not part.polyhedral
            for part in map(shape_of, of.S.form().parts)
        )
        self._attempts = attempts(solver, M, of.S, tol, anew)

    def serves(self, inclusion: Inclusion, S: ConvexSet) -> bool:
        """Whether its programs are those of this inclusion and this set."""
        return inclusion is self._inclusion and (self._cone is S or self._cone.same_cone(S))

    def __call__(self, of: Instance) -> Velocity:
        inclusion, tol = self._inclusion, self._tol
        if self._is_formula:
            velocity = inclusion.closed_form(of, tol)
            if velocity is not None:
                return velocity
        if not self._proved:  # wrong answers show in the trajectory's residual
            nothing = unsolved(of).z
            for attempt in self._attempts:
                pair = attempt.proposals(inclusion, of.S, nothing, math.inf)(of.force, None)
                if pair.gap < math.inf or math.isnan(pair.gap):
                    return Velocity(pair.z, math.nan, math.nan, attempt.solver.name)
                attempt.compiled = None
        if inclusion.rests(of, tol):
            return at_rest(of.q)
        if self._has_formula:
            velocity = refined(inclusion, by_formula(inclusion.M, of.S, tol), of, tol)
            return velocity._replace(solver=CLOSED_FORM)
        best, solver, iterations, count = unsolved(of), "none", 0, 0
        for attempt in self._attempts:
            velocity = attempt(inclusion, of, best.z, tol)
            iterations += velocity.iterations
            count += 1
            if velocity.relative < best.relative or math.isnan(velocity.relative):
                if not (attempt.from_best and best.relative <= WRONG):  # else it is improved
                    solver = attempt.solver.name
                best = velocity
            if not best.relative > tol:
                break
            if count == 1 and inclusion.rests_exactly(of):
                return at_rest(of.q)
        return Velocity(best.z, best.certificate, best.relative, solver, iterations, count)
