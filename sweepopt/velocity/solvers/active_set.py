"""Active-set methods for small polyhedra: exact to rounding, no tolerance enters.

For C = { w : G w <= h } the velocity program is the projection of q on C in the M^-1 metric, in
w = M z + q

    min 1/2 |w - q|^2_{M^-1}   subject to   G w <= h.

DAQP is a dual method, here for boxes, whose only constraints are bounds: a step changes q, l and u
and starts from the active set of the step before (Arnström, Bemporad, Axehill, IEEE Trans. Automat.
Contr. 67, 2022).

The library's own is the last of the cascade, for ill-conditioned bodies. With M = L L^T and
w = q + L x it seeks the shortest x with  G L x <= h - G q,  z = L^-T x: the condition of L is the
square root of that of M. Curved sets are projected on in that metric as composed ones are.
"""

import contextlib
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec

import numpy as np
import scipy.linalg

from sweepopt.checks import HUGE, Array
from sweepopt.errors import EmptySetError, brought_by
from sweepopt.linalg import NEGLIGIBLE, dense, euclidean
from sweepopt.sets import (
    HULL,
    ROUNDING,
    ConvexSet,
    InMetric,
    Lifted,
    NoHalfspacesError,
    Polytope,
    binary,
    least_distance,
    shape_of,
)
from sweepopt.velocity.program import Answer, Small, Solve, VelocityProgram

INFINITE = 1e30  # what DAQP takes for no bound


@dataclass(frozen=True)
class DAQP(Small):
    """DAQP for small programs over boxes (needs the extra "speed").

    Parameters
    ----------
    max_dim : int
        Larger programs are left to the other solvers: the cost grows with the number of entries
        that change sides in a step, and Newton's method changes all of them at once.

    Raises
    ------
    InputError
        If max_dim is not positive.

    Examples
    --------
    >>> from sweepopt.sets import Ball, Box
    >>> DAQP().treats(Box(-1.0, 1.0)), DAQP().treats(Ball([0.0, 0.0], 1.0))
    (True, False)
    """

    # at 400 to 641 of bar, chain, tube, fretting and fault: 0.08 to 0.96 of Newton's time
    max_dim: int = 650
    name = "daqp"

    def treats(self, C: ConvexSet) -> bool:
        """Whether C is small and a box: its projection has a diagonal derivative."""
        return C.polyhedral and C.block == 1 and C.dim <= self.max_dim and C.differentiable

    def compile(self, program: VelocityProgram) -> Solve:
        """Invert M once; a call updates the linear term and the bounds."""
        with brought_by("speed"):
            import daqp
        M = program.M
        # in units of the diagonal: the method's tolerances are absolute
        root, inverse = M.root, M.inverse * np.outer(M.root, M.root)
        free, engine = np.full(M.dim, INFINITE), daqp.Model()
        no_rows, sense = np.zeros((0, M.dim)), np.zeros(M.dim, dtype=np.int32)
        engine.setup(inverse, None, no_rows, free, -free, sense)
        box: ConvexSet | None = None
        unit, above, below = 0.0, free, -free

        def solve(q: Array, C: ConvexSet) -> Answer:
            nonlocal box, unit, above, below
            q = q / root
            force = binary(np.abs(q).max())
            if C is not box or force != unit:
                box, unit = C, force
                limit = INFINITE / np.maximum(1.0, force * root * (INFINITE / HUGE))
                far = limit * force * root
                above, below = (limit * (C.project(end) / far) for end in (far, -far))
            q = q / force
            engine.update(bupper=above - q, blower=below - q)  # of w - q: no linear term
            w, _, flag, info = engine.solve()
            z = inverse.dot(w * force) / root
            status = "solved" if flag == 1 else f"failed: flag {flag}"
            force_at_z = (w + q) * (force * root)
            return Answer(z, iterations=int(info["iterations"]), status=status, w=force_at_z)

        return solve


@cache
def has_daqp() -> bool:
    """Whether DAQP is there, so that "auto" may choose it."""
    return find_spec("daqp") is not None


@dataclass(frozen=True)
class ActiveSet(Small):
    """The library's own active-set method, for small sets whose rows are known, and curved ones.

    Parameters
    ----------
    max_dim : int
        Larger programs are left to the other solvers: a row that enters costs dim^2 operations.

    Raises
    ------
    InputError
        If max_dim is not positive.

    Examples
    --------
    >>> from sweepopt.sets import Ball, Box
    >>> ActiveSet().treats(Box(-1.0, 1.0)), ActiveSet().treats(Ball([0.0, 0.0], 1.0))
    (True, True)
    """

    name = "active-set"

    def treats(self, C: ConvexSet) -> bool:
        """Whether C is small, and its rows are known or its projection has a derivative.

        Those of a polytope wait until they count.
        """
        if C.dim > self.max_dim:
            return False
        if not C.polyhedral:
            return C.exact and C.differentiable
        if isinstance(shape_of(C), Polytope):
            return C.dim <= HULL
        with contextlib.suppress(NoHalfspacesError):
            return bool(C.halfspaces())
        return False

    def compile(self, program: VelocityProgram) -> Solve:
        """Factorise M once; a call starts from no active rows."""
        M = program.M
        lower = cache(lambda: scipy.linalg.cholesky(dense(M.M), lower=True))

        def solve(q: Array, C: ConvexSet) -> Answer:
            z, corrected = np.zeros_like(q), q
            # C has points and M is positive definite: where that is not seen it is rounding, and
            # numbers that are not finite are ValueErrors; a polytope may be flat to rounding
            with contextlib.suppress(EmptySetError, NoHalfspacesError, ValueError):
                if not C.polyhedral:
                    form = C.form()
                    each = tuple(ball for S in form.parts for ball in S.factors())
                    apart = Lifted(form._replace(parts=each))  # each ball has a unit of its own
                    return Answer(InMetric(apart, dense(M.M))(q, False).z, status="solved")
                (G, h), L = C.halfspaces().inequalities(), lower()
                # three refinements of what L rounds: without them polyhedra beside jumps of 1e8 are
                # not met
                for k in range(4):
                    rounding = ROUNDING * (np.abs(h) + np.abs(G) @ np.abs(corrected))
                    shortest = least_distance(G @ L, h - G @ corrected, rounding)
                    if shortest is None:
                        break
                    x, active = shortest
                    z = scipy.linalg.solve_triangular(L, x, lower=True, trans=1)
                    if k == 3 or M.rounding(z, euclidean(q / M.root)) <= NEGLIGIBLE * euclidean(x):
                        if not program.proved:
                            y = np.linalg.lstsq(G[active].T, z)[0]
                            z = np.minimum(y, 0.0) @ G[active]  # rounding is in the cone too
                            w = corrected + L @ x
                            return Answer(z, iterations=1, status="solved", w=w, normal=True)
                        break
                    # what L L^T misses of M goes to the linear term
                    corrected = M.precisely(z, q, -(L @ (L.T @ z)))
            return Answer(z, iterations=1, status="solved")

        return solve
