"""Proportional materials: a set that acts on few unknowns leaves a process of these alone.

Let B = rho A and C(t) = f(t) + E^T S(t) with E selecting few unknowns and f = sum_k phi_k f_k.
The velocity program (MATH.md section 2) has M = (1 + gamma rho) A, so that A^-1 can be applied once
and for all. For zeta = E u the whole process becomes

    -zeta'(t) in N_{S(t) + N a(t)}(N zeta' + rho N zeta),   N = (E A^-1 E^T)^-1,
    a(t) = sum_k phi_k(t) E A^-1 f_k,

again a sweeping process: the library solves it as any other. The other unknowns follow from

    u = u0 + A^-1 E^T N (zeta - zeta0) + sum_k alpha_k F_k + alpha_0 F_0,
    alpha_k' + rho alpha_k = phi_k - phi_k(t_0),   alpha_0' + rho alpha_0 = 1,

F_k the influence function of f_k and F_0 that of f(t_0) - B u0, which is 0 where u0 is at rest
beside the contact. The same scheme moves alpha from 0. u is reconstructed when asked for: as long
as the phi_k stay what they are and the contact is held, u and u' are u0 and 0 to the last bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.linalg import UNIT, Elimination, Precise
from sweepopt.loads import Constant, Separable
from sweepopt.problem import Motion, SweepingProcess, Terms, motion, proportion
from sweepopt.sets import ConvexSet, Moving, Selection
from sweepopt.velocity.certificate import is_rounding
from sweepopt.velocity.influence import Body

if TYPE_CHECKING:
    from sweepopt.integrate import Scheme

LEAST_SPEED = 1e-3  # of the velocity that the load alone would cause: less counts as this


ResidualOf = Callable[[int, np.ndarray, np.ndarray], tuple[float, float]]
"""(step, zeta, zeta') -> a residual in |.|_{M^-1}, and the size of velocity it is compared to."""


class Reduction:
    """A process of few unknowns, and the way back to all of them.

    It is that to S on the contact of the body and a load of these terms.

    Parameters
    ----------
    process : SweepingProcess
    body : Body
    S : ConvexSet
    terms : sequence of (phi_k, f_k)
    scale : callable, optional
        Of C(t).
    t : float
        When the first step asks for the load.

    Attributes
    ----------
    rho : float
        B = rho A; 0 where there is no B.
    process : SweepingProcess
        That of zeta = E u, shape (m,).
    load : Separable
        Its values, shape (k + 1,), are the right hand sides of alpha.
    """

    def __init__(
        self, process: SweepingProcess, body: Body, S: ConvexSet, terms: Terms, scale: Any, t: float
    ) -> None:
        A, u0, rho = body.A, process.u0, body.rho
        zeta0, load, histories = u0[A.unknowns], Separable(terms), [phi for phi, _ in terms]
        shapes = list(load.shapes.T)
        functions, forces = map(list, zip(*map(body.influence, shapes), strict=True))
        C = Moving(S, Separable(zip(histories, forces, strict=True)), scale)
        small = SweepingProcess(A.N, rho * A.N if rho else None, C, zeta0)
        self.rho, self.process, self._body, self._u0 = rho, small, body, u0

        # what is left at the start: f(t_0) - B u0, and its force on the contact
        start = load.coefficients(t)
        f, q = load.shapes @ start, process.times_B(u0)
        shapes.append(_less_B(process, u0, f))
        forces.append(_less_B(small, zeta0, np.column_stack(forces) @ start))
        first, _ = body.influence(shapes[-1])
        beside = shapes[-1].copy()
        beside[A.unknowns] = 0.0
        functions.append(0 * first if is_rounding(beside, np.abs(q) + np.abs(f)) else first)
        units = [*np.eye(len(shapes))[:-1], np.append(-start, 1.0)]
        self.load = Separable(zip([*histories, Constant(1.0)], units, strict=True))

        self._functions = np.column_stack(functions)  # F_k, then F_0
        # |residual of each|_{A^-1}, and what it is compared to
        self._errors = np.array(list(map(body.residual, functions, shapes, forces)))
        self._sizes = np.array([*map(A.dual_norm, shapes[:-1]), A.dual_norm(f) + A.dual_norm(q)])
        self._extension_error = body.extension_error()

    def velocity(self, zeta: np.ndarray, alpha: np.ndarray) -> np.ndarray:
        """All unknowns of a velocity from the few and the rates of the coefficients.

        Parameters
        ----------
        zeta : ndarray, shape (m,)
        alpha : ndarray, shape (k + 1,)

        Returns
        -------
        ndarray, shape (dim,)
        """
        z = self._functions @ alpha + self._body.extension(zeta)
        z[self._body.A.unknowns] = zeta  # to the last bit: stuck is 0.0
        return z

    def state(self, zeta: np.ndarray, alpha: np.ndarray) -> np.ndarray:
        """All unknowns of u from the few and the coefficients; shapes as in `velocity`."""
        u = self._u0 + self.velocity(zeta - self.process.u0, alpha)
        u[self._body.A.unknowns] = zeta
        return u

    def suits(self, mus: np.ndarray, scheme: Scheme, tol: float) -> bool:
        """Whether steps leave the velocities of alpha a thousand times as accurate as tol.

        alpha' = (psi - rho alpha) / (1 + gamma rho), psi the load's value, is the difference of two
        numbers that, far from the start, are as near to each other as the run is long in units of
        1 / rho.
        """
        gamma, span = scheme.a[-1][-1] * float(mus.min()), float(mus.sum())
        rounding = UNIT * self.rho * span / (1 + gamma * self.rho)
        return scheme.exact or rounding <= LEAST_SPEED * tol

    def is_accurate(self, enough: float) -> bool:
        """Whether A^-1 was applied to this accuracy."""
        known = (self._errors <= enough * self._sizes).all()
        return bool(known and self._extension_error <= enough)

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
        A, rho, ratios = self._body.A, self.rho, 1 + gammas * self.rho
        N, zeta0 = A.N, self.process.u0
        weights = np.abs(ratios[:, None] * rates) + np.abs(rho * alphas)
        gram = self._functions.T @ (A.M @ self._functions)
        squares = np.einsum("ik,kl,il->i", rates, gram, rates)
        columns = weights @ self._errors, LEAST_SPEED * (weights @ self._sizes), squares, ratios
        load = np.column_stack(columns).tolist()

        def residual(i: int, zeta: np.ndarray, velocity: np.ndarray) -> tuple[float, float]:
            error, floor, square, ratio = load[i]
            moved = zeta - zeta0
            u = math.sqrt(max(moved.dot(N.dot(moved)), 0.0))
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
    parts = contact_and_load(process)
    if isinstance(parts, str):
        return parts
    rho, selection, terms = parts
    few = selection.unknowns
    terms = terms or ((Constant(0.0), np.zeros(process.dim)),)
    body = Body(Elimination(process.A, few, process.metric.order), process.B, rho)
    scale = getattr(process.C, "scale", None)
    reduction = Reduction(process, body, selection.part, terms, scale, t)
    if not reduction.is_accurate(LEAST_SPEED * tol):
        return "A is too badly conditioned to apply its inverse beforehand"
    return reduction


def contact_and_load(process: SweepingProcess) -> tuple[float, Selection, Terms] | str:
    """rho, E with S, and f of a process that a reduction may take; or why there is none."""
    if not process.coercive:
        return "A is singular"
    if process.metric.method != "factors":
        return "the factors of A do not fit in memory"
    rho = proportion(process.A, process.B)
    if rho is None:
        return "B is not a multiple of A"
    selected = _selected(motion(process.C), getattr(process.C, "scale", None))
    return selected if isinstance(selected, str) else (rho, *selected)


def _less_B(process: SweepingProcess, u: np.ndarray, f: np.ndarray) -> np.ndarray:
    """f - B u, rounded once."""
    return f if process.B is None else -Precise(process.B)(u, -f)


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
