"""The exact velocity of a small program in 80 digits, to judge what double precision answers.

-z in N_C(M z + q) for C = c + E^T S, S a polyhedron or balls: the unknowns beside E z are
eliminated, the rest is solved by `velocities`. The solution is unique.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sweepopt.checks import Matrix
from sweepopt.linalg import dense
from sweepopt.problem import SweepingProcess
from sweepopt.sets import ConvexSet
from sweepopt.study.hard.digits import exactly, inverse, norm, precise
from sweepopt.study.hard.velocities import velocity
from sweepopt.velocity import untranslated

ROUNDING = 16 * np.finfo(float).eps
"""Relative to the forces: a load above its threshold by no more counts as stuck."""


class Exact(NamedTuple):
    """The velocity as decimal numbers, shape (dim,), and sizes in |.|_M.

    Attributes
    ----------
    size : float
        max(|z|_M, |M^-1 q|_M), q the full linear term.
    forces : float
        |M^-1 q|_M + |M^-1 c|_M of C = c + S, which cancel in the full linear term: rounding of
        the two is rounding of the data.
    """

    z: np.ndarray
    size: float
    forces: float


class Program:
    """M = A + gamma B in 80 digits, for the exact velocities of many linear terms.

    Parameters
    ----------
    A, B : ndarray or sparse, shape (dim, dim)
        Small: the inverse takes dim^3 operations of a microsecond. B may be None.
    gamma : float
    """

    @precise()
    def __init__(self, A: Matrix, B: Matrix | None = None, gamma: float = 0.0) -> None:
        A = exactly(dense(A))
        self._B = 0 * A if B is None else exactly(dense(B))
        self.M = A + exactly(gamma) * self._B
        self._inverse = inverse(self.M)

    @precise()
    def term(self, u: np.ndarray) -> np.ndarray:
        """The linear term B u, as decimal numbers."""
        return self._B @ exactly(u)

    @precise()
    def solve(self, q: np.ndarray, C: ConvexSet) -> Exact:
        """The velocity for a linear term of doubles or decimal numbers and a set.

        Raises
        ------
        InputError
            If C is none of the kinds that `velocities` knows.
        """
        # C = shift + a set on the unknowns `few`; nothing holds the forces on the others
        if C.selection is not None:
            few, part, shift = C.selection
        else:
            (shift, part), few = untranslated(C), np.arange(C.dim)
        q = exactly(q)
        force = q if shift is None else q - exactly(shift)
        W, free = self._inverse, self._inverse @ force
        N = inverse(W[np.ix_(few, few)])
        moves = velocity(part, N, N @ free[few])
        z = W[:, few] @ (N @ (moves + free[few])) - free
        z[few] = moves
        forces = norm(W, q) + norm(W, q - force)
        return Exact(z, max(self.norm(z), norm(W, force)), forces)

    @precise()
    def norm(self, z: np.ndarray) -> float:
        """|z|_M."""
        return norm(self.M, z)

    @precise()
    def error(self, z: np.ndarray, exact: Exact) -> float:
        """|z - z*|_M."""
        return self.norm(exactly(z) - exact.z)


class Judge:
    """The exact velocities of one case, computed once for all of its runs.

    Parameters
    ----------
    process : SweepingProcess
    mu : float
        The step of implicit Euler.
    """

    def __init__(self, process: SweepingProcess, mu: float) -> None:
        self.process, self.mu = process, mu
        self.program = Program(process.A, process.B, mu)
        self._known: dict[tuple[float, bytes], Exact] = {}

    def exact(self, u: np.ndarray, t: float) -> Exact:
        """The velocity of the step from u at t: from A, B and u, where nothing is rounded."""
        key = t, b"" if self.process.B is None else u.tobytes()
        if key not in self._known:
            # the time as a step makes it: a load may change within a rounding unit of t
            C = self.process.C.at(t + self.mu)
            self._known[key] = self.program.solve(self.program.term(u), C)
        return self._known[key]

    def step(
        self, u: np.ndarray, t: float, z: np.ndarray, certificate: float
    ) -> tuple[float, float, float]:
        """Error and certificate of a velocity relative to `size`, and their excess.

        The excess is error - certificate in the unit of the forces, less ROUNDING where nothing
        moves.
        """
        exact = self.exact(u, t)
        error, size = self.program.error(z, exact), exact.size or 1.0
        allowed = 0.0 if z.any() else ROUNDING
        excess = (error - certificate) / (exact.forces or 1.0) - allowed
        return error / size, certificate / size, excess
