"""The exact velocity of a small program in 60 digits, to judge what double precision answers.

-z in N_C(M z + q) for C = c + E^T S, S a box, balls or a polyhedron: the unknowns beside E z are
eliminated, the rest is an active set that is changed until no sign and no bound is violated. The
solution is unique, so that a start from somebody's answer favours nobody.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from sweepopt.checks import Matrix
from sweepopt.errors import InputError, SweepoptError
from sweepopt.linalg import dense
from sweepopt.program import untranslated
from sweepopt.sets import Ball, Balls, Box, ConvexSet, Point
from sweepopt.study.hard import digits

TURNS = 2000  # changes of the active set
NEWTON = 15  # steps of Newton's method from one start
NOISE = 1e-45  # relative: below is rounding of 60 digits


class Exact(NamedTuple):
    """The velocity as mpmath numbers, shape (dim,), and sizes in |.|_M.

    Attributes
    ----------
    length, size : float
        |z|_M, and max(|z|_M, |M^-1 q|_M), q the full linear term.
    forces : float
        |M^-1 q|_M + |M^-1 c|_M of C = c + S, which cancel in the full linear term: rounding of
        the two is rounding of the data.
    """

    z: np.ndarray
    length: float
    size: float
    forces: float


class Program:
    """M = A + gamma B in 60 digits, for the exact velocities of many linear terms.

    Parameters
    ----------
    A, B : ndarray or sparse, shape (dim, dim)
        Small: the elimination takes dim^3 operations of a microsecond. B may be None.
    gamma : float
    """

    def __init__(self, A: Matrix, B: Matrix | None = None, gamma: float = 0.0) -> None:
        self.M = digits.exactly(dense(A))
        self._B = None if B is None else digits.exactly(dense(B))
        if self._B is not None:
            self.M = self.M + digits.exactly(gamma) * self._B
        self._eliminated: dict[bytes, _Condensed] = {}

    def term(self, u: np.ndarray) -> np.ndarray:
        """The linear term B u, as mpmath numbers."""
        u = digits.exactly(u)
        return 0 * u if self._B is None else self._B @ u

    def solve(self, q: np.ndarray, C: ConvexSet, near: np.ndarray) -> Exact:
        """The velocity for a linear term and a set, from an answer that may be near it.

        Parameters
        ----------
        q : ndarray, shape (dim,)
            Of doubles or mpmath numbers.
        C : ConvexSet
        near : ndarray, shape (dim,)

        Raises
        ------
        InputError
            If C is none of the kinds that this module knows.
        """
        if C.selection is not None:
            few, part, moved = C.selection
            shift = np.zeros(q.size) if moved is None else moved
        else:
            few, (shift, part) = np.arange(q.size), untranslated(C)
        force = digits.exactly(q) - digits.exactly(shift)
        key = few.tobytes()
        if key not in self._eliminated:
            self._eliminated[key] = _Condensed(self.M, few)
        condensed = self._eliminated[key]
        forward, pull = condensed.reduce(force)
        zeta = _small(condensed.N, pull, part, near[few])
        z = condensed.recover(forward, zeta)

        def dual(w: np.ndarray) -> float:
            return digits.root(condensed.solve(w) @ w)

        length = digits.root(z @ self.M @ z)
        return Exact(
            z,
            length,
            max(length, dual(force)),
            dual(digits.exactly(q)) + dual(digits.exactly(shift)),
        )

    def error(self, z: np.ndarray, exact: Exact) -> float:
        """|z - z*|_M."""
        apart = digits.exactly(z) - exact.z
        return digits.root(apart @ self.M @ apart)


class _Condensed:
    """L D L^T of M with the unknowns beside `few` first."""

    def __init__(self, M: np.ndarray, few: np.ndarray) -> None:
        beside = np.setdiff1d(np.arange(len(M)), few)
        self.order, self.m = np.concatenate([beside, few]), len(beside)
        self.L, self.D = digits.factor(M[np.ix_(self.order, self.order)])
        tail = self.L[self.m :, self.m :]
        self.N = (tail * self.D[self.m :]) @ tail.T

    def reduce(self, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        forward = digits.forward(self.L[: self.m, : self.m], force[self.order[: self.m]])
        pull = force[self.order[self.m :]] - self.L[self.m :, : self.m] @ forward
        return forward, pull

    def recover(self, forward: np.ndarray, zeta: np.ndarray) -> np.ndarray:
        z = np.empty(len(self.order), dtype=object)
        z[self.order[self.m :]] = zeta
        right = -forward / self.D[: self.m] - self.L[self.m :, : self.m].T @ zeta
        z[self.order[: self.m]] = digits.backward(self.L[: self.m, : self.m], right)
        return z

    def solve(self, force: np.ndarray) -> np.ndarray:
        z = np.empty(len(self.order), dtype=object)
        z[self.order] = digits.backward(self.L, digits.forward(self.L, force[self.order]) / self.D)
        return z


def _small(N: np.ndarray, q: np.ndarray, C: ConvexSet, near: np.ndarray) -> np.ndarray:
    if isinstance(C, Point):
        return digits.solve(N, digits.exactly(C.offsets) - q)
    if isinstance(C, Box):
        return _in_box(N, q, C, near)
    if isinstance(C, (Ball, Balls)):
        return _in_balls(N, q, C, near)
    return _in_polyhedron(N, q, C)


def _in_box(N: np.ndarray, q: np.ndarray, C: Box, near: np.ndarray) -> np.ndarray:
    """A primal-dual active set; one entry at a time once blocks of them go round."""
    lower, upper = digits.exactly(C.lower), digits.exactly(C.upper)
    side = -np.sign(near).astype(int)  # of its bound where an entry slips, 0 where it sticks
    pinned = C.lower == C.upper
    for turn in range(TURNS):
        free = np.flatnonzero((side != 0) | pinned)
        z = np.full(len(q), q[0] * 0, dtype=object)
        bound = np.where(side > 0, upper, lower)
        if free.size:
            z[free] = digits.solve(N[np.ix_(free, free)], bound[free] - q[free])
        w = N @ z + q
        noise = NOISE * (abs(N) @ abs(z) + abs(q))
        wanted = side.copy()
        wanted[(side * z > 0) & ~pinned] = 0
        sticks = (side == 0) & ~pinned
        wanted[np.flatnonzero(sticks & (w > upper + noise).astype(bool))] = 1
        wanted[np.flatnonzero(sticks & (w < lower - noise).astype(bool))] = -1
        changed = np.flatnonzero(wanted != side)
        if not changed.size:
            return z
        changed = changed if turn < 20 else changed[:1]
        side[changed] = wanted[changed]
    raise SweepoptError("the exact active set was not found")


def _in_polyhedron(N: np.ndarray, q: np.ndarray, C: ConvexSet) -> np.ndarray:
    """w = q - N G^T y in C with y >= 0: the most violated row enters, rows with y < 0 leave.

    Goldfarb and Idnani's dual method, Math. Programming 27 (1983), in the metric of N^-1: finite,
    whatever the rows, as those that hold w stay independent.
    """
    rows = C.rows()
    if rows is None:
        raise InputError(f"no exact velocity is known for a {type(C).__name__}")
    G, h = digits.exactly(dense(rows[0])), digits.exactly(rows[1])
    H, start, active = G @ N @ G.T, h - G @ q, np.zeros(0, dtype=int)
    y, lengths = 0 * h, np.array([digits.sqrt(x) for x in H.diagonal()])
    for _ in range(TURNS):
        slack = start + H @ y
        noise = NOISE * (abs(start) + abs(H) @ abs(y))
        violated = np.where(slack < -noise, slack / lengths, 0)
        violated[active] = 0
        new = int(np.argmin(violated))
        if not violated[new] < 0:
            return -(G.T @ y)
        while new not in active:
            shares = digits.solve(H[np.ix_(active, active)], H[active, new])
            free = H[new, new] - H[new, active] @ shares
            wanted = -slack[new] / free if free > NOISE * H[new, new] else None
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


class _Balls(NamedTuple):
    """min 1/2 <N z, z> + <force, z> + sum r_k |z_k| over blocks z_k, `places` of z."""

    N: np.ndarray
    force: np.ndarray
    radii: np.ndarray
    places: list[slice]

    def newton(self, z: np.ndarray) -> np.ndarray | None:
        """Semismooth steps on w = P_C(w - T z), one T for each ball; None if they go round."""
        N, unit = self.N, digits.exactly(np.eye(self.places[0].stop))
        for _ in range(NEWTON):
            w, dz = N @ z + self.force, -z
            size = abs(N) @ abs(z) + abs(self.force)
            J, missed, free, off = N.copy(), w * 0, np.zeros(len(z), dtype=bool), 0
            for at, r in zip(self.places, self.radii, strict=True):
                T = N[at, at].trace()
                v = w[at] - T * z[at]
                length = digits.sqrt(v @ v)
                if length > r * (1 + NOISE):
                    # of w - P(v), with I - P' divided out: what is left is symmetric
                    across = r / (length - r) * (unit - np.outer(v, v) / length**2)
                    missed[at] = w[at] - r / length * v
                    free[at] = True
                    off += int((abs(missed[at]) > NOISE * size[at]).any())
                    missed[at] += across @ missed[at]
                    J[at, at] += T * across
                else:
                    off += int(z[at].any())
            if not off:
                return z
            right = -missed[free] - N[np.ix_(free, ~free)] @ dz[~free]
            dz[free] = digits.solve(J[np.ix_(free, free)], right)
            z = z + dz
        return None

    def rounded(self, z: np.ndarray, share: Any) -> np.ndarray:
        """The minimiser with r sqrt(|z_k|^2 + e_k^2) for r |z_k|, by Newton's method with a search.

        e_k is a share of the velocity that the forces on the ball alone would cause.
        """
        e = [share * (r + digits.sqrt(self.force[at] @ self.force[at])) / self.N[at, at].trace()
             for at, r in zip(self.places, self.radii, strict=True)]  # fmt: skip

        def value(z: np.ndarray) -> Any:
            roots = [
                digits.sqrt(z[at] @ z[at] + ek**2) for at, ek in zip(self.places, e, strict=True)
            ]
            return z @ (self.N @ z) / 2 + self.force @ z + self.radii @ np.array(roots)

        now = value(z)
        for _ in range(50):
            slope, bend = self.N @ z + self.force, self.N.copy()
            for at, r, ek in zip(self.places, self.radii, e, strict=True):
                root = digits.sqrt(z[at] @ z[at] + ek**2)
                slope[at] += r / root * z[at]
                unit = digits.exactly(np.eye(len(z[at])))
                bend[at, at] += r / root * (unit - np.outer(z[at], z[at]) / root**2)
            dz = -digits.solve(bend, slope)
            gain, length = -(slope @ dz), 1.0
            while (following := value(z + length * dz)) > now - 0.1 * length * gain:
                length /= 2
                if length < 1e-12:
                    return z
            z, now = z + length * dz, following
            if gain <= NOISE * abs(now):
                break
        return z


def _in_balls(N: np.ndarray, q: np.ndarray, C: Ball | Balls, near: np.ndarray) -> np.ndarray:
    """Newton's method; where it goes round, from minimisers that come closer and closer."""
    if isinstance(C, Ball):
        center, radii, block = C.center, np.array([C.radius]), C.dim
    else:
        center, radii, block = np.zeros(C.dim), C.radii, C.block
    places = [slice(k * block, (k + 1) * block) for k in range(len(radii))]
    balls = _Balls(N, q - digits.exactly(center), digits.exactly(radii), places)
    z = digits.exactly(near)
    found = balls.newton(z)
    for count in range(1, 40):
        if found is not None:
            return found
        z = balls.rounded(z, digits.exactly(10.0**-count).item())
        found = balls.newton(z)
    raise SweepoptError("the exact active set was not found")
