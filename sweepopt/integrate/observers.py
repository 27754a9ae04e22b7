"""Who sees the steps of a run: the progress bar, a file, the user's functions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np

from sweepopt.errors import InputError, brought_by, shown
from sweepopt.integrate.loop import Observer
from sweepopt.integrate.reconstruction import Reconstruction


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
SaveFunction = Callable[[float, np.ndarray, np.ndarray], Any]


class Sink(Protocol):
    """A file that takes the states of a run one after the other."""

    def put(self, t: float, u: np.ndarray, velocity: np.ndarray) -> None:
        """Take the state at the end t of the next step and the velocity of the step."""
        ...


class ProgressBar:
    """A progress bar, or nothing where `visible` is false.

    Raises
    ------
    MissingExtraError
        If tqdm is not installed.
    """

    def __init__(self, visible: bool, steps: int | None, done: int = 0) -> None:
        self.visible = visible
        if visible:
            with brought_by("fem"):
                from tqdm.auto import tqdm
            self._bar = tqdm(total=steps, initial=done, unit="step")

    def update(self) -> None:
        if self.visible:
            self._bar.update()

    def close(self) -> None:
        if self.visible:
            self._bar.close()


class Observers:
    """All of them as one `observer` of the loop; they see all unknowns.

    Parameters
    ----------
    bar : ProgressBar
    sink : Sink or None
    function : callable or None
        What it returns for (t, u, z) of a step is appended to `recorded`.
    recorded : list
        What it returned in the steps before.
    callback : callable or None
        A true value that it returns stops the run.
    """

    def __init__(
        self,
        bar: ProgressBar,
        sink: Sink | None,
        function: SaveFunction | None,
        recorded: list[Any],
        callback: Callback | None,
    ) -> None:
        self._bar, self._sink, self._function, self._callback = bar, sink, function, callback
        self._recorded = recorded

    @property
    def need_states(self) -> bool:
        """Whether one of them looks at more than how many steps are done."""
        return any(one is not None for one in (self._callback, self._sink, self._function))

    def of_run(self, reconstruction: Reconstruction, times: np.ndarray) -> Observer | None:
        """What the loop calls after each step; None if nobody looks."""
        if not self.need_states:
            return (lambda *step: self._bar.update()) if self._bar.visible else None

        def observe(i: int, u: np.ndarray, z: np.ndarray, certificate: float) -> bool:
            self._bar.update()
            t = float(times[i + 1])
            u, z = reconstruction.state(i + 1, u).copy(), reconstruction.velocity(i, z).copy()
            if self._sink is not None:
                self._sink.put(t, u, z)
            if self._function is not None:
                self._recorded.append(self._function(t, u, z))
            return self._callback is not None and _stops(
                self._callback(StepInfo(i, t, u, z, certificate))
            )

        return observe


def _stops(answer: Any) -> bool:
    """Whether a callback's answer ends the run."""
    try:
        return bool(answer)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"callback must return True to stop the run, or nothing; got {shown(answer)}"
        ) from error
