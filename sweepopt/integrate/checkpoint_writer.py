"""The marks of a run: where it is written down, and where one that was killed goes on.

A checkpoint holds u with what rounding kept out of it, what was kept and recorded, the arguments of
`solve` and checksums of the problem. It does not hold what solvers remember of earlier steps: that
is forgotten at the marks, in every run with checkpoints, killed or not, so that both are equal to
the last bit.
"""

from __future__ import annotations

import time as clock
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from sweepopt.errors import CheckpointError, DamagedFileError, InputError, Status
from sweepopt.integrate.adaptive import Adaptive
from sweepopt.integrate.checkpoint import (
    SCHEMA,
    Checkpoint,
    Continued,
    Stored,
    about_computer,
    encoded,
    read_stored,
)
from sweepopt.integrate.fingerprint import fingerprint
from sweepopt.integrate.loop import Place, Run
from sweepopt.integrate.records import packed, unpacked
from sweepopt.integrate.states import Keeper
from sweepopt.io import remove_parts, write_npz
from sweepopt.problem import SweepingProcess
from sweepopt.velocity import Plan

MARKS = 100  # in a run, if nobody says how many
SECONDS = 10.0  # between two files, if nobody says how many


def checkpoints(
    wanted: Any,
    process: SweepingProcess,
    plan: Plan,
    times: np.ndarray,
    settings: Mapping[str, Any],
) -> Checkpoints | None:
    """Read the argument `checkpoint` of solve; `settings` are the others that make up the run.

    Raises
    ------
    InputError
        If the run cannot be continued from a file, or its file is that of another one.
    """
    if wanted is None:
        return None
    checkpoint = wanted if isinstance(wanted, Checkpoint) else Checkpoint(wanted)
    save = settings["save"]
    whole = "checkpoint= is for steps given beforehand; "
    if isinstance(settings["steps"], Adaptive):
        raise InputError(whole + "Adaptive steps come from passes over the whole run")
    if plan.scheme.exact:
        raise InputError(whole + "scheme 'exact' computes the whole trajectory at once")
    if isinstance(save, (str, PathLike)) and save != "last":
        raise InputError(
            "checkpoint= cannot continue a NetCDF file; keep the states in memory, save=k, or in "
            "a file that save=f(t, u, z) writes"
        )
    plain, arrays = encoded(settings)
    about = {
        "schema": SCHEMA,
        "versions": about_computer(),
        "problem": {},
        "plan": str(plan),
        "settings": plain,
        "checkpoint": checkpoint.arguments,
    }
    if isinstance(checkpoint, Continued) and checkpoint.stored is not None:
        about["problem"] = checkpoint.stored.record["problem"]
        if checkpoint.stored.record["plan"] != about["plan"]:
            raise InputError(
                f"{checkpoint.stored.file} is of a run that was planned differently:\n"
                f"{checkpoint.stored.record['plan']}\nbut now\n{plan}"
            )
    else:
        about["problem"] = fingerprint(process, times)
    return Checkpoints(checkpoint, about, arrays, len(times) - 1)


class Checkpoints:
    """The marks of a run: writes it down there, and begins where an earlier run was.

    Attributes
    ----------
    recorded : list
        What a function recorded so far; whoever records appends to it.
    """

    def __init__(
        self,
        checkpoint: Checkpoint,
        about: dict[str, Any],
        arrays: dict[str, np.ndarray],
        steps: int,
    ) -> None:
        self._checkpoint, self._about, self._arrays = checkpoint, about, arrays
        self._stored = checkpoint.stored if isinstance(checkpoint, Continued) else None
        self._steps, self._every = steps, checkpoint.steps or -(-steps // MARKS)
        usual = 0.0 if checkpoint.steps is not None else SECONDS
        self._seconds = usual if checkpoint.seconds is None else checkpoint.seconds
        self._written = clock.monotonic()
        self.recorded: list[Any] = []
        if self._stored is None:
            _require_free(checkpoint)

    @property
    def done(self) -> int:
        """How many steps an earlier run has done."""
        return 0 if self._stored is None else int(self._stored.record["run"]["done"])

    def begin(self, run: Run, keeper: Keeper, start: Place) -> Place:
        with self._on_disk():
            remove_parts(self._checkpoint.file)
            if self._stored is None:
                self._checkpoint.previous.unlink(missing_ok=True)  # that of another run
        if self._stored is None:
            self._write(run, keeper, start, None)
            return start
        try:
            place = self._restore(self._stored, run, keeper)
        except (KeyError, ValueError, TypeError, IndexError) as error:
            raise DamagedFileError(f"{self._stored.file} does not fit together: {error}") from error
        if self._stored.file == self._checkpoint.previous:
            # the whole one must not give way to the damaged one
            with self._on_disk():
                self._checkpoint.file.unlink(missing_ok=True)
        return place

    @contextmanager
    def _on_disk(self) -> Iterator[None]:
        """What a disk refuses is told of as the library's own error."""
        try:
            yield
        except OSError as error:
            raise CheckpointError(
                f"{self._checkpoint.file} cannot be replaced ({error.strerror or error})"
            ) from error

    def __call__(self, run: Run, keeper: Keeper, place: Place) -> bool:
        if run.done == 1:
            packed(self.recorded)  # says so now if it cannot
        last = run.done == self._steps
        if run.done % self._every and not last:
            return False
        if last or clock.monotonic() - self._written >= self._seconds:
            self._write(run, keeper, place, self._checkpoint.previous)
            self._written = clock.monotonic()
        return True

    def _write(self, run: Run, keeper: Keeper, place: Place, previous: Path | None) -> None:
        form, columns = packed(self.recorded)
        state = {
            "done": run.done,
            "steps": self._steps,
            "status": run.status.name,
            "overshot": run.overshot,
            "solvers": run.log.solvers,
            "recorded": form,
            "records": len(self.recorded),
        }
        arrays = {"u": place.u, "lost": place.lost, **self._arrays}
        arrays |= {f"log.{name}": column[: run.done] for name, column in run.log.columns.items()}
        arrays |= {f"kept.{name}": column for name, column in keeper.columns.items()}
        arrays |= {f"recorded.{k}": column for k, column in enumerate(columns)}
        file = self._checkpoint.file
        try:
            write_npz(file, {**self._about, "run": state}, arrays, previous)
        except OSError as error:
            older = file.exists() or self._checkpoint.previous.exists()
            raise CheckpointError(
                f"the checkpoint after step {run.done} cannot be written "
                f"({error.strerror or error}); "
                + (f"the one before is whole: resume {file}" if older else "there is none before")
            ) from error

    def _restore(self, stored: Stored, run: Run, keeper: Keeper) -> Place:
        state, arrays = stored.record["run"], stored.arrays
        run.done, run.status = int(state["done"]), Status[state["status"]]
        run.overshot = state["overshot"]
        run.log.restore(_group(arrays, "log"), state["solvers"])
        keeper.restore(run.done, _group(arrays, "kept"))
        columns = {int(k): column for k, column in _group(arrays, "recorded").items()}
        self.recorded[:] = unpacked(state["recorded"], columns, state["records"])
        return Place(arrays["u"].copy(), arrays["lost"].copy())


def _group(arrays: Mapping[str, np.ndarray], group: str) -> dict[str, np.ndarray]:
    """The arrays of one group, without its name."""
    start = group + "."
    return {name.removeprefix(start): a for name, a in arrays.items() if name.startswith(start)}


def _require_free(checkpoint: Checkpoint) -> None:
    """Refuse to overwrite a run that is not finished, or any other file."""
    file = checkpoint.file if checkpoint.file.exists() else checkpoint.previous
    try:
        state = read_stored(file).record["run"]
    except FileNotFoundError:
        return
    except DamagedFileError as error:
        raise InputError(
            f"checkpoint: {error}. It is not overwritten: so.resume looks for the one before it, "
            "or choose another name"
        ) from error
    if state["done"] < state["steps"]:
        raise InputError(
            f"checkpoint: {file} holds a run that has done {state['done']} of {state['steps']} "
            "steps; continue it with so.resume, or delete it"
        )
