"""OSQP, an operator-splitting method for quadratic programs: vectors updated, warm started."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from sweepopt.sets import ConvexSet
from sweepopt.velocity.solvers.canonical import CanonicalSolver


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
    >>> OSQP(tol=1e-9).tol
    1e-09
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

    def engine(self, cone: ConvexSet, data: dict[str, Any], linear: np.ndarray) -> Any:
        """Equations and inequalities as rows between bounds."""
        import osqp

        equal, below = data["A"].shape[0], data["F"].shape[0]
        engine = osqp.OSQP()
        engine.setup(
            sp.csc_matrix(data["P"]),
            linear,
            sp.csc_matrix(sp.vstack([data["A"], data["F"]])),
            np.repeat([0.0, -np.inf], [equal, below]),
            np.zeros(equal + below),
            verbose=False,
            polishing=False,
            eps_abs=self.tol,
            eps_rel=self.tol,
            max_iter=self.max_iter,
        )
        return engine

    def run(self, engine: Any) -> tuple[Any, int, str]:
        """The engine's answer."""
        result = engine.solve(raise_error=False)
        return result.x, result.info.iter, result.info.status
