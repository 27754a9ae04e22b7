"""One step of a scheme: whole, or in parts where the whole misses its tolerance."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from sweepopt.errors import IndefiniteError
from sweepopt.integrate.schemes import Scheme
from sweepopt.problem import SweepingProcess
from sweepopt.velocity import (
    Factors,
    Plan,
    StateVelocity,
    Velocity,
    compile_velocity,
    factors,
    matrix,
)

PARTS = (2, 4, 8, 16)  # that a step which missed is tried in
INDEFINITE = "indefinite"  # who answers where M is no matrix of a program
Stages = list[Velocity]


class Summary(NamedTuple):
    """What the stages of a step have in common: their worst certificate, all their work."""

    iterations: int
    attempts: int
    certificate: float
    relative: float
    solver: str


class Velocities:
    """Compiled velocity programs, one per matrix A + gamma B."""

    LIMIT = 16  # irregular grids would otherwise keep one factorisation per step

    def __init__(self, process: SweepingProcess, plan: Plan) -> None:
        self._process, self._plan = process, plan
        self._factors: dict[float, Factors] = {}
        self._compiled: dict[float, StateVelocity] = {}
        self._refused: set[float] = set()

    def __call__(self, gamma: float) -> StateVelocity:
        if gamma not in self._compiled:
            if gamma in self._refused:
                raise IndefiniteError("A + gamma B is not positive definite to rounding")
            if gamma not in self._factors:
                _make_room(self._factors, self.LIMIT)
                self._factors[gamma] = factors(self._plan, matrix(self._process, gamma))
            # apart from the factorisations: what is dropped depends on the steps since `forget`
            _make_room(self._compiled, self.LIMIT)
            known = self._factors[gamma]
            self._compiled[gamma] = compile_velocity(self._process, self._plan, gamma, known)
        return self._compiled[gamma]

    def forget(self) -> None:
        """Drop what programs remember of earlier steps, but not the factorisations."""
        self._compiled.clear()
        self._refused.clear()

    def refuse(self, gamma: float) -> None:
        """Do not factorise a matrix again that has shown not to be positive definite."""
        self._refused.add(gamma)
        self._compiled.pop(gamma, None)


def _make_room(cache: dict[float, Any], limit: int) -> None:
    if len(cache) == limit:
        del cache[next(iter(cache))]


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
        known = u + mu * combined(weights[:-1], stages) if stages else u
        gamma = mu * weights[-1] if process.B is not None else 0.0
        try:
            solved = velocities(gamma)(known, process.C.at(t + c * mu))
        except IndefiniteError:
            velocities.refuse(gamma)
            nothing = Velocity(np.zeros_like(u), math.inf, math.inf, INDEFINITE)
            return nothing.z, [*stages, nothing]
        stages.append(solved)
    return combined(scheme.b, stages), stages


class Parts(NamedTuple):
    """A step in parts: the mean of their velocities, what their stages solved, why it failed."""

    z: np.ndarray
    stages: list[Stages]
    found: Summary
    cause: str = ""


def in_parts(
    process: SweepingProcess,
    plan: Plan,
    velocities: Velocities,
    t: float,
    mu: float,
    u: np.ndarray,
    whole: Summary,
) -> Parts:
    """The step in 2, 4, .. equal parts of the same scheme, until all of them meet tol.

    A + gamma mu / k B is nearer to A, and C(t) is asked for at other times. u moves through the
    parts as through steps, so that the result is that of a finer grid. The certificate is the worst
    of the parts' programs, each exact to it: no bound of what one whole step would have been, which
    nobody knows. The work is all that was done. Where no number of parts helps, `found` has the
    certificate of the whole.
    """
    iterations, attempts = whole.iterations, whole.attempts
    cause = ""
    for count in PARTS:
        h = mu / count
        starts = t + h * np.arange(count)
        try:
            process.C.members(np.unique(starts[:, None] + h * np.array(plan.scheme.c)))
        except Exception as error:  # these C(t) nobody asked for: what is done stays
            cause = str(error) or type(error).__name__
            break
        v, lost, z = u, np.zeros_like(u), np.zeros_like(u)
        stages: list[Stages] = []
        for start in starts.tolist():
            part, solved = step(process, plan.scheme, velocities, start, h, v)
            found = summary(solved)
            iterations, attempts = iterations + found.iterations, attempts + found.attempts
            if found.relative > plan.tol:
                break
            v, lost = compensated(v, h * part, lost)
            z += part
            stages.append(solved)
        else:
            every = summary([one for part in stages for one in part])
            solver = f"{every.solver}/{count}"
            return Parts(
                z / count,
                stages,
                every._replace(iterations=iterations, attempts=attempts, solver=solver),
            )
    failed = whole._replace(iterations=iterations, attempts=attempts)
    return Parts(np.zeros_like(u), [], failed, cause)


def summary(stages: Stages) -> Summary:
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


def compensated(u: Any, increment: Any, lost: Any) -> tuple[Any, Any]:
    """u + increment, and what rounding keeps out of it (Kahan); `lost` is that of before."""
    increment = increment - lost
    following = u + increment
    return following, (following - u) - increment


def combined(weights: Sequence[float], stages: Stages) -> np.ndarray:
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
