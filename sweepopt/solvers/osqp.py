"""OSQP, an operator-splitting method for quadratic programs: vectors updated, warm started."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from sweepopt.alone import silence
from sweepopt.checks import count, number
from sweepopt.program import VelocityProgram
from sweepopt.sets import ConvexSet
from sweepopt.solvers.base import Answer, Solve


@dataclass(frozen=True)
class OSQP:
    """OSQP with absolute and relative tolerance `tol`, polished.

    Parameters
    ----------
    tol : float
    max_iter : int

    Raises
    ------
    InputError
        If tol or max_iter is not positive.

    Examples
    --------
    >>> OSQP(tol=1e-9).refined().tol <= 1.1e-11
    True
    """

    tol: float = 1e-8
    max_iter: int = 5_000
    name = "osqp"

    def __post_init__(self) -> None:
        number("tol", self.tol, minimum=0.0, strict=True)
        count("max_iter", self.max_iter)

    def treats(self, C: ConvexSet) -> bool:
        """Polyhedra."""
        return C.polyhedral

    def refined(self) -> OSQP | None:
        """Two digits tighter, with more iterations."""
        if self.tol <= 1e-11:
            return None
        return replace(self, tol=self.tol / 100, max_iter=4 * self.max_iter)

    def compile(self, program: VelocityProgram) -> Solve:
        """Canonicalise and factorise once; a call updates the linear term."""
        import osqp

        canonical = program.canonical("OSQP")
        P = sp.triu(canonical.P / program.stiffness, format="csc")
        equations, inequalities = canonical.data["A"], canonical.data["F"]
        rows = sp.csc_matrix(sp.vstack([equations, inequalities]))
        equal, below = equations.shape[0], inequalities.shape[0]
        lower = np.concatenate([np.zeros(equal), np.full(below, -np.inf)])
        upper = np.zeros(equal + below)
        n, transposed = program.M.dim, canonical.map.T.tocsr()
        engine: Any = None

        def build(linear: np.ndarray) -> Any:
            fresh = osqp.OSQP()
            tolerances = {"eps_abs": self.tol, "eps_rel": self.tol, "max_iter": self.max_iter}
            data = (sp.csc_matrix(P), linear, rows, lower, upper)
            fresh.setup(*data, verbose=False, polishing=True, **tolerances)
            return fresh

        def solve(q: np.ndarray, C: ConvexSet) -> Answer:
            offsets = program.capped(q, C).offsets
            nonlocal engine
            linear = canonical.map @ np.concatenate([q, offsets])
            force = float(np.abs(linear).max())
            if force == 0:
                return Answer(np.zeros(n), np.zeros(offsets.size), 0, "solved")
            if engine is None:
                engine = build(linear / force)
            else:
                engine.update(q=linear / force)
            # its polish reports an empty active set even when it is told to be quiet
            with silence():
                result = engine.solve(raise_error=False)
            x = np.array(result.x, dtype=float)
            if not np.isfinite(x).all() or result.info.status_val not in (1, 2):
                engine = None  # a workspace that failed once is not used again
                x = np.nan_to_num(x, nan=0.0, posinf=0.0, neginf=0.0)
            answer = transposed @ (x * (force / program.stiffness))
            return Answer(answer[:n], answer[n:], result.info.iter, result.info.status)

        return solve
