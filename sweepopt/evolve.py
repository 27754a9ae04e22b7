"""solve(): from a process to a solution; every argument is checked before the loop starts."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from sweepopt.blocks import BlockWriter, Stored
from sweepopt.checks import count, number, vector
from sweepopt.errors import (
    InputError,
    MissingExtraError,
    StabilityWarning,
    Status,
    StepError,
    SweepoptError,
    UnstableStepError,
)
from sweepopt.march import Summary, march
from sweepopt.plan import PATHS, Plan, make_plan
from sweepopt.process import EvolutionVI, SweepingProcess
from sweepopt.schemes import Scheme, choose
from sweepopt.solution import Solution
from sweepopt.states import MEMORY, Keeper, Kept, Lifted, States, saving


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
    path: str = "auto",
    save: Any = None,
    memory: float = MEMORY,
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
        "auto", "clarabel", "osqp", "daqp", "newton", "cvxpy" or an object: ``OSQP(tol=1e-10)``.
    tol : float
        Each program's certificate is at most tol * max(|z|_M, |M^-1 q|_M); a step that misses it
        is tried with tighter settings, then with another solver, then handled as on_failure says.
    path : {"auto", "proportional", "eliminated", "full", "multigrid"}
        Which unknowns enter a step: with "full" all of them; with "eliminated" the few that C(t)
        acts on enter a program and the others two substitutions; with "proportional" (B = rho A
        and a Separable load) the others enter no step at all. "multigrid" iterates on all of them
        and factorises nothing. "auto" takes multigrid where factors would not fit in memory, and
        else proportional, eliminated or full, the first that applies.
    save : None, "last", int, array_like, callable, str or Path
        What is kept: all steps, the last one, every k-th, those that end at the given times of the
        grid, what a function of (t, u, z) returns for each step (in `Solution.recorded`), or all
        steps in a NetCDF file "run.nc" that is written in blocks. The last step always is kept.
    memory : float
        Bytes that the kept states may take; a run that needs more is refused before it starts.
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
        ("path", path, tuple(PATHS)),
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
    memory = number("memory", memory, minimum=0.0, strict=True)
    times, mus = time_grid(t_end, steps)
    tableau = choose(scheme, process.rate_independent)
    members = process.check(_evaluation_times(times, mus, tableau))
    plan = make_plan(process, members, tableau, solver, tol, path)
    wanted = saving(save, times, plan.entering, memory)
    process.check_start(float(times[0]))
    _check_stability(process, tableau, float(mus.max()), on_unstable)

    moved = plan.reduction.process if plan.reduction else process
    lift = _Lift(plan, times, mus)
    keeper = Keeper(wanted.steps, moved.u0)
    bar = _progress_bar(len(mus)) if progress else None
    blocks = BlockWriter(wanted.path, float(times[0]), process.u0) if wanted.path else None
    recorded: list[Any] = []

    def look(i: int, u: np.ndarray, z: np.ndarray, certificate: float) -> bool | None:
        if bar is not None:
            bar.update()
        if callback is None and blocks is None and wanted.function is None:
            return None
        t, u, z = float(times[i + 1]), lift.state(i + 1, u).copy(), lift.velocity(i, z).copy()
        if blocks is not None:
            blocks.put(t, u, z)
        if wanted.function is not None:
            recorded.append(wanted.function(t, u, z))
        return callback(StepInfo(i, t, u, z, certificate)) if callback is not None else None

    watched = any(one is not None for one in (bar, callback, blocks, wanted.function))
    beside, finished = lift.seconds, False
    try:
        run = march(
            moved,
            plan.of_entering,
            times,
            mus,
            keeper,
            look if watched else None,
            lift.prove if plan.reduction else None,
        )
        finished = run.status is not Status.INEXACT or on_failure == "stop"
    finally:
        if bar is not None:
            bar.close()
        if blocks is not None:
            blocks.close(finished)
    kept_steps, kept = keeper.close()
    if run.status is Status.INEXACT and on_failure == "raise":
        u = lift.state(run.done, kept.nodes[-1])
        raise StepError(run.cause, float(times[run.done]), run.done, u, run.relative)
    stats = run.log.table(times[1 : run.done + 1])
    stats["seconds"] += beside[: run.done]
    states: States = lift.of(kept, kept_steps)
    if blocks is not None:
        states, kept_steps = Stored(blocks.path, blocks.run), np.arange(blocks.steps)
    return Solution(
        process=process,
        plan=plan,
        t=np.append(times[0], times[kept_steps + 1]),
        steps=kept_steps,
        states=states,
        stats=stats,
        status=run.status,
        cause=run.cause,
        recorded=recorded if wanted.function is not None else None,
    )


class _Lift:
    """All unknowns from those that enter the steps; the coefficients of the load come first."""

    def __init__(self, plan: Plan, times: np.ndarray, mus: np.ndarray) -> None:
        self._plan, self._times, self._mus = plan, times, mus

    @cached_property
    def _moved(self) -> tuple[Kept, np.ndarray]:
        """The coefficients of the whole run, and the seconds of each of their steps."""
        assert self._plan.reduction is not None
        process = self._plan.reduction.coefficients
        n = len(self._mus)
        keeper = Keeper(np.arange(n), process.u0)
        run = march(process, self._plan.of_coefficients, self._times, self._mus, keeper)
        if run.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        if run.done < n:
            raise SweepoptError(f"the load's coefficients: {run.cause or run.status.value}")
        return keeper.close()[1], run.log.table(self._times[1:])["seconds"]

    @property
    def _alpha(self) -> Kept:
        return self._moved[0]

    @property
    def seconds(self) -> np.ndarray:
        """What each step costs beside the loop."""
        return np.zeros(len(self._mus)) if self._plan.reduction is None else self._moved[1]

    def state(self, node: int, u: np.ndarray) -> np.ndarray:
        """The state at a node of the grid."""
        reduction = self._plan.reduction
        return u if reduction is None else reduction.lift(u, self._alpha.nodes[node])

    def velocity(self, i: int, z: np.ndarray) -> np.ndarray:
        """The velocity of a step."""
        reduction = self._plan.reduction
        return z if reduction is None else reduction.lift(z, self._alpha.velocities[i])

    def prove(self, i: int, zeta: np.ndarray, velocity: np.ndarray, step: Summary) -> Summary:
        """The certificate of all unknowns from that of those that entered the step."""
        assert self._plan.reduction is not None
        gamma = self._mus[i] * self._plan.scheme.a[-1][-1]
        alphas = self._alpha.nodes[i], self._alpha.velocities[i]
        error, size = self._plan.reduction.residual((zeta, velocity), alphas, gamma)
        certificate = step.certificate + error
        if step.relative > 0:
            size = max(size, step.certificate / step.relative)
        relative = certificate / size if certificate > 0 else certificate
        return step._replace(certificate=certificate, relative=relative)

    def of(self, kept: Kept, steps: np.ndarray) -> States:
        """The kept states as states of all unknowns."""
        reduction = self._plan.reduction
        if reduction is None:
            return kept
        return Lifted(kept, lambda: self._alpha, steps, reduction.lift, self._plan.unknowns)


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
    ordered, counts = mus[order], np.bincount(group)
    last = np.cumsum(counts) - 1
    # neighbours by rounding may drift apart in a long chain: then each keeps its own
    one_size = ordered[last] - ordered[last - counts + 1] <= 4 * rounding
    sizes = np.bincount(group, weights=ordered) / counts
    mus[order] = np.where(one_size[group], sizes[group], ordered)
    return times, mus


def _evaluation_times(times: np.ndarray, mus: np.ndarray, scheme: Scheme) -> np.ndarray:
    """Where C(t) is asked for or shall be checked: the nodes, and the stages of every step."""
    stages = times[:-1, None] + mus[:, None] * np.array(scheme.c)
    return np.unique(np.append(times, np.minimum(stages, times[1:, None])))


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


def _progress_bar(steps: int) -> Any:
    try:
        from tqdm.auto import tqdm
    except ImportError as error:
        raise MissingExtraError("tqdm", "fem") from error
    return tqdm(total=steps, unit="step")
