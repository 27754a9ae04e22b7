"""The processes that are timed, with the plain data from which a loop by hand starts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Matrix
from sweepopt.loads import Separable, Sine
from sweepopt.problem import EvolutionVI, SweepingProcess
from sweepopt.sets import Box, Moving

SCHEME = "implicit-euler"  # one program a step, as the midpoint rule has


@dataclass(frozen=True, eq=False)
class Case:
    """A process with the load phi(t) shape and friction on some unknowns, at rest at t = 0.

    Attributes
    ----------
    name : str
    problem : EvolutionVI or SweepingProcess
    frictionless : EvolutionVI or None
        The same without its set, where that is timed too.
    phi : callable
    shape : ndarray, shape (dim,)
    contact : ndarray of int, shape (m,)
    threshold : ndarray, shape (m,)
        J(z) = sum of threshold_k |z[contact_k]|.
    times : ndarray, shape (n+1,)
        Equal steps from 0.
    best : str
        The library's most accurate path.
    """

    name: str
    problem: EvolutionVI | SweepingProcess
    frictionless: EvolutionVI | None
    phi: Callable[[Any], Any]
    shape: np.ndarray
    contact: np.ndarray
    threshold: np.ndarray
    times: np.ndarray
    best: str

    @property
    def dim(self) -> int:
        return self.problem.dim

    @property
    def steps(self) -> int:
        return len(self.times) - 1

    @property
    def mu(self) -> float:
        return float(self.times[-1]) / self.steps

    @property
    def B(self) -> Matrix:
        assert self.problem.B is not None  # all cases have one
        return self.problem.B

    @property
    def M(self) -> Matrix:
        """A + mu B, the matrix of every step."""
        return self.problem.A + self.mu * self.B


def square(cells: int, steps: int) -> Case:
    """Antiplane friction on the unit square, P1: clamped above, rubbing below, pulled at the right.

    Uniform viscosity and elasticity, so that B = 2 A; one period of the traction, in which slip
    zones grow, stop and turn round.

    Parameters
    ----------
    cells : int
        Cells a side: 32 gives 1,056 unknowns, 100 gives 10,100, 316 gives 100,172, 1000 gives
        1,001,000.
    steps : int
    """
    from skfem import MeshTri

    from sweepopt.fem import Effect, Elasticity, Friction, Traction, Viscosity, antiplane

    side = np.linspace(0.0, 1.0, cells + 1)
    mesh = MeshTri.init_tensor(side, side).with_defaults()
    wave = Sine(amplitude=2.0, period=4.0)
    traction = Traction("right", history=wave)
    pulled: list[Effect] = [Viscosity(1.0), Elasticity(2.0), traction]
    scene = antiplane(mesh, clamped="top", effects=[*pulled, Friction("bottom", g=0.5)])
    load, contact = scene.problem.load, scene.contact
    assert isinstance(load, Separable)
    assert contact is not None
    return Case(
        f"unit square, {cells} cells a side",
        scene.problem,
        antiplane(mesh, clamped="top", effects=pulled).problem,
        wave,
        load.shapes[:, 0],
        contact.unknown,
        contact.threshold,
        np.linspace(0.0, 4.0, steps + 1),
        "eliminated",
    )


def blocks(dim: int, steps: int) -> Case:
    """Blocks with dashpots 0.5, springs 2 and friction bound 1, pulled by up to 3."""
    shape = np.linspace(3.0, 1.5, dim)
    A, B = (sp.diags_array(np.full(dim, value), format="csc") for value in (0.5, 2.0))
    if dim == 1:
        A, B = A.toarray(), B.toarray()
    C = Moving(Box(-np.ones(dim), np.ones(dim)), center=lambda t: np.sin(2 * t) * shape)
    return Case(
        "a block on a spring" if dim == 1 else f"{dim} blocks on springs",
        SweepingProcess(A, B, C, np.zeros(dim)),
        None,
        lambda t: np.sin(2 * t),
        shape,
        np.arange(dim),
        np.ones(dim),
        np.linspace(0.0, 8.0, steps + 1),
        "auto",
    )
