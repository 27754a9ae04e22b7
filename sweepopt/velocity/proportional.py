"""Proportional materials: a set that acts on few unknowns leaves a process of these alone.

Let B = rho A and C(t) = f(t) + E^T S(t) with E selecting few unknowns and f = sum_k phi_k f_k.
The velocity program (MATH.md section 2) has M = (1 + gamma rho) A, so that A^-1 can be applied once
and for all. For zeta = E u the whole process becomes

    -zeta'(t) in N_{S(t) + N a(t)}(N zeta' + rho N zeta),   N = (E A^-1 E^T)^-1,
    a(t) = sum_k phi_k(t) E A^-1 f_k,

again a sweeping process: the library solves it as any other. The other unknowns follow from

    u = A^-1 E^T N zeta + sum_k alpha_k F_k + alpha_0 F_0,
    alpha_k' + rho alpha_k = phi_k,   alpha_0' + rho alpha_0 = 0,

F_k the influence function of f_k, F_0 what u0 has beyond the extension of its contact. The same
scheme moves alpha, from alpha_0(t_0) = 1 and all others 0. u is reconstructed when asked for.

Where sum_k phi_k F_k = rho F_0 nothing moves beside the contact, as long as the phi_k stay what
they are: alpha stays at its start, and u and u' beside a contact that is held are u0 and 0 to the
last bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.linalg import UNIT, Elimination, Precise
from sweepopt.loads import Constant, Separable
from sweepopt.problem import Motion, SweepingProcess, Terms, motion, proportion
from sweepopt.sets import Moving, Selection
from sweepopt.velocity.certificate import is_rounding
from sweepopt.velocity.influence import (
    extension,
    extension_error,
    influence,
    proportional_rounding,
)

if TYPE_CHECKING:
    from sweepopt.integrate import Scheme

ACCURATE = 1e-10  # |A F - f|_{A^-1} / |f|_{A^-1} up to which A^-1 is applied beforehand
LEAST_SPEED = 1e-3  # of the velocity that the load alone would cause: less counts as this


ResidualOf = Callable[[int, np.ndarray, np.ndarray], tuple[float, float]]
"""(step, zeta, zeta') -> a residual in |.|_{M^-1}, and the size of velocity it is compared to."""


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
    _A: Elimination
    _functions: np.ndarray  # F_k as columns, then u0
    _errors: np.ndarray  # |residual of each|_{A^-1}
    _sizes: np.ndarray  # |f_k|_{A^-1}
    _extension_error: float
    _balanced: np.ndarray | None  # the load with which u0 is at rest beside the contact

    def reconstruct(self, zeta: np.ndarray, alpha: np.ndarray) -> np.ndarray:
        """All unknowns, of u or of a velocity, from the few and the coefficients of the load.

        Parameters
        ----------
        zeta : ndarray, shape (m,)
        alpha : ndarray, shape (k + 1,)

        Returns
        -------
        ndarray, shape (dim,)
        """
        u = self._functions @ alpha + extension(self._A, zeta - alpha[-1] * self.process.u0)
        u[self._A.unknowns] = zeta  # to the last bit
        return u

    def steps_at_rest(self, values: np.ndarray) -> int:
        """How many steps at the start leave u0 as it is beside the contact.

        Parameters
        ----------
        values : ndarray, shape (n, k + 1)
            Those of the load that the steps ask for.
        """
        if self._balanced is None:
            return 0
        moves = (values[:, :-1] != self._balanced)[:, self.acts_beside[:-1]].any(axis=1)
        return int(moves.argmax()) if moves.any() else len(values)

    @cached_property
    def acts_beside(self) -> np.ndarray:
        """Which terms of the load act beside the contact; shape (k + 1,), that of u0 does not."""
        return np.append(self._functions[:, :-1].any(axis=0), False)

    def suits(self, mus: np.ndarray, scheme: Scheme, tol: float) -> bool:
        """Whether steps leave the velocities of alpha a thousand times as accurate as tol.

        alpha' = (phi - rho alpha) / (1 + gamma rho) is the difference of two numbers that, far from
        the start, are as near to each other as the run is long in units of 1 / rho.
        """
        gamma, span = scheme.a[-1][-1] * float(mus.min()), float(mus.sum())
        rounding = UNIT * self.rho * span / (1 + gamma * self.rho)
        return scheme.exact or rounding <= LEAST_SPEED * tol

    def residuals(self, alphas: np.ndarray, rates: np.ndarray, gammas: np.ndarray) -> ResidualOf:
        """What the inclusion of all unknowns has of residual beyond that of the few.

        With M = (1 + gamma rho) A and q = rho A u - f, both reconstructed, M z + q holds each
        residual of an influence function times (1 + gamma rho) alpha_k' + rho alpha_k, here with
        absolute values, and the same of the extension. The size is |z|_M, at least LEAST_SPEED of
        what the load and what B u alone would move.

        Parameters
        ----------
        alphas, rates : ndarray, shape (n, k + 1)
            alpha at the start of each step and alpha' in it.
        gammas : ndarray, shape (n,)
        """
        N, rho, ratios = self._A.N, self.rho, 1 + gammas * self.rho
        weights = np.abs(ratios[:, None] * rates) + np.abs(rho * alphas)
        functions = self._functions.copy()
        functions[:, -1] -= extension(self._A, self.process.u0)
        gram = functions.T @ (self._A.M @ functions)
        squares = np.einsum("ik,kl,il->i", rates, gram, rates)
        columns = weights @ self._errors, LEAST_SPEED * (weights @ self._sizes), squares, ratios
        load = list(zip(*(column.tolist() for column in columns), strict=True))

        def residual(i: int, zeta: np.ndarray, velocity: np.ndarray) -> tuple[float, float]:
            error, floor, square, ratio = load[i]
            u = math.sqrt(max(zeta.dot(N.dot(zeta)), 0.0))
            z_square = max(velocity.dot(N.dot(velocity)), 0.0)
            error += self._extension_error * (ratio * math.sqrt(z_square) + rho * u)
            # extensions and influence functions are orthogonal in the metric of A
            size = math.sqrt(ratio * max(square + z_square, 0.0))
            root = math.sqrt(ratio)
            return error / root, max(size, (floor + LEAST_SPEED * rho * u) / root)

        return residual


def reduce(process: SweepingProcess, tol: float, t: float) -> Reduction | str:
    """The reduction of a process, or a sentence that says why there is none.

    The solves with A that come beforehand must be a thousand times as accurate as `tol` asks of
    each step.

    Parameters
    ----------
    t : float
        When the first step asks for the load.
    """
    if process.rate_independent:
        return "A is zero"
    if process.metric.method != "factors":
        return "the factors of A do not fit in memory"
    rho = proportion(process.A, process.B)
    if rho is None:
        return "B is not a multiple of A"
    scale = getattr(process.C, "scale", None)
    selected = _selected(motion(process.C), scale)
    if isinstance(selected, str):
        return selected
    selection, terms = selected
    few = selection.unknowns
    A = Elimination(process.A, few, process.metric.order)
    influences = [influence(A, f) for _, f in terms]
    forces = [(phi, one.force) for (phi, _), one in zip(terms, influences, strict=True)]
    C = Moving(selection.part, Separable(forces) if forces else None, scale)
    small = SweepingProcess(A.N, rho * A.N if rho else None, C, process.u0[few])

    rounding = proportional_rounding(A, process.B, rho)
    share = extension_error(A, rounding)
    errors = np.array([one.residual + rounding(one.F) for one in influences])
    sizes = np.array([A.dual_norm(f) for _, f in terms])
    enough = min(ACCURATE, LEAST_SPEED * tol)
    if (errors > enough * sizes).any() or share > enough:
        return "A is too badly conditioned to apply its inverse beforehand"

    values = Separable(terms).coefficients(t) if terms else np.zeros(0)
    f = sum((c * f for c, (_, f) in zip(values, terms, strict=True)), np.zeros(A.dim))
    rest = _rest_residual(A, process, f) if rho else None
    start = rounding(process.u0) + share * math.sqrt(small.u0 @ (A.N @ small.u0))
    size = 0.0
    if rest is not None:  # alpha_0 = 1 is weighed with rho
        start, size = start + rest / rho, A.dual_norm(f) / rho
    histories: Terms = (*terms, (Constant(0.0), process.u0))
    units = np.eye(len(histories))
    return Reduction(
        rho,
        small,
        Separable([(phi, unit) for (phi, _), unit in zip(histories, units, strict=True)]),
        A,
        np.column_stack([*(one.F for one in influences), process.u0]),
        np.append(errors, start),
        np.append(sizes, size),
        share,
        None if rest is None else values,
    )


def _rest_residual(A: Elimination, process: SweepingProcess, f: np.ndarray) -> float | None:
    """|f - B u0|_{A^-1} beside the contact, if it is nothing but rounding."""
    q = process.times_B(process.u0)
    beside = f - q
    beside[A.unknowns] = 0.0
    if not is_rounding(beside, q, f):
        return None
    residual = Precise(process.B)(process.u0, -f)
    residual[A.unknowns] = 0.0
    return A.dual_norm(residual)


def _selected(moving: Motion, scale: Any) -> tuple[Selection, Terms] | str:
    """E with S, and f, of C(t) = f(t) + E^T S(t); or a sentence that says what C(t) lacks."""
    selection = None
    if moving.shape is not None and moving.offsets is None:
        selection = moving.shape.selection
    if selection is None:
        return "C(t) is not written as f(t) + E^T S(t) with E selecting few unknowns"
    if moving.center.function is not None:
        return "the load is a function of time, not a Separable of few shapes"
    if selection.shift is None:
        return selection, moving.center.terms
    if scale is not None:
        return "the set that is scaled is not centred"
    return selection, (*moving.center.terms, (Constant(1.0), selection.shift))
