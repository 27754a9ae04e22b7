"""solve(): from a process to a solution; every argument is checked before the loop starts."""

from __future__ import annotations

from functools import partial
from os import PathLike
from typing import Any, Literal, NamedTuple

import numpy as np

from sweepopt.checks import choice, number
from sweepopt.errors import InputError, PathError, Status, StepError, shown
from sweepopt.integrate import (
    MEMORY,
    Adaptive,
    AdaptiveResult,
    Bar,
    Callback,
    Checkpoint,
    Checkpoints,
    Keeper,
    Lift,
    Observers,
    Scheme,
    Segments,
    adapt,
    check_stability,
    checkpoints,
    choose,
    evaluation_times,
    mover,
    saving,
    time_grid,
    warn_of_overshoot,
)
from sweepopt.problem import EvolutionVI, SweepingProcess, sweeping
from sweepopt.results import Solution, refine
from sweepopt.velocity import PATHS, make_plan


def solve(
    process: SweepingProcess | EvolutionVI,
    *,
    t_end: float | None = None,
    steps: Any = 1000,
    scheme: str = "auto",
    solver: Any = "auto",
    tol: float = 1e-6,
    error: float | None = None,
    path: str = "auto",
    save: Any = None,
    memory: float = MEMORY,
    progress: bool = False,
    callback: Callback | None = None,
    checkpoint: Checkpoint | str | PathLike[str] | None = None,
    on_failure: Literal["raise", "stop"] = "raise",
    on_unstable: Literal["raise", "warn", "ignore"] = "raise",
) -> Solution:
    """Move a process through time and certify every step.

    Parameters
    ----------
    process : SweepingProcess or EvolutionVI
    t_end : float
        End of the interval [0, t_end]; may be left out when `steps` is an array.
    steps : int, array_like or Adaptive
        Number of equal steps, or the increasing times themselves (the first one is where u0 holds),
        or ``Adaptive(tol)``: steps that are chosen for an error of tol (see Notes).
    scheme : str
        "auto" (midpoint; when A = 0 implicit-euler, or sdirk2 with Adaptive), "catching-up",
        "implicit-euler", "midpoint", "trapezoid" (A coercive only), "sdirk2"; "exact" for polyhedra
        and loads as data (`Separable`): closed forms between switches that are located, in
        `Solution.exact` also between the nodes.
    solver : str or Solver
        "auto", "clarabel", "osqp", "daqp", "newton", "cvxpy" or an object: ``OSQP(tol=1e-10)``.
    tol : float
        Each program's certificate is at most tol * max(|z|_M, |M^-1 q|_M); a step that misses it
        is tried with tighter settings, then with another solver, then in 2 to 16 parts (see Notes),
        then handled as on_failure says.
    error : float, optional
        Refine the steps until `Solution.error_bound` is at most this; needs a load as data. The
        callback sees, and save= counts, the steps of the last run only, which is run once more.
    path : {"auto", "proportional", "eliminated", "full", "multigrid"}
        Which unknowns enter a step: with "full" all of them; with "eliminated" the few that C(t)
        acts on enter a program and the others two substitutions; with "proportional" (B = rho A
        and a Separable load) the others enter no step at all, and certificates are relative to no
        less than a thousandth of what the load or B u alone would move (near an equilibrium, where
        the two cancel, "eliminated" sees smaller velocities). "multigrid" iterates on all of them
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
    checkpoint : Checkpoint, str or Path, optional
        A file that the run is written to again and again, so that ``so.resume(path, process)``
        continues it if it is killed, with the same result bit for bit (see Notes).
    on_failure : {"raise", "stop"}
        Raise StepError, or return the steps that are certified with status INEXACT.
    on_unstable : {"raise", "warn", "ignore"}
        What catching-up does when mu Lam > 2; between 1 and 2 it warns unless "ignore". midpoint,
        trapezoid (mu Lam > 2) and sdirk2 (mu Lam > 1 + sqrt 2) warn of the first step that starts
        with B u far outside of C(t) and may have gone past the true rest, unless "ignore".

    Returns
    -------
    Solution

    Raises
    ------
    InputError, EmptySetError, SolverRefusedError
        For bad input, before any solver runs.
    UnstableStepError, StepError
    AccuracyError
        If refining does not reach `error`; the finest run is in it.
    CheckpointError
        If a checkpoint cannot be written; the one before it is whole.

    Notes
    -----
    Adaptive steps come from several passes over the run, coarse and cheap ones first: `passes` of
    the Solution has them all. They hit the breakpoints of loads that are data and the times given
    as `save`. A callback, a function or a file gets the steps of the last pass, in one more run.
    `tol` is lowered where the error asks for it. The proportional path is not used.

    Checkpoints are for steps given beforehand and states in memory, not for `error`, Adaptive,
    "exact" or NetCDF. Solvers forget earlier steps at each hundredth of the run, or as `Checkpoint`
    says, which moves the result by rounding.

    t_i = t_0 + i mu; u_{i+1} = u_i + mu sum_k b_k z_k with compensated summation. Ctrl-C returns
    the steps computed so far with status INTERRUPTED.

    A step in parts moves as so many steps of the scheme, and its velocity is their mean: u_n stays
    linear on the grid. Its certificate is the worst of its parts' programs and says nothing of the
    step as a whole; its solver in `stats` is "osqp/4" for 4 parts. `error_bound` looks at the nodes
    and velocities only, at no certificate, and holds as for any other run.

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
    asked = _Asked(t_end, steps, scheme, solver, tol, path, save, memory, on_failure, on_unstable)
    if error is not None:
        if checkpoint is not None:
            raise InputError("checkpoint= is for one run, but error= takes several; give steps")
        return _refined(process, asked, error, callback, progress)
    ready = _checked(process, asked, callback, checkpoint, progress)
    walked = ready.walked
    if ready.segments:
        walked = adapt(
            steps,
            ready.segments,
            ready.process,
            walked.plan,
            save,
            ready.memory,
            ready.bar.update,
        )
    return _moved(ready, walked, callback, on_failure)


class _Asked(NamedTuple):
    """The arguments of `solve` that make up a run, as its checkpoint holds them."""

    t_end: Any
    steps: Any
    scheme: Any
    solver: Any
    tol: Any
    path: Any
    save: Any
    memory: Any
    on_failure: Any
    on_unstable: Any


class _Ready(NamedTuple):
    """A run that may start: all of it is checked. `segments` are those of adaptive steps."""

    process: SweepingProcess
    segments: Segments | None
    walked: AdaptiveResult
    memory: float
    marks: Checkpoints | None
    bar: Bar


def _refined(
    process: Any, asked: _Asked, error: float, callback: Callback | None, progress: bool
) -> Solution:
    """Runs with more and more steps, until the bound of one is at most `error`."""
    if isinstance(asked.steps, Adaptive):
        raise InputError("error= chooses the steps itself; leave Adaptive out, or error=")
    again = partial(solve, process, **asked._replace(t_end=None, save=None)._asdict())
    first, _ = time_grid(asked.t_end, asked.steps)
    wanted = number("error", error, minimum=0.0, strict=True)
    sol = refine(lambda times: again(steps=times), first, wanted)
    if asked.save is None and callback is None and not progress:
        return sol
    return again(steps=sol.t, save=asked.save, callback=callback, progress=progress)


def _checked(
    process: Any, asked: _Asked, callback: Callback | None, checkpoint: Any, progress: bool
) -> _Ready:
    """Refuse what cannot be run, before anything is."""
    choice("path", asked.path, PATHS)
    choice("on_failure", asked.on_failure, ("raise", "stop"))
    choice("on_unstable", asked.on_unstable, ("raise", "warn", "ignore"))
    process = sweeping(process)
    if callback is not None and not callable(callback):
        raise InputError(f"callback must be a function of a StepInfo, got {shown(callback)}")
    tol = number("tol", asked.tol, minimum=0.0, strict=True)
    memory = number("memory", asked.memory, minimum=0.0, strict=True)
    scheme = _scheme(asked, process.rate_independent)
    segments = None
    if isinstance(asked.steps, Adaptive):
        segments = Segments.of(asked.steps, process, asked.t_end, scheme, asked.save)
        times, mus = time_grid(None, segments.equal())
    else:
        times, mus = time_grid(asked.t_end, asked.steps)
    members = process.check(evaluation_times(times, mus, scheme))
    plan = make_plan(process, members, scheme, asked.solver, tol, asked.path)
    if segments:
        plan = plan.of_all_unknowns("its coefficients need all steps beforehand, these adapt")
    elif plan.reduction and asked.path == "auto" and not plan.reduction.suits(mus, scheme, tol):
        plan = plan.of_all_unknowns("the steps differ so much that short ones would be rounding")
    walked = AdaptiveResult(times, mus, plan, saving(asked.save, times, plan.entering, memory))
    process.check_start(float(times[0]))
    check_stability(process, scheme, float(mus.max()), asked.on_unstable)
    marks = checkpoints(checkpoint, process, plan, times, asked._asdict())
    bar = Bar(progress, None if segments else len(mus), marks.done if marks else 0)
    return _Ready(process, segments, walked, memory, marks, bar)


def _scheme(asked: _Asked, rate_independent: bool) -> Scheme:
    """The tableau, if adaptive steps can use it where they are asked for."""
    name, adaptive = asked.scheme, isinstance(asked.steps, Adaptive)
    if adaptive and asked.path == "proportional":
        raise PathError("path='proportional' needs all steps beforehand; Adaptive cannot tell")
    if adaptive and isinstance(name, str) and name == "auto" and rate_independent:
        name = "sdirk2"
    scheme = choose(name, rate_independent)
    if adaptive and scheme.exact:
        raise InputError("scheme 'exact' has no error in time that steps could be adapted to")
    return scheme.unwatched if asked.on_unstable == "ignore" else scheme


def _moved(
    ready: _Ready, walked: AdaptiveResult, callback: Callback | None, on_failure: str
) -> Solution:
    """The run over the grid that was walked last, unless that was all there is to it."""
    process, marks = ready.process, ready.marks
    times, plan, wanted = walked.times, walked.plan, walked.wanted
    moved = plan.reduction.process if plan.reduction else process
    move = mover(moved, plan.of_entering, marks)
    lift = Lift(plan, times, walked.mus)
    beside = lift.seconds
    recorded = marks.recorded if marks else []
    observers = Observers(wanted, lift, times, process.u0, ready.bar, callback, recorded)
    run, keeper, finished = walked.run, walked.keeper, False
    try:
        if run is None or keeper is None or observers.need_states:
            keeper = Keeper(wanted.steps, moved.u0)
            prove = lift.prove if plan.reduction else None
            run = move(times, walked.mus, keeper, observers.look, prove)
        if walked.cause and run.done == len(walked.mus):
            run.status, run.cause = Status.INEXACT, walked.cause
        failed = run.status in (Status.INEXACT, Status.SWITCHING) and on_failure == "raise"
        finished = not failed
    finally:
        observers.close(finished)
    if run.overshot is not None:
        warn_of_overshoot(plan.scheme, float(times[run.overshot]))
    kept_steps, kept = keeper.close(run.done)
    if failed:
        u = lift.state(run.done, kept.nodes[-1])
        raise StepError(run.cause, float(times[run.done]), run.done, u, run.relative)
    states, kept_steps = observers.kept(kept, kept_steps)
    thinned = len(kept_steps) < run.done  # else the times are there already
    return Solution(
        process=process,
        plan=plan,
        t=times[np.append(0, kept_steps + 1)] if thinned else times[: run.done + 1],
        steps=kept_steps,
        states=states,
        statistics=run.log.of(times[1 : run.done + 1], beside),
        status=run.status,
        cause=run.cause,
        exact=lift.trajectory(run.exact),
        recorded=None if wanted.function is None else recorded,
        passes=walked.passes,
    )
