"""Influence functions of a body, and how accurately they are known.

With E selecting the contact and N = (E A^-1 E^T)^-1, the influence function F of a load f is the
answer of the body while its contact is held, A F = f - E^T (force on the contact) with E F = 0, and
A^-1 E^T N zeta is its answer to a displacement zeta of the contact: A^-1 is applied once and for
all.
"""

from __future__ import annotations

import numpy as np

from sweepopt.checks import Matrix
from sweepopt.linalg import UNIT, Elimination, Precise, euclidean, product_error


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
        self.A, self.contact, self.rho = A, A.unknowns, rho
        # B is a multiple of A up to rounding, and M = A + gamma B is rounded as another multiple
        other = 4 / 3
        self._differences = [product_error(other, A.M) / other]
        if B is not None:
            self._differences.append(((B - rho * A.M) - product_error(rho, A.M)) / rho)

    def influence(self, f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """F, and the force on the contact: that of f on it is there to the last bit."""
        beside = f.copy()
        beside[self.contact] = 0.0
        forward, force = self.A.reduce(beside)
        return self.A.recover(forward, np.zeros(self.contact.size)), f[self.contact] + force

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
        r[self.contact] -= force
        rounding = sum(A.dual_norm(D @ v) for D in self._differences)
        rounding += UNIT * A.stretch * euclidean(A.root * v)
        return A.dual_norm(r) + 2 * rounding

    def extension_error(self) -> float:
        """The residual of extensions v in units of |v|_A.

        Twice that of the displacements under two forces: they are smooth, and of smooth ones a
        badly conditioned A leaves fewest digits.
        """
        A, worst, N = self.A, 0.0, Precise(self.A.N)
        for force in (np.ones(self.contact.size), np.cos(np.arange(self.contact.size) + 1.0)):
            f = np.zeros(A.dim)
            f[self.contact] = force
            d = A.solve(f)[self.contact]
            v = self.extension(d)
            worst = max(worst, self.residual(v, 0 * v, -N(d)) / A.norm(v))
        return 2 * worst
