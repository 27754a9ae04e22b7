"""DAQP, a dual active-set method: the fastest for small programs over boxes, warm started.

For C = [l, u] the velocity program is the projection of q on C in the M^-1 metric: in w = M z + q

    min 1/2 |w - q|^2_{M^-1}   subject to   l <= w <= u,

a quadratic program whose only constraints are bounds. A step changes q, l and u and starts from the
active set of the step before (Arnström, Bemporad, Axehill, IEEE Trans. Automat. Contr. 67, 2022).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Any

import numpy as np

from sweepopt.errors import MissingExtraError
from sweepopt.linalg import Factor
from sweepopt.sets import ConvexSet, binary
from sweepopt.velocity.program import VelocityProgram
from sweepopt.velocity.solvers.contract import Answer, Small, Solve

BEYOND, INFINITE = 1e60, 1e30  # beyond any bound of a set; what DAQP takes for no bound


@dataclass(frozen=True)
class DAQP(Small):
    """DAQP for small programs over boxes (needs the extra "speed").

    Parameters
    ----------
    max_dim : int
        Larger programs are left to the other solvers: the cost grows with the number of entries
        that change sides in a step, and Newton's method changes all of them at once.

    Raises
    ------
    InputError
        If max_dim is not positive.

    Examples
    --------
    >>> from sweepopt.sets import Ball, Box
    >>> DAQP().treats(Box([-1.0], [1.0])), DAQP().treats(Ball([0.0, 0.0], 1.0))
    (True, False)
    """

    name = "daqp"

    def treats(self, C: ConvexSet) -> bool:
        """Whether C is small and a box: its projection has a diagonal derivative."""
        if not C.polyhedral or C.dim > self.max_dim:
            return False
        D = C.derivative(C.anchor)
        return D is not None and D.ndim == 1

    def compile(self, program: VelocityProgram) -> Solve:
        """Invert M once; a call updates the linear term and the bounds."""
        if not has_daqp():
            raise MissingExtraError("daqp", "speed")
        return _Workspace(program.M)


class _Workspace:
    """The inverse of M in units of its diagonal, and an engine that starts from its last answer."""

    def __init__(self, M: Factor) -> None:
        # in units of the diagonal: the method's tolerances are absolute
        self._root, self._inverse = M.root, M.inverse * np.outer(M.root, M.root)
        self._engine: Any = None
        self._box: ConvexSet | None = None
        self._bounds = np.zeros((2, M.dim))

    def __call__(self, q: np.ndarray, C: ConvexSet) -> Answer:
        q = q / self._root
        force = binary(np.abs(q).max())
        linear = self._inverse.dot(q) / -force
        if C is not self._box:
            far = np.full(q.size, BEYOND)
            self._box, self._bounds = C, np.array([C.project(far), C.project(-far)]) / self._root
        with np.errstate(over="ignore"):  # a unit of next to nothing: as far as INFINITE
            above, below = np.clip(self._bounds / force, -INFINITE, INFINITE)
        if self._engine is None:
            import daqp

            self._engine = daqp.Model()
            no_rows, sense = np.zeros((0, q.size)), np.zeros(q.size, dtype=np.int32)
            self._engine.setup(self._inverse, linear, no_rows, above, below, sense)
        else:
            self._engine.update(f=linear, bupper=above, blower=below)
        w, _, flag, info = self._engine.solve()
        z = self._inverse.dot(w * force - q) / self._root
        status = "solved" if flag == 1 else f"failed: flag {flag}"
        return Answer(z, iterations=int(info["iterations"]), status=status)


@cache
def has_daqp() -> bool:
    """Whether DAQP is there, so that "auto" may choose it."""
    return find_spec("daqp") is not None
