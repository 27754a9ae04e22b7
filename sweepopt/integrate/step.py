"""One step of a scheme: whole, or in equal parts where the whole misses its tolerance.

u_{i+1} = u_i + mu sum_k b_k z_k, where z_k solves the program of stage k (see `schemes`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from sweepopt.errors import IndefiniteError
from sweepopt.integrate.record import Summary
from sweepopt.integrate.schemes import Scheme
from sweepopt.problem import SweepingProcess
from sweepopt.velocity import Plan, StateVelocity, Velocity, compile_velocity

PARTS = (2, 4, 8, 16)  # that a step which missed its tolerance is tried in
INDEFINITE = "indefinite"  # who answers where A + gamma B is no matrix of a program
Stages = list[Velocity]


class Velocities:
    """Compiled velocity programs, one per matrix A + gamma B."""

    LIMIT = 16  # irregular grids would otherwise keep one factorisation per step

    def __init__(self, process: SweepingProcess, plan: Plan) -> None:
        self._process, self._plan = process, plan
        self._compiled: dict[float, StateVelocity] = {}  # the one that was asked last at the end
        self._indefinite: set[float] = set()

    def __call__(self, gamma: float) -> StateVelocity:
        velocity = self._compiled.pop(gamma, None)
        if velocity is None:
            if gamma in self._indefinite:
                raise IndefiniteError("A + gamma B is not positive definite to rounding")
            velocity = compile_velocity(self._process, self._plan, gamma)
            if len(self._compiled) == self.LIMIT:
                del self._compiled[next(iter(self._compiled))]
        self._compiled[gamma] = velocity
        return velocity

    def forget(self) -> None:
        """Drop what programs remember of earlier steps, but not the factorisations."""
        for velocity in self._compiled.values():
            velocity.forget()
        self._indefinite.clear()

    def refuse(self, gamma: float) -> None:
        """Do not factorise a matrix again that has shown not to be positive definite."""
        self._indefinite.add(gamma)
        self._compiled.pop(gamma, None)


def step(
    process: SweepingProcess,
    scheme: Scheme,
    velocities: Velocities,
    t: float,
    mu: float,
    u: np.ndarray,
) -> tuple[np.ndarray, Stages]:
    """One step of the tableau: its mean velocity and what its stages solved.

    A matrix A + gamma B that is not positive definite to rounding gives no velocity.
    """
    stages: Stages = []
    for weights, c in zip(scheme.a, scheme.c, strict=True):
        known = u + mu * combination(weights[:-1], stages) if stages else u
        gamma = mu * weights[-1] if process.B is not None else 0.0
        try:
            solved = velocities(gamma)(known, process.C.at(t + c * mu))
        except IndefiniteError:
            velocities.refuse(gamma)
            nothing = Velocity(np.zeros_like(u), math.inf, math.inf, INDEFINITE)
            return nothing.z, [*stages, nothing]
        stages.append(solved)
    return combination(scheme.b, stages), stages


class Parts(NamedTuple):
    """A step in equal parts; without stages where no number of parts meets the tolerance.

    Attributes
    ----------
    z : ndarray
        The mean of their velocities.
    stages : list
        What the stages of each part solved.
    summary : Summary
        The worst certificate of the parts, or that of the whole step without stages; the work is
        all that was done.
    cause : str
        Why the step cannot be taken in parts at all.
    """

    z: np.ndarray
    stages: list[Stages]
    summary: Summary
    cause: str = ""


def step_in_parts(
    process: SweepingProcess,
    plan: Plan,
    velocities: Velocities,
    t: float,
    mu: float,
    u: np.ndarray,
    whole: Summary,
) -> Parts:
    """The step in 2, 4, .. equal parts of the same scheme, until all of them meet the tolerance.

    A + gamma mu / k B is nearer to A, and C(t) is asked for at other times. u moves through the
    parts as through steps, so that the result is that of a finer grid. The certificate is the worst
    of the parts' programs and no bound of the error of one whole step, which nobody knows.
    """
    iterations, attempts = whole.iterations, whole.attempts
    cause = ""
    for count in PARTS:
        h = mu / count
        starts = t + h * np.arange(count)
        try:
            process.C.members(np.unique(starts[:, None] + h * np.array(plan.scheme.c)))
        except Exception as error:  # C(t) may have no value between the times of the grid
            cause = str(error) or type(error).__name__
            break
        v, z = u, np.zeros_like(u)
        compensation = np.zeros_like(u)
        stages: list[Stages] = []
        for start in starts.tolist():
            velocity, solved = step(process, plan.scheme, velocities, start, h, v)
            part = summarise(solved)
            iterations, attempts = iterations + part.iterations, attempts + part.attempts
            if part.relative > plan.tol:
                break
            v, compensation = compensated_sum(v, h * velocity, compensation)
            z += velocity
            stages.append(solved)
        else:
            worst = summarise([one for part_stages in stages for one in part_stages])
            solver = f"{worst.solver}/{count}"
            summary = worst._replace(iterations=iterations, attempts=attempts, solver=solver)
            return Parts(z / count, stages, summary)
    failed = whole._replace(iterations=iterations, attempts=attempts)
    return Parts(np.zeros_like(u), [], failed, cause)


def summarise(stages: Stages) -> Summary:
    """What the stages have in common; the solver is that of the last one."""
    last = stages[-1]
    if len(stages) == 1:
        _, certificate, relative, solver, iterations, attempts = last
        return Summary(iterations, attempts, certificate, relative, solver)
    return Summary(
        sum(solved.iterations for solved in stages),
        max(solved.attempts for solved in stages),
        _worst(solved.certificate for solved in stages),
        _worst(solved.relative for solved in stages),
        last.solver,
    )


def compensated_sum(u: Any, increment: Any, compensation: Any) -> tuple[Any, Any]:
    """Kahan's sum: u + increment, and the compensation of what rounding has kept out of it."""
    increment = increment - compensation
    total = u + increment
    return total, (total - u) - increment


def combination(weights: Sequence[float], stages: Stages) -> np.ndarray:
    """sum of weights_k z_k; a single weight 1 keeps z itself."""
    if weights == (1.0,):
        return stages[0].z
    total = weights[0] * stages[0].z
    for weight, solved in zip(weights[1:], stages[1:], strict=True):
        total += weight * solved.z
    return total


def _worst(values: Iterable[float]) -> float:
    """The largest, or nan if one of them has no proof."""
    return max(values, key=lambda value: math.inf if math.isnan(value) else value)
