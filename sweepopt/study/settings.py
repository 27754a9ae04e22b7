"""The solvers that are compared, each with its settings for a low, a middle and a high accuracy."""

from __future__ import annotations

from typing import Any, NamedTuple

from sweepopt.sets import ConvexSet
from sweepopt.velocity import DAQP, OSQP, Clarabel, Cvxpy, Newton, Solver, installed

ACCURACIES = {"low": 1e-3, "mid": 1e-6, "high": 1e-9}
TOLERANCES: dict[str, tuple[str, ...]] = {
    "CLARABEL": ("tol_gap_abs", "tol_gap_rel", "tol_feas"),
    "OSQP": ("eps_abs", "eps_rel"),
    "PIQP": ("eps_abs", "eps_rel"),
    "PROXQP": ("eps_abs", "eps_rel"),
    "DAQP": ("primal_tol", "dual_tol"),
    "SCS": ("eps_abs", "eps_rel"),
    "QOCO": ("abstol", "reltol"),
    "MOSEK": ("eps",),
}
"""What each solver calls its tolerances in cvxpy's interface."""
LIMITS: dict[str, dict[str, Any]] = {
    "OSQP": {"max_iter": 20_000},
    "SCS": {"max_iters": 20_000},
    "PROXQP": {"max_iter": 10_000},
}
"""Iterations, for methods of first order."""


class Contestant(NamedTuple):
    """A solver with the settings of one accuracy."""

    name: str
    setting: str
    accuracy: float
    solver: Solver


def contestants(C: ConvexSet) -> list[Contestant]:
    """The library's own solvers and those installed for cvxpy, as far as they treat the set."""
    exact: list[Solver] = [Newton(), DAQP()]
    found = [Contestant(one.name, "high", ACCURACIES["high"], one) for one in exact]
    for setting, tol in ACCURACIES.items():
        own: list[Solver] = [Clarabel(tol=tol), OSQP(tol=tol)]
        found += [Contestant(one.name, setting, tol, one) for one in own]
        for name, keys in TOLERANCES.items():
            if name in installed():
                settings = {**dict.fromkeys(keys, tol), **LIMITS.get(name, {})}
                solver = Cvxpy(name, settings)
                found.append(Contestant(solver.name, setting, tol, solver))
    return [contestant for contestant in found if contestant.solver.treats(C)]
