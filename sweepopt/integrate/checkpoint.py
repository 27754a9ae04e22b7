"""A run is written down again and again, so that one that was killed goes on from there.

A checkpoint is an .npz file with the arrays of the run, what a function recorded, the arguments of
`solve` and checksums of the problem. It does not hold what solvers remember of earlier steps: that
is forgotten every so many steps, in every run with checkpoints, killed or not, so that both are
equal to the last bit.
"""

from __future__ import annotations

import hashlib
import platform
import time as clock
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Array, count, number
from sweepopt.display import evenly
from sweepopt.errors import (
    CheckpointError,
    CheckpointWarning,
    DamagedFileError,
    InputError,
    shown,
    warn,
)
from sweepopt.io import (
    decoded,
    encoded,
    locked,
    read_npz,
    remove_parts,
    versions_of,
    writable,
    write_npz,
)
from sweepopt.loads import History
from sweepopt.problem import ONE, SweepingProcess, motion
from sweepopt.sets import ConvexSet

if TYPE_CHECKING:
    from sweepopt.integrate.options import SolveOptions
    from sweepopt.integrate.record import Run

SCHEMA = 7  # of the file: one more for each change of what it holds


@dataclass(frozen=True)
class Checkpoint:
    """Where and how often a run is written down, so that `resume` can continue it.

    Parameters
    ----------
    path : str or Path
        The file, replaced as a whole; until the run is done the one before it stays beside it as
        ``path + ".previous"``.
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
            object.__setattr__(self, "steps", count("steps", self.steps))
        pause = self.seconds if self.seconds is not None else 0.0 if self.steps else 10.0
        object.__setattr__(self, "seconds", number("seconds", pause, minimum=0.0))
        writable("path", self.path)

    @property
    def file(self) -> Path:
        """The file, wherever the run goes."""
        return Path(self.path).resolve()

    @property
    def previous(self) -> Path:
        """The file that was there before the last one."""
        return self.file.with_name(self.file.name + ".previous")


# ---- reading ------------------------------------------------------------------------------------


class StoredRun(NamedTuple):
    """What a checkpoint holds; `file` is where it is."""

    file: Path
    record: dict[str, Any]
    arrays: dict[str, Array]

    @property
    def done(self) -> int:
        """How many steps were done."""
        return self.record["run"]["done"]


def newest(checkpoint: Checkpoint) -> StoredRun:
    """The run in the file, or in the one before it if the file is damaged.

    Raises
    ------
    InputError
        If there is none, or it cannot be read.
    CheckpointError
        If both are damaged.

    Warns
    -----
    CheckpointWarning
        If it is from the file before.
    """
    damage: DamagedFileError | None = None
    for file in (checkpoint.file, checkpoint.previous):
        try:
            stored = _read(file)
        except FileNotFoundError:  # killed just before the new file took its name
            continue
        except DamagedFileError as error:
            damage = damage or error
            continue
        if damage:
            goes_on = "The run goes on from the checkpoint before it, after step"
            warn(f"{damage}. {goes_on} {stored.done}", CheckpointWarning)
        return stored
    raise damage or InputError(f"there is no checkpoint {checkpoint.file}")


def _read(file: Path) -> StoredRun:
    try:
        record, arrays = read_npz(file)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise InputError(f"{file} cannot be read ({error.strerror or error})") from error
    if "schema" not in record:
        raise DamagedFileError(f"{file} is no checkpoint")
    if record["schema"] != SCHEMA:
        raise InputError(
            f"{file} is a checkpoint of form {record['schema']!r}; this version of sweepopt "
            f"reads form {SCHEMA}, continue with sweepopt {shown(record.get('versions'))}"
        )
    return StoredRun(file, record, arrays)


def require_same_problem(stored: StoredRun, process: SweepingProcess, times: Array) -> None:
    """Refuse a checkpoint of another problem, and warn of other versions."""
    if differ := differences(stored.record["problem"], process, times):
        raise InputError(
            f"{stored.file} is a checkpoint of another problem: {', '.join(differ)} "
            f"{'differ' if len(differ) > 1 else 'differs'} from what the run began with"
        )
    before, here = stored.record["versions"], _versions()
    changes = [
        f"{name} {before.get(name)} -> {here.get(name)}"
        for name in sorted({*before, *here})
        if before.get(name) != here.get(name)
    ]
    if changes:
        message = "the run began with other versions, last bits may differ"
        warn(f"{message}: {', '.join(changes)}", CheckpointWarning)


def _versions() -> dict[str, str]:
    return {"machine": platform.machine(), **versions_of()}


# ---- writing ------------------------------------------------------------------------------------


@contextmanager
def checkpoint_writer(
    asked: Any,
    process: SweepingProcess,
    run: Run,
    options: SolveOptions,
    stored: StoredRun | None,
) -> Iterator[CheckpointWriter | None]:
    """Read the argument `checkpoint` of solve; `stored` is the run that is continued.

    Raises
    ------
    InputError
        If the run cannot be continued from a file, or its file is that of another one, or another
        run is writing it.
    """
    if asked is None:
        yield None
        return
    if not isinstance(asked, Checkpoint):
        asked = Checkpoint(writable("checkpoint", asked))
    checkpoint: Checkpoint = asked
    if run.plan.scheme.exact:
        raise InputError("checkpoint= is for steps; scheme 'exact' computes the run at once")
    if run.saving.path:
        raise InputError(
            "checkpoint= cannot continue a NetCDF file; keep the states in memory, save=k, or in "
            "a file that save=f(t, u, z) writes"
        )
    if stored and stored.record["plan"] != str(run.plan):
        raise InputError(
            f"{stored.file} is of a run that was planned differently:\n{stored.record['plan']}\n"
            f"but now\n{run.plan}"
        )
    about = {
        "schema": SCHEMA,
        "versions": _versions(),
        "problem": stored.record["problem"] if stored else fingerprint(process, run.times),
        "plan": str(run.plan),
        "options": options.to_json(),
        "checkpoint": {"steps": checkpoint.steps, "seconds": checkpoint.seconds},
    }
    with locked(checkpoint.file):
        if stored is None:
            _require_free(checkpoint)
        yield CheckpointWriter(checkpoint, about, stored)


@dataclass
class CheckpointWriter:
    """Writes a run down after some of its steps, and restores one that was written down.

    Attributes
    ----------
    checkpoint : Checkpoint
    about : dict
        What is known of the run beforehand, in terms of JSON.
    stored : StoredRun or None
        The run that is continued.
    written : float
        When the last file was, by a clock.
    """

    checkpoint: Checkpoint
    about: dict[str, Any]
    stored: StoredRun | None
    written: float = field(default_factory=clock.monotonic)

    def begin(self, run: Run) -> None:
        """Write down the start of a run, or take it to where the stored one is."""
        stored = self.stored
        if stored:
            try:
                run.restore(stored.record["run"], stored.arrays)
                run.recorded[:] = decoded(stored.record["recorded"])
            except (KeyError, ValueError, TypeError, IndexError) as error:
                raise DamagedFileError(f"{stored.file} does not fit together: {error}") from error
        # in the place of a damaged one too, which must not take that of the whole one before it
        self._write(run, None)

    def __call__(self, run: Run) -> bool:
        """Write the run down if it is time; whether a run can be continued from this step."""
        if run.done == 1:
            _records(run)  # says so now if they cannot be stored
        last = run.done == run.steps
        if run.done % (self.checkpoint.steps or -(-run.steps // 100)) and not last:
            return False
        if last or clock.monotonic() - self.written >= (self.checkpoint.seconds or 0.0):
            self._write(run, self.checkpoint.previous)
            self.written = clock.monotonic()
        if last:
            self.checkpoint.previous.unlink(missing_ok=True)
        return True

    def _write(self, run: Run, previous: Path | None) -> None:
        state, arrays = run.store()
        file, record = self.checkpoint.file, {**self.about, "run": state}
        try:
            if previous is None:
                remove_parts(file)
                if not self.stored:
                    self.checkpoint.previous.unlink(missing_ok=True)  # that of another run
            write_npz(file, {**record, "recorded": _records(run)}, arrays, previous)
        except OSError as error:
            older = file.exists() or self.checkpoint.previous.exists()
            before = f"the one before is whole: resume {file}" if older else "there is none before"
            raise CheckpointError(
                f"the checkpoint {file} cannot be replaced after step {run.done} "
                f"({error.strerror or error}); {before}"
            ) from error


def _records(run: Run) -> Any:
    try:
        return encoded(run.recorded)
    except TypeError as error:
        raise InputError(
            "save: with a checkpoint= a function returns numbers or arrays, text, or tuples, "
            f"lists and dicts of them; it returned {shown(run.recorded[-1])}"
        ) from error


def _require_free(checkpoint: Checkpoint) -> None:
    """Refuse to overwrite a run that is not finished, or any other file."""
    try:
        stored = _read(checkpoint.file if checkpoint.file.exists() else checkpoint.previous)
    except FileNotFoundError:
        return
    except DamagedFileError as error:
        raise InputError(
            f"checkpoint: {error}. It is not overwritten: so.resume looks for the one before it, "
            "or choose another name"
        ) from error
    steps = stored.record["run"]["steps"]
    if stored.done < steps:
        raise InputError(
            f"checkpoint: {stored.file} holds a run that has done {stored.done} of {steps} "
            "steps; continue it with so.resume, or delete it"
        )


# ---- what defines a problem ---------------------------------------------------------------------


def fingerprint(process: SweepingProcess, times: Array) -> dict[str, str]:
    """sha256 of A, B, u0 and C(t), part by part, so that one can say which part differs.

    Of C(t) the data; a function of time is compared by its values at up to 256 of the times.
    """
    some = times[evenly(len(times), 256)].tolist()
    moving = motion(process.C)
    scales, sets = zip(*moving.summands or [(ONE, None)], strict=True)
    loads = [load for load in (moving.center, *scales, moving.offsets) if load is not None]
    data = [*sets, getattr(process.C, "lipschitz", None), *(load.terms for load in loads)]
    values = (phi(t) for phi in moving.histories for t in some)
    C = chain(data, moving.histories, values)
    parts = {"A": [process.A], "B": [process.B], "u0": [process.u0], "C(t)": C}
    return {name: _sha256(part) for name, part in parts.items()}


def _sha256(values: Iterable[Any]) -> str:
    digest = hashlib.sha256()
    for piece in chain.from_iterable(map(_bytes, values)):
        digest.update(piece)
        digest.update(b" ")
    return digest.hexdigest()


def differences(began: Mapping[str, str], process: SweepingProcess, times: Array) -> list[str]:
    """The parts of a process that are not those of the fingerprint of another at these times."""
    now = fingerprint(process, times)
    return [name for name in now if began.get(name) != now[name]]


def _bytes(value: Any) -> Iterator[bytes]:
    """Those of a nest of sets, loads, arrays and numbers; of another object its type alone."""
    if sp.issparse(value):
        value = sp.csc_array(value)
    yield type(value).__name__.encode()
    if isinstance(value, (ConvexSet, History)):
        value = _attributes(value)
    elif sp.issparse(value):
        places = (index.astype(np.int64) for index in (value.indices, value.indptr))
        value = [value.shape, value.data, *places]
    if isinstance(value, (list, tuple)):
        yield str(len(value)).encode()
        for part in value:
            yield from _bytes(part)
    elif isinstance(value, (np.ndarray, np.generic)):
        yield f"{value.dtype.str} {value.shape}".encode()
        yield value.tobytes()
    elif value is None or isinstance(value, (str, int, float)):
        yield repr(value).encode()


def _attributes(value: Any) -> list[Any]:
    """What a set or a load is made of: its public attributes, none that are computed later."""
    kinds = [vars(kind) for kind in type(value).__mro__]
    later = {name for kind in kinds for name in kind if isinstance(kind[name], cached_property)}
    names = sorted(name for name in vars(value).keys() - later if name[0] != "_")
    entries = [*names, *(getattr(value, name) for name in names)]
    if isinstance(value, ConvexSet) and any(map(callable, entries)):
        # what a function in it does is seen in what it gives
        direction = np.cos(np.arange(value.dim) + 1.0)
        entries += [f"{value.support(z):.6e}" for z in (direction, -direction)]
    return entries
