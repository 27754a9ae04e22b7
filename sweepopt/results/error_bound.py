"""A guaranteed bound of the error of a whole trajectory, without unknown constants (MATH 4).

Let v be a Lipschitz function, w(t) any selection in C(t), and

    r = A v' + B v - w,      G = sigma(C(t), -v') + <v', w>  >= 0.

Then for e = u - v, as monotonicity of the normal cone gives <e', A e' + B e + r> <= G:

    |e(t)|_A <= K(t) (|e(0)|_A + int sqrt(2 G + |r|^2))                (growth of differences),
    |e(t)|_A <= |e(0)|_A + sqrt(t (|e(0)|_B^2 + int 2 G + |r|^2))      (energy),

where |r| is the norm of A^-1.

Let further r = r_1 + r_2, r_2 of bounded variation. With <e', r_1> >= -|e'|_A^2 - |r_1|^2 / 4 and
int <e', r_2> = <e, r_2> - int <e, dr_2> that inequality gives for e(0) = 0

    |e(t)|_B <= y = R + sqrt(R^2 - V^2 + S),    int |e'|_A^2 <= int 2 G + |r_1|^2 + 2 y R,
    S = int 2 G + |r_1|^2 / 2,    V = var(r_2),    R = V + sup |r_2|    (| | of B^-1 for r_2),

as g = |e|_B - sup |r_2| has g(t)^2 <= S + (R - V)^2 + 2 int (g + R - V) |dr_2| (Ou-Iang's lemma),
and |e|_A <= |e|_B / sqrt(lam). As R contains no A^-1 this bound is as good for stiff bodies as for
soft ones, and holds for A = 0 with r_1 = 0. On the steps where it makes y smaller r_2 is r, which
then jumps to 0 at their ends; on the others r_2 = 0.
K(tau) = min(exp(nu tau), 1 + sqrt(Lam tau / 2)), nu = (Lam - lam)^2 / (8 (Lam + lam)), with
lam <= Lam the extreme eigenvalues of A^-1 B.

v is a curve through the nodes of a second run: on each step a line or one of two cubics, whichever
gives the smallest bound. The second run has the trapezoidal rule, or BDF2 where all of the body is
stiff (step * lam > 10, or A = 0): errors fade within a step there. Where one curve is tried, along
which r is of order one, that is implicit Euler: hulls of points had bounds up to twice as loose
with BDF2. All have one program a step, as the first stage of the trapezoidal rule is the last one
of the step before, and that of BDF2 its mean; how close the bound is depends on the length of the
steps in which bodies stick or slip, so that sdirk2 with two programs was up to 5 times as loose for
the same work. The grid is refined where most of the bound of |u - v| arises, which is around the
switches, and the run is repeated, until that bound is at most COMPANION_SHARE of |v - u_n| or no
finer grid pays (`_more`).
w(t) = center(t) + scale(t) s(t), where s is a curve in S through projections of
A v' + B v - beta v', less the center, or, where projections iterate, through those points of S
with which the programs of the second run ended. beta is that of |x|_A^2 >= beta |x|^2, as
w = P_C(A v' + B v - beta v') makes 2 G + |r|^2 / beta least; 0 where A is singular. Errors of the
solver in the second run thus are part of r and G. Both are bounded on the whole of each step: G by
the convexity of sigma, r as a polynomial plus the interpolation error of histories (`residuals`);
w and G of sets that operations make of sets with data of their own are in `separate`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from sweepopt.checks import TIME_SLACK, Array, times_inside
from sweepopt.errors import PathError, Status
from sweepopt.integrate import (
    MEMORY,
    SCHEMES,
    Run,
    Velocities,
    combination,
    compensated_sum,
    divided,
    integrate,
    saving,
    stiffly_accurate,
    time_grid,
)
from sweepopt.linalg import EPS
from sweepopt.loads import breakpoints
from sweepopt.problem import ONE, Norms, SweepingProcess, histories_of, motion
from sweepopt.results.interpolation import CURVES, Nodes, cubic, slopes_of_curves
from sweepopt.results.residuals import CHUNK, Residuals, projects_at_once, residuals, unknown
from sweepopt.results.separate import moves_straight
from sweepopt.velocity import Plan, Velocity

SUM_ROUNDING = 64 * EPS  # bound of the rounding of u_n, relative to |u|_A sqrt(number of steps)
TOL = 1e-8  # of the second run's programs: 1e-9 takes 3 times as long where diag(A) is uneven
COMPANION_SHARE = 1 / 3
"""The second run is not repeated if the bound of |u - v| is at most this share of |v - u_n|.

The bound of the error, |u - v| + |v - u_n|, is then at most (1 + 1/3) / (1 - 1/3) = 2 times the
error."""
STIFF = 10
"""If step * lam is larger, the second run takes BDF2, else the trapezoidal rule, which at 10 leaves
2/3 of an error after a step, with the other sign, and beyond it more. With BDF2 for all, bounds of
soft bodies were up to 5 times as loose; with implicit Euler that of a disc that follows a tractrix
at A = 0 was 95 times the error on 1,600 steps (now 1.7)."""
BDF2 = stiffly_accurate("bdf2", (0.0,), (1 / 3, 2 / 3), order=2)
"""Its first stage is the mean velocity of the step before: second order where steps are equal."""
WORK = (8, 5, 4, 3)
"""Steps, of one program each, that all second runs together may have for each program of the run:
for up to SMALL unknowns with exact projections, for others, and for sets that move separately by
straight and by curved data. With 5 and 4 these took up to 13 and 16 times as long as the run, as
each step has one or two supports, and with curved data a projection. One takes 0.5 to 0.9 of the
time of a program of the run: 8 make bounds cost less than 10 runs. With 8 in place of 9 they were
1.02 times as loose (geometric mean of 45 runs, at most 1.29), with 8 in place of 10 up to 1.5 times
on seven uneven stiff bodies. 5 is what sdirk2 had for large bodies. For more than SMALL unknowns
steps at rest do not count, as one takes a fiftieth of the time of another; for fewer they do:
without them bounds were up to 1.5 times as loose. With sets that move separately they do not: one
that moved in 3 of 40 steps had a bound of 16 runs, not 2."""
SMALL, LARGE = 50, 1000
"""Unknowns. With 14 programs, which small bodies once had, bounds took 13 times as long as the run
for 120 unknowns, 11 for 72 and 10 for 7. Of more than LARGE one curve v is tried."""
MOST_REFINEMENT = 5
"""A grid has at most so many times as many steps more than the one before: where the second run has
the scheme of the run, |v - u_n| on the first grid tells nothing of the error, and all of WORK would
be spent. With 3 (7) bounds were up to 1.5 times as loose (took 1.2 times as long) on 120 rows."""
LEAST_ORDER, LEAST_REFINEMENT = 0.5, 0.25
"""A bound that falls with a smaller order than that, as that of noise, is not worth a finer grid,
nor is one of which a grid with less than a quarter of the steps more would be enough: with 0 in its
place that of the scene chain takes 17 times as long as the run, not 8, and is 1.1 times as
close."""


class ErrorBound(float):
    """A bound of sup_t |u(t) - u_n(t)|_A (|.|_B if A may be singular), a number that knows more.

    Attributes
    ----------
    reason : str
        Why it is sampled and does not hold for certain; "" if it does, up to rounding.
    guaranteed : bool
        Whether there is no such reason.
    t : ndarray, shape (n+1,)
    of_t : ndarray, shape (n,)
        The bound on each step [t_i, t_{i+1}].
    B : ndarray, shape (n,)
        The bound of |u(t) - u_n(t)|_B on each step.
    lower : float
        A lower bound of the same supremum; 0 where none is known.
    """

    reason: str
    t: Array
    of_t: Array
    B: Array
    lower: float

    def __repr__(self) -> str:
        sampled = f"sampled, not guaranteed: {self.reason}"
        return f"{float(self):.4g} ({'guaranteed' if self.guaranteed else sampled})"

    @property
    def guaranteed(self) -> bool:
        return not self.reason

    @classmethod
    def make(cls, reason: str, t: Array, of_t: Array, B: Array, lower: float) -> ErrorBound:
        # what overflows on the way, inf - inf for example, is not bounded
        of_t, B = (np.where(np.isnan(one), np.inf, one) for one in (of_t, B))
        bound = cls(of_t.max(initial=0.0))
        bound.reason, bound.t, bound.of_t, bound.B = reason, t, of_t, B
        bound.lower = lower if math.isfinite(lower) else 0.0
        return bound


def error_bound(
    process: SweepingProcess,
    plan: Plan,
    run: Nodes,
    variation: Callable[[float], float] | None = None,
) -> ErrorBound:
    """The bound of a run, with v through the nodes of runs on grids that are refined for it.

    The first grid is that of the run with the breakpoints of the data added, and for the
    trapezoidal rule with the middles of its steps: where C(t) is no data there is no other pass.
    Nor is there for sets that move separately and schemes of one stage, whose steps are in as many
    parts as WORK has programs: with two passes bounds were 1.2 (at most 2) times as loose.
    Each pass bounds |u - v|, with the best curve on each step; on each step the smallest bound of
    all counts. The first one of a stiff body that ran by implicit Euler is that run itself, as BDF2
    starts like it: with its programs left for the second pass the worst bound of 24 such processes
    is 2.5 times the error, not 3.0. The next pass has as many more steps as its goal needs, or WORK
    has left.
    """
    norms = Norms(process)
    stiff = process.rate_independent or norms.lam * np.diff(run.t).min() > STIFF
    data, t0, stages = motion(process.C), float(run.t[0]), len(plan.scheme.b)
    reason = "" if variation else unknown(process.C, data, t0)
    separate = not (data.summands or reason or variation)
    curves = _curves(process, plan, t0, stiff, not (reason or separate))
    euler = SCHEMES["implicit-euler"]
    scheme = SCHEMES["trapezoid"] if not stiff else BDF2 if len(curves) > 1 else euler
    work = _work(process, plan, separate)
    parts = work if separate and stages == 1 else 1 if stiff else 2
    own = scheme is BDF2 and plan.scheme == euler
    plan = replace(plan, tol=min(plan.tol, TOL), scheme=scheme, proved=False)
    velocities = Velocities(plan.process_of(process), replace(plan, scheme=euler))
    A, B = np.full((2, len(run.t) - 1), np.inf)
    layer = run.t[:0] if plan.cones else _start_layer(process, norms.Lam, run.t)
    t = np.union1d(_first_grid(process, run.t, parts), layer)
    own &= len(t) == len(run.t)  # then the first pass is the run itself
    first_pass = run, np.concatenate([run.velocity[:1], run.velocity]), None
    ends = norms.A(run.u)
    largest, lower = _largest_state(norms, t0, float(run.t[-1])), 0.0
    passes: list[tuple[int, float]] = []
    while True:
        new = bool(passes) or not own
        nodes, slopes, members = companion(process, plan, velocities, t) if new else first_pass
        moving = _moving(nodes, separate)
        if not passes:  # what the run took for rest may move
            left = work * stages * max(_moving(run, separate), -(-(moving - len(layer)) // parts))
        left -= new * moving
        velocity = slopes_of_curves(nodes, slopes, curves)
        each, reason = residuals(norms, nodes, velocity, variation, slopes[1:], members)
        growth = _growth(norms, t, each)
        v = velocity[growth.curve, np.arange(len(t) - 1)]
        nodal, distance, distance_B = _distances(norms, nodes, v, run)
        rounding = SUM_ROUNDING * math.sqrt(len(t)) * (ends.max() + nodal.max())
        first = np.searchsorted(t, run.t[:-1])
        A = np.fmin(A, np.maximum.reduceat(distance + growth.A, first) + rounding)
        B = np.fmin(B, np.maximum.reduceat(distance_B + growth.B, first) + rounding)
        lower = max(lower, float(np.nan_to_num(nodal - growth.A - rounding).max()))
        passes.append((len(t) - 1, float(growth.A[-1])))
        more = _more(passes, max(COMPANION_SHARE * distance.max(), rounding), left - moving)
        if more == 0 or reason or variation is not None:
            break
        t = _refined(t, growth.shares, more)
    most = largest + np.maximum(ends[:-1], ends[1:]) + rounding
    A, B = np.fmin(A, most), np.fmin(B, most * (1.0 if norms.weak else math.sqrt(norms.Lam)))
    if not process.metric.has_factors:
        reason = reason or "the matrices are too large for factors, which would prove their Lam"
    return ErrorBound.make(reason, run.t, A, B, lower)


def require_bound(process: SweepingProcess, plan: Plan) -> None:
    """Refuse a run whose error no bound is known of.

    Raises
    ------
    InputError
        If C depends on the state.
    PathError
        If path "cones" would need projections that are slow.
    """
    process.refuse_state("error_bound")
    moving = motion(process.C)
    if plan.cones and not (moving.summands and moving.scales_known and moving.disjoint):
        raise PathError(
            "error_bound needs projections that take seconds each for path='cones', where C(t) is "
            "a function, or a sum on the same unknowns: give it as data, such as so.Separable, "
            "or take path='full'"
        )


def _work(process: SweepingProcess, plan: Plan, separate: bool) -> int:
    """Which of WORK the second runs may have."""
    moving = motion(process.C)
    if separate:
        return WORK[3 - moves_straight(process.C)]
    at_once = all(projects_at_once(S) for _, S in moving.summands)
    return WORK[not (at_once and moving.disjoint and not plan.cones and process.dim <= SMALL)]


def _curves(process: SweepingProcess, plan: Plan, t: float, stiff: bool, known: bool) -> Any:
    """Which of CURVES are tried: one where each costs programs or projections of its own.

    Of unbounded sets a straight one, or all, as velocities of a cubic may have no support function.
    """
    moving, bounded = motion(process.C), process.C.at(t).is_bounded
    one_by_one = not (known or (moving.summands and moving.scales_known and not moving.offsets))
    at_once = all(projects_at_once(S) for _, S in moving.summands)
    slow = (process.dim > LARGE and plan.contact is not None) or plan.cones or not at_once
    if not (one_by_one or (slow and bounded)):
        return CURVES
    return ["velocities" if bounded and not stiff else "straight"]


def _largest_state(norms: Norms, a: float, b: float) -> float:
    """A bound of |u(t)|_A on [a, b]: |u|_A falls where |u|_B > sup |w|_{B^-1}, w in C (MATH 4)."""
    process = norms.process
    moving = motion(process.C)
    lam = 1.0 if process.rate_independent else norms.lam  # at A = 0, B u = w
    if not moving.summands or lam == 0 or norms.B.beta == 0:
        return math.inf
    center = sum(phi * float(norms.B.dual(f)) for phi, f in moving.center.largest(a, b))
    sets: Any = moving.summands
    if moving.offsets is not None:
        h = np.sum([phi * np.abs(f) for phi, f in moving.offsets.largest(a, b)], axis=0)
        if not np.isfinite(h).all():
            return math.inf
        sets = [(ONE, sets[0][1].member(h))]
    size = 0.0
    for scale, S in sets:
        most = sum(phi * float(np.abs(f).max()) for phi, f in scale.largest(a, b))
        size += most * S.magnitude()
    w = center + size / math.sqrt(norms.B.beta)
    return max(float(norms.A(process.u0)), w / math.sqrt(lam)) if w < math.inf else w


def _first_grid(process: SweepingProcess, t: Array, parts: int) -> Array:
    """The breakpoints of the data added, if they are fewer, and each step in equal parts."""
    cuts = breakpoints(histories_of(process.C, inside=False), t[0], t[-1])
    t = np.union1d(t, times_inside(cuts, t)) if len(cuts) < len(t) else t
    return divided(t, np.full(len(t) - 1, parts))


def _start_layer(process: SweepingProcess, Lam: float, t: Array) -> Array:
    """Times in the first step, each four times as late as the one before, from 1 / Lam on.

    Where B u0 is outside of C(t_0) a stiff body is nearly at rest after 1 / Lam. On equal parts of
    the step the variation of r is all of the way until there, however short they are: of 54 such
    processes bounds were 2.3 to 3.0 times the error (medians of four schemes; at most 17.5), now
    1.1 to 1.2. With twice as many times they are as close.
    """
    h = t[1] - t[0]
    many = math.log(min(max(h * Lam, 1.0), h / (TIME_SLACK * np.abs(t[:2]).max())), 4)
    if many < 1 or not process.start_excess(float(t[0])).any():
        return t[:0]
    return t[0] + h * 0.25 ** np.arange(1, 1 + math.ceil(many))


def _moving(run: Nodes, separate: bool) -> int:
    """The steps that count as work: all of small bodies that move as one, else those in motion."""
    moves = run.velocity.any(axis=1) | (run.velocity.shape[1] <= SMALL and not separate)
    return int(moves.sum())


def _more(passes: list[tuple[int, float]], goal: float, left: int) -> int:
    """How many steps the next grid shall have more, of those left; 0 where no finer grid pays.

    A pass is its number of steps and its bound, which falls with the order of the last two; with
    one pass, or an infinite bound, with order 1.
    """
    n, bound = passes[-1]
    before, larger = passes[-2] if len(passes) > 1 else (0, math.inf)
    if not bound > goal or left <= 0 or n == before:  # or it is not a number
        return 0
    order = 1.0
    if max(bound, larger) < math.inf:
        order = math.log(larger / bound) / math.log(n / before)
    if order < LEAST_ORDER:
        return 0
    missing = (bound / goal) ** (1 / order) - 1 if goal > 0 else math.inf
    if missing < LEAST_REFINEMENT:
        return 0
    # the last pass that WORK allows takes what is left: one after it would not be twice as fine
    finer = MOST_REFINEMENT * n if left > (1 + 3 * MOST_REFINEMENT) * n else left
    return math.ceil(min(missing * n, finer, left))


def _refined(t: Array, shares: Array, cuts: int) -> Array:
    """The grid with at most so many cuts: shares / cuts have the least sum at cuts ~ sqrt(shares).

    Steps are halved, that with the most cuts left for its parts first: so they have few lengths,
    each of which has a matrix, and seldom another one than the step before, where BDF2 is of order
    one.
    """
    weights = np.sqrt(np.nan_to_num(shares))  # of inf they have a finite sum
    weights *= cuts / (float(weights.sum()) or 1.0)
    halvings = np.arange(int(cuts).bit_length())
    sizes = (1 + weights)[:, None] / 2.0**halvings
    parts = np.ones(len(shares), dtype=int)
    for k in np.argsort(-sizes, axis=None, kind="stable").tolist():
        step, more = k // len(halvings), 2 ** (k % len(halvings))
        if more <= cuts:
            parts[step] += more
            cuts -= more
    return divided(t, parts)


class _Growth(NamedTuple):
    """|u - v|_A and |u - v|_B at most on each step; what each adds; the curve it is about."""

    A: Array
    B: Array
    shares: Array
    curve: Array


def _growth(norms: Norms, t: Array, each: Residuals) -> _Growth:
    """The smallest of the theorem's bounds, with the best curve on each step."""
    gaps, squares, turning = each[:3]
    turning[~np.isfinite(turning + each.error)] = np.inf
    step = np.arange(len(t) - 1)
    powers, weight = gaps + 0.5 * squares, 0.0
    for _ in range(4):  # with 2, and y for y - V, bounds were up to 1.2 times as loose
        # |r|^2 on a step or its variation, for which dy = (dS / 2 + (y - V) dV) / (y - R): what
        # makes y smaller, to first order; at first the variation wherever there is one
        varied = np.where(turning < np.inf, gaps + 2 * weight * turning, np.inf)
        varied[np.isnan(varied)] = np.inf
        cost = np.minimum(powers, varied)
        curve = np.argmin(cost, axis=0)
        weak = (varied < powers)[curve, step]
        V, size = _variation(norms, each, curve, weak)
        S = np.cumsum(np.where(weak, gaps[curve, step], powers[curve, step]))
        R = V + size
        of_B = R + np.sqrt(size * (size + 2 * V) + S)
        weight = (of_B - V)[-1]
    cost = cost[curve, step]
    if norms.weak:
        return _Growth(of_B, of_B, cost, curve)
    gap, square = gaps[curve, step], squares[curve, step]
    once = np.sqrt(np.diff(t) * (gap + square))  # Cauchy and Schwarz: int sqrt(2 G + |r|^2)
    energy = np.cumsum(gap + np.where(weak, 0.0, square)) + 2 * of_B * R
    time = t[1:] - t[0]
    A = np.minimum(norms.growth(time) * np.cumsum(once), np.sqrt(time * energy))
    of_B = np.minimum(of_B, math.sqrt(norms.Lam) * np.cumsum(once)) if norms.Lam else 0 * of_B
    if norms.lam > 0 and of_B[-1] < math.sqrt(norms.lam) * A[-1]:
        return _Growth(np.minimum(A, of_B / math.sqrt(norms.lam)), of_B, cost, curve)
    return _Growth(A, of_B, once, curve)


def _variation(norms: Norms, each: Residuals, curve: Array, weak: Array) -> Array:
    """V and sup |r_2| until the end of each step; r_2 is r on the weak steps, and jumps to 0."""
    if not weak.any():
        return np.zeros((2, len(weak)))
    turning, size, begin, end, error = (x[curve, np.arange(len(curve))] for x in each[2:])
    turning, size, error = (np.where(weak, x, 0.0) for x in (turning, size, error))
    begin, end = (np.where(weak[:, None], r, 0.0) for r in (begin, end))
    before = np.concatenate([np.zeros_like(end[:1]), end[:-1]])
    known = np.sqrt(each.gaps[curve, np.arange(len(curve))])
    jumps = norms.B.dual(begin - before, known) + error + np.append(0.0, error[:-1])
    return np.array([np.cumsum(turning + jumps), np.maximum.accumulate(size)])


def _distances(norms: Norms, nodes: Nodes, slopes: Array, run: Nodes) -> tuple[Array, Array, Array]:
    """|v - u_n|_A at all nodes but the first, and bounds in both norms on each step.

    Those of the Bernstein coefficients of the cubic v - u_n, on some steps at a time: of 5,000
    unknowns all at once took twice as long.
    """
    step = np.clip(np.searchsorted(run.t, nodes.t, side="right") - 1, 0, len(run.t) - 2)
    share = ((nodes.t - run.t[step]) / np.diff(run.t)[step])[:, None]
    many, sizes = max(CHUNK // (30 * run.u.shape[1]), 1), []
    for k in range(0, len(slopes), many):
        some = slice(k, k + many + 1)
        i, x = step[some], share[some]
        u, h = (1 - x) * run.u[i] + x * run.u[i + 1], np.diff(nodes.t[some])[:, None, None]
        difference = nodes.u[some] - u
        increments = h * slopes[k : k + many] - np.diff(u, axis=0)[:, None]
        curve = cubic(difference[:-1], difference[1:], increments)
        sizes.append([norms.A(curve), norms.B(curve)])
    all_sizes = np.concatenate(sizes, axis=1)
    return all_sizes[0, :, 3], *all_sizes.max(axis=2)


# ---- runs ---------------------------------------------------------------------------------------


def companion(
    process: SweepingProcess,
    plan: Plan,
    velocities: Velocities,
    t: Array,
) -> tuple[Nodes, Array, Array | None]:
    """Nodes of the plan's scheme on the grid t, and the velocities at them (the mean at the first).

    And points of C(t) at all but the first, where the programs know them.

    A step has one program, that of its last stage, which is the inclusion at the node itself, so
    that no difference of forces is divided by A; an explicit stage before it is that of the step
    before, for BDF2 its mean velocity. Where that carries on what comes to rest or turns back in
    this stage the program is solved again without it: friction would hold such bodies where they
    should not be (with a chain of six the bound of |u - v| was three times as large). The first
    step, one after a second stage without a program, and for BDF2 one of more than twice the length
    of the one before, is one of implicit Euler, in which errors of the start fade; without a
    program it is taken in parts or at rest, and the residual has what is missing.
    Weights are positive, so that means of velocities stay in cones. A program that misses its
    tolerance is in the residual.
    """
    times, mus = time_grid(None, t)
    few, start = plan.process_of(process), SCHEMES["implicit-euler"]
    u, members = [few.u0], []
    means: list[Array] = []
    slopes: list[Array] = []
    stages: list[Velocity] = []
    compensation = np.zeros(few.dim)
    stiff, last, in_cone = plan.scheme is BDF2, 0.0, not few.C.at(times[0]).is_bounded
    sets = few.C.at_many(times[1:])  # C may jump at a node, from which rounding takes t + mu
    for time, mu, C in zip(times[:-1].tolist(), mus.tolist(), sets, strict=True):
        if stiff and mu > 2.1 * last:
            stages = []
        last, scheme = mu, plan.scheme if stages else start
        first = stages[-1:] if len(scheme.b) > 1 else []
        if first and stiff:
            first = [first[0]._replace(z=means[-1])]
        stages = velocities.stages(scheme, time, mu, u[-1], first, (*([None] * len(first)), C))
        if stiff and len(stages) == 2:
            carried = (first[0].z != 0) & (first[0].z * stages[-1].z <= 0)
            if carried.any():
                first = [first[0]._replace(z=np.where(carried | in_cone, 0.0, first[0].z))]
                stages = velocities.stages(scheme, time, mu, u[-1], first, (None, C))
        if len(stages) == len(scheme.b):
            mean, slope = combination(scheme.b, stages), stages[-1].z
            members.append(stages[-1].w)
        else:  # a stage has no program
            mean = slope = velocities.step(time, mu, u[-1]).velocity.z
            stages = []
        following, compensation = compensated_sum(u[-1], mu * mean, compensation)
        u.append(following)
        means.append(mean)
        slopes.append(slope)
    velocity, ends = plan.velocity(np.array(means)), plan.velocity(np.array(slopes))
    nodes = Nodes(times, plan.state(np.array(u)), velocity)
    known = len(members) == len(mus) and not (plan.reduction or any(w is None for w in members))
    return nodes, np.array([velocity[0], *ends]), np.array(members) if known else None


def nodes_of(process: SweepingProcess, plan: Plan, t: Array) -> Nodes:
    """All nodes of a run on the grid t; where its programs miss tol, their residual is bounded."""
    times, mus = time_grid(None, t)
    saved = saving(None, times, process.dim, MEMORY)
    for tol in (plan.tol, math.inf):
        run = Run(times, mus, replace(plan, tol=tol), saved, process.u0)
        integrate(process, run)
        if run.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        if run.done == len(mus):
            break
    states = run.states()
    return Nodes(times, states.u(slice(None)), states.velocity(slice(None)))
