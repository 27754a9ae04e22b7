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
beside the contact. With zeta they are one more sweeping process, of y = (zeta, alpha), which any
scheme moves: its set is a point in the alpha. u is reconstructed when asked for: as long as the
phi_k stay what they are and the contact is held, u and u' are u0 and 0 to the last bit.

The influence function F of a load f is the answer of the body while its contact is held,
A F = f - E^T (force on the contact) with E F = 0.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.linalg

from sweepopt.checks import Matrix
from sweepopt.linalg import UNIT, Elimination, Factor, Precise, euclidean, product_error
from sweepopt.loads import Constant, Separable
from sweepopt.problem import Motion, SweepingProcess, Terms, motion, proportion
from sweepopt.sets import Aligned, ConvexSet, Moving, Selection
from sweepopt.velocity.certificate import Velocity, is_rounding

if TYPE_CHECKING:
    from sweepopt.integrate import Scheme

LEAST_SPEED = 1e-3  # of the velocity that the load alone would cause: less counts as this


class Body:
    """A body of the matrices A and B = rho A, of which all but the contact is eliminated.

    Parameters
    ----------
    A : Elimination
        Its `unknowns` are the contact.
    B : ndarray or sparse, shape (dim, dim), or None
    rho : float
    """

    def __init__(self, A: Elimination, B: Matrix | None, rho: float) -> None:
        self.A, self.rho, self._contact = A, rho, A.unknowns
        # B is a multiple of A up to rounding, and M = A + gamma B is rounded as another multiple
        other = 4 / 3
        self._differences = [product_error(other, A.M) / other]
        if B is not None:
            self._differences.append(((B - rho * A.M) - product_error(rho, A.M)) / rho)

    def influence(self, f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """F, and the force on the contact: that of f on it is there to the last bit."""
        beside = f.copy()
        beside[self._contact] = 0.0
        forward, force, _ = self.A.reduce(beside)
        return self.A.recover(forward, np.zeros(self._contact.size)), f[self._contact] + force

    def extension(self, zeta: np.ndarray) -> np.ndarray:
        """A^-1 E^T N zeta: the body follows its contact."""
        return self.A.recover(np.zeros(self.A.dim), zeta)

    def residual(self, v: np.ndarray, f: np.ndarray, force: np.ndarray) -> float:
        """|f - E^T force - A v|_{A^-1}, with what the rounding of v, of B and of M adds.

        The rounding of B and M moves |(M - (1 + gamma rho) A) v|_{A^-1} and |(B - rho A) v|_{A^-1},
        which grow with the condition of A.
        """
        A = self.A
        r = A.precisely(-v, f)
        r[self._contact] -= force
        rounding = sum(A.dual_norm(D @ v) for D in self._differences)
        rounding += UNIT * A.stretch * euclidean(A.root * v)
        return A.dual_norm(r) + 2 * rounding

    def extension_error(self) -> float:
        """The residual of extensions v in units of |v|_A.

        Twice that of the displacement under equal forces, in units of the diagonal: it is smooth,
        and of smooth ones a badly conditioned A leaves fewest digits. On 33 random bodies with
        contrasts up to 1e10 ten other displacements had 0.5 times as much at most.
        """
        A, f = self.A, np.zeros(self.A.dim)
        f[self._contact] = A.root[self._contact]
        zeta = A.solve(f)[self._contact]
        v = self.extension(zeta)
        return 2 * self.residual(v, 0 * v, -Precise(A.N)(zeta)) / A.norm(v)


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
        That of y = (zeta, alpha), shape (m + k + 1,), in units in which |F_k|_A is about 1.
    metric : Factor
        N.
    """

    def __init__(
        self, process: SweepingProcess, body: Body, S: ConvexSet, terms: Terms, scale: Any, t: float
    ) -> None:
        A, u0, rho = body.A, process.u0, body.rho
        zeta0, load, histories = u0[A.unknowns], Separable(terms), [phi for phi, _ in terms]
        shapes = list(load.shapes.T)
        functions, forces = map(list, zip(*map(body.influence, shapes), strict=True))
        self.rho, self.metric, self._body, self._u0 = rho, Factor(A.N), body, u0
        self.few = A.unknowns.size

        # what is left at the start: f(t_0) - B u0, and its force on the contact
        start = load.coefficients(t)
        f, q = load.shapes @ start, process.times_B(u0)
        shapes.append(_less_B(process.B, u0, f))
        B = rho * A.N if rho else None
        forces.append(_less_B(B, zeta0, np.column_stack(forces) @ start))
        first, _ = body.influence(shapes[-1])
        beside = shapes[-1].copy()
        beside[A.unknowns] = 0.0
        functions.append(0 * first if is_rounding(beside, np.abs(q) + np.abs(f)) else first)
        # powers of 2 as units of alpha, which round nothing
        units = np.array([2.0 ** math.frexp(A.norm(F))[1] if F.any() else 1.0 for F in functions])
        self._functions = np.column_stack(functions) / units  # F_k, then F_0
        self._gram = self._functions.T @ (A.M @ self._functions)
        # |residual of each|_{A^-1}, and what it is compared to
        self._errors = np.array(list(map(body.residual, functions, shapes, forces))) / units
        sizes = np.array([*map(A.dual_norm, shapes[:-1]), A.dual_norm(f) + A.dual_norm(q)])
        self._sizes, self._extension_error = sizes / units, body.extension_error()

        rates = np.diag(units)
        rates[:-1, -1] = -start * units[:-1]  # phi_k - phi_k(t_0)
        columns = np.vstack([np.column_stack([*forces[:-1], 0 * zeta0]), rates]).T
        E_S = Aligned(S, unknowns=np.arange(self.few), dim=columns.shape[1])
        C = Moving(E_S, Separable(zip([*histories, Constant(1.0)], columns, strict=True)), scale)
        small = scipy.linalg.block_diag(A.N, np.eye(len(units)))
        y0 = np.append(zeta0, 0 * units)
        self.process = SweepingProcess(small, rho * small if rho else None, C, y0)

    def velocity(self, y: np.ndarray) -> np.ndarray:
        """All unknowns of a velocity, or of some in rows, from those that enter."""
        if y.ndim > 1:
            return np.array(list(map(self.velocity, y))).reshape(len(y), self._u0.size)
        zeta, alpha = y[: self.few], y[self.few :]
        z = self._functions @ alpha + self._body.extension(zeta)
        z[self._body.A.unknowns] = zeta  # to the last bit: stuck is 0.0
        return z

    def state(self, y: np.ndarray) -> np.ndarray:
        """All unknowns of u, or of some in rows, from those that enter."""
        u = self._u0 + self.velocity(y - self.process.u0)
        u[..., self._body.A.unknowns] = y[..., : self.few]
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

    def certified(self, gamma: float, y: np.ndarray, velocity: Velocity) -> Velocity:
        """The velocity of a stage from y with the certificate of all unknowns.

        Beside what that of the contact proves, with M = (1 + gamma rho) A and q = rho A u - f, both
        reconstructed, M z + q holds each residual of an influence function times
        (1 + gamma rho) alpha_k' + rho alpha_k, here with absolute values, and the same of the
        extension. The size is |z|_M, at least LEAST_SPEED of what the load and what B u alone would
        move.
        """
        few, rho, ratio, z = self.few, self.rho, 1 + gamma * self.rho, velocity.z
        N, root = self.metric, math.sqrt(ratio)
        zeta, rates = N.norm(z[:few]), z[few:]
        weights = ratio * abs(rates) + rho * abs(y[few:])
        u = rho * N.norm(y[:few] - self.process.u0[:few])
        error = weights.dot(self._errors) + self._extension_error * (ratio * zeta + u)
        # extensions and influence functions are orthogonal in the metric of A
        size = root * math.sqrt(max(rates.dot(self._gram.dot(rates)), 0.0) + zeta**2)
        size = max(size, LEAST_SPEED * (weights.dot(self._sizes) + u) / root)
        certificate = velocity.certificate + error / root
        if velocity.relative > 0:
            size = max(size, velocity.certificate / velocity.relative)
        relative = certificate / size if certificate > 0 else certificate
        return velocity._replace(certificate=certificate, relative=relative)


def reduce(process: SweepingProcess, tol: float, t: float) -> Reduction | str:
    """The reduction of a process, or a sentence that says why there is none.

    The solves with A that come beforehand must be a thousand times as accurate as `tol` asks of
    each step.

    Parameters
    ----------
    t : float
        When the first step asks for the load.
    """
    parts = _contact_and_load(process)
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


def _contact_and_load(process: SweepingProcess) -> tuple[float, Selection, Terms] | str:
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


def _less_B(B: Matrix | None, u: np.ndarray, f: np.ndarray) -> np.ndarray:
    """f - B u, rounded once."""
    return f if B is None else -Precise(B)(u, -f)


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
