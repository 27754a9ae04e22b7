"""A component of a run over time, with the band that surely holds the solution's."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sweepopt.checks import count, vector
from sweepopt.errors import InputError, SweepoptError, SweepoptWarning
from sweepopt.results import Solution
from sweepopt.study.advice import advice
from sweepopt.study.cell import Cell, solution_of
from sweepopt.study.study import Study

if TYPE_CHECKING:
    from pandas import DataFrame

SHOWN = 1e-2
"""Relative error of the trajectories in the report: their bands can be seen."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One component of a run over time.

    Attributes
    ----------
    problem, scheme : str
    steps : int
    t, u : ndarray, shape (k,)
        Times, strictly increasing, and the component there.
    band : ndarray, shape (k,), or None
        Half-width of the band: a bound of the component's error at each time.
    component : str
        What u is, for example "displacement of the block (mm)".

    Raises
    ------
    InputError
        If shapes disagree, a number is not finite, times do not increase or a half-width is below
        zero.

    Examples
    --------
    >>> run = Trajectory("block", "midpoint", 2, [0, 1, 2], [0.0, 0.5, 0.5], [0.0, 0.1, 0.1], "mm")
    >>> run.u - run.band
    array([0. , 0.4, 0.4])
    """

    problem: str
    scheme: str
    steps: int
    t: np.ndarray
    u: np.ndarray
    band: np.ndarray | None = None
    component: str = "u"

    def __post_init__(self) -> None:
        count("steps", self.steps)
        t = vector("t", self.t)
        if t.size < 2 or not (np.diff(t) > 0.0).all():
            raise InputError("t must hold two times or more, each later than the one before")
        checked = {"t": t, "u": vector("u", self.u, t.size)}
        if self.band is not None:
            checked["band"] = band = vector("band", self.band, t.size)
            if (band < 0.0).any():
                k = int(np.flatnonzero(band < 0.0)[0])
                raise InputError(f"band[{k}] is {band[k]:g}; give half-widths >= 0")
        for name, value in checked.items():
            object.__setattr__(self, name, value)


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
    scheme, steps = solution.plan.scheme.name, len(solution.t) - 1
    u, band = solution.u[:, k], _band(solution, k)
    return Trajectory(cell.problem.name, scheme, steps, solution.t, u, band, f"u[{k}]")


def _band(solution: Solution, k: int) -> np.ndarray | None:
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
