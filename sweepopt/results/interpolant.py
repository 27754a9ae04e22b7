"""The piecewise-linear interpolant u_n, from the steps of a run that were kept."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sweepopt import checks
from sweepopt.errors import InputError
from sweepopt.integrate import States


@dataclass(frozen=True, eq=False)
class Interpolant:
    """u_n(t) = u_{i+1} - (t_{i+1} - t) u_n', u_n' the velocity of step i.

    Attributes
    ----------
    t : ndarray, shape (k+1,)
        The start, and the ends of the kept steps.
    begins : ndarray, shape (k,)
        Where these steps begin, at t[:-1] if no other is between them.
    states : States
    """

    t: np.ndarray
    begins: np.ndarray
    states: States

    def __call__(self, t: Any) -> np.ndarray:
        times = self.inside(t)
        later = times > self.t[0]  # the start is kept, its step may not be
        values = np.tile(self.states.u(0), (*times.shape, 1))
        i = self.step_of(times[later])
        before = (self.t[i + 1] - times[later])[:, None]
        values[later] = self.states.u(i + 1) - before * self.states.velocity(i)
        return values

    def inside(self, t: Any) -> np.ndarray:
        """The times as floats; one that misses a kept node by rounding is that node."""
        times = checks.times("t", t)
        if len(self.t) < 2:
            raise InputError("the run has no complete step to interpolate")
        slack = checks.TIME_SLACK * max(abs(self.t[0]), abs(self.t[-1]))
        outside = ~((times >= self.t[0] - slack) & (times <= self.t[-1] + slack))
        if outside.any():
            raise InputError(
                f"t = {times[outside].flat[0]:g} is outside of [{self.t[0]:g}, {self.t[-1]:g}]"
            )
        nearest = self.t[np.clip(np.searchsorted(self.t, times - slack), 0, len(self.t) - 1)]
        return np.where(np.abs(nearest - times) <= slack, nearest, times)

    def step_of(self, times: np.ndarray) -> np.ndarray:
        """i with t in (t_i, t_{i+1}]; the whole of the time must be in the step that ends there."""
        i = np.maximum(np.searchsorted(self.t, times, side="left") - 1, 0)
        between = times < self.begins[i]
        if between.any():
            raise InputError(
                f"t = {times[between].flat[0]:g} is in a step that was not kept; solve with "
                "another save="
            )
        return i
