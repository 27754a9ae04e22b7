"""OSQP, an operator-splitting method for quadratic programs: vectors updated, warm started."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from sweepopt.sets import ConvexSet
from sweepopt.velocity.solvers.canonical import CanonicalSolver, EngineAnswer, Workspace


@dataclass(frozen=True)
class OSQP(CanonicalSolver):
    """OSQP with absolute and relative tolerance `tol`.

    Its own polish is off: refinement does the same, and keeps an answer only if it is better.

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

    def treats(self, C: ConvexSet) -> bool:
        """Polyhedra."""
        return C.polyhedral

    @classmethod
    def meeting(cls, tol: float) -> OSQP:
        """A hundredth of tol, between 1e-9 and 1e-3: residuals count more where M is soft."""
        return cls(tol=min(max(0.01 * tol, 1e-9), 1e-3))

    def refined(self) -> OSQP | None:
        """Two digits tighter, with more iterations."""
        if self.tol <= 1e-11:
            return None
        return replace(self, tol=self.tol / 100, max_iter=4 * self.max_iter)

    def workspace(self, cone: ConvexSet, P: sp.csc_array, data: dict[str, Any]) -> Workspace:
        """Equations and inequalities as rows between bounds."""
        import osqp

        equations, inequalities = data["A"], data["F"]
        rows = sp.csc_matrix(sp.vstack([equations, inequalities]))
        equal, below = equations.shape[0], inequalities.shape[0]
        lower = np.concatenate([np.zeros(equal), np.full(below, -np.inf)])
        upper = np.zeros(equal + below)

        def build(linear: np.ndarray) -> Any:
            fresh = osqp.OSQP()
            tolerances = {"eps_abs": self.tol, "eps_rel": self.tol, "max_iter": self.max_iter}
            fresh.setup(
                sp.csc_matrix(P),
                linear,
                rows,
                lower,
                upper,
                verbose=False,
                polishing=False,
                **tolerances,
            )
            return fresh

        def run(engine: Any) -> EngineAnswer:
            result = engine.solve(raise_error=False)
            x, info = np.array(result.x, dtype=float), result.info
            return EngineAnswer(x, info.iter, info.status, info.status_val in (1, 2))

        return Workspace(build, run, np.ones(P.shape[0]))
