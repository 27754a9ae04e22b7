"""The public face of a run: `solve` starts one, `resume` continues one from its checkpoint.

From a process to a solution: options -> grid of times -> plan -> loop over time -> solution. Every
argument is checked before the loop starts.
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from os import PathLike
from typing import Any, Literal

import numpy as np

from sweepopt.checks import Array, meaning, number, with_checks
from sweepopt.errors import (
    AccuracyError,
    InputError,
    SaveError,
    Status,
    StepError,
    SweepoptError,
    SweepoptWarning,
    shown,
)
from sweepopt.integrate import (
    MEMORY,
    Adaptive,
    Callback,
    Checkpoint,
    CheckpointWriter,
    Pass,
    Run,
    SaveFunction,
    SolveOptions,
    States,
    StepInfo,
    StoredRun,
    adapt,
    check_resolution,
    check_stability,
    checkpoint_writer,
    first_grid,
    integrate,
    newest,
    observer,
    progress_bar,
    require_same_problem,
    saving,
    time_grid,
    with_breakpoints,
)
from sweepopt.problem import EvolutionVI, SweepingProcess, sweeping
from sweepopt.results import ErrorBound, Solution, StateFiles
from sweepopt.sets import ConvexSet
from sweepopt.velocity import Plan, compile_projection

LEAST_TOL = 1e-4
"""Share of `error`: if Adaptive meets so small a tolerance and the bound is still above `error`,
shorter steps do not help. Of 15 runs that begin in a layer of 1 / Lam, which no node sees at first,
the one that took the smallest tolerance delivered its error at a share of 0.06."""


@with_checks
@meaning(
    u0="; the problem is stated first: so.solve(so.SweepingProcess(A, B, C, u0), t_end=1.0)",
    T="; give t_end",
    dt="; give steps=round(t_end / dt)",
    h="; give steps=round(t_end / h)",
    t0="; the run starts at t = 0, or at the first time of steps",
    t_span="; the run starts at t = 0: give t_end, or the times themselves as steps",
    t_eval="; give the times as save, they must be among those of steps",
    max_step="; give steps, or steps=so.Adaptive(tol, first=max_step)",
    method="; give scheme",
    rtol="; give tol, of each step's certificate, or error, of the whole run",
    atol="; give tol, of each step's certificate, or error, of the whole run",
)
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
    """Integrate a process and certify every step.

    t_i = t_0 + i h; u_{i+1} = u_i + h sum_k b_k z_k with compensated summation.

    Parameters
    ----------
    process : SweepingProcess or EvolutionVI
    t_end : float
        End of the interval [0, t_end]; may be left out when `steps` is an array.
    steps : int, array_like or Adaptive
        Number of equal steps, or the increasing times themselves (the first one is where u0 holds),
        or ``Adaptive(tol)``: steps chosen for an error of tol at the ends of steps.
    scheme : str
        "auto": sdirk32, in parts where a step contains breakpoints of a load that is data, unless
        they are too many; with Adaptive sdirk2. By name, on the steps as they are: "catching-up",
        "implicit-euler", "midpoint", "trapezoid" (A coercive only), "sdirk2", "sdirk32" (3 programs
        a step, 7 where step * Lam > 2 and much stops; `SweepingProcess.Lam` is the largest
        eigenvalue of A^-1 B); "exact" for polyhedra and loads as data (`Separable`): closed forms
        between switches that are located, in `Solution.exact` also between the nodes.
    solver : str or Solver
        "auto", "clarabel", "osqp", "daqp", "newton", "cvxpy:NAME" for any that cvxpy knows, such as
        "cvxpy:scs", or an object with settings: ``OSQP(tol=1e-10)``.
    tol : float
        Each program's certificate is at most tol * max(|z|_M, |M^-1 q|_M); a step that misses it
        is tried with other solvers, then in 2 to 16 equal parts, then handled as on_failure says.
        The solver of a step in parts is "osqp/4" in `stats`, its certificate the worst of theirs.
    error : float, optional
        Refine the steps where u changes fast until `Solution.error_bound` is at most this; needs a
        load as data. All runs contain the times of `steps` (1000 by default: give few). The last
        one is made once more if a callback or `save` is given; where a run stops early (on_failure,
        Ctrl-C) the callback is not called, and no file is written.
    path : {"auto", "proportional", "eliminated", "return mapping", "cones", "full"}
        Which unknowns enter a step: with "full" all of them; with "eliminated" the few that C(t)
        acts on enter a program and the others two substitutions; with "proportional" (B = rho A
        and a Separable load) the others enter no step at all, at some accuracy near an equilibrium
        (MATH.md section 5). With "return mapping" the unknowns that C(t) acts on, plastic strains
        at many points, follow from the others by a formula; A and B must be diagonal on them. With
        "cones" C(t) = f(t) + E^T S, S balls and E sparse, differences of neighbours or rows of a
        gradient: connected balls at rest, a plug, have one value. "auto" takes proportional, return
        mapping (where these unknowns are more than the others, or very many), cones (intervals from
        300 unknowns on), eliminated or full, the first that applies. Where factors would not fit in
        memory, conjugate gradients take their place on every path.
    save : None, "last", int, array_like, callable, str or Path
        What is kept: all steps, the last one, every k-th, those that end at the given times of the
        grid, what a function of (t, u, z) returns for each step (in `Solution.recorded`), or all
        steps in a NetCDF file "run.nc", and on the disk beside it until the run ends. The last step
        always is kept.
    memory : float
        Bytes that the kept states may take; a run that needs more is refused before it starts.
        Each pass of Adaptive and of `error` keeps all its states.
    progress : bool
        Show a progress bar (needs tqdm), of Adaptive and `error` one for each pass.
    callback : callable, optional
        Called after each step; returning True stops the run and keeps what was computed.
    checkpoint : Checkpoint, str or Path, optional
        A file that the run is written to again and again, so that ``so.resume(path, process)``
        continues it if it is killed, with the same result bit for bit. Not for `error`, Adaptive,
        "exact" or NetCDF. It changes the result by rounding, see `Checkpoint`.
    on_failure : {"raise", "stop"}
        Raise StepError, or return the steps that are certified with status INEXACT.
    on_unstable : {"raise", "warn", "ignore"}
        What catching-up does when step * Lam > 2. Unless it is "ignore", and but for Adaptive and
        `error` with implicit schemes, a run warns of steps of half a period of a Sine or Triangle
        and more, and schemes by name: catching-up between 1 and 2; midpoint and trapezoid where
        they ring
        (step * Lam > 10/3 or A = 0, while C(t) moves); where B u0 is outside of C(0), midpoint and
        trapezoid from 2 on and sdirk2 from 1 + sqrt 2 on, which can overshoot the equilibrium.

    Returns
    -------
    Solution
        Ctrl-C returns the steps computed so far with status INTERRUPTED.

    Raises
    ------
    InputError, EmptySetError, SolverRefusedError
        For bad input, before any solver runs.
    UnstableStepError, StepError
    AccuracyError
        If refining does not reach `error`; the finest run is in it.
    CheckpointError
        If a checkpoint cannot be written; the one before it is whole.
    SaveError
        If a NetCDF file cannot be written; the steps that are done are in it.

    Notes
    -----
    Adaptive steps come from several passes over the run, coarse and cheap ones first: `passes` of
    the Solution has them all. They hit the breakpoints of loads that are data (of a table with more
    than 40 those where it turns) and the times given as `save`. A callback and `save` get the steps
    of the last pass, in one more run.

    Examples
    --------
    A body that sticks until the load 1.5 t reaches the friction bound 1:

    >>> import sweepopt as so
    >>> C = so.Moving(so.Box(-1, 1), center=lambda t: 1.5 * t)
    >>> process = so.SweepingProcess(A=0.5, B=2.0, C=C, u0=0.0)
    >>> sol = so.solve(process, t_end=5.0, steps=200)
    >>> sol.success, float(sol(0.5)[0]), round(float(sol(5.0)[0]), 3)
    (True, 0.0, 3.063)
    """
    options = SolveOptions(
        *(t_end, steps, scheme, solver, tol, path, save, memory, on_failure, on_unstable),
        callback=callback,
        progress=progress,
    )
    process = sweeping(process)
    adaptive = isinstance(steps, Adaptive)
    if error is None and not adaptive:
        return _run(process, options, checkpoint)
    if checkpoint is not None:
        name = "Adaptive" if adaptive else "error="
        raise InputError(f"checkpoint= is for one run, but {name} takes several; give steps")
    if error is None:
        return _adapt(process, options)
    return _refine(process, options, error)


def resume(
    path: str | PathLike[str],
    process: SweepingProcess | EvolutionVI,
    *,
    save: SaveFunction | None = None,
    callback: Callback | None = None,
    progress: bool = False,
) -> Solution:
    """Continue a run from the file that ``solve(..., checkpoint=path)`` wrote.

    The result is that of the run if it had not been stopped, bit for bit, but for the seconds in
    `Solution.stats`. It goes on writing checkpoints. A run that had reached its end is given back.

    Parameters
    ----------
    path : str or Path
    process : SweepingProcess or EvolutionVI
        The same problem as before; it is compared by checksums.
    save : callable, optional
        The function that was given as `save`, if there was one; what it recorded comes back.
        All other arguments of `solve` are in the file.
    callback, progress
        As in `solve`.

    Returns
    -------
    Solution

    Raises
    ------
    InputError
        If there is no checkpoint, or it is one of another problem; the message says what differs.
    CheckpointError
        If both the file and the one before it are damaged.

    Warns
    -----
    CheckpointWarning
        If the file is damaged and the run goes on from the one before it; if versions of packages
        have changed, so that last bits may differ.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> import sweepopt as so
    >>> C = so.Moving(so.Box(-1, 1), center=lambda t: 1.5 * t)
    >>> process = so.SweepingProcess(A=0.5, B=2.0, C=C, u0=0.0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     where = so.Checkpoint(pathlib.Path(folder) / "run.npz", steps=50)
    ...     stop = lambda step: step.step == 120
    ...     sol = so.solve(process, t_end=5.0, steps=200, checkpoint=where, callback=stop)
    ...     whole = so.resume(where.path, process)
    >>> len(sol.t), len(whole.t)
    (122, 201)
    """
    if save is not None and not callable(save):
        raise InputError(f"save must be a function of (t, u, z) or left out, got {shown(save)}")
    stored = newest(Checkpoint(path))
    process = sweeping(process)
    options = SolveOptions.from_json(stored.record["options"])
    times, _ = time_grid(options.t_end, options.steps)
    require_same_problem(stored, process, times)
    if (stored.record["options"]["save"] == {"function": True}) != callable(save):
        need = "needs" if save is None else "had no"
        raise InputError(f"save: the run in {stored.file} {need} function of (t, u, z) as save")
    save = options.save if save is None else save  # what is no function is in the file
    options = replace(options, save=save, callback=callback, progress=progress)
    checkpoint = Checkpoint(path, **stored.record["checkpoint"])
    return _run(process, options, checkpoint, stored)


def _refine(process: SweepingProcess, options: SolveOptions, error: float) -> Solution:
    """The run whose guaranteed error bound is at most `error`.

    Its steps are adaptive, within those that are given, and their tolerance is reduced until the
    bound is met. The first run need not follow each wave of the load, as the bound overlooks none.
    Ctrl-C during a bound returns the run that it is of.
    """
    if isinstance(options.steps, Adaptive):
        raise InputError("error= chooses the steps itself; leave Adaptive out, or error=")
    times, _ = time_grid(options.t_end, options.steps)
    error = number("error", error, minimum=0.0, strict=True)
    saving(options.save, times, process.dim, options.memory)
    scheme = options.tableau(process)
    if scheme.exact:
        raise InputError(
            "error=: scheme 'exact' has no error in time; leave error out (Solution.exact is u at "
            "any time, between the nodes too)"
        )
    # the bound has what an implicit scheme does in long steps; an explicit one may blow up
    unstable = options.on_unstable if scheme.explicit else "ignore"
    run, last_pass = _passes(process, replace(options, on_unstable=unstable))
    # an adaptive pass at least doubles the steps: a run that may be accurate enough is tried before
    tol, cause, times = 2 * error, "", with_breakpoints(process, times)
    sol = run(times, options.tol)
    while sol.success:
        try:
            # one that ended where it needs too short a step is not the whole run
            bound = _guaranteed_bound(sol) if sol.t[-1] == times[-1] else math.inf
        except KeyboardInterrupt:
            return replace(sol, status=Status.INTERRUPTED)
        if bound <= error:
            return last_pass(sol)
        if not cause and (tol < LEAST_TOL * error or (sol.passes[1:] and bound == math.inf)):
            cause = "shorter steps do not help; ask for less"
        if cause:
            raise AccuracyError(
                f"error = {error:g} was asked for, but the bound is {float(bound):.3g} with "
                f"{len(sol.t) - 1} steps: {cause}",
                solution=sol,
            )
        # estimates that miss a first layer are far too low: by the ratio that the bound asks for
        # 135 starts outside of C(0) took 1.8 times as many steps
        if sol.passes[1:] or bound <= tol:
            tol *= 0.5
        sol, cause = adapt(run, process, Adaptive(tol), sol, bound)
    return sol


def _guaranteed_bound(solution: Solution) -> ErrorBound:
    """The bound of a run; refused if it is a sampled one."""
    bound = solution._bound  # without the warning
    if not bound.guaranteed:
        raise InputError(
            f"error= needs a guaranteed bound: {bound.reason}; leave error= out for a sampled one"
        )
    return bound


def _adapt(process: SweepingProcess, options: SolveOptions) -> Solution:
    """Runs on better and better grids, until the estimated error is at most the tolerance."""
    scheme = options.tableau(process)
    times = first_grid(options.steps, process, options.times_to_meet(), scheme)
    saving(options.save, times, process.dim, options.memory)
    # errors are estimated, so no scheme is warned of
    asked = replace(options, scheme=scheme.name, on_unstable="ignore")
    run, last_pass = _passes(process, asked)
    sol, cause = adapt(run, process, options.steps, run(times, math.inf))
    sol = last_pass(sol)
    if not (cause and sol.success):
        return sol
    if options.on_failure == "raise":
        worst = float(sol.stats["relative"].max(initial=0.0))
        t, u, step = float(sol.t[-1]), sol.u[-1], len(sol.stats)
        raise StepError(cause, t=t, step=step, u=u, certificate=worst)
    return replace(sol, status=Status.INEXACT, cause=cause)


def _passes(
    process: SweepingProcess, options: SolveOptions
) -> tuple[Callable[..., Solution], Callable[[Solution], Solution]]:
    """A run as a function of its times and tol, with all states; and what makes the last of them.

    That is made once more if there is a callback, or something else is to be kept. Warnings of the
    process are those of the first run.
    """
    calls = count()

    def run(times: Array, tol: float, save: Any = None, callback: Any = None) -> Solution:
        chosen = replace(options, t_end=None, steps=times, tol=min(tol, options.tol))
        with warnings.catch_warnings():
            if next(calls):
                warnings.simplefilter("ignore", SweepoptWarning)
            try:
                sol = _run(process, replace(chosen, save=save, callback=callback))
            except Exception as failure:
                if save is None and callback is None and not isinstance(failure, SweepoptError):
                    failure.add_note(
                        "Adaptive and error= ask for C(t) at any time. Where C(t) is known at "
                        "multiples of a step only, give these times as steps=, or the load as a "
                        "Table."
                    )
                raise
        seconds = float(sol.stats["seconds"].sum())
        return replace(sol, passes=(Pass(len(sol.stats), math.nan, seconds),))

    def last_pass(sol: Solution) -> Solution:
        if not sol.success or (options.save is None and options.callback is None):
            return sol
        again = run(sol.t, sol.plan.tol, options.save, options.callback)
        return replace(again, passes=sol.passes)

    return run, last_pass


def _run(
    process: SweepingProcess,
    options: SolveOptions,
    checkpoint: Any = None,
    stored: StoredRun | None = None,
) -> Solution:
    """Check what remains to be checked, and run."""
    run = start(process, options)
    with checkpoint_writer(checkpoint, process, run, options, stored) as writer:
        return finish(process, options, run, writer)


def start(process: SweepingProcess, options: SolveOptions) -> Run:
    """The run before its first step; C(t) is checked at all times that are asked for."""
    times, mus = time_grid(options.t_end, options.steps)
    plan = options.plan(process, options.tableau(process), times, mus)
    saved = saving(options.save, times, plan.entering, options.memory)
    outside = process.check_start(float(times[0]), _nearest(process, plan) if plan.cones else None)
    process.check_jumps(float(times[0]), float(times[-1]))
    if options.on_unstable != "ignore":
        check_stability(process, plan, float(mus.max()), outside, options.on_unstable)
        check_resolution(process, plan, times)
    return Run(times, mus, plan, saved, plan.process_of(process).u0)


def finish(
    process: SweepingProcess,
    options: SolveOptions,
    run: Run,
    writer: CheckpointWriter | None = None,
) -> Solution:
    """Take the steps of a run, and make a solution of it."""
    saved = run.saving
    files = StateFiles(saved.path, process.u0) if saved.path else None
    watchers: list[Callable[[StepInfo], Any]] = [files.put] if files else []
    if (record := saved.function) is not None:
        watchers.append(lambda step: run.recorded.append(record(step.t, step.u, step.velocity)))
    if options.callback is not None:
        watchers.append(options.callback)
    succeeded = False
    try:
        if writer:
            writer.begin(run)  # from where a stored one is
        with progress_bar(options.progress, run) as advance:
            observe = observer(advance, watchers, run) if advance or watchers else None
            integrate(process, run, observe, writer)
            failed = run.status in (Status.INEXACT, Status.SWITCHING)
            succeeded = not failed or options.on_failure == "stop"
    finally:
        solution = _solution(process, run, files)
        if files:
            files.close(solution, succeeded)
    if not succeeded:
        t, u = float(run.times[run.done]), run.plan.state(run.u)
        raise StepError(run.cause, t=t, step=run.done, u=u, certificate=run.relative)
    if files and files.failure:
        raise SaveError(
            f"save: {saved.path} cannot be written ({files.failure}), the run "
            f"ended after {run.done} steps; `solution` of this error has their states. Free the "
            "disk, name another file, or keep fewer steps in memory, save=k",
            solution=solution,
        )
    return solution


def _nearest(process: SweepingProcess, plan: Plan) -> Callable[[Array, ConvexSet], Array]:
    """The projection in the metric of A^-1 by the plan's solver, where the set has no fast one."""
    M = process.metric
    velocity = compile_projection(plan, M)
    return lambda w, C: w + M.M @ velocity(w, C).z


def _solution(process: SweepingProcess, run: Run, files: StateFiles | None) -> Solution:
    """The states of all unknowns where they are, and what is known of the run."""
    plan, (steps, u, velocity) = run.plan, run.states()
    states = States(steps, lambda i: plan.state(u(i)), lambda i: plan.velocity(velocity(i)))
    if files:
        states = files.states()
    return Solution(
        process=process,
        plan=plan,
        t=run.times[np.append(0, states.steps + 1)],
        states=states,
        statistics=run.statistics(),
        status=run.status,
        cause=f"{run.divided()} {run.cause}".strip(),
        trajectory=run.exact,
        recorded=None if run.saving.function is None else run.recorded,
    )
