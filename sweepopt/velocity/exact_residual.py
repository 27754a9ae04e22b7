"""The velocity of A, B and u, where a program sees their rounded sum and product.

M = A + gamma B and q = B u are rounded before any program starts. What that hides of the residual,

    d = (A + gamma B - M) z + (B u - q),

is bounded at each step, and counts as the residual of the program does, in |.|_{M^-1}. Where the
bound is no small share of the velocity (|B| / beta = 1e10, a state that is large beside its forces)
d is computed in twice the precision and goes to the linear term, until nothing of it is left.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Matrix
from sweepopt.linalg import (
    NEGLIGIBLE,
    SMALL,
    UNIT,
    Factor,
    Precise,
    dense,
    euclidean,
    product_error,
    row_sum,
    sum_error,
)
from sweepopt.problem import SweepingProcess
from sweepopt.sets import ConvexSet, Point
from sweepopt.velocity.elimination import Solved, VelocityOf, accurate
from sweepopt.velocity.interval import Interval, interval_of, velocity_in
from sweepopt.velocity.plan import Factors, Plan
from sweepopt.velocity.program import Translate, Velocity, untranslated

REFINEMENTS = 20  # corrections of the linear term; each leaves a share |M^-1 (A + gamma B - M)|
StateVelocity = Callable[[np.ndarray, ConvexSet], Solved]


def matrix(process: SweepingProcess, gamma: float) -> Matrix:
    """A + gamma B, rounded."""
    return process.A if process.B is None or not gamma else process.A + gamma * process.B


def of_state(process: SweepingProcess, plan: Plan, gamma: float, factors: Factors) -> StateVelocity:
    """Compile (u, C) -> the velocity z with -z in N_C(A z + B (u + gamma z)), certified.

    Parameters
    ----------
    process : SweepingProcess
    plan : Plan
    gamma : float
    factors : Factors
        Of `matrix(process, gamma)`.
    """
    velocity = plan.velocity(factors)
    if process.B is None:
        return lambda u, C: velocity(process.times_B(u), C)
    enough = accurate(process.dim, plan.tol)
    whole = _Unrounded(process.A, process.B, gamma, factors, velocity, enough)
    return _OfOne(whole) if process.dim == 1 and plan.solver == "auto" else whole


class _Shares(NamedTuple):
    """What rounding hides of the residual: M z as a share of |z|_M or of |z|, B u of |u|.

    The lengths of z and u are in units of the diagonal of M.
    """

    of_size: float
    of_z: float
    of_u: float


class _Unrounded:
    def __init__(
        self,
        A: Matrix,
        B: Matrix,
        gamma: float,
        factors: Factors,
        velocity: VelocityOf,
        enough: float,
    ) -> None:
        self._A, self.B, self._gamma = A, B, gamma
        self._factors, self._velocity, self.enough = factors, velocity, enough

    def __call__(self, u: np.ndarray, C: ConvexSet) -> Solved:
        q = self.B.dot(u)
        found = self._velocity(q, C)
        z, certificate, relative = found.velocity
        if not relative <= 1 and not C.singleton:  # no proof, or nothing to improve
            return found
        # at rest by a rule in units of the forces
        size = certificate / relative if relative else self._forces(q, C)
        missed = self._bound(z, u, size)
        if missed > self.enough * size:
            return self._precise(u, C, found)
        if not relative:
            return found
        velocity = Velocity(z, certificate + missed, relative + missed / size)
        return Solved(velocity, found.solver, found.iterations, found.attempts)

    def _bound(self, z: np.ndarray, u: np.ndarray, size: float) -> float:
        """At least |d|_{M^-1}, for |z|_M <= size."""
        root, shares = self.M.root, self.shares
        by_size = shares.of_size <= NEGLIGIBLE
        of_sum = shares.of_size * size if by_size else shares.of_z * euclidean(root * z)
        return of_sum + shares.of_u * euclidean(root * u)

    @cached_property
    def M(self) -> Factor:
        contact = self._factors.contact.size
        return self._factors.elimination if contact else self._factors.whole

    @cached_property
    def shares(self) -> _Shares:
        of_B = row_sum(self.B, self.M.root)
        entries = np.diff(self.B.indptr).max() if sp.issparse(self.B) else len(self.B)
        unit = UNIT * self.M.bound_factor
        of_M = unit * (self._stretch**2 + self._gamma * of_B) if self._gamma else 0.0
        of_u = unit * (3 + math.sqrt(entries)) * of_B
        return _Shares(of_M * self.M.bound_factor, of_M, of_u)

    @cached_property
    def _stretch(self) -> float:
        """|z|_M <= this times |z| in units of the diagonal of M."""
        return math.sqrt(row_sum(self.M.M, self.M.root))

    @cached_property
    def _product(self) -> Precise:
        return Precise(self.B)

    @cached_property
    def _lost(self) -> Matrix:
        """A + gamma B - M."""
        if not self._gamma:
            return 0.0 * self._A
        product = self._gamma * self.B
        return product_error(self._gamma, self.B) + sum_error(self._A, product, self.M.M)

    @cached_property
    def _share(self) -> float:
        """|M^-1/2 (A + gamma B - M) M^-1/2|: by how much the two metrics differ."""
        if not self._gamma:
            return 0.0
        M = self.M
        share = row_sum(self._lost, M.root) * M.bound_factor**2
        if share > NEGLIGIBLE and M.dim <= 10 * SMALL:
            similar = M.solve_many(dense(self._lost)) * M.root / M.root[:, None]
            share = float(np.abs(np.linalg.eigvals(similar)).max())
        return share

    def _precise(self, u: np.ndarray, C: ConvexSet, found: Solved) -> Solved:
        """The same from a linear term that is rounded once, with d of the z before in it."""
        z = np.zeros_like(u)
        # near its equilibrium a body without a set has nothing but rounding in q - c
        c, S = _split(C) if C.singleton else (z, C)
        best, left = found._replace(velocity=Velocity(z, math.inf, math.inf)), math.inf
        for attempt in range(REFINEMENTS):
            known = (self._lost @ z, -c)
            term = self._product(u, *known)
            solved = self._velocity(term, S)
            if S is C and not solved.velocity.relative:
                return solved  # at rest by the rule, which looks at q and C as they are
            z, certificate, relative = solved.velocity
            if not relative <= 1:
                break
            rest = self._product(u, self._lost @ z, -c, -term)
            size = certificate / relative if relative else self._forces(term, S)
            little = max(NEGLIGIBLE * size, certificate)
            missed = self.M.dual_norm_within(rest, 0.5 * little)
            missed += self._product.share * self._bound(z, u, size)
            velocity = self._proven(z, certificate + missed, size)
            if velocity.relative < best.velocity.relative:
                best = solved._replace(velocity=velocity)
            negligible = missed <= little
            if attempt:
                if negligible or missed > 0.5 * left:
                    break
                left = missed
            elif negligible and velocity.relative <= self.enough:
                break
            # from here on q - c is rounded once: what the two have in common cancels before that
            c, S = _split(C)
        return best

    def _forces(self, q: np.ndarray, C: ConvexSet) -> float:
        """A number below |M^-1 q|_M + |M^-1 c|_M, which need a solve."""
        root, anchor = self.M.root, C.anchor
        return (euclidean(q / root) + euclidean(anchor / root)) / self._stretch

    def _proven(self, z: np.ndarray, certificate: float, size: float) -> Velocity:
        """In the norm of A + gamma B, as far as that of M tells."""
        left = 1 - self._share
        if left <= 0:
            return Velocity(z, math.inf, math.inf)
        certificate /= math.sqrt(left)
        return Velocity(z, certificate, certificate / (size * math.sqrt(left)) if size else 0.0)


class _OfOne:
    """The same for one unknown, where C is an interval and rounding is no matter of a closer look.

    Anything else is left to `whole`.
    """

    def __init__(self, whole: _Unrounded) -> None:
        self._whole = whole
        self._shape: ConvexSet | None = None
        self._interval: Interval | None = None

    def __call__(self, u: np.ndarray, C: ConvexSet) -> Solved:
        c, S = untranslated(C)
        if S is not self._shape:
            self._shape, self._interval = S, interval_of(S)
        if self._interval is None or C.singleton:
            return self._whole(u, C)
        M, B, shares, enough = self._numbers
        state, shift = float(u[0]), float(c[0])
        q = B * state
        z, certificate, relative = velocity_in(self._interval, shift, M, q)
        root = math.sqrt(M)
        size = certificate / relative if relative else (abs(q) + abs(shift)) / root
        missed = root * (shares.of_z * abs(z) + shares.of_u * abs(state))
        if not relative <= 1 or not missed <= enough * size:
            return self._whole(u, C)
        if relative:
            certificate, relative = certificate + missed, relative + missed / size
        return Solved(Velocity(np.array([z]), certificate, relative), "closed form", 0, 0)

    @cached_property
    def _numbers(self) -> tuple[float, float, _Shares, float]:
        whole = self._whole
        return float(whole.M.diagonal[0]), float(dense(whole.B)[0, 0]), whole.shares, whole.enough


def _split(C: ConvexSet) -> Translate:
    """C = c + S; a point has its place in c, for what is in S is rounded with q."""
    c, S = untranslated(C)
    return Translate(S.anchor, Point(c)) if S.singleton else Translate(c, S)
