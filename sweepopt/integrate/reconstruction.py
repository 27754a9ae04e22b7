"""All unknowns of a proportional material from those that enter its steps (`Reduction`)."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sweepopt.integrate.exact import Evaluate, Trajectory, phases_of, rows_of
from sweepopt.integrate.record import Grid, States
from sweepopt.integrate.schemes import Scheme
from sweepopt.integrate.step import compensated_sum
from sweepopt.problem import SweepingProcess
from sweepopt.sets import Moving, Point
from sweepopt.velocity import Reduction, Velocity

Reconstruct = Callable[[np.ndarray, np.ndarray], np.ndarray]


class Reconstruction:
    """All unknowns from those that enter the steps; without a reduction these are all.

    Attributes
    ----------
    seconds : float
        What alpha took of each step, beside the loop.
    """

    def __init__(self, grid: Grid) -> None:
        reduction, n = grid.plan.reduction, len(grid.mus)
        # alpha at all nodes, alpha' in all steps
        self._nodes, self._velocities = np.zeros((n + 1, 0)), np.zeros((n, 0))
        self.seconds, self._exact = 0.0, None
        self._state: Reconstruct = lambda few, alpha: few
        self._velocity: Reconstruct = self._state
        if reduction is None:
            return
        self._state = _by_rows(reduction.state, grid.plan.unknowns)
        self._velocity = _by_rows(reduction.velocity, grid.plan.unknowns)
        begun, scheme = clock.perf_counter(), grid.plan.scheme
        if scheme.exact:
            self._exact = _exact_coefficients(reduction, grid.times)
            self._nodes = self._exact(grid.times)
            self._velocities = np.diff(self._nodes, axis=0) / grid.mus[:, None]
        else:
            every = _coefficients(reduction, scheme, grid.times, grid.mus)
            self._nodes, self._velocities = every
        self.seconds = (clock.perf_counter() - begun) / n
        gammas = grid.mus * scheme.a[-1][-1]
        self._residual = reduction.residuals(self._nodes[:-1], self._velocities, gammas)

    def state(self, node: int, u: np.ndarray) -> np.ndarray:
        """The state at a node of the grid."""
        return self._state(u, self._nodes[node])

    def velocity(self, i: int, z: np.ndarray) -> np.ndarray:
        """The velocity of a step."""
        return self._velocity(z, self._velocities[i])

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
        exact = self._exact
        if few is None or exact is None:
            return few

        def all_unknowns(t: np.ndarray, values: np.ndarray, of_phase: Evaluate) -> np.ndarray:
            return self._state(values, exact.evaluate(t, of_phase))

        return replace(few, reconstruct=all_unknowns)

    def states(self, entering: States) -> States:
        """The states of all unknowns from those that entered, made when they are asked for."""
        steps = entering.steps
        nodes = np.append(0, steps + 1)
        return States(
            steps,
            lambda i: self._state(entering.u(i), self._nodes[nodes[i]]),
            lambda i: self._velocity(entering.velocity(i), self._velocities[steps[i]]),
        )


def _by_rows(one: Reconstruct, dim: int) -> Reconstruct:
    """The same for one state or velocity and for some in rows."""

    def all_unknowns(few: np.ndarray, alpha: np.ndarray) -> np.ndarray:
        if few.ndim == 1:
            return one(few, alpha)
        rows = [one(*each) for each in zip(few, alpha, strict=True)]
        return np.array(rows).reshape(len(few), dim)

    return all_unknowns


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
    phases = phases_of(rows_of(process), process.u0, float(times[0]), float(times[-1]))
    return Trajectory(list(phases))
