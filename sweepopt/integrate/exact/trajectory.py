"""The exact trajectory: closed forms between the times at which the active rows change.

A run takes it on its grid, the inclusion checked at each node and late in each phase between them:
a row that is missed is violated until its phase ends.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import groupby, pairwise
from operator import attrgetter
from typing import Any

import numpy as np

from sweepopt import checks
from sweepopt.checks import Array
from sweepopt.errors import InputError, Status, shown
from sweepopt.integrate.exact.exponential_sum import ExponentialSum, decay, first_root, histories
from sweepopt.integrate.exact.rows import ZERO, Face, Rows, face_after, modes, rows_of
from sweepopt.integrate.record import Run, Step
from sweepopt.linalg import EPS, Factor
from sweepopt.loads import breakpoints
from sweepopt.problem import SweepingProcess
from sweepopt.velocity import Plan, Velocity, certify_point

# Most phases besides one for each breakpoint: beyond it switching times are taken to accumulate.
PHASES = 100_000  # two and a half minutes, with one unknown
STALL = 20
"""Phases a row within sqrt(EPS) of the run, or up to twice as many: switches accumulate there, too.
With 80 the one of 430 runs that ends so does so, too."""


@dataclass(frozen=True, eq=False)
class Phase:
    """u(start + tau) in closed form up to `end`, the active rows unchanged.

    It begins with a switch where they are not those before, or the load breaks while one moves.
    """

    start: float
    end: float
    u: ExponentialSum
    switch: bool

    def state(self, t: Any) -> Array:
        """u at the times, shape (dim,) or (k, dim)."""
        return self.u(t - self.start)

    def velocity(self, t: Any) -> Array:
        """u' at the times, shape (dim,) or (k, dim); exactly 0.0 in what is stuck."""
        return 0.0 + self.u.derivative()(t - self.start)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """u(t) to rounding at any time.

    Attributes
    ----------
    phases : list of Phase
        One after the other; a run adds to them as it goes.
    plan : Plan
        It has all unknowns where the phases have few of them.

    Examples
    --------
    >>> import sweepopt as so
    >>> C = so.Moving(so.Box(-1, 1), so.Separable([(so.Polynomial([0.0, 1.5]), 1.0)]))
    >>> process = so.SweepingProcess(A=0.5, B=2.0, C=C, u0=0.0)
    >>> exact = so.solve(process, t_end=5.0, steps=10, scheme="exact").exact
    >>> exact.switches.round(8), exact([0.5, 5.0]).round(8).tolist()
    (array([0.66666667]), [[0.0], [3.06250001]])
    """

    phases: list[Phase]
    plan: Plan

    def __repr__(self) -> str:
        return (
            f"Trajectory({len(self.phases)} phases on [{self.phases[0].start:g}, {self.end:g}], "
            f"{self.switches.size} switches)"
        )

    @property
    def end(self) -> float:
        """The time up to which u is known: less than was asked for if the run stopped early."""
        return self.phases[-1].end

    @property
    def switches(self) -> Array:
        """Times at which the motion changes its closed form, shape (k,).

        A row begins or ceases to hold, or the load has a breakpoint while something moves.
        """
        return np.array([phase.start for phase in self.phases if phase.switch])

    @cached_property
    def starts(self) -> Array:
        """Where the phases begin."""
        return np.array([phase.start for phase in self.phases])

    def __call__(self, t: Any) -> Array:
        """u(t), shape (dim,) or (k, dim) for a scalar or an array t."""
        return self.plan.state(self._of_phases(t, Phase.state))

    def velocity(self, t: Any) -> Array:
        """u'(t), the left derivative; shape (dim,) or (k, dim)."""
        return self.plan.velocity(self._of_phases(t, Phase.velocity))

    def _of_phases(self, t: Any, value: Callable[[Phase, Array], Array]) -> Array:
        """u or u' of the unknowns of the phases at the times t."""
        times = checks.times_inside(t, np.array([self.starts[0], self.end]))
        flat = times.ravel()
        phase_of = np.maximum(np.searchsorted(self.starts, flat) - 1, 0)
        values = np.zeros((flat.size, len(self.phases[0].u.weights)))
        for k, group in groupby(np.argsort(phase_of).tolist(), phase_of.__getitem__):
            inside = list(group)
            values[inside] = value(self.phases[k], flat[inside])
        return values.reshape(*times.shape, values.shape[-1])


def phases_of(rows: Rows, u0: Array, start: float, end: float) -> Iterator[Phase]:
    """Move the process from u0 at `start`, phase by phase; to `end` if switches do not accumulate.

    Raises
    ------
    EmptySetError
        If C(t) becomes empty.
    """
    u, before, switch, left = u0, set[int](), False, PHASES
    ends = [start, *breakpoints(rows.histories, start, end).tolist(), end]
    for a, b in pairwise(ends):
        s, pieces = a, [phi.piece(a, b) for phi in rows.histories]
        left, mark, stalled, pushed = left + 1, -math.inf, False, 0.0
        while s < b:
            phi = histories(pieces, s, b - s)
            face = face_after(rows, phi, s, u, before, stalled)
            motion, length = _motion(rows, phi, u, face)
            active = set(face.active)
            switch |= s > start and (active != before or (s == a and bool(active)))
            following = s + length
            again, stalled = stalled, length <= 32 * EPS * abs(s) and active == before
            if not stalled:
                pushed = 0.0
            elif again:  # it ends where it starts but for rounding, of unknown size
                pushed = 2 * pushed or math.nextafter(s, b) - s
                following, stalled = min(max(following, s + pushed), b), False
            before = active
            if b - following <= min(32 * EPS * abs(b), following - s):
                following = b  # but for rounding
            u = motion(following - s)
            if following > s:
                yield Phase(s, following, motion, switch)
                s, switch = following, False
            left -= 1
            if left % (STALL * len(rows.N)) == 0:
                if not left or s - mark <= math.sqrt(EPS) * (end - start):
                    return
                mark = s


def _motion(rows: Rows, phi: ExponentialSum, u: Array, face: Face) -> tuple[ExponentialSum, float]:
    """u in closed form, and after which time another row holds, at most phi's length."""
    active = face.active
    force = phi.with_weights(-rows.weights @ phi.weights)
    of_load = np.abs(rows.weights) @ np.abs(phi.weights[:, 0].imag)
    force.weights.imag[:, : phi.degree + 1] = 0.0
    force.weights[:, 0] += rows.NB @ u  # N B u_s - d
    square = np.ix_(active, active)
    if rows.rate_independent:
        V = np.eye(len(active))
        p = force.with_weights(np.linalg.solve(rows.S[square], force.weights[active]))
    else:
        lam, V = modes(rows.S[square], rows.SB[square])
        force = force.extended(lam)
        p = decay(lam, force.with_weights(V.T @ force.weights[active]))
    dp = p.derivative()
    motion = p.with_weights(-rows.N[active].T @ V @ p.weights)
    motion.weights[:, 0] += u
    # the slacks N (A u' + B u) <= d, and the multipliers of the active rows in their place
    signs = rows.SB[:, active] @ V @ p.weights - force.weights
    if not rows.rate_independent:
        signs += rows.S[:, active] @ V @ dp.weights
    signs.imag[:, 0] = of_load  # what rounds where a slack touches zero
    signs[active] = V @ dp.weights
    start, sizes = (signs @ force.basis(0.0)).real, np.abs(signs).sum(axis=1)
    # the slack of an undecided row starts within rounding of 0, on either side: its row switches
    # where it is below 0 by more than it may be at the start, once for that and once for rounding
    signs[:, 0] += 2 * face.undecided * (np.maximum(-start, 0.0) + ZERO * sizes)
    watched = ~rows.equations & (sizes > 0)
    if rows.rate_independent:  # no order is hidden there by that of a velocity before
        watched &= ~face.undecided
    return motion, first_root(p.with_weights(signs[watched]), face.orders[watched])


def exact_steps(process: SweepingProcess, run: Run) -> Callable[[float, float, Array], Step | None]:
    """What takes the next step along the exact trajectory, of length mu from t, u; None where the
    switches accumulate.

    The certificate is that of -u' in N_C(A u' + B u) at the end of the step, or late in a phase
    inside of it if it is worse there, from A, B and the set's own projection: u' solves the program
    of an implicit Euler step that ends in u, M = A + mu B and q = B (u - mu u'). B u and the load
    may cancel, and the terms of a row's d(t): then it is compared to a hundredth of their largest
    sizes so far.

    Raises
    ------
    InputError
        If the process is not one of polyhedra and loads as data.
    """
    plan = run.plan
    if plan.solver != "auto":
        raise InputError(
            f"scheme 'exact' has no use for solver={shown(plan.solver)}; leave one of them out"
        )
    rows = rows_of(process)
    factor = lru_cache(maxsize=1)(lambda mu: Factor(process.matrix(mu)))
    largest = 0.0
    nodes = _nodes(rows, run)

    def certified(mu: float, t: float, u: Array, z: Array) -> Velocity:
        nonlocal largest
        C, M, force = process.C.at(t), factor(mu), process.times_B(u)
        sizes = M.norm(z) + M.dual_norm(force) + M.dual_norm(C.anchor)
        largest = max(largest, sizes, rows.size_of_nearest(t, u, mu))
        if not (z.any() or C.normal(force).any()):
            return Velocity(z, 0.0, 0.0)  # at rest in C
        before = u - mu * z
        velocity = certify_point(M, process.times_B(before), C, z, 0.01 * largest)
        if plan.reduction is not None:
            velocity = plan.reduction.certified(mu, before, velocity)
        return velocity

    def take(t: float, mu: float, u: Array) -> Step | None:
        node = next(nodes, None)
        if node is None:
            assert run.exact is not None
            run.status = Status.SWITCHING
            run.cause = (
                f"step {run.done} from t = {t:g}: its phases do not get beyond "
                f"t = {run.exact.end:g}, {len(run.exact.phases)} with those of the steps before; "
                "use implicit-euler, midpoint or sdirk2"
            )
            return None
        end, after, z, phases = node
        checked = [certified(mu, end, after, z)]
        for one in phases:
            if one.end < end:
                late = one.start + 0.999 * (one.end - one.start)  # C may jump at its end
                checked.append(certified(mu, late, one.state(late), one.velocity(late)))
        worst = max(checked, key=attrgetter("relative"))
        velocity = worst._replace(
            z=(after - u) / mu, solver="closed form", iterations=len(phases), attempts=1
        )
        return Step(velocity, end=after)

    return take


def _nodes(rows: Rows, run: Run) -> Iterator[tuple[float, Array, Array, list[Phase]]]:
    """t, u, u' and the phases that are new at each node, as far as phases go; `run` gets them."""
    phases: list[Phase] = []
    times, done, before = run.times, 1, 0
    for phase in phases_of(rows, run.u, float(times[0]), float(times[-1])):
        phases.append(phase)
        run.exact = run.exact or Trajectory(phases, run.plan)
        if run.advance is not None:
            run.advance(run.steps * ((phase.end - times[0]) / (times[-1] - times[0])))
        # a node that rounding puts beside a breakpoint is that: the velocity before it is meant
        slack = checks.TIME_SLACK * abs(phase.end)
        end = int(np.searchsorted(times, phase.end + slack, side="right"))
        block = np.minimum(times[done:end], phase.end)  # one by one they take twice as long
        of_block = block.tolist(), phase.state(block), phase.velocity(block)
        for t, u, z in zip(*of_block, strict=True):
            yield t, u, z, phases[before:]
            before = len(phases)
        done = max(done, end)
