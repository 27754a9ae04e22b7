"""Influence functions of a body, and how accurately they are known.

With E selecting the contact and N = (E A^-1 E^T)^-1, the influence function F of a load f is the
answer of the body while its contact is held, A F = f - E^T (force on the contact) with E F = 0, and
A^-1 E^T N zeta is its answer to a displacement zeta of the contact: A^-1 is applied once and for
all.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from sweepopt.checks import Matrix
from sweepopt.linalg import Elimination, Precise, product_error


class Influence(NamedTuple):
    """The influence function F of a load, its force on the contact, |its residual|_{A^-1}."""

    F: np.ndarray
    force: np.ndarray
    residual: float


def influence(A: Elimination, f: np.ndarray) -> Influence:
    """The influence function of f; a force on the contact itself is there to the last bit."""
    contact, beside = A.unknowns, f.copy()
    beside[contact] = 0.0
    forward, force = A.reduce(beside)
    F = A.recover(forward, np.zeros(contact.size))
    residual = A.precisely(-F, beside)
    residual[contact] -= force
    return Influence(F, f[contact] + force, A.dual_norm(residual) + A.resolution(F))


def extension(A: Elimination, zeta: np.ndarray) -> np.ndarray:
    """A^-1 E^T N zeta: the body follows its contact."""
    u = A.recover(np.zeros(A.dim), zeta)
    u[A.unknowns] = zeta  # to the last bit: stuck is 0.0
    return u


def proportional_rounding(
    A: Elimination, B: Matrix | None, rho: float
) -> Callable[[np.ndarray], float]:
    """v -> |(M - (1 + gamma rho) A) v|_{A^-1} + |(B - rho A) v|_{A^-1}, relative to A's factors.

    B is a multiple of A up to rounding, and M = A + gamma B is rounded; what that moves grows with
    the condition of A. The rounding of M is estimated by that of another multiple of A, 4 / 3.
    """
    other = 4 / 3
    differences = [product_error(other, A.M) / other]
    if B is not None:
        differences.append(((B - rho * A.M) - product_error(rho, A.M)) / rho)
    return lambda v: 2 * sum(A.dual_norm(D @ v) for D in differences)


def extension_error(A: Elimination, rounding: Callable[[np.ndarray], float]) -> float:
    """|A v - E^T N d|_{A^-1} / |v|_A of extensions v of d, with the rounding of B and M.

    Twice that of the displacements under two forces: they are smooth, and of smooth ones a badly
    conditioned A leaves fewest digits.
    """
    contact, worst, N = A.unknowns, 0.0, Precise(A.N)
    for force in (np.ones(contact.size), np.cos(np.arange(contact.size) + 1.0)):
        total = np.zeros(A.dim)
        total[contact] = force
        d = A.solve(total)[contact]
        v, total[contact] = extension(A, d), N(d)
        residual = A.dual_norm(A.precisely(v, -total)) + A.resolution(v) + rounding(v)
        worst = max(worst, residual / A.norm(v))
    return 2 * worst
