"""What is written of a run that can be continued, and where: arguments of `solve` and their file.

A checkpoint is a plain .npz file; `checkpoint_writer` writes it.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sweepopt.checks import count, number
from sweepopt.errors import DamagedFileError, InputError, shown
from sweepopt.io import read_npz, versions_of, writable
from sweepopt.velocity import REGISTRY

SCHEMA = 1
PARTS = {"schema", "versions", "problem", "plan", "settings", "checkpoint", "run"}
PACKAGES = ("numpy", "scipy", "cvxpy", "osqp", "clarabel", "cvxopt", "daqp", "pyamg")
SOLVERS: dict[str, Any] = {getattr(kind, "__name__", name): kind for name, kind in REGISTRY.items()}


@dataclass(frozen=True)
class Checkpoint:
    """Where and how often a run is written down, so that `resume` can continue it.

    Parameters
    ----------
    path : str or Path
        The file, replaced as a whole; the one before it stays beside it as ``path + ".previous"``.
    steps : int, optional
        Write after every so many steps; a hundredth of the run by default.
    seconds : float, optional
        But not before so many seconds have passed; 0 if steps are given, and else 10.

    Raises
    ------
    InputError
        If steps or seconds is not positive, or the file cannot be written there.

    Notes
    -----
    A run that is continued is equal to the last bit, so solvers forget earlier steps after every
    `steps` steps, whether a file is written there or not: a run with checkpoints differs from one
    without by rounding, and two runs with the same `steps` do not differ. Factorisations stay.
    Forgetting costs 0.2 ms where Newton solves for the contact, 8 to 10 ms with OSQP or Clarabel;
    where all unknowns are in the program 12 ms with OSQP and 18 ms with Clarabel for 1,056 of them,
    18 and 38 ms for 4,160 (measured on one core). A file takes the time of a disk to write the kept
    states, all of them each time: keep few (``save=``) in a long run.

    Examples
    --------
    >>> Checkpoint("run.npz", steps=500).steps
    500
    """

    path: str | PathLike[str]
    steps: int | None = None
    seconds: float | None = None

    def __post_init__(self) -> None:
        if self.steps is not None:
            count("steps", self.steps)
        if self.seconds is not None:
            number("seconds", self.seconds, minimum=0.0)
        writable("checkpoint", self.path)

    @property
    def file(self) -> Path:
        """The file, wherever the run goes."""
        return Path(self.path).resolve()

    @property
    def previous(self) -> Path:
        """The file that was there before the last one."""
        return self.file.with_name(self.file.name + ".previous")

    @property
    def arguments(self) -> dict[str, Any]:
        """How often, in terms of JSON."""
        return {
            "steps": None if self.steps is None else int(self.steps),
            "seconds": None if self.seconds is None else float(self.seconds),
        }


class Stored(NamedTuple):
    """What a file holds; `file` is where it was found."""

    file: Path
    record: dict[str, Any]
    arrays: dict[str, np.ndarray]


@dataclass(frozen=True)
class Continued(Checkpoint):
    """A checkpoint that a run begins with."""

    stored: Stored | None = None


def read_stored(file: Path) -> Stored:
    """A checkpoint from a file.

    Raises
    ------
    FileNotFoundError
    DamagedFileError
    InputError
        If it cannot be read; if another version of the library has written it in another form.
    """
    try:
        record, arrays = read_npz(file)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise InputError(f"{file} cannot be read ({error.strerror or error})") from error
    if not set(record) >= PARTS:
        raise DamagedFileError(f"{file} is no checkpoint")
    if record.get("schema") != SCHEMA:
        raise InputError(
            f"{file} is a checkpoint of form {record.get('schema')!r}; this version of sweepopt "
            f"reads form {SCHEMA}, continue with sweepopt {shown(record.get('versions'))}"
        )
    return Stored(file, record, arrays)


def about_computer() -> dict[str, str]:
    """What may change the last bits of a result."""
    here = {"python": platform.python_version(), "machine": platform.machine()}
    return {**here, **versions_of(PACKAGES)}


def encoded(settings: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Arguments of solve in terms of JSON, and those that are arrays.

    Raises
    ------
    InputError
        If an argument cannot be written to a file.
    """
    plain: dict[str, Any] = {}
    arrays: dict[str, np.ndarray] = {}
    for name, value in settings.items():
        value = value.item() if isinstance(value, np.generic) else value
        if value is None or isinstance(value, (str, bool, int, float)):
            plain[name] = value
        elif name == "save" and callable(value):
            plain[name] = {"function": True}
        elif name == "solver" and SOLVERS.get(type(value).__name__) is type(value):
            plain[name] = {"solver": type(value).__name__, **_plain(asdict(value))}
        elif name in ("steps", "save"):
            plain[name], arrays[f"settings.{name}"] = {"array": True}, np.asarray(value, float)
        else:
            raise InputError(f"{name}: with checkpoint= it must be one of the library's own")
    return plain, arrays


def _plain(fields: dict[str, Any]) -> dict[str, Any]:
    try:
        json.dumps(fields, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"solver: with checkpoint= its settings must be plain: {error}") from error
    return fields


def decoded(stored: Stored) -> dict[str, Any]:
    """The arguments of solve from a checkpoint; a function as None."""
    settings = dict(stored.record["settings"])
    for name, value in settings.items():
        if isinstance(value, dict) and value.get("array"):
            settings[name] = stored.arrays[f"settings.{name}"]
        elif isinstance(value, dict) and "solver" in value:
            fields = {key: entry for key, entry in value.items() if key != "solver"}
            settings[name] = SOLVERS[value["solver"]](**fields)
        elif isinstance(value, dict):
            settings[name] = None
    return settings
