"""Solutions as NetCDF files and xarray datasets, every variable with its unit and name.

`NetCDFSink` takes the states of a long run in blocks while it goes, and reads them later.
"""

from __future__ import annotations

import os
import uuid
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.errors import InputError, brought_by
from sweepopt.integrate import Index, States, StepInfo
from sweepopt.io import part_of, versions_of

if TYPE_CHECKING:
    import xarray as xr

    from sweepopt.results.solution import Solution

BLOCK = 16e6  # bytes that wait in memory: large enough that writing them costs little


class NetCDFSink:
    """Appends times, states and velocities to a file that takes its name when it is closed.

    Dimensions are time (one longer), step and unknown, as in `Solution.to_xarray`.

    Attributes
    ----------
    steps : int
        How many steps it got.

    Raises
    ------
    MissingExtraError
        If h5netcdf or h5py is not installed.
    """

    def __init__(self, path: Path, t: float, u0: np.ndarray) -> None:
        self._path, self._part = path, part_of(path)
        self._file = netcdf_package().File(self._part, "w")
        self._run = uuid.uuid4().hex  # tells the file from one of another run
        self._file.attrs["run"] = self._run
        self._file.dimensions = {"time": None, "step": None, "unknown": u0.size}
        block = max(int(BLOCK // (16 * u0.size)), 1)
        for name, dims, words in (
            ("time", ("time",), "time"),
            ("u", ("time", "unknown"), "u_n at the grid times"),
            ("velocity", ("step", "unknown"), "velocity u_n' in each step"),
        ):
            chunks = (1024,) if len(dims) == 1 else (min(block, 64), u0.size)
            created = self._file.create_variable(name, dims, float, chunks=chunks)
            created.attrs.update({"long_name": words, "units": "1"})
        self._block = {
            "time": np.zeros(block),
            "u": np.zeros((block, u0.size)),
            "velocity": np.zeros((block, u0.size)),
        }
        self.steps = self._written = 0
        self._file.resize_dimension("time", 1)
        self._file.variables["time"][0], self._file.variables["u"][0] = t, u0

    def put(self, step: StepInfo) -> None:
        """Take the state at the end of the next step and the velocity of the step."""
        row = self.steps - self._written
        for name, value in (("time", step.t), ("u", step.u), ("velocity", step.velocity)):
            self._block[name][row] = value
        self.steps += 1
        if row + 1 == len(self._block["time"]):
            self._write()

    def close(self, finished: bool) -> None:
        """Write what waits and put the file in its place; an unfinished one keeps its part name."""
        self._write()
        self._file.close()
        if finished:
            os.replace(self._part, self._path)

    def _write(self) -> None:
        start, end = self._written, self.steps
        self._file.resize_dimension("time", end + 1)
        self._file.resize_dimension("step", end)
        for name, rows in self._block.items():
            first = 0 if name == "velocity" else 1  # the start has a state and no velocity
            self._file.variables[name][start + first : end + first] = rows[: end - start]
        self._written = end

    def states(self) -> States:
        """The states in the file, read when they are asked for."""

        def read(name: str, i: Index) -> np.ndarray:
            if not self._path.is_file():
                raise InputError(f"{self._path}, which holds the states of this run, is not there")
            with netcdf_package().File(self._path, "r") as file:
                if file.attrs.get("run") != self._run:
                    raise InputError(f"another run has written {self._path}: these states are gone")
                stored = file.variables[name]
                if isinstance(i, slice):
                    return np.asarray(stored[i])
                rows = [np.asarray(stored[int(k)]) for k in np.ravel(i)]
                return np.reshape(rows, (*np.shape(i), stored.shape[1]))

        return States(partial(read, "u"), partial(read, "velocity"))


def netcdf_package() -> Any:
    """The package h5netcdf, if it is there with all that it needs to write."""
    with brought_by("fem"):
        import h5netcdf
        import h5py  # noqa: F401  # h5netcdf alone cannot write
    return h5netcdf


# ---- datasets -----------------------------------------------------------------------------------


def to_xarray(solution: Solution) -> xr.Dataset:
    """A solution as a dataset: u, velocity and the statistics of each step; see there."""
    kept = "step" if solution.complete else "kept_step"
    variables = {
        "u": variable(("time", "unknown"), solution.u, "u_n at the kept grid times"),
        "velocity": variable(
            (kept, "unknown"), solution.velocity, "velocity u_n' in each kept step"
        ),
        **statistics_of(solution),
    }
    coordinates = {
        **times_of(solution),
        kept: variable((kept,), solution.steps, "step, counted from 0"),
        "unknown": variable(("unknown",), np.arange(solution.u.shape[1]), "unknown"),
    }
    return dataset(variables, coordinates, attributes_of(solution, "A sweeping process"))


def dataset(
    variables: dict[str, Any], coordinates: dict[str, Any], attributes: dict[str, Any]
) -> xr.Dataset:
    """An xarray.Dataset.

    Raises
    ------
    MissingExtraError
        If xarray is not installed.
    """
    with brought_by("fem"):
        import xarray
    return xarray.Dataset(variables, coordinates, attributes)


def variable(
    dims: tuple[str, ...], values: Any, long_name: str, units: str = "1", **attributes: Any
) -> tuple[Any, ...]:
    """A variable of a dataset."""
    return dims, values, {"long_name": long_name, "units": units, **attributes}


def times_of(solution: Solution, unit: str = "1") -> dict[str, Any]:
    """The kept times and the ends of all steps."""
    ends = solution.stats["t"]
    return {
        "time": variable(("time",), solution.t, "time", unit),
        "step": variable(("step",), np.arange(len(ends)), "step, counted from 0"),
        "step_end": variable(("step",), ends, "time at the end of the step", unit),
    }


def statistics_of(
    solution: Solution, certificate: str = "1", viability: str = "1"
) -> dict[str, Any]:
    """What is known of each step, with the units of its certificate and viability."""
    stats = solution.stats
    described = {
        "certificate": ("largest error bound of the step's velocity programs", certificate),
        "relative": ("certificate relative to the size of the program, what tol bounds", "1"),
        "iterations": ("iterations of the solver", "1"),
        "attempts": ("solvers and settings tried; 0 where the body is at rest", "1"),
        "seconds": ("wall time of the step", "s"),
    }
    steps = {name: variable(("step",), stats[name], *words) for name, words in described.items()}
    answered = "solver that answered the step"
    steps["solver"] = variable(("step",), stats["solver"].astype(object), answered)
    bound = "bound of the distance of the step's force to C"
    steps["viability"] = variable(("step",), solution.viability(), bound, viability)
    return steps


def attributes_of(solution: Solution, title: str) -> dict[str, Any]:
    """How the solution came about."""
    plan = solution.plan
    solver = solver_name(solution)
    return {
        "title": title,
        "software": ", ".join(f"{name} {number}" for name, number in software(solution).items()),
        "status": solution.status.name.lower(),
        "message": solution.message,
        "scheme": plan.scheme.name,
        "solver": solver,
        "tol": plan.tol,
    }


def solver_name(solution: Solution) -> str:
    """The solver that the plan tries first; "linear" if no step needs one."""
    solvers = solution.plan.solvers
    return solvers[0].name if solvers else "linear"


def software(solution: Solution) -> dict[str, str]:
    """Versions of what computed the solution."""
    solver = solver_name(solution).split(":")[-1]
    names = ["sweepopt", "numpy", "scipy", "cvxpy", "osqp", "clarabel", "scikit-fem", solver]
    return versions_of(names)
