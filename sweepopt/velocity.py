"""From (q, C) to a certified velocity: the routes a plan chooses from.

A point needs a linear solve, a set on few unknowns a program for these alone or multigrid on all,
any other set the whole program.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from sweepopt.linalg import Elimination, Factor, dense, euclidean
from sweepopt.multigrid import Multigrid
from sweepopt.program import (
    POLISHED,
    Velocity,
    VelocityProgram,
    closed_form,
    has_closed_form,
    rate,
    untranslated,
)
from sweepopt.sets import ConvexSet
from sweepopt.sets.algebra import Translation
from sweepopt.sets.base import Selection, same_array
from sweepopt.solvers import NEWTON, Answer, Solve, Solver, choose
from sweepopt.solvers.multigrid import MultigridProgram
from sweepopt.solvers.newton import Iteration

ACCURATE = 1e-9  # what multigrid iterates to, and above which rounding is looked at closely
SOLVED = {"Solved", "solved", "optimal"}  # how Clarabel, OSQP and cvxpy call it


class Solved(NamedTuple):
    """A velocity, who found it and what was tried before."""

    velocity: Velocity
    solver: str
    iterations: int
    attempts: int


VelocityOf = Callable[[np.ndarray, ConvexSet], Solved]
SelectedVelocity = Callable[[np.ndarray, Selection], Solved]
Polish = Callable[[np.ndarray, ConvexSet, np.ndarray], Velocity | None]


def linear(M: Factor) -> VelocityOf:
    """C is a point c: M z = c - q."""

    def solve(q: np.ndarray, C: ConvexSet) -> Solved:
        force = C.anchor - q
        z = M.solve(force)
        size = math.sqrt(abs(force.dot(z)))  # both |z|_M and |M^-1 q|_M
        rounding = M.dual_norm_within(M.M @ z - force, ACCURATE * size)
        velocity = rate(z, rounding, size, size)
        return Solved(velocity, "linear", 0, 1)

    return solve


def eliminated(M: Elimination, small: VelocityOf) -> SelectedVelocity:
    """C = c + E^T S: the velocity of the unknowns zeta = E z solves a small program.

    N = (E M^-1 E^T)^-1, linear term N E M^-1 (q - c), set S (MATH.md section 5). From zeta the
    force w = N (zeta + E M^-1 (q - c)) gives z = M^-1 (c - q + E^T w), whose E z is zeta: z
    misses the inclusion by what zeta misses it, in the same norm, plus rounding. `small` is the
    velocity for the matrix N.
    """

    def solve(q: np.ndarray, selection: Selection) -> Solved:
        force = -q if selection.shift is None else selection.shift - q
        forward, pull = M.reduce(force)
        size_q = euclidean(forward)
        solved = small(-pull, selection.part)
        zeta = solved.velocity.z
        total = M.N @ zeta
        z = M.recover(forward, total)
        z[M.unknowns] = zeta  # to the last bit: stuck is 0.0
        force[M.unknowns] += total - pull
        size_z = math.sqrt(abs(force.dot(z)))
        rounding = M.dual_norm_within(M.M @ z - force, ACCURATE * size_z)
        certificate = solved.velocity.certificate + rounding
        velocity = rate(z, certificate, size_z, size_q)
        return Solved(velocity, solved.solver, solved.iterations, solved.attempts)

    return solve


def iterated(M: Multigrid, contact: np.ndarray, tol: float) -> SelectedVelocity:
    """All unknowns at once by multigrid: nothing is factorised."""
    program = MultigridProgram(M, contact, min(ACCURATE, tol))

    def solve(q: np.ndarray, selection: Selection) -> Solved:
        step = program(q, selection)
        moves = step.velocity.z.any()
        return Solved(step.velocity, "multigrid" if moves else "at rest", step.cycles, 1)

    return solve


def programmed(M: Factor, solver: Any, tol: float, order: np.ndarray | None) -> VelocityOf:
    """One cone at a time: its formula if there is one, else its compiled ladder of solvers."""
    program: VelocityProgram | None = None
    formula = False
    rungs: list[Solver] = []
    compiled: dict[int, Solve] = {}
    judge = _judge(cache(lambda: polisher(M, order)))

    def solve(q: np.ndarray, C: ConvexSet) -> Solved:
        nonlocal program, formula, rungs
        shape = C.part if isinstance(C, Translation) else C
        if program is None or not (program.cone is shape or program.cone.same_cone(shape)):
            program = VelocityProgram(M, shape)
            formula = solver == "auto" and has_closed_form(M, shape)
            rungs = ladder(choose(solver, shape))
            compiled.clear()
        if formula:
            return Solved(closed_form(M, q, C), "closed form", 0, 0)
        rest = program.at_rest(q, C)
        if rest is not None:
            return Solved(rest, "at rest", 0, 0)
        q, C = untranslated(q, C)  # the same program
        best = Solved(Velocity(np.zeros_like(q), np.inf, np.inf), "none", 0, 0)
        for attempt, rung in enumerate(rungs):
            if attempt not in compiled:
                compiled[attempt] = rung.compile(program)
            answer = compiled[attempt](q, C)
            if not C.certifiable:
                # nothing to compare: the first answer that its solver calls solved stands
                if answer.status in SOLVED:
                    velocity = program.certify(q, C, answer.z, answer.y)
                    return Solved(velocity, rung.name, answer.iterations, attempt + 1)
                continue
            velocity = judge(program, q, C, answer)
            found = Solved(velocity, rung.name, answer.iterations, attempt + 1)
            if found.velocity.relative < best.velocity.relative:
                best = found
            if best.velocity.relative <= tol:
                break
        return best._replace(attempts=attempt + 1)

    return solve


def _judge(
    polish: Callable[[], Polish],
) -> Callable[[VelocityProgram, np.ndarray, ConvexSet, Answer], Velocity]:
    """Certify an answer, polished if that is better; who needed it last is polished at once."""
    needed = False

    def judge(program: VelocityProgram, q: np.ndarray, C: ConvexSet, answer: Answer) -> Velocity:
        nonlocal needed
        raw = None if needed else program.certify(q, C, answer.z, answer.y)
        if raw is not None and raw.relative <= POLISHED:
            return raw
        better = polish()(q, C, answer.z)
        needed = better is not None and better.relative <= POLISHED
        if better is not None and needed:
            return better
        raw = raw or program.certify(q, C, answer.z, answer.y)
        return raw if better is None or raw.relative <= better.relative else better

    return judge


def polisher(M: Factor, order: np.ndarray | None) -> Polish:
    """(q, C, z) -> the velocity of Newton steps from z; None where they do not apply.

    They are taken on the unknowns that the set acts on, all others are eliminated.
    """
    start = np.zeros(0)
    elimination: Elimination | None = None
    selected: SelectedVelocity | None = None

    def newton(N: Factor, cone: ConvexSet) -> VelocityOf:
        program, iterate = VelocityProgram(N, cone), Iteration(dense(N.M))

        def solve(q: np.ndarray, C: ConvexSet) -> Solved:
            z = start
            for limit in (1, NEWTON.max_iter):  # one step is enough from a good answer
                z, iterations = iterate(q, C, z, limit)
                velocity = program.certify(q, C, z, np.zeros(C.offsets.size))
                if velocity.relative <= POLISHED:
                    break
            return Solved(velocity, NEWTON.name, iterations, 1)

        return solve

    whole: VelocityOf | None = None

    def polish(q: np.ndarray, C: ConvexSet, z: np.ndarray) -> Velocity | None:
        nonlocal start, elimination, selected, whole
        selection = C.selection
        if selection is None or not NEWTON.treats(selection.part):
            if not NEWTON.treats(C):
                return None
            start, whole = z, whole or newton(M, C)
            return whole(q, C).velocity
        few = selection.unknowns
        if elimination is None or selected is None or not same_array(few, elimination.unknowns):
            elimination = Elimination(M.M, few, order)
            selected = eliminated(elimination, newton(Factor(elimination.N), selection.part))
        start = z[few]
        return selected(q, selection).velocity

    return polish


def ladder(solvers: Sequence[Solver]) -> list[Solver]:
    """The first solver, its refinements, then the other solvers and theirs."""
    rungs: list[Solver] = []
    for solver in solvers:
        rung: Solver | None = solver
        while rung is not None:
            rungs.append(rung)
            rung = rung.refined()
    return rungs
