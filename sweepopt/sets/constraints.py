"""Sets that a user states in cvxpy."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.alone import in_turn
from sweepopt.checks import vector
from sweepopt.errors import EmptySetError, InputError, SweepoptError
from sweepopt.sets.base import ConvexSet, Features, binary
from sweepopt.sets.iteration import solve_in_own_units
from sweepopt.sets.shapes import dimension

if TYPE_CHECKING:
    import cvxpy as cp


class Constraints(ConvexSet):
    """{ w : the cvxpy constraints that `build(w)` returns }, for sets the shapes do not cover.

    Its support function is cvxpy's conic dual. It cannot prove a solver's answer: a run on it ends
    with the status "uncertified".

    Its programs are solved in units of the largest constant of the constraints and of w, and are
    as accurate as that: write cp.norm(w) <= r, not cp.sum_squares(w) <= r**2, for a small r. In the
    program of a velocity cvxpy hides these units from the solver, so that other than for all other
    sets they matter: measure forces in units in which C is of the size 1.

    Parameters
    ----------
    dim : int
    build : callable
        Takes a cvxpy Variable of shape (dim,), returns a list of cvxpy constraints.

    Raises
    ------
    InputError
        If build fails or returns anything but convex constraints with finite data.
    EmptySetError
        From `project`, `support` and `require_nonempty`, if no w satisfies them.

    Examples
    --------
    >>> import cvxpy as cp
    >>> C = Constraints(2, lambda w: [cp.norm(w, 1) <= 1])
    >>> round(C.support([3.0, 4.0]), 6)
    4.0
    """

    certifiable = exact = False

    @in_turn
    def __init__(self, dim: int, build: Any) -> None:
        import cvxpy as cp

        self.dim = dimension(dim)
        if not callable(build):
            raise InputError("build must be a function from a cvxpy Variable to constraints")
        self.build = build
        self._w = cp.Variable(self.dim)
        try:
            self._constraints = build(self._w)
        except Exception as error:  # whatever a user's function raises
            raise InputError(f"build(w) raised {type(error).__name__}: {error}") from error
        if not isinstance(self._constraints, (list, tuple)):
            raise InputError("build must return a list of cvxpy constraints")
        for i, constraint in enumerate(self._constraints):
            if not (isinstance(constraint, cp.Constraint) and constraint.is_dcp()):
                raise InputError(f"constraint {i} of build(w) is not a convex cvxpy constraint")
            if any(not np.isfinite(c.value.sum()) for c in constraint.constants()):
                raise InputError(f"constraint {i} of build(w) holds a number that is not finite")
            if any(
                v.attributes["integer"] or v.attributes["boolean"] for v in constraint.variables()
            ):
                raise InputError(f"constraint {i} of build(w) has an integer variable: not convex")
            if any(parameter.value is None for parameter in constraint.parameters()):
                raise InputError(f"constraint {i} of build(w) has a parameter without a value")

    @cached_property
    def offsets(self) -> np.ndarray:  # type: ignore[override]
        """The size of C, so that a program over it is stated in C's own units; shape (1,)."""
        direction = np.cos(np.arange(self.dim) + 1.0)
        heights = np.abs([self.support(direction), self.support(-direction)])
        known = heights[np.isfinite(heights) & (heights > 0)]
        return np.array([binary(known.max(initial=0.0))])

    @in_turn
    def support(self, z: np.ndarray) -> float:
        import cvxpy as cp

        z = vector("z", z, self.dim)
        if not z.any():
            return 0.0
        found = self._solve(cp.Maximize((z / np.abs(z).max()) @ self._w))
        return float("inf") if found is None else float(z @ found)

    @in_turn
    def project(self, w: np.ndarray) -> np.ndarray:
        import cvxpy as cp

        w = vector("w", w, self.dim)
        found = self._solve(cp.Minimize(cp.sum_squares(self._w - w)))
        if found is None:
            raise SweepoptError("Clarabel calls a projection on Constraints unbounded")
        return found

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        size = cp.Variable(1)
        w = cp.Variable(self.dim)
        return Features([size], [cp.suppfunc(w, self.build(w))(p) <= self.offsets[0] * size])

    def witness(self, p: Any, w: Any, tau: Any, y: Any) -> None:
        return None

    def polar(self) -> ConvexSet:
        raise self._polar_unknown()

    def same_cone(self, other: ConvexSet) -> bool:
        # what build(w) holds cannot be compared: another object is another cone
        return self is other

    def require_nonempty(self, where: str = "C") -> None:
        try:
            self.project(np.zeros(self.dim))
        except EmptySetError as error:
            raise EmptySetError(f"{where} is empty: no w satisfies the constraints") from error

    def _solve(self, objective: Any) -> np.ndarray | None:
        """The best w; None if the objective is unbounded."""
        import cvxpy as cp

        problem = cp.Problem(objective, list(self._constraints))
        unit = solve_in_own_units(problem)
        if problem.status in (cp.UNBOUNDED, cp.UNBOUNDED_INACCURATE):
            return None
        if problem.status in (cp.INFEASIBLE, cp.INFEASIBLE_INACCURATE):
            raise EmptySetError("Constraints has no point: no w satisfies the constraints")
        if self._w.value is None:
            raise SweepoptError(f"Clarabel failed on Constraints: {problem.status}")
        return unit * np.array(self._w.value)
