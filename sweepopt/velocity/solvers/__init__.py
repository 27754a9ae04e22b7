"""Solvers of the velocity program: the library's names for them and how "auto" chooses."""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

from sweepopt.errors import SolverRefusedError, shown, suggestion
from sweepopt.sets import ConvexSet, shape_of
from sweepopt.velocity.program import Answer, Small, Solve, Solver
from sweepopt.velocity.solvers.active_set import DAQP, ActiveSet, has_daqp
from sweepopt.velocity.solvers.conic import OSQP, Clarabel, Cvxpy, installed
from sweepopt.velocity.solvers.newton import Newton

NEWTON, FASTEST, LAST = Newton(), DAQP(), ActiveSet()
CONTRACT = ("name", "treats", "compile")
REGISTRY: dict[str, Callable[[], Solver]] = {
    "clarabel": Clarabel,
    "osqp": OSQP,
    "newton": Newton,
    "daqp": DAQP,
    "active-set": ActiveSet,
    "cvxpy": Cvxpy,
}


def choose(solver: Any, C: ConvexSet, tol: float = 1e-6) -> tuple[Solver, ...]:
    """The solver for a set, and behind it those that repair a step it misses.

    "auto" is DAQP for small boxes if it is installed, Newton for small sets whose projection has a
    derivative, then OSQP for polyhedra and Clarabel for the rest: in this order of speed. Where a
    polyhedron couples its unknowns OSQP is faster than Newton, and Clarabel where a projection is
    itself an iteration on each of many parts.

    Parameters
    ----------
    solver : str or Solver
        "auto", a registered name, "cvxpy:NAME" for a solver that cvxpy knows, or an object.
    C : ConvexSet
    tol : float
        Of the certificate: OSQP and Clarabel get settings that meet it, where they are not given.

    Raises
    ------
    SolverRefusedError
        If the name is unknown or the solver cannot treat C.
    """
    new = partial(_new_solver, C.certifiable, tol)
    general = [one for one in (new(OSQP), new(Clarabel), LAST) if one.treats(C)]
    small: list[Solver] = [NEWTON] if NEWTON.treats(C) else []
    if isinstance(solver, str) and solver == "auto":
        fastest = [FASTEST] if has_daqp() and FASTEST.treats(C) else []
        coupled = bool(small) and C.polyhedral and C.block > 1
        first = 1 if (coupled if C.exact else C.block < C.dim) else 0
        return (*fastest, *general[:first], *small, *general[first:])
    if isinstance(solver, str):
        name, _, engine = solver.partition(":")
        if solver not in REGISTRY and not (name == "cvxpy" and engine):
            import cvxpy as cp

            near = suggestion(solver, REGISTRY)
            if not near and solver.upper() in cp.settings.SOLVERS:
                near = f"; did you mean cvxpy:{solver.lower()}?"
            raise SolverRefusedError(
                f"solver {shown(solver)} is not known; use auto, {_names()} or cvxpy:NAME for one "
                f"that cvxpy knows{near}"
            )
        solver = Cvxpy(engine.upper()) if engine else new(REGISTRY[name])
    if isinstance(solver, type):
        name = "so." * (solver in REGISTRY.values()) + solver.__name__
        raise SolverRefusedError(
            f"solver must be a name or an object, got a class; call it: {name}()"
        )
    lacks = [name for name in CONTRACT if not hasattr(solver, name)]
    if lacks:
        missing = f" (it has no {lacks[0]}, see help(sweepopt.velocity.Solver))"
        raise SolverRefusedError(
            f"solver must be a name ({_names()}) or an object: {shown(solver)}{missing}"
        )
    if not solver.treats(C):
        raise SolverRefusedError(
            f"{solver.name} cannot treat {_curved_parts(C)}: OSQP solves quadratic programs over "
            "polyhedra, Newton and DAQP small programs with simple sets; use "
            'solver="clarabel"'
        )
    return (solver, *(other for other in (*small, *general) if other.name != solver.name))


@lru_cache  # every matrix of a run asks for them
def _new_solver(proved: bool, tol: float, kind: Any) -> Solver:
    """A solver with settings that meet tol; what it calls solved stands where nothing is proved."""
    return kind.meeting(tol) if proved and hasattr(kind, "meeting") else kind()


def _curved_parts(C: ConvexSet) -> str:
    """The parts of C that are no polyhedra, by name; without any C itself."""
    parts = map(shape_of, C.form().parts)
    curved = dict.fromkeys(type(part).__name__ for part in parts if not part.polyhedral)
    return ", ".join(curved) or type(shape_of(C)).__name__


def _names() -> str:
    return ", ".join(REGISTRY)
