"""solve(): the only loop over time."""

from __future__ import annotations

import math
import time as clock
import warnings
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from sweepopt.checks import Matrix, count, number, vector
from sweepopt.errors import (
    InputError,
    MissingExtraError,
    StabilityWarning,
    Status,
    StepError,
    UnstableStepError,
)
from sweepopt.plan import Plan, Solved, VelocityOf, make_plan
from sweepopt.process import EvolutionVI, SweepingProcess
from sweepopt.schemes import Scheme, choose
from sweepopt.solution import STATS, Solution


class StepInfo(NamedTuple):
    """What a callback sees after a step: its index, end time, state, velocity, certificate."""

    step: int
    t: float
    u: np.ndarray
    velocity: np.ndarray
    certificate: float


def solve(
    process: SweepingProcess | EvolutionVI,
    *,
    t_end: float | None = None,
    steps: Any = 1000,
    scheme: str = "auto",
    solver: Any = "auto",
    tol: float = 1e-6,
    progress: bool = False,
    callback: Callable[[StepInfo], bool | None] | None = None,
    on_failure: Literal["raise", "stop"] = "raise",
    on_unstable: Literal["raise", "warn", "ignore"] = "raise",
) -> Solution:
    """Move a process through time and certify every step.

    Parameters
    ----------
    process : SweepingProcess or EvolutionVI
    t_end : float
        End of the interval [0, t_end]; may be left out when `steps` is an array.
    steps : int or array_like
        Number of equal steps, or the increasing times themselves (the first one is where u0 holds).
    scheme : str
        "auto" (midpoint; implicit-euler when A = 0), "catching-up", "implicit-euler", "midpoint".
    solver : str or Solver
        "auto", "clarabel", "osqp", "newton", "cvxpy" or an object: ``Clarabel(tol=1e-10)``.
    tol : float
        Each program's certificate is at most tol * max(|z|_M, |M^-1 q|_M); a step that misses it
        is tried with tighter settings, then with another solver, then handled as on_failure says.
    progress : bool
        Show a progress bar (needs tqdm).
    callback : callable, optional
        Called after each step; returning True stops the run and keeps what was computed.
    on_failure : {"raise", "stop"}
        Raise StepError, or return the steps that are certified with status INEXACT.
    on_unstable : {"raise", "warn", "ignore"}
        What catching-up does when mu Lam > 2; between 1 and 2 it warns unless "ignore".

    Returns
    -------
    Solution

    Raises
    ------
    InputError, EmptySetError, SolverRefusedError
        For bad input, before any solver runs.
    UnstableStepError, StepError

    Notes
    -----
    t_i = t_0 + i mu; u_{i+1} = u_i + mu sum_k b_k z_k with compensated summation. Ctrl-C returns
    the steps computed so far with status INTERRUPTED.

    Examples
    --------
    A body that sticks until the load 1.5 t reaches the friction bound 1:

    >>> import sweepopt as so
    >>> C = so.Moving(so.Box([-1], [1]), center=lambda t: [1.5 * t])
    >>> process = so.SweepingProcess(A=[[0.5]], B=[[2.0]], C=C, u0=[0.0])
    >>> sol = so.solve(process, t_end=5.0, steps=200)
    >>> sol.success, float(sol(0.5)[0]), round(float(sol(5.0)[0]), 3)
    (True, 0.0, 3.063)
    """
    for name, value, allowed in (
        ("on_failure", on_failure, ("raise", "stop")),
        ("on_unstable", on_unstable, ("raise", "warn", "ignore")),
    ):
        if value not in allowed:
            raise InputError(f"{name} must be one of {', '.join(allowed)}; got {value!r}")
    if not isinstance(process, (SweepingProcess, EvolutionVI)):
        raise InputError(f"process must be a SweepingProcess or an EvolutionVI: {process!r:.60}")
    if callback is not None and not callable(callback):
        raise InputError(f"callback must be a function of a StepInfo, got {callback!r:.60}")
    process = process.as_sweeping()
    tol = number("tol", tol, minimum=0.0, strict=True)
    times, mus = time_grid(t_end, steps)
    tableau = choose(scheme, process.rate_independent)
    members = process.check(_evaluation_times(times, mus, tableau))
    plan = make_plan(process, members, tableau, solver, tol)
    process.check_start(float(times[0]))
    _check_stability(process, tableau, float(mus.max()), on_unstable)
    return _march(process, plan, times, mus, progress, callback, on_failure)


def time_grid(t_end: float | None, steps: Any) -> tuple[np.ndarray, np.ndarray]:
    """The times, t_0 + i mu or the user's own, and the step sizes.

    Steps that differ by the rounding of the times only get one size: they share a program.
    """
    end = None if t_end is None else number("t_end", t_end, minimum=0.0, strict=True)
    if np.ndim(steps) == 0:
        n = count("steps", steps)
        if end is None:
            raise InputError("t_end is missing; give it or pass the times as steps")
        return np.append(np.arange(n) * (end / n), end), np.full(n, end / n)
    times = vector("steps", steps)
    if times.size < 2 or not (np.diff(times) > 0).all():
        raise InputError("steps must hold at least two strictly increasing times")
    if end is not None and abs(times[-1] - end) > 1e-12 * abs(times[-1]):
        raise InputError(f"steps end at {times[-1]:g}, but t_end is {end:g}; leave t_end out")
    mus = np.diff(times)
    order = np.argsort(mus, kind="stable")
    rounding = 4 * np.finfo(float).eps * np.abs(times).max()
    group = np.cumsum(np.diff(mus[order], prepend=mus[order[0]]) > rounding)
    sizes = np.bincount(group, weights=mus[order]) / np.bincount(group)
    mus[order] = sizes[group]
    return times, mus


def _evaluation_times(times: np.ndarray, mus: np.ndarray, scheme: Scheme) -> np.ndarray:
    """Where C(t) is asked for: the two ends, and the stages of every step."""
    stages = times[:-1, None] + mus[:, None] * np.array(scheme.c)
    return np.unique(np.append(times[[0, -1]], np.minimum(stages, times[1:, None])))


def _check_stability(process: SweepingProcess, scheme: Scheme, mu: float, on_unstable: str) -> None:
    """Explicit in u means mu Lam <= 2, and no overshoot only for mu Lam <= 1."""
    if scheme.implicit or on_unstable == "ignore" or process.B is None:
        return
    number_ = mu * process.Lam
    if number_ <= 1:
        return
    remedy = (
        f"mu Lam = {number_:.3g}; take mu <= {1 / process.Lam:.3g}, or implicit-euler or midpoint, "
        "which need no such step"
    )
    if number_ > 2 and on_unstable == "raise":
        raise UnstableStepError(
            f"scheme {scheme.name!r} amplifies errors: {remedy}, or say on_unstable='warn'"
        )
    effect = "amplifies errors" if number_ > 2 else "can overshoot into a wrong stuck state"
    warnings.warn(f"scheme {scheme.name!r} {effect}: {remedy}", StabilityWarning, stacklevel=3)


def _march(
    process: SweepingProcess,
    plan: Plan,
    times: np.ndarray,
    mus: np.ndarray,
    progress: bool,
    callback: Callable[[StepInfo], bool | None] | None,
    on_failure: str,
) -> Solution:
    steps = len(times) - 1
    u = np.zeros((steps + 1, process.dim))
    velocity = np.zeros((steps, process.dim))
    stats = np.zeros(steps, dtype=STATS)
    u[0] = process.u0
    lost = np.zeros(process.dim)  # what rounding kept out of u (Kahan)
    velocities = _Velocities(process, plan)
    status, cause, done = Status.SUCCESS, "", 0
    bar = _progress_bar(steps) if progress else None
    try:
        for i in range(steps):
            started = clock.perf_counter()
            t, mu = float(times[i]), float(mus[i])
            z, stages = _step(process, plan.scheme, velocities, t, mu, u[i])
            certificate = _worst(solved.velocity.certificate for solved in stages)
            relative = _worst(solved.velocity.relative for solved in stages)
            attempts = max(solved.attempts for solved in stages)
            following = u[i] + (mu * z - lost)
            if relative > plan.tol or not np.isfinite(following).all():
                cause = _cause(i, t, relative, attempts, plan.tol)
                if on_failure == "raise":
                    raise StepError(cause, t, i, u[i].copy(), relative)
                status = Status.INEXACT
                break
            if math.isnan(relative):
                status = Status.UNCERTIFIED
            lost = (following - u[i]) - (mu * z - lost)
            u[i + 1] = following
            velocity[i] = z
            iterations = sum(solved.iterations for solved in stages)
            seconds, by = clock.perf_counter() - started, stages[-1].solver
            stats[i] = (times[i + 1], seconds, iterations, attempts, certificate, relative, by)
            done = i + 1
            if bar is not None:
                bar.update()
            if callback is not None and callback(
                StepInfo(i, float(times[i + 1]), following, z, certificate)
            ):
                status = Status.STOPPED if done < steps else status
                break
    except KeyboardInterrupt:
        status = Status.INTERRUPTED
    finally:
        if bar is not None:
            bar.close()
    return Solution(
        process,
        plan,
        times[: done + 1],
        u[: done + 1],
        velocity[:done],
        stats[:done],
        status,
        cause if status is Status.INEXACT else "",
    )


class _Velocities:
    """Compiled velocity programs, one per matrix A + gamma B."""

    LIMIT = 16  # irregular grids would otherwise keep one factorisation per step

    def __init__(self, process: SweepingProcess, plan: Plan) -> None:
        self._process, self._plan = process, plan
        self._compiled: dict[float, VelocityOf] = {}

    def __call__(self, gamma: float) -> VelocityOf:
        if gamma not in self._compiled:
            if len(self._compiled) == self.LIMIT:
                self._compiled.pop(next(iter(self._compiled)))
            self._compiled[gamma] = self._plan.velocity(self._matrix(gamma))
        return self._compiled[gamma]

    def _matrix(self, gamma: float) -> Matrix:
        process = self._process
        return process.A if process.B is None or not gamma else process.A + gamma * process.B


def _step(
    process: SweepingProcess,
    scheme: Scheme,
    velocities: _Velocities,
    t: float,
    mu: float,
    u: np.ndarray,
) -> tuple[np.ndarray, list[Solved]]:
    """One step of the tableau: its mean velocity and what its stages solved."""
    stages: list[Solved] = []
    for weights, c in zip(scheme.a, scheme.c, strict=True):
        known = u + mu * _combine(weights[:-1], stages) if stages else u
        gamma = mu * weights[-1] if process.B is not None else 0.0
        solved = velocities(gamma)(process.times_B(known), process.C.at(t + c * mu))
        stages.append(solved)
    return _combine(scheme.b, stages), stages


def _combine(weights: Sequence[float], stages: list[Solved]) -> np.ndarray:
    """sum of weights_k z_k; a single weight 1 keeps z to the last bit."""
    total = weights[0] * stages[0].velocity.z
    for weight, solved in zip(weights[1:], stages[1:], strict=True):
        total += weight * solved.velocity.z
    return total


def _worst(values: Iterable[float]) -> float:
    """The largest, or nan if one of them has no proof."""
    return max(values, key=lambda value: math.inf if math.isnan(value) else value)


def _cause(step: int, t: float, relative: float, attempts: int, tol: float) -> str:
    if not relative > tol:
        return f"step {step} from t = {t:g}: the state is not finite any more; take smaller steps"
    return (
        f"step {step} from t = {t:g}: the best certificate of {attempts} attempts is "
        f"{relative:.2g} of the velocity's size, tol is {tol:g}. The data of this step are scaled "
        "too badly for double precision, C(t) is nearly empty, or its projection is not exact "
        "enough; loosen tol or try another solver"
    )


def _progress_bar(steps: int) -> Any:
    try:
        from tqdm.auto import tqdm
    except ImportError as error:
        raise MissingExtraError("tqdm", "fem") from error
    return tqdm(total=steps, unit="step")
