"""States of a long run in a NetCDF file: written in blocks, read row by row."""

from __future__ import annotations

import os
import uuid
from pathlib import Path
from typing import Any

import numpy as np

from sweepopt.errors import InputError, brought_by
from sweepopt.integrate.states import Index
from sweepopt.io import part_of

BLOCK = 16e6  # bytes that wait in memory


class BlockWriter:
    """Appends times, states and velocities to a file that takes its name when it is closed.

    Dimensions are time (one longer), step and unknown, as in `Solution.to_xarray`; `steps` counts
    the steps it got.

    Raises
    ------
    MissingExtraError
        If h5netcdf or h5py is not installed.
    """

    def __init__(self, path: Path, t: float, u0: np.ndarray) -> None:
        h5netcdf = netcdf_package()
        self.path = path
        self._part = part_of(path)
        self._file = h5netcdf.File(self._part, "w")
        self.run = uuid.uuid4().hex
        self._file.attrs["run"] = self.run
        self._file.dimensions = {"time": None, "step": None, "unknown": u0.size}
        rows = max(int(BLOCK // (16 * u0.size)), 1)
        for name, dims, words in (
            ("time", ("time",), "time"),
            ("u", ("time", "unknown"), "u_n at the grid times"),
            ("velocity", ("step", "unknown"), "velocity u_n' in each step"),
        ):
            chunks = (1024,) if len(dims) == 1 else (min(rows, 64), u0.size)
            variable = self._file.create_variable(name, dims, float, chunks=chunks)
            variable.attrs.update({"long_name": words, "units": "1"})
        self._t, self._u = np.zeros(rows), np.zeros((rows, u0.size))
        self._z = np.zeros((rows, u0.size))
        self.steps = self._waiting = self._written = 0
        self._grow(1)
        self._file.variables["time"][0], self._file.variables["u"][0] = t, u0

    def put(self, t: float, u: np.ndarray, z: np.ndarray) -> None:
        """Take the state at the end t of the next step and the velocity of the step."""
        row = self._waiting
        self._t[row], self._u[row], self._z[row] = t, u, z
        self._waiting += 1
        self.steps += 1
        if self._waiting == len(self._t):
            self._write()

    def close(self, finished: bool) -> None:
        """Write what waits and put the file in its place; an unfinished one keeps its part name."""
        self._write()
        self._file.close()
        if finished:
            os.replace(self._part, self.path)

    def _write(self) -> None:
        start, count = self._written, self._waiting
        if count:
            self._grow(start + count + 1)
            variables = self._file.variables
            variables["time"][start + 1 : start + count + 1] = self._t[:count]
            variables["u"][start + 1 : start + count + 1] = self._u[:count]
            variables["velocity"][start : start + count] = self._z[:count]
        self._written, self._waiting = start + count, 0

    def _grow(self, nodes: int) -> None:
        self._file.resize_dimension("time", nodes)
        self._file.resize_dimension("step", nodes - 1)


class Stored:
    """States in a file that `BlockWriter` wrote; `run` tells it from a file of another run."""

    def __init__(self, path: Path, run: str) -> None:
        self.path, self.run = path, run

    def u(self, i: Index) -> np.ndarray:
        return self._read("u", i)

    def velocity(self, i: Index) -> np.ndarray:
        return self._read("velocity", i)

    def _read(self, name: str, i: Index) -> np.ndarray:
        if not self.path.is_file():
            raise InputError(f"{self.path}, which holds the states of this run, is not there")
        with netcdf_package().File(self.path, "r") as file:
            if file.attrs.get("run") != self.run:
                raise InputError(f"another run has written {self.path}: these states are gone")
            variable = file.variables[name]
            if isinstance(i, slice):
                return np.asarray(variable[i])
            rows = [np.asarray(variable[int(k)]) for k in np.ravel(i)]
            return np.reshape(rows, (*np.shape(i), variable.shape[1]))


def netcdf_package() -> Any:
    """The package h5netcdf, if it is there with all that it needs to write."""
    with brought_by("fem"):
        import h5netcdf
        import h5py  # noqa: F401  # h5netcdf alone cannot write
    return h5netcdf
