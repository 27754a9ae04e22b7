"""The solver cascade of one cone: the first solver whose velocity meets the tolerance.

A solver fails on the one step in a thousand that another takes with ease: its tighter settings, a
polish and the other solvers stand behind it. The certificate judges them all alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np

from sweepopt.checks import Matrix
from sweepopt.linalg import (
    Elimination,
    Factor,
    IterativeElimination,
    eliminate,
    euclidean,
    factorise,
)
from sweepopt.sets import ConvexSet
from sweepopt.velocity.certificate import (
    SHARE,
    Inclusion,
    LinearTerm,
    Proposal,
    Velocity,
    at_rest,
    is_near,
)
from sweepopt.velocity.elimination import AllUnknowns, FewUnknowns, Unknowns
from sweepopt.velocity.program import VelocityProgram, untranslated
from sweepopt.velocity.refinement import refined
from sweepopt.velocity.solvers import LAST, NEWTON, Answer, Small, Solver, choose

WRONG = 1e-2  # a larger relative certificate is that of a failure, not of a loose solver


@dataclass(frozen=True, eq=False)
class Factors:
    """A matrix factorised in the ways that somebody asks for; nothing in it depends on steps."""

    M: Matrix
    contact: np.ndarray
    order: np.ndarray | None

    @cached_property
    def all(self) -> AllUnknowns:
        """The matrix of a program for all unknowns."""
        return AllUnknowns(self.whole)

    @cached_property
    def few(self) -> FewUnknowns:
        """That of a program for the contact."""
        return FewUnknowns(self.elimination)

    @cached_property
    def whole(self) -> Factor:
        """The factors of M."""
        return factorise(self.M)

    @cached_property
    def elimination(self) -> Elimination | IterativeElimination:
        """Factors that end with the contact."""
        return eliminate(self.M, self.contact, self.order)


class Rest(NamedTuple):
    """The rule of rest for a state u, where q = B u is rounded."""

    inclusion: Inclusion
    u: np.ndarray | None
    rule: Callable[[np.ndarray], bool]

    def holds(self, term: LinearTerm, tol: float) -> bool:
        """Whether q is in C, and B u as well where q may be rounded to more than a share of tol."""
        if not self.rule(term.q):
            return False
        rounding, forces = self.inclusion.rounding_of_force(self.u), self.inclusion.forces
        return rounding <= SHARE * tol * forces(term.q, term.c) or self.holds_exactly()

    def holds_exactly(self) -> bool:
        """Whether B u, rounded once, is in C."""
        return self.u is not None and self.rule(self.inclusion.exact_force(self.u))


class Attempt(NamedTuple):
    """A solver for a program of some unknowns of a set.

    Attributes
    ----------
    unknowns : callable () -> Unknowns
    selected : bool
        Whether the program is that of the few unknowns that the set selects.
    polish : bool
        Whether it starts from the best velocity that is known.
    """

    solver: Solver
    unknowns: Callable[[], Unknowns]
    selected: bool = False
    polish: bool = False

    def part(self, S: ConvexSet) -> ConvexSet:
        """The set on the unknowns of the program."""
        return S.selection.part if self.selected and S.selection is not None else S


def attempts(
    solver: Any, factors: Factors, on_few: bool, S: ConvexSet, tol: float
) -> list[Attempt]:
    """The first solver and its refinements, then the other solvers and theirs.

    Behind a solver come Newton steps from its velocity where the projection has a derivative, and
    behind one that iterates to a tolerance an active set on small polyhedra: both are exact but for
    rounding, and on the few unknowns that the set acts on.
    """

    def program() -> Unknowns:
        return factors.few if on_few else factors.all

    few: Callable[[], Unknowns] = program
    part, selection = S, S.selection
    if selection is not None and not on_few:
        part = selection.part
        few = cache(lambda: FewUnknowns(eliminate(factors.M, selection.unknowns, factors.order)))
    own = part is not S
    polish = [Attempt(NEWTON, few, own, True)] if NEWTON.treats(part) else []
    last = [Attempt(LAST, few, own)] if LAST.treats(part) else []
    found: list[Attempt] = []
    for one in choose(solver, S, tol):
        attempt: Solver | None = one
        while attempt is not None:
            found.append(Attempt(attempt, program))
            if attempt.name != NEWTON.name:
                found += polish
            if not isinstance(attempt, Small):
                found, last = found + last, []
            attempt = attempt.refined()
    return found


class Cascade:
    """(linear term, S) -> the first velocity that meets the tolerance, or the best, for one cone.

    A solver is compiled when it is asked first.
    """

    at_rest = "at rest"

    def __init__(
        self, inclusion: Inclusion, attempts: Sequence[Attempt], cone: ConvexSet, tol: float
    ) -> None:
        self._inclusion, self._attempts, self._cone, self._tol = inclusion, attempts, cone, tol
        self._compiled: dict[int, Any] = {}

    def serves(self, C: ConvexSet) -> bool:
        """Whether C has the cone of the program."""
        return self._cone is C or self._cone.same_cone(C)

    def __call__(self, term: LinearTerm, S: ConvexSet, rest: Rest) -> Velocity:
        best, iterations = Velocity(np.zeros_like(term.force), math.inf, math.inf, "none"), 0
        for k, attempt in enumerate(self._attempts):
            velocity = self._refined(k, term, S, best.z)
            iterations += velocity.iterations
            if velocity.relative < best.relative or math.isnan(velocity.relative):
                polished = attempt.polish and best.relative <= WRONG
                name = best.solver if polished else attempt.solver.name
                best = velocity._replace(solver=name)
            if not best.relative > self._tol:
                break
            if not velocity.relative <= WRONG:
                del self._compiled[k]  # a workspace that failed is not used again
            if k == 0 and rest.holds_exactly():
                return at_rest(term.q)
        return best._replace(iterations=iterations, attempts=k + 1)

    def _refined(self, k: int, term: LinearTerm, S: ConvexSet, start: np.ndarray) -> Velocity:
        attempt = self._attempts[k]
        unknowns = attempt.unknowns()
        if k not in self._compiled:
            shape = untranslated(attempt.part(self._cone)).S
            self._compiled[k] = attempt.solver.compile(VelocityProgram(_matrix(unknowns), shape))
        compiled = self._compiled[k]
        if attempt.polish and start.any():
            compiled.z = start[unknowns.unknowns]

        def solve(linear: np.ndarray, C: ConvexSet) -> Answer:
            c, shape = untranslated(C)
            return compiled(linear if shape is C else linear - c, shape)

        return refined(self._inclusion, unknowns, solve, term, attempt.part(S), self._tol)


class ClosedForm:
    """z = M^-1 (P_S(q) - q) for a diagonal M and a set whose projection is that in M's metric."""

    at_rest = "closed form"

    def __init__(
        self, inclusion: Inclusion, unknowns: Unknowns, cone: ConvexSet, tol: float
    ) -> None:
        self._inclusion, self._unknowns, self._cone, self._tol = inclusion, unknowns, cone, tol

    @staticmethod
    def applies(M: Factor, C: ConvexSet) -> bool:
        """Whether M is diagonal and the projection in its metric is C's own (box, uniform ball)."""
        return C.exact and M.is_diagonal and np.array_equal(C.weights(M.diagonal), M.diagonal)

    def serves(self, C: ConvexSet) -> bool:
        """Whether the formula holds for C."""
        return self._cone is C or self._cone.same_cone(C)

    def __call__(self, term: LinearTerm, S: ConvexSet, rest: Rest) -> Velocity:
        M, velocity = _matrix(self._unknowns), None
        if M is self._inclusion.M:  # of all unknowns: without the loop that refines
            pair, size = self._pair(term.force, S), euclidean(term.force / M.root)
            outside = M.diagonal * pair.z
            if is_near(outside, term.q, term.c + S.anchor) and rest.holds(term, self._tol):
                return at_rest(term.q, self.at_rest)
            velocity = self._inclusion.certify(term, pair, self._tol, size=size)
        if velocity is None or not velocity.relative <= self._tol:
            velocity = refined(self._inclusion, self._unknowns, self._pair, term, S, self._tol)
        return velocity._replace(solver="closed form")

    def _pair(self, linear: np.ndarray, S: ConvexSet) -> Proposal:
        z = 0.0 - S.normal(linear) / _matrix(self._unknowns).diagonal
        return Proposal(z, S.project(linear), self._unknowns.unknowns)


def _matrix(unknowns: Unknowns) -> Factor:
    assert unknowns.N is not None  # None is a linear system, which has no cascade
    return unknowns.N


def compiled(
    inclusion: Inclusion, factors: Factors, on_few: bool, S: ConvexSet, solver: Any, tol: float
) -> Cascade | ClosedForm:
    """What solves the programs of one cone."""
    unknowns: Unknowns = factors.few if on_few else factors.all
    if solver == "auto" and ClosedForm.applies(_matrix(unknowns), S):
        return ClosedForm(inclusion, unknowns, S, tol)
    return Cascade(inclusion, attempts(solver, factors, on_few, S, tol), S, tol)
