"""Sets that a user states in cvxpy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.checks import dimension, vector
from sweepopt.errors import EmptySetError, InputError, SweepoptError
from sweepopt.sets.base import ConvexSet, Features, same_array
from sweepopt.sets.conic import conic, in_dual, in_own_units
from sweepopt.sets.programs import in_turn, normal_by_program, support_by_program

if TYPE_CHECKING:
    import cvxpy as cp


class Constraints(ConvexSet):
    """{ w : the cvxpy constraints that `build(w)` returns }, for sets the shapes do not cover.

    They are read once, in conic form (sweepopt/sets/conic.py), with the values that parameters have
    then. A step takes about 0.1 s, and no solver's answer can be proved: a run ends with the status
    "uncertified" and is as accurate as Clarabel is, about 5 digits. Linear constraints are better
    given as a `Polyhedron`, balls and ellipsoids as `Ball` and `Ellipsoid`, what is made of these
    by `C & D`, `C + D` and `image`: these prove their answers.

    Forces may have any units. In others, answers are the same to the last bit if no number of the
    constraints is rounded otherwise (powers of two), and else to Clarabel's accuracy.

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

    def __repr__(self) -> str:
        better = (
            "for balls, ellipsoids and linear constraints: so.Ball, so.Ellipsoid, so.Polyhedron"
        )
        if {block.kind for block in self.cones} <= {"zero", "nonneg"}:
            better = "as these constraints are linear: so.Polyhedron(G, h)"
        return f"{super().__repr__()}: 0.1 s a step and no proof; faster and proved {better}"

    @in_turn
    def __init__(self, dim: int, build: Any) -> None:
        import cvxpy as cp

        self.dim = dimension(dim)
        if not callable(build):
            raise InputError("build must be a function from a cvxpy Variable to constraints")
        w = cp.Variable(self.dim)
        try:
            constraints = build(w)
        except Exception as error:  # whatever a user's function raises
            raise InputError(f"build(w) raised {type(error).__name__}: {error}") from error
        if not isinstance(constraints, (list, tuple)):
            raise InputError("build must return a list of cvxpy constraints")
        for i, constraint in enumerate(constraints):
            _check(constraint, f"constraint {i} of build(w)")
        form = conic(w, list(constraints))
        if not all(np.isfinite(numbers).all() for numbers in (form.h, form.G.data, form.H.data)):
            raise InputError("the constraints of build(w) hold a number that is not finite")
        self.offsets, self.G, self.H, self.cones = in_own_units(form)

    def support(self, z: np.ndarray) -> float:
        value = support_by_program(self, vector("z", z, self.dim))
        if value == np.inf:
            self.require_nonempty()
        return value

    def project(self, w: np.ndarray) -> np.ndarray:
        w = vector("w", w, self.dim)
        return w - normal_by_program(self, w)

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        if not self.offsets.size:
            return Features([], [p == 0])
        y = cp.Variable(self.offsets.size)
        ties = [M.T @ y == right for M, right in ((self.G, p), (self.H, 0)) if M.shape[1]]
        return Features([y], [*ties, *in_dual(y, self.cones)])

    def normal_pair(self, p: Any, w: Any, tau: Any) -> None:
        return None

    def polar(self) -> ConvexSet:
        raise self._polar_unknown()

    def same_cone(self, other: ConvexSet) -> bool:
        return (
            isinstance(other, Constraints)
            and self.cones == other.cones
            and same_array(self.G, other.G)
            and same_array(self.H, other.H)
        )

    def magnitude(self) -> float:
        try:
            return super().magnitude()
        except EmptySetError:
            raise
        except SweepoptError:  # unbounded without a ray, like a parabola: no solver calls it so
            return float("inf")

    def require_nonempty(self, where: str = "C") -> None:
        try:
            self.project(np.zeros(self.dim))
        except EmptySetError as error:
            raise EmptySetError(f"{where} is empty: no w satisfies the constraints") from error


def _check(constraint: Any, name: str) -> None:
    """Refuse what is no convex constraint with numbers for data."""
    import cvxpy as cp

    if not (isinstance(constraint, cp.Constraint) and constraint.is_dcp()):
        raise InputError(f"{name} is not a convex cvxpy constraint")
    if any(parameter.value is None for parameter in constraint.parameters()):
        raise InputError(f"{name} has a parameter without a value")
    leaves = [*constraint.constants(), *constraint.parameters()]
    if any(not np.isfinite(np.sum(leaf.value)) for leaf in leaves):
        raise InputError(f"{name} holds a number that is not finite")
    whole = [v.attributes["integer"] or v.attributes["boolean"] for v in constraint.variables()]
    if any(whole) or isinstance(constraint, cp.FiniteSet):
        raise InputError(f"{name} has an integer variable: not convex")
