"""Solutions as NetCDF files and xarray datasets, every variable with its unit and name.

Files are written and read by h5netcdf; only `to_xarray` needs xarray. `StateFiles` takes the
states of a long run while it goes, so that they are not in memory.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from io import FileIO
from os import PathLike
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.checks import Array
from sweepopt.errors import DamagedFileError, InputError, brought_by
from sweepopt.integrate import States, StepInfo, fingerprint
from sweepopt.io import as_path, part_of, replacing, versions_of

if TYPE_CHECKING:
    import xarray as xr

    from sweepopt.results.solution import Solution

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


class StateFiles:
    """The states and velocities of all steps on a disk, in two files that have no name.

    They are there as long as the run's solution. Its NetCDF file is made of them at the end.

    Parameters
    ----------
    path : Path
        The NetCDF file.
    u0 : ndarray, shape (dim,)

    Attributes
    ----------
    failure : str
        Why a file cannot be written, if so.

    Raises
    ------
    InputError
        If there is no place for them beside it.
    MissingExtraError
        If h5netcdf or h5py is not installed.
    """

    failure = ""

    def __init__(self, path: Path, u0: Array) -> None:
        netcdf_package()  # told before the run
        self._path, self._size = path, u0.size
        try:
            self._nodes, self._velocities = (_anonymous_file(path.parent) for _ in range(2))
            self._nodes.write(u0.data)
            if self._nodes.failure:
                raise self._nodes.failure
        except OSError as error:
            raise InputError(f"save: {path} cannot be written ({error.strerror})") from None

    def put(self, step: StepInfo) -> bool:
        """Take the state at the end of the next step and the velocity of the step.

        The answer is whether they cannot be written.
        """
        self._nodes.write(step.u.data)
        self._velocities.write(step.velocity.data)
        if failure := self._nodes.failure or self._velocities.failure:
            self.failure = str(failure.strerror)
        return bool(self.failure)

    def states(self) -> States:
        """The states so far; no more are written."""
        with self._nodes, self._velocities:
            nodes, velocities = map(self._rows, (self._nodes, self._velocities))
        count = min(len(nodes) - 1, len(velocities))
        u, velocity = nodes[: count + 1], velocities[:count]
        return States(np.arange(count), u.__getitem__, velocity.__getitem__)

    def _rows(self, file: _Storage) -> Array:
        """Those that are whole, read when asked for."""
        count = file.tell() // (8 * self._size)
        shape = count, self._size
        return np.asarray(np.memmap(file, float, "r", shape=shape)) if count else np.empty(shape)

    def close(self, solution: Solution, succeeded: bool) -> None:
        """Write the file of a run; that of one that failed has the name of a part."""
        try:
            if not self.failure:
                file = self._path if succeeded else part_of(self._path)
                write_dataset(dataset_of(solution), file)
        except (Exception, KeyboardInterrupt) as error:  # the run is not lost with its file
            self.failure = getattr(error, "strerror", "") or repr(error)


def _anonymous_file(folder: Path) -> _Storage:
    with TemporaryFile(dir=folder) as file:
        return _Storage(os.dup(file.fileno()), "r+")


def netcdf_package() -> Any:
    """The package h5netcdf, if it is there with all that it needs to write."""
    with brought_by("fem"):
        import h5netcdf
        import h5py  # noqa: F401  # h5netcdf alone cannot write
    return h5netcdf


Variable = tuple[tuple[str, ...], Any, dict[str, str]]


@dataclass
class Dataset:
    """Named arrays on named dimensions, as a NetCDF file has them.

    Attributes
    ----------
    variables : dict of str to tuple
        Dimensions, values and attributes, what xarray.Dataset takes.
    attributes : dict of str
    coordinates : set of str
        Variables that say where the others are, beside those named as a dimension.
    """

    variables: dict[str, Variable]
    attributes: dict[str, Any]
    coordinates: set[str]


def write_dataset(dataset: Dataset, path: Path) -> None:
    """Replace a file by one of the dataset, compressed and with checksums.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    package = netcdf_package()
    with replacing(path) as part, _Storage(part, "w+") as storage:
        with package.File(storage, "w", **CHECKED) as file:
            _dump(dataset, file)
        # without a checksum of all HDF5 has to judge damage: in its heaps of texts it can then
        # read without end
        storage.seek(0)
        digest = hashlib.file_digest(storage, "sha256").digest()
        storage.seek(0, os.SEEK_END)
        storage.write(MARK + digest)
        if storage.failure:
            raise storage.failure


def _check(path: Path) -> None:
    """Raise DamagedFileError if a file is not what was written, before HDF5 reads a byte of it."""
    try:
        content = np.memmap(path, np.uint8, "r") if path.stat().st_size else np.zeros(0, np.uint8)
    except OSError as error:
        raise InputError(f"path: {path} cannot be read ({error.strerror})") from None
    before, last = np.split(content, [-len(MARK) - hashlib.sha256().digest_size])
    if last.tobytes() != MARK + hashlib.sha256(before.data).digest():
        raise DamagedFileError(
            f"{path} is damaged, or no file that this library wrote: what xarray has written again "
            "is read by xarray.open_dataset, a checkpoint by so.resume"
        )


def _dump(dataset: Dataset, file: Any) -> None:
    """Write a dataset into an open file."""
    packed = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}
    where = sorted(dataset.coordinates)
    for name, (dimensions, values, attributes) in dataset.variables.items():
        values = np.asarray(values)
        if values.dtype.kind == "O":  # text as characters, as strings have no checksum
            texts = np.char.encode(values.astype(str), "utf-8")
            values = texts[..., None].view("S1")
            dimensions = (*dimensions, f"string{values.shape[-1]}")
            attributes = attributes | {"_Encoding": "utf-8"}
        for dimension, size in zip(dimensions, values.shape, strict=True):
            if dimension not in file.dimensions:
                file.dimensions[dimension] = size
        of_these = [c for c in where if {*dataset.variables[c][0]} <= {*dimensions}]
        if of_these and name not in {*where, *dimensions}:
            attributes = attributes | {"coordinates": " ".join(of_these)}
        stored = file.create_variable(name, dimensions, values.dtype, values, **packed)
        stored.attrs.update(attributes)
    file.attrs.update(dataset.attributes)


def read(variable: Any) -> Array:
    """The values of a variable in a file of `open_run`; characters as texts."""
    values = np.asarray(variable[...])
    if values.dtype.kind != "S":
        return values
    return np.char.decode(values.view(f"S{values.shape[-1]}")[..., 0], "utf-8")


def open_run(path: str | PathLike[str]) -> Any:
    """What was written of a run by `write_dataset`, an h5netcdf.File to be used by with.

    Raises
    ------
    InputError
        If there is no such file.
    MissingExtraError
        If h5netcdf or h5py is not installed.
    DamagedFileError
        If it is not as it was written, by its checksum.
    """
    package = netcdf_package()
    file_of_run = as_path("path", path)
    if not os.path.isfile(file_of_run):  # False for a name that is too long, too
        remedy = "; it is a folder, name the file in it" if os.path.isdir(file_of_run) else ""
        raise InputError(f"path: there is no file {path!s:.300}{remedy}")
    _check(file_of_run)
    return package.File(file_of_run, "r")


# ---- datasets -----------------------------------------------------------------------------------

STATISTICS = {
    "certificate": "largest error bound of the step's velocity programs",
    "relative": "certificate relative to the size of the program, what tol bounds",
    "iterations": "iterations of the solver",
    "attempts": "solvers and settings tried; 0 where the body is at rest",
    "seconds": "wall time of the step",
    "solver": "solver that answered the step",
}


def variable(dimensions: str, values: Any, words: str, unit: str) -> Variable:
    """One of a dataset; of several dimensions with blanks between them."""
    return tuple(dimensions.split()), values, {"long_name": words, "units": unit}


def dataset_of(solution: Solution) -> Dataset:
    """A solution as a dataset: u, velocity and the statistics of each step."""
    kept, stats, plan = "step" if solution.complete else "kept_step", solution.stats, solution.plan
    process = solution.process
    rows: dict[str, tuple[str, Any, str]] = {
        **{name: ("step", stats[name], words) for name, words in STATISTICS.items()},
        "solver": ("step", stats["solver"].astype(object), STATISTICS["solver"]),
        "viability": ("step", solution.viability(), "bound of the distance of its force to C"),
        "time": ("time", solution.t, "time"),
        "step": ("step", np.arange(len(stats)), "step, counted from 0"),
        "step_end": ("step", stats["t"], "time at the end of the step"),
        kept: (kept, solution.steps, "step, counted from 0"),
        "unknown": ("unknown", np.arange(process.dim), "unknown"),
        "u": ("time unknown", solution.u, "u_n at the kept grid times"),
        "velocity": (f"{kept} unknown", solution.velocity, "velocity u_n' in each kept step"),
    }
    if process.fields:
        names = field_names(process.fields, process.dim)
        rows["field"] = "unknown", names, "field of the unknown"
    return Dataset(
        {name: variable(*row, "s" if name == "seconds" else "1") for name, row in rows.items()},
        {
            "title": "A sweeping process",
            "software": ", ".join(map(" ".join, software(solution).items())),
            "status": solution.status.name.lower(),
            "message": solution.message,
            "scheme": plan.scheme.name,
            "solver": solver_name(solution),
            "tol": plan.tol,
            "unknowns_digest": process.unknowns_digest,
            "problem": json.dumps(fingerprint(process, solution.t)),
        },
        {"step_end", "field"} & set(rows),
    )


def to_xarray(solution: Solution) -> xr.Dataset:
    """`dataset_of` a solution for xarray.

    Raises
    ------
    MissingExtraError
        If xarray is not installed.
    """
    with brought_by("study"):
        import xarray
    run = dataset_of(solution)
    dataset = xarray.Dataset(run.variables, attrs=run.attributes)
    return dataset.set_coords(run.coordinates).copy(deep=True)  # can be changed, as u cannot


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
