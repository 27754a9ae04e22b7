"""What a grid of steps misses, from the velocities of a pass over this or another grid.

The differences of the velocities are the derivatives of u, from which `Flow` knows what each step
misses; kinks are looked for first, and count by their place. Carried along from step to step with
its sign, what cancels or is forgotten does not count.

Where a kink could not be told from its neighbours the leading order holds in the mean over its
place only. By how much it misses is estimated from the differences of neighbours and summed as a
variance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sweepopt.integrate.error_propagation import Flow
from sweepopt.integrate.switching_times import Kinks, joined

STIFF = 1e6  # h times a rate that is as good as infinite
SPREAD = 0.9  # standard deviations that are added to the error carried along


class Missed(NamedTuple):
    """What each of k steps does to the error.

    Attributes
    ----------
    own : ndarray, shape (k, dim)
        What it misses itself.
    kept : ndarray, shape (k, dim)
        What it leaves of the error before it.
    left : ndarray, shape (k,)
        What is left at its end of what a kink did within it.
    rest, scatter : ndarray, shape (k,)
        The same for the standard deviation, and its own one.
    """

    own: np.ndarray
    kept: np.ndarray
    left: np.ndarray
    rest: np.ndarray
    scatter: np.ndarray


class Carried(NamedTuple):
    """The error after each step, and its standard deviation."""

    errors: np.ndarray
    deviations: np.ndarray

    def sizes(self, flow: Flow) -> np.ndarray:
        """What may be expected of the error at most, nearly always."""
        return flow.norms(self.errors) + SPREAD * self.deviations


@dataclass(frozen=True, eq=False)
class Course:
    """How the velocity goes, as far as n steps of a pass tell.

    Attributes
    ----------
    times : ndarray, shape (n+1,)
    rates : ndarray, shape (n,)
        How fast errors along the velocity decay.
    lower, high : ndarray, shape (n, dim)
        The (r-1)-th and the r-th derivative of the velocity, kinks left out.
    bends : ndarray, shape (n, dim)
        What kinks that were not found may have added to `high`.
    moves, stops : ndarray of bool, shape (n, dim)
        Which unknowns do, and which of them rest or have turned in the next step.
    kinks : Kinks
    """

    times: np.ndarray
    rates: np.ndarray
    lower: np.ndarray
    high: np.ndarray
    bends: np.ndarray
    moves: np.ndarray
    stops: np.ndarray
    kinks: Kinks

    def own(self, flow: Flow, before: float) -> Missed:
        """What these steps miss; `before` is the length of the one before them."""
        missed = self._missed(flow, self.times, np.arange(len(self.rates)), before)
        kinks = self.kinks
        known = kinks.missed
        if flow.continuous:
            known = self._beyond(flow, self.times, kinks.step, missed)
        np.add.at(missed.own, (kinks.step, kinks.unknown), known)
        return missed

    def on(self, flow: Flow, times: np.ndarray) -> Carried:
        """The error that another grid over the same time would have."""
        middle = 0.5 * (times[1:] + times[:-1])
        last = len(self.rates) - 1
        source = np.clip(np.searchsorted(self.times, middle) - 1, 0, last)
        missed = self._missed(flow, times, source, times[1] - times[0])
        step = np.clip(np.searchsorted(times, self.kinks.t, side="right") - 1, 0, len(middle) - 1)
        beyond = self._beyond(flow, times, step, missed)
        np.add.at(missed.own, (step, self.kinks.unknown), beyond)
        if not flow.continuous:
            # what stops within a step rests in the next one
            rests = np.minimum(step + 1, len(middle) - 1)
            missed.kept[rests, self.kinks.unknown] = 1.0
        return carry(missed, np.zeros(self.high.shape[1]), 0.0)

    def _beyond(
        self, flow: Flow, times: np.ndarray, step: np.ndarray, missed: Missed
    ) -> np.ndarray:
        """What the kinks do in these steps."""
        h = times[step + 1] - times[step]
        share = (self.kinks.t - times[step]) / h
        beyond: np.ndarray = missed.left[step] * h**2 * self.kinks.jump * flow.beyond(share)
        return beyond

    def _missed(self, flow: Flow, times: np.ndarray, source: np.ndarray, before: float) -> Missed:
        """But for the kinks; `source` is the step whose velocity each of the steps has."""
        h = np.diff(times)
        x = np.minimum(h * self.rates[source], STIFF)
        rest, left = flow.decay(x)
        high, stops, moves = self.high[source], self.stops[source], self.moves[source]
        if flow.continuous:
            own = flow.missed(h, x, left, self.lower[source], high)
        else:
            own = flow.missed_without_A(h, stops, high)
        # a step has them once
        bends = self.bends[source] * np.append(True, np.diff(source) > 0)[:, None]
        shorter = np.minimum(h, np.append(before, h[:-1])) ** (flow.order + 1)
        scatter = shorter * flow.norms(flow.scatter(stops) * bends)
        still = np.where(moves.any(axis=1), rest, 1.0)
        left = left if flow.continuous else np.ones_like(h)
        return Missed(own, np.where(moves, rest[:, None], 1.0), left, still, scatter)


def carry(missed: Missed, error: np.ndarray, deviation: float) -> Carried:
    """The error after each step, from the one before them all on."""
    errors, deviations = np.empty_like(missed.own), np.empty(len(missed.own))
    for k, (own, kept) in enumerate(zip(missed.own, missed.kept, strict=True)):
        error = errors[k] = kept * error + own
    for k, (rest, own) in enumerate(
        zip(missed.rest.tolist(), missed.scatter.tolist(), strict=True)
    ):
        # what the steps scatter adds up as a variance
        deviation = deviations[k] = math.hypot(rest * deviation, own)
    return Carried(errors, deviations)


def chain(parts: list[Course]) -> Course:
    """One course after the other."""
    ends, steps = parts[0].times[:1], 0
    kinks = []
    for part in parts:
        kinks.append(part.kinks._replace(step=part.kinks.step + steps))
        steps += len(part.rates)
        ends = np.append(ends, part.times[1:])
    columns = ("rates", "lower", "high", "bends", "moves", "stops")
    rows = {name: np.concatenate([getattr(part, name) for part in parts]) for name in columns}
    return Course(times=ends, **rows, kinks=joined(kinks))
