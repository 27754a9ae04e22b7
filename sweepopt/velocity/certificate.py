"""The one certificate: every velocity is judged here, whoever proposed it (MATH.md section 2).

    -z in N_C(A z + B (u + gamma z)),    C = c + S

has one solution z*. For a normal pair, w in C and -z in N_C(w), let

    rho = A z + B (u + gamma z) - w.

Then |z - z*|_M <= |rho|_{M^-1}, M = A + gamma B, for M + N_C^-1 is strongly monotone; a pair that
is normal up to `gap` only adds 2 gap under the root. rho is computed from M and q = B u, which are
rounded, with a bound of what rounding hides; where that bound is no small share of what the
tolerance allows, rho is computed once more from A, B and u in twice the precision.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Matrix
from sweepopt.linalg import (
    EPS,
    NEGLIGIBLE,
    UNIT,
    Factor,
    Precise,
    dense,
    euclidean,
    exact_sum,
    product_error,
    row_sum,
)
from sweepopt.sets import ROUNDING, Box, ConvexSet

CLOSED_FORM = "closed form"  # who finds a velocity that a formula gives
SHARE = 0.1  # of the tolerance, for rounding that is bounded and not looked at more closely


class Velocity(NamedTuple):
    """A velocity, the proof of it and who found it.

    Attributes
    ----------
    z : ndarray, shape (dim,)
        The velocity; sigma(C, -z) is finite, stuck unknowns are exactly 0.0.
    certificate : float
        >= |z - z*|_M, from A, B, gamma, u and C alone; nan if the set has no proof.
    relative : float
        certificate / max(|z|_M, |M^-1 q|_M), q the full linear term; what `tol` bounds. Where
        certificate / |z|_M is below `tol` already it is that, which is larger.
    solver : str
    iterations, attempts : int
        Of the solver that found it, and how many were asked.
    """

    z: np.ndarray
    certificate: float
    relative: float
    solver: str = ""
    iterations: int = 0
    attempts: int = 0


class Instance(NamedTuple):
    """One inclusion: C = c + E^T S with E selecting unknowns, or all, and q = B u.

    Attributes
    ----------
    force : ndarray, shape (dim,)
        q - c, rounded.
    q, c : ndarray, shape (dim,)
    S : ConvexSet
    whole : ConvexSet
        E^T S.
    u : ndarray or None
        None where q is given.
    unknowns : ndarray of int or slice
        Those that S acts on.
    """

    force: np.ndarray
    q: np.ndarray
    c: np.ndarray
    S: ConvexSet
    whole: ConvexSet
    u: np.ndarray | None = None
    unknowns: Any = slice(None)


class Proposal(NamedTuple):
    """A normal pair of C = c + E^T S: -E z in N_S(w), but for a gap and for rounding.

    Attributes
    ----------
    z : ndarray, shape (dim,)
    w : ndarray, shape (m,)
        A point of S.
    unknowns : ndarray of int or slice
        What E selects.
    gap : float
        By how much the pair may fail to be normal: sigma(S, -E z) - <-E z, w> <= gap.
    perturbation : float
        Bound of what the rounding of the pair moves z and w, in |.|_M and |.|_{M^-1}.
    size : float, optional
        |M^-1 (q - c)|_M if it is known; it costs a solve.
    solver : str
    iterations : int
        Of the solver.
    """

    z: np.ndarray
    w: np.ndarray
    unknowns: Any = slice(None)
    gap: float = 0.0
    perturbation: float = 0.0
    size: float | None = None
    solver: str = ""
    iterations: int = 0


class Inclusion:
    """The data A, B and gamma of -z in N_C(A z + B (u + gamma z)), and M = A + gamma B rounded.

    Parameters
    ----------
    M : Factor
    A, B : ndarray or sparse, shape (dim, dim)
        B None where there is none; then A is M.
    gamma : float
    """

    def __init__(
        self, M: Factor, A: Matrix | None = None, B: Matrix | None = None, gamma: float = 0.0
    ) -> None:
        self.M, self._A, self._B, self._gamma = M, A, B, gamma

    def certify(self, of: Instance, pair: Proposal, tol: float) -> Velocity:
        """The velocity of a normal pair with its certificate, as sharp as `tol` needs it."""
        M, z, size = self.M, pair.z, pair.size
        force = euclidean(of.force / M.root)
        if M.is_diagonal:  # all norms are those in its units
            product = M.diagonal * z
            size_z = length = math.sqrt(z.dot(product))
            size = force
        else:
            product = M.M.dot(z)
            size_z, length = math.sqrt(max(z.dot(product), 0.0)), euclidean(M.root * z)
        allowed, metric = SHARE * tol * size_z, 1.0
        of_products = 2 * M.rounding(length, force)
        of_data = self._rounding_of_data(size_z, of.u)
        rounding = of_products + of_data
        if rounding <= allowed:
            rho = product + of.force
            rho[pair.unknowns] -= pair.w
        else:
            w = np.zeros_like(z)
            w[pair.unknowns] = pair.w
            rho = self.exact_residual(of, z, -w)
            rounding *= self._share
            metric = math.sqrt(max(1 - self.share_of_z, 0.0))
            if not metric:  # M says nothing of A + gamma B
                return Velocity(z, math.inf, math.inf)
        residual = M.dual_norm_bound(rho)
        if residual > allowed:
            residual = min(residual, M.margin * M.dual_norm(rho))
        certificate = math.sqrt(2 * pair.gap + (residual + rounding) ** 2) + pair.perturbation
        certificate /= metric
        if size is None and not certificate <= tol * size_z:
            size = M.dual_norm(of.force)
        return rated(z, certificate, max(size_z, size or 0.0) * metric, pair.solver)

    # ---- rounding ------------------------------------------------------------------------------

    def exact_residual(self, of: Instance, z: np.ndarray, *more: np.ndarray) -> np.ndarray:
        """A z + B (u + gamma z) - c + the others, rounded once."""
        A, B, gamma = self._exact_A, self._B, self._gamma
        if B is None or of.u is None:
            return self.M.precisely(z, of.q, -of.c, *more)
        terms = [*A.terms(z), *self._exact_B.terms(of.u), -of.c, *more]
        if gamma:
            terms += [*self._exact_B.terms(gamma * z), B @ product_error(gamma, z)]
        return exact_sum(terms)

    def _rounding_of_data(self, size: float, u: np.ndarray | None) -> float:
        """A bound of (A + gamma B - M) z + (B u - q) in |.|_{M^-1}, for |z|_M <= size."""
        if self._B is None or u is None:
            return 0.0
        return self.share_of_z * size + self.share_of_u * euclidean(self.M.root * u)

    @cached_property
    def share_of_u(self) -> float:
        """|B u - q|_{M^-1} as a share of |u| in units of the diagonal of M."""
        if self._B is None:
            return 0.0
        entries = np.diff(self._B.indptr).max() if sp.issparse(self._B) else len(self._B)
        M = self.M
        return UNIT * M.bound_factor * (3 + math.sqrt(entries)) * row_sum(self._B, M.root)

    @cached_property
    def share_of_z(self) -> float:
        """|(A + gamma B - M) z|_{M^-1} as a share of |z|_M."""
        if self._B is None or not self._gamma:
            return 0.0
        M = self.M
        sums = M.stretch**2 + self._gamma * row_sum(self._B, M.root)
        return UNIT * M.bound_factor**2 * sums

    @cached_property
    def _exact_A(self) -> Precise:
        return self.M.precisely if self._A is None else Precise(self._A)

    @cached_property
    def _exact_B(self) -> Precise:
        assert self._B is not None
        return Precise(self._B)

    @property
    def _share(self) -> float:
        """Of the rounding in double precision, what is left of it in `exact_residual`."""
        share = self._exact_A.share
        return share if self._B is None else max(share, self._exact_B.share)

    # ---- rest ----------------------------------------------------------------------------------

    def rests(self, of: Instance, tol: float, outside: np.ndarray | None = None) -> bool:
        """Whether q is in C, and B u as well where q may be rounded to more than a share of tol.

        Parameters
        ----------
        outside : ndarray, shape (dim,), optional
            How far q is outside of C = c + S, if that is known.
        """
        if outside is None:
            if not rests(of, of.q):
                return False
        elif not is_rounding(outside, of.q, of.c, of.whole.anchor):
            return False
        if self._B is None or of.u is None:
            return True
        root = self.M.root
        # below |M^-1 q|_M + |M^-1 c|_M, which need a solve
        forces = (euclidean(of.q / root) + euclidean(of.c / root)) / self.M.stretch
        rounding = self.share_of_u * euclidean(root * of.u)
        return rounding <= SHARE * tol * forces or self.rests_exactly(of)

    def rests_exactly(self, of: Instance) -> bool:
        """Whether B u, rounded once, is in C."""
        return of.u is not None and rests(of, self._exact_B(of.u))


def rated(z: np.ndarray, certificate: float, size: float, solver: str = "") -> Velocity:
    """A velocity whose certificate is compared to a size.

    What is not exact is known to one rounding of this size at best.
    """
    certificate += UNIT * size if certificate else 0.0
    relative = certificate / size if size else math.inf
    return Velocity(z, certificate, float(relative) if certificate else 0.0, solver)


def certify(
    M: Factor,
    q: np.ndarray,
    C: ConvexSet,
    z: np.ndarray,
    *,
    tol: float = NEGLIGIBLE,
) -> Velocity:
    """The velocity that C's normal pair near z makes of an approximate answer, with its proof.

    The program is that of M, q and C: -z in N_C(M z + q).
    """
    pair = pair_near(M, q, C, z, tol)
    if pair is None:
        return Velocity(z, math.nan, math.nan)
    pair = pair._replace(size=M.dual_norm(q - C.anchor))
    return Inclusion(M).certify(Instance(q, q, np.zeros_like(q), C, C), pair, tol)


def certify_point(M: Factor, q: np.ndarray, C: ConvexSet, z: np.ndarray, floor: float) -> Velocity:
    """z itself with its certificate: that of the normal pair near z, and how far that is from z.

    Parameters
    ----------
    floor : float
        The certificate is compared to max(|z|_M, |M^-1 q|_M), at least to this size.
    """
    near = certify(M, q, C, z)
    size = max(M.norm(z), M.dual_norm(q - C.anchor), floor)
    return rated(z, near.certificate + M.norm(z - near.z), size)


def pair_near(M: Factor, q: np.ndarray, C: ConvexSet, z: np.ndarray, tol: float) -> Proposal | None:
    """The normal pair of C near an approximate answer; None if the set has no proof."""
    force, _ = M.apply(z, q, SHARE * tol)
    pair = C.normal_pair(-z, force, M.diagonal)
    if pair is None:
        return None
    perturbation = 0.0 if pair.perturbation is None else M.moved(*pair.perturbation)
    return Proposal(0.0 - pair.p, pair.w, gap=pair.gap, perturbation=perturbation)


# ---- rest --------------------------------------------------------------------------------------


def rests(of: Instance, q: np.ndarray) -> bool:
    """Whether z = 0 for a linear term q: it is in C = c + E^T S but for rounding.

    Where S acts on few unknowns, the force beside them settles most steps.
    """
    few, outside, anchor = of.unknowns, q - of.c, of.S.anchor
    acting = outside[few]
    if of.S is not of.whole:
        outside[few] = 0.0
        if not is_near(outside, q, of.c, anchor):
            return False
    outside[few] = acting - of.S.project(acting)
    shift = np.abs(of.c)
    shift[few] += np.abs(anchor)
    return is_rounding(outside, q, shift)


def is_rounding(outside: np.ndarray, q: np.ndarray, *shifts: np.ndarray) -> bool:
    """The rule of rest: q is out of C by at most 8 rounding units of q and of C's translations.

    It holds entry by entry.
    """
    if not is_near(outside, q, *shifts):
        return False
    scale = sum(map(np.abs, shifts), start=np.abs(q))
    return bool((np.abs(outside) <= ROUNDING * scale).all())


def is_near(outside: np.ndarray, q: np.ndarray, *shifts: np.ndarray) -> bool:
    """What the rule of rest implies in the Euclidean norm, which costs less to look at."""
    squares = q.dot(q)
    for shift in shifts:
        squares += shift.dot(shift)
    return bool(outside.dot(outside) <= (2 + len(shifts)) * ROUNDING**2 * squares)


def at_rest(q: np.ndarray, solver: str = "at rest") -> Velocity:
    """Nothing moves."""
    return Velocity(np.zeros_like(q), 0.0, 0.0, solver)


# ---- one unknown -------------------------------------------------------------------------------


class OneUnknown:
    """The closed form, its certificate and the rule of rest in plain numbers: C = c + [l, u].

    Arrays of one entry would take most of the time of a step. None where rounding needs a closer
    look.
    """

    def __init__(self, inclusion: Inclusion, B: Matrix | None, S: Box, tol: float) -> None:
        self._M, self._allowed = float(inclusion.M.diagonal[0]), SHARE * tol
        self._B, self._root = 0.0 if B is None else float(dense(B)[0, 0]), math.sqrt(self._M)
        self._of_z, self._of_u = inclusion.share_of_z, inclusion.share_of_u
        self._lower, self._upper = float(S.lower[0]), float(S.upper[0])

    def __call__(self, u: float, c: float) -> Velocity | None:
        q = self._B * u
        v = q - c
        outside = v - min(max(v, self._lower), self._upper)
        forces = (abs(q) + abs(c)) / self._root
        hidden = self._root * self._of_u * abs(u)
        if abs(outside) <= ROUNDING * (abs(q) + abs(c)) < math.inf:
            return at_rest(np.zeros(1), CLOSED_FORM) if hidden <= self._allowed * forces else None
        z = 0.0 - outside / self._M
        size = max(abs(outside), abs(v)) / self._root
        certificate = EPS * (size + forces) + self._root * self._of_z * abs(z) + hidden
        if not certificate <= self._allowed * size:
            return None
        return rated(np.array([z]), certificate, size, CLOSED_FORM)
