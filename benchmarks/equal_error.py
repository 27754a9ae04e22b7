"""What every way to a trajectory costs at one error: its cheapest setting, then all in turn.

    python benchmarks/equal_error.py S03 --error 1e-6

The library's schemes, a bare loop of the paper's scheme, SciPy's solvers on `so.velocity_field`,
and SciPy's solvers on the smoothed friction law

    a u' + b u + g tanh(u'/eps) = f(t),

the root z of a z + g tanh(z/eps) = f - b u being an explicit velocity. As eps -> 0 its solution
tends to that of the sweeping process with C(t) = f(t) - [-g, g], at a distance proportional to eps.
All report u at the same times. Each way tries its settings from cheap to dear until one is accurate
enough or takes too long.
"""

from __future__ import annotations

import argparse
import gc
import itertools
import math
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.integrate import odeint, solve_ivp

import sweepopt as so
from sweepopt.study import machine
from sweepopt.study.problems import problem

REPORTS = 100
"""Equal intervals at whose ends u is reported."""
LOOKS = 10
"""Steps that ODE solvers take at least: at rest all derivatives vanish and slip may be passed."""
PATIENCE = 30.0
"""Seconds of a run after which a way is given up."""
SLOW = 2.0
"""Seconds from which on a run is timed once."""
SHARES = (0.1, 0.3, 0.6, 0.9)
"""Of the error for the smoothing: each is results, the fastest counts."""
METHODS = ("BDF", "Radau", "LSODA")
BLOCKS = ("S01", "S02", "S03", "block")


@dataclass(frozen=True)
class Task:
    """A trajectory whose exact states are known at the times of the reports."""

    process: so.SweepingProcess
    t_end: float
    times: np.ndarray
    exact: np.ndarray

    @classmethod
    def of(cls, process: so.SweepingProcess, t_end: float) -> Task:
        sol = so.solve(process, t_end=t_end, steps=REPORTS, scheme="exact")
        return cls(process, t_end, sol.t, sol.u)

    def error(self, u: np.ndarray) -> float:
        """The largest |u - exact|_A of the reports; inf where there is no u."""
        apart = u - self.exact
        if not np.isfinite(apart).all():
            return math.inf
        return max(math.sqrt(x @ (self.process.A @ x)) for x in apart)


class Run(NamedTuple):
    """A setting in words, and what it runs: u at the times, shape (REPORTS + 1, dim)."""

    setting: str
    states: Callable[[], np.ndarray]


class Way(NamedTuple):
    """A way to a trajectory: from an error to the settings that might do, cheap ones first."""

    name: str
    settings: Callable[[float], Iterable[Run]]


class Result(NamedTuple):
    """The cheapest run of a way, or the most accurate one if none was accurate enough."""

    way: str
    run: Run
    error: float
    seconds: float
    reached: bool


# ---- ways -------------------------------------------------------------------------------------


def scheme(task: Task, name: str) -> Way:
    """One of the library's schemes with equal steps."""

    def states(steps: int) -> np.ndarray:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", so.SweepoptWarning)  # of large steps: seen in the error
            return so.solve(
                task.process,
                t_end=task.t_end,
                steps=steps,
                scheme=name,
                save=steps // REPORTS,
                on_unstable="ignore",
            ).u

    return Way(name, partial(_more_steps, states))


def exact(task: Task) -> Way:
    """The event-exact integrator."""

    def states() -> np.ndarray:
        return so.solve(task.process, t_end=task.t_end, steps=REPORTS, scheme="exact").u

    return Way("exact", lambda wanted: [Run("closed forms", states)])


def by_hand(task: Task) -> Way:
    """The paper's scheme for one unknown as a loop over floats, with nothing around it."""
    a, b, g, load, u0 = friction_of(task.process)

    def states(steps: int) -> np.ndarray:
        each, mu, u = steps // REPORTS, task.t_end / steps, u0
        reports = [u]
        for k in range(REPORTS):
            times = mu * np.arange(k * each + 1, (k + 1) * each + 1, dtype=np.float64)
            for f in load.at_many(times)[:, 0].tolist():
                s = f - b * u
                if s > g:
                    u += mu * (s - g) / a
                elif s < -g:
                    u += mu * (s + g) / a
            reports.append(u)
        return np.array(reports)[:, None]

    return Way("catching-up by hand", partial(_more_steps, states))


def field_solver(task: Task, method: str) -> Way:
    """SciPy's solver on `so.velocity_field`."""

    def states(rtol: float) -> np.ndarray:
        return integrate(task, so.velocity_field(task.process), method, rtol)

    def settings(wanted: float) -> Iterator[Run]:
        for rtol in _tolerances(wanted):
            yield Run(f"rtol {rtol:.1e}", partial(states, rtol))

    return Way(f"{method} on velocity_field", settings)


def smoothed(task: Task, method: str, share: float) -> Way:
    """SciPy's solver on the smoothed law, eps such that smoothing takes a share of the error."""
    per_error = smoothing(task)

    def settings(wanted: float) -> Iterator[Run]:
        eps = share * wanted * per_error
        law = SmoothedLaw(task.process, eps)
        for rtol in _tolerances(wanted):
            run = partial(integrate, task, law.velocity, method, rtol, law.slope)
            yield Run(f"eps {eps:.1e}, rtol {rtol:.1e}", run)

    return Way(f"{method} on the smoothed law", settings)


def smoothing(task: Task) -> float:
    """eps / error of the smoothed law's own solution, for an eps that leaves little error."""
    law = SmoothedLaw(task.process, 1e-7)
    return law.eps / task.error(integrate(task, law.velocity, "LSODA", 1e-12, law.slope))


def ours(task: Task) -> list[Way]:
    """What the library offers, the schemes of order 1 apart."""
    names = ("midpoint", "trapezoid", "sdirk2")
    return [*(scheme(task, name) for name in names), exact(task), field_solver(task, "LSODA")]


def all_ways(task: Task) -> list[Way]:
    """The paper's scheme, ours, and the smoothed law by SciPy's solvers."""
    first = [scheme(task, "catching-up"), by_hand(task), scheme(task, "implicit-euler")]
    rivals = [smoothed(task, method, share) for method in METHODS for share in SHARES]
    return [*first, *ours(task), field_solver(task, "Radau"), *rivals]


def _more_steps(states: Callable[[int], np.ndarray], wanted: float) -> Iterator[Run]:
    """Multiples of REPORTS, a factor of about 1.4 apart."""
    for k in itertools.count():
        steps = REPORTS * int(2.0 ** (k / 2))
        yield Run(f"{steps} steps", partial(states, steps))


def _tolerances(wanted: float) -> Iterator[float]:
    """Half decades from ten times the wanted error."""
    for k in range(10):
        yield 10.0 * wanted * 10.0 ** (-k / 2)


# ---- the smoothed law -------------------------------------------------------------------------


class Friction(NamedTuple):
    """A block on a dashpot a and a spring b, friction bound g, pulled by the load f."""

    a: float
    b: float
    g: float
    load: so.Separable
    u0: float


def friction_of(process: so.SweepingProcess) -> Friction:
    """The numbers of one of the `BLOCKS`, whose C(t) = f(t) - [-g, g]."""
    C = process.C
    b = 0.0 if process.B is None else float(process.B[0, 0])
    a, g, u0 = process.A[0, 0], C.shape.upper[0], process.u0[0]
    return Friction(float(a), b, float(g), C.center, float(u0))


class SmoothedLaw:
    """a u' + b u + g tanh(u'/eps) = f(t), solved for u', and its derivative in u."""

    def __init__(self, process: so.SweepingProcess, eps: float) -> None:
        self.eps, self._friction = eps, friction_of(process)
        self._weights = self._friction.load.shapes[:, 0].tolist()

    def velocity(self, t: float, u: Any) -> list[float]:
        s = self._force(t, u)
        return [math.copysign(self._root(s)[0], s)]

    def slope(self, t: float, u: Any) -> list[list[float]]:
        return [[-self._friction.b / self._root(self._force(t, u))[1]]]

    def _force(self, t: float, u: Any) -> float:
        load = self._friction.load
        pull = sum(weight * load.value(k, t) for k, weight in enumerate(self._weights))
        return float(pull - self._friction.b * u[0])

    def _root(self, s: float) -> tuple[float, float]:
        """|z| and the slope there: the law is concave in |z|, Newton's method climbs from below."""
        (a, _, g, _, _), eps, size = self._friction, self.eps, abs(s)
        z = max(size / (a + g / eps), (size - g) / a)
        for _ in range(50):
            friction = math.tanh(z / eps)
            slope = a + g / eps * (1.0 - friction * friction)
            change = (size - a * z - g * friction) / slope
            z += change
            if abs(change) <= 1e-14 * (z + eps):
                break
        return z, slope


def integrate(
    task: Task, velocity: Callable[..., Any], method: str, rtol: float, slope: Any = None
) -> np.ndarray:
    """u' = velocity(t, u) by SciPy, atol a tenth of rtol; nan where a solver did not come.

    LSODA by `odeint`, which calls back from compiled code only for velocities.
    """
    u0, times, longest = task.process.u0, task.times, task.t_end / LOOKS
    tolerances = {"rtol": rtol, "atol": 0.1 * rtol}
    if method == "LSODA":
        options = {"hmax": longest, "mxstep": 100_000, "full_output": True, **tolerances}
        u, report = odeint(velocity, u0, times, Dfun=slope, tfirst=True, **options)
        return np.asarray(u) if "successful" in report["message"] else np.full_like(u, np.nan)
    options = {"t_eval": times, "jac": slope, "max_step": longest, **tolerances}
    with np.errstate(divide="ignore"):  # Radau divides by its error, which is 0 at rest
        result = solve_ivp(velocity, (times[0], times[-1]), u0, method=method, **options)
    u = np.full((len(times), len(u0)), np.nan)
    u[: result.y.shape[1]] = result.y.T
    return u


# ---- the cheapest setting, and its time -------------------------------------------------------


def cheapest(task: Task, way: Way, wanted: float, patience: float = PATIENCE) -> Result:
    """The cheapest setting of a way that reaches an error."""
    results = []
    for run in way.settings(wanted):
        started = time.perf_counter()
        error = task.error(run.states())
        seconds = time.perf_counter() - started
        results.append(Result(way.name, run, error, seconds, error <= wanted))
        if error <= wanted or seconds > patience:
            break
    return min(results, key=lambda result: result.error)


def equal_error(
    task: Task, wanted: float, ways: Sequence[Way], rounds: int = 5, patience: float = PATIENCE
) -> pd.DataFrame:
    """Time each way at its cheapest setting whose error is at most `wanted`.

    A row a way, of several with one name the fastest: the fastest first, what did not reach the
    error last.
    """
    fastest: dict[str, Result] = {}
    for way in ways:
        result = cheapest(task, way, wanted, patience)
        print(f"{way.name}: {result.run.setting}, error {result.error:.1e}", file=sys.stderr)
        other = fastest.setdefault(way.name, result)
        if (not result.reached, result.seconds) < (not other.reached, other.seconds):
            fastest[way.name] = result
    return timed(list(fastest.values()), rounds)


def timed(results: Sequence[Result], rounds: int) -> pd.DataFrame:
    """All in turn, several rounds; slow ones keep the time of the run that was tried."""
    seconds = {one.way: [one.seconds] if one.seconds > SLOW else [] for one in results}
    for _ in range(rounds):
        for one in results:
            if one.seconds <= SLOW:
                gc.collect()
                started = time.perf_counter()
                one.run.states()
                seconds[one.way].append(time.perf_counter() - started)
    table = pd.DataFrame(
        {
            "way": [one.way for one in results],
            "setting": [one.run.setting for one in results],
            "error": [one.error for one in results],
            "ms": [1e3 * median(seconds[one.way]) for one in results],
            "note": ["" if one.reached else "not reached" for one in results],
        }
    )
    table.insert(4, "x best", table.ms / table.ms[table.note == ""].min())
    return table.sort_values(["note", "ms"], ignore_index=True)


def text(table: pd.DataFrame) -> str:
    """The costs as text."""
    forms = {"error": "{:.1e}".format, "ms": "{:.4g}".format, "x best": "{:.3g}".format}
    return table.to_string(index=False, formatters=forms)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="What every way costs at one error.")
    parser.add_argument("problem", choices=BLOCKS, help="one block on a dashpot")
    parser.add_argument("--error", type=float, nargs="+", default=[1e-6])
    parser.add_argument("--t-end", type=float, help="shorter than the problem")
    parser.add_argument("--patience", type=float, default=PATIENCE, help="seconds of a run")
    parser.add_argument("--rounds", type=int, default=5)
    chosen = parser.parse_args(arguments)
    posed = problem(chosen.problem)
    task = Task.of(posed.process(), chosen.t_end or posed.t_end)
    print(f"{machine()}\n{posed.name}: {posed.title}, t_end {task.t_end:g}")
    for wanted in chosen.error:
        table = equal_error(task, wanted, all_ways(task), chosen.rounds, chosen.patience)
        print(f"\nerror at most {wanted:g} at {REPORTS} equal times\n{text(table)}", flush=True)


if __name__ == "__main__":
    main()
