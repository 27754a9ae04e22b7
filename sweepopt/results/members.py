"""Chords of a C(t) made of sets that move separately by data, by sums, images, & and products.

Each of these is inside of, or around, a set whose data are straight between the times of a grid:

    c~ + d a + (r~ - d) S  in  c + r S  in  c~ - d a + (r~ + d) S,    d = f + (f |a| + e) / rho,

with e >= |c - c~|, f >= |r - r~| and a ball of radius rho around a in S: (f + d) S has a ball of
radius (f + d) rho around (f + d) a. The operations keep inclusions, and chords between their sets.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from operator import add
from typing import Any

import numpy as np

from sweepopt.checks import Array
from sweepopt.errors import EmptySetError
from sweepopt.problem import TimeFunction, motion
from sweepopt.results.interpolation import chord_errors
from sweepopt.sets import Chords, ConvexSet, ball_inside

Member = Callable[[int, int], ConvexSet]


def moves_by_data(C: Any) -> bool:
    """Whether C(t) is made of sets that move by data."""
    moving = motion(C)
    functions = [f for f in (moving.center, moving.offsets, *(r for r, _ in moving.summands)) if f]
    if moving.summands:
        return all(f.bounded for f in functions)
    return C.of_members is not None and all(map(moves_by_data, C.operands))


def chords(C: Any, times: Array, v: Array, c: float) -> Chords:
    """Of C(t) between the times, through the points next to v; `Chords.through` raises."""
    made = _made(C, times)
    inside, around = ([made(k, side) for k in range(len(times))] for side in (1, -1))
    return Chords.through(inside, around, v, c)


def _made(C: Any, times: Array) -> Member:
    """A member at the time k: inside of C(t) for side 1, around it for side -1."""
    if motion(C).summands:
        return _straight(C, times)
    of_members: Any = C.of_members
    each = {id(D): _made(D, times) for D in C.operands}
    return lambda k, side: of_members(lambda D: each[id(D)](k, side))


def _straight(C: Any, times: Array) -> Member:
    """Of one set that moves by data."""
    moving = motion(C)
    if moving.offsets is not None:
        shape: Any = moving.summands[0][1]
        h, off = moving.offsets.at(times), _chord_errors(moving.offsets, times, np.abs)
        return lambda k, side: shape.member(h[k] - side * off[k])
    center, off = moving.center.at(times), _chord_errors(moving.center, times, np.linalg.norm)
    shift, scaled = np.zeros_like(center), []
    for r, S in moving.summands:
        d = _chord_errors(r, times, np.linalg.norm)
        if d.any() or off.any():
            a, rho = ball_inside(S)
            if not rho:
                raise EmptySetError("a part is flat")
            d = d + (d * np.linalg.norm(a) + off) / rho
            shift, off = shift + np.outer(d, a), np.zeros_like(off)
        scaled.append((r.at(times)[:, 0], d, S))

    def member(k: int, side: int) -> ConvexSet:
        sizes = [r[k] - side * d[k] for r, d, _ in scaled]
        if min(sizes) < 0:
            raise EmptySetError("a scale is next to 0")
        parts = (size * S for size, (*_, S) in zip(sizes, scaled, strict=True))
        return reduce(add, parts) + (center[k] + side * shift[k])

    return member


def _chord_errors(f: TimeFunction, times: Array, size: Callable[[Array], Any]) -> Array:
    """A bound of sup |f - its chord| on both sides of each time, in sizes of the terms' vectors."""
    if f.terms:
        each = [chord_errors(phi, times) for phi, _ in f.terms]
        errors = np.column_stack(each) @ np.array([size(v) for _, v in f.terms])
    else:
        errors = np.zeros((len(times) - 1, *np.shape(size(np.zeros(f.dim)))))
    return np.maximum(np.concatenate([errors[:1], errors]), np.concatenate([errors, errors[-1:]]))
