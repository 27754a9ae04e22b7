"""Sets that a user states in cvxpy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.checks import vector
from sweepopt.errors import EmptySetError, InputError, SweepoptError
from sweepopt.sets.base import ConvexSet, Features
from sweepopt.sets.iteration import solve_tightly
from sweepopt.sets.shapes import dimension

if TYPE_CHECKING:
    import cvxpy as cp


class Constraints(ConvexSet):
    """{ w : the cvxpy constraints that `build(w)` returns }, for sets the shapes do not cover.

    Its support function is cvxpy's conic dual. It cannot prove a solver's answer: a run on it ends
    with the status "uncertified".

    Parameters
    ----------
    dim : int
    build : callable
        Takes a cvxpy Variable of shape (dim,), returns a list of cvxpy constraints.
    """

    certifiable = False

    def __init__(self, dim: int, build: Any) -> None:
        import cvxpy as cp

        self.dim = dimension(dim)
        self.offsets = np.ones(1)
        if not callable(build):
            raise InputError("build must be a function from a cvxpy Variable to constraints")
        self.build = build
        self._w = cp.Variable(self.dim)
        self._constraints = build(self._w)
        if not isinstance(self._constraints, (list, tuple)):
            raise InputError("build must return a list of cvxpy constraints")
        for i, constraint in enumerate(self._constraints):
            if not (isinstance(constraint, cp.Constraint) and constraint.is_dcp()):
                raise InputError(f"constraint {i} of build(w) is not a convex cvxpy constraint")
            if any(parameter.value is None for parameter in constraint.parameters()):
                raise InputError(f"constraint {i} of build(w) has a parameter without a value")

    def support(self, z: np.ndarray) -> float:
        import cvxpy as cp

        z = vector("z", z, self.dim)
        size = float(np.abs(z).max()) or 1.0
        problem = self._solve(cp.Maximize((z / size) @ self._w))
        unbounded = problem.status in (cp.UNBOUNDED, cp.UNBOUNDED_INACCURATE)
        return float("inf") if unbounded else size * float(problem.value)

    def project(self, w: np.ndarray) -> np.ndarray:
        import cvxpy as cp

        w = vector("w", w, self.dim)
        self._solve(cp.Minimize(cp.sum_squares(self._w - w)))
        return np.array(self._w.value)

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        size = cp.Variable(1)
        w = cp.Variable(self.dim)
        return Features([size], [cp.suppfunc(w, self.build(w))(p) <= size])

    def witness(self, p: Any, w: Any, tau: Any, y: Any) -> None:
        return None

    def same_cone(self, other: ConvexSet) -> bool:
        # what build(w) holds cannot be compared: another object is another cone
        return self is other

    def require_nonempty(self, where: str = "C") -> None:
        import cvxpy as cp

        try:
            self._solve(cp.Minimize(0))
        except EmptySetError as error:
            raise EmptySetError(f"{where} is empty: no w satisfies the constraints") from error

    def _solve(self, objective: Any) -> Any:
        import cvxpy as cp

        problem = cp.Problem(objective, list(self._constraints))
        solve_tightly(problem)
        if problem.status in (cp.INFEASIBLE, cp.INFEASIBLE_INACCURATE):
            raise EmptySetError("Constraints has no point: no w satisfies the constraints")
        if problem.value is None:
            raise SweepoptError(f"Clarabel failed on Constraints: {problem.status}")
        return problem
