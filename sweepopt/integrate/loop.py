"""The only loop over time: a velocity for each stage, a compensated sum for each step; who sees it.

t_i = t_0 + i mu and u_{i+1} = u_i + mu sum_k b_k z_k (MATH.md section 3).
"""

import time as clock
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from scipy.linalg import blas

from sweepopt.checks import HUGE, Array
from sweepopt.errors import InputError, Status, note, result_of, shown
from sweepopt.integrate.exact import exact_steps
from sweepopt.integrate.grid import by_steps
from sweepopt.integrate.record import Run, Step, StepInfo
from sweepopt.integrate.schemes import Scheme
from sweepopt.integrate.step import (
    INDEFINITE,
    Velocities,
    compensated_sum,
)
from sweepopt.problem import SweepingProcess
from sweepopt.sets import ROUNDING
from sweepopt.velocity import Plan, Velocity

Observer = Callable[[int, Array, Array, float], "bool | None"]
"""Sees a step's number, state, velocity and certificate; a true value stops the run."""
Restarts = Callable[[Run], bool]
"""Whether programs shall forget the steps so far, as those of a run that goes on from there do."""


def integrate(
    process: SweepingProcess,
    run: Run,
    observer: Observer | None = None,
    restarts: Restarts | None = None,
) -> None:
    """Move u along the grid of `run` from where it is, and write every step into it.

    A step with breakpoints of the plan in it, or that misses the tolerance, is taken in parts; one
    that misses it all the same ends the run. Ctrl-C ends it too, also in `observer`: the run has
    the steps that are done.
    """
    plan, steps = run.plan, run.steps
    process = plan.process_of(process)
    starts, sizes = run.times.data, run.mus.data  # these give floats of Python
    velocities = Velocities(process, plan)
    take = exact_steps(process, run) if plan.scheme.exact else velocities.step
    within = by_steps(plan.breakpoints, run.times)
    limit = _largest_state(process, plan.scheme)
    u, compensation = run.u, run.compensation
    try:
        for i in range(run.done, steps):
            began = clock.perf_counter()
            mu = sizes[i]
            result = take(starts[i], mu, u, *within.get(i, ()))
            if result is None:
                return
            velocity = result.velocity
            if result.end is None:
                following, compensation = compensated_sum(u, mu * velocity.z, compensation)
            else:
                following = result.end
            if velocity.relative > plan.tol or not blas.dnrm2(following) <= limit:
                run.status, run.relative = Status.INEXACT, velocity.relative
                run.cause = f"step {i} from t = {starts[i]:g}: " + _cause(
                    process, plan, starts[i], velocity, result
                )
                return
            if velocity.relative != velocity.relative:
                run.status = Status.UNCERTIFIED
            u = following
            run.add(u, velocity, clock.perf_counter() - began, compensation)
            stop = observer is not None and observer(i, u, velocity.z, velocity.certificate)
            if restarts is not None and restarts(run):
                velocities.forget()
            if stop:
                run.status = Status.STOPPED if run.done < steps else run.status
                return
    except KeyboardInterrupt:
        run.status = Status.INTERRUPTED
    except Exception as error:
        note(error, f"This was raised in step {i}, from t = {starts[i]:g}.")
        raise


def _largest_state(process: SweepingProcess, scheme: Scheme) -> float:
    """The largest |u|: where B enters explicitly, B u beyond what can be squared is a blow-up."""
    if process.B is None or not scheme.explicit:
        return HUGE**2
    return HUGE / 1e10 / max(float(abs(process.B).max()), 1.0)


def _cause(process: SweepingProcess, plan: Plan, t: float, velocity: Velocity, result: Step) -> str:
    """Why a step failed, as far as that can be known."""
    missed = f"{velocity.relative:.2g} of the velocity's size"
    likely = (
        "The data of this step are scaled too badly for double precision, or A and B have a common "
        "null vector, as where nothing holds a body"
    )
    if plan.tol < ROUNDING:
        likely = "tol is below the rounding of double precision"
    if plan.scheme.exact:
        return (
            f"the closed form misses the inclusion by {missed}, tol is {plan.tol:g}. "
            f"{likely}; loosen tol or use implicit-euler or sdirk2"
        )
    if not velocity.relative > plan.tol:
        return (
            "the state grows beyond all numbers, which only errors do that a scheme amplifies; "
            "take smaller steps or implicit-euler"
        )
    of = f" of {velocity.attempts} attempts" if velocity.attempts else ""
    best = f"the best certificate{of} is {missed}, tol is {plan.tol:g}"
    if velocity.relative == np.inf:
        best = f"none{of} has an answer with a finite certificate"
    tried = ", and to take it in parts does not help"
    if result.cause:
        tried, likely = "", f"It cannot be taken in parts: {result.cause}"
    elif velocity.solver == INDEFINITE:
        best = "A + gamma B is not positive definite to rounding"
        likely = "B is so large, or cancels so far, that A is lost in it, or nothing holds a body"
    elif not process.C.at(t).exact:
        likely = "C(t) is nearly empty, or its projection is not exact enough"
    return f"{best}{tried}. {likely}; loosen tol, take smaller steps or another solver"


@contextmanager
def progress_bar(visible: bool, run: Run) -> Iterator[Callable[[], Any] | None]:
    """What moves a bar by a step; None where it shall not be seen, or phases move it."""
    if not visible:
        yield None
        return
    from tqdm.auto import tqdm

    exact = run.plan.scheme.exact
    with tqdm(total=run.steps, initial=run.done, unit="step", unit_scale=exact) as bar:
        if exact:
            run.advance = lambda done: bar.update(done - bar.n)
        yield None if exact else bar.update


def observer(
    advance: Callable[[], Any] | None,
    watchers: Sequence[Callable[[StepInfo], Any]],
    run: Run,
) -> Observer:
    """What the loop calls after each step: a bar, then the watchers, who see all unknowns.

    A watcher that answers with a true value stops the run.
    """

    def observe(i: int, u: Array, z: Array, certificate: float) -> bool:
        if advance is not None:
            advance()
        if not watchers:
            return False
        u, z = run.plan.state(u).copy(), run.plan.velocity(z).copy()
        step = StepInfo(i, float(run.times[i + 1]), u, z, certificate)
        for watcher in watchers:
            answer = result_of(watcher, step, f"callback or save, at t = {step.t:g}")
            try:
                if isinstance(answer, str):
                    raise TypeError
                if answer:
                    return True
            except (TypeError, ValueError):
                raise InputError(
                    "callback must return True to stop the run, or nothing; got " + shown(answer)
                ) from None
        return False

    return observe
