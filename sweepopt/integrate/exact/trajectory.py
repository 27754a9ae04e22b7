"""The exact trajectory: closed forms between the times at which the active rows change."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np

from sweepopt import checks
from sweepopt.integrate.exact.exponential_sum import ExponentialSum, decay, histories
from sweepopt.integrate.exact.face import Face, face_after
from sweepopt.integrate.exact.first_root import first_root
from sweepopt.integrate.exact.rows import Rows
from sweepopt.linalg import EPS
from sweepopt.velocity import Plan

# Most phases besides one for each breakpoint: beyond it switching times are taken to accumulate.
PHASES = 100_000  # a minute, with one unknown

SAME = 32 * EPS  # of a time: an event that is nearer to a breakpoint is there, but for rounding


@dataclass(frozen=True, eq=False)
class Phase:
    """u(start + tau) in closed form up to `end`, the active rows unchanged.

    It begins with a switch where they are not those before, or the load breaks while one moves.
    """

    start: float
    end: float
    u: ExponentialSum
    switch: bool

    def state(self, t: Any) -> np.ndarray:
        """u at the times, shape (dim,) or (k, dim)."""
        return self.u(t - self.start)

    def velocity(self, t: Any) -> np.ndarray:
        """u' at the times, shape (dim,) or (k, dim); exactly 0.0 in what is stuck."""
        return 0.0 + self.u.derivative()(t - self.start)


Evaluate = Callable[[Phase, np.ndarray], np.ndarray]
"""A function of a phase at some times, such as `Phase.state`."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """u(t) to rounding at any time.

    Attributes
    ----------
    phases : list of Phase
        One after the other; a run adds to them as it goes.
    plan : Plan or None
        Of a run whose phases have few of the unknowns.

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
    plan: Plan | None = None

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
    def switches(self) -> np.ndarray:
        """Times at which the motion changes its closed form, shape (k,).

        A row begins or ceases to hold, or the load has a breakpoint while something moves.
        """
        return np.array([phase.start for phase in self.phases if phase.switch])

    @cached_property
    def starts(self) -> np.ndarray:
        """Where the phases begin."""
        return np.array([phase.start for phase in self.phases])

    def __call__(self, t: Any) -> np.ndarray:
        """u(t), shape (dim,) or (k, dim) for a scalar or an array t."""
        values = self._evaluate(t, Phase.state)
        return values if self.plan is None else self.plan.state(values)

    def velocity(self, t: Any) -> np.ndarray:
        """u'(t), the left derivative; shape (dim,) or (k, dim)."""
        values = self._evaluate(t, Phase.velocity)
        return values if self.plan is None else self.plan.velocity(values)

    def _evaluate(self, t: Any, of_phase: Evaluate) -> np.ndarray:
        """What `of_phase` computes of the phases at the times."""
        start = self.phases[0].start
        times = checks.times_inside(t, start, self.end)
        flat = np.clip(times.ravel(), start, self.end)
        phase_of = np.maximum(np.searchsorted(self.starts, flat, side="left") - 1, 0)
        values = np.zeros((flat.size, len(self.phases[0].u.weights)))
        for k, group in groupby(np.argsort(phase_of).tolist(), phase_of.__getitem__):
            inside = list(group)
            values[inside] = of_phase(self.phases[k], flat[inside])
        return values.reshape(*times.shape, values.shape[-1])


def phases_of(rows: Rows, u0: np.ndarray, start: float, end: float) -> Iterator[Phase]:
    """Move the process from u0 at `start`, phase by phase; to `end` if switches do not accumulate.

    Raises
    ------
    EmptySetError
        If C(t) becomes empty.
    """
    u, before, switch, left, stalled = u0, None, False, PHASES, False
    for a, b, pieces in rows.pieces(start, end):
        s = a
        left += 1
        while s < b:
            phi = histories(pieces, s, b - s)
            face = face_after(rows, phi, s, u, stalled)
            motion, length = _motion(rows, phi, u, face)
            active = set(face.active)
            switch |= before is not None and (active != before or (s == a and bool(active)))
            stalled = s + length == s and active == before
            before, following = active, s + length
            if b - following <= SAME * abs(b):
                following = b
            u = motion(following - s)
            if following > s:
                yield Phase(s, following, motion, switch)
                s, switch = following, False
            left -= 1
            if left < 0:
                return


def _motion(
    rows: Rows, phi: ExponentialSum, u: np.ndarray, face: Face
) -> tuple[ExponentialSum, float]:
    """u in closed form, and after which time another row holds, at most phi's length."""
    active = face.active
    force = phi.with_weights(-rows.weights @ phi.weights)
    force.weights.imag[:, : phi.degree + 1] = 0.0
    force.weights[:, 0] += rows.NB @ u  # N B u_s - d
    if rows.rate_independent:
        square, V = np.ix_(active, active), np.eye(len(active))
        p = force.with_weights(np.linalg.solve(rows.S[square], force.weights[active]))
    else:
        lam, V = rows.modes(tuple(active))
        force = force.extended(lam)
        p = decay(lam, force.with_weights(V.T @ force.weights[active]))
    dp = p.derivative()
    motion = p.with_weights(-rows.N[active].T @ V @ p.weights)
    motion.weights[:, 0] += u
    # the slacks N (A u' + B u) <= d, and the multipliers of the active rows in their place
    signs = rows.SB[:, active] @ V @ p.weights - force.weights
    if not rows.rate_independent:
        signs += rows.S[:, active] @ V @ dp.weights
    signs[active] = V @ dp.weights
    changing = ~face.redundant
    changing[active] = ~rows.equations[active]
    return motion, first_root(p.with_weights(signs[changing]), face.orders[changing])
