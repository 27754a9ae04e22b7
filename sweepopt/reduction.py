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

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
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
Pair = tuple[np.ndarray, np.ndarray]


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
    _errors: np.ndarray
    _share: float

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

    def residual(self, zetas: Pair, alphas: Pair, gamma: float) -> tuple[float, float]:
        """What the inclusion of all unknowns misses beyond that of the few, and its size.

        With M = (1 + gamma rho) A, q = rho A u and both lifted, M z + q - f holds phi_k (A F_k -
        f_k), phi_k = (1 + gamma rho) alpha_k' + rho alpha_k, and what A^-1 E^T lam misses.

        Parameters
        ----------
        zetas, alphas : pairs of ndarray
            Of the state u and of the velocity z.
        gamma : float

        Returns
        -------
        error, size : float
            The residual in |.|_{M^-1} by the measured accuracy of the solves; and
            max(|z|_M, |M^-1 (f - q)|_M).
        """
        ratio = 1 + gamma * self.rho
        few, N = self._shapes[self._A.unknowns], self._A.N
        apart = [zeta - few @ alpha for zeta, alpha in zip(zetas, alphas, strict=True)]
        forces = [N @ d for d in apart]
        u, z = (math.sqrt(max(float(d @ w), 0.0)) for d, w in zip(apart, forces, strict=True))
        phi = np.abs(ratio * alphas[1] + self.rho * alphas[0])
        error = phi @ self._errors + self._share * (ratio * z + self.rho * u)
        # z, and the velocity without contact M^-1 (f - q), both in units of the shapes
        held, free = self._gram @ alphas[1], self.rho / ratio
        moving = alphas[1] @ (held + 2 * (few.T @ forces[1])) + z * z
        loose = alphas[1] @ (held - 2 * free * (few.T @ forces[0])) + (free * u) ** 2
        size = math.sqrt(ratio * max(float(moving), float(loose), 0.0))
        return float(error) / math.sqrt(ratio), size

    @cached_property
    def _gram(self) -> np.ndarray:
        return self._shapes.T @ (self._A.M @ self._shapes)


def reduce(process: SweepingProcess, tol: float) -> Reduction | str:
    """The reduction of a process, or a sentence that says what it lacks.

    The solves with A that come beforehand must be a thousand times as accurate as `tol` asks of
    each step.
    """
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
    columns, pulls = [], []
    for _, f in terms:
        F = A.solve(f)
        columns.append(F + A.solve(f - process.A @ F))
        # N E A^-1 f; what acts on the few is itself: a load at the threshold stays there
        inner = f.copy()
        inner[unknowns] = 0.0
        pulls.append(f[unknowns] + (A.reduce(inner)[1] if inner.any() else 0.0))
    # what the certificates of the small process do not see: how well the rest follows
    errors = [A.dual_norm(process.A @ F - f) for F, (_, f) in zip(columns, terms, strict=True)]
    shares = [error / size for F, error in zip(columns, errors, strict=True) if (size := A.norm(F))]
    share = _accuracy(A)
    if max([*shares, share]) > min(ACCURATE, 1e-3 * tol):
        return "A is too badly conditioned to apply its inverse beforehand"
    shapes = np.column_stack([*columns, process.u0])
    load = [(phi, pull) for (phi, _), pull in zip(terms, pulls, strict=True)]
    small = SweepingProcess(A.N, rho * A.N if rho else None, moving(load), process.u0[unknowns])
    phis = [phi for phi, _ in terms]
    unit = np.eye(len(terms) + 1)
    alpha = Separable([*zip(phis, unit, strict=False), (Constant(0.0), unit[-1])])
    linear = SweepingProcess(
        unit, rho * unit if rho else None, Moving(Point(unit[-1] * 0), alpha), unit[-1]
    )
    return Reduction(rho, small, linear, shapes, A, np.array([*errors, 0.0]), share)


def _accuracy(A: Elimination) -> float:
    """|A v - E^T N d|_{A^-1} / |v|_A of v = A^-1 E^T N d: twice the worst of three d."""
    m = A.unknowns.size
    worst = 0.0
    for d in (np.ones(m), np.cos(np.arange(m) + 1.0), (-1.0) ** np.arange(m)):
        v, pull = A.recover(np.zeros(A.dim), A.N @ d), np.zeros(A.dim)
        v[A.unknowns] = d
        pull[A.unknowns] = A.N @ d
        worst = max(worst, A.dual_norm(A.M @ v - pull) / A.norm(v))
    return 2 * worst


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
