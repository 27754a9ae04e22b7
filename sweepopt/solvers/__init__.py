"""Solvers of the velocity program: the library's names for them and how "auto" chooses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from sweepopt.errors import SolverRefusedError, shown
from sweepopt.sets import ConvexSet
from sweepopt.solvers.active_set import ActiveSet
from sweepopt.solvers.base import Answer, Solve, Solver
from sweepopt.solvers.clarabel import Clarabel
from sweepopt.solvers.daqp import DAQP, installed
from sweepopt.solvers.newton import Newton
from sweepopt.solvers.osqp import OSQP
from sweepopt.solvers.reference import Cvxpy
from sweepopt.solvers.secular import Secular

NEWTON, FASTEST, FORMULA, LAST = Newton(), DAQP(), Secular(), ActiveSet()
CONTRACT = ("name", "treats", "compile", "refined")
REGISTRY: dict[str, Callable[[], Solver]] = {
    "clarabel": Clarabel,
    "osqp": OSQP,
    "newton": Newton,
    "secular": Secular,
    "daqp": DAQP,
    "active-set": ActiveSet,
    "cvxpy": Cvxpy,
}


def choose(solver: Any, C: ConvexSet) -> tuple[Solver, ...]:
    """The solver for a set, and behind it those that repair a step it misses.

    "auto" is the formula for one small ball, DAQP for small boxes if it is installed, Newton for
    small sets whose projection has a derivative, then OSQP for polyhedra and Clarabel for the rest:
    in this order of speed, as measured by `benchmarks/loops_by_hand.py`. Where a polyhedron couples
    its unknowns OSQP is faster than Newton, and Clarabel where a projection is itself an iteration.

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
    general: list[Solver] = [other for other in (OSQP(), Clarabel(), LAST) if other.treats(C)]
    small: list[Solver] = [NEWTON] if NEWTON.treats(C) else []
    if isinstance(solver, str) and solver == "auto":
        fastest: list[Solver] = [FASTEST] if installed() and FASTEST.treats(C) else []
        formula: list[Solver] = [FORMULA] if FORMULA.treats(C) else []
        D = C.derivative(C.anchor) if small and C.polyhedral else None
        if (D is not None and D.ndim == 2) or not C.exact:
            return (*formula, *fastest, general[0], *small, *general[1:])
        return (*formula, *fastest, *small, *general)
    if isinstance(solver, str):
        if solver not in REGISTRY:
            raise SolverRefusedError(f"solver {solver!r} is not known; use auto, {_names()}")
        solver = REGISTRY[solver]()
    lacks = [name for name in CONTRACT if not hasattr(solver, name)]
    if lacks or isinstance(solver, type):
        missing = f" (it has no {lacks[0]}, see help(sweepopt.solvers.Solver))" if lacks else ""
        raise SolverRefusedError(
            f"solver must be a name ({_names()}) or an object: {shown(solver)}{missing}"
        )
    if not solver.treats(C):
        raise SolverRefusedError(
            f"{solver.name} cannot treat {describe(C)}: OSQP solves quadratic programs over "
            "polyhedra, Newton and DAQP small programs with simple sets, Secular a small ball; use "
            'solver="clarabel"'
        )
    return (solver, *(other for other in (*small, *general) if other.name != solver.name))


def describe(C: ConvexSet) -> str:
    """The shapes that make a set a cone set, by name."""
    parts = [getattr(C, name, None) for name in ("part", "first", "second")]
    inner = [part for part in (*parts, *getattr(C, "parts", ())) if isinstance(part, ConvexSet)]
    curved = [describe(part) for part in inner if not part.polyhedral]
    return ", ".join(dict.fromkeys(curved)) or type(C).__name__


def _names() -> str:
    return ", ".join(REGISTRY)


__all__ = [
    "DAQP",
    "LAST",
    "NEWTON",
    "OSQP",
    "ActiveSet",
    "Answer",
    "Clarabel",
    "Cvxpy",
    "Newton",
    "Secular",
    "Solve",
    "Solver",
    "choose",
]
