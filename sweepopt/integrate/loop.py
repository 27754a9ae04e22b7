"""The only loop over time: a velocity for each stage, a compensated sum for each step.

t_i = t_0 + i mu and u_{i+1} = u_i + mu sum_k b_k z_k (MATH.md section 3).
"""

from __future__ import annotations

import time as clock
from array import array
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
import scipy.sparse as sp
from scipy.linalg import blas

from sweepopt.checks import HUGE
from sweepopt.errors import Status
from sweepopt.integrate.overshoot import longest_safe, overshot
from sweepopt.integrate.record import Run, Summary
from sweepopt.integrate.schemes import Scheme
from sweepopt.integrate.step import (
    INDEFINITE,
    PARTS,
    Parts,
    Stages,
    Velocities,
    combination,
    compensated_sum,
    step,
    step_in_parts,
    summarise,
)
from sweepopt.problem import SweepingProcess
from sweepopt.velocity import Plan

Observer = Callable[[int, np.ndarray, np.ndarray, float], "bool | None"]
"""Sees a step's number, state, velocity and certificate; a true value stops the run."""
FullCertificate = Callable[[int, np.ndarray, np.ndarray, Summary], Summary]
"""What is known of all unknowns from a step's number, first state, velocity and summary."""


class RestartPoint(NamedTuple):
    """u after the steps that are done, and the compensation of its sum."""

    u: np.ndarray
    compensation: np.ndarray


class Restarts(Protocol):
    """Steps after which a run can go on later, to the same result: programs forget all of it."""

    def begin(self, run: Run, start: RestartPoint) -> RestartPoint:
        """Where the run begins: at `start`, or where an earlier one has come."""
        ...

    def after_step(self, run: Run, point: RestartPoint) -> bool:
        """Whether the step that is done is one of them."""
        ...


def integrate(
    process: SweepingProcess,
    plan: Plan,
    times: np.ndarray,
    mus: np.ndarray,
    run: Run,
    observer: Observer | None = None,
    full_certificate: FullCertificate | None = None,
    restarts: Restarts | None = None,
    velocities: Velocities | None = None,
) -> None:
    """Move u along the grid, and write every step into `run`.

    A step that misses the tolerance is taken in parts; one that misses it all the same ends the
    run. Ctrl-C ends it too, also in `observer`: the run has the steps that are done.

    Parameters
    ----------
    velocities : Velocities, optional
        The compiled programs of an earlier run of the same process.
    """
    steps = len(mus)
    starts, sizes = _plain(times), _plain(mus)
    velocities = velocities or Velocities(process, plan)
    safe, limit = longest_safe(process, plan, mus), _largest_state(process, plan.scheme)
    point = RestartPoint(process.u0, np.zeros(process.dim))
    u, compensation = point if restarts is None else restarts.begin(run, point)
    try:
        for i in range(run.done, steps):
            began = clock.perf_counter()
            t, mu = starts[i], sizes[i]
            z, stages = step(process, plan.scheme, velocities, t, mu, u)
            summary, parts = summarise(stages), None
            if summary.relative > plan.tol:
                parts = step_in_parts(process, plan, velocities, t, mu, u, summary)
                z, summary = parts.z, parts.summary
            if full_certificate is not None and not summary.relative > plan.tol:
                summary = full_certificate(i, u, z, summary)
            following, compensation = compensated_sum(u, mu * z, compensation)
            if summary.relative > plan.tol or not blas.dnrm2(following) <= limit:
                run.status, run.relative = Status.INEXACT, summary.relative
                run.cause = _cause(process, i, t, summary, parts, plan.tol)
                return
            if summary.relative != summary.relative:
                run.status = Status.UNCERTIFIED
            if mu > safe and run.overshot is None:
                each = parts.stages if parts else [stages]
                if mu > safe * len(each) and _overshot(process, plan, starts, i, u, each):
                    run.overshot = i
            u = following
            run.add(u, z, summary, clock.perf_counter() - began)
            stop = observer is not None and observer(i, u, z, summary.certificate)
            if restarts is not None and restarts.after_step(run, RestartPoint(u, compensation)):
                velocities.forget()
            if stop:
                run.status = Status.STOPPED if run.done < steps else run.status
                return
    except KeyboardInterrupt:
        run.status = Status.INTERRUPTED


def _plain(numbers: np.ndarray) -> array[float]:
    """Floats of Python, as a list has them, in a quarter of its memory."""
    return array("d", np.ascontiguousarray(numbers, dtype=float).tobytes())


def _largest_state(process: SweepingProcess, scheme: Scheme) -> float:
    """The largest |u|: where B enters explicitly, B u beyond what can be squared is a blow-up."""
    B = process.B
    if B is None or not scheme.explicit:
        return HUGE**2
    entries = B.data if sp.issparse(B) else B.ravel(order="K")
    return 1e-5 * HUGE / max(blas.dnrm2(entries) if entries.size else 0.0, 1.0)


def _overshot(
    process: SweepingProcess,
    plan: Plan,
    times: array[float],
    i: int,
    u: np.ndarray,
    parts: list[Stages],
) -> bool:
    """Whether step i from u, in so many equal parts, may have overshot."""
    inner = np.linspace(times[i], times[i + 1], len(parts) + 1).tolist()
    nodes = [*times[max(i - 2, 0) : i], *inner, *times[i + 2 : i + 3]]
    for k, stages in enumerate(parts, start=min(i, 2)):
        try:
            if overshot(process, plan, nodes, k, u, stages):
                return True
        except Exception:  # C(t) may have no value between the times of the grid
            return False
        u = u + (nodes[k + 1] - nodes[k]) * combination(plan.scheme.b, stages)
    return False


def _cause(
    process: SweepingProcess, i: int, t: float, summary: Summary, parts: Parts | None, tol: float
) -> str:
    """Where and why a step failed, as far as that can be known."""
    where = f"step {i} from t = {t:g}"
    if not summary.relative > tol:
        return (
            f"{where}: the state grows beyond all numbers, which only errors do that a scheme "
            "amplifies; take smaller steps or implicit-euler"
        )
    best = (
        f"the best certificate of {summary.attempts} attempts is {summary.relative:.2g} of the "
        f"velocity's size, tol is {tol:g}"
    )
    tried = f", and to take it in {PARTS[0]} to {PARTS[-1]} parts does not help"
    likely = "The data of this step are scaled too badly for double precision"
    if parts is None or parts.stages:
        tried, likely = "", "A is too badly conditioned to recover all unknowns"
    elif parts.cause:
        tried, likely = "", f"It cannot be taken in parts: {parts.cause}"
    elif summary.solver == INDEFINITE:
        best = "A + gamma B is not positive definite to rounding"
        likely = "B is so large, or its rows cancel so far, that A is lost in the sum"
    elif not process.C.at(t).exact:
        likely = "C(t) is nearly empty, or its projection is not exact enough"
    return f"{where}: {best}{tried}. {likely}; loosen tol, take smaller steps or another solver"
