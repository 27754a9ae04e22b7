"""The exact trajectory: closed forms between the times at which the active rows change."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from sweepopt import checks
from sweepopt.errors import InputError
from sweepopt.integrate.exact.active import Active, just_after
from sweepopt.integrate.exact.crossing import first_crossing
from sweepopt.integrate.exact.curves import Curve
from sweepopt.integrate.exact.forces import Smooth
from sweepopt.integrate.exact.modes import decay, modes, whitening
from sweepopt.integrate.exact.rows import Rows
from sweepopt.linalg import EPS

PHASES = 100_000
"""Phases of a run, not counting kinks: more are taken for an accumulation of switches."""
STALLED = 50  # phases in a row that are as short as rounding


@dataclass(frozen=True, eq=False)
class Phase:
    """u(s + tau) = u_s - paths @ p(tau), the active rows unchanged.

    Attributes
    ----------
    start : float
    u : ndarray, shape (dim,)
    paths : ndarray, shape (dim, modes)
    p, dp : Curve
        The modes and their derivative.
    """

    start: float
    u: np.ndarray
    paths: np.ndarray
    p: Curve
    dp: Curve

    def state(self, t: np.ndarray) -> np.ndarray:
        """u at the times, shape (k, dim)."""
        return self.u - self.p(t - self.start) @ self.paths.T

    def velocity(self, t: np.ndarray) -> np.ndarray:
        """u' at the times, shape (k, dim); exactly 0.0 in what is stuck."""
        return 0.0 - self.dp(t - self.start) @ self.paths.T

    def terms(self, t: np.ndarray) -> np.ndarray:
        """The absolute terms whose sum u' is, shape (k, dim): its rounding is relative to them."""
        values = np.abs(self.dp.basis.at(t - self.start)) @ np.abs(self.dp.weights).T
        return values @ np.abs(self.paths).T


class Lifting(NamedTuple):
    """All unknowns from few ones: lift(few, coefficients), both of them trajectories."""

    coefficients: Trajectory
    lift: Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """u(t) to rounding at any time.

    Attributes
    ----------
    phases : list of Phase
    end : float
        The time up to which they are known.
    switches : ndarray, shape (k,)
        Times at which the motion changes its closed form: a row begins or ceases to hold, or the
        load has a kink while something moves.
    complete : bool
        False if the switches accumulate: then `end` is where they were given up.
    lifting : Lifting or None
        How all unknowns follow from those of the phases.

    Examples
    --------
    >>> import sweepopt as so
    >>> C = so.Moving(so.Box([-1], [1]), so.Separable([(so.Polynomial([0.0, 1.5]), [1.0])]))
    >>> process = so.SweepingProcess(A=[[0.5]], B=[[2.0]], C=C, u0=[0.0])
    >>> exact = so.solve(process, t_end=5.0, steps=10, scheme="exact").exact
    >>> exact.switches.round(8), exact([0.5, 5.0]).round(8).tolist()
    (array([0.66666667]), [[0.0], [3.06250001]])
    """

    phases: list[Phase]
    end: float
    switches: np.ndarray
    complete: bool = True
    lifting: Lifting | None = None

    def __repr__(self) -> str:
        return (
            f"Trajectory({len(self.phases)} phases on [{self.phases[0].start:g}, {self.end:g}], "
            f"{self.switches.size} switches)"
        )

    @cached_property
    def starts(self) -> np.ndarray:
        """Where the phases begin."""
        return np.array([phase.start for phase in self.phases])

    def __call__(self, t: Any) -> np.ndarray:
        """u(t), shape (dim,) or (k, dim) for a scalar or an array t."""
        return self.seen(t, Phase.state)

    def velocity(self, t: Any) -> np.ndarray:
        """u'(t), the left derivative; shape (dim,) or (k, dim)."""
        return self.seen(t, Phase.velocity)

    def seen(self, t: Any, look: Callable[[Phase, np.ndarray], np.ndarray]) -> np.ndarray:
        """What `look` sees of the phases at the times."""
        times = checks.times("t", t)
        start = self.phases[0].start
        slack = checks.TIME_SLACK * max(abs(start), abs(self.end))
        bad = ~((times >= start - slack) & (times <= self.end + slack))
        if bad.any():
            raise InputError(f"t = {times[bad].flat[0]:g} is outside of [{start:g}, {self.end:g}]")
        flat = np.clip(times.ravel(), start, self.end)
        which = np.maximum(np.searchsorted(self.starts, flat, side="left") - 1, 0)
        values = np.zeros((flat.size, self.phases[0].u.size))
        order = np.argsort(which, kind="stable")
        for inside in np.split(order, np.flatnonzero(np.diff(which[order])) + 1):
            if inside.size:
                values[inside] = look(self.phases[which[inside[0]]], flat[inside])
        if self.lifting is not None:
            alphas = self.lifting.coefficients.seen(flat, look)
            lifted = [self.lifting.lift(*pair) for pair in zip(values, alphas, strict=True)]
            values = np.array(lifted)
        return values.reshape(*times.shape, values.shape[-1])


def integrate(rows: Rows, u0: np.ndarray, start: float, end: float) -> Trajectory:
    """Follow the process from u0 at `start`, phase by phase.

    Raises
    ------
    EmptySetError
        If C(t) becomes empty.
    """
    phases: list[Phase] = []
    switches: list[float] = []
    kinks = [start, *rows.forces.breakpoints(start, end).tolist(), end]
    u, before, stalled = u0, None, 0
    for a, b in pairwise(kinks):
        load, s = rows.forces.between(a, b), a
        touched = np.zeros(0, dtype=int)
        while s < b:
            active = just_after(rows, load, s, u, touched)
            phase, watched, signs = _phase(rows, load, s, b, u, active)
            moves = bool(phase.paths.size)
            if before is not None and (
                set(active.rows) != before[0] or (s == a and (moves or before[1]))
            ):
                switches.append(s)
            before = set(active.rows), moves
            found = first_crossing(signs, active.orders[watched]) if watched.size else None
            following = b if found is None else s + found.tau
            if b - following <= 4 * EPS * abs(b):
                following, found = b, None
            stalled = stalled + 1 if following - s <= 64 * EPS * abs(following) else 0
            u = phase.state(np.array([following]))[0]
            if following > s or not phases:
                phases.append(phase)
            touched = np.zeros(0, dtype=int) if found is None else watched[found.rows]
            s = following
            if len(phases) > PHASES + len(kinks) or stalled > STALLED:
                return Trajectory(phases, s, np.array(switches), complete=False)
    return Trajectory(phases, end, np.unique(switches))


class _Watched(NamedTuple):
    """The closed form from a time on, the rows that may end it, and their multipliers or slacks."""

    phase: Phase
    rows: np.ndarray
    signs: Curve


def _phase(rows: Rows, load: Smooth, s: float, b: float, u: np.ndarray, active: Active) -> _Watched:
    d = load.on(s, b - s)
    holding = active.rows
    N = rows.N[holding]
    first = d.basis.cuts.powers
    rest = Curve(d.basis, -d.weights)
    rest.weights[:, first] += rows.NB @ u  # N B u_s - d
    square = np.ix_(holding, holding)
    SB = rows.SB[square]
    if rows.rate_independent:
        V = whitening(SB) if holding else np.zeros((0, 0))
        p = Curve(d.basis, V.T @ rest.weights[holding])
    else:
        lam, V = modes(rows.S[square], SB)
        p = decay(lam, Curve(d.basis, V.T @ rest.weights[holding]))
    dp = p.derivative()
    phase = Phase(s, u, N.T @ V, p, dp)
    off = np.flatnonzero(~active.redundant & ~np.isin(np.arange(len(rows.N)), holding))
    pushing = np.array([i for i, row in enumerate(holding) if not rows.frozen[row]], dtype=int)
    watched = np.concatenate([np.array(holding, dtype=int)[pushing], off])
    slacks = p.mapped(rows.SB[off][:, holding] @ V).weights
    if not rows.rate_independent:
        slacks = slacks + dp.mapped(rows.S[off][:, holding] @ V).weights
    sines, skipped = d.basis.cuts.sines, p.basis.cuts.powers
    powers, waves = rest.weights[off, :sines], rest.weights[off, sines:]
    slacks[:, skipped : skipped + sines] -= powers
    if waves.shape[1]:
        slacks[:, -waves.shape[1] :] -= waves
    multipliers = dp.mapped(V[pushing]).weights
    return _Watched(phase, watched, Curve(p.basis, np.vstack([multipliers, slacks])))
