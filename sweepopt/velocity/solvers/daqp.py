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

import numpy as np

from sweepopt.errors import brought_by
from sweepopt.sets import ConvexSet, binary
from sweepopt.velocity.program import Answer, Small, Solve, VelocityProgram

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
    >>> DAQP().treats(Box(-1.0, 1.0)), DAQP().treats(Ball([0.0, 0.0], 1.0))
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
        with brought_by("speed"):
            import daqp
        M = program.M
        # in units of the diagonal: the method's tolerances are absolute
        root, inverse = M.root, M.inverse * np.outer(M.root, M.root)
        free, engine = np.full(M.dim, INFINITE), daqp.Model()
        no_rows, sense = np.zeros((0, M.dim)), np.zeros(M.dim, dtype=np.int32)
        engine.setup(inverse, 0 * free, no_rows, free, -free, sense)
        box: ConvexSet | None = None
        unit = 0.0

        def solve(q: np.ndarray, C: ConvexSet) -> Answer:
            nonlocal box, unit
            q = q / root
            force = binary(np.abs(q).max())
            bounds: dict[str, np.ndarray] = {}
            if C is not box or force != unit:
                box, unit, far = C, force, np.full(M.dim, BEYOND)
                ends = np.array([C.project(far), C.project(-far)]) / root
                with np.errstate(over="ignore"):  # a unit of next to nothing: as far as INFINITE
                    above, below = np.clip(ends / force, -INFINITE, INFINITE)
                bounds = {"bupper": above, "blower": below}
            engine.update(f=inverse.dot(q) / -force, **bounds)
            w, _, flag, info = engine.solve()
            z = inverse.dot(w * force - q) / root
            status = "solved" if flag == 1 else f"failed: flag {flag}"
            return Answer(z, iterations=int(info["iterations"]), status=status)

        return solve


@cache
def has_daqp() -> bool:
    """Whether DAQP is there, so that "auto" may choose it."""
    return find_spec("daqp") is not None
