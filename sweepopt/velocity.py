"""From (q, C) to a certified velocity: the routes a plan chooses from.

A point needs a linear solve, a set on few unknowns a program for these alone or multigrid on all,
any other set the whole program.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Matrix, is_finite
from sweepopt.linalg import Elimination, Factor
from sweepopt.multigrid import Multigrid
from sweepopt.polish import judged
from sweepopt.precise import sum_error
from sweepopt.program import Velocity, VelocityProgram, closed_form, has_closed_form, untranslated
from sweepopt.sets import ConvexSet
from sweepopt.sets.algebra import Translation
from sweepopt.sets.base import Selection
from sweepopt.sets.units import in_units
from sweepopt.solvers import NEWTON, Solve, Solver, choose
from sweepopt.solvers.multigrid import MultigridProgram
from sweepopt.substitution import ACCURATE, SelectedVelocity, Solved, VelocityOf, eliminated

UNEVEN = 2.0**6  # ratio of the roots of M's diagonal up to which one metric serves all entries
SOLVED = {"Solved", "solved", "optimal"}  # how Clarabel, OSQP and cvxpy call it


def iterated(M: Multigrid, contact: np.ndarray, tol: float) -> SelectedVelocity:
    """All unknowns at once by multigrid: nothing is factorised."""
    program = MultigridProgram(M, contact, min(ACCURATE, tol))

    def solve(q: np.ndarray, selection: Selection) -> Solved:
        step = program(q, selection)
        moves = step.velocity.z.any()
        return Solved(step.velocity, "multigrid" if moves else "at rest", step.cycles, 1)

    return solve


def programmed(M: Factor, solver: Any, tol: float, order: np.ndarray | None) -> VelocityOf:
    """The program of each C, in units that make the diagonal of M even where C is uneven in it."""
    plain = _programmed(M, solver, tol, order)
    roots = np.exp2(np.round(np.log2(M.root)))
    if roots.max() <= UNEVEN * roots.min():
        return plain
    even = cache(lambda: _programmed(Factor(_over(M.M, roots)), solver, tol, order))
    shape: ConvexSet | None = None
    other: ConvexSet | None = None

    def solve(q: np.ndarray, C: ConvexSet) -> Solved:
        nonlocal shape, other
        part = C.part if isinstance(C, Translation) else C
        if part is not shape:
            shape = part
            other = in_units(part, 1 / roots) if is_uneven(part, M.diagonal) else None
        if other is None:
            return plain(q, C)
        D = Translation(other, C.v / roots) if isinstance(C, Translation) else other
        found = even()(q / roots, D)
        z, certificate, relative = found.velocity
        return found._replace(velocity=Velocity(z / roots, certificate, relative))

    return solve


def is_uneven(C: ConvexSet, diagonal: np.ndarray) -> bool:
    """Whether C has no projection in a metric near the diagonal of M: rows have their own."""
    if C.selection is not None:
        return is_uneven(C.selection.part, diagonal[C.selection.unknowns])
    steps = C.steps(diagonal) / diagonal
    return C.rows() is None and bool(steps.max() > UNEVEN**2 * steps.min())


def _over(M: Matrix, roots: np.ndarray) -> Matrix:
    """M_ij / (roots_i roots_j), powers of two."""
    if sp.issparse(M):
        inverse = sp.diags_array(1 / roots, format="csc")
        return sp.csc_array(inverse @ M @ inverse)
    return M / np.outer(roots, roots)


def _programmed(M: Factor, solver: Any, tol: float, order: np.ndarray | None) -> VelocityOf:
    """One cone at a time: its formula if there is one, else its compiled ladder of solvers."""
    program: VelocityProgram | None = None
    formula = False
    rungs: list[Solver] = []
    compiled: dict[int, Solve] = {}
    judge = judged(M, order)

    @cache
    def alone(unknowns: tuple[int, ...]) -> SelectedVelocity:
        """The program of the few unknowns, where that of all of them fails."""
        body = Elimination(M.M, np.array(unknowns), order)
        return eliminated(body, programmed(Factor(body.N), "auto", min(tol, ACCURATE), None))

    def solve(q: np.ndarray, C: ConvexSet) -> Solved:
        nonlocal program, formula, rungs, judge
        shape = C.part if isinstance(C, Translation) else C
        if program is None or not (program.cone is shape or program.cone.same_cone(shape)):
            program = VelocityProgram(M, shape)
            formula = solver == "auto" and has_closed_form(M, shape)
            rungs = ladder(choose(solver, shape))
            judge = judged(M, order)
            compiled.clear()
        if formula:
            return Solved(closed_form(M, q, C), "closed form", 0, 0)
        rest = program.at_rest(q, C)
        if rest is not None:
            return Solved(rest, "at rest", 0, 0)
        moved, part = untranslated(q, C)  # the same program
        return _without(M, climbed(program, moved, part), q, C)

    def enough(relative: float, rung: Solver, C: ConvexSet) -> bool:
        """Whether tol is met: a solver is refined for a small program that no polish made exact."""
        if not relative <= tol:
            return False
        return relative <= ACCURATE or rung.refined() is None or not NEWTON.treats(C)

    def climbed(program: VelocityProgram, q: np.ndarray, C: ConvexSet) -> Solved:
        """The best answer of the ladder."""
        nothing = Velocity(np.zeros_like(q), np.inf, np.inf)
        best = Solved(nothing, "none", 0, 0)
        for attempt, rung in enumerate(rungs):
            if attempt not in compiled:
                compiled[attempt] = rung.compile(program)
            answer = compiled[attempt](q, C)
            if not C.certifiable:
                # nothing to compare: the first answer that its solver calls solved stands
                if answer.status in SOLVED:
                    velocity = program.certify(q, C, answer.z, answer.y)
                    return Solved(velocity, rung.name, answer.iterations, attempt + 1)
                del compiled[attempt]
                continue
            velocity = judge(program, q, C, answer) if is_finite(answer.z) else nothing
            if not velocity.relative <= tol:
                del compiled[attempt]  # a workspace that failed is not used again
            if velocity.relative < best.velocity.relative:
                best = Solved(velocity, rung.name, answer.iterations, attempt + 1)
            if enough(best.velocity.relative, rung, C):
                break
        if best.velocity.relative <= min(tol, ACCURATE):
            return best._replace(attempts=attempt + 1)
        # an answer that no polish made exact: the few unknowns alone are better conditioned
        selection = C.selection
        if selection is not None:
            few = alone(tuple(selection.unknowns))(q, selection)
            if few.velocity.relative < best.velocity.relative:
                return few._replace(attempts=attempt + 1 + few.attempts)
        return best._replace(attempts=attempt + 1)

    return solve


def _without(M: Factor, found: Solved, q: np.ndarray, C: ConvexSet) -> Solved:
    """What is found for q - c, rounded, as the answer for q and C = c + S."""
    z, certificate, relative = found.velocity
    if M.is_sharp or not isinstance(C, Translation) or not 0 < relative < math.inf:
        return found
    lost = M.dual_norm_bound(sum_error(q, -C.v, q - C.v))
    velocity = Velocity(z, certificate + lost, relative * (1 + lost / certificate))
    return found._replace(velocity=velocity)


def ladder(solvers: Sequence[Solver]) -> list[Solver]:
    """The first solver, its refinements, then the other solvers and theirs."""
    rungs: list[Solver] = []
    for solver in solvers:
        rung: Solver | None = solver
        while rung is not None:
            rungs.append(rung)
            rung = rung.refined()
    return rungs
