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
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import count, number
from sweepopt.linalg import Factor
from sweepopt.sets import ConvexSet, Similar

if TYPE_CHECKING:
    import cvxpy as cp

# of the residual, left by a step of Newton's method after which the tangent is kept: such steps
# cost a fifth of others; of 1e-4 to 0.2 this takes the least time on problems/tread.toml, and of
# 0 to 0.1 on a ring with plastic strains
KEPT = 1e-2


class Translate(NamedTuple):
    """C = c + S."""

    c: np.ndarray
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
    """

    M: Factor
    cone: ConvexSet

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


# ---- the contract of a solver: compile once per program, then only vectors -----------------------


class Answer(NamedTuple):
    """What a solver says; nothing of it is believed before the program has certified it.

    The multipliers y are not used; a solver of yours may give them. w is M z + q, if it is known.
    """

    z: np.ndarray
    y: np.ndarray = np.zeros(0)
    iterations: int = 0
    status: str = ""
    w: np.ndarray | None = None


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
