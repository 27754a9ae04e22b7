"""The one program every scheme asks for, stated once, and its certificate.

    z = argmin  1/2 <M z, z> + <q, z> + sigma(C, -z)

is strongly convex: it has exactly one solution, whatever a solver says. It is equivalent to
-z in N_C(M z + q). The certificate (MATH.md section 2) is computed from M, q and C alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from sweepopt.linalg import EPS, UNIT, Factor, euclidean
from sweepopt.sets import ROUNDING, ConvexSet, Selection, Translation, in_turn

if TYPE_CHECKING:
    import cvxpy as cp

POLISHED = 1e-12  # relative certificates above this are worth a polish


class Velocity(NamedTuple):
    """A velocity and the proof of it.

    Attributes
    ----------
    z : ndarray, shape (dim,)
        The velocity; sigma(C, -z) is finite, stuck unknowns are exactly 0.0.
    certificate : float
        >= |z - z*|_M up to rounding, from M, q and C alone; nan if the set has no proof.
    relative : float
        certificate / max(|z|_M, |M^-1 q|_M), q the full linear term; what `tol` bounds. Where it
        is below POLISHED it may be certificate / |z|_M, which is larger.
    """

    z: np.ndarray
    certificate: float
    relative: float


class Translate(NamedTuple):
    """C = c + S."""

    c: np.ndarray
    S: ConvexSet


def untranslated(C: ConvexSet) -> Translate:
    """C with all its translations taken out: it enters the program through q - C alone."""
    if not isinstance(C, Translation):
        return Translate(np.zeros(C.dim), C)
    c, S = C.v, C.part
    while isinstance(S, Translation):
        c, S = c + S.v, S.part
    return Translate(c, S)


class Expressions(NamedTuple):
    """z, the features y (None if there are none), 1/2 <M z, z> and what ties y to z."""

    z: cp.Expression
    y: cp.Expression | None
    quadratic: cp.Expression
    constraints: list[cp.Constraint]


class Statement(NamedTuple):
    """The program in cvxpy, its two parameters and its two answers."""

    problem: cp.Problem
    q: cp.Parameter
    offsets: cp.Parameter
    z: cp.Expression
    y: cp.Expression


class Canonical(NamedTuple):
    """min 1/2 <P x, x> + <map (q, offsets), x> over a fixed cone given in the solver's `data`.

    As the objective is linear in (q, offsets) the answers are its gradient: (z, y) = map^T x.
    The support function is positively homogeneous, so scaling (q, offsets) scales x.
    """

    P: sp.csc_array
    map: sp.csr_array
    data: dict[str, Any]


@dataclass(frozen=True)
class VelocityProgram:
    """min 1/2 <M z, z> + <q, z> + sigma(C, -z) for one M and all C with one cone.

    Parameters
    ----------
    M : Factor
    cone : ConvexSet
        Any member of the family; only its features are used.
    """

    M: Factor
    cone: ConvexSet
    _canonical: dict[str, Canonical] = field(default_factory=dict, init=False, compare=False)

    @cached_property
    def stiffness(self) -> float:
        """A power of two in the units of M: the geometric mean of its diagonal, nearly."""
        return math.ldexp(1.0, int(np.frexp(self.M.diagonal)[1].sum()) // self.M.dim)

    def _expressions(self) -> Expressions:
        """The program without its linear term."""
        import cvxpy as cp

        # Jacobi scaling: the solver sees a matrix of constant diagonal, whatever the units of z
        scale = np.sqrt(self.stiffness / self.M.diagonal)
        x = cp.Variable(self.M.dim)
        z = cp.multiply(scale, x)
        weights = sp.diags_array(scale) if sp.issparse(self.M.M) else np.diag(scale)
        scaled = weights @ self.M.M @ weights
        scaled = 0.5 * (scaled + scaled.T)
        features, constraints = self.cone.features(-z)
        y = cp.hstack(features) if features else None
        tied = {own.id for constraint in constraints for own in constraint.variables()} | {x.id}
        if y is not None and any(
            any(own.attributes.values()) or own.id not in tied for own in y.variables()
        ):
            # cvxpy replaces variables with attributes (nonneg=True) and drops those that nothing
            # ties (how a point splits between two points): y gets one that it keeps
            kept = cp.Variable(y.size)
            y, constraints = kept, [*constraints, kept == y]
        # M is known to be positive definite: it was factorised
        return Expressions(z, y, 0.5 * cp.quad_form(x, cp.psd_wrap(scaled)), constraints)

    @in_turn
    def statement(self) -> Statement:
        """The program with M / stiffness for M in cvxpy, so that solvers see numbers without units.

        Only the linear part of the objective has parameters (DPP).
        """
        import cvxpy as cp

        z, y, quadratic, constraints = self._expressions()
        y = cp.Constant(np.zeros(1)) if y is None else y
        q = cp.Parameter(self.M.dim)
        offsets = cp.Parameter(max(self.cone.offsets.size, 1))
        objective = quadratic / self.stiffness + q @ z + offsets @ y
        problem = cp.Problem(cp.Minimize(objective), constraints)
        return Statement(problem, q, offsets, z, y)

    @in_turn
    def canonical(self, solver: str) -> Canonical:
        """What cvxpy hands to the solver, with the linear term as a map of q and the offsets.

        The objective <q, z> + <offsets, y> is linear in cvxpy's variables, so the map is made of
        the derivatives of z and y: parameters of the size of z would cost memory of its square.
        """
        if solver not in self._canonical:
            import cvxpy as cp

            z, y, quadratic, constraints = self._expressions()
            problem = cp.Problem(cp.Minimize(quadratic), constraints)
            data, _, _ = problem.get_problem_data(solver, enforce_dpp=True)
            columns = data["param_prob"].var_id_to_col
            size = data["P"].shape[0]
            maps = [_derivative(expression, columns, size) for expression in (z, y)]
            self._canonical[solver] = Canonical(
                sp.csc_array(data["P"]), sp.csr_array(sp.hstack(maps)), data
            )
        return self._canonical[solver]

    def certify(self, q: np.ndarray, C: ConvexSet, z: np.ndarray, y: np.ndarray) -> Velocity:
        """Turn any approximate answer (z, y) into a velocity with a proven error bound.

        C gives a pair -z' in N_C(w) near the answer; then rho = M z' + q - w carries all of the
        error, and strong monotonicity of M + N_C^-1 gives |z' - z*|_M <= |rho|_{M^-1}; a set that
        is short of an exact pair by `gap` adds 2 gap under the root. Of a pair that is rounded an
        exact one is dw and dp away: then z' moves by |dp|_M, and rho by |dw|_{M^-1} + |dp|_M.
        """
        M = self.M
        pair = C.normal_pair(-z, M.apply(z, q).value, M.diagonal, y)
        if pair is None:
            return Velocity(z, float("nan"), float("nan"))
        z = 0.0 - pair.p
        # norms that cost a solve are taken only where cheaper ones do not show rounding alone
        rho, size_z, rounding = M.apply(z, q, -pair.w)
        size_rho = M.dual_norm_within(rho, POLISHED * size_z) + rounding
        certificate = math.sqrt(2 * pair.gap + size_rho**2)
        if pair.perturbation is not None:
            certificate += M.moved(*pair.perturbation)
        size_q = 0.0 if certificate <= POLISHED * size_z else M.dual_norm(q - C.anchor)
        return rate(z, certificate, size_z, size_q)

    def at_rest(self, q: np.ndarray, C: Translate) -> Velocity | None:
        """z = 0 exactly, if q is in C: nothing moves.

        A force that misses C by rounding counts as inside.
        """
        c, S = C
        few = S.selection
        if few is not None:
            shift = c if few.shift is None else few.shift + c
            return at_rest_on(q, few._replace(shift=shift), self.M.diagonal)
        force = q - c
        rests = is_rounding(force - S.nearest(force, self.M.diagonal), q, c + S.anchor)
        return Velocity(np.zeros_like(q), 0.0, 0.0) if rests else None


def at_rest_on(q: np.ndarray, few: Selection, diagonal: np.ndarray) -> Velocity | None:
    """The same where C acts on few unknowns: what acts beside them settles most steps."""
    shift = np.zeros_like(q) if few.shift is None else few.shift
    missed = q - shift
    force = missed[few.unknowns]
    missed[few.unknowns] = 0.0
    if not _is_near(missed, q, shift):
        return None
    missed[few.unknowns] = force - few.part.nearest(force, diagonal[few.unknowns])
    anchor = np.abs(shift)
    anchor[few.unknowns] += np.abs(few.part.anchor)
    return Velocity(np.zeros_like(q), 0.0, 0.0) if is_rounding(missed, q, anchor) else None


def _derivative(
    expression: cp.Expression | None, columns: dict[int, int], size: int
) -> sp.csc_array:
    """The derivative of a linear expression in the canonical variables, transposed."""
    if expression is None:
        return sp.csc_array((size, 0))
    for variable in expression.variables():
        variable.value = np.zeros(variable.shape)  # any point: the expression is linear
    rows, entries = [], expression.grad
    for variable, part in entries.items():
        part = sp.coo_array(np.atleast_2d(part) if np.isscalar(part) else part)
        moved = (part.data, (part.row + columns[variable.id], part.col))
        rows.append(sp.csc_array(moved, shape=(size, part.shape[1])))
    return sp.csc_array(sum(rows[1:], start=rows[0]))


def is_rounding(missed: np.ndarray, q: np.ndarray, anchor: np.ndarray) -> bool:
    """The rule of rest: q misses C by at most 8 rounding units of q and of C's translation.

    It holds entry by entry.
    """
    return _is_near(missed, q, anchor) and bool(
        (np.abs(missed) <= ROUNDING * (np.abs(q) + np.abs(anchor))).all()
    )


def _is_near(missed: np.ndarray, q: np.ndarray, anchor: np.ndarray) -> bool:
    """What the rule of rest implies in the Euclidean norm, which costs less to look at."""
    return bool(missed.dot(missed) <= 3 * ROUNDING**2 * (q.dot(q) + anchor.dot(anchor)))


def rate(z: np.ndarray, certificate: float, size_z: float, size_q: float) -> Velocity:
    """A velocity with its certificate in relation to max(|z|_M, |M^-1 q|_M).

    What is not exact is known to one rounding of this size at best.
    """
    size = max(size_z, size_q)
    certificate += UNIT * size if certificate else 0.0
    relative = certificate / size if size else math.inf
    return Velocity(z, certificate, float(relative) if certificate else 0.0)


def has_closed_form(M: Factor, C: ConvexSet) -> bool:
    """Whether M is diagonal and the projection in its metric is C's own (box, uniform ball)."""
    return C.exact and M.is_diagonal and np.array_equal(C.weights(M.diagonal), M.diagonal)


def closed_form(M: Factor, q: np.ndarray, C: ConvexSet) -> Velocity:
    """z = M^-1 (P_C(q) - q) for a diagonal M; the certificate is what rounding leaves."""
    missed, anchor = C.normal(q), C.anchor
    if is_rounding(missed, q, anchor):
        return Velocity(np.zeros_like(q), 0.0, 0.0)
    z = 0.0 - missed / M.diagonal
    force, shift = q / M.root, anchor / M.root
    size_z = math.sqrt(-missed.dot(z))
    # the rounding of the quotient, and of the differences that `missed` is made of
    certificate = EPS * (size_z + euclidean(force) + euclidean(shift))
    size_q = 0.0 if certificate <= ROUNDING * size_z else euclidean(force - shift)
    return rate(z, certificate, size_z, size_q)
