"""The one program every scheme asks for, stated once, and what a solver of it is.

    z = argmin  1/2 <M z, z> + <q, z> + sigma(C, -z)

is strongly convex: it has exactly one solution, whatever a solver says. It is equivalent to
-z in N_C(M z + q) (MATH.md section 2).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Array, Matrix, count, number, vector
from sweepopt.display import Brief, as_lines, brief, record
from sweepopt.errors import IndefiniteError, InputError
from sweepopt.linalg import Factor
from sweepopt.sets import ConvexSet, Point, Similar, exchange_matrix, in_turn
from sweepopt.velocity.certificate import Velocity, certify_point

if TYPE_CHECKING:
    import cvxpy as cp


class Translate(NamedTuple):
    """C = c + S."""

    c: Array
    S: ConvexSet


def untranslated(C: ConvexSet) -> Translate:
    """C with all its translations taken out: it enters the program through q - C alone."""
    c = None
    while isinstance(C, Similar) and C.v is not None:
        c, C = C.v if c is None else c + C.v, C.centred
    return Translate(np.zeros(C.dim) if c is None else c, C)


class Statement(NamedTuple):
    """The program in cvxpy, without its linear term <q, z> + <offsets, y>.

    Attributes
    ----------
    linear : cvxpy.Expression
        z, then the features y: what (q, offsets) are the coefficients of.
    quadratic : cvxpy.Expression
        1/2 <M z, z> / stiffness: solvers see numbers without units.
    constraints : list of cvxpy.Constraint
        What ties y to z.
    """

    linear: cp.Expression
    quadratic: cp.Expression
    constraints: list[cp.Constraint]


@dataclass(frozen=True)
class VelocityProgram:
    """min 1/2 <M z, z> + <q, z> + sigma(C, -z) for one M and all C with one cone.

    Parameters
    ----------
    M : Factor
    cone : ConvexSet
        Any member of the family; only its features are used.
    proved : bool
        Whether its velocities are certified.
    """

    M: Factor
    cone: ConvexSet
    proved: bool = True

    @cached_property
    def stiffness(self) -> float:
        """A power of two in the units of M: the geometric mean of its diagonal, nearly."""
        return math.ldexp(1.0, int(np.frexp(self.M.diagonal)[1].sum()) // self.M.dim)

    def statement(self) -> Statement:
        """The program in cvxpy; to be called in turn by threads."""
        import cvxpy as cp

        # Jacobi scaling: the solver sees a matrix of constant diagonal, whatever the units of z
        scale = np.sqrt(self.stiffness / self.M.diagonal)
        x = cp.Variable(self.M.dim)
        z = cp.multiply(scale, x)
        weights = sp.diags_array(scale) if sp.issparse(self.M.M) else np.diag(scale)
        scaled = weights @ self.M.M @ weights / self.stiffness
        scaled = 0.5 * (scaled + scaled.T)
        y, constraints = self.cone.features(-z)
        y, constraints = list(y), list(constraints)
        tied = {own.id for constraint in constraints for own in constraint.variables()} | {x.id}
        for k, feature in enumerate(y):
            if any(
                any(own.attributes.values()) or own.id not in tied for own in feature.variables()
            ):
                # cvxpy replaces variables with attributes (nonneg=True) and drops those that
                # nothing ties (how a point splits between two): the feature gets one that it keeps
                y[k] = cp.Variable(feature.size)
                constraints = [*constraints, y[k] == feature]
        # M is known to be positive definite: it was factorised
        quadratic = 0.5 * cp.quad_form(x, cp.psd_wrap(scaled))
        return Statement(cp.hstack([z, *y]), quadratic, constraints)


# ---- as a person writes it ----------------------------------------------------------------------


@record
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
    Bu: Array
    C: ConvexSet

    @classmethod
    @in_turn
    def of(cls, M: Matrix, Bu: Array, C: ConvexSet) -> StepProgram:
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
            which `tol` bounds in a run. Isotropic hardening alone leaves M singular: the norm is
            that of M + H then, with the stiffness exchanged (`ConvexSet.exchange`).

        Raises
        ------
        InputError
            If z is no finite vector: None, before the problem is solved.
        """
        if z is None:
            status = self.problem.status or "not solved"
            raise InputError(f"z is None: problem is {status}; solve it, or take another solver")
        c, S = untranslated(self.C)
        try:
            M = Factor(self.M)
        except IndefiniteError:
            if (H := exchange_matrix(self.M, S, force=self.Bu - c)) is None:
                raise
            M = Factor(self.M + H)
        return certify_point(M, self.Bu - c, S, vector("z", z, S.dim), 0.0)

    def __repr__(self) -> str:
        data = ((name, brief(getattr(self, name))) for name in ("M", "Bu", "C"))
        program = " ".join(str(self.problem).split())
        return as_lines([("StepProgram", f"dim {self.C.dim}"), *data, ("problem", program)])

    def __str__(self) -> str:
        return str(self.problem)


# ---- the contract of a solver: compile once per program, then only vectors -----------------------


class Answer(NamedTuple):
    """What a solver says; nothing of it is believed before the program has certified it.

    The multipliers y are not used; a solver of yours may give them. w is M z + q, if it is known.
    If `normal`, w is a point of C and -z is normal to C at w, both up to rounding; this is used
    where nothing is to be proved, or with a bound of what the rounding moves w and z, in |.|_{M^-1}
    and |.|_M, as of `Proposal`.
    """

    z: Array
    y: Array = np.zeros(0)
    iterations: int = 0
    status: str = ""
    w: np.ndarray | None = None
    normal: bool = False
    perturbation: float = math.inf


Solve = Callable[..., Answer]


class Solver(Protocol):
    """A way to solve velocity programs.

    Attributes
    ----------
    name : str
    """

    @property
    def name(self) -> str: ...

    def treats(self, C: ConvexSet) -> bool:
        """Whether programs with this set can be solved."""
        ...

    def compile(self, program: VelocityProgram) -> Solve:
        """A function (q, C) -> Answer for C with this cone; not to be shared by threads.

        A solver that can start from a velocity, like Newton, takes one as a third argument.
        """
        ...


@dataclass(frozen=True)
class Settings:
    """Those of a solver: its `tol` is positive, what is called max is a positive whole number.

    Raises
    ------
    InputError
        If one is not.
    """

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name == "tol":
                number(name, value, minimum=0.0, strict=True)
            elif name.startswith("max_"):
                count(name, value)


@dataclass(frozen=True)
class Small(Settings):
    """What solvers of small programs have in common: they go to rounding, or fail.

    Parameters
    ----------
    max_dim : int
        Larger programs are left to the other solvers.
    """

    max_dim: int = 300
