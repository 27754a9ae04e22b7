"""Who sees the steps of a run: the progress bar, the file, the record, the user's callback."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from sweepopt.errors import InputError, brought_by, shown
from sweepopt.integrate.loop import Look
from sweepopt.integrate.netcdf_writer import BlockWriter, Stored
from sweepopt.integrate.reconstruction import Lift
from sweepopt.integrate.states import Kept, Saving, States


class StepInfo(NamedTuple):
    """What a callback sees after a step: its index, end time, state, velocity, certificate.

    The certificate is that of `Solution.stats`: the worst of the programs that the step solved.
    """

    step: int
    t: float
    u: np.ndarray
    velocity: np.ndarray
    certificate: float


Callback = Callable[[StepInfo], "bool | None"]


class Bar:
    """A progress bar, or nothing where none is wanted.

    Raises
    ------
    MissingExtraError
        If tqdm is not installed.
    """

    def __init__(self, shown: bool, steps: int | None, done: int = 0) -> None:
        self.shown = shown
        if shown:
            with brought_by("fem"):
                from tqdm.auto import tqdm
            self._bar = tqdm(total=steps, initial=done, unit="step")

    def update(self) -> None:
        if self.shown:
            self._bar.update()

    def close(self) -> None:
        if self.shown:
            self._bar.close()


class Observers:
    """All of them behind one `look`; they see all unknowns.

    Attributes
    ----------
    recorded : list
        What the function given as `save` returned.
    """

    def __init__(
        self,
        wanted: Saving,
        lift: Lift,
        times: np.ndarray,
        u0: np.ndarray,
        bar: Bar,
        callback: Callback | None,
        recorded: list[Any],
    ) -> None:
        self.recorded = recorded
        self._function, self._callback, self._bar = wanted.function, callback, bar
        self._lift, self._times = lift, times
        self._blocks = BlockWriter(wanted.path, float(times[0]), u0) if wanted.path else None

    @property
    def need_states(self) -> bool:
        """Whether somebody looks at more than how many steps are done."""
        return any(one is not None for one in (self._callback, self._blocks, self._function))

    @property
    def look(self) -> Look | None:
        """What the loop calls after a step; None if nobody looks."""
        return self._look if self.need_states or self._bar.shown else None

    def _look(self, i: int, u: np.ndarray, z: np.ndarray, certificate: float) -> bool | None:
        self._bar.update()
        if not self.need_states:
            return None
        lift, t = self._lift, float(self._times[i + 1])
        u, z = lift.state(i + 1, u).copy(), lift.velocity(i, z).copy()
        if self._blocks is not None:
            self._blocks.put(t, u, z)
        if self._function is not None:
            self.recorded.append(self._function(t, u, z))
        if self._callback is None:
            return None
        stop = self._callback(StepInfo(i, t, u, z, certificate))
        try:
            return bool(stop)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"callback must return True to stop the run, or nothing; got {shown(stop)}"
            ) from error

    def close(self, finished: bool) -> None:
        """The run is over, well or not."""
        self._bar.close()
        if self._blocks is not None:
            self._blocks.close(finished)

    def kept(self, kept: Kept, steps: np.ndarray) -> tuple[States, np.ndarray]:
        """The states of all unknowns where they are, and their steps."""
        if self._blocks is None:
            return self._lift.of(kept, steps), steps
        return Stored(self._blocks.path, self._blocks.run), np.arange(self._blocks.steps)
