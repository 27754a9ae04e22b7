"""The one certificate: every velocity is judged here, whoever proposed it (MATH.md section 2).

    -z in N_C(A z + B (u + gamma z)),    C = c + S

has one solution z*. For a normal pair, w in C and -z in N_C(w), let

    rho = A z + B (u + gamma z) - w.

Then |z - z*|_M <= |rho|_{M^-1}, M = A + gamma B, for M + N_C^-1 is strongly monotone; a pair that
is normal up to `gap` only adds 2 gap under the root. rho is computed from M and q = B u, which are
rounded, with a bound of what rounding hides; where that bound is no small share of what the
tolerance allows, rho is computed once more from A, B and u in twice the precision.
"""

import math
from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from sweepopt.checks import Array, Matrix
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
    rounding_weights,
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
    w : ndarray, shape (dim,), optional
        The point of C with which the program ended: of path "cones" and where nothing is proved.
    at_rounding : bool
        Whether more than `tol` is what rounds in its normal pair, as in sets that hardly overlap:
        no other solver does better.
    """

    z: Array
    certificate: float
    relative: float
    solver: str = ""
    iterations: int = 0
    attempts: int = 0
    w: Array | None = None
    at_rounding: bool = False


class Instance(NamedTuple):
    """One inclusion: C = c + E^T S with E selecting unknowns, or all, and q = B u.

    Attributes
    ----------
    force : ndarray, shape (dim,)
        q - c, rounded.
    q, c : ndarray, shape (dim,)
    S : ConvexSet
    u : ndarray or None
        None where q is given.
    unknowns : ndarray of int or slice
        Those that S acts on.
    """

    force: Array
    q: Array
    c: Array
    S: ConvexSet
    u: Array | None = None
    unknowns: Any = slice(None)

    def projection(self, force: Array) -> Array:
        """The point of E^T S nearest to a force."""
        w = np.zeros(force.size)
        w[self.unknowns] = self.S.project(force[self.unknowns])
        return w

    def rests(self) -> bool:
        """Whether z = 0: q is in C but for rounding."""
        few, size = self.force[self.unknowns], self.force.dot(self.force)
        # what S does not act on; a sum of a million squares rounds less than 1e-9
        if size - few.dot(few) > self.most_at_rest**2 + 1e-9 * size:
            return False
        return self.is_rounding(self.force - self.projection(self.force))

    @property
    def most_at_rest(self) -> float:
        """A bound of the length of what `is_rounding` allows."""
        squares = sum(x.dot(x) for x in (self.q, self.c, self.S.shift_sizes))
        return 3 * ROUNDING * math.sqrt(squares)

    def is_rounding(self, outside: Array) -> bool:
        """The rule of rest: q is out of C by at most 8 rounding units of q and of C's translations.

        Centres are translations too. It holds entry by entry; `outside` is how far q is out of C,
        up to signs.
        """
        scale = np.abs(self.q) + np.abs(self.c)
        scale[self.unknowns] += self.S.shift_sizes
        return is_rounding(outside, scale)


class Proposal(NamedTuple):
    """A normal pair of C - c: -z in N_{C - c}(w), but for a gap and for rounding.

    Attributes
    ----------
    z : ndarray, shape (dim,)
    w : ndarray, shape (dim,)
        A point of C - c.
    gap : float
        By how much the pair may fail to be normal: sigma(C - c, -z) - <-z, w> <= gap.
    perturbation : float
        Bound of what the rounding of the pair moves z and w, in |.|_M and |.|_{M^-1}.
    size : float, optional
        |M^-1 (q - c)|_M if it is known; it costs a solve.
    iterations : int
        Of the solver.
    """

    z: Array
    w: Array
    gap: float = 0.0
    perturbation: float = 0.0
    size: float | None = None
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
        self.M, self._A, self.B, self.gamma = M, A, B, gamma

    def certify(self, of: Instance, pair: Proposal, tol: float) -> Velocity:
        """The velocity of a normal pair with its certificate, as sharp as `tol` needs it."""
        M, z, size = self.M, pair.z, pair.size
        product = M.M.dot(z)
        size_z = math.sqrt(max(z.dot(product), 0.0))
        allowed, of_z = SHARE * tol * max(size_z, size or 0.0), 0.0
        force = euclidean(of.force / M.root)
        rounding = self.rounding(of, z, force)
        if rounding <= allowed:
            rho = product + of.force - pair.w
        else:
            rho = self.exact_residual(of, z, -pair.w)
            rounding *= max(one.share for one in self._exact)
            of_z = M.margin - 1 if self.gamma else 0.0
        residual = M.dual_norm_bound(rho)
        if residual > allowed:
            residual = min(residual, M.margin * M.dual_norm(rho))
        certificate = math.sqrt(2 * pair.gap + (residual + rounding) ** 2) + pair.perturbation
        certificate += UNIT * force / M.stretch if certificate else 0.0  # w is rounded
        metric = math.sqrt(1 - of_z)  # |z|_M^2 may be so much larger than that in A + gamma B
        certificate = certificate / metric if metric else math.inf
        if size is None and not certificate <= tol * size_z:
            size = M.dual_norm(of.force)
        size = max(size_z, size or 0.0) * metric
        at_rounding = math.inf > pair.perturbation > max(tol * size, 0.5 * certificate)
        return rated(z, certificate, size)._replace(at_rounding=at_rounding)

    def closed_form(self, of: Instance, tol: float) -> Velocity | None:
        """z = M^-1 (w - q + c) for a diagonal M, w the projection of q - c, or rest.

        Rounding is all that the certificate is made of; None where it needs a closer look.
        """
        M, outside = self.M, of.force - of.projection(of.force)
        if of.is_rounding(outside):
            return at_rest(of.q, CLOSED_FORM) if self.knows_rest(of, tol) else None
        z = 0.0 - outside / M.diagonal
        force = euclidean(of.force / M.root)
        size, rounding = max(math.sqrt(-z.dot(outside)), force), self.rounding(of, z, force)
        rounding += ROUNDING * euclidean(of.S.shift_sizes / M.root[of.unknowns]) / M.stretch
        return rated(z, rounding, size, CLOSED_FORM) if rounding <= SHARE * tol * size else None

    # ---- rounding ------------------------------------------------------------------------------

    def rounding(self, of: Instance, z: Array, force: float) -> float:
        """A bound in |.|_{M^-1} of what rounds in M z + q - c, and of M and q themselves.

        Parameters
        ----------
        force : float
            |q - c| in units of the diagonal of M.
        """
        rounding = 2 * self.M.rounding(z, force)
        if of.u is not None:  # B u - q, and gamma B z in M z
            rounding += self.rounding_of_B(of.u) + self.gamma * self.rounding_of_B(z)
        return rounding

    def exact_residual(self, of: Instance, z: Array, *more: Array) -> Array:
        """A z + B (u + gamma z) - c + the others, rounded once."""
        if of.u is None:
            return self.M.precisely(z, of.q, -of.c, *more)
        (A, B), change = self._exact, self.gamma * z
        state = of.u + change
        added = state - of.u
        # what is rounded of u + gamma z (Knuth's two-sum)
        error = (of.u - (state - added)) + (change - added) + product_error(self.gamma, z)
        return exact_sum([*A.terms(z), *B.terms(state, error), -of.c, *more])

    @cached_property
    def _exact(self) -> tuple[Precise, ...]:
        """A and B, or M where there is no B."""
        if self.B is None or self._A is None:
            return (self.M.precisely,)
        return Precise(self._A), Precise(self.B)

    def rounding_of_B(self, u: Array) -> float:
        """A bound of |B u - q|_{M^-1}, without a solve."""
        return UNIT * self.M.bound_factor * euclidean(self._weights_of_B * u)

    @cached_property
    def _weights_of_B(self) -> Any:
        return 0.0 if self.B is None else rounding_weights(self.B, self.M.root)

    # ---- rest ----------------------------------------------------------------------------------

    def rests(self, of: Instance, tol: float) -> bool:
        """Whether q is in C, and B u as well where q may be rounded to more than a share of tol."""
        return of.rests() and (self.knows_rest(of, tol) or self.rests_exactly(of))

    def knows_rest(self, of: Instance, tol: float) -> bool:
        """Whether the rounding of q = B u is less than a share of tol."""
        if of.u is None:
            return True
        root = self.M.root
        # below |M^-1 q|_M + |M^-1 c|_M, which need a solve
        forces = (euclidean(of.q / root) + euclidean(of.c / root)) / self.M.stretch
        return self.rounding_of_B(of.u) <= SHARE * tol * forces

    def rests_exactly(self, of: Instance) -> bool:
        """Whether B u, rounded once, is in C."""
        if of.u is None:
            return False
        q = self._exact[-1](of.u)
        return of._replace(q=q, force=q - of.c).rests()


def rated(z: Array, certificate: float, size: float, solver: str = "") -> Velocity:
    """A velocity whose certificate is compared to a size.

    What is not exact is known to one rounding of this size at best.
    """
    certificate += UNIT * size if certificate else 0.0
    relative = certificate / size if size else float(certificate) * math.inf  # nan stays nan
    return Velocity(z, certificate, float(relative) if certificate else 0.0, solver)


def of_fixed_point(
    velocity: Velocity, before: Velocity, distance: float, contraction: float
) -> Velocity:
    """An iterate z of a fixed-point iteration T with a proof of its distance to the fixed point z*.

    With c the certificate of z as T(z_before) and theta < 1 the contraction of T,
    |z - z*| <= (theta |z - z_before| + c) / (1 - theta), as |T(z_before) - z*| <= theta (|z_before
    - z| + |z - z*|). The work is that of both.
    """
    certificate, relative, total = velocity.certificate, velocity.relative, math.inf
    if contraction < 1:
        total = (contraction * distance + certificate) / (1 - contraction)
    if certificate:  # the size that it was compared to
        relative *= total / certificate
    elif total:
        relative = math.inf
    return velocity._replace(
        certificate=total,
        relative=relative,
        iterations=velocity.iterations + before.iterations,
        attempts=velocity.attempts + before.attempts,
    )


def certify(M: Factor, q: Array, C: ConvexSet, z: Array) -> Velocity:
    """The velocity that C's normal pair near z makes of an approximate answer, with its proof.

    The program is that of M, q and C: -z in N_C(M z + q).
    """
    pair = pair_near(M, q, C, z, NEGLIGIBLE)
    if pair is None:  # no proof, or one that rounding hides
        none = math.inf if C.certifiable else math.nan
        return Velocity(z, none, none)
    pair = pair._replace(size=M.dual_norm(q - C.anchor))
    return Inclusion(M).certify(Instance(q, q, np.zeros_like(q), C), pair, NEGLIGIBLE)


def certify_point(M: Factor, q: Array, C: ConvexSet, z: Array, floor: float) -> Velocity:
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
    M: Factor,
    q: Array,
    C: ConvexSet,
    z: Array,
    tol: float,
    size: float | None = None,
    force: Array | None = None,
) -> Proposal | None:
    """The normal pair of C near an approximate answer; None if the set has no proof.

    tol is that of the certificate, beside |z|_M or a larger size; force is M z + q, if it is known.
    """
    if force is None:
        force, _ = M.apply(z, q, SHARE * tol, size or 0.0)
    pair = C.normal_pair(-z, force, M.diagonal)
    if pair is None:
        return None
    perturbation = 0.0
    if pair.perturbation is not None:
        w, p = pair.perturbation
        perturbation = M.dual_norm_bound(w) + 2 * M.stretch * euclidean(M.root * p)
    return Proposal(0.0 - pair.p, pair.w, gap=pair.gap, perturbation=perturbation)


# ---- rest --------------------------------------------------------------------------------------


def is_rounding(outside: Array, scale: Array) -> bool:
    """Whether each entry is at most 8 rounding units of its scale."""
    return (np.abs(outside) <= ROUNDING * scale).all()


def at_rest(q: Array, solver: str = "at rest") -> Velocity:
    """Nothing moves."""
    return Velocity(np.zeros_like(q), 0.0, 0.0, solver)


def unsolved(of: Instance) -> Velocity:
    """What every answer is better than."""
    return Velocity(np.zeros(of.force.size), math.inf, math.inf)


# ---- one unknown -------------------------------------------------------------------------------


def one_unknown(
    inclusion: Inclusion, S: Box, tol: float
) -> Callable[[float, float], Velocity | None]:
    """(u, c) -> the closed form, its certificate and the rule of rest in plain numbers.

    C = c + [l, u]. Arrays of one entry would take most of the time of a step. None where rounding
    needs a closer look.
    """
    M, B = float(inclusion.M.diagonal[0]), inclusion.B
    stiffness, root = 0.0 if B is None else float(dense(B)[0, 0]), math.sqrt(M)
    of_u, gamma = inclusion.rounding_of_B(np.ones(1)), inclusion.gamma
    lower, upper, allowed = float(S.lower[0]), float(S.upper[0]), SHARE * tol

    def velocity(u: float, c: float) -> Velocity | None:
        q = stiffness * u
        v = q - c
        outside = v - min(max(v, lower), upper)
        forces = (abs(q) + abs(c)) / root
        hidden = of_u * abs(u)
        if abs(outside) <= ROUNDING * (abs(q) + abs(c)) < math.inf:
            return at_rest(np.zeros(1), CLOSED_FORM) if hidden <= allowed * forces else None
        z = 0.0 - outside / M
        size = max(abs(outside), abs(v)) / root
        certificate = EPS * (size + forces) + of_u * gamma * abs(z) + hidden
        if not certificate <= allowed * size:
            return None
        return rated(np.array([z]), certificate, size, CLOSED_FORM)

    return velocity
