"""The velocity program as cvxpy solves it: slow, readable, and open to every solver cvxpy has."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.errors import InputError, SolverRefusedError, shown
from sweepopt.sets import ConvexSet, in_turn
from sweepopt.velocity.program import Answer, Solve, VelocityProgram

if TYPE_CHECKING:
    import cvxpy as cp

QUADRATIC_ONLY = {"OSQP", "PIQP", "PROXQP", "DAQP", "HIGHS"}
TIGHT: dict[str, dict[str, Any]] = {
    "CLARABEL": {"tol_gap_abs": 1e-11, "tol_gap_rel": 1e-11, "tol_feas": 1e-11},
    "OSQP": {"eps_abs": 1e-10, "eps_rel": 1e-10, "max_iter": 100_000, "polishing": False},
}


@dataclass(frozen=True)
class Cvxpy:
    """Any solver installed for cvxpy, through cvxpy's own interface.

    Parameters
    ----------
    solver : str
        cvxpy's name of it, for example "CLARABEL", "OSQP", "PIQP".
    settings : dict
        Passed on to the solver; tight ones are chosen for CLARABEL and OSQP when empty.

    Raises
    ------
    InputError
        If the solver is no name or the settings are no dict.

    Examples
    --------
    >>> Cvxpy("OSQP", {"eps_abs": 1e-9}).name
    'cvxpy:osqp'
    """

    solver: str = "CLARABEL"
    settings: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.solver, str) or not isinstance(self.settings, dict):
            given = shown((self.solver, self.settings))
            raise InputError(
                f"Cvxpy takes the name of a solver and a dict of settings, got {given}"
            )

    @property
    def name(self) -> str:
        return f"cvxpy:{self.solver.lower()}"

    def treats(self, C: ConvexSet) -> bool:
        """Polyhedra, and every set if the solver is not one for quadratic programs."""
        return C.polyhedral or self.solver.upper() not in QUADRATIC_ONLY

    def compile(self, program: VelocityProgram) -> Solve:
        """State the program once; a call sets its parameters and solves."""
        import cvxpy as cp

        name = self.solver.upper()
        if name not in installed():
            raise SolverRefusedError(
                f"cvxpy has no solver {name!r} here; it has {', '.join(installed())}"
            )
        settings = self.settings or TIGHT.get(name, {})
        n = program.M.dim
        problem, linear, parameter = _with_parameter(program)

        @in_turn
        def solve(q: np.ndarray, C: ConvexSet) -> Answer:
            given = np.concatenate([q, C.offsets])
            # forces in units of the largest one: solvers' absolute tolerances need it
            force = np.abs(given).max() or 1.0
            parameter.value = given / force
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", message="Solution may be inaccurate")
                try:
                    problem.solve(solver=name, enforce_dpp=True, **settings)
                except cp.SolverError as error:
                    return Answer(np.zeros(n), status=f"failed: {error}")
                except (TypeError, ValueError) as error:
                    raise SolverRefusedError(
                        f"cvxpy's {name} does not take the settings {settings}: {error}"
                    ) from error
            status = str(problem.status)
            if linear.value is None:
                return Answer(np.zeros(n), status=status)
            iterations = problem.solver_stats.num_iters or 0
            z = linear.value[:n] * (force / program.stiffness)
            return Answer(z, iterations=iterations, status=status)

        return solve


@in_turn
def _with_parameter(program: VelocityProgram) -> tuple[cp.Problem, cp.Expression, cp.Parameter]:
    """The program with a parameter in the linear part of its objective alone (DPP)."""
    import cvxpy as cp

    linear, quadratic, constraints = program.statement()
    parameter = cp.Parameter(linear.size)
    problem = cp.Problem(cp.Minimize(quadratic + parameter @ linear), constraints)
    return problem, linear, parameter


def installed() -> list[str]:
    """The solvers that cvxpy finds here."""
    import cvxpy as cp

    return list(cp.installed_solvers())
