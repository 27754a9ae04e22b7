"""What a cell's error is measured against: the exact states, or a fine run that knows its error."""

from __future__ import annotations

import warnings
from math import inf, nan
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sweepopt.errors import DamagedFileError, SweepoptError, SweepoptWarning
from sweepopt.io import read_npz, write_npz
from sweepopt.solve import solve
from sweepopt.study.machine import one_thread
from sweepopt.study.sources import Source

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

    u: np.ndarray
    uncertainty: float = inf
    message: str = ""


def make_reference(source: Source, steps: int) -> Reference:
    """The states of a problem on a grid of equal steps, as well as the library knows them.

    A pure function of plain data: it runs in workers. What goes wrong leaves no states.
    """
    with one_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore", SweepoptWarning)
        try:
            return _exact(source, steps) or _refined(source, steps)
        except Exception as error:
            return absent(f"{type(error).__name__}: {error}")


def absent(message: str) -> Reference:
    """No states, and why."""
    return Reference(np.empty((0, 0)), message=message)


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


def distance(source: Source, u: np.ndarray, v: np.ndarray) -> float:
    """sup over the nodes of |u_i - v_i|_A, of |.|_B where A = 0."""
    return max(map(source.open().process.metric.norm, u - v))


def error_of(source: Source, u: np.ndarray, reference: Reference) -> float:
    """The error of the states on the nodes; nan if the reference's is not far below."""
    if len(u) != len(reference.u):
        return nan
    error = distance(source, u, reference.u)
    return error if error >= SAFETY * reference.uncertainty else nan


def _exact(source: Source, steps: int) -> Reference | None:
    """The event-exact integrator's states, None where it does not apply."""
    process, t_end = source.open()
    try:
        sol = solve(process, t_end=t_end, steps=steps, scheme="exact")
    except SweepoptError:
        return None
    return Reference(sol.u, 0.0) if sol.success else None


def _refined(source: Source, steps: int) -> Reference:
    process, t_end = source.open()

    fine, coarse = (
        solve(
            process,
            t_end=t_end,
            steps=steps * times,
            scheme="sdirk2",
            tol=TOL,
            save=times,
            on_unstable="ignore",
        ).u
        for times in (REFINED, REFINED // 2)
    )
    return Reference(fine, distance(source, fine, coarse))
