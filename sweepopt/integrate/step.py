"""One step of a scheme: whole, in parts that end at breakpoints of the load, or in equal parts.

u_{i+1} = u_i + mu sum_k b_k z_k, where z_k solves the program of stage k (see `schemes`); or some
steps of implicit Euler, where step * Lam > 2 and much of the motion comes to rest or turns back. A
step is the whole one of the scheme but where it contains breakpoints of the plan, or misses its
tolerance: then u moves through parts of it as through steps, and the result is that of a finer
grid.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np

from sweepopt.checks import Array
from sweepopt.errors import IndefiniteError, InputError, TouchingError
from sweepopt.integrate.record import Step
from sweepopt.integrate.schemes import Scheme, implicit_euler
from sweepopt.problem import SweepingProcess
from sweepopt.sets import ConvexSet
from sweepopt.velocity import Plan, StateVelocity, Velocity, compile_velocity, of_fixed_point

PARTS = (2, 4, 8, 16)  # of a step that missed its tolerance: halved like steps of adaptive grids
BY_EULER = " (implicit-euler)"  # after the solver of a step that was taken by steps of that
INDEFINITE = "indefinite"  # who answers where A + gamma B is no matrix of a program
TOUCHING = "none"  # and where rounding hides the projection on C(t)
Stages = list[Velocity]


class Velocities:
    """The steps of a plan's scheme, and their velocity programs, one per matrix A + gamma B."""

    def __init__(self, process: SweepingProcess, plan: Plan) -> None:
        self._process, self._plan = process, plan
        self._contraction = cache(process.contraction)
        # an iteration needs programs that are closer than its limit: with a contraction of 0.8, the
        # largest that is allowed, 5 times their certificate is in its own
        self._programs = replace(plan, tol=0.1 * plan.tol) if plan.contraction else plan
        self._compiled: dict[float, StateVelocity] = {}  # the one that was asked last at the end
        self._bodies: Array | None = None

    def __call__(self, gamma: float) -> StateVelocity:
        velocity = self._compiled.pop(gamma, None)
        if velocity is None:
            velocity = compile_velocity(self._process, self._programs, gamma)
            if len(self._compiled) == 15:  # irregular grids would otherwise keep one a step
                del self._compiled[next(iter(self._compiled))]
        self._compiled[gamma] = velocity
        return velocity

    def forget(self) -> None:
        """Drop what programs remember of earlier steps, but not the factorisations."""
        for velocity in self._compiled.values():
            velocity.forget()

    def step(self, t: float, mu: float, u: Array, *breakpoints: float) -> Step:
        """A step of the plan's scheme that meets its tolerance, if there is one.

        First in the parts between the breakpoints, if there are any. Their matrices, one for each
        length, are not kept. A step that misses its tolerance as a whole is tried in 2, 4, .. equal
        parts, until all of them meet it: A + gamma mu / k B is nearer to A, and C(t) is asked for
        at other times. Sets that only touch in halves of the step, too, do so in smaller parts, and
        what rounds in a normal pair does not fall with the step.
        """
        work: Stages = []
        if breakpoints:
            starts, of_steps = np.array([t, *breakpoints]), set(self._compiled)
            mean = self._in_parts(starts, np.diff(starts, append=t + mu), u, work)
            for gamma in set(self._compiled) - of_steps:
                del self._compiled[gamma]
            if mean is not None:
                return Step(mean)
        whole, cause = self._mean(t, mu, u), ""
        work.append(whole)
        for count in PARTS if whole.relative > self._plan.tol and not whole.at_rounding else ():
            h = mu / count
            starts = t + h * np.arange(count)
            try:
                times = starts[:, None] + h * np.array(self._plan.scheme.times)
                self._process.C.members(np.unique(times))
            except Exception as error:  # C(t) may have no value between the times of the grid
                cause = str(error) or type(error).__name__
                break
            mean = self._in_parts(starts, np.full(count, h), u, work)
            if mean is not None:
                return Step(mean)
            if whole.solver == work[-1].solver == TOUCHING:
                break
        return Step(_mean((1.0,), [whole], work), cause)

    def _in_parts(self, starts: Array, sizes: Array, u: Array, work: Stages) -> Velocity | None:
        """The mean velocity of a step in parts; None where one misses the tolerance."""
        compensation, means = np.zeros_like(u), []
        for start, h in zip(starts.tolist(), sizes.tolist(), strict=True):
            means.append(self._mean(start, h, u))
            work.append(means[-1])
            if means[-1].relative > self._plan.tol:
                return None
            u, compensation = compensated_sum(u, h * means[-1].z, compensation)
        mean = _mean((sizes / sizes.sum()).tolist(), means, work)
        return mean._replace(solver=f"{mean.solver}/{len(means)}")

    def _mean(self, t: float, mu: float, u: Array) -> Velocity:
        """The mean velocity of a step of the scheme, or of its steps of implicit Euler.

        These are taken in stiff steps where the bodies that rest or turn back in the last stage
        moved more in the earlier ones, and may be carried too far, than steps of implicit Euler are
        late to follow the velocities of the others: by A / M times their change, and not at all
        without viscosity. Both in squares, weighted by the diagonal of M. A body is one unknown, or
        those of a ball: where that slides on a curve, its unknowns change their signs in turn and
        nothing turns back. What rests in an earlier stage and starts is one of the others: counted
        as carried too far, it made one of 699 runs 2.3 times the best of three schemes.
        Where step * Lam <= 2 no error comes back with the other sign.
        """
        scheme, process = self._plan.scheme, self._process
        stages = self.stages(scheme, t, mu, u)
        if not scheme.euler_steps or len(stages) < len(scheme.b):
            return _mean(scheme.b, stages)
        A = M = process.A.diagonal()
        if process.B is not None:
            M = A + mu * scheme.a[0][0] * process.B.diagonal()
        if self._bodies is None:
            self._bodies = _bodies(process.set_at(t + scheme.c[0] * mu, u))
        of_bodies = partial(np.bincount, self._bodies)
        last, motion = stages[-1].z, np.zeros(1)
        for stage in stages[:-1]:
            turned = of_bodies(M * stage.z * last) <= 0
            motion = np.maximum(motion, turned * of_bodies(M * stage.z**2))
        lag = of_bodies(A**2 / M * (last - stages[0].z) ** 2)
        if not (motion.sum() > lag[motion == 0].sum() and mu * process.Lam > 2):
            return _mean(scheme.b, stages)
        euler = implicit_euler(scheme.euler_steps)
        mean = _mean(euler.b, self.stages(euler, t, mu, u, stages[:1]))
        left = sum(stage.iterations for stage in stages[1:])
        iterations = mean.iterations + left
        return mean._replace(solver=mean.solver + BY_EULER, iterations=iterations)

    def stages(
        self,
        scheme: Scheme,
        t: float,
        mu: float,
        u: Array,
        first: Sequence[Velocity] = (),
        sets: Sequence[ConvexSet | None] = (),
    ) -> Stages:
        """What the stages of a tableau solve after the first ones, up to one that has no program.

        Their sets C(t) may be given. A matrix A + gamma B that is not positive definite to rounding
        gives no velocity.
        """
        stages = [*first]
        tableau = zip(scheme.a, scheme.c, sets or [None] * len(scheme.c), strict=True)
        for weights, c, C in list(tableau)[len(stages) :]:
            start = u + mu * combination(weights[:-1], stages) if stages else u
            try:
                stages.append(self._stage(mu * weights[-1], t + c * mu, start, C))
            except (TouchingError, IndefiniteError) as error:
                solver = INDEFINITE if isinstance(error, IndefiniteError) else TOUCHING
                return [Velocity(np.zeros_like(u), math.inf, math.inf, solver, attempts=1)]
        return stages

    def _stage(self, gamma: float, t: float, u: Array, C: ConvexSet | None) -> Velocity:
        """The velocity z of the state u + gamma z, where C depends on it by fixed-point iteration.

        z_{k+1} is the velocity of C(t, u + gamma z_k), z_0 = 0.
        """
        process = self._process
        velocity = self(gamma if process.B is not None else 0.0)
        result = program = velocity(u, process.set_at(t, u) if C is None else C)
        q = self._contraction(gamma)
        last = size = velocity.norm(result.z) if q else 0.0
        for _ in range(100 if q else 0):  # a contraction of 0.8 gives ten digits
            before, error = result, program.certificate
            program = velocity(u, process.set_at(t, u + gamma * before.z))
            distance = velocity.norm(program.z - before.z)
            # a user's function rounds what it adds up; a small L shows in the first iterations
            if distance > q * last + error + program.certificate + 1e-9 * size:
                raise InputError(
                    f"lipschitz of C(t, u) is too small: at t = {t:g} the set changes more with "
                    f"the state than it says, by a factor of {distance / max(q * last, 1e-300):.2g}"
                )
            last = distance
            result = of_fixed_point(program, before, distance, q)
            if result.relative <= self._plan.tol or program.relative > self._plan.tol:
                break
        return result


def _bodies(C: ConvexSet) -> Array:
    """A number of each unknown, the same for those of one ball."""
    bodies = np.arange(C.dim)
    unknowns, part = (bodies, C) if C.selection is None else C.selection[:2]
    if part.polyhedral or not part.exact:
        return bodies
    if part.block == part.dim:  # a matrix of it may be large
        bodies[unknowns] = unknowns[0]
    else:
        for block in part.blocks(part.anchor) or ():
            bodies[unknowns[block.unknowns]] = unknowns[block.unknowns[:, :1]]
    return bodies


def _mean(weights: Sequence[float], velocities: Stages, work: Stages | None = None) -> Velocity:
    """The weighted velocity and the worst certificate; the solver is the last one.

    Its attempts are the most of a stage, or all of those that were work.
    """
    if len(work or velocities) == 1:
        return velocities[0]
    attempts = [one.attempts for one in work or velocities]
    return Velocity(
        combination(weights, velocities),
        _largest(one.certificate for one in velocities),
        _largest(one.relative for one in velocities),
        velocities[-1].solver,
        sum(one.iterations for one in work or velocities),
        sum(attempts) if work else max(attempts),
        at_rounding=any(one.at_rounding for one in velocities),
    )


def compensated_sum(u: Any, increment: Any, compensation: Any) -> tuple[Any, Any]:
    """Kahan's sum: u + increment, and the compensation of what rounding has kept out of it."""
    increment = increment - compensation
    total = u + increment
    return total, (total - u) - increment


def combination(weights: Sequence[float], velocities: Stages) -> Array:
    """sum of weights_k z_k; a single weight 1 keeps z itself."""
    if weights == (1.0,):
        return velocities[0].z
    total = weights[0] * velocities[0].z
    for weight, velocity in zip(weights[1:], velocities[1:], strict=True):
        total += weight * velocity.z
    return total


def _largest(values: Iterable[float]) -> float:
    """The largest, or nan if one of them has no proof."""
    return max(values, key=lambda value: math.inf if math.isnan(value) else value)
