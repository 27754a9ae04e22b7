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
    """u_n(t) = u_i + (t - t_i) / mu (u_{i+1} - u_i).

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
        start = times == self.t[0]
        if start.any() and self.begins[0] > self.t[0]:  # the start is kept without the first step
            first = self.states.u(0)
            values = np.zeros((*times.shape, first.size))
            values[start] = first
            values[~start] = self(times[~start]) if not start.all() else 0.0
            return values
        # many times in few steps: every node is looked up once
        i, where = np.unique(self.step_of(times), return_inverse=True)
        where = where.reshape(times.shape)
        begin, end = self.begins[i][where], self.t[i + 1][where]
        share = ((times - begin) / (end - begin))[..., None]
        after = self.states.u(i + 1)[where]
        if (self.begins[i] == self.t[i]).all():
            # the form with two weights meets both nodes exactly
            return (1 - share) * self.states.u(i)[where] + share * after
        back = (1 - share) * (end - begin)[..., None] * self.states.velocity(i)[where]
        return after - back

    def inside(self, t: Any) -> np.ndarray:
        """The times as floats; one that misses a kept node by rounding is that node."""
        times = checks.times("t", t)
        if len(self.t) < 2:
            raise InputError("the run has no complete step to interpolate")
        slack = checks.TIME_SLACK * max(abs(self.t[0]), abs(self.t[-1]))
        bad = ~((times >= self.t[0] - slack) & (times <= self.t[-1] + slack))
        if bad.any():
            raise InputError(
                f"t = {times[bad].flat[0]:g} is outside of [{self.t[0]:g}, {self.t[-1]:g}]"
            )
        nearest = self.t[np.clip(np.searchsorted(self.t, times - slack), 0, len(self.t) - 1)]
        return np.where(np.abs(nearest - times) <= slack, nearest, times)

    def step_of(self, times: np.ndarray) -> np.ndarray:
        """i with t in (t_i, t_{i+1}]; the whole of the time must be in the step that ends there."""
        i = np.maximum(np.searchsorted(self.t, times, side="left") - 1, 0)
        lost = times < self.begins[i]
        if lost.any():
            raise InputError(
                f"t = {times[lost].flat[0]:g} is in a step that was not kept; solve with another "
                "save="
            )
        return i
