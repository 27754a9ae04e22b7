"""Iterative refinement: the residual of an answer is the linear term of the next program.

A solver sees rounded numbers: M = A + gamma B, q = B u and, where most unknowns are eliminated, the
matrix N and a linear term that come out of factors. Of its answer z the residual

    r = A z + B (u + gamma z) - c

is computed in twice the precision, and z + dz solves the inclusion if dz solves the program with M
for its matrix and r - M z for its linear term. So do M's errors leave the answer, as those of
a factorisation leave the solution of linear equations.

For C = c + E^T S, E selecting few unknowns, zeta = E z solves a small program with the matrix
N = (E M^-1 E^T)^-1, the linear term N E M^-1 (q - c) and the set S; then z = M^-1 (c - q + E^T w)
with w = N zeta + N E M^-1 (q - c) (MATH.md section 5). For a residual of some z in place of q - c
the same program gives the change of z.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import is_finite
from sweepopt.linalg import Factor
from sweepopt.sets import ConvexSet
from sweepopt.velocity.certificate import (
    Inclusion,
    Instance,
    Proposal,
    Velocity,
    pair_near,
    unsolved,
)
from sweepopt.velocity.solvers import Answer

REFINEMENTS = 20  # each leaves a share |M^-1 (A + gamma B - M)| of the error; most need one
SOLVED = {"Solved", "solved", "optimal"}  # how Clarabel, OSQP and cvxpy call it
AnswerOf = Callable[[np.ndarray, ConvexSet], Answer]
Propose = Callable[[np.ndarray, np.ndarray | None], Proposal]
"""From the residual of a z, None for 0, to a better pair; its gap is nan where it has no proof."""


def refined(inclusion: Inclusion, propose: Propose, of: Instance, tol: float) -> Velocity:
    """The velocity of a solver, refined as long as its certificate is above `tol` and falls."""
    best, residual, z, iterations = unsolved(of), of.force, None, 0
    for _ in range(1 + REFINEMENTS):
        pair = propose(residual, z)
        iterations += pair.iterations
        velocity = inclusion.certify(of, pair, tol)
        falls = velocity.certificate <= 0.5 * best.certificate
        if not velocity.relative >= best.relative:
            best = velocity
        if best.relative <= tol or not falls:
            break
        z = pair.z
        residual = inclusion.exact_residual(of, z)
    return best._replace(iterations=iterations)


def by_program(M: Factor, solve: AnswerOf, S: ConvexSet, tol: float) -> Propose:
    """The program of the unknowns that M keeps, as a solver answers it."""
    few, N = M.unknowns, M.small

    def propose(residual: np.ndarray, z: np.ndarray | None) -> Proposal:
        forward, force, size = M.reduce(-residual)
        linear = -force if z is None else N.precisely(-z[few], -force)
        answer = solve(linear, S)
        usable = is_finite(answer.z)
        pair = pair_near(N, linear, S, answer.z, tol) if usable else None
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


def with_forces_at_rest(N: Factor, q: np.ndarray, S: ConvexSet, pair: Proposal) -> Proposal:
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

    def propose(residual: np.ndarray, z: np.ndarray | None) -> Proposal:
        change = -M.solve(residual)
        z = change if z is None else z + change
        return Proposal(z, np.zeros(z.size), size=0.0)  # no larger than |z|_M

    return propose


def by_formula(M: Factor, S: ConvexSet, tol: float) -> Propose:
    """z = M^-1 (w - q + c), w the projection on C - c in the metric of a diagonal M."""
    diagonal = M.small.diagonal
    return by_program(M, lambda q, S: Answer((S.project(q) - q) / diagonal), S, tol)
