"""Active-set methods for small polyhedra: exact to rounding, no tolerance enters.

For C = { w : G w <= h } the velocity program is the projection of q on C in the M^-1 metric, in
w = M z + q

    min 1/2 |w - q|^2_{M^-1}   subject to   G w <= h.

DAQP is a dual method, here for boxes, whose only constraints are bounds: a step changes q, l and u
and starts from the active set of the step before (Arnström, Bemporad, Axehill, IEEE Trans. Automat.
Contr. 67, 2022).

The library's own is the last of the cascade, for ill-conditioned bodies. With M = L L^T and
w = q + L x it seeks the shortest x with  G L x <= h - G q,  z = L^-T x: the condition of L is the
square root of that of M. Balls are met by half-spaces that touch them.
"""

import contextlib
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np
import scipy.linalg

from sweepopt.checks import HUGE, Array
from sweepopt.errors import EmptySetError, brought_by
from sweepopt.linalg import NEGLIGIBLE, dense, euclidean
from sweepopt.sets import (
    HULL,
    ROUNDING,
    Aligned,
    Balls,
    ConvexSet,
    NoHalfspacesError,
    Polytope,
    binary,
    least_distance,
    placed,
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
    """The library's own active-set method, for small sets whose rows are known, and for balls.

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
        """Whether C is small and its rows are known; those of a polytope wait until they count."""
        if C.dim > self.max_dim:
            return False
        if isinstance(shape_of(C), Polytope):
            return C.dim <= HULL
        return _touching(C, np.zeros(C.dim)) is not None

    def compile(self, program: VelocityProgram) -> Solve:
        """Factorise M once; a call starts from no active rows.

        Balls are met by sequential quadratic programming: at a point w_k of C half-spaces touch
        them, and their multipliers y bend the objective along the spheres:

            min |w - q|^2_{M^-1} + |w - w_k|^2_K,    K = (y / r) (1 - n n^T) for each ball,

        whose metric is that of L R^-T, R R^T = 1 + L^T K L. Where multipliers fall their bend falls
        by no more than 4 a step: without it some steps go round in circles.
        """
        M = program.M
        lower = cache(lambda: scipy.linalg.cholesky(dense(M.M), lower=True))

        def solve(q: Array, C: ConvexSet) -> Answer:
            z, w, corrected, bend = np.zeros_like(q), q, q, np.zeros(1)
            # C has points and M is positive definite: where that is not seen it is rounding, and
            # numbers that are not finite are ValueErrors
            with contextlib.suppress(EmptySetError, ValueError):
                # discs on needles take 3; in units up to 2^40 apart rounding keeps w moving
                for k in range(50):
                    rows = _touching(C, w)
                    if rows is None:  # a polytope that is flat to rounding
                        return Answer(z, status="failed: no rows")
                    L = lower()
                    shortest = _shortest(L, rows, bend + 0 * rows.h, corrected)
                    if shortest is None:
                        break
                    x, z, active = shortest
                    w = corrected + L @ x
                    rounded = M.rounding(z, euclidean(q / M.root))
                    curved = rows.curvature @ rows.blocks
                    stays = (np.abs(w - rows.point) * curved <= ROUNDING).all()
                    # three refinements of what L rounds: without them polyhedra beside jumps of
                    # 1e8 are not met
                    if stays and (k >= 3 or rounded <= NEGLIGIBLE * euclidean(x)):
                        if not program.proved and not curved.any():
                            y = np.linalg.lstsq(rows.G[active].T, z)[0]
                            z = np.minimum(y, 0.0) @ rows.G[active]  # rounding is in the cone too
                            return Answer(z, iterations=1, status="solved", w=w, normal=True)
                        break
                    # what L L^T misses of M goes to the linear term
                    corrected = M.precisely(z, q, -(L @ (L.T @ z)))
                    bend = np.maximum(-(rows.G @ z) * rows.curvature, bend / 4)
            return Answer(z, iterations=1, status="solved")

        return solve


class Touching(NamedTuple):
    """Half-spaces G w <= h that touch a set at a point of it.

    Attributes
    ----------
    curvature : ndarray, shape (m,)
        1 / r where a row touches a ball, 0 of faces.
    blocks : ndarray, shape (m, dim)
        1 at the unknowns of the ball, 0 of faces.
    point : ndarray, shape (dim,)
        Any where there are faces.
    """

    G: Array
    h: Array
    curvature: Array
    blocks: Array
    point: Array


def _shortest(L: Array, rows: Touching, bend: Array, q: Array) -> tuple[Array, Array, Array] | None:
    """The solution of the bent program of `ActiveSet.compile`: x with w = q + L x, z, active rows.

    None where rounding keeps the method from an answer.
    """
    G, h, curvature, blocks, point = rows
    one, metric, bent, R = np.eye(q.size), L, np.zeros_like(q), None
    if bend.any():
        tangent = one - G.T @ ((curvature > 0)[:, None] * G)
        root = np.sqrt(bend @ blocks)[:, None] * tangent  # K = root^T root
        R = scipy.linalg.qr(np.vstack([one, root @ L]), mode="r")[0][: q.size].T
        metric = scipy.linalg.solve_triangular(R, L.T, lower=True).T
        bent = (root @ metric).T @ (root @ (point - q))
    center = q + metric @ bent
    rounding = ROUNDING * (np.abs(h) + np.abs(G) @ np.abs(center))
    shortest = least_distance(G @ metric, h - G @ center, rounding)
    if shortest is None:
        return None
    x = bent + shortest.u
    if R is not None:
        x = scipy.linalg.solve_triangular(R, x, lower=True, trans=1)
    return x, scipy.linalg.solve_triangular(L, x, lower=True, trans=1), shortest.active


def _touching(C: ConvexSet, w: Array) -> Touching | None:
    """Those at the point next to w; None if not all rows are known."""
    if isinstance(C, Balls) and C.block > 1 and C.radii.all():
        arms = (w - C.center).reshape(-1, C.block)
        sizes = np.linalg.norm(arms, axis=1)
        normals = arms / np.where(sizes > 0, sizes, 1.0)[:, None]
        G, blocks = (scipy.linalg.block_diag(*x) for x in (normals, np.ones_like(normals)))
        point = C.center + (normals * np.minimum(sizes, C.radii)[:, None]).ravel()
        return Touching(G, C.radii + G @ (C.center + 0 * w), 1 / C.radii, blocks, point)
    if isinstance(C, Aligned) and C.unknowns is None and not C.polyhedral:
        v, r = 0 * w if C.v is None else C.v, C.factor
        each = [_touching(S, (w - v)[at] / r) for S, at in placed(C.parts)]
        if any(one is None for one in each):
            return None
        Gs, hs, curvatures, blocks, points = zip(*each, strict=True)
        G = np.sign(r) * scipy.linalg.block_diag(*Gs)
        return Touching(
            G,
            abs(r) * np.concatenate(hs) + G @ v,
            np.concatenate(curvatures) / abs(r),
            scipy.linalg.block_diag(*blocks),
            v + r * np.concatenate(points),
        )
    if not C.polyhedral:
        return None
    try:
        G, h = C.halfspaces().inequalities()
    except NoHalfspacesError:
        return None
    return Touching(G, h, 0 * h, 0 * G, w)
