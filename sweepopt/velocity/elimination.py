"""What costs substitutions only: a body without a set, and all unknowns beside a small program.

Where a matrix is so badly conditioned that its factors are not enough, both are refined.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sweepopt.linalg import Elimination, Factor, IterativeElimination, Precise
from sweepopt.sets import ConvexSet, Selection
from sweepopt.velocity.program import Velocity, at_rest_on, rate

ACCURATE = 1e-9  # what multigrid iterates to, and above which rounding is looked at closely
MANY = 250_000  # unknowns from which on that look, which costs three steps, is for more
REFINEMENTS = 5  # corrections of what a factorisation rounds


class Solved(NamedTuple):
    """A velocity, who found it and what was tried before."""

    velocity: Velocity
    solver: str
    iterations: int
    attempts: int


def accurate(dim: int, tol: float) -> float:
    """The share of a velocity that a bound of rounding may be without a closer look.

    There are two, that of the program and that of the state: both together stay below tol and 1e-8.
    They grow with the number of unknowns, rounding itself hardly does.
    """
    return min(ACCURATE * min(max(dim / MANY, 1.0), 4.0), 0.3 * tol)


VelocityOf = Callable[[np.ndarray, ConvexSet], Solved]
SelectedVelocity = Callable[[np.ndarray, Selection], Solved]


def linear(M: Factor, enough: float) -> VelocityOf:
    """C is a point c: M z = c - q; refined where the certificate is above `enough`."""

    def solve(q: np.ndarray, C: ConvexSet) -> Solved:
        c = C.anchor
        z = M.solve(c - q)
        best = _of_force(M, z, c, q, enough)
        for _ in range(REFINEMENTS):
            if not best.relative > enough:
                break
            z = z + M.solve(M.precisely(-z, c, -q))
            best = min(best, _of_force(M, z, c, q, enough), key=lambda one: one.relative)
        return Solved(best, "linear", 0, 1)

    return solve


def _of_force(M: Factor, z: np.ndarray, c: np.ndarray, q: np.ndarray, enough: float) -> Velocity:
    """z with M z = c - q but for rounding: both |z|_M and |M^-1 q|_M are |c - q|_{M^-1}."""
    rho, size, rounding = M.apply(z, q, -c, enough=enough)
    return rate(z, M.dual_norm_within(rho, enough * size) + rounding, size, size)


class _Load(NamedTuple):
    """The force c - q, rounded, and what it is made of: q, and -c where there is one."""

    force: np.ndarray
    missing: tuple[np.ndarray, ...]


def unless_at_rest(diagonal: np.ndarray, moving: SelectedVelocity) -> SelectedVelocity:
    """Nothing moves where q is in C: seen on all unknowns, for forces on the few round more."""

    def solve(q: np.ndarray, selection: Selection) -> Solved:
        rest = at_rest_on(q, selection, diagonal)
        return moving(q, selection) if rest is None else Solved(rest, "at rest", 0, 0)

    return solve


def eliminated(
    M: Elimination | IterativeElimination, small: VelocityOf, enough: float
) -> SelectedVelocity:
    """C = c + E^T S: the velocity of the unknowns zeta = E z solves a small program.

    N = (E M^-1 E^T)^-1, linear term N E M^-1 (q - c), set S (MATH.md section 5). From zeta the
    force w = N (zeta + E M^-1 (q - c)) gives z = M^-1 (c - q + E^T w), whose E z is zeta: z
    misses the inclusion by what zeta misses it, in the same norm, plus rounding. `small` is the
    velocity for the matrix N.

    Where M is so badly conditioned that the certificate is above `enough`, the residual
    r = c - q - M z, rounded once, frames the program of the correction: that for zeta again, with
    N zeta - N E M^-1 r for its linear term, as iterative refinement does for linear equations.
    """
    return _Eliminated(M, small, enough)


class _Eliminated:
    def __init__(
        self, M: Elimination | IterativeElimination, small: VelocityOf, enough: float
    ) -> None:
        self._M, self._small, self._enough = M, small, enough

    def __call__(self, q: np.ndarray, selection: Selection) -> Solved:
        M, few, shift = self._M, self._M.unknowns, selection.shift
        load = _Load(-q, (q,)) if shift is None else _Load(shift - q, (q, -shift))
        forward, pull = M.reduce(load.force)
        size_q, linear = M.size(forward), -pull
        solved = self._small(linear, selection.part)
        zeta = solved.velocity.z
        z = M.recover(forward, M.N @ zeta)
        z[few] = zeta  # to the last bit: stuck is 0.0
        best = self._proven(z, solved, load, linear, size_q)
        for _ in range(REFINEMENTS):
            # nan: no proof, nothing to compare; above 1 there is nothing to refine
            if not self._enough < best.velocity.relative < 1:
                break
            forward, pull = M.reduce(-M.precisely(z, *load.missing))
            linear = self._precisely(-zeta, -pull)
            solved = self._small(linear, selection.part)
            z = z + M.recover(forward, M.N @ (solved.velocity.z - zeta))
            z[few] = zeta = solved.velocity.z
            refined = self._proven(z, solved, load, linear, size_q)
            best = min(best, refined, key=lambda one: one.velocity.relative)
        return best

    @cached_property
    def _precisely(self) -> Precise:
        """(zeta, *more) -> N zeta + the others, rounded once."""
        return Precise(self._M.N)

    def _proven(
        self, z: np.ndarray, solved: Solved, load: _Load, linear: np.ndarray, size_q: float
    ) -> Solved:
        """What was solved for zeta as the answer z, with what all of z misses."""
        M, few = self._M, self._M.unknowns
        force, zeta = load.force, z[few]
        pull = M.N @ zeta + linear
        size_z = math.sqrt(abs(z.dot(force) + zeta.dot(pull)))
        rounding = 2 * M.rounding(z, force)  # of M z, and of N zeta, which is less
        if rounding <= self._enough * size_z:
            rho = M.M @ z - force
            rho[few] -= pull
        else:
            on_few, lost = np.zeros_like(z), np.zeros_like(z)
            on_few[few] = self._precisely(zeta, linear)
            lost[few] = self._precisely(zeta, linear, -on_few[few])
            rho = M.precisely(z, *load.missing, -on_few, -lost)
            rounding *= M.precisely.share
        missed = M.dual_norm_within(rho, self._enough * size_z) + rounding
        # N is made of rounded factors
        certificate = M.margin * solved.velocity.certificate + missed
        return solved._replace(velocity=rate(z, certificate, size_z, size_q))
