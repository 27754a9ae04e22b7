"""resume(): a run that was killed goes on from its last checkpoint."""

from __future__ import annotations

from collections.abc import Callable
from os import PathLike
from typing import Any

import numpy as np

from sweepopt.errors import CheckpointWarning, DamagedFileError, InputError, warn
from sweepopt.integrate import (
    Checkpoint,
    Continued,
    StepInfo,
    Stored,
    about_computer,
    decoded,
    fingerprint,
    read_stored,
    time_grid,
)
from sweepopt.problem import EvolutionVI, SweepingProcess, sweeping
from sweepopt.results import Solution
from sweepopt.solve import solve


def resume(
    path: str | PathLike[str],
    process: SweepingProcess | EvolutionVI,
    *,
    save: Callable[[float, np.ndarray, np.ndarray], Any] | None = None,
    callback: Callable[[StepInfo], bool | None] | None = None,
    progress: bool = False,
) -> Solution:
    """Continue a run from the file that ``solve(..., checkpoint=path)`` wrote.

    The result is that of the run if it had not been stopped, bit for bit, but for the seconds in
    `Solution.stats`. It goes on writing checkpoints. A run that had reached its end is given back.

    Parameters
    ----------
    path : str or Path
    process : SweepingProcess or EvolutionVI
        The same problem as before; it is compared by checksums.
    save : callable, optional
        The function that was given as `save`, if there was one; what it recorded comes back.
        All other arguments of `solve` are in the file.
    callback, progress
        As in `solve`.

    Returns
    -------
    Solution

    Raises
    ------
    InputError
        If there is no checkpoint, or it is one of another problem; the message says what differs.
    CheckpointError
        If both the file and the one before it are damaged.

    Warns
    -----
    CheckpointWarning
        If the file is damaged and the run goes on from the one before it; if versions of packages
        have changed, so that last bits may differ.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> import sweepopt as so
    >>> C = so.Moving(so.Box([-1], [1]), center=lambda t: [1.5 * t])
    >>> process = so.SweepingProcess(A=[[0.5]], B=[[2.0]], C=C, u0=[0.0])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder) / "run.npz"
    ...     stop = lambda step: step.step == 120
    ...     where = so.Checkpoint(file, steps=50)
    ...     sol = so.solve(process, t_end=5.0, steps=200, checkpoint=where, callback=stop)
    ...     whole = so.resume(file, process)
    >>> len(sol.t), len(whole.t)
    (122, 201)
    """
    stored = _newest(Checkpoint(path))
    process, settings = sweeping(process), decoded(stored)
    times, _ = time_grid(settings["t_end"], settings["steps"])
    _compare(stored, process, times)
    wanted = stored.record["settings"]["save"]
    if (wanted == {"function": True}) != callable(save):
        need = "needs" if save is None else "had no"
        raise InputError(f"save: the run in {stored.file} {need} function of (t, u, z) as save")
    settings["save"] = settings["save"] if save is None else save
    return solve(
        process,
        **settings,
        checkpoint=Continued(path, **stored.record["checkpoint"], stored=stored),
        callback=callback,
        progress=progress,
    )


def _newest(checkpoint: Checkpoint) -> Stored:
    """The checkpoint, or the one before it."""
    try:
        return read_stored(checkpoint.file)
    except FileNotFoundError:
        try:  # killed just before the new file took its name
            return read_stored(checkpoint.previous)
        except FileNotFoundError:
            raise InputError(f"there is no checkpoint {checkpoint.file}") from None
    except DamagedFileError as damage:
        try:
            stored = read_stored(checkpoint.previous)
        except FileNotFoundError:
            raise damage from None
        warn(
            f"{damage}. The run goes on from the checkpoint before it, after step "
            f"{stored.record['run']['done']}",
            CheckpointWarning,
        )
        return stored


def _compare(stored: Stored, process: SweepingProcess, times: np.ndarray) -> None:
    """Refuse another problem, and tell of other versions."""
    was, now = stored.record["problem"], fingerprint(process, times)
    differ = [name for name in now if was.get(name) != now[name]]
    if differ:
        raise InputError(
            f"{stored.file} is a checkpoint of another problem: {', '.join(differ)} "
            f"{'differ' if len(differ) > 1 else 'differs'} from what the run began with"
        )
    began, here = stored.record["versions"], about_computer()
    changed = [
        f"{name} {began.get(name)} -> {here.get(name)}"
        for name in sorted({*began, *here})
        if began.get(name) != here.get(name)
    ]
    if changed:
        warn(
            f"the run began with other versions, last bits may differ: {', '.join(changed)}",
            CheckpointWarning,
        )
