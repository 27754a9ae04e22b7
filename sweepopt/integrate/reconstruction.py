"""All unknowns of a proportional material from those that enter its steps."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from sweepopt.errors import Status, SweepoptError
from sweepopt.integrate.exact import Lifting, Trajectory, mover
from sweepopt.integrate.record import (
    KeptStates,
    ReconstructedStates,
    Run,
    States,
    StatesInMemory,
    Summary,
)
from sweepopt.integrate.schemes import Scheme
from sweepopt.integrate.step import compensated_sum, step
from sweepopt.problem import SweepingProcess
from sweepopt.sets import Moving, Point
from sweepopt.velocity import POLISHED, OfLoad, Plan, Reduction, Solved, Velocity


class _Coefficients(NamedTuple):
    """alpha at all nodes, the seconds that each step of it took, its exact trajectory."""

    alpha: StatesInMemory
    seconds: float
    exact: Trajectory | None


class Lift:
    """All unknowns from those that enter the steps; the coefficients of the load come first."""

    def __init__(self, plan: Plan, times: np.ndarray, mus: np.ndarray) -> None:
        self._plan, self._times, self._mus = plan, times, mus

    @cached_property
    def _moved(self) -> _Coefficients:
        """The coefficients of the whole run, which come first."""
        reduction, scheme = self._plan.reduction, self._plan.scheme
        assert reduction is not None
        begun = clock.perf_counter()
        if scheme.exact:
            alpha, exact = _exact_coefficients(reduction, self._plan, self._times, self._mus)
        else:
            alpha, exact = _coefficients(reduction, scheme, self._times, self._mus), None
        return _Coefficients(alpha, (clock.perf_counter() - begun) / len(self._mus), exact)

    @cached_property
    def _of_load(self) -> list[OfLoad]:
        """What the load brings into the proof of each step."""
        assert self._plan.reduction is not None
        gammas = self._mus * self._plan.scheme.a[-1][-1]
        alphas = self._alpha.nodes[:-1], self._alpha.velocities
        return self._plan.reduction.of_load(alphas, gammas)

    @property
    def _alpha(self) -> StatesInMemory:
        return self._moved.alpha

    @property
    def seconds(self) -> float:
        """What each step costs beside the loop."""
        return self._moved.seconds if self._plan.reduction else 0.0

    def state(self, node: int, u: np.ndarray) -> np.ndarray:
        """The state at a node of the grid."""
        reduction = self._plan.reduction
        return u if reduction is None else reduction.lift(u, self._alpha.nodes[node])

    def velocity(self, i: int, z: np.ndarray) -> np.ndarray:
        """The velocity of a step."""
        reduction = self._plan.reduction
        return z if reduction is None else reduction.lift(z, self._alpha.velocities[i])

    def prove(self, i: int, zeta: np.ndarray, velocity: np.ndarray, step: Summary) -> Summary:
        """The certificate of all unknowns from that of those that entered the step.

        The load takes no part in parts of a step: it is linear, and its own scheme takes the whole.
        """
        assert self._plan.reduction is not None
        error, size = self._plan.reduction.residual(zeta, velocity, self._of_load[i])
        certificate = step.certificate + error
        if step.relative > 0:
            size = max(size, step.certificate / step.relative)
        relative = certificate / size if certificate > 0 else certificate
        return Summary(step.iterations, step.attempts, certificate, relative, step.solver)

    def trajectory(self, few: Trajectory | None) -> Trajectory | None:
        """The exact trajectory of all unknowns from that of those that entered."""
        reduction = self._plan.reduction
        if few is None or reduction is None:
            return few
        exact = self._moved.exact
        assert exact is not None  # the same scheme moves the coefficients
        return replace(few, lifting=Lifting(exact, reduction.lift))

    def of(self, kept: KeptStates) -> States:
        """The kept states as states of all unknowns."""
        reduction = self._plan.reduction
        if reduction is None:
            return kept.states
        return ReconstructedStates(
            kept.states, lambda: self._alpha, kept.steps, reduction.lift, self._plan.unknowns
        )


class _EveryStep:
    """The process of one coefficient, alpha' + rho alpha = phi, in all steps of a run at once.

    `step` asks this of it; every argument has a row for each step.
    """

    def __init__(self, rho: float, phi: Callable[[np.ndarray], np.ndarray | float]) -> None:
        self.B = rho or None
        self.C = self
        self._phi = phi

    def at(self, times: np.ndarray) -> np.ndarray | float:
        return self._phi(times)

    def velocity(self, gamma: np.ndarray) -> Callable[[np.ndarray, np.ndarray], Solved]:
        rho = self.B or 0.0
        return lambda alpha, phi: Solved(
            Velocity((phi - rho * alpha) / (1 + rho * gamma), 0.0, 0.0), "formula", 0, 1
        )


def _coefficients(
    reduction: Reduction, scheme: Scheme, times: np.ndarray, mus: np.ndarray
) -> StatesInMemory:
    """alpha at every node and its velocity in every step.

    The velocity of a step is affine in its first state: the tableau is asked twice for all steps,
    for the constant and for the slope.
    """
    load, n = reduction.load, len(mus)
    shape = n, len(load.terms)
    starts: Any = times[:-1, None]  # a row where `step` has a number
    sizes: Any = mus[:, None]

    def asked(phi: Callable[[np.ndarray], np.ndarray | float], alpha: np.ndarray) -> np.ndarray:
        every: Any = _EveryStep(reduction.rho, phi)
        return step(every, scheme, every.velocity, starts, sizes, alpha)[0]

    constant = asked(lambda t: load.values(t.ravel()), np.zeros(shape))
    slope = asked(lambda t: 0.0, np.ones((n, 1))).repeat(shape[1], axis=1)
    still = reduction.still(load.values(times[:-1] + scheme.c[0] * mus))
    constant[:still, reduction.beside] = 0.0
    slope[:still, -1] = 0.0
    starts_at = np.eye(shape[1])[-1]  # alpha_0 = 1, all others 0
    columns = [
        _follow(alpha, values, falls, mus)
        for alpha, values, falls in zip(starts_at.tolist(), constant.T, slope.T, strict=True)
    ]
    nodes, velocities = (np.column_stack(parts) for parts in zip(*columns, strict=True))
    return StatesInMemory(nodes, velocities)


def _exact_coefficients(
    reduction: Reduction, plan: Plan, times: np.ndarray, mus: np.ndarray
) -> tuple[StatesInMemory, Trajectory | None]:
    """alpha' + rho alpha = phi as a process of its own, which is linear."""
    unit = np.eye(len(reduction.load.terms))
    C = Moving(Point(0 * unit[-1]), reduction.load)
    process = SweepingProcess(unit, reduction.rho * unit if reduction.rho else None, C, unit[-1])
    plan = replace(plan, solvers=(), contact=None, reduction=None, order=None, tol=POLISHED)
    run = Run(len(mus), np.arange(len(mus)), process.u0)
    mover(process, plan)(times, mus, run)
    if run.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    if run.done < len(mus):
        raise SweepoptError(f"the load's coefficients: {run.cause or run.status.value}")
    return run.kept().states, run.exact


def _follow(
    alpha: float, constant: np.ndarray, slope: np.ndarray, mus: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """alpha and its velocity = constant + slope alpha, step by step in plain numbers."""
    compensation = 0.0
    nodes, velocities = [alpha], []
    for a, b, mu in zip(constant.tolist(), slope.tolist(), mus.tolist(), strict=True):
        velocity = a + b * alpha
        alpha, compensation = compensated_sum(alpha, mu * velocity, compensation)
        nodes.append(alpha)
        velocities.append(velocity)
    return np.array(nodes), np.array(velocities)
