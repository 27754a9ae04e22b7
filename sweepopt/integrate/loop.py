"""The only loop over time: one velocity a stage, one compensated sum a step."""

from __future__ import annotations

import time as clock
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
import scipy.sparse as sp
from scipy.linalg import blas

from sweepopt.checks import HUGE
from sweepopt.errors import Status
from sweepopt.integrate.overshoot import longest_safe, overshot
from sweepopt.integrate.schemes import Scheme
from sweepopt.integrate.states import Keeper
from sweepopt.integrate.statistics import Log
from sweepopt.integrate.step import (
    INDEFINITE,
    PARTS,
    Parts,
    Stages,
    Summary,
    Velocities,
    combined,
    compensated,
    in_parts,
    step,
    summary,
)
from sweepopt.problem import SweepingProcess
from sweepopt.velocity import Plan

if TYPE_CHECKING:
    from sweepopt.integrate.exact import Trajectory


Look = Callable[[int, np.ndarray, np.ndarray, float], "bool | None"]
Prove = Callable[[int, np.ndarray, np.ndarray, "Summary"], "Summary"]


class Place(NamedTuple):
    """Where a run is: u after the steps that are done, and what rounding kept out of it."""

    u: np.ndarray
    lost: np.ndarray


class Marks(Protocol):
    """Steps after which a run can be continued: what the programs remember ends there."""

    def begin(self, run: Run, keeper: Keeper, start: Place) -> Place:
        """Where the run begins: at `start`, or where an earlier one has come."""
        ...

    def __call__(self, run: Run, keeper: Keeper, place: Place) -> bool:
        """Whether the step that is done is a mark."""
        ...


def march(
    process: SweepingProcess,
    plan: Plan,
    times: np.ndarray,
    mus: np.ndarray,
    keeper: Keeper,
    look: Look | None = None,
    prove: Prove | None = None,
    velocities: Velocities | None = None,
    marks: Marks | None = None,
) -> Run:
    """Move u through time; `look` sees every state, velocity and certificate, True from it stops.

    A step that misses tol is taken in parts. `prove` adds to a step's certificate, from its number,
    its first state and its velocity.
    `velocities` are the compiled programs of an earlier run of the same process; at `marks` they
    forget all steps, so that a run which is continued there is the same to the last bit.
    Ctrl-C ends the loop, also in `look`: the keeper has the steps that are done.
    """
    steps = len(mus)
    grid, sizes = _plain(times), _plain(mus)
    velocities = velocities or Velocities(process, plan)
    safe, limit = longest_safe(process, plan, mus), _limit(process, plan.scheme)
    run = Run(Log(steps))
    place = Place(process.u0, np.zeros(process.dim))
    u, lost = place if marks is None else marks.begin(run, keeper, place)
    try:
        for i in range(run.done, steps):
            started = clock.perf_counter()
            mu = sizes[i]
            z, stages = step(process, plan.scheme, velocities, grid[i], mu, u)
            found, parts = summary(stages), None
            if found.relative > plan.tol:
                parts = in_parts(process, plan, velocities, grid[i], mu, u, found)
                z, found = parts.z, parts.found
            if prove is not None and not found.relative > plan.tol:
                found = prove(i, u, z, found)
            following, lost = compensated(u, mu * z, lost)
            if found.relative > plan.tol or not blas.dnrm2(following) <= limit:
                run.cause = _cause(process, i, grid[i], found, parts, plan.tol)
                run.status, run.relative = Status.INEXACT, found.relative
                break
            if found.relative != found.relative:
                run.status = Status.UNCERTIFIED
            if mu > safe and run.overshot is None:
                each = parts.stages if parts else [stages]
                if mu > safe * len(each) and _overshot(process, plan, grid, i, u, each):
                    run.overshot = i
            u = following
            keeper.put(i, u, z)
            run.log.add(i, found, clock.perf_counter() - started)
            run.done = i + 1
            stop = look is not None and look(i, u, z, found.certificate)
            if marks is not None and marks(run, keeper, Place(u, lost)):
                velocities.forget()
            if stop:
                run.status = Status.STOPPED if run.done < steps else run.status
                break
    except KeyboardInterrupt:
        run.status = Status.INTERRUPTED
    return run


@dataclass
class Run:
    """How a run ended, the first step that may have overshot, the dense exact trajectory."""

    log: Log
    done: int = 0
    status: Status = Status.SUCCESS
    cause: str = ""
    relative: float = 0.0
    overshot: int | None = None
    exact: Trajectory | None = None


def _plain(numbers: np.ndarray) -> array[float]:
    """Floats of Python, as a list has them, in a quarter of its memory."""
    return array("d", np.ascontiguousarray(numbers, dtype=float).tobytes())


def _limit(process: SweepingProcess, scheme: Scheme) -> float:
    """The largest |u|: where B enters explicitly, B u beyond what can be squared is a blow-up."""
    B = process.B
    if B is None or not scheme.explicit:
        return HUGE**2
    entries = B.data if sp.issparse(B) else B.ravel(order="K")
    return 1e-5 * HUGE / max(blas.dnrm2(entries) if entries.size else 0.0, 1.0)


def _overshot(
    process: SweepingProcess,
    plan: Plan,
    grid: array[float],
    i: int,
    u: np.ndarray,
    parts: list[Stages],
) -> bool:
    """Whether step i from u, in so many equal parts, may have overshot."""
    inner = np.linspace(grid[i], grid[i + 1], len(parts) + 1).tolist()
    nodes = [*grid[max(i - 2, 0) : i], *inner, *grid[i + 2 : i + 3]]
    for k, stages in enumerate(parts, start=min(i, 2)):
        try:
            if overshot(process, plan, nodes, k, u, stages):
                return True
        except Exception:  # these C(t) nobody asked for
            return False
        u = u + (nodes[k + 1] - nodes[k]) * combined(plan.scheme.b, stages)
    return False


def _cause(
    process: SweepingProcess, i: int, t: float, found: Summary, parts: Parts | None, tol: float
) -> str:
    """Where and why a step failed, as far as that can be told."""
    where = f"step {i} from t = {t:g}"
    if not found.relative > tol:
        return (
            f"{where}: the state grows beyond all numbers, which only errors do that a scheme "
            "amplifies; take smaller steps or implicit-euler"
        )
    best = (
        f"the best certificate of {found.attempts} attempts is {found.relative:.2g} of the "
        f"velocity's size, tol is {tol:g}"
    )
    tried = f", and to take it in {PARTS[0]} to {PARTS[-1]} parts does not help"
    likely = "The data of this step are scaled too badly for double precision"
    if parts is None or parts.stages:
        tried, likely = "", "A is too badly conditioned to recover all unknowns"
    elif parts.cause:
        tried, likely = "", f"It cannot be taken in parts: {parts.cause}"
    elif found.solver == INDEFINITE:
        best = "A + gamma B is not positive definite to rounding"
        likely = "B is so large, or its rows cancel so far, that A is lost in the sum"
    elif not process.C.at(t).exact:
        likely = "C(t) is nearly empty, or its projection is not exact enough"
    return f"{where}: {best}{tried}. {likely}; loosen tol, take smaller steps or another solver"
