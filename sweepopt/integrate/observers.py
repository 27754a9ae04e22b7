"""Who sees the steps of a run: the progress bar, a file, the user's functions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from sweepopt.display import by_parts
from sweepopt.errors import InputError, brought_by, shown
from sweepopt.integrate.loop import Observer
from sweepopt.velocity import Plan


class StepInfo(NamedTuple):
    """What a callback sees after a step: its index, end time, state, velocity, certificate.

    The certificate is that of `Solution.stats`: the worst of the programs that the step solved.
    """

    step: int
    t: float
    u: np.ndarray
    velocity: np.ndarray
    certificate: float

    def __repr__(self) -> str:
        return by_parts(self)


Callback = Callable[[StepInfo], "bool | None"]
SaveFunction = Callable[[float, np.ndarray, np.ndarray], Any]


class ProgressBar:
    """A progress bar, or nothing where `visible` is false.

    Raises
    ------
    MissingExtraError
        If tqdm is not installed.
    """

    def __init__(self, visible: bool, steps: int | None, done: int = 0) -> None:
        self._bar: Any = None
        if visible:
            with brought_by("fem"):
                from tqdm.auto import tqdm
            self._bar = tqdm(total=steps, initial=done, unit="step")

    def update(self) -> None:
        if self._bar is not None:
            self._bar.update()

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()


def observer(
    bar: ProgressBar,
    watchers: Sequence[Callable[[StepInfo], Any]],
    plan: Plan,
    times: np.ndarray,
) -> Observer:
    """What the loop calls after each step: the bar, then the watchers, who see all unknowns.

    A watcher that answers with a true value stops the run.
    """

    def observe(i: int, u: np.ndarray, z: np.ndarray, certificate: float) -> bool:
        bar.update()
        if not watchers:
            return False
        u, z = plan.state(u).copy(), plan.velocity(z).copy()
        step = StepInfo(i, float(times[i + 1]), u, z, certificate)
        for watcher in watchers:
            answer = watcher(step)
            try:
                if answer:
                    return True
            except (TypeError, ValueError) as error:
                raise InputError(
                    "callback must return True to stop the run, or nothing; got " + shown(answer)
                ) from error
        return False

    return observe
