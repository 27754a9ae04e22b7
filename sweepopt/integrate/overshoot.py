"""Steps that may have gone past the true rest of a body, where mu Lam is above a threshold.

Where B u is far outside of C(t), u should come to rest at the edge of C(t), as exp(-t A^-1 B)
decays. A scheme whose stability function turns negative goes past that point, and friction holds
the body wherever B u is inside C(t) then. implicit-euler never does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from sweepopt.errors import StabilityWarning, warn
from sweepopt.integrate.schemes import Scheme
from sweepopt.integrate.step import Stages, Step, combination
from sweepopt.linalg import UNIT, exceeds_none
from sweepopt.problem import SweepingProcess
from sweepopt.velocity import Plan

RESOLVED = 1e-3  # of how far B u is outside: more rounding of B u hides it, as springs of 1e15 show
FAR = 2.0  # times the way that C(t) goes around the step: a load leaves B u behind by less


def longest_safe(process: SweepingProcess, plan: Plan, mus: np.ndarray) -> float:
    """The step size above which the scheme can overshoot; infinite where none of the steps can.

    Where nothing sticks, or nothing starts outside of C(t) as A = 0, no step is too long.
    """
    limit = plan.scheme.overshoots
    if process.B is None or process.rate_independent or not plan.solvers or math.isinf(limit):
        return math.inf
    if exceeds_none(process.metric, process.B, limit / float(mus.max())):
        return math.inf
    return limit / process.Lam


def overshot(
    process: SweepingProcess, plan: Plan, times: Sequence[float], i: int, u: np.ndarray, step: Step
) -> bool:
    """Whether step i of the grid from u, or one of its parts, may have overshot."""
    before, parts = times[max(i - 2, 0) : i], step.parts
    inside = np.linspace(times[i], times[i + 1], len(parts) + 1).tolist()
    nodes = [*before, *inside, *times[i + 2 : i + 3]]
    try:
        for k, stages in enumerate(parts, len(before)):
            if _went_too_far(process, plan, nodes, k, u, stages):
                return True
            u = u + (nodes[k + 1] - nodes[k]) * combination(plan.scheme.b, stages)
    except Exception:  # C(t) may have no value between the times of the grid
        pass
    return False


def _went_too_far(
    process: SweepingProcess,
    plan: Plan,
    times: Sequence[float],
    i: int,
    u: np.ndarray,
    stages: Stages,
) -> bool:
    """Whether a step from u may have gone past the rest that it should come to.

    Seen from the half-space { w : <-z, w> <= sigma(C(t), -z) } of the first stage's velocity z: the
    force M z + q of that stage is on its edge, and B u is outside of it by <M z, z>. The step has
    gone too far if B u is inside at its end, unless C(t) took it there: a load that grows and then
    stops or turns leaves B u behind by less than twice the way that the edge goes around the step.
    A jump of the load just before it is looked at is not in that way.
    """
    scheme, (start, end) = plan.scheme, times[i : i + 2]
    z, mu = stages[0].z, end - start
    along = process.times_B(z)
    outside = float(z @ (process.A @ z)) + scheme.a[0][0] * mu * float(z @ along)
    gone = mu * float(along @ combination(scheme.b, stages))

    def edge(t: float) -> float:
        return float(process.C.at(t).support(-z))

    at_stage = -float(z @ process.times_B(u)) - outside
    at_end = edge(end) if outside > 0 else math.inf
    if not outside - gone < at_end - at_stage < math.inf:
        return False
    B: Any = process.B
    rounding = UNIT * np.abs(z) @ (abs(B) @ (np.abs(u) + mu * np.abs(z)))
    if not rounding < RESOLVED * outside:
        return False
    after = [end, *(min(end + scheme.c[-1] * (t - end), t) for t in times[i + 2 : i + 3])]
    earlier = [*times[max(i - 2, 0) : i]]
    earlier += [t + scheme.c[0] * (start - t) for t in earlier[-1:]]
    ways = (abs(edge(s) - edge(t)) for side in (after, earlier) for s, t in pairwise(side))
    return outside > FAR * (abs(at_end - at_stage) + sum(ways))


def warn_of_overshoot(scheme: Scheme, t: float) -> None:
    """Tell of a step that decays from outside of C(t) while mu Lam is too large to resolve that."""
    warn(
        f"scheme {scheme.name!r} may have overshot into a wrong stuck state in the step from "
        f"t = {t:g}: B u starts far outside of C(t) there and mu Lam is above "
        f"{scheme.overshoots:.3g}; take smaller steps, or implicit-euler, which never does",
        StabilityWarning,
    )
