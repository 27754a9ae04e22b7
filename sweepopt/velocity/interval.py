"""One unknown: C is an interval, and z a formula in plain numbers. Arrays of one entry are slow."""

from __future__ import annotations

import math
from typing import NamedTuple

from sweepopt.linalg import EPS, UNIT
from sweepopt.sets import ROUNDING, Box, ConvexSet


class Interval(NamedTuple):
    """[lower, upper], the bounds may be infinite."""

    lower: float
    upper: float


def interval_of(C: ConvexSet) -> Interval | None:
    """A set that says where its one interval ends, None for others.

    Examples
    --------
    >>> from sweepopt.sets import Orthant
    >>> interval_of(2.0 * Box([-1.5], [1.5])), interval_of(Orthant(1))
    (Interval(lower=-3.0, upper=3.0), Interval(lower=0.0, upper=inf))
    >>> interval_of(Box([-1.0, -1.0], [1.0, 1.0]))
    """
    if C.dim > 1 or not isinstance(C, Box):
        return None
    return Interval(float(C.lower[0]), float(C.upper[0]))


def velocity_in(C: Interval, c: float, M: float, q: float) -> tuple[float, float, float]:
    """z with -z in N_{c + C}(M z + q), its certificate and that in relation to its size.

    The same as `program.closed_form` in plain numbers. All are nan where a number is not finite.

    Examples
    --------
    >>> velocity_in(Interval(-1.0, 1.0), 0.0, 2.0, 4.0)[0]
    -1.5
    """
    v = q - c
    missed = v - min(max(v, C.lower), C.upper)
    if abs(missed) <= ROUNDING * (abs(q) + abs(c)) < math.inf:
        return 0.0, 0.0, 0.0
    root = math.sqrt(M)
    size_z = abs(missed) / root
    certificate = EPS * (size_z + (abs(q) + abs(c)) / root)
    size = size_z if certificate <= ROUNDING * size_z else max(size_z, abs(v) / root)
    certificate += UNIT * size
    return 0.0 - missed / M, certificate, certificate / size if size else math.inf
