"""The solver cascade of one cone: the first solver whose velocity meets the tolerance.

A solver fails on the one step in a thousand that another takes with ease: its tighter settings,
Newton steps from its answer and the other solvers stand behind it. The certificate judges them all
alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from sweepopt.linalg import Elimination, Factor
from sweepopt.sets import ConvexSet
from sweepopt.velocity.certificate import (
    CLOSED_FORM,
    Inclusion,
    Instance,
    Proposal,
    Velocity,
    at_rest,
)
from sweepopt.velocity.program import VelocityProgram, untranslated
from sweepopt.velocity.refinement import UNSOLVED, by_program, refined
from sweepopt.velocity.solvers import NEWTON, Answer, Solver, choose

WRONG = 1e-2  # a larger relative certificate is that of a failure, not of a loose solver


class Attempt(NamedTuple):
    """A solver for a program of some unknowns of a set.

    Attributes
    ----------
    solver : Solver
    matrix : callable () -> Factor
        Its `unknowns` are those of the program.
    cone : ConvexSet
        A set on these unknowns.
    from_best : bool
        Whether it starts from the best velocity that is known.
    """

    solver: Solver
    matrix: Callable[[], Factor]
    cone: ConvexSet
    from_best: bool = False


def attempts(solver: Any, M: Factor, S: ConvexSet, tol: float) -> Iterator[Attempt]:
    """The solvers of a program, each with its refinements, in the order in which they are asked.

    A program of all unknowns whose set acts on few of them has that of the few behind it, which is
    better conditioned.
    """
    solvers = choose(solver, S, tol)
    selection = S.selection if M.small is M else None
    if selection is None or selection.shift is not None:
        yield from _chain(solvers, lambda: M, S)
        return
    unknowns, part = selection.unknowns, selection.part
    yield from _chain(solvers[:1], lambda: M, S)
    eliminated = cache(lambda: Elimination(M.M, unknowns, M.order))
    yield from _chain(choose("auto", part, tol), eliminated, part)


def _chain(
    solvers: tuple[Solver, ...],
    matrix: Callable[[], Factor],
    cone: ConvexSet,
) -> Iterator[Attempt]:
    """Each solver, then each with tighter settings, and Newton steps from the answers of those.

    They find the active set, and are exact but for rounding.
    """
    while solvers:
        for solver in solvers:
            yield Attempt(solver, matrix, cone)
            if solver.name != NEWTON.name and NEWTON.treats(cone):
                yield Attempt(NEWTON, matrix, cone, from_best=True)
        tighter = [solver.refined() for solver in solvers]
        solvers = tuple(solver for solver in tighter if solver is not None)


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
        M = inclusion.M.small
        # z = M^-1 (P_S(q) - q) where the projection in M's metric is the set's own: box, ball
        self._has_formula = (
            solver == "auto"
            and cone.exact
            and M.is_diagonal
            and np.array_equal(cone.weights(M.diagonal), M.diagonal)
        )
        self._attempts = [] if self._has_formula else list(attempts(solver, inclusion.M, cone, tol))
        self._compiled: dict[int, Any] = {}

    def serves(self, C: ConvexSet) -> bool:
        """Whether C has the cone of the program."""
        return self._cone is C or self._cone.same_cone(C)

    def __call__(self, of: Instance) -> Velocity:
        if self._has_formula:
            return self._by_formula(of)
        if self.inclusion.rests(of, self._tol):
            return at_rest(of.q)
        best, solver, iterations = UNSOLVED, "none", 0
        for k, attempt in enumerate(self._attempts):
            velocity = self._asked(k, of, best.z)
            iterations += velocity.iterations
            if velocity.relative < best.relative or math.isnan(velocity.relative):
                if not (attempt.from_best and best.relative <= WRONG):  # else it is improved
                    solver = attempt.solver.name
                best = velocity
            if not best.relative > self._tol:
                break
            if not velocity.relative <= WRONG:
                del self._compiled[k]  # a workspace that failed is not used again
            if k == 0 and self.inclusion.rests_exactly(of):
                return at_rest(of.q)
        z = np.zeros_like(of.force) if best is UNSOLVED else best.z
        return Velocity(z, best.certificate, best.relative, solver, iterations, k + 1)

    def _asked(self, k: int, of: Instance, start: np.ndarray) -> Velocity:
        attempt = self._attempts[k]
        M = attempt.matrix()
        if k not in self._compiled:
            shape = untranslated(attempt.cone).S
            self._compiled[k] = attempt.solver.compile(VelocityProgram(M.small, shape))
        compiled = self._compiled[k]
        starts = [start[M.unknowns]] if attempt.from_best and start.any() else []

        def solve(linear: np.ndarray, C: ConvexSet) -> Answer:
            c, shape = untranslated(C)
            given = [starts.pop()] if starts else []
            return compiled(linear if shape is C else linear - c, shape, *given)

        S = of.whole if isinstance(M.unknowns, slice) else of.S
        return refined(self.inclusion, by_program(M, solve, S, self._tol), of, self._tol)

    def _by_formula(self, of: Instance) -> Velocity:
        inclusion, tol = self.inclusion, self._tol
        M, S = inclusion.M, of.S
        if M.small is M:  # without the loop that refines, and with one projection
            S = of.whole
            outside = S.normal(of.force)
            if inclusion.rests(of, tol, outside):
                return at_rest(of.q, CLOSED_FORM)
            z = 0.0 - outside / M.diagonal
            pair = Proposal(z, S.project(of.force), solver=CLOSED_FORM)
            velocity = inclusion.certify(of, pair, tol)
            if velocity.relative <= tol:
                return velocity
        elif inclusion.rests(of, tol):
            return at_rest(of.q, CLOSED_FORM)

        def solve(linear: np.ndarray, S: ConvexSet) -> Proposal:
            return Proposal(0.0 - S.normal(linear) / M.small.diagonal, S.project(linear))

        velocity = refined(inclusion, by_program(M, solve, S, tol), of, tol)
        return velocity._replace(solver=CLOSED_FORM)
