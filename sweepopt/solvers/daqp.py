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
from scipy.linalg import lapack

from sweepopt.errors import MissingExtraError
from sweepopt.linalg import dense
from sweepopt.program import VelocityProgram
from sweepopt.sets import ConvexSet
from sweepopt.sets.base import binary
from sweepopt.solvers.base import Answer, Small, Solve

FAR, INFINITE = 1e60, 1e30  # beyond any bound of a set; what DAQP takes for no bound


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
        if not installed():
            raise MissingExtraError("daqp", "speed")
        import daqp

        n, root = program.M.dim, program.M.root
        # in units of the diagonal: the method's tolerances are absolute
        factor, _ = lapack.dpotrf(dense(program.M.M) / np.outer(root, root), lower=True)
        lower = np.tril(lapack.dpotri(factor, lower=True)[0])
        inverse = np.ascontiguousarray(lower + np.tril(lower, -1).T)
        no_rows, sense = np.zeros((0, n)), np.zeros(n, dtype=np.int32)
        far = np.full(n, FAR)
        engine: Any = None
        box: ConvexSet | None = None
        unit, above, below = 0.0, far, -far

        def solve(q: np.ndarray, C: ConvexSet) -> Answer:
            nonlocal engine, box, unit, above, below
            q = q / root
            force = binary(np.abs(q).max())
            linear = -(inverse @ q) / force
            same = C is box and force == unit
            if not same:
                box, unit = C, force
                bounds = np.array([C.project(far), C.project(-far)]) / root
                above, below = np.maximum(np.minimum(bounds / force, INFINITE), -INFINITE)
            if engine is None:
                engine = daqp.Model()
                engine.setup(inverse, linear, no_rows, above, below, sense)
            elif same:
                engine.update(f=linear)
            else:
                engine.update(f=linear, bupper=above, blower=below)
            w, _, flag, info = engine.solve()
            if flag != 1:
                engine = None  # a workspace that failed once is not used again
                return Answer(np.zeros(n), np.zeros(C.offsets.size), 0, f"failed: flag {flag}")
            z = (inverse @ (w * force - q)) / root
            return Answer(z, np.zeros(C.offsets.size), int(info["iterations"]), "solved")

        return solve


@cache
def installed() -> bool:
    """Whether DAQP is there, so that "auto" may choose it."""
    return find_spec("daqp") is not None
