"""What a cell's error is measured against: the exact states, or a fine run that knows its error."""

from __future__ import annotations

import warnings
from contextlib import suppress
from math import inf, nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sweepopt.errors import DamagedFileError, SweepoptError, SweepoptWarning
from sweepopt.io import read_npz, write_npz
from sweepopt.problem import SweepingProcess
from sweepopt.results import Solution
from sweepopt.solve import solve
from sweepopt.study.machine import one_thread
from sweepopt.study.sources import Source, open_source

REFINED = 16
"""A fine run has so many times the steps: of order 2, its error is far below the one measured."""
TOL = 1e-8  # of the fine run's programs: a hundredth of the default of a study
SAFETY = 20.0
"""How far below an error the reference's own error must lie for the error to be a number."""


class Reference(NamedTuple):
    """States on the nodes of a cell, shape (steps+1, dim).

    Attributes
    ----------
    u : ndarray
        Empty if there are none.
    uncertainty : float
        Of u, sup over the nodes in |.|_A: the distance from the run with half the steps, which for
        a run of order p is 2^p - 1 times its own error; 0 if exact, inf if there are none.
    message : str
        Why there are none.
    """

    u: np.ndarray = np.empty(0)
    uncertainty: float = inf
    message: str = ""

    def error(self, process: SweepingProcess, u: np.ndarray) -> float:
        """The error of states on the nodes; nan if the reference's own is not far below."""
        if len(u) != len(self.u):
            return nan
        error = largest_norm(process, u - self.u)
        return error if error >= SAFETY * self.uncertainty else nan


def make_reference(source: Source, steps: int) -> Reference:
    """The states of a problem on a grid of equal steps, as well as the library knows them.

    A pure function of plain data: it runs in workers. What goes wrong leaves no states.
    """

    def run(times: int, scheme: str, **settings: Any) -> Solution:
        return solve(process, t_end=t_end, steps=steps * times, scheme=scheme, **settings)

    with one_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore", SweepoptWarning)
        try:
            process, t_end = open_source(source)
            with suppress(SweepoptError):  # the event-exact integrator does not apply
                exact = run(1, "exact")
                if exact.success:
                    return Reference(exact.u, 0.0)
            fine, coarse = (
                run(times, "sdirk2", tol=TOL, save=times, on_unstable="ignore").u
                for times in (REFINED, REFINED // 2)
            )
            return Reference(fine, largest_norm(process, fine - coarse))
        except Exception as error:
            return Reference(message=f"{type(error).__name__}: {error}")


def largest_norm(process: SweepingProcess, u: np.ndarray) -> float:
    """sup over the nodes of |u_i|_A, of |.|_B where A = 0."""
    return max(map(process.metric.norm, u))


def save_reference(path: Path, reference: Reference) -> None:
    """Write it; a zip has a checksum for each of its entries."""
    u, *record = reference
    write_npz(path, {"record": record}, {"u": u})


def load_reference(path: Path) -> Reference | None:
    """Read it; None if it is not there, not whole or of another version."""
    try:
        record, arrays = read_npz(path)
        return Reference(arrays["u"], *record["record"])
    except (OSError, DamagedFileError, KeyError):
        return None
