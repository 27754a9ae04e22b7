"""Curves through the nodes of a run, and the forces along them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sweepopt.errors import Status
from sweepopt.integrate import (
    MEMORY,
    Grid,
    Run,
    Velocities,
    combination,
    compensated_sum,
    integrate,
    saving,
    time_grid,
)
from sweepopt.problem import SweepingProcess, applied
from sweepopt.sets import basis
from sweepopt.velocity import Plan


class Nodes(NamedTuple):
    """Nodes of a trajectory, shape (n+1, dim), and the mean velocities between them.

    Their differences would do, but rounding takes them out of cones, where sigma is infinite.
    """

    t: np.ndarray
    u: np.ndarray
    velocity: np.ndarray


def companion(
    process: SweepingProcess,
    plan: Plan,
    velocities: Velocities,
    t: np.ndarray,
) -> tuple[Nodes, np.ndarray]:
    """Nodes of the plan's scheme on the grid t, and the velocities at them (the mean at the first).

    Its last stage is the inclusion at the node itself, so that no difference of forces is divided
    by A; its weights are positive, so that means of velocities stay in cones. A program that
    misses its tolerance is in the residual.
    """
    times, mus = time_grid(None, t)
    few, scheme = plan.process_of(process), plan.scheme
    u, means, slopes = [few.u0], [], []
    compensation, count = np.zeros(few.dim), len(scheme.c)
    sets = few.C.at_many((times[:-1, None] + mus[:, None] * np.array(scheme.c)).ravel())
    for i, (time, mu) in enumerate(zip(times[:-1].tolist(), mus.tolist(), strict=True)):
        of_step = sets[i * count : (i + 1) * count]
        stages = velocities.stages(scheme, time, mu, u[-1], sets=of_step)
        if len(stages) == len(scheme.b):
            mean, slope = combination(scheme.b, stages), stages[-1].z
        else:  # a stage has no program
            mean = slope = velocities.step(time, mu, u[-1]).velocity.z
        following, compensation = compensated_sum(u[-1], mu * mean, compensation)
        u.append(following)
        means.append(mean)
        slopes.append(slope)
    velocity, ends = plan.velocity(np.array(means)), plan.velocity(np.array(slopes))
    return Nodes(times, plan.state(np.array(u)), velocity), np.array([velocity[0], *ends])


def nodes_of(process: SweepingProcess, plan: Plan, t: np.ndarray) -> Nodes:
    """All nodes of a run on the grid t; where its programs miss tol, their residual is bounded."""
    times, mus = time_grid(None, t)
    grid = Grid(times, mus, plan, saving(None, times, process.dim, MEMORY))
    for tol in (plan.tol, math.inf):
        run = Run(grid, process.u0)
        integrate(process, replace(plan, tol=tol), run)
        if run.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        if run.done == len(mus):
            break
    states = run.states()
    return Nodes(times, states.u(slice(None)), states.velocity(slice(None)))


def slopes_of_curves(nodes: Nodes, slopes: np.ndarray) -> np.ndarray:
    """Bernstein coefficients of v', shape (3, n, 3, dim), of three curves through the nodes.

    Straight, and cubics: with the velocities at the nodes, and with the slopes of parabolas through
    three nodes, which have more digits where A is next to nothing. Without one of them bounds were
    up to 2.1, 2.1 and 1.9 times looser (84 stiff rows).
    """
    mean, h = nodes.velocity, np.diff(nodes.t)[:, None]
    inner = (h[1:] * mean[:-1] + h[:-1] * mean[1:]) / (h[1:] + h[:-1])
    parabolas = np.concatenate([mean[:1], inner, mean[-1:]])
    curves = [np.repeat(mean[:, None], 3, axis=1)]
    for ends in (slopes, parabolas):
        first, last = ends[:-1], ends[1:]
        curves.append(np.stack([first, 3 * mean - first - last, last], axis=1))
    return np.array(curves)


def force_along(
    process: SweepingProcess,
    nodes: Nodes,
    slopes: np.ndarray,
    i: np.ndarray,
    theta: np.ndarray,
) -> np.ndarray:
    """A v' + B v at the shares theta, shape (m, k), of the steps i, where v' has these slopes."""
    force = applied(process.A, basis(2, theta) @ slopes)
    if process.B is not None:
        h = (nodes.t[i + 1] - nodes.t[i])[:, None, None]
        v = cubic(nodes.u[i], nodes.u[i + 1], h * slopes)
        force += applied(process.B, basis(3, theta) @ v)
    return force


def cubic(begin: np.ndarray, end: np.ndarray, increments: np.ndarray) -> np.ndarray:
    """Bernstein coefficients of curves, shape (m, 4, dim), from their ends and h times v'."""
    first, last = begin + increments[:, 0] / 3, end - increments[:, 2] / 3
    return np.stack([begin, first, last, end], axis=1)
