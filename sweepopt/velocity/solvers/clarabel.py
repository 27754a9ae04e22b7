"""Clarabel, an interior-point method for cone programs: vectors are updated in place."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from sweepopt.sets import CAREFUL, ConvexSet
from sweepopt.velocity.solvers.canonical import CanonicalSolver, EngineAnswer, Workspace

USABLE = {"Solved", "AlmostSolved"}


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
    >>> Clarabel(tol=1e-9).refined().tol <= 1.1e-11
    True
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

        A smaller gap is at the mercy of rounding: what misses a tighter tol is polished.
        """
        return cls(tol=min(max(0.1 * tol**2, 1e-11), 1e-4))

    def refined(self) -> Clarabel | None:
        """Two digits tighter, as far as double precision goes."""
        return replace(self, tol=self.tol / 100) if self.tol > 1e-13 else None

    def workspace(self, cone: ConvexSet, P: sp.csc_array, data: dict[str, Any]) -> Workspace:
        """The rows in units of their cones."""
        import clarabel

        A, b, dims = data["A"], data["b"], data["dims"]
        cones = _cones(clarabel, dims)
        rows, columns = _units(P, sp.csc_array(A), dims)
        A = sp.csc_matrix(sp.diags_array(rows) @ A @ sp.diags_array(columns))
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_iter = self.max_iter
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = self.tol
        settings.presolve_enable = False  # updates need the problem as it was set up
        if not cone.certifiable:  # an answer stands if Clarabel calls it solved
            for name, value in CAREFUL.items():
                setattr(settings, name, value)

        def build(linear: np.ndarray) -> Any:
            return clarabel.DefaultSolver(P, linear, A, rows * b, cones, settings)

        def run(engine: Any) -> EngineAnswer:
            solution = engine.solve()
            status = str(solution.status)
            return EngineAnswer(np.array(solution.x), solution.iterations, status, status in USABLE)

        return Workspace(build, run, columns)


def _units(P: Any, A: sp.csc_array, dims: Any) -> tuple[np.ndarray, np.ndarray]:
    """Units of the rows and of the variables in which no cone is larger than another.

    The variables of the quadratic term have theirs already. A cone that they are in gets their
    unit, and all other variables that of their cones: |p| <= t with p in 1e-10 lets a solver that
    meets both sides to 1e-9 forget p (discs in mixed units at condition 1e12 are not met then).
    """
    tied = np.zeros(A.shape[1], dtype=bool)
    tied[sp.coo_array(P).col] = True
    ends = np.cumsum([0, *[1] * (dims.zero + dims.nonneg), *dims.soc])
    blocks = np.repeat(np.arange(len(ends) - 1), np.diff(ends))
    rows, columns = np.ones(A.shape[0]), np.ones(A.shape[1])
    entries = sp.coo_array(A)
    known = (entries.row < ends[-1]) & (entries.data != 0)
    row, column, size = entries.row[known], entries.col[known], np.abs(entries.data[known])
    sizes = np.zeros(len(ends) - 1)
    at = tied[column]
    np.maximum.at(sizes, blocks[row[at]], size[at])
    rows[: ends[-1]] = np.where(sizes > 0, 1 / np.where(sizes > 0, sizes, 1.0), 1.0)[blocks]
    largest = np.zeros(A.shape[1])
    np.maximum.at(largest, column, size * rows[row])
    free = ~tied & (largest > 0)
    columns[free] = 1 / largest[free]
    return rows, columns


def _cones(clarabel: Any, dims: Any) -> list[Any]:
    """cvxpy's cone dimensions in Clarabel's words."""
    cones = [clarabel.ZeroConeT(dims.zero)] if dims.zero else []
    cones += [clarabel.NonnegativeConeT(dims.nonneg)] if dims.nonneg else []
    cones += [clarabel.SecondOrderConeT(size) for size in dims.soc]
    cones += [clarabel.PSDTriangleConeT(size) for size in dims.psd]
    cones += [clarabel.ExponentialConeT()] * dims.exp
    cones += [clarabel.PowerConeT(exponent) for exponent in dims.p3d]
    cones += [clarabel.GenPowerConeT(exponents, 1) for exponents in getattr(dims, "pnd", [])]
    return cones
