"""Supports and projections that have no closed form, as cone programs for Clarabel.

sigma(C, z) = min { <h, y> : features of z },
z - P_C(z)  = argmin 1/2 |p|^2 - <z, p> + sigma(C, p).

Runs in several threads are, bit for bit, those in one: each compiles programs of its own. What they
cannot have of their own, cvxpy's numbers of variables, they take in turns here.
"""

from __future__ import annotations

import contextlib
import threading
import warnings
from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING, ParamSpec, TypeVar

import numpy as np

from sweepopt.checks import Array, vector
from sweepopt.errors import EmptySetError, InputError, SweepoptError, result_of, shown
from sweepopt.sets.base import ConvexSet, binary

if TYPE_CHECKING:
    import cvxpy as cp

# steps of Clarabel that stay off the boundary of the cones, where it is stuck before its tolerance
CAREFUL: dict[str, float] = {
    "max_step_fraction": 0.8,
    "iterative_refinement_reltol": 1e-15,
    "iterative_refinement_abstol": 1e-15,
}
TIGHT = {"tol_gap_abs": 1e-12, "tol_gap_rel": 1e-12, "tol_feas": 1e-12, **CAREFUL}


Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

_cvxpy = threading.RLock()


def in_turn(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """For all that states or solves something in cvxpy: one thread at a time.

    cvxpy numbers its variables by `count += 1`: where two threads do that at once, variables of one
    program get the same number. And a variable that is shared holds one answer only.
    """

    @wraps(function)
    def alone(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        with _cvxpy:
            return function(*args, **kwargs)

    return alone


@in_turn
def check_features(C: ConvexSet) -> None:
    """Spot-check that the `offsets` and `features` give the support function.

    Raises
    ------
    InputError
        Naming what is wrong.
    """
    import cvxpy as cp

    name, p, at = f"{type(C).__name__}.features", cp.Variable(C.dim), cp.Parameter(C.dim)
    try:
        given = result_of(C.features, p, name)
    except NotImplementedError:  # of small programs the projection is enough
        return
    h = vector(f"{type(C).__name__}.offsets", getattr(C, "offsets", None))
    if np.shape(C.offsets) != h.shape:
        raise InputError(f"offsets must be an array of shape ({h.size},), got {h[0]:g}")
    size, turns = float(np.abs(h).max(initial=0.0)) or 1.0, np.arange(C.dim) + 1.0
    for z in (np.cos(turns), -np.cos(turns), np.sin(turns), -np.sin(turns)):
        sigma, at.value = C.support(z), z
        try:
            y, constraints = given
            value = np.append(0 * z, h / size) @ cp.hstack([p, *y])
            problem = cp.Problem(cp.Minimize(value), [*constraints, p == at])
            least = size * float(problem.solve(solver="CLARABEL"))
        except Exception as error:  # whatever cvxpy has against a user's expressions
            raise InputError(
                f"{name} is no program: {type(error).__name__}: {error}; it must return "
                f"Features([y], [constraints]), convex, y of {h.size} entries, one for each "
                f"offset: {shown(given)}"
            ) from error
        if not (sigma == least or abs(sigma - least) <= 1e-3 * max(size, abs(sigma))):
            raise InputError(
                f"{name} contradicts support: for z = {shown(z)} the least <offsets, y> is "
                f"{least:g}, but support(z) = {sigma:g}"
            )


@in_turn
def support_by_program(C: ConvexSet, z: Array) -> float:
    """sigma(C, z) from its features, for sets without a closed form; infeasible means +inf."""
    import cvxpy as cp

    length = float(np.abs(z).max())
    if not length:
        return 0.0
    y, constraints = C.features(cp.Constant(z / length))
    unit = binary(np.abs(C.offsets).max(initial=0.0))
    value = C.offsets @ cp.hstack(y) / unit if y else cp.Constant(0.0)
    problem = cp.Problem(cp.Minimize(value), constraints)
    solve_tightly(problem)
    if problem.status in (cp.INFEASIBLE, cp.INFEASIBLE_INACCURATE):
        return float("inf")
    if problem.value is None or not np.isfinite(problem.value):
        raise EmptySetError(f"{type(C).__name__} has no point: nothing meets all its conditions")
    return length * unit * float(problem.value)


@in_turn
def normal_by_program(C: ConvexSet, w: Array) -> Array:
    """w - P_C(w).

    A solver's gap leaves an error of its square root, relative to the unit of length. So the
    program is solved in units of the size of the data, and where |p| turns out to be much smaller
    once more in units of |p|.
    """
    import cvxpy as cp

    p = cp.Variable(C.dim)
    features, constraints = C.features(p)
    sigma = C.offsets @ cp.hstack(features) if features else 0
    size = binary(max(np.abs(w).max(initial=0.0), np.abs(C.offsets).max(initial=0.0)))

    def solve(unit: float) -> Array:
        objective = 0.5 * cp.sum_squares(p) + (sigma - w @ p) / unit
        problem = cp.Problem(cp.Minimize(objective), constraints)
        solve_tightly(problem)
        if p.value is None:
            raise EmptySetError(
                f"{type(C).__name__} has no point: nothing meets all its conditions"
            )
        return np.asarray(unit * p.value)

    normal = solve(size)
    distance = float(np.linalg.norm(normal))
    if distance < 0.01 * size:
        # a failure at this scale says nothing about the set
        with contextlib.suppress(SweepoptError):
            normal = solve(binary(max(distance, 1e-6 * size)))
    return normal


def solve_tightly(problem: cp.Problem) -> None:
    """Solve a small side program with Clarabel as far as double precision goes.

    Its "inaccurate" only means that 1e-12 was not reached; whoever calls checks the answer.
    """
    import cvxpy as cp

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Solution may be inaccurate")
        try:
            problem.solve(solver=cp.CLARABEL, **TIGHT)
        except cp.SolverError as error:
            raise SweepoptError(
                f"Clarabel failed on a projection or a support function: {error}; state the set by "
                "other shapes, or with numbers nearer to 1"
            ) from error
