"""Proportional materials: a set that acts on few unknowns leaves a process of these alone.

Let B = rho A and C(t) = f(t) + E^T S(t) with E selecting few unknowns and f = sum_k phi_k f_k.
The velocity program (MATH.md section 2) has M = (1 + gamma rho) A, so that A^-1 can be applied once
and for all. For zeta = E u the whole process becomes

    -zeta'(t) in N_{S(t) + N a(t)}(N zeta' + rho N zeta),   N = (E A^-1 E^T)^-1,
    a(t) = sum_k phi_k(t) E A^-1 f_k,

again a sweeping process: the library solves it as any other. The other unknowns follow from

    u = sum_k alpha_k A^-1 f_k + alpha_0 u0 + A^-1 E^T lam,   alpha_k' + rho alpha_k = phi_k,
    alpha_0' + rho alpha_0 = 0,   alpha_0(t_0) = 1, alpha_k(t_0) = 0,

where alpha is the trajectory of a linear process that the same scheme moves, and lam = N (zeta -
E (u - A^-1 E^T lam)). They are computed when somebody asks for them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Matrix
from sweepopt.linalg import Elimination
from sweepopt.loads import Constant, Separable
from sweepopt.process import SweepingProcess
from sweepopt.sets import AnySet, ConvexSet, Moving, Point

SAME = 8 * np.finfo(float).eps  # entries of B and rho A may differ by this share
ACCURATE = 1e-10  # |A F - f|_{A^-1} in units of |F|_A: worse solves leave it to the general path


@dataclass(frozen=True, eq=False)
class Reduction:
    """A process of few unknowns, and the way back to all of them.

    Attributes
    ----------
    rho : float
        B = rho A; 0 where there is no B.
    process : SweepingProcess
        That of zeta = E u, shape (m,).
    coefficients : SweepingProcess
        That of alpha, shape (k + 1,); the last entry is alpha_0.
    """

    rho: float
    process: SweepingProcess
    coefficients: SweepingProcess
    _shapes: np.ndarray
    _A: Elimination

    def lift(self, zeta: np.ndarray, alpha: np.ndarray) -> np.ndarray:
        """All unknowns, of u or of a velocity, from the few and the coefficients of the load.

        Parameters
        ----------
        zeta : ndarray, shape (m,)
        alpha : ndarray, shape (k + 1,)

        Returns
        -------
        ndarray, shape (dim,)
        """
        u = self._shapes @ alpha
        few = self._A.unknowns
        u += self._A.recover(np.zeros_like(u), self._A.N @ (zeta - u[few]))
        u[few] = zeta  # to the last bit: stuck is 0.0
        return u


def reduce(process: SweepingProcess) -> Reduction | str:
    """The reduction of a process, or a sentence that says what it lacks."""
    if process.rate_independent:
        return "A is zero"
    rho = _ratio(process.A, process.B)
    if rho is None:
        return "B is not a multiple of A"
    motion = _motion(process.C)
    if isinstance(motion, str):
        return motion
    unknowns, terms, moving = motion
    A = Elimination(process.A, unknowns, process.metric.order)
    columns = []
    for _, f in terms:
        F = A.solve(f)
        columns.append(F + A.solve(f - process.A @ F))
    # what the certificates of the small process do not see: how well the rest follows
    few = np.ones(unknowns.size)
    follows = A.recover(np.zeros(process.dim), A.N @ few)
    pull = np.zeros(process.dim)
    pull[unknowns] = A.N @ few
    pairs = [(F, f) for F, (_, f) in zip(columns, terms, strict=True)]
    for F, f in [*pairs, (follows, pull)]:
        if A.dual_norm(process.A @ F - f) > ACCURATE * A.norm(F):
            return "A is too badly conditioned to apply its inverse beforehand"
    shapes = np.column_stack([*columns, process.u0])
    load = [(phi, A.N @ F[unknowns]) for (phi, _), F in zip(terms, columns, strict=True)]
    small = SweepingProcess(A.N, rho * A.N if rho else None, moving(load), process.u0[unknowns])
    phis = [phi for phi, _ in terms]
    unit = np.eye(len(terms) + 1)
    alpha = Separable([*zip(phis, unit, strict=False), (Constant(0.0), unit[-1])])
    linear = SweepingProcess(
        unit, rho * unit if rho else None, Moving(Point(unit[-1] * 0), alpha), unit[-1]
    )
    return Reduction(rho, small, linear, shapes, A)


def _ratio(A: Matrix, B: Matrix | None) -> float | None:
    """rho with B = rho A to rounding, entry by entry; None if there is none."""
    if B is None:
        return 0.0
    if sp.issparse(A) != sp.issparse(B):
        return None
    i = int(np.argmax(A.diagonal()))
    rho = float(B[i, i] / A[i, i])
    difference = abs(B - rho * A) - SAME * rho * abs(A)
    return rho if difference.max() <= 0 else None


def _motion(
    C: AnySet,
) -> tuple[np.ndarray, list[tuple[Any, np.ndarray]], Callable[[list[Any]], Moving]] | str:
    """The selected unknowns, the terms of f and a maker of S(t) + N a(t)."""
    shape, center, scale = C, None, None
    if isinstance(C, Moving):
        shape, center, scale = C.shape, C.center, C.scale
    selection = shape.selection if isinstance(shape, ConvexSet) else None
    if selection is None:
        return "C(t) is not written as f(t) + E^T S(t) with E selecting few unknowns"
    part = selection.part
    terms: list[tuple[Any, np.ndarray]] = []
    if isinstance(center, Separable):
        terms = list(center.terms)
    elif isinstance(center, np.ndarray):
        terms = [(Constant(1.0), center)]
    elif center is not None:
        return "the load is a function of time, not a Separable of few shapes"
    if selection.shift is not None:
        if scale is not None:
            return "the set that is scaled is not centred"
        terms.append((Constant(1.0), selection.shift))

    def moving(load: list[Any]) -> Moving:
        return Moving(part, Separable(load) if load else None, scale)

    return selection.unknowns, terms, moving
