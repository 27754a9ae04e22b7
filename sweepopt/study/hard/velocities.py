"""The program  -z in N_C(N z + q)  in 60 digits: an active set for each kind of set C.

A polyhedron by a dual active set, a box by a primal-dual one, balls by Newton's method; each ends
when no sign and no bound is violated, so that the answer is the only one there is.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import singledispatch
from typing import Any, NamedTuple

import numpy as np

from sweepopt.errors import InputError, SweepoptError
from sweepopt.linalg import dense
from sweepopt.sets import Ball, Balls, Box, ConvexSet, Point
from sweepopt.study.hard import digits

CHANGES = 2000  # changes of the active set
NEWTON = 15  # steps of Newton's method from one start
ROUNDING = 1e-45  # relative: of 60 digits, the rest is for condition numbers


@singledispatch
def velocity(C: ConvexSet, N: np.ndarray, q: np.ndarray, near: np.ndarray) -> np.ndarray:
    """z with -z in N_C(N z + q), from one that may be near it.

    For rows w = q - N G^T y in C with y >= 0: the most violated row enters, rows with y < 0 leave
    (Goldfarb and Idnani's dual method, Math. Programming 27, 1983, in the metric of N^-1: finite,
    whatever the rows, as those that hold w stay independent).
    """
    rows = C.rows()
    if rows is None:
        raise InputError(f"no exact velocity is known for a {type(C).__name__}")
    G, h = digits.exactly(dense(rows[0])), digits.exactly(rows[1])
    H, start, active = G @ N @ G.T, h - G @ q, np.zeros(0, dtype=int)
    y, lengths = 0 * h, np.array([digits.sqrt(x) for x in H.diagonal()])
    for _ in range(CHANGES):
        slack = start + H @ y
        noise = ROUNDING * (abs(start) + abs(H) @ abs(y))
        violated = np.where(slack < -noise, slack / lengths, 0)
        violated[active] = 0
        new = int(np.argmin(violated))
        if not violated[new] < 0:
            return -(G.T @ y)
        while new not in active:
            shares = digits.solve(H[np.ix_(active, active)], H[active, new])
            free = H[new, new] - H[new, active] @ shares
            wanted = -slack[new] / free if free > ROUNDING * H[new, new] else None
            falling = active[(shares > 0).astype(bool)]
            limits = y[falling] / shares[(shares > 0).astype(bool)]
            last = int(np.argmin(limits)) if falling.size else -1
            if wanted is None and last < 0:
                raise SweepoptError("C has no point")
            whole = last < 0 or (wanted is not None and wanted <= limits[last])
            length = wanted if whole else limits[last]
            y[active] -= length * shares
            y[new] += length
            slack = start + H @ y
            if whole:
                active = np.append(active, new)
            else:
                y[falling[last]] *= 0
                active = active[active != falling[last]]
    raise SweepoptError("the exact active set was not found")


@velocity.register
def _(C: Point, N: np.ndarray, q: np.ndarray, near: np.ndarray) -> np.ndarray:
    return digits.solve(N, digits.exactly(C.project(np.zeros(C.dim))) - q)


@velocity.register
def _(C: Box, N: np.ndarray, q: np.ndarray, near: np.ndarray) -> np.ndarray:
    """A primal-dual active set; one entry at a time once blocks of them go round."""
    lower, upper = digits.exactly(C.lower), digits.exactly(C.upper)
    side = -np.sign(near).astype(int)  # of its bound where an entry slips, 0 where it sticks
    pinned = C.lower == C.upper
    for count in range(CHANGES):
        free = np.flatnonzero((side != 0) | pinned)
        z = np.full(len(q), q[0] * 0, dtype=object)
        bound = np.where(side > 0, upper, lower)
        if free.size:
            z[free] = digits.solve(N[np.ix_(free, free)], bound[free] - q[free])
        w = N @ z + q
        noise = ROUNDING * (abs(N) @ abs(z) + abs(q))
        wanted = side.copy()
        wanted[(side * z > 0) & ~pinned] = 0
        sticks = (side == 0) & ~pinned
        wanted[np.flatnonzero(sticks & (w > upper + noise).astype(bool))] = 1
        wanted[np.flatnonzero(sticks & (w < lower - noise).astype(bool))] = -1
        changed = np.flatnonzero(wanted != side)
        if not changed.size:
            return z
        changed = changed if count < 20 else changed[:1]
        side[changed] = wanted[changed]
    raise SweepoptError("the exact active set was not found")


class _Balls(NamedTuple):
    """min 1/2 <N z, z> + <force, z> + sum r_k |z_k| over blocks z_k, `places` of z."""

    N: np.ndarray
    force: np.ndarray
    radii: np.ndarray
    places: list[slice]

    @property
    def balls(self) -> Iterator[tuple[slice, Any]]:
        return zip(self.places, self.radii, strict=True)

    def newton(self, z: np.ndarray) -> np.ndarray | None:
        """Semismooth Newton steps on w = P_C(w - T z), T a number for each ball; None if they go
        round."""
        N, unit = self.N, digits.exactly(np.eye(self.places[0].stop))
        for _ in range(NEWTON):
            w, dz = N @ z + self.force, -z
            size = abs(N) @ abs(z) + abs(self.force)
            J, residual, free, violated = N.copy(), w * 0, np.zeros(len(z), dtype=bool), False
            for at, r in self.balls:
                T = N[at, at].trace()
                v = w[at] - T * z[at]
                length = digits.sqrt(v @ v)
                if length > r * (1 + ROUNDING):
                    # of w - P(v), with I - P' divided out: what is left is symmetric
                    across = r / (length - r) * (unit - np.outer(v, v) / length**2)
                    residual[at] = w[at] - r / length * v
                    violated |= bool((abs(residual[at]) > ROUNDING * size[at]).any())
                    residual[at] += across @ residual[at]
                    J[at, at] += T * across
                    free[at] = True
                else:
                    violated |= bool(z[at].any())
            if not violated:
                return z
            right = -residual[free] - N[np.ix_(free, ~free)] @ dz[~free]
            dz[free] = digits.solve(J[np.ix_(free, free)], right)
            z = z + dz
        return None

    def rounded(self, z: np.ndarray, s: np.ndarray, share: Any) -> tuple[np.ndarray, np.ndarray]:
        """The minimiser with r sqrt(|z_k|^2 + e_k^2) for r |z_k|, and s_k, the slopes of that.

        e_k is a share of the velocity that the forces on the ball alone would cause. Newton's
        method on both, s_k sqrt(|z_k|^2 + e_k^2) = r z_k, with a line search: with z alone it
        crawls where e is small (Andersen, Christiansen, Conn and Overton, SIAM J. Sci. Comput. 22,
        2000).
        """
        e = [
            share * (r + digits.sqrt(self.force[at] @ self.force[at])) / self.N[at, at].trace()
            for at, r in self.balls
        ]

        def roots(z: np.ndarray) -> np.ndarray:
            pairs = zip(self.places, e, strict=True)
            return np.array([digits.sqrt(z[at] @ z[at] + ek**2) for at, ek in pairs])

        def value(z: np.ndarray) -> Any:
            return z @ (self.N @ z) / 2 + self.force @ z + self.radii @ roots(z)

        unit = digits.exactly(np.eye(self.places[0].stop))
        now = value(z)
        for _ in range(50):
            pull, bend = 0 * z, 0 * self.N
            for (at, r), root in zip(self.balls, roots(z), strict=True):
                turn = np.outer(s[at], z[at]) / root**2
                pull[at] = r / root * z[at]
                bend[at, at] = r / root * unit - (turn + turn.T) / 2
            slope = self.N @ z + self.force + pull
            dz = -digits.solve(self.N + bend, slope)
            gain, length = -(slope @ dz), 1.0
            while (following := value(z + length * dz)) > now - 0.1 * length * gain:
                length /= 2
                if length < 1e-12:
                    return z, s
            s = pull + bend @ dz
            for at, r in self.balls:
                s[at] = s[at] * min(1, r / digits.sqrt(s[at] @ s[at])) if s[at].any() else s[at]
            z, now = z + length * dz, following
            if gain <= ROUNDING * abs(now):
                break
        return z, s


@velocity.register
def _(C: Ball, N: np.ndarray, q: np.ndarray, near: np.ndarray) -> np.ndarray:
    return _in_balls(N, q - digits.exactly(C.center), np.array([C.radius]), near)


@velocity.register
def _(C: Balls, N: np.ndarray, q: np.ndarray, near: np.ndarray) -> np.ndarray:
    return _in_balls(N, q, C.radii, near)


def _in_balls(N: np.ndarray, q: np.ndarray, radii: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Newton's method; where it goes round, from minimisers that come closer and closer."""
    block = len(q) // len(radii)
    places = [slice(k * block, (k + 1) * block) for k in range(len(radii))]
    program = _Balls(N, q, digits.exactly(radii), places)
    z = digits.exactly(near)
    s = 0 * z
    for count in range(1, 40):
        minimiser = program.newton(z)
        if minimiser is not None:
            return minimiser
        z, s = program.rounded(z, s, digits.exactly(10.0**-count).item())
    raise SweepoptError("the exact active set was not found")
