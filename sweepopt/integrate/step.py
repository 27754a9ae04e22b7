"""One step of a scheme: whole, or in equal parts where the whole misses its tolerance.

u_{i+1} = u_i + mu sum_k b_k z_k, where z_k solves the program of stage k (see `schemes`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from sweepopt.errors import IndefiniteError, TouchingError
from sweepopt.problem import SweepingProcess
from sweepopt.velocity import Plan, StateVelocity, Velocity, compile_velocity

PARTS = (2, 4, 8, 16)  # of a step that missed its tolerance: halved like steps of adaptive grids
MATRICES = 15  # kept factorised: irregular grids would otherwise keep one a step
INDEFINITE = "indefinite"  # who answers where A + gamma B is no matrix of a program
Stages = list[Velocity]


class Step(NamedTuple):
    """A step, whole or in equal parts.

    Attributes
    ----------
    velocity : Velocity
        The mean velocity with the worst certificate of the programs and all their work. In parts
        that is no bound of the error of one whole step, which nobody knows.
    parts : list of list of Velocity
        What the stages of each part solved; none where no number of parts meets the tolerance.
    cause : str
        Why the step cannot be taken in parts at all.
    end : ndarray or None
        The state at its end, where that is not a sum.
    """

    velocity: Velocity
    parts: list[Stages]
    cause: str = ""
    end: np.ndarray | None = None


class Velocities:
    """The steps of a plan's scheme, and their velocity programs, one per matrix A + gamma B."""

    def __init__(self, process: SweepingProcess, plan: Plan) -> None:
        self._process, self._plan = process, plan
        self._compiled: dict[float, StateVelocity] = {}  # the one that was asked last at the end

    def __call__(self, gamma: float) -> StateVelocity:
        velocity = self._compiled.pop(gamma, None)
        if velocity is None:
            velocity = compile_velocity(self._process, self._plan, gamma)
            if len(self._compiled) == MATRICES:
                del self._compiled[next(iter(self._compiled))]
        self._compiled[gamma] = velocity
        return velocity

    def forget(self) -> None:
        """Drop what programs remember of earlier steps, but not the factorisations."""
        for velocity in self._compiled.values():
            velocity.forget()

    def step(self, t: float, mu: float, u: np.ndarray) -> Step:
        """A step of the plan's scheme that meets its tolerance, if there is one.

        One that misses it as a whole is tried in 2, 4, .. equal parts of the same scheme, until
        all of them meet it: A + gamma mu / k B is nearer to A, and C(t) is asked for at other
        times. u moves through the parts as through steps, so that the result is that of a finer
        grid.
        """
        scheme, tol = self._plan.scheme, self._plan.tol
        stages = self._stages(t, mu, u)
        whole = _mean(scheme.b, stages)
        if not whole.relative > tol:
            return Step(whole, [stages])
        work, cause = [whole], ""
        for count in PARTS:
            h = mu / count
            starts = t + h * np.arange(count)
            try:
                self._process.C.members(np.unique(starts[:, None] + h * np.array(scheme.c)))
            except Exception as error:  # C(t) may have no value between the times of the grid
                cause = str(error) or type(error).__name__
                break
            v, compensation, parts, means = u, np.zeros_like(u), [], []
            for start in starts.tolist():
                parts.append(self._stages(start, h, v))
                means.append(_mean(scheme.b, parts[-1]))
                work.append(means[-1])
                if means[-1].relative > tol:
                    break
                v, compensation = compensated_sum(v, h * means[-1].z, compensation)
            else:
                mean = _mean([1 / count] * count, means, work)
                return Step(mean._replace(solver=f"{mean.solver}/{count}"), parts)
        return Step(_mean((1.0,), [whole], work), [], cause)

    def _stages(self, t: float, mu: float, u: np.ndarray) -> Stages:
        """What the stages of the tableau solve, up to one that has no program.

        A matrix A + gamma B that is not positive definite to rounding gives no velocity.
        """
        process, scheme = self._process, self._plan.scheme
        stages: Stages = []
        for weights, c in zip(scheme.a, scheme.c, strict=True):
            start = u + mu * combination(weights[:-1], stages) if stages else u
            gamma = mu * weights[-1] if process.B is not None else 0.0
            try:
                stages.append(self(gamma)(start, process.C.at(t + c * mu)))
            except TouchingError:
                return [Velocity(np.zeros_like(u), math.inf, math.inf, "none", attempts=1)]
            except IndefiniteError:
                return [Velocity(np.zeros_like(u), math.inf, math.inf, INDEFINITE)]
        return stages


def _mean(weights: Sequence[float], velocities: Stages, work: Stages | None = None) -> Velocity:
    """The weighted velocity and the worst certificate; the solver is the last one.

    Its attempts are the most of a stage, or all of those that were work.
    """
    if len(velocities) == 1 and work is None:
        return velocities[0]
    attempts = [one.attempts for one in work or velocities]
    return Velocity(
        combination(weights, velocities),
        _worst(one.certificate for one in velocities),
        _worst(one.relative for one in velocities),
        velocities[-1].solver,
        sum(one.iterations for one in work or velocities),
        sum(attempts) if work else max(attempts),
    )


def compensated_sum(u: Any, increment: Any, compensation: Any) -> tuple[Any, Any]:
    """Kahan's sum: u + increment, and the compensation of what rounding has kept out of it."""
    increment = increment - compensation
    total = u + increment
    return total, (total - u) - increment


def combination(weights: Sequence[float], velocities: Stages) -> np.ndarray:
    """sum of weights_k z_k; a single weight 1 keeps z itself."""
    if weights == (1.0,):
        return velocities[0].z
    total = weights[0] * velocities[0].z
    for weight, velocity in zip(weights[1:], velocities[1:], strict=True):
        total += weight * velocity.z
    return total


def _worst(values: Iterable[float]) -> float:
    """The largest, or nan if one of them has no proof."""
    return max(values, key=lambda value: math.inf if math.isnan(value) else value)
