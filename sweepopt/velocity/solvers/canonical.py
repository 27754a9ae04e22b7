"""What solvers of the program as cvxpy states it have in common: set up once, then only vectors.

cvxpy makes of the program

    min 1/2 <P x, x> + <map (q, offsets), x>    over a fixed cone given in the solver's `data`.

As the objective is linear in (q, offsets) the answers are its gradient: (z, y) = map^T x. The
support function is positively homogeneous, so scaling (q, offsets) scales x.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import count, number
from sweepopt.sets import ConvexSet, in_turn
from sweepopt.velocity.program import VelocityProgram
from sweepopt.velocity.solvers.contract import Answer, Solve

if TYPE_CHECKING:
    import cvxpy as cp


class EngineAnswer(NamedTuple):
    """What an engine answers; is_solved tells whether it may be used again."""

    x: np.ndarray
    iterations: int
    status: str
    is_solved: bool


class Workspace(NamedTuple):
    """A program that is set up but for its linear term.

    Attributes
    ----------
    build : callable linear -> engine
        An engine has `update(q=linear)`.
    run : callable engine -> EngineAnswer
    units : ndarray, shape (k,)
        Of the variables: the engine sees x / units.
    """

    build: Callable[[np.ndarray], Any]
    run: Callable[[Any], EngineAnswer]
    units: np.ndarray


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

    @abstractmethod
    def workspace(self, cone: ConvexSet, P: sp.csc_array, data: dict[str, Any]) -> Workspace:
        """The program in `data`, with P the upper triangle of its matrix."""

    def compile(self, program: VelocityProgram) -> Solve:
        """Canonicalise and set up once; a call updates the linear term."""
        data, linear_map = _canonical(program, self.name.upper())
        build, run, units = self.workspace(program.cone, sp.triu(data["P"], format="csc"), data)
        n, transposed = program.M.dim, linear_map.T.tocsr()
        engine: Any = None

        def solve(q: np.ndarray, C: ConvexSet) -> Answer:
            nonlocal engine
            offsets = C.offsets
            linear = units * (linear_map @ np.concatenate([q, offsets]))
            force = float(np.abs(linear).max())
            if force == 0:
                return Answer(np.zeros(n), np.zeros(offsets.size), 0, "solved")
            if engine is None:
                engine = build(linear / force)
            else:
                engine.update(q=linear / force)
            x, iterations, status, is_solved = run(engine)
            x = x * (force / program.stiffness)
            if not is_solved or not np.isfinite(x).all():
                engine = None  # a workspace that failed once is not used again
                x = np.where(np.isfinite(x), x, 0.0)
            answer = transposed @ (units * x)
            return Answer(answer[:n], answer[n:], iterations, status)

        return solve


@in_turn
def _canonical(program: VelocityProgram, solver: str) -> tuple[dict[str, Any], sp.csr_array]:
    """What cvxpy hands to the solver, and the linear term as a map of q and the offsets.

    The objective <q, z> + <offsets, y> is linear in cvxpy's variables, so the map is made of
    the derivatives of z and y: parameters of the size of z would cost memory of its square.
    """
    import cvxpy as cp

    z, y, quadratic, constraints = program.statement()
    problem = cp.Problem(cp.Minimize(quadratic), constraints)
    data, _, _ = problem.get_problem_data(solver, enforce_dpp=True)
    columns, size = data["param_prob"].var_id_to_col, data["P"].shape[0]
    maps = [
        _derivative(expression, columns, size) for expression in (z, y) if expression is not None
    ]
    return data, sp.csr_array(sp.hstack(maps))


def _derivative(expression: cp.Expression, columns: dict[int, int], size: int) -> sp.csc_array:
    """The derivative of a linear expression in the canonical variables, transposed."""
    for variable in expression.variables():
        variable.value = np.zeros(variable.shape)  # any point: the expression is linear
    total = sp.csc_array((size, expression.size))
    for variable, part in expression.grad.items():
        part = sp.coo_array(np.atleast_2d(part) if np.isscalar(part) else part)
        placed = (part.data, (part.row + columns[variable.id], part.col))
        total += sp.csc_array(placed, shape=total.shape)
    return total
