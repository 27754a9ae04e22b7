"""Solvers of the program as cvxpy states it: OSQP and Clarabel by themselves, any other by cvxpy.

cvxpy makes of the program

    min 1/2 <P x, x> + <map (q, offsets), x>    over a fixed cone given in the solver's `data`.

OSQP and Clarabel are set up once, then only vectors change. As the objective is linear in
(q, offsets) the answers are its gradient: (z, y) = map^T x. The support function is positively
homogeneous, so scaling (q, offsets) scales x.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Array
from sweepopt.errors import InputError, SolverRefusedError, shown
from sweepopt.sets import CAREFUL, ConvexSet, in_turn
from sweepopt.velocity.program import Answer, Settings, Solve, VelocityProgram

QUADRATIC_ONLY = {"OSQP", "PIQP", "PROXQP", "DAQP", "HIGHS"}
TIGHT: dict[str, dict[str, Any]] = {
    "CLARABEL": {"tol_gap_abs": 1e-11, "tol_gap_rel": 1e-11, "tol_feas": 1e-11},
    "OSQP": {"eps_abs": 1e-10, "eps_rel": 1e-10, "max_iter": 100_000, "polishing": False},
}


@dataclass(frozen=True)
class OSQP(Settings):
    """OSQP, an operator-splitting method for quadratic programs, warm started.

    Its own polish is off: refinement does the same, and keeps an answer only if it is better.

    Parameters
    ----------
    tol : float
        Absolute and relative.
    max_iter : int

    Raises
    ------
    InputError
        If tol or max_iter is not positive.

    Examples
    --------
    >>> OSQP(tol=1e-9).tol
    1e-09
    """

    tol: float = 1e-8
    max_iter: int = 5_000
    name = "osqp"

    def treats(self, C: ConvexSet) -> bool:
        """Polyhedra."""
        return C.polyhedral

    @classmethod
    def meeting(cls, tol: float) -> OSQP:
        """A hundredth of tol, between 1e-9 and 1e-3: residuals count more where M is soft."""
        return cls(tol=min(max(0.01 * tol, 1e-9), 1e-3))

    def compile(self, program: VelocityProgram) -> Solve:
        """Equations and inequalities as rows between bounds, set up once."""
        import osqp

        data, linear_map = _canonical(program, "OSQP")
        equal, below = data["A"].shape[0], data["F"].shape[0]

        def set_up(linear: Array) -> Any:
            engine = osqp.OSQP()
            engine.setup(
                sp.csc_matrix(data["P"]),
                linear,
                sp.csc_matrix(sp.vstack([data["A"], data["F"]])),
                np.repeat([0.0, -np.inf], [equal, below]),
                np.zeros(equal + below),
                verbose=False,
                polishing=False,
                eps_abs=self.tol,
                eps_rel=self.tol,
                max_iter=self.max_iter,
            )
            return engine

        def run(engine: Any) -> tuple[Any, int, str]:
            result = engine.solve(raise_error=False)
            return result.x, result.info.iter, result.info.status

        return _with_engine(program, linear_map, set_up, run)


@dataclass(frozen=True)
class Clarabel(Settings):
    """Clarabel, an interior-point method for cone programs.

    Parameters
    ----------
    tol : float
        Absolute, relative and of feasibility.
    max_iter : int

    Raises
    ------
    InputError
        If tol or max_iter is not positive.

    Examples
    --------
    >>> Clarabel(tol=1e-9).tol
    1e-09
    """

    tol: float = 1e-9
    max_iter: int = 200
    name = "clarabel"

    def treats(self, C: ConvexSet) -> bool:
        """Every set."""
        return True

    @classmethod
    def meeting(cls, tol: float) -> Clarabel:
        """Half the square of a certificate is a gap: a tenth of tol^2, between 1e-11 and 1e-4.

        A smaller gap is at the mercy of rounding: Newton steps or refinement meet a tighter tol.
        """
        return cls(tol=min(max(0.1 * tol**2, 1e-11), 1e-4))

    def compile(self, program: VelocityProgram) -> Solve:
        """The cone program, set up once."""
        import clarabel
        from cvxpy.reductions.solvers.conic_solvers.clarabel_conif import dims_to_solver_cones

        data, linear_map = _canonical(program, "CLARABEL")

        def set_up(linear: Array) -> Any:
            settings = clarabel.DefaultSettings()
            settings.verbose = False
            settings.max_iter = self.max_iter
            settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = self.tol
            settings.presolve_enable = False  # updates need the problem as it was set up
            if not program.cone.certifiable:  # an answer stands if Clarabel calls it solved
                for name, value in CAREFUL.items():
                    setattr(settings, name, value)
            cones = dims_to_solver_cones(data["dims"])
            return clarabel.DefaultSolver(
                data["P"], linear, sp.csc_matrix(data["A"]), data["b"], cones, settings
            )

        def run(engine: Any) -> tuple[Any, int, str]:
            solution = engine.solve()
            return solution.x, solution.iterations, str(solution.status)

        return _with_engine(program, linear_map, set_up, run)


def _with_engine(
    program: VelocityProgram,
    linear_map: sp.csr_array,
    set_up: Callable[[Array], Any],
    run: Callable[[Any], tuple[Any, int, str]],
) -> Solve:
    """A call sets an engine up with a linear term, or gives it another, and lets it run."""
    to_z = sp.csr_array(linear_map[:, : program.M.dim].T)
    engine: Any = None

    def solve(q: Array, C: ConvexSet) -> Answer:
        nonlocal engine
        linear = linear_map @ np.concatenate([q, C.offsets])
        force = float(np.abs(linear).max()) or 1.0
        if engine is None:
            engine = set_up(linear / force)
        else:
            engine.update(q=linear / force)
        x, iterations, status = run(engine)
        z = to_z @ np.array(x, dtype=float) * (force / program.stiffness)
        return Answer(z, iterations=iterations, status=status)

    return solve


@in_turn
def _canonical(program: VelocityProgram, solver: str) -> tuple[dict[str, Any], sp.csr_array]:
    """What cvxpy hands to the solver, and the linear term as a map of q and the offsets.

    The objective <q, z> + <offsets, y> is linear in cvxpy's variables, so the map is made of
    the derivatives of z and y: parameters of the size of z would cost memory of its square.
    """
    import cvxpy as cp

    linear, quadratic, constraints = program.statement()
    problem = cp.Problem(cp.Minimize(quadratic), constraints)
    data, _, _ = problem.get_problem_data(solver, enforce_dpp=True)
    data["P"] = sp.triu(data["P"], format="csc")
    for variable in linear.variables():
        variable.value = np.zeros(variable.shape)  # any point: the expression is linear
    total = sp.csr_array((data["P"].shape[0], linear.size))
    for variable, part in linear.grad.items():
        if not variable.size:  # cvxpy drops it
            continue
        part = sp.coo_array(part if sp.issparse(part) else np.atleast_2d(part))  # a number if 1 x 1
        column = data["param_prob"].var_id_to_col[variable.id]
        placed = (part.data, (part.row + column, part.col))
        total += sp.csr_array(placed, shape=total.shape)
    return data, total


# ---- any solver, slow and readable -------------------------------------------------------------


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

        @in_turn
        def state() -> tuple[cp.Problem, cp.Expression, cp.Parameter]:
            """With a parameter in the linear part of its objective alone (DPP)."""
            linear, quadratic, constraints = program.statement()
            parameter = cp.Parameter(linear.size)
            objective = cp.Minimize(quadratic + parameter @ linear)
            return cp.Problem(objective, constraints), linear, parameter

        problem, linear, parameter = state()

        @in_turn
        def solve(q: Array, C: ConvexSet) -> Answer:
            given = np.concatenate([q, C.offsets])
            # forces in units of the largest one: solvers' absolute tolerances need it
            force = np.abs(given).max() or 1.0
            parameter.value = given / force
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", message="Solution may be inaccurate")
                try:
                    problem.solve(solver=name, enforce_dpp=True, **settings)
                except cp.SolverError as error:
                    return Answer(np.zeros(q.size), status=f"failed: {error}")
                except (TypeError, ValueError) as error:
                    raise SolverRefusedError(
                        f"cvxpy's {name} does not take the settings {settings}: {error}"
                    ) from None
            if linear.value is None:
                return Answer(np.zeros(q.size), status=str(problem.status))
            z = linear.value[: q.size] * (force / program.stiffness)
            iterations = problem.solver_stats.num_iters or 0
            return Answer(z, iterations=iterations, status=str(problem.status))

        return solve


def installed() -> list[str]:
    """The solvers that cvxpy finds here."""
    import cvxpy as cp

    return list(cp.installed_solvers())
