"""A program is solved: by the first solver whose velocity, refined, meets the tolerance.

A solver fails on the one step in a thousand that another takes with ease: Newton steps from its
answer and the other solvers stand behind it. The certificate judges them all alike.

The residual of an answer is the linear term of the next program (iterative refinement). A solver
sees rounded numbers: M = A + gamma B, q = B u and, where most unknowns are eliminated, the matrix N
and a linear term that come out of factors. Of its answer z the residual

    r = A z + B (u + gamma z) - c

is computed in twice the precision, and z + dz solves the inclusion if dz solves the program with M
for its matrix and r - M z for its linear term. So do M's errors leave the answer, as those of
a factorisation leave the solution of linear equations.

For C = c + E^T S, E selecting few unknowns, zeta = E z solves a small program with the matrix
N = (E M^-1 E^T)^-1, the linear term N E M^-1 (q - c) and the set S; then z = M^-1 (c - q + E^T w)
with w = N zeta + N E M^-1 (q - c) (MATH.md section 5). For a residual of some z in place of q - c
the same program gives the change of z.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Array
from sweepopt.errors import TouchingError
from sweepopt.linalg import Elimination, Factor
from sweepopt.sets import Balls, Box, ConvexSet, shape_of
from sweepopt.velocity.certificate import (
    CLOSED_FORM,
    Inclusion,
    Instance,
    Proposal,
    Velocity,
    at_rest,
    pair_near,
    unsolved,
)
from sweepopt.velocity.program import VelocityProgram
from sweepopt.velocity.solvers import NEWTON, Answer, Small, Solve, Solver, choose

SOLVED = {"Solved", "solved", "optimal"}  # how Clarabel, OSQP and cvxpy call it
AnswerOf = Callable[[Array, ConvexSet], Answer]
Propose = Callable[[Array, Array | None], Proposal]
"""From the residual of a z, None for 0, to a better pair; its gap is nan where it has no proof."""


# ---- iterative refinement ----------------------------------------------------------------------


def refined(inclusion: Inclusion, propose: Propose, of: Instance, tol: float) -> Velocity:
    """The velocity of a solver, refined as long as its certificate is above `tol` and halved.

    Each refinement leaves a share |M^-1 (A + gamma B - M)| of the error; most need one.
    """
    best, residual, z, iterations = unsolved(of), of.force, None, 0
    before = math.inf
    while True:
        pair = propose(residual, z)
        iterations += pair.iterations
        velocity = inclusion.certify(of, pair, tol)
        halved, before = velocity.certificate < 0.5 * before, velocity.certificate
        if not velocity.relative >= best.relative:
            best = velocity
        if best.relative <= tol or not halved:
            return best._replace(iterations=iterations)
        z = pair.z
        residual = inclusion.exact_residual(of, z)


def by_program(M: Factor, solve: AnswerOf, S: ConvexSet, tol: float) -> Propose:
    """The program of the unknowns that M keeps, as a solver answers it."""
    few, N = M.unknowns, M.small

    def propose(residual: Array, z: Array | None) -> Proposal:
        forward, force, size = M.reduce(-residual)
        linear = -force if z is None else N.precisely(-z[few], -force)
        answer = solve(linear, S)
        usable = math.isfinite(answer.z.dot(answer.z))
        known = answer.w if z is None else None  # a refined z needs N z + linear more sharply
        pair = None
        unproved = tol == math.inf  # no solver is a proof
        if answer.w is not None and answer.normal and (unproved or answer.perturbation < math.inf):
            bound = 0.0 if unproved else answer.perturbation
            pair = Proposal(answer.z, answer.w, 0.0, bound, size)
        elif usable:
            pair = pair_near(N, linear, S, answer.z, tol, size, known)
        if pair is None:
            nothing, believed = np.zeros_like(linear), usable and answer.status in SOLVED
            # of a set without proof; inf is a proof that rounding hides
            gap = math.nan if believed and not S.certifiable else math.inf
            pair = Proposal(answer.z if usable else nothing, nothing, gap)
        if z is None:
            z = M.recover(forward, pair.z)
        else:
            size = None  # of the residual, not of q - c
            pair = with_forces_at_rest(N, linear, S, pair)
            z = z + M.recover(forward, pair.z - z[few])
        w = np.zeros(z.size)
        z[few], w[few] = pair.z, pair.w  # to the last bit: stuck is 0.0
        perturbation = pair.perturbation and M.margin * pair.perturbation
        return Proposal(z, w, pair.gap, perturbation, size, answer.iterations)

    return propose


def with_forces_at_rest(N: Factor, q: Array, S: ConvexSet, pair: Proposal) -> Proposal:
    """The pair with the forces w at rest that leave the least residual, if S has them.

    What z rounds, dz, leaves a residual N_mm dz on the unknowns m that move. With the forces of z
    itself at rest there is no other, and |.|_{N^-1} of it can be cond(N) times |dz|_N; with those
    of z - dz it is |dz|_N. A w of S that differs only where z = 0 is as normal as the pair's.
    """
    rest = pair.z == 0
    if not rest.any() or sp.issparse(N.M) or pair.perturbation:
        return pair
    residual, moves = N.precisely(pair.z, q, -pair.w), ~rest
    dz = np.linalg.solve(N.M[np.ix_(moves, moves)], residual[moves])
    w = pair.w.copy()
    w[rest] += residual[rest] - N.M[np.ix_(rest, moves)] @ dz
    w = S.project(w)
    return pair._replace(w=w) if np.array_equal(w[moves], pair.w[moves]) else pair


def by_solve(M: Factor) -> Propose:
    """The solution of the linear system that is left where C is a point."""

    def propose(residual: Array, z: Array | None) -> Proposal:
        change = -M.solve(residual)
        z = change if z is None else z + change
        return Proposal(z, np.zeros(z.size), size=0.0)  # no larger than |z|_M

    return propose


# ---- the cascade -------------------------------------------------------------------------------


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

    def proposals(self, inclusion: Inclusion, S: ConvexSet, best: Array, tol: float) -> Propose:
        """From residuals to the solver's normal pairs."""
        M, selection = self.body(), S.selection
        if M is not inclusion.M and selection is not None:
            S = selection.part.copy_for_run()
        if self.compiled is None:
            self.compiled = self.solver.compile(VelocityProgram(M.small, S, tol < math.inf))
        compiled = self.compiled
        start = [best[M.unknowns]] if self.from_best and best.any() else []

        def solve(q: Array, C: ConvexSet) -> Answer:
            return compiled(q, C, start.pop()) if start else compiled(q, C)

        return by_program(M, solve, S, tol)


def attempts(solver: Any, M: Factor, S: ConvexSet, tol: float, small: bool) -> list[Attempt]:
    """The solvers of a program, in the order in which they are asked.

    A program of all unknowns whose set acts on few of them has that of the few behind it, which is
    better conditioned: without it 9 hard families miss 1e-9. If `small`, those come first that
    compile next to nothing and end with a normal pair. It is for sets that are given anew at every
    time (polytopes in 3 to 8 unknowns take 1 ms in place of 6), and where nothing is to be proved
    and each length of a step has a matrix (bounds of polyhedra took 1.4 to 1.7 times as long).
    """
    solvers, selection, behind = choose(solver, S, tol), S.selection, []
    if small and solver == "auto":
        solvers = tuple(sorted(solvers, key=lambda one: not isinstance(one, Small)))
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

    Without a proof a pair that misses M z + q = w by a thousandth of the forces is no answer; right
    ones miss it by about a solver's tol, 1e-8. DAQP gave velocities of 1e15 beside the right force
    in half-spaces, with which error bounds were up to 1e27 times the error (11 of 906 random
    processes).

    Parameters
    ----------
    inclusion : Inclusion
    solver : str or Solver
        The user's choice.
    of : Instance
        Any one of the family.
    tol : float
    proved : bool
        Whether velocities are certified and refined.
    anew : bool
        Whether it takes the place of a cascade for another set.
    """

    def __init__(
        self,
        inclusion: Inclusion,
        solver: Any,
        of: Instance,
        tol: float,
        proved: bool,
        anew: bool,
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
        self._attempts = attempts(solver, M, of.S, tol, anew or not proved)
        self._at_rest = True  # of the velocity before; the first is asked whether it rests

    def serves(self, inclusion: Inclusion, S: ConvexSet) -> bool:
        """Whether its programs are those of this inclusion and this set."""
        return inclusion is self._inclusion and (self._cone is S or self._cone.same_cone(S))

    def __call__(self, of: Instance) -> Velocity:
        inclusion, tol = self._inclusion, self._tol
        if self._is_formula:
            velocity = inclusion.closed_form(of, tol)
            if velocity is not None:
                return velocity
        # what moved last mostly still does, and whether it rests costs a projection
        if not self._at_rest or not self._rests(of):
            velocity, self._at_rest = self._moving(of), False
            try:
                self._at_rest = self._may_rest(of, velocity) and self._rests(of)
            except TouchingError:  # a velocity that is known stands
                if velocity.relative == math.inf:
                    raise
            if not self._at_rest:
                return velocity
        rest = at_rest(of.q)
        return rest if self._proved else rest._replace(w=of.projection(of.force) + of.c)

    def _rests(self, of: Instance) -> bool:
        return self._inclusion.rests(of, self._tol) if self._proved else of.rests()

    def _may_rest(self, of: Instance, velocity: Velocity) -> bool:
        """Whether a body so slow may rest: |z*|_M, the distance of its force to C in |.|_{M^-1}, is
        then at most that of rounding.
        """
        M, error = self._inclusion.M, velocity.certificate if self._proved else 0.0
        return not M.norm(velocity.z) > error + M.bound_factor * of.most_at_rest / M.root.min()

    def _moving(self, of: Instance) -> Velocity:
        """By the formula of a diagonal M, or by solvers."""
        inclusion, tol = self._inclusion, self._tol
        if not self._proved:  # wrong answers show in the trajectory's residual
            nothing = unsolved(of).z
            for attempt in self._attempts:
                pair = attempt.proposals(inclusion, of.S, nothing, math.inf)(of.force, None)
                residual = inclusion.M.M.dot(pair.z) + of.force - pair.w
                most = 1e-6 * (of.force.dot(of.force) + pair.w.dot(pair.w))
                known = pair.gap < math.inf and residual.dot(residual) <= most
                if known or math.isnan(pair.gap):
                    w = pair.w + of.c if pair.gap < math.inf else None
                    return Velocity(pair.z, math.nan, math.nan, attempt.solver.name, w=w)
                attempt.compiled = None
        if self._has_formula:
            # z = M^-1 (w - q + c), w the projection on C - c in the metric of M
            diagonal = inclusion.M.small.diagonal
            propose = by_program(
                inclusion.M, lambda q, S: Answer((S.project(q) - q) / diagonal), of.S, tol
            )
            return refined(inclusion, propose, of, tol)._replace(solver=CLOSED_FORM)
        best, solver, iterations, count = unsolved(of), "none", 0, 0
        for attempt in self._attempts:
            velocity = refined(inclusion, attempt.proposals(inclusion, of.S, best.z, tol), of, tol)
            if not velocity.relative < math.inf:  # a workspace that failed is not used again
                attempt.compiled = None
            iterations += velocity.iterations
            count += 1
            if velocity.relative < best.relative or math.isnan(velocity.relative):
                if not (attempt.from_best and best.relative < math.inf):  # else it is improved
                    solver = attempt.solver.name
                best = velocity
            if not best.relative > tol or velocity.at_rounding:
                break
            if count == 1 and inclusion.rests_exactly(of):
                return at_rest(of.q)
        return best._replace(solver=solver, iterations=iterations, attempts=count, w=None)
