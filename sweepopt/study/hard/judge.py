"""The exact velocity of a small program in 60 digits, to judge what double precision answers.

-z in N_C(M z + q) for C = c + E^T S, S a box, balls or a polyhedron: the unknowns beside E z are
eliminated, the rest is an active set that is changed until no sign and no bound is violated. The
solution is unique, so that a start from somebody's answer favours nobody.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sweepopt.checks import Matrix
from sweepopt.linalg import dense
from sweepopt.problem import SweepingProcess
from sweepopt.sets import ConvexSet
from sweepopt.study.hard import digits
from sweepopt.study.hard.velocities import velocity
from sweepopt.velocity import untranslated


class Structure(NamedTuple):
    """C = shift + a set on the unknowns `few`; nothing holds the forces on the others."""

    few: np.ndarray
    part: ConvexSet
    shift: np.ndarray


def structure(C: ConvexSet) -> Structure:
    """How a set of the library is stated: the one place that looks inside of it."""
    if C.selection is not None:
        few, part, shift = C.selection
        return Structure(few, part, np.zeros(C.dim) if shift is None else shift)
    shift, part = untranslated(C)
    return Structure(np.arange(C.dim), part, shift)


class Exact(NamedTuple):
    """The velocity as mpmath numbers, shape (dim,), and sizes in |.|_M.

    Attributes
    ----------
    length, size : float
        |z|_M, and max(|z|_M, |M^-1 q|_M), q the full linear term.
    forces : float
        |M^-1 q|_M + |M^-1 c|_M of C = c + S, which cancel in the full linear term: rounding of
        the two is rounding of the data.
    """

    z: np.ndarray
    length: float
    size: float
    forces: float


class Program:
    """M = A + gamma B in 60 digits, for the exact velocities of many linear terms.

    Parameters
    ----------
    A, B : ndarray or sparse, shape (dim, dim)
        Small: the elimination takes dim^3 operations of a microsecond. B may be None.
    gamma : float
    """

    def __init__(self, A: Matrix, B: Matrix | None = None, gamma: float = 0.0) -> None:
        self.M = digits.exactly(dense(A))
        self._B = None if B is None else digits.exactly(dense(B))
        if self._B is not None:
            self.M = self.M + digits.exactly(gamma) * self._B
        self._eliminated: dict[bytes, _Condensed] = {}

    def term(self, u: np.ndarray) -> np.ndarray:
        """The linear term B u, as mpmath numbers."""
        u = digits.exactly(u)
        return 0 * u if self._B is None else self._B @ u

    def solve(self, q: np.ndarray, C: ConvexSet, near: np.ndarray) -> Exact:
        """The velocity for a linear term and a set, from an answer that may be near it.

        Parameters
        ----------
        q : ndarray, shape (dim,)
            Of doubles or mpmath numbers.
        C : ConvexSet
        near : ndarray, shape (dim,)

        Raises
        ------
        InputError
            If C is none of the kinds that `velocities` knows.
        """
        few, part, shift = structure(C)
        force = digits.exactly(q) - digits.exactly(shift)
        key = few.tobytes()
        if key not in self._eliminated:
            self._eliminated[key] = _Condensed(self.M, few)
        condensed = self._eliminated[key]
        forward, pull = condensed.reduce(force)
        z = condensed.recover(forward, velocity(part, condensed.N, pull, near[few]))

        def dual(w: np.ndarray) -> float:
            w = digits.exactly(w)
            return digits.root(condensed.solve(w) @ w)

        length = digits.root(z @ self.M @ z)
        return Exact(z, length, max(length, dual(force)), dual(q) + dual(shift))

    def error(self, z: np.ndarray, exact: Exact) -> float:
        """|z - z*|_M."""
        apart = digits.exactly(z) - exact.z
        return digits.root(apart @ self.M @ apart)


class Judge:
    """The exact velocities of one case, computed once for all of its runs."""

    def __init__(self, process: SweepingProcess, gamma: float) -> None:
        self.process, self._program = process, Program(process.A, process.B, gamma)
        self._known: dict[tuple[float, bytes], Exact] = {}

    def of(self, u: np.ndarray, t: float, near: np.ndarray) -> Exact:
        """The velocity of the state u for C(t): from A, B and u, where nothing is rounded."""
        key = t, b"" if self.process.B is None else u.tobytes()
        if key not in self._known:
            q = self._program.term(u)
            self._known[key] = self._program.solve(q, self.process.C.at(t), near)
        return self._known[key]

    def error(self, z: np.ndarray, exact: Exact) -> float:
        """|z - z*|_M."""
        return self._program.error(z, exact)


class _Condensed:
    """L D L^T of M with the unknowns beside `few` first."""

    def __init__(self, M: np.ndarray, few: np.ndarray) -> None:
        beside = np.setdiff1d(np.arange(len(M)), few)
        self.order, self.m = np.concatenate([beside, few]), len(beside)
        self.L, self.D = digits.factor(M[np.ix_(self.order, self.order)])
        tail = self.L[self.m :, self.m :]
        self.N = (tail * self.D[self.m :]) @ tail.T

    def reduce(self, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        forward = digits.forward(self.L[: self.m, : self.m], force[self.order[: self.m]])
        pull = force[self.order[self.m :]] - self.L[self.m :, : self.m] @ forward
        return forward, pull

    def recover(self, forward: np.ndarray, zeta: np.ndarray) -> np.ndarray:
        z = np.empty(len(self.order), dtype=object)
        z[self.order[self.m :]] = zeta
        right = -forward / self.D[: self.m] - self.L[self.m :, : self.m].T @ zeta
        z[self.order[: self.m]] = digits.backward(self.L[: self.m, : self.m], right)
        return z

    def solve(self, force: np.ndarray) -> np.ndarray:
        z = np.empty(len(self.order), dtype=object)
        z[self.order] = digits.backward(self.L, digits.forward(self.L, force[self.order]) / self.D)
        return z
