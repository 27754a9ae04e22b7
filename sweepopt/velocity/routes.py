"""From (q, C) to a certified velocity: the routes a plan chooses from.

A point needs a linear solve, a set on few unknowns a program for these alone or multigrid on all,
any other set the whole program.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Matrix
from sweepopt.linalg import Elimination, Factor, Multigrid, sum_error
from sweepopt.sets import ConvexSet, Selection, Translation, in_units
from sweepopt.velocity.cascade import Ladder
from sweepopt.velocity.elimination import ACCURATE, SelectedVelocity, Solved, VelocityOf, eliminated
from sweepopt.velocity.polish import judged
from sweepopt.velocity.program import (
    Velocity,
    VelocityProgram,
    closed_form,
    has_closed_form,
    untranslated,
)
from sweepopt.velocity.solvers import choose
from sweepopt.velocity.solvers.multigrid import MultigridProgram

UNEVEN = 2.0**6  # ratio of the roots of M's diagonal up to which one metric serves all entries


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
    plain = _Programmed(M, solver, tol, order)
    roots = np.exp2(np.round(np.log2(M.root)))
    if roots.max() <= UNEVEN * roots.min():
        return plain
    even = cache(lambda: _Programmed(Factor(_over(M.M, roots)), solver, tol, order))
    return _Evened(plain, even, M.diagonal, roots)


class _Programmed:
    """The velocities of one M: at rest, by formula, or by the solvers of the cone that C has.

    What is compiled is that of one cone, the last one.
    """

    def __init__(self, M: Factor, solver: Any, tol: float, order: np.ndarray | None) -> None:
        self._M, self._solver, self._tol, self._order = M, solver, tol, order
        self._ladder: Ladder | None = None
        self._has_formula = False
        self._alone: dict[tuple[int, ...], SelectedVelocity] = {}

    def __call__(self, q: np.ndarray, C: ConvexSet) -> Solved:
        translate = untranslated(C)
        c, S = translate
        ladder = self._ladder_of(S)
        if self._has_formula:
            return Solved(closed_form(self._M, q, C), "closed form", 0, 0)
        rest = ladder.program.at_rest(q, translate)
        if rest is not None:
            return Solved(rest, "at rest", 0, 0)
        return _without(self._M, self._climbed(ladder, q - c, S), q, c)

    def _ladder_of(self, shape: ConvexSet) -> Ladder:
        if self._ladder is not None and self._ladder.serves(shape):
            return self._ladder
        self._has_formula = self._solver == "auto" and has_closed_form(self._M, shape)
        self._ladder = Ladder(
            VelocityProgram(self._M, shape),
            choose(self._solver, shape),
            tol=self._tol,
            judge=judged(self._M, self._order),
        )
        return self._ladder

    def _climbed(self, ladder: Ladder, q: np.ndarray, C: ConvexSet) -> Solved:
        """The best answer of the ladder, or of the few unknowns alone: better conditioned."""
        best = ladder(q, C)
        if best.velocity.relative <= min(self._tol, ACCURATE) or not C.certifiable:
            return best
        selection = C.selection
        if selection is None:
            return best
        few = self._few(tuple(selection.unknowns))(q, selection)
        if few.velocity.relative < best.velocity.relative:
            return few._replace(attempts=best.attempts + few.attempts)
        return best

    def _few(self, unknowns: tuple[int, ...]) -> SelectedVelocity:
        if unknowns not in self._alone:
            body = Elimination(self._M.M, np.array(unknowns), self._order)
            small = programmed(Factor(body.N), "auto", min(self._tol, ACCURATE), None)
            self._alone[unknowns] = eliminated(body, small, ACCURATE)
        return self._alone[unknowns]


class _Evened:
    """As `plain`; for a set that is uneven in M in units, `roots`, in which M's diagonal is even.

    The last shape stays in these units while C is a translate of it.
    """

    def __init__(
        self,
        plain: VelocityOf,
        even: Callable[[], VelocityOf],
        diagonal: np.ndarray,
        roots: np.ndarray,
    ) -> None:
        self._plain, self._even, self._diagonal, self._roots = plain, even, diagonal, roots
        self._shape: ConvexSet | None = None
        self._changed: ConvexSet | None = None  # None too where C stays as it is

    def __call__(self, q: np.ndarray, C: ConvexSet) -> Solved:
        c, S = untranslated(C)
        changed, roots = self._in_units(S), self._roots
        if changed is None:
            return self._plain(q, C)
        found = self._even()(q / roots, Translation(changed, c / roots))
        z, certificate, relative = found.velocity
        return found._replace(velocity=Velocity(z / roots, certificate, relative))

    def _in_units(self, shape: ConvexSet) -> ConvexSet | None:
        if shape is not self._shape:
            uneven = is_uneven(shape, self._diagonal)
            self._shape = shape
            self._changed = in_units(shape, 1 / self._roots) if uneven else None
        return self._changed


def is_uneven(C: ConvexSet, diagonal: np.ndarray) -> bool:
    """Whether C has no projection in a metric near the diagonal of M: rows have their own."""
    if C.selection is not None:
        return is_uneven(C.selection.part, diagonal[C.selection.unknowns])
    weights = C.weights(diagonal) / diagonal
    return C.rows() is None and bool(weights.max() > UNEVEN**2 * weights.min())


def _over(M: Matrix, roots: np.ndarray) -> Matrix:
    """M_ij / (roots_i roots_j), powers of two."""
    if sp.issparse(M):
        inverse = sp.diags_array(1 / roots, format="csc")
        return sp.csc_array(inverse @ M @ inverse)
    return M / np.outer(roots, roots)


def _without(M: Factor, found: Solved, q: np.ndarray, c: np.ndarray) -> Solved:
    """What is found for q - c, rounded, as the answer for q and C = c + S."""
    z, certificate, relative = found.velocity
    if M.is_sharp or not 0 < relative < math.inf:
        return found
    lost = M.dual_norm_bound(sum_error(q, -c, q - c))
    velocity = Velocity(z, certificate + lost, relative * (1 + lost / certificate))
    return found._replace(velocity=velocity)
