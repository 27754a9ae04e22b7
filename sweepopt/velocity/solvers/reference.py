"""The velocity program as cvxpy solves it: slow, readable, and open to every solver cvxpy has."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sweepopt.errors import InputError, SolverRefusedError, shown
from sweepopt.sets import ConvexSet, in_turn
from sweepopt.velocity.program import VelocityProgram
from sweepopt.velocity.solvers.base import Answer, Solve, Solver

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

    def refined(self) -> Solver | None:
        """None: the settings are the user's."""
        return None

    def compile(self, program: VelocityProgram) -> Solve:
        """State the program once; a call sets its parameters and solves."""
        import cvxpy as cp

        name = self.solver.upper()
        if name not in installed():
            raise SolverRefusedError(
                f"cvxpy has no solver {name!r} here; it has {', '.join(installed())}"
            )
        settings = self.settings or TIGHT.get(name, {})
        n, size = program.M.dim, program.cone.offsets.size
        problem, z, y, linear, weights = _with_parameters(program)

        @in_turn
        def solve(q: np.ndarray, C: ConvexSet) -> Answer:
            offsets = C.offsets
            # forces in units of the largest one: solvers' absolute tolerances need it
            force = max(np.abs(q).max(), np.abs(offsets).max(initial=0.0)) or 1.0
            linear.value = q / force
            if weights is not None:
                weights.value = offsets / force
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", message="Solution may be inaccurate")
                try:
                    problem.solve(solver=name, enforce_dpp=True, **settings)
                except cp.SolverError as error:
                    return Answer(np.zeros(n), np.zeros(size), 0, f"failed: {error}")
                except (TypeError, ValueError) as error:
                    raise SolverRefusedError(
                        f"cvxpy's {name} does not take the settings {settings}: {error}"
                    ) from error
            if z.value is None:
                return Answer(np.zeros(n), np.zeros(size), 0, str(problem.status))
            iterations = problem.solver_stats.num_iters or 0
            scale = force / program.stiffness
            features = np.zeros(0) if y is None else y.value * scale
            return Answer(z.value * scale, features, iterations, str(problem.status))

        return solve


class Parametric(NamedTuple):
    """The program with parameters in the linear part of its objective alone (DPP)."""

    problem: cp.Problem
    z: cp.Expression
    y: cp.Expression | None
    q: cp.Parameter
    offsets: cp.Parameter | None


@in_turn
def _with_parameters(program: VelocityProgram) -> Parametric:
    import cvxpy as cp

    z, y, objective, constraints = program.statement()
    q, offsets = cp.Parameter(program.M.dim), None
    objective += q @ z
    if y is not None:
        offsets = cp.Parameter(y.size)
        objective += offsets @ y
    return Parametric(cp.Problem(cp.Minimize(objective), constraints), z, y, q, offsets)


def installed() -> list[str]:
    """The solvers that cvxpy finds here."""
    import cvxpy as cp

    return list(cp.installed_solvers())
