"""The velocity of one matrix A + gamma B: the method that a C(t) needs, and the solver cascade.

Where q is in C nothing moves. A point needs a linear solve, a set on few unknowns a program for
these, any other set a program for all unknowns. A program is solved by a formula where its matrix
is diagonal, else by the first solver whose velocity meets the tolerance: a solver fails on the one
step in a thousand that another takes with ease. The certificate judges them all alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np

from sweepopt.checks import Matrix
from sweepopt.linalg import Elimination, Factor, IterativeElimination, dense, eliminate, factorise
from sweepopt.problem import SweepingProcess
from sweepopt.sets import Box, ConvexSet, Selection, same_array
from sweepopt.velocity.certificate import (
    SHARE,
    Inclusion,
    LinearTerm,
    OneUnknown,
    Proposal,
    Velocity,
    at_rest,
    rests,
)
from sweepopt.velocity.elimination import AllUnknowns, FewUnknowns, NoUnknowns, Unknowns
from sweepopt.velocity.plan import Plan
from sweepopt.velocity.program import VelocityProgram, untranslated
from sweepopt.velocity.refinement import refined
from sweepopt.velocity.solvers import LAST, NEWTON, Answer, Small, Solver, choose

VelocityOf = Callable[[np.ndarray, ConvexSet], Velocity]
WRONG = 1e-2  # a larger relative certificate is that of a failure, not of a loose solver
DEFAULT_TOL = 1e-6  # what is aimed at where every answer is welcome (tol = inf)


def matrix(process: SweepingProcess, gamma: float) -> Matrix:
    """A + gamma B, rounded."""
    return process.A if process.B is None or not gamma else process.A + gamma * process.B


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


def factors(plan: Plan, M: Matrix) -> Factors:
    """What a plan needs of a matrix before any velocity."""
    contact = np.zeros(0, dtype=int) if plan.contact is None else plan.contact
    return Factors(M, contact, plan.order)


def compile_velocity(
    process: SweepingProcess, plan: Plan, gamma: float, known: Factors | None = None
) -> StateVelocity:
    """(u, C) -> the velocity z with -z in N_C(A z + B (u + gamma z)), certified.

    Parameters
    ----------
    known : Factors, optional
        Of `matrix(process, gamma)`.
    """
    known = known or factors(plan, matrix(process, gamma))
    return StateVelocity(plan, known, process.A, process.B, gamma)


def compile_projection(plan: Plan, M: Matrix) -> VelocityOf:
    """(q, C) -> the z with -z in N_C(M z + q), certified: M z + q is q projected on C."""
    return StateVelocity(plan, factors(plan, M)).of_force


class StateVelocity:
    """(u, C) -> the velocity z with -z in N_C(A z + B (u + gamma z)), certified.

    What a C needs is compiled when it comes; not to be shared by threads.

    Parameters
    ----------
    plan : Plan
    known : Factors
        Of A + gamma B, rounded.
    A, B : ndarray or sparse, shape (dim, dim), optional
    gamma : float
    """

    def __init__(
        self,
        plan: Plan,
        known: Factors,
        A: Matrix | None = None,
        B: Matrix | None = None,
        gamma: float = 0.0,
    ) -> None:
        self._factors, self._B, self._data = known, B, (A, B, gamma)
        self._solver = plan.solver
        self._tol = plan.tol if math.isfinite(plan.tol) else DEFAULT_TOL
        self._few: Cascade | ClosedForm | None = None
        self._all: Cascade | ClosedForm | None = None
        self._one: tuple[ConvexSet, OneUnknown | None] | None = None

    def __call__(self, u: np.ndarray, C: ConvexSet) -> Velocity:
        if u.size == 1 and self._solver == "auto":
            velocity = self._of_one(u, C)
            if velocity is not None:
                return velocity
        if self._B is None:
            return self._of_force(np.zeros_like(u), None, C)
        return self._of_force(self._B.dot(u), u, C)

    def of_force(self, q: np.ndarray, C: ConvexSet) -> Velocity:
        """The z with -z in N_C(M z + q): of a linear term that is given, and of M as it is."""
        return self._of_force(q, None, C)

    def _of_one(self, u: np.ndarray, C: ConvexSet) -> Velocity | None:
        """One unknown in an interval, in plain numbers."""
        c, S = untranslated(C)
        if self._one is None or self._one[0] is not S:
            B = 0.0 if self._B is None else float(dense(self._B)[0, 0])
            treated = isinstance(S, Box) and not S.singleton
            self._one = S, OneUnknown(self._on_all, B, S, self._tol) if treated else None
        velocity = self._one[1]
        return None if velocity is None else velocity(float(u[0]), float(c[0]))

    def _of_force(self, q: np.ndarray, u: np.ndarray | None, C: ConvexSet) -> Velocity:
        if C.singleton:
            return self._linear(q, u, C)
        contact, selection = self._factors.contact, C.selection
        if selection is not None and same_array(selection.unknowns, contact):
            return self._of_few(q, u, selection)
        c, S = untranslated(C)
        if self._all is None or not self._all.serves(S):
            self._all = compiled(self._on_all, self._factors, False, S, self._solver, self._tol)
        diagonal = self._factors.whole.diagonal
        rest = Rest(self._on_all, u, lambda force: rests(force, c, S, selection, diagonal))
        return self._moving(self._all, LinearTerm(q - c, q, c, u), S, rest)

    def _of_few(self, q: np.ndarray, u: np.ndarray | None, selection: Selection) -> Velocity:
        S, shift = selection.part, selection.shift
        c, shape = np.zeros_like(q) if shift is None else shift, untranslated(S).S
        if self._few is None or not self._few.serves(shape):
            self._few = compiled(self._on_few, self._factors, True, shape, self._solver, self._tol)
        diagonal = self._factors.elimination.diagonal
        rest = Rest(self._on_few, u, lambda force: rests(force, c, S, selection, diagonal))
        return self._moving(self._few, LinearTerm(q - c, q, c, u), S, rest)

    def _moving(
        self, solve: Cascade | ClosedForm, term: LinearTerm, S: ConvexSet, rest: Rest
    ) -> Velocity:
        if rest.holds(term, self._tol):
            return at_rest(term.q, solve.at_rest)
        return solve(term, S, rest)

    def _linear(self, q: np.ndarray, u: np.ndarray | None, C: ConvexSet) -> Velocity:
        c = C.anchor
        term, unknowns = LinearTerm(q - c, q, c, u), NoUnknowns(self._factors.whole)
        velocity = refined(self._on_all, unknowns, None, term, C, self._tol)
        return velocity._replace(solver="linear", attempts=1)

    @cached_property
    def _on_all(self) -> Inclusion:
        return Inclusion(self._factors.whole, *self._data)

    @cached_property
    def _on_few(self) -> Inclusion:
        return Inclusion(self._factors.elimination, *self._data)


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
    program: Callable[[], Unknowns] = lambda: factors.few if on_few else factors.all
    few, part, selection = program, S, S.selection
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
                name = (
                    best.solver if attempt.polish and best.solver != "none" else attempt.solver.name
                )
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
            self._compiled[k] = attempt.solver.compile(VelocityProgram(unknowns.N, shape))
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
        velocity = refined(self._inclusion, self._unknowns, self._pair, term, S, self._tol)
        return velocity._replace(solver="closed form")

    def _pair(self, linear: np.ndarray, S: ConvexSet) -> Proposal:
        z = 0.0 - S.normal(linear) / self._unknowns.N.diagonal
        return Proposal(z, S.project(linear), self._unknowns.unknowns)


def compiled(
    inclusion: Inclusion, factors: Factors, on_few: bool, S: ConvexSet, solver: Any, tol: float
) -> Cascade | ClosedForm:
    """What solves the programs of one cone."""
    unknowns: Unknowns = factors.few if on_few else factors.all
    if solver == "auto" and ClosedForm.applies(unknowns.N, S):
        return ClosedForm(inclusion, unknowns, S, tol)
    return Cascade(inclusion, attempts(solver, factors, on_few, S, tol), S, tol)
