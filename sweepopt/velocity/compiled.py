"""The velocity of one matrix A + gamma B: rest, and the method that a C(t) needs.

Where q is in C nothing moves. A point needs a linear solve, a set on few unknowns a program for
these, any other set a program for all unknowns. A program is solved by a formula where its matrix
is diagonal, else by the solvers of `cascade.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property

import numpy as np

from sweepopt.checks import Matrix
from sweepopt.linalg import dense
from sweepopt.problem import SweepingProcess
from sweepopt.sets import Box, ConvexSet, Selection, same_array
from sweepopt.velocity.cascade import Cascade, ClosedForm, Factors, Rest, compiled
from sweepopt.velocity.certificate import (
    Inclusion,
    LinearTerm,
    OneUnknown,
    Velocity,
    at_rest,
    rests,
)
from sweepopt.velocity.elimination import NoUnknowns
from sweepopt.velocity.plan import Plan
from sweepopt.velocity.program import untranslated
from sweepopt.velocity.refinement import refined

VelocityOf = Callable[[np.ndarray, ConvexSet], Velocity]
DEFAULT_TOL = 1e-6  # what is aimed at where every answer is welcome (tol = inf)


def matrix(process: SweepingProcess, gamma: float) -> Matrix:
    """A + gamma B, rounded."""
    return process.A if process.B is None or not gamma else process.A + gamma * process.B


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
            formula = None
            if isinstance(S, Box) and not S.singleton:
                formula = OneUnknown(self._on_all, B, S, self._tol)
            self._one = S, formula
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
