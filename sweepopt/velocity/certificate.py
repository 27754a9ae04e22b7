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
from sweepopt.sets import ROUNDING, Box, ConvexSet, Selection

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


class LinearTerm(NamedTuple):
    """The linear term q - c of the program for C = c + S.

    Attributes
    ----------
    force : ndarray, shape (dim,)
        q - c, rounded.
    q, c : ndarray, shape (dim,)
    u : ndarray or None
        The state with q = B u; None where q is given.
    """

    force: np.ndarray
    q: np.ndarray
    c: np.ndarray
    u: np.ndarray | None = None


class Proposal(NamedTuple):
    """A normal pair of C = c + S: -z in N_C(c + w), w zero beside some unknowns.

    Attributes
    ----------
    z : ndarray, shape (dim,)
    w : ndarray, shape (m,)
        A point of S on `unknowns`.
    unknowns : ndarray of int or slice
    gap : float
        By how much the pair may fail to be normal: sigma(S, -z) + <z, w> <= gap.
    moved : float
        Bound of what the rounding of the pair moves z and w, in |.|_M and |.|_{M^-1}.
    """

    z: np.ndarray
    w: np.ndarray
    unknowns: Any
    gap: float = 0.0
    moved: float = 0.0


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

    @cached_property
    def _condensed(self) -> Factor:
        """N = (E M^-1 E^T)^-1, if M is factorised for the elimination of other unknowns."""
        return Factor(self.M.N)  # type: ignore[attr-defined]

    def certify(
        self, term: LinearTerm, found: Proposal, tol: float, *, size: float | None = None
    ) -> Velocity:
        """The velocity of a normal pair with its certificate, as sharp as `tol` needs it.

        Parameters
        ----------
        size : float, optional
            |M^-1 (q - c)|_M if it is known; it costs a solve.
        """
        M, z, few = self.M, found.z, found.unknowns
        product = M.diagonal * z if M.is_diagonal else M.M.dot(z)
        size_z = math.sqrt(max(z.dot(product), 0.0))
        allowed = SHARE * tol * size_z
        of_products = 2 * M.rounding(z, term.force)
        of_data = self._hidden_bound(term, z, size_z)
        rounding, metric = of_products + of_data, 1.0
        if rounding <= allowed:
            rho = product + term.force
            rho[few] -= found.w
        else:
            w = np.zeros_like(z)
            w[few] = found.w
            rho = self.exact_residual(term, z, -w)
            rounding = M.precisely.share * of_products
            rounding += self._product.share * of_data if of_data else 0.0
            metric = math.sqrt(max(1 - self._metric_error, 0.0))
        residual = self._dual_norm(rho, few, allowed) + rounding
        certificate = math.sqrt(2 * found.gap + residual**2) + found.moved
        if not metric:  # M says nothing of A + gamma B
            return Velocity(z, math.inf, math.inf)
        certificate /= metric
        if size is None and not certificate <= tol * size_z:
            size = M.dual_norm(term.force)
        size_z = max(size_z, size or 0.0)
        return rated(z, certificate, size_z * metric)

    # ---- the residual and its rounding ---------------------------------------------------------

    def _hidden_bound(self, term: LinearTerm, z: np.ndarray, size: float) -> float:
        """A bound of (A + gamma B - M) z + (B u - q) in |.|_{M^-1}, for |z|_M <= size."""
        if self._B is None or term.u is None:
            return 0.0
        shares = self._shares
        by_size = shares.of_size <= NEGLIGIBLE
        of_M = shares.of_size * size if by_size else shares.of_z * euclidean(self.M.root * z)
        return of_M + self.rounding_of_force(term.u)

    def rounding_of_force(self, u: np.ndarray | None) -> float:
        """A bound of |B u - q|_{M^-1}."""
        if self._B is None or u is None:
            return 0.0
        return self._shares.of_u * euclidean(self.M.root * u)

    def exact_residual(self, term: LinearTerm, z: np.ndarray, *more: np.ndarray) -> np.ndarray:
        """A z + B (u + gamma z) - c + the others, rounded once."""
        if self._B is None or term.u is None:
            return self.M.precisely(z, term.q, -term.c, *more)
        hidden = self._product(term.u, -term.q)
        return self.M.precisely(z, term.q, -term.c, hidden, self._hidden @ z, *more)

    def exact_force(self, u: np.ndarray) -> np.ndarray:
        """B u, rounded once."""
        return self._product(u)

    def forces(self, q: np.ndarray, c: np.ndarray) -> float:
        """A number below |M^-1 q|_M + |M^-1 c|_M, which need a solve."""
        root = self.M.root
        return (euclidean(q / root) + euclidean(c / root)) / self._stretch

    def _dual_norm(self, rho: np.ndarray, few: Any, enough: float) -> float:
        """A bound of |rho|_{M^-1}; the cheapest one that is at most `enough`.

        On the few unknowns that are not eliminated it is a norm of few entries: |E^T r|_{M^-1} is
        |r|_{N^-1}.
        """
        M = self.M
        bound = M.dual_norm_bound(rho)
        if bound > enough and few is getattr(M, "unknowns", None):
            beside = rho.copy()
            beside[few] = 0.0
            on_few = M.margin * self._condensed.dual_norm(rho[few])
            bound = min(bound, on_few + M.dual_norm_bound(beside))
        return bound if bound <= enough else min(bound, M.margin * M.dual_norm(rho))

    @cached_property
    def _shares(self) -> _Shares:
        B, root, factor = self._B, self.M.root, self.M.bound_factor
        assert B is not None
        of_B = row_sum(B, root)
        entries = np.diff(B.indptr).max() if sp.issparse(B) else len(B)
        of_M = UNIT * factor * (self._stretch**2 + self._gamma * of_B) if self._gamma else 0.0
        of_u = UNIT * factor * (3 + math.sqrt(entries)) * of_B
        return _Shares(of_M * factor, of_M, of_u)

    @cached_property
    def _stretch(self) -> float:
        """|z|_M <= this times |z| in units of the diagonal of M."""
        return math.sqrt(row_sum(self.M.M, self.M.root))

    @cached_property
    def _product(self) -> Precise:
        assert self._B is not None
        return Precise(self._B)

    @cached_property
    def _hidden(self) -> Matrix:
        """A + gamma B - M."""
        assert self._A is not None
        assert self._B is not None
        if not self._gamma:
            return 0.0 * self._A
        product = self._gamma * self._B
        return product_error(self._gamma, self._B) + sum_error(self._A, product, self.M.M)

    @cached_property
    def _metric_error(self) -> float:
        """|M^-1/2 (A + gamma B - M) M^-1/2|: by how much the two metrics differ."""
        if self._B is None or not self._gamma:
            return 0.0
        M = self.M
        share = row_sum(self._hidden, M.root) * M.bound_factor**2
        if share > NEGLIGIBLE and M.dim <= 10 * SMALL:
            similar = M.solve_many(dense(self._hidden)) * M.root / M.root[:, None]
            share = float(np.abs(np.linalg.eigvals(similar)).max())
        return share


class _Shares(NamedTuple):
    """What rounding hides of the residual: M z as a share of |z|_M or of |z|, B u of |u|.

    The lengths of z and u are in units of the diagonal of M.
    """

    of_size: float
    of_z: float
    of_u: float


def rated(z: np.ndarray, certificate: float, size: float) -> Velocity:
    """A velocity whose certificate is compared to a size.

    What is not exact is known to one rounding of this size at best.
    """
    certificate += UNIT * size if certificate else 0.0
    relative = certificate / size if size else math.inf
    return Velocity(z, certificate, float(relative) if certificate else 0.0)


def certify(
    M: Factor,
    q: np.ndarray,
    C: ConvexSet,
    z: np.ndarray,
    y: np.ndarray | None = None,
    *,
    tol: float = NEGLIGIBLE,
) -> Velocity:
    """The velocity that C's normal pair near (z, y) makes of an approximate answer, with its proof.

    The program is that of M, q and C: -z in N_C(M z + q).
    """
    pair = pair_near(M, q, C, z, np.zeros(C.offsets.size) if y is None else y, tol)
    if pair is None:
        return Velocity(z, math.nan, math.nan)
    term = LinearTerm(q, q, np.zeros_like(q))
    size = M.dual_norm(q - C.anchor)
    return Inclusion(M).certify(term, pair, tol, size=size)


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


def pair_near(
    M: Factor, q: np.ndarray, C: ConvexSet, z: np.ndarray, y: np.ndarray, tol: float
) -> Proposal | None:
    """The normal pair of C near an approximate answer; None if the set has no proof."""
    force = M.apply(z, q, enough=SHARE * tol).value
    pair = C.normal_pair(-z, force, M.diagonal, y)
    if pair is None:
        return None
    moved = 0.0 if pair.perturbation is None else M.moved(*pair.perturbation)
    return Proposal(0.0 - pair.p, pair.w, slice(None), pair.gap, moved)


# ---- rest --------------------------------------------------------------------------------------


def rests(
    q: np.ndarray, c: np.ndarray, S: ConvexSet, few: Selection | None, diagonal: np.ndarray
) -> bool:
    """Whether z = 0: q is in C = c + S but for rounding, `few` the selection of C if it has one.

    Where C acts on few unknowns, the force beside them settles most steps.
    """
    force = q - c
    if few is None:
        return is_rounding(force - S.nearest(force, diagonal), q, c + S.anchor)
    on_few = force[few.unknowns]
    force[few.unknowns] = 0.0
    if not _is_near(force, q, c):
        return False
    force[few.unknowns] = on_few - few.part.nearest(on_few, diagonal[few.unknowns])
    anchor = np.abs(c)
    anchor[few.unknowns] += np.abs(few.part.anchor)
    return is_rounding(force, q, anchor)


def is_rounding(outside: np.ndarray, q: np.ndarray, anchor: np.ndarray) -> bool:
    """The rule of rest: q is out of C by at most 8 rounding units of q and of C's translation.

    It holds entry by entry.
    """
    return _is_near(outside, q, anchor) and bool(
        (np.abs(outside) <= ROUNDING * (np.abs(q) + np.abs(anchor))).all()
    )


def _is_near(outside: np.ndarray, q: np.ndarray, anchor: np.ndarray) -> bool:
    """What the rule of rest implies in the Euclidean norm, which costs less to look at."""
    return bool(outside.dot(outside) <= 3 * ROUNDING**2 * (q.dot(q) + anchor.dot(anchor)))


def at_rest(q: np.ndarray, solver: str = "at rest") -> Velocity:
    """Nothing moves."""
    return Velocity(np.zeros_like(q), 0.0, 0.0, solver)


# ---- one unknown -------------------------------------------------------------------------------


class OneUnknown:
    """The closed form, its certificate and the rule of rest in plain numbers: C = c + [l, u].

    Arrays of one entry would take most of the time of a step. None where rounding needs a closer
    look.
    """

    def __init__(self, inclusion: Inclusion, B: float, S: Box, tol: float) -> None:
        shares = inclusion._shares if inclusion._B is not None else _Shares(0.0, 0.0, 0.0)
        self._M, self._B, self._allowed = float(inclusion.M.diagonal[0]), B, SHARE * tol
        self._root = math.sqrt(self._M)
        self._of_z, self._of_u = shares.of_z, shares.of_u
        self._lower, self._upper = float(S.lower[0]), float(S.upper[0])

    def __call__(self, u: float, c: float) -> Velocity | None:
        q = self._B * u
        v = q - c
        outside = v - min(max(v, self._lower), self._upper)
        forces = (abs(q) + abs(c)) / self._root
        hidden = self._root * self._of_u * abs(u)
        if abs(outside) <= ROUNDING * (abs(q) + abs(c)) < math.inf:
            return at_rest(np.zeros(1), "closed form") if hidden <= self._allowed * forces else None
        z = 0.0 - outside / self._M
        size = max(abs(outside), abs(v)) / self._root
        certificate = EPS * (size + forces) + self._root * self._of_z * abs(z) + hidden
        if not certificate <= self._allowed * size:
            return None
        certificate += UNIT * size
        return Velocity(np.array([z]), certificate, certificate / size, "closed form")
