"""When: the grid of times, where a scheme looks at C(t), and which steps it may take."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sweepopt.checks import (
    TIME_SLACK,
    Array,
    axes,
    increasing,
    meaning,
    number,
    step_count,
    times_inside,
)
from sweepopt.errors import InputError, StabilityWarning, UnstableStepError, shown, warn
from sweepopt.integrate.schemes import Scheme, rings
from sweepopt.linalg import EPS
from sweepopt.loads import Constant, History, Sine, Slope, Triangle, breakpoints
from sweepopt.problem import SweepingProcess, histories_of, motion
from sweepopt.velocity import Plan

LARGEST_CONTRACTION = 0.8
"""By no more than this: a fixed point has ten digits after 100 iterations then."""
RINGING = 0.25
"""A larger share of an error that comes back lasts for steps: sdirk2's is 0.21 at most."""
PER_PIECE = 3
"""Steps between breakpoints and in half a period, at least: for second differences."""


@meaning(
    rtol="; give tol, the error itself in the units of |u|_A",
    atol="; give tol, the error in the units of |u|_A",
    max_step="; give first, the longest step",
)
@dataclass(frozen=True)
class Adaptive:
    """Steps that are chosen such that max_i |u_i - u(t_i)|_A is at most tol (|.|_B where A = 0).

    Parameters
    ----------
    tol : float
        The global error at the ends of steps, in the units of |u|_A. It is estimated, not proved;
        within steps, where u is linear, errors can be larger.
    first : float, optional
        Longest step, t_end / 16 by default, t_end / 32 where the load is a function. An event of
        such a load that is shorter than the steps can pass unseen: make `first` as short as it.
    minimum : float, optional
        Shortest step, t_end 2^-40 by default.

    Raises
    ------
    InputError
        If a number is not positive, or minimum is longer than first.

    Notes
    -----
    C(t) is asked for at any time. Where a function knows it only at multiples of a step, give these
    times as `steps` of `solve` with a scheme that looks at no others, such as implicit-euler, or
    give the load as a Table.

    Examples
    --------
    >>> import sweepopt as so
    >>> C = so.Moving(so.Box(-1, 1), center=lambda t: 1.5 * t)
    >>> process = so.SweepingProcess(A=0.5, B=2.0, C=C, u0=0.0)
    >>> sol = so.solve(process, t_end=5.0, steps=so.Adaptive(1e-4))
    >>> sol.passes[-1].error < 1e-4, round(float(sol(5.0)[0]), 3)
    (True, 3.063)
    """

    tol: float
    first: float | None = None
    minimum: float | None = None

    def __post_init__(self) -> None:
        for name in ("tol", "first", "minimum"):
            value = getattr(self, name)
            if value is not None or name == "tol":
                object.__setattr__(self, name, number(name, value, 0.0, strict=True))
        if self.first is not None and self.minimum is not None and self.minimum > self.first:
            raise InputError(f"minimum, {self.minimum:g}, is longer than first, {self.first:g}")


def time_grid(t_end: float | None, steps: Any) -> tuple[Array, Array]:
    """The times, t_0 + i mu or the user's own, and the step sizes.

    Steps that differ by the rounding of the times only get one size: they share a program.
    """
    if axes(t_end):
        raise InputError(
            f"t_end must be one number, the end of [0, t_end], got {shown(t_end)}; give the times "
            "themselves as steps to start elsewhere"
        )
    end = None if t_end is None else number("t_end", t_end, minimum=0.0, strict=True)
    if axes(steps) == 0:
        try:
            n = step_count(steps)
        except InputError as error:
            if isinstance(steps, int):
                raise
            raise InputError(
                f"{error}; for steps of length dt give round(t_end / dt), or the times "
                "themselves, or so.Adaptive(tol)"
            ) from None
        if end is None:
            raise InputError("t_end is missing; give it or pass the times as steps")
        return np.append(np.arange(n) * (end / n), end), np.full(n, end / n)
    times = increasing("steps", steps)
    if end is not None and abs(times[-1] - end) > TIME_SLACK * abs(times[-1]):
        raise InputError(
            f"steps end at {times[-1]:g}, but t_end is {end:g}; leave t_end out, or end them at "
            f"{end:g}"
        )
    mus = np.diff(times)
    order, rounding = np.argsort(mus), 4 * EPS * np.abs(times).max()
    group = np.zeros(len(mus), dtype=int)
    group[order[1:]] = np.cumsum(np.diff(mus[order]) > rounding)
    mean = (np.bincount(group, weights=mus) / np.bincount(group))[group]
    # neighbours by rounding may drift apart in a long chain: then each keeps its own
    return times, np.where(np.abs(mean - mus) <= 2 * rounding, mean, mus)


def divided(times: Array, parts: Any) -> Array:
    """The grid with each step cut into equal parts, of each step its number."""
    inside = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    begin, length = (np.repeat(x, parts) for x in (times[:-1], np.diff(times) / parts))
    return np.append(begin + inside * length, times[-1])


def breakpoints_to_meet(histories: Iterable[Any], a: float, b: float) -> Array:
    """Those that steps shall meet, increasing: of more than 40 of a table only where it turns.

    A sine in a table of 3,000 points took 18,006 adaptive steps with all of them, and 499 so
    (tol = 1e-2); in one of 30 points 236, and 536 so.
    """
    points = []
    for history in histories:
        points.append(breakpoints([history], a, b))
        if len(points[-1]) > 40 and isinstance(history, History):
            points[-1] = history.turning_points(a, b)
    return np.unique(np.concatenate([np.empty(0), *points]))


def meeting_breakpoints(
    process: SweepingProcess, plan: Plan, times: Array, histories: Iterable[Any]
) -> Plan:
    """The plan for these times with the histories' breakpoints in steps, if they are not too many.

    One at a node up to rounding is in no step. C(t) is checked at the others, too.

    With one in two steps, on average, a run takes 3.4 times as long (200 boxes, 200 steps). Of 500
    unknowns on a new matrix takes as long as 13 steps (992 of them) to 30 (10,100): of those one in
    ten steps is the most, as with 0.2 a finer grid of as long a run had the smaller error.
    """
    points = breakpoints_to_meet(histories, times[0], times[-1])
    points = np.setdiff1d(times_inside(points, times), times)
    points = points[np.diff(points, prepend=-np.inf) > TIME_SLACK * np.abs(times).max()]
    large = plan.entering > 500 and process.B is not None
    most = int((0.1 if large else 0.5) * (len(times) - 1))
    if points.size > most:
        reason = f"breakpoints of the load: {points.size} inside of steps, over {most} are not met"
        return replace(plan, left_out=(*plan.left_out, reason))
    if points.size:
        process.C.members(points)
    return replace(plan, breakpoints=points)


def by_steps(points: Array, times: Array) -> dict[int, list[float]]:
    """The points in each step that has some."""
    steps: dict[int, list[float]] = {}
    for step, point in zip(np.searchsorted(times, points) - 1, points, strict=True):
        steps.setdefault(int(step), []).append(float(point))
    return steps


def evaluation_times(times: Array, mus: Array, scheme: Scheme) -> Array:
    """Where C(t) is asked for or shall be checked: the nodes, and the stages of every step."""
    stages = times[:-1, None] + mus[:, None] * np.array(scheme.times)
    return np.unique(np.append(times, np.minimum(stages, times[1:, None])))


def shortest_period(process: SweepingProcess) -> float:
    """That of the waves, or their slopes, that C(t) moves with as data; infinite without any."""
    histories = (one.history if isinstance(one, Slope) else one for one in histories_of(process.C))
    waves = (one for one in histories if isinstance(one, (Sine, Triangle)) and one.amplitude)
    return min((wave.period for wave in waves), default=math.inf)


def check_resolution(process: SweepingProcess, plan: Plan, times: Array) -> None:
    """Whether steps are so long that all of them may see a wave of the load at the same phase.

    A part of a step that ends at a breakpoint counts as a step.
    """
    period = shortest_period(process)
    longest = float(np.diff(np.union1d(times, plan.breakpoints)).max())
    if plan.scheme.exact or longest < (1 - TIME_SLACK) * period / 2:
        return
    enough = math.ceil((times[-1] - times[0]) / period * 2 * PER_PIECE * (1 - TIME_SLACK))
    warn(
        f"the load has a period of {period:g}, but steps are up to {longest:g} long: with two in a "
        f"period or fewer its waves can pass unseen. Take {2 * PER_PIECE} steps in each period at "
        f"least, which are steps={enough} if they are equal, or steps=so.Adaptive(tol)",
        StabilityWarning,
    )


def check_stability(
    process: SweepingProcess, plan: Plan, mu: float, outside: bool, on_unstable: str
) -> None:
    """What the longest step does to errors, from the stability function R at -step * Lam.

    A scheme that is explicit in u amplifies them where R < -1, and overshoots where R < 0. An
    implicit one overshoots where R < 0 if B u starts outside of C(t), and rings while C(t) moves
    where R < -RINGING; nothing of it stays where nothing sticks, or where Euler steps step in.
    """
    scheme = plan.scheme
    if scheme.explicit:
        _check_explicit(process, scheme, mu, on_unstable)
        return
    moves = any(not isinstance(phi, Constant) for phi in motion(process.C).histories)
    if scheme.euler_steps or not plan.solvers or not (outside or moves):
        return
    if rings(process, scheme, mu, 0.0 if outside else RINGING):
        rate = f"step * Lam = {mu * process.Lam:.3g}" if process.coercive else "A is singular"
        effect = "can overshoot into a wrong stuck state" if outside else "rings"
        warn(
            f"scheme {scheme.name!r} {effect}: {rate}, and from 2 on its errors change "
            "their sign in each step, so that bodies stick that should slip; take scheme='auto' "
            "or implicit-euler, or shorter steps",
            StabilityWarning,
        )


def contraction(process: SweepingProcess, scheme: Scheme, mu: float) -> float:
    """The largest of the stages of the longest step; refused above LARGEST_CONTRACTION.

    Raises
    ------
    UnstableStepError
        Naming steps that are short enough, if there are any.
    """
    gamma = mu * max(row[-1] for row in scheme.a)
    theta = process.contraction(gamma)
    if theta <= LARGEST_CONTRACTION:
        return theta
    # 2^-50 of a step is less than the times are rounded by
    halves = (k for k in range(1, 50) if process.contraction(gamma / 2**k) <= LARGEST_CONTRACTION)
    remedy = next(
        (f"take steps of at most {mu / 2**k:.3g}" for k in halves),
        "no shorter step helps, as B u alone does not hold against it and a body without viscosity "
        "jumps: give viscosity, a stiffer body, or a C(t, u) that changes less with u",
    )
    raise UnstableStepError(
        f"C(t, u) changes so much with the state that fixed-point iteration converges slowly or "
        f"not at all: its contraction is {theta:.3g}, not below {LARGEST_CONTRACTION:g}; {remedy}"
    )


def _check_explicit(process: SweepingProcess, scheme: Scheme, mu: float, on_unstable: str) -> None:
    """Explicit in u means step * Lam <= 2, and no overshoot only for step * Lam <= 1.

    What C(t, u) adds to the rate of change with u counts as B does.
    """
    number_ = mu * (process.Lam + process.state_rate)
    if number_ <= 1:
        return
    shorter = "take" if math.isinf(number_) else f"take steps <= {mu / number_:.3g}, or"
    remedy = (
        f"step * Lam = {number_:.3g}; {shorter} implicit-euler, which needs no such step and never "
        "overshoots"
    )
    if number_ > 2 and on_unstable == "raise":
        raise UnstableStepError(
            f"scheme {scheme.name!r} amplifies errors: {remedy}, or say on_unstable='warn'"
        )
    effect = "amplifies errors" if number_ > 2 else "can overshoot into a wrong stuck state"
    warn(f"scheme {scheme.name!r} {effect}: {remedy}", StabilityWarning)
