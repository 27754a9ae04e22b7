"""Iterative refinement: the residual of an answer is the linear term of the next program.

A solver sees rounded numbers: M = A + gamma B, q = B u and, where most unknowns are eliminated, the
matrix N and a linear term that come out of factors. Of its answer z the residual

    r = A z + B (u + gamma z) - c

is computed in twice the precision, and z + dz solves the inclusion if dz solves the program with M
for its matrix and r - M z for its linear term. So do M's errors leave the answer, as those of
a factorisation leave the solution of linear equations.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from sweepopt.checks import is_finite
from sweepopt.sets import ConvexSet
from sweepopt.velocity.certificate import Inclusion, LinearTerm, Proposal, Velocity, pair_near
from sweepopt.velocity.elimination import Unknowns
from sweepopt.velocity.solvers import Answer

REFINEMENTS = 20  # each leaves a share |M^-1 (A + gamma B - M)| of the error; most need one
SOLVED = {"Solved", "solved", "optimal"}  # how Clarabel, OSQP and cvxpy call it
Solve = Callable[[np.ndarray, ConvexSet], Answer | Proposal]


def refined(
    inclusion: Inclusion,
    unknowns: Unknowns,
    solve: Solve | None,
    term: LinearTerm,
    S: ConvexSet,
    tol: float,
) -> Velocity:
    """The velocity of a solver, refined as long as its certificate is above `tol` and falls.

    Parameters
    ----------
    unknowns : Unknowns
        Those of the program that the solver sees.
    solve : callable (linear term, S) -> Answer, optional
        None for a program of no unknowns.
    S : ConvexSet
        The set on these unknowns, without its translation.
    """
    N, few = unknowns.N, unknowns.unknowns
    z, size = np.zeros_like(term.force), None
    zeta = z[few]
    best = Velocity(z, math.inf, math.inf)
    residual, iterations = term.force, 0
    for count in range(1 + REFINEMENTS):
        forward, linear = unknowns.reduce(residual)
        if count == 0:
            size = unknowns.size(forward)
        elif N is not None:
            linear = unknowns.exact_product(-zeta, linear)
        pair = Proposal(zeta, zeta, few)  # C is a point
        if solve is not None and N is not None:
            answer = solve(linear, S)
            if isinstance(answer, Answer):
                iterations += answer.iterations
                if not is_finite(answer.z):
                    break
                near = pair_near(N, linear, S, answer.z, answer.y, tol)
                if near is None:
                    z = unknowns.recover(forward, answer.z)
                    unproven = math.nan if answer.status in SOLVED else math.inf
                    return Velocity(z, unproven, unproven, iterations=iterations)
                answer = near
            pair = answer
        change = unknowns.recover(forward, pair.z - zeta if count else pair.z)
        z = z + change if count else change
        z[few] = zeta = pair.z  # to the last bit: stuck is 0.0
        moved = inclusion.M.margin * pair.moved
        proposal = Proposal(z, pair.w, few, pair.gap, moved)
        found = inclusion.certify(term, proposal, tol, size=size)
        falls = found.certificate <= 0.5 * best.certificate
        if found.relative < best.relative:
            best = found
        if best.relative <= tol or not falls:
            break
        residual = inclusion.exact_residual(term, z)
    return best._replace(iterations=iterations)
