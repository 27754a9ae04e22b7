"""The polish: any answer is moved to one that is exact but for rounding, if that is better.

Newton steps on sets whose projection has a derivative, an active set on small polyhedra where there
is none or rounding is too much for it; both on the unknowns that the set acts on, with all others
eliminated.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial

import numpy as np

from sweepopt.linalg import Elimination, Factor
from sweepopt.sets import ConvexSet, same_array
from sweepopt.velocity.elimination import ACCURATE, SelectedVelocity, Solved, VelocityOf, eliminated
from sweepopt.velocity.program import POLISHED, Velocity, VelocityProgram
from sweepopt.velocity.solvers import LAST, NEWTON, Answer
from sweepopt.velocity.solvers.newton import Iteration

ENOUGH = 1e-11  # what a polish is called for again: its certificate counts rounding that is there
ROUGH = 1e-2  # relative certificate above which an answer is wrong, and no polish is called for
Judge = Callable[[VelocityProgram, np.ndarray, ConvexSet, Answer], Velocity]


def judged(M: Factor, order: np.ndarray | None) -> Judge:
    """Certify an answer, polished if that is better; who needed it last is polished at once."""
    polish = _Polish(M, order)
    needed = False

    def judge(program: VelocityProgram, q: np.ndarray, C: ConvexSet, answer: Answer) -> Velocity:
        nonlocal needed
        raw = None if needed else program.certify(q, C, answer.z, answer.y)
        if raw is not None and raw.relative <= POLISHED:
            return raw
        better = polish(q, C, answer.z)
        needed = better is not None and better.relative <= ENOUGH
        if better is not None and needed:
            return better
        raw = raw or program.certify(q, C, answer.z, answer.y)
        return raw if better is None or raw.relative <= better.relative else better

    return judge


class _Polish:
    """(q, C, z) -> the velocity of exact steps from z; None where they do not apply."""

    def __init__(self, M: Factor, order: np.ndarray | None) -> None:
        self._M, self._order = M, order
        self._start = np.zeros(0)
        self._elimination: Elimination | None = None
        self._selected: SelectedVelocity | None = None
        self._whole: VelocityOf | None = None
        # C as it is; one cone comes here, and to look at it may cost
        self._treated: bool | None = None

    def __call__(self, q: np.ndarray, C: ConvexSet, z: np.ndarray) -> Velocity | None:
        selection = C.selection
        if selection is None or not _treats(selection.part):
            self._treated = _treats(C) if self._treated is None else self._treated
            if not self._treated:
                return None
            self._start, self._whole = z, self._whole or self._exact(self._M, C)
            return self._whole(q, C).velocity
        few, body = selection.unknowns, self._elimination
        if body is None or self._selected is None or not same_array(few, body.unknowns):
            body = self._elimination = Elimination(self._M.M, few, self._order)
            small = self._exact(Factor(body.N), selection.part)
            self._selected = eliminated(body, small, ACCURATE)
        self._start = z[few]
        return self._selected(q, selection).velocity

    def _exact(self, N: Factor, cone: ConvexSet) -> VelocityOf:
        ways = [
            cache(partial(way, N, cone))  # compiled where the way before is not enough
            for method, way in ((NEWTON, self._newton), (LAST, self._active_set))
            if method.treats(cone)
        ]

        def solve(q: np.ndarray, C: ConvexSet) -> Solved:
            best = ways[0]()(q, C)
            for way in ways[1:]:
                if not best.velocity.relative <= ACCURATE:
                    best = min(best, way()(q, C), key=lambda one: one.velocity.relative)
            return best

        return solve

    def _newton(self, N: Factor, cone: ConvexSet) -> VelocityOf:
        program, iterate = VelocityProgram(N, cone), Iteration(N)

        def solve(q: np.ndarray, C: ConvexSet) -> Solved:
            z = self._start
            for limit in (1, NEWTON.max_iter):  # one step is enough from a good answer
                z, iterations = iterate(q, C, z, limit)
                velocity = program.certify(q, C, z, np.zeros(C.offsets.size))
                if velocity.relative <= POLISHED:
                    break
            return Solved(velocity, NEWTON.name, iterations, 1)

        return solve

    def _active_set(self, N: Factor, cone: ConvexSet) -> VelocityOf:
        program = VelocityProgram(N, cone)
        compiled = LAST.compile(program)

        def solve(q: np.ndarray, C: ConvexSet) -> Solved:
            rough = program.certify(q, C, self._start, np.zeros(C.offsets.size))
            if not rough.relative <= ROUGH:
                return Solved(rough, LAST.name, 0, 1)
            answer = compiled(q, C)
            velocity = program.certify(q, C, answer.z, answer.y)
            return Solved(velocity, LAST.name, answer.iterations, 1)

        return solve


def _treats(C: ConvexSet) -> bool:
    return NEWTON.treats(C) or LAST.treats(C)
