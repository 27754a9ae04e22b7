"""The unknowns that a program has: all, the few that a set acts on, or none (MATH.md section 5).

For C = c + E^T S, E selecting few unknowns, zeta = E z solves a small program with the matrix
N = (E M^-1 E^T)^-1, the linear term N E M^-1 (q - c) and the set S; then z = M^-1 (c - q + E^T w)
with w = N zeta + N E M^-1 (q - c). All classes have the same methods, for a residual
r = M z + q - c of some z in place of q - c.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, Protocol

import numpy as np

from sweepopt.linalg import Elimination, Factor, IterativeElimination, Precise, euclidean


class Unknowns(Protocol):
    """A way to a program of fewer unknowns, and back.

    Attributes
    ----------
    unknowns : ndarray of int or slice
        Those that stay.
    N : Factor or None
        The matrix of their program.
    """

    unknowns: Any

    @property
    def N(self) -> Factor | None: ...

    def reduce(self, residual: np.ndarray) -> tuple[Any, np.ndarray]:
        """What `recover` needs of a residual, and the linear term N E M^-1 r."""
        ...

    def size(self, forward: Any) -> float | None:
        """|r|_{M^-1} from what `reduce` gave for r, if that is known without a solve."""
        ...

    def exact_product(self, zeta: np.ndarray, linear: np.ndarray) -> np.ndarray:
        """N zeta + the linear term, rounded once."""
        ...

    def recover(self, forward: Any, change: np.ndarray) -> np.ndarray:
        """By how much all unknowns change if the few change so and the others balance r."""
        ...


class AllUnknowns:
    """Nothing is eliminated."""

    unknowns = slice(None)

    def __init__(self, M: Factor) -> None:
        self.N = M

    def reduce(self, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The residual itself."""
        return residual, residual

    def size(self, forward: np.ndarray) -> float | None:
        """Known without a solve for a diagonal M only."""
        return euclidean(forward / self.N.root) if self.N.is_diagonal else None

    def exact_product(self, zeta: np.ndarray, linear: np.ndarray) -> np.ndarray:
        """M z + the linear term, rounded once."""
        return self.N.precisely(zeta, linear)

    def recover(self, forward: np.ndarray, change: np.ndarray) -> np.ndarray:
        """The change."""
        return change


class FewUnknowns:
    """All unknowns but a few are eliminated, by one forward and one backward substitution."""

    def __init__(self, M: Elimination | IterativeElimination) -> None:
        self._M, self.unknowns = M, M.unknowns

    @cached_property
    def N(self) -> Factor:
        """What is left for the few."""
        return Factor(self._M.N)

    @cached_property
    def _precise(self) -> Precise:
        return Precise(self._M.N)

    def reduce(self, residual: np.ndarray) -> tuple[Any, np.ndarray]:
        """One forward substitution."""
        forward, force = self._M.reduce(-residual)
        return forward, -force

    def size(self, forward: Any) -> float:
        """From the forward substitution."""
        return self._M.size(forward)

    def exact_product(self, zeta: np.ndarray, linear: np.ndarray) -> np.ndarray:
        """N zeta + the linear term, rounded once."""
        return self._precise(zeta, linear)

    def recover(self, forward: Any, change: np.ndarray) -> np.ndarray:
        """One backward substitution."""
        return self._M.recover(forward, self._M.N @ change)


class NoUnknowns:
    """C is a point: the program is a linear system."""

    unknowns = np.zeros(0, dtype=int)
    N = None

    def __init__(self, M: Factor) -> None:
        self._M = M

    def reduce(self, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The residual, which waits for its solve."""
        return residual, residual[self.unknowns]

    def size(self, forward: np.ndarray) -> float:
        """That of z, which the certificate computes."""
        return 0.0

    def exact_product(self, zeta: np.ndarray, linear: np.ndarray) -> np.ndarray:
        """Nothing."""
        return linear

    def recover(self, forward: np.ndarray, change: np.ndarray) -> np.ndarray:
        """The solution of M dz = -r."""
        return -self._M.solve(forward)
