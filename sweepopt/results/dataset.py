"""Solutions as NetCDF files and xarray datasets, every variable with its unit and name.

`NetCDFSink` takes the states of a long run in blocks while it goes, and reads them later.
"""

from __future__ import annotations

import hashlib
import json
import os
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from io import BytesIO, FileIO
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.checks import Array
from sweepopt.errors import DamagedFileError, InputError, brought_by
from sweepopt.integrate import Index, States, StepInfo, fingerprint
from sweepopt.io import as_path, part_of, versions_of

if TYPE_CHECKING:
    import xarray as xr

    from sweepopt.results.solution import Solution

BLOCK_BYTES = 8e6  # bytes that wait in memory: large enough that writing them costs little


U, VELOCITY = "u_n at the kept grid times", "velocity u_n' in each kept step"
CHECKED = {"libver": ("v110", "v110")}  # of HDF5: its own tables have checksums too
MARK = b"\nSHA-256 of all bytes before this line: "  # behind the end that HDF5 knows of


class _Storage(FileIO):
    """A file for HDF5, which crashes at exit if it saw that it could not be written.

    Attributes
    ----------
    failure : OSError or None
        The first one; nothing is written after it.
    """

    failure: OSError | None = None

    def write(self, data: Any) -> int:
        rest = memoryview(data).cast("B")
        size = len(rest)
        with self._record_failure():
            while rest and not self.failure:
                rest = rest[super().write(rest) :]
        return size

    def truncate(self, size: int | None = None) -> int:
        with self._record_failure():
            return 0 if self.failure else super().truncate(size)
        return 0

    @contextmanager
    def _record_failure(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.failure = error


class NetCDFSink:
    """Appends times, states and velocities to a file that takes its name when it is closed.

    Dimensions are time (one longer), step and unknown, as in `Solution.to_xarray`. All arrays
    have checksums.

    Attributes
    ----------
    storage : _Storage
        Knows whether the file can be written.

    Raises
    ------
    MissingExtraError
        If h5netcdf or h5py is not installed.
    """

    def __init__(self, path: Path, t: float, u0: Array, unknowns_digest: str = "") -> None:
        self._path, self._part = path, part_of(path)
        package = netcdf_package()
        self.storage = _Storage(self._part, "w+")
        self._file = package.File(self.storage, "w", **CHECKED)
        self._run = self._file.attrs["run"] = uuid.uuid4().hex  # another run has another one
        self._file.attrs["unknowns_digest"] = unknowns_digest
        self._file.dimensions = {"time": None, "step": None, "unknown": u0.size}
        self._most = max(int(BLOCK_BYTES // (16 * u0.size)), 1)
        for name, dims, words in (
            ("time", ("time",), "time"),
            ("u", ("time", "unknown"), U),
            ("velocity", ("step", "unknown"), VELOCITY),
        ):
            created = self._file.create_variable(name, dims, float, fletcher32=True)
            created.attrs.update({"long_name": words, "units": "1"})
        self._file.resize_dimension("time", 1)
        self._file.variables["time"][0], self._file.variables["u"][0] = t, u0
        self._steps, self._waiting, self._last = 0, list[StepInfo](), list[StepInfo]()
        self._u0 = u0

    def put(self, step: StepInfo) -> bool:
        """Take the state at the end of the next step and the velocity of the step.

        The answer is whether the file cannot be written.
        """
        # a copy: a callback may change the state that it sees
        self._last = [step._replace(u=step.u.copy(), velocity=step.velocity.copy())]
        self._waiting += self._last
        if len(self._waiting) == self._most:
            self._write()
        return self.storage.failure is not None

    def close(self, solution: Solution | None) -> None:
        """Write what waits and put the file in its place; an unfinished one keeps its part name.

        One that cannot be written disappears.

        Parameters
        ----------
        solution : Solution or None
            The run, if it is finished: its statistics come beside the states.
        """
        self._write()
        if solution and not self.storage.failure:
            _dump(to_xarray(solution, states=False), self._file)
        self._file.close()
        _end_with_checksum(self.storage)
        self.storage.close()
        if self.storage.failure:
            self._part.unlink()
        elif solution:
            os.replace(self._part, self._path)

    def _write(self) -> None:
        start, variables = self._steps, self._file.variables
        end = start + len(self._waiting)
        if end == start or self.storage.failure:
            return
        self._file.resize_dimension("time", end + 1)
        self._file.resize_dimension("step", end)
        variables["time"][start + 1 :] = [step.t for step in self._waiting]
        variables["u"][start + 1 :] = [step.u for step in self._waiting]
        variables["velocity"][start:] = [step.velocity for step in self._waiting]
        self._file.flush()  # so that a failure is seen before the block is forgotten
        if not self.storage.failure:
            # one assignment at the end: what Ctrl-C cuts short is written again by `close`
            self._steps, self._waiting = end, []

    def states(self) -> States:
        """The states in the file, read when asked for; if that failed what waits, or the last."""
        self._write()
        if self.storage.failure:
            steps = self._waiting or self._last
            nodes = np.array([self._u0, *(step.u for step in steps)])
            velocities = np.array([step.velocity for step in steps]).reshape(-1, self._u0.size)
            done = np.array([step.step for step in steps], dtype=int)
            return States(done, nodes.__getitem__, velocities.__getitem__)

        def read(name: str, i: Index) -> Array:
            if not self._path.is_file():
                raise InputError(f"{self._path}, which holds the states of this run, is not there")
            package = netcdf_package()
            try:
                with package.File(self._path, "r") as file:
                    if file.attrs.get("run") == self._run:
                        variable = file.variables[name]
                        chosen = np.arange(variable.shape[0])[i]
                        rows = np.unique(chosen)  # a file has them read in order, each once
                        return np.asarray(variable[rows])[np.searchsorted(rows, chosen)]
            except Exception as error:  # h5py has no list of what it raises
                raise DamagedFileError(
                    f"{self._path} is damaged ({error}); its states are lost, run again"
                ) from error
            raise InputError(f"another run has written {self._path}: these states are gone")

        return States(np.arange(self._steps), partial(read, "u"), partial(read, "velocity"))


def netcdf_package() -> Any:
    """The package h5netcdf, if it is there with all that it needs to write."""
    with brought_by("fem"):
        import h5netcdf
        import h5py  # noqa: F401  # h5netcdf alone cannot write
        import xarray  # noqa: F401
    return h5netcdf


def netcdf_bytes(dataset: xr.Dataset) -> bytes:
    """A file of the dataset, compressed and with checksums.

    It is made in memory: HDF5 crashes at exit where a disk is full.
    """
    package, content = netcdf_package(), BytesIO()
    with package.File(content, "w", **CHECKED) as file:
        _dump(dataset, file)
    _end_with_checksum(content)
    return content.getvalue()


def _end_with_checksum(file: BytesIO | FileIO) -> None:
    """Without it HDF5 has to judge damage: in its heaps of texts it can then read without end."""
    file.seek(0)
    digest = hashlib.file_digest(file, "sha256").digest()
    file.seek(0, os.SEEK_END)
    file.write(MARK + digest)


def _check(path: Path) -> None:
    """Raise DamagedFileError if a file is not what was written, before HDF5 reads a byte of it."""
    content = np.memmap(path, np.uint8, "r") if path.stat().st_size else np.zeros(0, np.uint8)
    before, last = np.split(content, [-len(MARK) - hashlib.sha256().digest_size])
    if last.tobytes() != MARK + hashlib.sha256(before.data).digest():
        raise DamagedFileError(
            f"{path} is damaged, or no file that this library wrote: what xarray has written again "
            "is read by xarray.open_dataset, a checkpoint by so.resume"
        )


def _dump(dataset: xr.Dataset, file: Any) -> None:
    """Write a dataset into an open file."""
    from xarray.backends import H5NetCDFStore

    packed = {"zlib": True, "complevel": 1, "shuffle": True, "fletcher32": True}
    # text as characters, as strings have no checksum
    encoding = {
        name: packed | ({"dtype": "S1"} if x.dtype.kind in "OU" else {})
        for name, x in dataset.variables.items()
        if x.ndim and name not in file.variables
    }
    dataset.dump_to_store(H5NetCDFStore(file), encoding=encoding)


def open_run(path: str | PathLike[str]) -> xr.Dataset:
    """What was written of a run by `netcdf_bytes` or a `NetCDFSink`; close it, or use it by with.

    Raises
    ------
    InputError
        If there is no such file.
    MissingExtraError
        If h5netcdf or xarray is not installed.
    DamagedFileError
        If it is not as it was written, by its checksum.
    """
    netcdf_package()
    import xarray

    file_of_run = as_path("path", path)
    if not file_of_run.is_file():
        remedy = "; it is a folder, name the file in it" if file_of_run.is_dir() else ""
        raise InputError(f"path: there is no file {path}{remedy}")
    _check(file_of_run)
    return xarray.open_dataset(file_of_run, engine="h5netcdf")


# ---- datasets -----------------------------------------------------------------------------------

STATISTICS = {
    "certificate": "largest error bound of the step's velocity programs",
    "relative": "certificate relative to the size of the program, what tol bounds",
    "iterations": "iterations of the solver",
    "attempts": "solvers and settings tried; 0 where the body is at rest",
    "seconds": "wall time of the step",
    "solver": "solver that answered the step",
}


def to_xarray(solution: Solution, states: bool = True) -> xr.Dataset:
    """A solution as a dataset: u, velocity if `states`, and the statistics of each step.

    Raises
    ------
    MissingExtraError
        If xarray is not installed.
    """
    with brought_by("fem"):
        import xarray
    kept, stats, plan = "step" if solution.complete else "kept_step", solution.stats, solution.plan
    variables: dict[str, tuple[Any, Any, str]] = {
        **{name: ("step", stats[name], words) for name, words in STATISTICS.items()},
        "viability": ("step", solution.viability(), "bound of the distance of its force to C"),
        "time": ("time", solution.t, "time"),
        "step": ("step", np.arange(len(stats)), "step, counted from 0"),
        "step_end": ("step", stats["t"], "time at the end of the step"),
        kept: (kept, solution.steps, "step, counted from 0"),
        "unknown": ("unknown", np.arange(solution.process.dim), "unknown"),
    }
    if states:
        u, velocity = solution.u, solution.velocity
        variables["u"] = ("time", "unknown"), u, U
        variables["velocity"] = (kept, "unknown"), velocity, VELOCITY
    run = xarray.Dataset(
        {
            name: (dims, values, {"long_name": words, "units": "s" if name == "seconds" else "1"})
            for name, (dims, values, words) in variables.items()
        },
        attrs={
            "title": "A sweeping process",
            "software": ", ".join(map(" ".join, software(solution).items())),
            "status": solution.status.name.lower(),
            "message": solution.message,
            "scheme": plan.scheme.name,
            "solver": solver_name(solution),
            "tol": plan.tol,
            "unknowns_digest": solution.process.unknowns_digest,
            "problem": json.dumps(fingerprint(solution.process, solution.t)),
        },
    )
    run = run.assign(solver=run.solver.astype(object)).set_coords("step_end")
    if not (fields := solution.process.fields):
        return run
    names = field_names(fields, solution.process.dim)
    return run.assign_coords(field=("unknown", names, {"long_name": "field of the unknown"}))


def field_names(fields: Mapping[str, Any], size: int) -> Array:
    """The name of each unknown's field; "" where it is in none."""
    names = np.full(size, "", dtype=object)
    for name, part in fields.items():
        names[part] = name
    return names


def solver_name(solution: Solution) -> str:
    """The solver that the plan tries first; "linear" if no step needs one."""
    solvers = solution.plan.solvers
    return solvers[0].name if solvers else "linear"


def software(solution: Solution) -> dict[str, str]:
    """Versions of what computed the solution."""
    solver = solver_name(solution).split(":")[-1]
    names = ["sweepopt", "numpy", "scipy", "cvxpy", "osqp", "clarabel", "scikit-fem", solver]
    return versions_of(names)
