"""Contact in a body that is too large to factorise: Newton's method in the full space.

For a set on few unknowns C = c + E^T S, S separable (friction), -z in N_C(M z + q) is solved by the
semismooth Newton method of `newton.py` in the full space: stuck unknowns get z = 0, all
others F solve M_FF dz = r. The hierarchy of M serves every F: on each level the coarse unknowns
whose function would be torn by holding the stuck ones are left out, and the others are cut off
there (R. Kornhuber, Monotone multigrid methods, Numer. Math. 69, 1994, truncates so).

Newton's method may cycle. A contact that would reverse stops first, and when the number of contacts
that change their state has not fallen for a while, one changes at a time: that ends for every M > 0
(J. Judice, F. Pires, A block principal pivoting algorithm, Comput. Oper. Res. 21, 1994).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sweepopt.errors import SolverRefusedError
from sweepopt.linalg import Multigrid
from sweepopt.sets import ConvexSet, Selection
from sweepopt.velocity.program import Velocity, at_rest_on, rate

# reduction of the residual while the contact state changes; less and less loose if that goes on
LOOSE, LEAST = 0.1, 1e-8
PATIENCE = 10  # Newton steps without fewer changes of the state; then one contact changes at a time


class Step(NamedTuple):
    """A velocity with its proof, the number of Newton steps and of conjugate gradient steps."""

    velocity: Velocity
    iterations: int
    cycles: int


class MultigridProgram:
    """-z in N_C(M z + q) for one M and all C = c + E^T S with one E, S separable.

    A call starts from the velocity and the contact state that the last one found; not to be shared
    by threads. The certificate is computed from M, q and C alone, whatever the iterations did.

    Parameters
    ----------
    M : Multigrid
    contact : ndarray of int, shape (m,)
        The unknowns that E selects.
    tol : float
        Relative certificate at which a call ends; it ends above it where it stagnates.
    max_iter : int
        Newton steps of a call.
    """

    def __init__(
        self, M: Multigrid, contact: np.ndarray, tol: float = 1e-10, max_iter: int = 300
    ) -> None:
        self.M, self.contact, self.tol, self.max_iter = M, contact, tol, max_iter
        self._columns = M.M[contact].T
        self._last = self._before = np.zeros(M.dim)
        self._side = np.zeros(contact.size)  # signs of the slipping contacts, 0 where stuck
        self._cycle = M.cycle(contact)

    def __call__(self, q: np.ndarray, selection: Selection) -> Step:
        """Solve the program.

        Parameters
        ----------
        q : ndarray, shape (dim,)
        selection : Selection
            `C.selection`, of the unknowns `contact`.

        Raises
        ------
        SolverRefusedError
            If the set is not separable.
        """
        M, contact, part = self.M, self.contact, selection.part
        force = q if selection.shift is None else q - selection.shift
        rest = at_rest_on(q, selection, M.diagonal)
        if rest is not None:
            self._last = self._before = np.zeros(M.dim)
            return Step(rest, 0, 0)
        T = part.weights(M.diagonal[contact])
        size_q = M.dual_norm_floor(force)
        z, best = 2 * self._last - self._before, Velocity(self._last, math.inf, math.inf)
        fewest, stalled, cycles, tight = contact.size + 1, 0, 0, False
        forces = np.zeros(contact.size)
        for iteration in range(self.max_iter + 1):
            w = M.M @ z + force
            v = w[contact] - T * z[contact]
            normal, target = part.normal(v), part.project(v)
            side = self._next_side(part, v, normal, z[contact])
            changes = np.flatnonzero(side != self._side)
            reduction = max(LOOSE ** (1 + stalled), LEAST)
            if not changes.size or iteration == self.max_iter:
                velocity = self._certify(z, w, force, normal / T, target, size_q)
                stagnates = tight and velocity.certificate >= best.certificate
                best = min(best, velocity, key=lambda one: one.certificate)
                if best.relative <= self.tol or stagnates or iteration == self.max_iter:
                    break
                reduction = min(0.3 * self.tol / velocity.relative, 0.3)
            elif changes.size < fewest:
                fewest, stalled = changes.size, 0
            else:
                stalled += 1
                if stalled > PATIENCE:
                    changes = changes[-1:]
            tight = not changes.size
            if not tight:
                self._side[changes] = side[changes]
                self._cycle = M.cycle(contact[self._side == 0])
            # one that is to stop but has to wait keeps its force
            forces = np.where((side == self._side) | (self._side == 0), target, forces)
            w[contact] -= forces
            dz, count = self._newton(z, w, reduction)
            z, cycles = z + dz, cycles + count
        self._before, self._last = self._last, best.z
        return Step(best, iteration, cycles)

    def _next_side(
        self, part: ConvexSet, v: np.ndarray, normal: np.ndarray, z: np.ndarray
    ) -> np.ndarray:
        """The sign of z at the contacts that slip next: none that reverses, it stops first."""
        D = part.derivative(v)
        if D is None or D.ndim != 1:
            raise SolverRefusedError(
                "multigrid treats sets that act on each unknown alone, such as a Box; this is a "
                f"{type(part).__name__}"
            )
        return np.where((D == 1) | (z * self._side < 0), 0.0, -np.sign(normal))

    def _newton(self, z: np.ndarray, rho: np.ndarray, reduction: float) -> tuple[np.ndarray, int]:
        """dz: stuck contacts get 0, all other unknowns solve M dz = -rho."""
        held = np.where(self._side == 0, -z[self.contact], 0.0)
        dz, count = self.M.correct(-rho - self._columns @ held, self._cycle, reduction)
        dz[self.contact] += held
        return dz, count

    def _certify(
        self,
        z: np.ndarray,
        w: np.ndarray,
        force: np.ndarray,
        p: np.ndarray,
        target: np.ndarray,
        size_q: float,
    ) -> Velocity:
        """z with -p on the contact, where p in N_S(target) exactly (Moreau), and its proof.

        What is left is rho = M z + q - c - E^T target, and |z - z*|_M <= |rho|_{M^-1}.
        """
        entries = 0.0 - p
        rho = w + self._columns @ (entries - z[self.contact])
        z = z.copy()
        z[self.contact] = entries
        size_z = math.sqrt(max(float(z @ (rho - force)), 0.0))
        rho[self.contact] -= target
        return rate(z, self.M.dual_norm_bound(rho), size_z, size_q)
