"""A component of a run over time, with the band that surely holds the solution's."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from sweepopt.errors import SweepoptError, SweepoptWarning
from sweepopt.results import Solution
from sweepopt.study.advice import advice
from sweepopt.study.cell import solution_of
from sweepopt.study.study import Study

if TYPE_CHECKING:
    from pandas import DataFrame

SHOWN = 1e-2
"""Relative error of the runs in the report: their bands can be seen."""


class Curve(NamedTuple):
    """u[component] at the times t, and the half-width of its band; None if there is no bound."""

    t: np.ndarray
    u: np.ndarray
    band: np.ndarray | None
    component: int


def fastest_runs(study: Study, table: DataFrame) -> dict[str, Solution]:
    """The fastest run of each problem with a relative error of SHOWN, solved again."""
    chosen = set(advice(table, (SHOWN,)).cell)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SweepoptWarning)  # the table has them
        return {
            f"{cell.problem.name}: {cell.scheme}, {cell.steps} steps": solution_of(cell)
            for cell in study.cells()
            if cell.id in chosen
        }


def most_moving(solution: Solution) -> Curve:
    """The component that moves most, with a bound of |u_k(t_i) - u_n,k(t_i)|.

    |e_k| <= |e|_A sqrt((A^-1)_kk).
    """
    k = int(np.argmax(np.ptp(solution.u, axis=0)))
    t, u = solution.t, solution.u[:, k]
    try:
        of_t = solution.error_bound().of_t
    except SweepoptError:
        return Curve(t, u, None, k)
    unit = np.zeros(solution.process.dim)
    unit[k] = 1.0
    factor = float(np.sqrt(solution.process.metric.solve(unit)[k]))
    # a node belongs to two steps; both bounds hold there
    band = factor * np.concatenate([of_t[:1], np.minimum(of_t[:-1], of_t[1:]), of_t[-1:]])
    return Curve(t, u, band if np.isfinite(band).all() else None, k)
