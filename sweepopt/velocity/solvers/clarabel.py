"""Clarabel, an interior-point method for cone programs: vectors are updated in place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from sweepopt.sets import CAREFUL, ConvexSet
from sweepopt.velocity.solvers.canonical import CanonicalSolver


@dataclass(frozen=True)
class Clarabel(CanonicalSolver):
    """Clarabel with absolute, relative and feasibility tolerances equal to `tol`.

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
    >>> Clarabel(tol=1e-9).tol
    1e-09
    """

    tol: float = 1e-9
    max_iter: int = 200
    name = "clarabel"

    def treats(self, C: ConvexSet) -> bool:
        """Every set."""
        return True

    @classmethod
    def meeting(cls, tol: float) -> Clarabel:
        """Half the square of a certificate is a gap: a tenth of tol^2, between 1e-11 and 1e-4.

        A smaller gap is at the mercy of rounding: Newton steps or refinement meet a tighter tol.
        """
        return cls(tol=min(max(0.1 * tol**2, 1e-11), 1e-4))

    def scaled(self, data: dict[str, Any]) -> np.ndarray:
        """Puts the rows in units of their cones."""
        rows, columns = _units(data["P"], data["A"], data["dims"])
        data["A"] = sp.diags_array(rows) @ data["A"] @ sp.diags_array(columns)
        data["b"] = rows * data["b"]
        return columns

    def engine(self, cone: ConvexSet, data: dict[str, Any], linear: np.ndarray) -> Any:
        """Clarabel with the program."""
        import clarabel
        from cvxpy.reductions.solvers.conic_solvers.clarabel_conif import dims_to_solver_cones

        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_iter = self.max_iter
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = self.tol
        settings.presolve_enable = False  # updates need the problem as it was set up
        if not cone.certifiable:  # an answer stands if Clarabel calls it solved
            for name, value in CAREFUL.items():
                setattr(settings, name, value)
        A, b, cones = sp.csc_matrix(data["A"]), data["b"], dims_to_solver_cones(data["dims"])
        return clarabel.DefaultSolver(data["P"], linear, A, b, cones, settings)

    def run(self, engine: Any) -> tuple[Any, int, str]:
        """The engine's answer."""
        solution = engine.solve()
        return solution.x, solution.iterations, str(solution.status)


def _units(P: Any, A: Any, dims: Any) -> tuple[np.ndarray, np.ndarray]:
    """Units of the rows and of the variables in which no cone is larger than another.

    The variables of the quadratic term have theirs already. A cone that they are in gets their
    unit, and all other variables that of their cones: |p| <= t with p in 1e-10 lets a solver that
    meets both sides to 1e-9 forget p. Newton's method repairs that up to its size; 800 discs in
    units from 1e-3 to 1e3 are not met then.
    """
    sizes = [*[1] * (dims.zero + dims.nonneg), *dims.soc]
    sizes += [A.shape[0] - sum(sizes)] * (A.shape[0] > sum(sizes))  # cones of other kinds as one
    tied, A = np.isin(np.arange(A.shape[1]), sp.coo_array(P).col), abs(sp.csr_array(A))
    largest = (A @ sp.diags_array(1.0 * tied)).max(axis=1).toarray().ravel()
    of_cones = np.maximum.reduceat(largest, np.cumsum([0, *sizes[:-1]]))
    rows = np.repeat(1 / np.where(of_cones > 0, of_cones, 1.0), sizes)
    free = (sp.diags_array(rows) @ A).max(axis=0).toarray().ravel()
    return rows, np.where(tied | (free == 0), 1.0, 1 / np.where(free > 0, free, 1.0))
