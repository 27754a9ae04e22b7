"""The one program every scheme asks for, stated once.

    z = argmin  1/2 <M z, z> + <q, z> + sigma(C, -z)

is strongly convex: it has exactly one solution, whatever a solver says. It is equivalent to
-z in N_C(M z + q) (MATH.md section 2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from sweepopt.linalg import Factor
from sweepopt.sets import ConvexSet, Similar, in_turn

if TYPE_CHECKING:
    import cvxpy as cp


class Translate(NamedTuple):
    """C = c + S."""

    c: np.ndarray
    S: ConvexSet


def untranslated(C: ConvexSet) -> Translate:
    """C with all its translations taken out: it enters the program through q - C alone."""
    c = None
    while isinstance(C, Similar) and C.v is not None:
        c, C = C.v if c is None else c + C.v, C.centred
    return Translate(np.zeros(C.dim) if c is None else c, C)


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
