"""All unknowns of a proportional material from those that enter its steps (`Reduction`).

u = A^-1 E^T N zeta + sum_k alpha_k F_k + alpha_0 F_0,   alpha_k' + rho alpha_k = phi_k
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sweepopt.integrate.exact import Evaluate, Trajectory, exact_trajectory, rows_of
from sweepopt.integrate.record import (
    KeptStates,
    ReconstructedStates,
    States,
    StatesInMemory,
    Summary,
)
from sweepopt.integrate.schemes import Scheme
from sweepopt.integrate.step import compensated_sum
from sweepopt.problem import SweepingProcess
from sweepopt.sets import Moving, Point
from sweepopt.velocity import Plan, Reduction


class _Coefficients(NamedTuple):
    """alpha at all nodes, the seconds that each step of it took, its exact trajectory."""

    alpha: StatesInMemory
    seconds: float
    exact: Trajectory | None


class Reconstruction:
    """All unknowns from those that enter the steps; without a reduction these are all."""

    def __init__(self, plan: Plan, times: np.ndarray, mus: np.ndarray) -> None:
        self._plan, self._times, self._mus = plan, times, mus

    @cached_property
    def _coefficients(self) -> _Coefficients:
        """Those of the whole run, which come first."""
        reduction, scheme = self._plan.reduction, self._plan.scheme
        assert reduction is not None
        begun = clock.perf_counter()
        exact = None
        if scheme.exact:
            exact = _exact_coefficients(reduction, self._times)
            nodes = exact(self._times)
            alpha = StatesInMemory(nodes, np.diff(nodes, axis=0) / self._mus[:, None])
        else:
            alpha = _coefficients(reduction, scheme, self._times, self._mus)
        return _Coefficients(alpha, (clock.perf_counter() - begun) / len(self._mus), exact)

    @cached_property
    def _residual(self) -> Callable[[int, np.ndarray, np.ndarray], tuple[float, float]]:
        assert self._plan.reduction is not None
        gammas = self._mus * self._plan.scheme.a[-1][-1]
        return self._plan.reduction.residuals(
            self._alpha.nodes[:-1], self._alpha.velocities, gammas
        )

    @property
    def _alpha(self) -> StatesInMemory:
        return self._coefficients.alpha

    @property
    def seconds(self) -> float:
        """The cost of each step beside the loop."""
        return self._coefficients.seconds if self._plan.reduction else 0.0

    def state(self, node: int, u: np.ndarray) -> np.ndarray:
        """The state at a node of the grid."""
        reduction = self._plan.reduction
        return u if reduction is None else reduction.reconstruct(u, self._alpha.nodes[node])

    def velocity(self, i: int, z: np.ndarray) -> np.ndarray:
        """The velocity of a step."""
        reduction = self._plan.reduction
        return z if reduction is None else reduction.reconstruct(z, self._alpha.velocities[i])

    def full_certificate(
        self, i: int, zeta: np.ndarray, velocity: np.ndarray, step: Summary
    ) -> Summary:
        """The certificate of all unknowns from that of those that entered the step.

        A step in parts has the load's coefficients of the whole step: they are linear.
        """
        error, size = self._residual(i, zeta, velocity)
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
        exact = self._coefficients.exact
        assert exact is not None  # the same scheme moves the coefficients

        def all_unknowns(t: np.ndarray, values: np.ndarray, of_phase: Evaluate) -> np.ndarray:
            pairs = zip(values, exact.evaluate(t, of_phase), strict=True)
            return np.array([reduction.reconstruct(*pair) for pair in pairs])

        return replace(few, reconstruct=all_unknowns)

    def states(self, kept: KeptStates) -> States:
        """The kept states as states of all unknowns."""
        reduction = self._plan.reduction
        if reduction is None:
            return kept.states
        return ReconstructedStates(
            kept.states,
            lambda: self._alpha,
            kept.steps,
            reduction.reconstruct,
            self._plan.unknowns,
        )


def _coefficients(
    reduction: Reduction, scheme: Scheme, times: np.ndarray, mus: np.ndarray
) -> StatesInMemory:
    """alpha at every node and its velocity in every step of a scheme of one stage.

    alpha' = (phi - rho alpha) / (1 + gamma rho), phi at the stage, alpha at the start of the step.
    """
    ((weight,),), (c,) = scheme.a, scheme.c
    ratios = (1 + weight * mus * reduction.rho)[:, None]
    phi = reduction.load.values(times[:-1] + c * mus)
    constant, slope = phi / ratios, np.broadcast_to(-reduction.rho / ratios, phi.shape).copy()
    rest = reduction.steps_at_rest(phi)
    constant[:rest, reduction.acts_beside] = 0.0
    slope[:rest, -1] = 0.0
    nodes = np.zeros((len(mus) + 1, phi.shape[1]))
    velocities = np.zeros(phi.shape)
    nodes[0, -1] = 1.0  # alpha_0
    sizes = mus.tolist()
    for k in range(phi.shape[1]):  # in plain numbers
        alpha, compensation = float(nodes[0, k]), 0.0
        each = zip(constant[:, k].tolist(), slope[:, k].tolist(), sizes, strict=True)
        for i, (a, b, mu) in enumerate(each):
            velocities[i, k] = velocity = a + b * alpha
            alpha, compensation = compensated_sum(alpha, mu * velocity, compensation)
            nodes[i + 1, k] = alpha
    return StatesInMemory(nodes, velocities)


def _exact_coefficients(reduction: Reduction, times: np.ndarray) -> Trajectory:
    """alpha' + rho alpha = phi as a process of its own, which is linear."""
    unit = np.eye(len(reduction.load.terms))
    C = Moving(Point(0 * unit[-1]), reduction.load)
    process = SweepingProcess(unit, reduction.rho * unit if reduction.rho else None, C, unit[-1])
    return exact_trajectory(rows_of(process), process.u0, float(times[0]), float(times[-1]))
