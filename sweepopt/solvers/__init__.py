"""Solvers of the velocity program: the library's names for them and how "auto" chooses."""

from __future__ import annotations

from typing import Any

from sweepopt.errors import SolverRefusedError
from sweepopt.sets import ConvexSet
from sweepopt.solvers.base import Answer, Solve, Solver
from sweepopt.solvers.clarabel import Clarabel
from sweepopt.solvers.osqp import OSQP
from sweepopt.solvers.reference import Cvxpy

REGISTRY: dict[str, type[Clarabel] | type[OSQP] | type[Cvxpy]] = {
    "clarabel": Clarabel,
    "osqp": OSQP,
    "cvxpy": Cvxpy,
}


def choose(solver: Any, C: ConvexSet) -> tuple[Solver, ...]:
    """The solver for a set, and behind it those that repair a step it misses.

    Parameters
    ----------
    solver : str or Solver
        "auto", a registered name or an object.
    C : ConvexSet

    Raises
    ------
    SolverRefusedError
        If the name is unknown or the solver cannot treat C.
    """
    if isinstance(solver, str):
        if solver != "auto" and solver not in REGISTRY:
            raise SolverRefusedError(f"solver {solver!r} is not known; use auto, {_names()}")
        # measured on polyhedral programs: OSQP with its polish is faster and more accurate
        automatic = "osqp" if C.polyhedral else "clarabel"
        first: Any = REGISTRY[automatic if solver == "auto" else solver]()
    elif hasattr(solver, "compile") and not isinstance(solver, type):
        first = solver
    else:
        raise SolverRefusedError(f"solver must be a name ({_names()}) or an object: {solver!r:.60}")
    if not first.cones and not C.polyhedral:
        raise SolverRefusedError(
            f"{first.name} solves quadratic programs only, but {describe(C)} is not a polyhedron; "
            'use solver="clarabel"'
        )
    others: list[Solver] = [Clarabel(), OSQP()]
    able = [other for other in others if other.cones or C.polyhedral]
    return (first, *(other for other in able if other.name != first.name))


def describe(C: ConvexSet) -> str:
    """The shapes that make a set a cone set, by name."""
    parts = [getattr(C, name, None) for name in ("part", "first", "second")]
    inner = [part for part in (*parts, *getattr(C, "parts", ())) if isinstance(part, ConvexSet)]
    curved = [describe(part) for part in inner if not part.polyhedral]
    return ", ".join(dict.fromkeys(curved)) or type(C).__name__


def _names() -> str:
    return ", ".join(REGISTRY)


__all__ = ["OSQP", "Answer", "Clarabel", "Cvxpy", "Solve", "Solver", "choose"]
