"""What solvers of the program as cvxpy states it have in common: set up once, then only vectors.

cvxpy makes of the program

    min 1/2 <P x, x> + <map (q, offsets), x>    over a fixed cone given in the solver's `data`.

As the objective is linear in (q, offsets) the answers are its gradient: (z, y) = map^T x. The
support function is positively homogeneous, so scaling (q, offsets) scales x.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import count, number
from sweepopt.sets import ConvexSet, in_turn
from sweepopt.velocity.program import Answer, Solve, VelocityProgram


@dataclass(frozen=True)
class CanonicalSolver(ABC):
    """A solver with a tolerance and a limit of iterations, whose linear term is updated in place.

    Parameters
    ----------
    tol : float
    max_iter : int

    Raises
    ------
    InputError
        If tol or max_iter is not positive.
    """

    tol: float
    max_iter: int
    name = ""

    def __post_init__(self) -> None:
        number("tol", self.tol, minimum=0.0, strict=True)
        count("max_iter", self.max_iter)

    @classmethod
    @abstractmethod
    def meeting(cls, tol: float) -> Self:
        """The solver with settings for which a certificate of `tol` is to be expected."""

    def scaled(self, data: dict[str, Any]) -> np.ndarray:
        """Puts the program in units of its own, and returns those of the variables."""
        return np.ones(data["P"].shape[0])

    @abstractmethod
    def engine(self, cone: ConvexSet, data: dict[str, Any], linear: np.ndarray) -> Any:
        """The program in `data` with a linear term, set up; it has `update(q=linear)`."""

    @abstractmethod
    def run(self, engine: Any) -> tuple[Any, int, str]:
        """The engine's answer: x, its iterations and its status."""

    def compile(self, program: VelocityProgram) -> Solve:
        """Canonicalise and set up once; a call updates the linear term."""
        data, linear_map = _canonical(program, self.name.upper())
        linear_map = sp.diags_array(self.scaled(data)) @ linear_map
        n = program.M.dim
        to_z = sp.csr_array(linear_map[:, :n].T)
        engine: Any = None

        def solve(q: np.ndarray, C: ConvexSet) -> Answer:
            nonlocal engine
            linear = linear_map @ np.concatenate([q, C.offsets])
            force = float(np.abs(linear).max()) or 1.0
            if engine is None:
                engine = self.engine(program.cone, data, linear / force)
            else:
                engine.update(q=linear / force)
            x, iterations, status = self.run(engine)
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
