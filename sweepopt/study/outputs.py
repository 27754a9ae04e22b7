"""What a study leaves to read: the table, the diagram, the report with a trajectory a problem."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sweepopt.errors import SweepoptError, SweepoptWarning
from sweepopt.results import Solution
from sweepopt.study.advice import advice
from sweepopt.study.diagram import work_precision
from sweepopt.study.hard.page import write_hard
from sweepopt.study.hard.table import HardRow
from sweepopt.study.measure import Cell, solution_of
from sweepopt.study.report import Trajectory, write_report
from sweepopt.study.study import Study

if TYPE_CHECKING:
    from pandas import DataFrame

TABLE, DIAGRAM, REPORT, HARD = "table.csv", "diagram.png", "report.html", "hard.csv"
SHOWN = 1e-2
"""Relative error of the trajectories in the report: their bands can be seen."""


def write_outputs(
    study: Study, table: DataFrame, folder: Path, hard: Sequence[HardRow] = ()
) -> list[str]:
    """Write all files of a finished study, with its hard cases if it has some; their names.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    table.to_csv(folder / TABLE, index=False)
    work_precision(table).figure.savefig(folder / DIAGRAM)
    title = study.title or "What accuracy costs"
    shown = trajectories(study, table)
    write_report(table, folder / REPORT, trajectories=shown, hard=hard, title=title)
    if not hard:
        return [TABLE, DIAGRAM, REPORT]
    write_hard(hard, folder / HARD)
    return [TABLE, DIAGRAM, HARD, REPORT]


def write_hard_outputs(hard: Sequence[HardRow], folder: Path, title: str) -> list[str]:
    """Write the files of hard cases alone; their names."""
    write_hard(hard, folder / HARD)
    write_report(None, folder / REPORT, hard=hard, title=title or "Hard cases")
    return [HARD, REPORT]


def trajectories(study: Study, table: DataFrame) -> list[Trajectory]:
    """The fastest run of each problem with an error of SHOWN, solved again, with its band."""
    chosen = set(advice(table, (SHOWN,)).cell)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SweepoptWarning)  # the table has them
        return [trajectory_of(cell) for cell in study.cells() if cell.id in chosen]


def trajectory_of(cell: Cell) -> Trajectory:
    """The component that moves most and the band that holds the solution's."""
    solution = solution_of(cell)
    k = int(np.argmax(np.ptp(solution.u, axis=0)))
    return Trajectory(
        cell.problem.name,
        solution.plan.scheme.name,
        len(solution.t) - 1,
        solution.t,
        solution.u[:, k],
        band(solution, k),
        f"u[{k}]",
    )


def band(solution: Solution, k: int) -> np.ndarray | None:
    """A bound of |u_k(t_i) - u_n,k(t_i)|, shape (n+1,): |e_k| <= |e|_A sqrt((A^-1)_kk).

    None if the library has no bound, or none that is finite.
    """
    try:
        of_t = solution.error_bound().of_t
    except SweepoptError:
        return None
    unit = np.zeros(solution.process.dim)
    unit[k] = 1.0
    factor = float(np.sqrt(solution.process.metric.solve(unit)[k]))
    # a node belongs to two steps; both bounds hold there
    of_nodes = np.concatenate([of_t[:1], np.minimum(of_t[:-1], of_t[1:]), of_t[-1:]])
    return factor * of_nodes if np.isfinite(of_nodes).all() else None
