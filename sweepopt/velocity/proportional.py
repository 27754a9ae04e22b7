"""Proportional materials: a set that acts on few unknowns leaves a process of these alone.

Let B = rho A and C(t) = f(t) + E^T S(t) with E selecting few unknowns and f = sum_k phi_k f_k.
The velocity program (MATH.md section 2) has M = (1 + gamma rho) A, so that A^-1 can be applied once
and for all. For zeta = E u the whole process becomes

    -zeta'(t) in N_{S(t) + N a(t)}(N zeta' + rho N zeta),   N = (E A^-1 E^T)^-1,
    a(t) = sum_k phi_k(t) E A^-1 f_k,

again a sweeping process: the library solves it as any other. The other unknowns follow from

    u = A^-1 E^T N zeta + sum_k alpha_k F_k + alpha_0 F_0,
    alpha_k' + rho alpha_k = phi_k,   alpha_0' + rho alpha_0 = 0,

F_k the response to f_k of the body whose contact is held, F_0 what u0 has beyond the response to
its contact. The same scheme moves alpha, from alpha_0(t_0) = 1 and all others 0. u is computed when
somebody asks for it.

Where sum_k phi_k F_k = rho F_0 nothing moves beside the contact, as long as the phi_k stay what
they are: alpha stays at its start, and u and u' beside a contact that is held are u0 and 0 to the
last bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sweepopt.linalg import UNIT, Elimination, Precise
from sweepopt.loads import Constant, Separable
from sweepopt.problem import SweepingProcess, proportion
from sweepopt.sets import AnySet, ConvexSet, Moving
from sweepopt.velocity.influence import Uneven, accuracy, follow, held
from sweepopt.velocity.certificate import is_rounding

if TYPE_CHECKING:
    from sweepopt.integrate import Scheme

ACCURATE = 1e-10  # |A F - f|_{A^-1} in units of |F|_A: worse solves leave it to the general path
FLOOR = 1e-3  # of the velocity that the load alone would cause: less counts as this
Pair = tuple[np.ndarray, np.ndarray]


class OfLoad(NamedTuple):
    """What the load alone brings into the residual of a step; `residual` knows its use."""

    error: float
    floor: float
    square: float
    ratio: float


class Residual(NamedTuple):
    """A residual in |.|_{M^-1} by the measured accuracy of the solves, and what it is compared to.

    The size is |z|_M, at least FLOOR of what the load and what B u alone would move.
    """

    error: float
    size: float


@dataclass(frozen=True, eq=False)
class Reduction:
    """A process of few unknowns, and the way back to all of them.

    Attributes
    ----------
    rho : float
        B = rho A; 0 where there is no B.
    process : SweepingProcess
        That of zeta = E u, shape (m,).
    load : Separable
        Its k + 1 values are the right hand sides of alpha; the last one is that of alpha_0.
    """

    rho: float
    process: SweepingProcess
    load: Separable
    _balanced: np.ndarray | None
    _shapes: np.ndarray
    _A: Elimination
    _errors: np.ndarray
    _responses: np.ndarray
    _uneven: np.ndarray
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
        u = self._shapes @ alpha + follow(self._A, zeta - alpha[-1] * self.process.u0)
        u[self._A.unknowns] = zeta  # to the last bit
        return u

    def still(self, values: np.ndarray) -> int:
        """How many steps at the start leave u0 as it is beside the contact.

        Parameters
        ----------
        values : ndarray, shape (n, k + 1)
            Those of the load that the steps ask for.
        """
        if self._balanced is None:
            return 0
        moves = (values != self._balanced)[:, self.beside].any(axis=1)
        return int(moves.argmax()) if moves.any() else len(values)

    def suits(self, mus: np.ndarray, scheme: Scheme, tol: float) -> bool:
        """Whether steps leave the velocities of alpha a thousand times as accurate as tol.

        alpha' = (phi - rho alpha) / (1 + gamma rho) is the difference of two numbers that, far from
        the start, are as near to each other as the run is long in units of 1 / rho.
        """
        gamma, span = scheme.a[-1][-1] * float(mus.min()), float(mus.sum())
        lost = UNIT * self.rho * span / (1 + gamma * self.rho)
        return scheme.exact or lost <= FLOOR * tol

    def of_load(self, alphas: Pair, gammas: np.ndarray) -> list[OfLoad]:
        """What the load brings into the residual of each step.

        With M = (1 + gamma rho) A, q = rho A u and both lifted, M z + q - f holds what each F_k
        misses times phi_k = (1 + gamma rho) alpha_k' + rho alpha_k, and what A^-1 E^T N misses;
        beside that what A + gamma B and B miss of multiples of A, where nothing cancels.

        Parameters
        ----------
        alphas : pair of ndarray, shape (n, k + 1)
            Of the states u and of the velocities z.
        gammas : ndarray, shape (n,)
        """
        ratios = 1 + gammas * self.rho
        phi = np.abs(ratios[:, None] * alphas[1] + self.rho * alphas[0])
        # A^-1 E^T N zeta and the F_k are orthogonal in the metric of A
        squares = np.einsum("ik,kl,il->i", alphas[1], self._gram, alphas[1])
        apart = np.abs(ratios[:, None] * alphas[1]) + np.abs(self.rho * alphas[0])
        errors = phi @ self._errors + apart @ self._uneven
        columns = (errors, FLOOR * (phi @ self._responses), squares, ratios)
        return [OfLoad(*row) for row in zip(*(column.tolist() for column in columns), strict=True)]

    def residual(self, zeta: np.ndarray, velocity: np.ndarray, load: OfLoad) -> Residual:
        """What the inclusion of all unknowns misses beyond that of the few, and its size.

        Parameters
        ----------
        zeta, velocity : ndarray, shape (m,)
            The state and the velocity of the few.
        load : OfLoad
            Of this step.
        """
        N, ratio = self._A.N, load.ratio
        u, square = math.sqrt(max(zeta.dot(N.dot(zeta)), 0.0)), velocity.dot(N.dot(velocity))
        z = math.sqrt(max(square, 0.0))
        error = load.error + self._share * (ratio * z + self.rho * u)
        size = math.sqrt(ratio * max(load.square + square, 0.0))
        floor = load.floor + FLOOR * self.rho * u
        return Residual(error / math.sqrt(ratio), max(size, floor / math.sqrt(ratio)))

    @cached_property
    def beside(self) -> np.ndarray:
        """Which coefficients have a response beside the contact; shape (k + 1,), that of u0 not."""
        return np.append(self._shapes[:, :-1].any(axis=0), False)

    @cached_property
    def _gram(self) -> np.ndarray:
        shapes = self._shapes.copy()
        shapes[:, -1] -= follow(self._A, self.process.u0)
        return shapes.T @ (self._A.M @ shapes)


def reduce(process: SweepingProcess, tol: float, t: float) -> Reduction | str:
    """The reduction of a process, or a sentence that says what it lacks.

    The solves with A that come beforehand must be a thousand times as accurate as `tol` asks of
    each step.

    Parameters
    ----------
    t : float
        When the first step asks for the load.
    """
    if process.rate_independent:
        return "A is zero"
    rho = proportion(process.A, process.B)
    if rho is None:
        return "B is not a multiple of A"
    motion = _motion(process.C)
    if isinstance(motion, str):
        return motion
    unknowns, terms, moving = motion
    A = Elimination(process.A, unknowns, process.metric.order)
    at_held = [held(A, f) for _, f in terms]
    load = [(phi, one.pull) for (phi, _), one in zip(terms, at_held, strict=True)]
    small = SweepingProcess(A.N, rho * A.N if rho else None, moving(load), process.u0[unknowns])
    uneven = Uneven(A, process.B, rho)
    share = accuracy(A, uneven)
    responses = np.array([A.dual_norm(f) for _, f in terms])
    errors = np.array([A.dual_norm(one.missed) + A.resolution(one.F) for one in at_held])
    shapes = np.column_stack([*(one.F for one in at_held), process.u0])
    missed = np.array([uneven(F) for F in shapes.T])
    missed[-1] += share * math.sqrt(small.u0 @ (A.N @ small.u0))
    worst = min(ACCURATE, FLOOR * tol)
    if (np.maximum(errors, missed[:-1]) > worst * responses).any() or share > worst:
        return "A is too badly conditioned to apply its inverse beforehand"
    histories = [*(phi for phi, _ in terms), Constant(0.0)]
    alpha = Separable(list(zip(histories, np.eye(len(histories)), strict=True)))
    phi = alpha.values(np.array([t]))[0]
    f = sum((c * f for c, (_, f) in zip(phi, terms, strict=False)), np.zeros(A.dim))
    pull = sum((c * one.pull for c, one in zip(phi, at_held, strict=False)), 0.0 * unknowns)
    left = _left(A, process, f, rho * small.u0, pull) if rho else None
    # alpha_0 = 1 weighs what F_0 misses with rho
    errors = np.append(errors, 0.0 if left is None else left / rho)
    responses = np.append(responses, 0.0 if left is None else A.dual_norm(f) / rho)
    balanced = None if left is None else phi
    return Reduction(rho, small, alpha, balanced, shapes, A, errors, responses, missed, share)


def _left(
    A: Elimination, process: SweepingProcess, f: np.ndarray, strain: np.ndarray, pull: np.ndarray
) -> float | None:
    """|f - B u0|_{A^-1} beside what the contact takes, if no more than rounding is left of it.

    The contact takes N strain - pull: rho u0 there, and what the response to f pulls.
    """
    few, q = A.unknowns, process.times_B(process.u0)
    beside = f - q
    beside[few] = 0.0
    if not is_rounding(beside, q, f):
        return None
    missed = -Precise(process.B)(process.u0, -f)
    missed[few] += Precise(A.N)(strain, -pull)
    return A.dual_norm(missed)


class _Motion(NamedTuple):
    """The unknowns that E selects, the terms of f, and what makes S(t) + N a(t) of those of a."""

    unknowns: np.ndarray
    terms: list[tuple[Any, np.ndarray]]
    moving: Callable[[list[Any]], Moving]


def _motion(C: AnySet) -> _Motion | str:
    """C(t) = f(t) + E^T S(t), or a sentence that says what it lacks."""
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

    return _Motion(selection.unknowns, terms, moving)
