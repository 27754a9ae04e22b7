"""What solvers of the program as cvxpy states it have in common: set up once, then only vectors."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import count, number
from sweepopt.sets import ConvexSet
from sweepopt.velocity.program import VelocityProgram
from sweepopt.velocity.solvers.base import Answer, Solve


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
    def workspace(self, program: VelocityProgram, P: sp.csc_array) -> Workspace:
        """The canonical program of this solver, with P the upper triangle of its matrix."""

    def compile(self, program: VelocityProgram) -> Solve:
        """Canonicalise and set up once; a call updates the linear term."""
        canonical = program.canonical(self.name.upper())
        P = sp.triu(canonical.P / program.stiffness, format="csc")
        build, run, units = self.workspace(program, P)
        n, transposed = program.M.dim, canonical.map.T.tocsr()
        engine: Any = None

        def solve(q: np.ndarray, C: ConvexSet) -> Answer:
            nonlocal engine
            offsets = C.offsets
            linear = units * (canonical.map @ np.concatenate([q, offsets]))
            force = float(np.abs(linear).max())
            if force == 0:
                return Answer(np.zeros(n), np.zeros(offsets.size), 0, "solved")
            if engine is None:
                engine = build(linear / force)
            else:
                engine.update(q=linear / force)
            raw = run(engine)
            x = raw.x * (force / program.stiffness)
            if not raw.is_solved or not np.isfinite(x).all():
                engine = None  # a workspace that failed once is not used again
                x = np.where(np.isfinite(x), x, 0.0)
            answer = transposed @ (units * x)
            return Answer(answer[:n], answer[n:], raw.iterations, raw.status)

        return solve
