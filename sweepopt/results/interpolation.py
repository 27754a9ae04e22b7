"""Polynomials in the place of histories, on intervals, and curves through the nodes of a run.

A guaranteed bound must know a load at all times of an interval. Here a history is replaced on each
interval by the cubic through its values at the four Gauss points. The error is zero for tables; for
sines and polynomials it is bounded by the fourth derivative, for other functions by their
variation, where that is known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from sweepopt.checks import Array, instant
from sweepopt.errors import InputError, shown
from sweepopt.loads import History, breakpoints
from sweepopt.problem import SweepingProcess, TimeFunction, applied, variations
from sweepopt.sets import GAUSS, basis, to_bernstein

TO_BERNSTEIN = to_bernstein(GAUSS)

NODAL = math.factorial(4) ** 2 / math.factorial(8)  # max of prod |x - x_g| on [0, 1]
SAMPLES = 64  # of an interval of which only a variation is known: its bound is that much sharper
GAUSS_TO_PARTS = basis(3, np.arange(SAMPLES + 1) / SAMPLES) @ TO_BERNSTEIN


class Intervals(NamedTuple):
    """Intervals inside the steps of a grid: the step of each, and its ends."""

    step: Array
    begin: Array
    end: Array


class Interpolated(NamedTuple):
    """A TimeFunction of k terms on m intervals.

    Attributes
    ----------
    values : ndarray, shape (m, 4, dim)
        Of the polynomials, at GAUSS.
    error : ndarray, shape (m, k)
        A bound of sup |phi_k - its polynomial|; of the function itself where it has no terms.
    slope_error : ndarray, shape (m, k)
        A bound of int |phi_k' - the derivative of its polynomial|.
    """

    values: Array
    error: Array
    slope_error: Array


def smooth_intervals(histories: Sequence[Any], t: Array, parts: int = 1) -> Intervals:
    """Equal parts of the steps between the times t, cut at the breakpoints of all histories."""
    equal = np.linspace(t[:-1], t[1:], parts, endpoint=False).ravel()
    cuts = np.unique(np.concatenate([t, equal, breakpoints(histories, t[0], t[-1])]))
    step = np.searchsorted(t, cuts[:-1], side="right") - 1
    return Intervals(step, cuts[:-1], cuts[1:])


def is_straight(history: Any) -> bool:
    """Whether a history is straight between its breakpoints."""
    return getattr(type(history), "piece", None) is History.piece


def interpolate(f: TimeFunction, begin: Array, end: Array) -> Interpolated:
    """Interpolate on intervals between breakpoints; on those that are there again only once."""
    begin, first, again = np.unique(begin, return_index=True, return_inverse=True)
    end = end[first]
    h, m = end - begin, len(begin)
    values = f.at((begin[:, None] + h[:, None] * GAUSS).ravel()).reshape(m, 4, f.dim)
    errors = np.zeros((m, len(f.histories), 2))
    for k, history in enumerate(f.histories):
        if is_straight(history):
            continue
        if hasattr(history, "piece"):
            # |(phi - p)^(k)| <= max |omega^(k)| max |phi^(4)| / 4!, omega = prod (x - x_g), for
            # k = 0 and 1 (Shadrin, J. Approx. Theory 80, 1995); omega is a multiple of Legendre's
            # polynomial, whose slope at an end of [0, 1] is 4 * 5 times its value there
            fourth = _derivative(history, 4, begin, end) * h**4
            errors[:, k] = np.outer(fourth / 24, [NODAL, 4 * 5 * NODAL])
        elif f.variation is not None or hasattr(history, "variation"):
            function, variation = f, f.variation
            if variation is None:
                function, variation = TimeFunction.of(history, 1), partial(variations, history)
            for i, ends in enumerate(zip(begin.tolist(), end.tolist(), strict=True)):
                errors[i, k] = _by_variation(function, history, variation, *ends)
    return Interpolated(*(x[again] for x in (values, errors[..., 0], errors[..., 1])))


def _by_variation(
    f: TimeFunction, history: Any, variation: Callable[[Array], Array], a: float, b: float
) -> tuple[float, float]:
    """Both errors of a function of which only the variation is known, from samples on parts.

    On a part an error e is at most (|e| at one end + |e| at the other + its variation) / 2.
    """
    times, values = a + (b - a) * np.arange(SAMPLES + 1) / SAMPLES, f.at(a + (b - a) * GAUSS)
    e = np.linalg.norm(f.at(times) - GAUSS_TO_PARTS @ values, axis=1)
    slopes = 3 * np.linalg.norm(np.diff(TO_BERNSTEIN @ values, axis=0), axis=1)
    varies = variation(times)
    if varies.min() < -1e-9 * np.abs(values).max():  # less is what V(b) - V(a) rounds
        raise InputError(
            f"variation(a, b) of {shown(history)} must not be negative, but it is between t = "
            f"{a:g} and {b:g}; give at least the total variation"
        )
    varies = np.maximum(varies, 0.0) + slopes.max() / SAMPLES
    return float((0.5 * (e[:-1] + e[1:] + varies)).max()), float(np.sum(varies))


def increments(variation: Callable[[float], float], times: Array) -> Array:
    """v(t_{i+1}) - v(t_i) of a variation, which never falls."""
    grown = np.diff([instant(f"variation({t:g})", variation(t)) for t in times.tolist()])
    if (grown < 0).any():
        i = int(np.argmin(grown))
        raise InputError(
            f"variation must not fall, but it does between t = {times[i]:g} and {times[i + 1]:g}; "
            "give v with d_H(C(t), C(s)) <= v(t) - v(s) for s <= t"
        )
    return grown


def _derivative(history: Any, order: int, begin: Array, end: Array) -> Array:
    """A bound of |phi^(order)| on each interval; all between two breakpoints have one closed form.

    That of a product is by Leibniz's rule.
    """
    bounds = np.zeros(len(begin))
    if factors := getattr(history, "factors", ()):
        f, g = factors
        for k in range(order + 1):
            of_both = _derivative(f, k, begin, end) * _derivative(g, order - k, begin, end)
            bounds += math.comb(order, k) * of_both
        return bounds
    if order > 1 and is_straight(history):
        return bounds
    points = breakpoints([history], begin[0], end[-1])
    for some in np.split(np.arange(len(begin)), np.searchsorted(begin, points)):
        if some.size:
            a, b = begin[some], end[some]
            origin, polynomial, waves = history.piece(float(a[0]), float(b[-1]))
            bounds[some] = sum(abs(amplitude) * abs(rate) ** order for amplitude, rate, _ in waves)
            reach = np.maximum(abs(a - origin), abs(b - origin))
            for k, c in enumerate(polynomial[order:], start=order):
                bounds[some] += abs(c) * math.perm(k, order) * reach ** (k - order)
    return bounds


# ---- curves through the nodes of a run, and the forces along them -------------------------------


class Nodes(NamedTuple):
    """Nodes of a trajectory, shape (n+1, dim), and the mean velocities between them.

    Their differences would do, but rounding takes them out of cones, where sigma is infinite.
    """

    t: Array
    u: Array
    velocity: Array


CURVES = ("straight", "velocities", "nodes")
"""Straight, and cubics with the velocities at the nodes, or through four nodes: the ends of a step
and of those beside it. Where A is singular the bound adds up the variation of r. Along the last
ones that is of order two, as r goes on smoothly from step to step, along the others of order one:
for A = diag(1, 0) under a ramp, 400 steps, bounds were 38 times the error, now 1.0."""


def slopes_of_curves(nodes: Nodes, velocities: Array, chosen: Sequence[str]) -> Array:
    """Bernstein coefficients of v', shape (c, n, 3, dim), of some of CURVES through the nodes.

    The cubic through four nodes by divided differences; at both ends a parabola through three.
    """
    mean = nodes.velocity
    # the sum of the three is 3 mean; where both ends are the mean so is the middle, to the last bit
    return np.stack(
        [
            np.stack([first, mean + (mean - first) + (mean - last), last], axis=1)
            for first, last in (_slopes_at_ends(nodes, velocities, curve) for curve in chosen)
        ]
    )


def _slopes_at_ends(nodes: Nodes, velocities: Array, curve: str) -> tuple[Array, Array]:
    """v' at both ends of each step."""
    mean, h = nodes.velocity, np.diff(nodes.t)[:, None]
    if curve == "straight":
        return mean, mean
    if curve == "velocities":
        return velocities[:-1], velocities[1:]
    second = np.diff(mean, axis=0) / (h[1:] + h[:-1])
    turn = np.concatenate([second[:1], second]) if len(second) else 0 * mean
    third = np.zeros_like(mean)
    third[1:-1] = np.diff(second, axis=0) / (h[:-2] + h[1:-1] + h[2:])
    before = np.concatenate([h[:1], h[:-1]])
    return mean - h * (turn + before * third), mean + h * (turn + (h + before) * third)


def force_along(
    process: SweepingProcess,
    nodes: Nodes,
    slopes: Array,
    i: Array,
    theta: Array,
) -> Array:
    """A v' + B v at the shares theta, shape (m, k), of the steps i, where v' has these slopes."""
    force = applied(process.A, basis(2, theta) @ slopes)
    if process.B is not None:
        h = (nodes.t[i + 1] - nodes.t[i])[:, None, None]
        v = cubic(nodes.u[i], nodes.u[i + 1], h * slopes)
        force += applied(process.B, basis(3, theta) @ v)
    return force


def cubic(begin: Array, end: Array, increments: Array) -> Array:
    """Bernstein coefficients of curves, shape (m, 4, dim), from their ends and h times v'."""
    first, last = begin + increments[:, 0] / 3, end - increments[:, 2] / 3
    return np.stack([begin, first, last, end], axis=1)
