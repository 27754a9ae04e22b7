"""What a curve through the nodes of a run misses of the sweeping process, step by step.

For the curve v and a selection w(t) in C(t) this gives int 2 G and int |r|^2 on every step,
r = A v' + B v - w and G = sigma(C(t), -v') + <v', w> (`certificate` has the theorem). Where C(t) is
data, w(t) = center(t) + scale(t) s(t) with s a curve in S between the projections at the nodes, and
both integrals are bounds; a C(t) of which only its variation is known costs 2 |v'| more in G; and
of any other C(t) they are sampled.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from sweepopt.motion import DERIVATIVE, GAUSS, TO_BERNSTEIN, WEIGHTS, Data, Motion, motion
from sweepopt.norms import Norms
from sweepopt.process import SweepingProcess
from sweepopt.sets.base import QUADRATIC_LINEAR
from sweepopt.sets.curves import basis
from sweepopt.velocity import VelocityOf

CHUNK = 2_000_000  # numbers that the points of some steps may take


class Path(NamedTuple):
    """Nodes of a trajectory, shape (n+1, dim), and the mean velocities between them."""

    t: np.ndarray
    u: np.ndarray
    velocity: np.ndarray


class Defects(NamedTuple):
    """What a curve misses on each step, shape (n,).

    Attributes
    ----------
    gaps, squares : ndarray
        int 2 G and int |r|^2.
    sup, bent : ndarray
        sup |r| and int |r'|, where A = 0; else zero.
    slopes : ndarray, shape (n, 3, dim)
        Bernstein coefficients of v'.
    known : bool
        Whether the integrals are bounds and not sampled values.
    """

    gaps: np.ndarray
    squares: np.ndarray
    sup: np.ndarray
    bent: np.ndarray
    slopes: np.ndarray
    known: bool


def defects(
    process: SweepingProcess,
    phi: VelocityOf,
    norms: Norms,
    near: Path,
    variation: Callable[[float], float] | None,
) -> Defects:
    """The defects of the curve through the nodes of `near`.

    Parameters
    ----------
    phi : callable (q, C) -> Solved
        The velocity for M = A (B where A = 0); its answers are not trusted.
    variation : callable or None
        v with d_H(C(t), C(s)) <= v(t) - v(s) for s <= t.
    """
    moved = motion(process.C)
    if moved is not None and variation is not None and not moved.center.known:
        moved = replace(moved, center=replace(moved.center, variation=variation))
    if moved is not None and moved.scale.function is None:
        return _of_motion(process, phi, norms, near, moved)
    if variation is not None and not norms.still:
        return _of_variation(process, phi, norms, near, variation)
    return _sampled(process, phi, norms, near)


def _node_velocities(
    process: SweepingProcess, phi: VelocityOf, near: Path, still: bool
) -> np.ndarray:
    """Slopes at the nodes, shape (n+1, dim): Phi(t_i, u_i); none where A = 0."""
    z = np.zeros_like(near.u)
    if not still:
        for i, t in enumerate(near.t.tolist()):
            z[i] = phi(process.times_B(near.u[i]), process.C.at(t)).velocity.z
    return z


def _cubic_slopes(z: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Bernstein coefficients of v' for a cubic v, shape (n, 3, dim)."""
    return np.stack([z[:-1], 3 * mean - z[:-1] - z[1:], z[1:]], axis=1)


def _of_motion(
    process: SweepingProcess, phi: VelocityOf, norms: Norms, near: Path, moved: Motion
) -> Defects:
    t, h, n = near.t, np.diff(near.t), len(near.t) - 1
    z = _node_velocities(process, phi, near, norms.still)
    centers, scales = moved.center.at(t), moved.scale.at(t)
    grid = _grid(moved, t)
    reach = _reach(moved.scale, grid, n)
    s = np.zeros_like(z)
    for i in range(n + 1):
        w = process.times_B(near.u[i]) + process.A @ z[i] - centers[i]
        scale = np.broadcast_to(scales[i], w.shape)
        s[i] = moved.shape.project(np.divide(w, scale, out=np.zeros_like(w), where=scale > 0))
    unknowns, part = slice(None), moved.shape
    if moved.shape.selection is not None:
        unknowns, part, _ = moved.shape.selection
    few = s[:, unknowns]

    def between(slopes: np.ndarray) -> Defects:
        gaps, away = np.zeros((2, n))
        for i, x in enumerate(slopes):
            most = float(np.max(reach[i]))
            # where A = 0 the curve in S must be continuous: a chord
            ratio = math.inf if norms.still else most**2 / norms.beta
            gap, arc = part.companion(-(reach[i] * x)[:, unknowns], few[i : i + 2], ratio)
            gaps[i], away[i] = 2 * h[i] * gap, most * arc / math.sqrt(norms.beta)
        residuals = _residuals(process, norms, near, slopes, moved, s, grid, away)
        return Defects(gaps, *residuals, slopes, moved.known)

    straight = between(np.repeat(near.velocity[:, None], 3, axis=1))
    return straight if norms.still else _smaller(between(_cubic_slopes(z, near.velocity)), straight)


def _smaller(one: Defects, two: Defects) -> Defects:
    """On each step the curve that misses less: both go through the nodes."""
    first = one.gaps + one.squares <= two.gaps + two.squares
    arrays = [
        np.where(np.reshape(first, (-1,) + (1,) * (a.ndim - 1)), a, b)
        for a, b in zip(one[:5], two[:5], strict=True)
    ]
    return Defects(*arrays, one.known)


class _Grid(NamedTuple):
    """Intervals inside the steps: the step of each, and its ends."""

    step: np.ndarray
    begin: np.ndarray
    end: np.ndarray


def _grid(moved: Motion, t: np.ndarray) -> _Grid:
    cuts = [moved.grid(a, b) for a, b in zip(t[:-1].tolist(), t[1:].tolist(), strict=True)]
    step = np.repeat(np.arange(len(cuts)), [len(cut) - 1 for cut in cuts])
    return _Grid(
        step, np.concatenate([cut[:-1] for cut in cuts]), np.concatenate([cut[1:] for cut in cuts])
    )


def _reach(scale: Data, grid: _Grid, n: int) -> np.ndarray:
    """A bound of scale(t) on each step, shape (n, 1) or (n, dim)."""
    between = scale.on(grid.begin, grid.end)
    upper = (TO_BERNSTEIN @ between.values).max(axis=1)
    if between.away.any():
        upper += between.away @ np.abs([f for _, f in scale.terms])
    reach = np.zeros((n, upper.shape[1]))
    np.maximum.at(reach, grid.step, upper)
    return reach


def _residuals(
    process: SweepingProcess,
    norms: Norms,
    near: Path,
    slopes: np.ndarray,
    moved: Motion,
    s: np.ndarray,
    grid: _Grid,
    away: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """int |r|^2, and where A = 0 sup |r| and int |r'|, on each step."""
    n, dim = near.velocity.shape
    squares, sup, bent = np.zeros((3, n))
    size = np.array([norms.dual(f) for _, f in moved.center.terms])
    if moved.center.function is not None:
        size = np.array([1 / math.sqrt(norms.beta)])
    per = max(CHUNK // (12 * dim), 1)
    for start in range(0, len(grid.step), per):
        i, a, b = (x[start : start + per] for x in grid)
        h = near.t[i + 1] - near.t[i]
        theta = (a - near.t[i])[:, None] / h[:, None] + (b - a)[:, None] / h[:, None] * GAUSS
        force = _force(process, near, slopes, i, theta)
        center, scale = moved.center.on(a, b), moved.scale.on(a, b)
        chord = (1 - theta)[..., None] * s[i, None] + theta[..., None] * s[i + 1, None]
        r = force - center.values - scale.values * chord
        rest, turn = center.away @ size, center.bent @ size
        if scale.away.any():
            ends = [norms.dual(f * s) for _, f in moved.scale.terms]
            most = np.array([np.maximum(e[i], e[i + 1]) for e in ends]).T
            rest += (scale.away * most).sum(axis=1)
            turn += ((scale.bent + scale.away) * 3 * most).sum(axis=1)
        rest = rest + away[i]
        lengths = b - a
        size_r = norms.dual(r)
        # Minkowski: what the polynomials are away from the load adds up in the norm
        np.add.at(squares, i, lengths * (np.sqrt(size_r**2 @ WEIGHTS) + rest) ** 2)
        if norms.still:
            np.maximum.at(sup, i, norms.dual(TO_BERNSTEIN @ r).max(axis=1) + rest)
            slope = norms.dual(DERIVATIVE @ r)  # times the length
            np.add.at(bent, i, np.sqrt(slope**2 @ WEIGHTS) + turn)
    return squares, sup, bent


def _force(
    process: SweepingProcess,
    near: Path,
    slopes: np.ndarray,
    i: np.ndarray,
    theta: np.ndarray,
) -> np.ndarray:
    """A v' + B v at the shares theta, shape (m, k), of the steps i."""
    velocity = basis(2, theta) @ slopes[i]
    force = _apply(process.A, velocity)
    if process.B is not None:
        h = (near.t[i + 1] - near.t[i])[:, None, None]
        force += _apply(process.B, basis(3, theta) @ cubic(near.u[i], near.u[i + 1], h * slopes[i]))
    return force


def cubic(begin: np.ndarray, end: np.ndarray, increments: np.ndarray) -> np.ndarray:
    """Bernstein coefficients of curves, shape (m, 4, dim), from their ends and h times v'."""
    first, last = begin + increments[:, 0] / 3, end - increments[:, 2] / 3
    return np.stack([begin, first, last, end], axis=1)


def _apply(M: Any, x: np.ndarray) -> np.ndarray:
    return (M @ x.reshape(-1, x.shape[-1]).T).T.reshape(x.shape)


def _of_variation(
    process: SweepingProcess,
    phi: VelocityOf,
    norms: Norms,
    near: Path,
    variation: Callable[[float], float],
) -> Defects:
    """w(t) is the point of C(t) nearest to the chord of two projections."""
    h, n = np.diff(near.t), len(near.t) - 1
    z = _node_velocities(process, phi, near, norms.still)
    members = [process.C.at(t) for t in near.t.tolist()]
    w = np.array(
        [
            C.project(process.times_B(u) + process.A @ velocity)
            for C, u, velocity in zip(members, near.u, z, strict=True)
        ]
    )
    v = np.diff([float(variation(t)) for t in near.t.tolist()])
    slopes = _cubic_slopes(z, near.velocity)
    gaps = np.zeros(n)
    for i in range(n):
        each = [[members[k].gap(-x, w[k]) for k in (i, i + 1)] for x in slopes[i]]
        # moving by v changes sigma(C, x) and <x, w> by |x| v at most
        speed = np.linalg.norm(slopes[i], axis=1).mean()
        gaps[i] = np.sum(QUADRATIC_LINEAR * np.array(each)) + 2 * speed * v[i]
    theta = np.broadcast_to(GAUSS, (n, len(GAUSS)))
    chord = (1 - theta)[..., None] * w[:-1, None] + theta[..., None] * w[1:, None]
    r = norms.dual(_force(process, near, slopes, np.arange(n), theta) - chord)
    squares = h * (np.sqrt(r**2 @ WEIGHTS) + v / math.sqrt(norms.beta)) ** 2
    return Defects(2 * h * gaps, squares, np.zeros(n), np.zeros(n), slopes, True)


def _sampled(process: SweepingProcess, phi: VelocityOf, norms: Norms, near: Path) -> Defects:
    """One program at each Gauss point: delta = Phi(t, v) - v'."""
    h, n = np.diff(near.t), len(near.t) - 1
    z = _node_velocities(process, phi, near, norms.still)
    straight = np.repeat(near.velocity[:, None], 3, axis=1)
    slopes = straight if norms.still else _cubic_slopes(z, near.velocity)
    gaps, squares, sup, bent = np.zeros((4, n))
    for i in range(n):
        velocity = basis(2, GAUSS) @ slopes[i]
        v = basis(3, GAUSS) @ cubic(near.u[i, None], near.u[i + 1, None], h[i] * slopes[i : i + 1])[0]
        times = near.t[i] + h[i] * GAUSS
        q = [process.times_B(x) for x in v]
        sets = [process.C.at(t) for t in times.tolist()]
        found = np.array([phi(*one).velocity.z for one in zip(q, sets, strict=True)])
        if not norms.still:
            squares[i] = h[i] * (norms.A(found - velocity) ** 2 @ WEIGHTS)
            continue
        # phi projects B v on C(t): B v + B z, so that r = -B z
        pull = [C.support(-x) + x @ (f + process.times_B(y))
                for C, x, f, y in zip(sets, velocity, q, found, strict=True)]  # fmt: skip
        gaps[i] = 2 * h[i] * float(np.maximum(pull, 0.0) @ WEIGHTS)
        sup[i] = norms.A(found).max()
        bent[i] = norms.A(np.diff(found, axis=0)).sum()
    return Defects(gaps, squares, sup, bent, slopes, False)
