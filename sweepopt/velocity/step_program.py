"""The program of a step as a person writes it in cvxpy, and the certificate of any answer to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.checks import Matrix, vector
from sweepopt.display import Brief
from sweepopt.errors import InputError
from sweepopt.linalg import Factor
from sweepopt.sets import ConvexSet, Point, in_turn
from sweepopt.velocity.certificate import Velocity, certify_point
from sweepopt.velocity.program import untranslated

if TYPE_CHECKING:
    import cvxpy as cp


@dataclass(frozen=True, eq=False, repr=False)
class StepProgram(Brief):
    """min 1/2 <M z, z> + <Bu, z> + J(z) - <f, z>, the program that a step of a scheme solves.

    It is the program of all unknowns, whatever the plan of a run eliminates. The set is
    C(t) = f - D and J(z) = sigma(D, z), so that J(z) - <f, z> = sigma(C(t), -z); f is 0 where C(t)
    is not written as a translate. Nothing is scaled. ``print(program)`` shows it.

    Attributes
    ----------
    problem : cvxpy.Problem
        For any solver: ``program.problem.solve(solver="SCS")``. z is its variable "z", "Bu" and "f"
        are parameters, M and what J is made of are constants with names; J may bring variables of
        its own, such as the multipliers of a polyhedron's rows.
    z : cvxpy.Variable, shape (dim,)
    M : ndarray or sparse, shape (dim, dim)
        A + gamma B, gamma = mu a_kk by the scheme; A for catching-up.
    Bu : ndarray, shape (dim,)
    C : ConvexSet
        C(t).
    """

    problem: cp.Problem
    z: cp.Variable
    M: Matrix
    Bu: np.ndarray
    C: ConvexSet

    @classmethod
    @in_turn
    def of(cls, M: Matrix, Bu: np.ndarray, C: ConvexSet) -> StepProgram:
        """That of M, B u and C(t)."""
        import cvxpy as cp

        f, S = untranslated(C)
        if C.singleton:
            f, S = C.anchor, Point(0 * f)
        z = cp.Variable(C.dim, name="z")
        J, constraints = (-S).epigraph(z)
        data = (cp.Parameter(C.dim, name, value=x) for name, x in (("Bu", Bu), ("f", f)))
        of_u, load = (parameter @ z for parameter in data)
        # M is known to be positive definite
        quadratic = 0.5 * cp.quad_form(z, cp.psd_wrap(cp.Constant(M, "M")))
        problem = cp.Problem(cp.Minimize(quadratic + of_u + J - load), constraints)
        return cls(problem, z, M, Bu, C)

    def certify(self, z: Any) -> Velocity:
        """The library's certificate of an answer, whoever found it.

        Parameters
        ----------
        z : array_like, shape (dim,)
            ``program.z.value`` after `problem.solve`, for example. The data are M, Bu and C as they
            stand here, whatever the parameters are set to later.

        Returns
        -------
        Velocity
            z, its `certificate` >= |z - z*|_M (nan where the set has no proof) and `relative`,
            which `tol` bounds in a run.

        Raises
        ------
        InputError
            If z is no finite vector: None, before the problem is solved.
        """
        if z is None:
            raise InputError("z is None: solve the problem first")
        c, S = untranslated(self.C)
        return certify_point(Factor(self.M), self.Bu - c, S, vector("z", z, S.dim), 0.0)

    def __str__(self) -> str:
        return str(self.problem)
