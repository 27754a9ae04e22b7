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
from typing import NamedTuple

import numpy as np

from sweepopt.problem import (
    DERIVATIVE,
    GAUSS,
    TO_BERNSTEIN,
    WEIGHTS,
    Between,
    Grid,
    Motion,
    Norms,
    SweepingProcess,
    increments,
    motion,
)
from sweepopt.results.nodes import Nodes, cubic, force_along, slopes_of_curves
from sweepopt.sets import ConvexSet, basis, products, to_bernstein
from sweepopt.velocity import VelocityOf

THIRDS = to_bernstein(np.array([0.0, 0.5, 1.0]))
CHUNK = 2_000_000  # numbers that the points of some steps may take


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
    near: Nodes,
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
        # translates of a bounded set are as far apart as their centres
        bounded = math.isfinite(moved.shape.magnitude())
        known = replace(moved, center=replace(moved.center, variation=variation))
        moved = known if bounded else None
    slopes = slopes_of_curves(process, phi, near)
    if moved is not None and moved.scale.function is None:
        return _best(_of_motion(process, norms, near, slopes, moved), norms.still)
    if variation is not None and not norms.still:
        return _of_variation(process, norms, near, slopes[-1], variation)
    return _sampled(process, phi, norms, near, slopes[0 if norms.still else -1])


def _best(found: list[Defects], still: bool) -> Defects:
    """On each step the curve that misses least: all go through the nodes."""
    gaps, squares, sup, bent, slopes = (
        np.array(part) for part in zip(*(one[:5] for one in found), strict=True)
    )
    cost = gaps + squares
    if still:  # the bound is about sum bent + sqrt(sum gaps)
        cost = bent + gaps / (math.sqrt(float(gaps.min(axis=0).sum())) or 1.0)
    choice, step = np.argmin(cost, axis=0), np.arange(cost.shape[1])
    gaps, squares, sup, bent, slopes = (
        part[choice, step] for part in (gaps, squares, sup, bent, slopes)
    )
    return Defects(gaps, squares, sup, bent, slopes, found[0].known)


def _of_motion(
    process: SweepingProcess, norms: Norms, near: Nodes, slopes: list[np.ndarray], moved: Motion
) -> list[Defects]:
    """Bounds of both integrals for data: intervals without a kink, many of them at once."""
    n, dim = near.velocity.shape
    zeros = np.zeros((len(slopes), 4, n))
    found = [
        Defects(rows[0], rows[1], rows[2], rows[3], x, moved.known)
        for rows, x in zip(zeros, slopes, strict=True)
    ]
    whole = moved.grid(near.t)
    per = max(CHUNK // (30 * dim), 1)
    for start in range(0, len(whole.step), per):
        grid = Grid(*(x[start : start + per] for x in whole))
        load = moved.on(grid)
        for total in found:
            part = _on_intervals(process, norms, near, total.slopes, moved, grid, load)
            np.add.at(total.gaps, grid.step, part.gaps)
            np.add.at(total.squares, grid.step, part.squares)
            np.add.at(total.bent, grid.step, part.bent)
            np.maximum.at(total.sup, grid.step, part.sup)
    return found


def _on_intervals(
    process: SweepingProcess,
    norms: Norms,
    near: Nodes,
    slopes: np.ndarray,
    moved: Motion,
    grid: Grid,
    load: tuple[Between, Between],
) -> Defects:
    """int 2 G, int |r|^2, sup |r|, int |r'| on each interval.

    The curve in S has the Bernstein coefficients of (A v' + B v - center - tau v') / scale,
    projected on S: S is convex, so the curve stays in it. Any tau > 0 will do: where v rests and
    nothing is outside, nothing is missed, and where v moves s is pushed to where it is normal.
    """
    i, a, b = grid
    center, scale = load
    h, length = near.t[i + 1] - near.t[i], b - a
    begin, share = (a - near.t[i]) / h, length / h
    theta = begin[:, None] + share[:, None] * GAUSS
    pull = force_along(process, near, slopes, i, theta) - center.values
    size = np.broadcast_to(scale.values, pull.shape)
    aim = pull - norms.weights(moved.shape, h)[:, None] * (basis(2, theta) @ slopes[i])
    wanted = TO_BERNSTEIN @ np.divide(aim, size, out=np.zeros_like(aim), where=size > 0)
    if norms.still:
        # at the ends without tau v', which jumps there: r must be continuous
        ends = TO_BERNSTEIN[[0, -1]] @ pull
        last = TO_BERNSTEIN[[0, -1]] @ size
        wanted[:, [0, -1]] = np.divide(ends, last, out=np.zeros_like(ends), where=last > 0)
    if not moved.scale.constant:  # a moving scale times a line has degree 5
        wanted = wanted[:, [0, -1]]
    s = np.array([moved.shape.project(w) for w in wanted.reshape(-1, wanted.shape[-1])])
    s = s.reshape(wanted.shape)
    r = pull - scale.values * (basis(s.shape[1] - 1, GAUSS) @ s)

    reach = (TO_BERNSTEIN @ scale.values).max(axis=1)
    rest, turn = norms.terms(moved.center, center)
    if scale.away.any():
        reach += scale.away @ np.abs([f for _, f in moved.scale.terms])
        more = norms.scaled(moved.scale, s)
        rest, turn = rest + (scale.away * more).sum(axis=1), turn + (scale.bent * more).sum(axis=1)
    gaps, away = _gaps_along_curves(norms, moved.shape, slopes[i], (begin, share), s, reach)
    rest = rest + away / math.sqrt(norms.beta)
    # Minkowski: what the polynomials are away from the load adds up in the norm
    squares = length * (np.sqrt(norms.dual(r) ** 2 @ WEIGHTS) + rest) ** 2
    sup, bent = np.zeros((2, len(i)))
    if norms.still:
        sup = norms.dual(TO_BERNSTEIN @ r).max(axis=1) + rest
        # at the ends the curve in S jumps by what the load is away from its polynomial
        bent = np.sqrt(norms.dual(DERIVATIVE @ r) ** 2 @ WEIGHTS) + turn + 2 * rest
    return Defects(2 * length * gaps, squares, sup, bent, slopes, True)


def _gaps_along_curves(
    norms: Norms,
    S: ConvexSet,
    slopes: np.ndarray,
    where: tuple[np.ndarray, np.ndarray],
    s: np.ndarray,
    reach: np.ndarray,
) -> np.ndarray:
    """The mean of G on each interval, and how far the curve in C(t) was moved for it, shape (2, m).

    G <= sup scale * (sigma(S, -v') + <v', s>), a scale of several entries inside the parentheses.
    """
    begin, share = where
    whole = share == 1
    ends = basis(2, begin[:, None] + share[:, None] * np.array([0.0, 0.5, 1.0])) @ slopes
    p = -np.where(whole[:, None, None], slopes, THIRDS @ ends) * reach[:, None]
    if S.selection is not None:
        few, S, shift = S.selection
        p, s = p[..., few], s[..., few] - (0.0 if shift is None else shift[few])
    most = reach.max(axis=1)
    # where A = 0 the curve must be continuous: no arcs
    ratios = np.full(len(p), math.inf) if norms.still else most**2 / norms.beta
    each = map(S.gap_along_curve, p, s, ratios.tolist())
    gaps, away = np.array(list(each)).T
    return np.array([gaps, most * away])


def _of_variation(
    process: SweepingProcess,
    norms: Norms,
    near: Nodes,
    slopes: np.ndarray,
    variation: Callable[[float], float],
) -> Defects:
    """w(t) is the point of C(t) nearest to the chord of two projections."""
    h, n = np.diff(near.t), len(near.t) - 1
    members = [process.C.at(t) for t in near.t.tolist()]
    force = force_along(process, near, slopes, np.arange(n), np.zeros((n, 1)))[:, 0]
    last = force_along(process, near, slopes, np.array([n - 1]), np.ones((1, 1)))[:, 0]
    nodes = zip(members, np.concatenate([force, last]), strict=True)
    w = np.array([C.project(f) for C, f in nodes])
    v = increments(variation, near.t)
    gaps = np.zeros(n)
    for i in range(n):
        each = [[members[k].gap(-x, w[k]) for k in (i, i + 1)] for x in slopes[i]]
        # moving by v changes sigma(C, x) and <x, w> by |x| v at most
        speed = np.linalg.norm(slopes[i], axis=1).mean()
        gaps[i] = np.sum(products(2, 1) * np.array(each)) + 2 * speed * v[i]
    theta = np.broadcast_to(GAUSS, (n, len(GAUSS)))
    chord = (1 - theta)[..., None] * w[:-1, None] + theta[..., None] * w[1:, None]
    r = norms.dual(force_along(process, near, slopes, np.arange(n), theta) - chord)
    squares = h * (np.sqrt(r**2 @ WEIGHTS) + v / math.sqrt(norms.beta)) ** 2
    return Defects(2 * h * gaps, squares, np.zeros(n), np.zeros(n), slopes, True)


def _sampled(
    process: SweepingProcess, phi: VelocityOf, norms: Norms, near: Nodes, slopes: np.ndarray
) -> Defects:
    """One program at each Gauss point: delta = Phi(t, v) - v'."""
    h, n = np.diff(near.t), len(near.t) - 1
    gaps, squares, sup, bent = np.zeros((4, n))
    curves = cubic(near.u[:-1], near.u[1:], h[:, None, None] * slopes)
    for i in range(n):
        velocity, v = basis(2, GAUSS) @ slopes[i], basis(3, GAUSS) @ curves[i]
        q = [process.times_B(x) for x in v]
        sets = [process.C.at(t) for t in (near.t[i] + h[i] * GAUSS).tolist()]
        found = np.array([phi(*one).velocity.z for one in zip(q, sets, strict=True)])
        if not norms.still:
            squares[i] = h[i] * (norms.A(found - velocity) ** 2 @ WEIGHTS)
            continue
        # phi projects B v on C(t): w = B v + B z, so that r = -B z
        each = zip(sets, velocity, q, found, strict=True)
        pull = [C.gap(-x, f + process.times_B(y)) for C, x, f, y in each]
        gaps[i] = 2 * h[i] * float(np.array(pull) @ WEIGHTS)
        sup[i] = norms.A(found).max()
        bent[i] = norms.A(np.diff(found, axis=0)).sum()
    return Defects(gaps, squares, sup, bent, slopes, False)
