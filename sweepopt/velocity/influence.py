"""What a body does when its contact is held, or led, and how accurate that is known.

With these answers A^-1 is applied once and for all (`sweepopt/reduction.py`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sweepopt.checks import Matrix
from sweepopt.linalg import Elimination, Precise, product_error


class Held(NamedTuple):
    """The response F of a body whose contact is held, the force on that, and what F misses."""

    F: np.ndarray
    pull: np.ndarray
    missed: np.ndarray


def held(A: Elimination, f: np.ndarray) -> Held:
    """A F = f but on the contact, F = 0 there; what acts on the few is theirs to the last bit."""
    few, inner = A.unknowns, f.copy()
    inner[few] = 0.0
    nothing = np.zeros(few.size)
    F, pull = np.zeros(A.dim), nothing
    for _ in range(2):  # the second one refines
        missed = A.precisely(-F, inner)
        missed[few] -= pull
        if not missed.any():
            break
        forward, more = A.reduce(missed)
        # held at 0, the contact takes the force N E A^-1 r
        F, pull = F + A.recover(forward, nothing), pull + more
    missed = A.precisely(-F, inner)
    missed[few] -= pull
    return Held(F, f[few] + pull, missed)


def follow(A: Elimination, zeta: np.ndarray) -> np.ndarray:
    """A^-1 E^T N zeta: how the body follows its contact."""
    u = A.recover(np.zeros(A.dim), A.N @ zeta)
    u[A.unknowns] = zeta  # to the last bit: stuck is 0.0
    return u


class Uneven:
    """|(M - (1 + gamma rho) A) v|_{A^-1} and |(B - rho A) v|_{A^-1}, relative to the factors.

    B is a multiple of A up to rounding, and A + gamma B is rounded; what that moves grows with the
    condition of A. The rounding of A + gamma B is that of another multiple of A.
    """

    OTHER = 4 / 3

    def __init__(self, A: Elimination, B: Matrix | None, rho: float) -> None:
        self._A = A
        self._missed = [(1 / self.OTHER, product_error(self.OTHER, A.M))]
        if B is not None:
            self._missed.append((1 / rho, (B - rho * A.M) - product_error(rho, A.M)))

    def __call__(self, v: np.ndarray) -> float:
        return 2 * sum(share * self._A.dual_norm(E @ v) for share, E in self._missed)


def accuracy(A: Elimination, uneven: Uneven) -> float:
    """|A v - E^T N d|_{A^-1} / |v|_A of v = A^-1 E^T N d, and what is uneven: twice the worst.

    Of six d: three are given, the others are the displacements under these as forces: smooth ones,
    of which a badly conditioned A leaves less.
    """
    few, worst, precisely = A.unknowns, 0.0, Precise(A.N)
    m = few.size
    for force in (np.ones(m), np.cos(np.arange(m) + 1.0), (-1.0) ** np.arange(m)):
        on_few = np.zeros(A.dim)
        on_few[few] = force
        for d in (force, A.solve(on_few)[few]):
            v, pull = follow(A, d), np.zeros(A.dim)
            pull[few] = precisely(d)
            missed = A.dual_norm(A.precisely(v, -pull)) + A.resolution(v) + uneven(v)
            worst = max(worst, missed / A.norm(v))
    return 2 * worst
