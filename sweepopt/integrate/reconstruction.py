"""All unknowns of a proportional material from those that enter its steps (`Reduction`)."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sweepopt.integrate.exact import Evaluate, Trajectory, exact_trajectory, rows_of
from sweepopt.integrate.record import Grid, Index, States
from sweepopt.integrate.schemes import Scheme
from sweepopt.integrate.step import compensated_sum
from sweepopt.problem import SweepingProcess
from sweepopt.sets import Moving, Point
from sweepopt.velocity import Reduction, Velocity

Reconstruct = Callable[[np.ndarray, np.ndarray], np.ndarray]


class _Coefficients(NamedTuple):
    """alpha at all nodes, alpha' in all steps, the seconds that each took, the exact trajectory."""

    nodes: np.ndarray
    velocities: np.ndarray
    seconds: float
    exact: Trajectory | None


class Reconstruction:
    """All unknowns from those that enter the steps; without a reduction these are all."""

    def __init__(self, grid: Grid) -> None:
        self._plan, self._times, self._mus = grid.plan, grid.times, grid.mus

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
            velocities = np.diff(nodes, axis=0) / self._mus[:, None]
        else:
            nodes, velocities = _coefficients(reduction, scheme, self._times, self._mus)
        seconds = (clock.perf_counter() - begun) / len(self._mus)
        return _Coefficients(nodes, velocities, seconds, exact)

    @cached_property
    def _residual(self) -> Callable[[int, np.ndarray, np.ndarray], tuple[float, float]]:
        assert self._plan.reduction is not None
        gammas = self._mus * self._plan.scheme.a[-1][-1]
        alpha = self._coefficients
        return self._plan.reduction.residuals(alpha.nodes[:-1], alpha.velocities, gammas)

    @property
    def seconds(self) -> float:
        """The cost of each step beside the loop."""
        return self._coefficients.seconds if self._plan.reduction else 0.0

    def state(self, node: int, u: np.ndarray) -> np.ndarray:
        """The state at a node of the grid."""
        reduction = self._plan.reduction
        return u if reduction is None else reduction.state(u, self._coefficients.nodes[node])

    def velocity(self, i: int, z: np.ndarray) -> np.ndarray:
        """The velocity of a step."""
        reduction = self._plan.reduction
        if reduction is None:
            return z
        return reduction.velocity(z, self._coefficients.velocities[i])

    def full_certificate(self, i: int, zeta: np.ndarray, velocity: Velocity) -> Velocity:
        """The certificate of all unknowns from that of those that entered the step.

        A step in parts has the load's coefficients of the whole step: they are linear.
        """
        error, size = self._residual(i, zeta, velocity.z)
        certificate = velocity.certificate + error
        if velocity.relative > 0:
            size = max(size, velocity.certificate / velocity.relative)
        relative = certificate / size if certificate > 0 else certificate
        return velocity._replace(certificate=certificate, relative=relative)

    def trajectory(self, few: Trajectory | None) -> Trajectory | None:
        """The exact trajectory of all unknowns from that of those that entered."""
        reduction = self._plan.reduction
        if few is None or reduction is None:
            return few
        exact = self._coefficients.exact
        assert exact is not None  # the same scheme moves the coefficients

        def all_unknowns(t: np.ndarray, values: np.ndarray, of_phase: Evaluate) -> np.ndarray:
            pairs = zip(values, exact.evaluate(t, of_phase), strict=True)
            return np.array([reduction.state(*pair) for pair in pairs])

        return replace(few, reconstruct=all_unknowns)

    def states(self, entering: States) -> States:
        """The states of all unknowns from those that entered, made when they are asked for."""
        reduction, dim = self._plan.reduction, self._plan.unknowns
        if reduction is None:
            return entering
        steps = entering.steps
        nodes = np.append(0, steps + 1)

        def each(one: Reconstruct, few: np.ndarray, alpha: np.ndarray) -> np.ndarray:
            every = np.zeros((*few.shape[:-1], dim))
            for index in np.ndindex(few.shape[:-1]):
                every[index] = one(few[index], alpha[index])
            return every

        def u(i: Index) -> np.ndarray:
            return each(reduction.state, entering.u(i), self._coefficients.nodes[nodes[i]])

        def velocity(i: Index) -> np.ndarray:
            alpha = self._coefficients.velocities[steps[i]]
            return each(reduction.velocity, entering.velocity(i), alpha)

        return States(steps, u, velocity)


def _coefficients(
    reduction: Reduction, scheme: Scheme, times: np.ndarray, mus: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """alpha at every node and its velocity in every step of a scheme of one stage.

    alpha' = (psi - rho alpha) / (1 + gamma rho), psi the load's value at the stage, alpha at the
    start of the step.
    """
    ((weight,),), (c,) = scheme.a, scheme.c
    ratios = (1 + weight * mus * reduction.rho)[:, None]
    load = reduction.load
    psi = load.values(times[:-1] + c * mus) @ load.shapes.T
    constant, slopes = psi / ratios, (-reduction.rho / ratios[:, 0]).tolist()
    nodes = np.zeros((len(mus) + 1, psi.shape[1]))
    velocities = np.zeros(psi.shape)
    sizes = mus.tolist()
    for k in range(psi.shape[1]):  # in plain numbers
        alpha, compensation = 0.0, 0.0
        each = zip(constant[:, k].tolist(), slopes, sizes, strict=True)
        for i, (a, b, mu) in enumerate(each):
            velocities[i, k] = velocity = a + b * alpha
            alpha, compensation = compensated_sum(alpha, mu * velocity, compensation)
            nodes[i + 1, k] = alpha
    return nodes, velocities


def _exact_coefficients(reduction: Reduction, times: np.ndarray) -> Trajectory:
    """alpha' + rho alpha = phi as a process of its own, which is linear."""
    unit = np.eye(reduction.load.dim)
    C = Moving(Point(0 * unit[-1]), reduction.load)
    process = SweepingProcess(
        unit, reduction.rho * unit if reduction.rho else None, C, 0 * unit[-1]
    )
    return exact_trajectory(rows_of(process), process.u0, float(times[0]), float(times[-1]))
