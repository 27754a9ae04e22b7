"""Ways to a trajectory that can be compared: our schemes, a loop by hand, other ODE solvers.

A way knows its settings from cheap to dear, and what a setting runs. All of them report u at the
same times.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np

from sweepopt.errors import SweepoptWarning
from sweepopt.integrate import velocity_field
from sweepopt.problem import SweepingProcess
from sweepopt.solve import solve
from sweepopt.study.smoothed import METHODS, Method, friction_of, integrate, solve_smoothed

REPORTS = 100
"""Equal intervals at whose ends everyone reports u."""
LOOKS = 10
"""Steps that other ODE solvers take at least, lest they pass a slip phase unseen."""
TIGHT = 1e-12


@dataclass(frozen=True)
class Task:
    """A trajectory whose exact states are known.

    Parameters
    ----------
    process : SweepingProcess
        One that scheme="exact" integrates, A coercive.
    t_end : float
    """

    process: SweepingProcess
    t_end: float
    times: np.ndarray = field(init=False)
    exact: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        sol = solve(self.process, t_end=self.t_end, steps=REPORTS, scheme="exact")
        object.__setattr__(self, "times", sol.t)
        object.__setattr__(self, "exact", sol.u)

    def error(self, u: np.ndarray) -> float:
        """The largest |u - exact|_A of the reports; inf where there is no u."""
        away = u - self.exact
        return max(map(self.process.metric.norm, away)) if np.isfinite(away).all() else math.inf


class Run(NamedTuple):
    """A setting in words, and what it runs: u at the times, shape (REPORTS + 1, dim)."""

    setting: str
    states: Callable[[], np.ndarray]


class Steps(NamedTuple):
    """A way whose accuracy is a number of equal steps, a multiple of REPORTS."""

    name: str
    run: Callable[[int], Run]


class Ladder(NamedTuple):
    """A way whose settings are rungs; the first that is accurate enough is taken.

    Attributes
    ----------
    name : str
    rungs : callable
        From an error to the settings that might do, cheap ones first.
    """

    name: str
    rungs: Callable[[float], Iterator[Run]]


Way = Steps | Ladder


def scheme(task: Task, name: str) -> Steps:
    """One of the library's schemes with equal steps."""

    def states(steps: int) -> np.ndarray:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SweepoptWarning)  # of large steps: seen in the error
            return solve(
                task.process,
                t_end=task.t_end,
                steps=steps,
                scheme=name,
                save=steps // REPORTS,
                on_unstable="ignore",
            ).u

    return Steps(name, lambda steps: Run(f"{steps} steps", partial(states, steps)))


def exact(task: Task) -> Ladder:
    """The event-exact integrator."""
    run = partial(solve, task.process, t_end=task.t_end, steps=REPORTS, scheme="exact")
    return Ladder("exact", lambda wanted: iter([Run("closed forms", lambda: run().u)]))


def by_hand(task: Task) -> Steps:
    """The paper's scheme for one unknown as a loop over floats, with nothing around it."""
    a, b, g, load, u0 = friction_of(task.process)

    def states(steps: int) -> np.ndarray:
        each = steps // REPORTS
        mu, u = task.t_end / steps, u0
        told = [u]
        for k in range(REPORTS):
            times = mu * np.arange(k * each + 1, (k + 1) * each + 1, dtype=np.float64)
            for f in load.at_many(times)[:, 0].tolist():
                s = f - b * u
                if s > g:
                    u += mu * (s - g) / a
                elif s < -g:
                    u += mu * (s + g) / a
            told.append(u)
        return np.array(told)[:, None]

    return Steps("catching-up by hand", lambda steps: Run(f"{steps} steps", partial(states, steps)))


def field_solver(task: Task, method: Method) -> Ladder:
    """SciPy's solver on `velocity_field`, which it compiles for itself."""

    def states(rtol: float) -> np.ndarray:
        velocity, limit = velocity_field(task.process), task.t_end / LOOKS
        return integrate(velocity, task.process.u0, task.times, method, rtol, limit)

    def rungs(wanted: float) -> Iterator[Run]:
        for rtol in _tolerances(wanted):
            yield Run(f"rtol {rtol:.1e}", partial(states, rtol))

    return Ladder(f"{method} on velocity_field", rungs)


def smoothed(task: Task, method: Method, share: float) -> Ladder:
    """SciPy's solver on the smoothed law, eps such that smoothing takes a share of the error."""
    friction = friction_of(task.process)
    run = partial(solve_smoothed, friction, task.times, method=method, max_step=task.t_end / LOOKS)

    def rungs(wanted: float) -> Iterator[Run]:
        eps = share * wanted * smoothing(task)
        for rtol in _tolerances(wanted):
            yield Run(f"eps {eps:.1e}, rtol {rtol:.1e}", partial(run, eps=eps, rtol=rtol))

    return Ladder(f"{method} on the smoothed law", rungs)


def smoothing(task: Task) -> float:
    """eps / error of the smoothed law's own solution, for an eps that leaves little error."""
    eps = 1e-7
    u = solve_smoothed(
        friction_of(task.process), task.times, eps=eps, method="LSODA", rtol=TIGHT,
        max_step=task.t_end / LOOKS,
    )  # fmt: skip
    return eps / task.error(u)


SHARES = (0.1, 0.3, 0.6, 0.9)
"""Of the error for the smoothing: each is tried, the fastest counts."""


def ours(task: Task) -> list[Way]:
    """What the library offers, the schemes of order 1 apart."""
    names = ("midpoint", "trapezoid", "sdirk2")
    return [*(scheme(task, name) for name in names), exact(task), field_solver(task, "LSODA")]


def all_ways(task: Task) -> list[Way]:
    """The paper's scheme, ours, and the smoothed law by SciPy's solvers."""
    first = [scheme(task, "catching-up"), by_hand(task), scheme(task, "implicit-euler")]
    rivals = [smoothed(task, method, share) for method in METHODS for share in SHARES]
    return [*first, *ours(task), field_solver(task, "Radau"), *rivals]


def _tolerances(wanted: float) -> Iterator[float]:
    """Half decades from ten times the wanted error."""
    for k in range(10):
        yield 10.0 * wanted * 10.0 ** (-k / 2)
