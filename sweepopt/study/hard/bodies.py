"""What the hard cases are made of: small matrices, sets on some unknowns, one step or a run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from sweepopt.errors import SweepoptError
from sweepopt.problem import SweepingProcess
from sweepopt.sets import AnySet, Box, ConvexSet, Moving, image

Random = np.random.Generator
N, FEW = 36, 14  # unknowns, and those of them in contact


@dataclass(frozen=True)
class Hard:
    """A process and how it is run with implicit Euler.

    Attributes
    ----------
    process : callable
        Makes it: a refusal counts as an answer.
    refused : type or None
        The error that is the right answer.
    drawn : str
        What is hard about a case that was drawn by chance.
    """

    process: Callable[[], SweepingProcess]
    t_end: float = 1.0
    steps: int = 1
    refused: type[SweepoptError] | None = None
    drawn: str = ""


Family = Callable[[Random], Hard]


def chain(random: Random, n: int = N) -> np.ndarray:
    """A chain of springs of different stiffness, held a little everywhere."""
    return rod(random.uniform(0.5, 2.0, n + 1)) + 0.01 * np.eye(n)


def rod(k: np.ndarray) -> np.ndarray:
    """Springs in a row, held at both ends."""
    return np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)


def spectral(random: Random, values: np.ndarray) -> np.ndarray:
    """A full matrix with these eigenvalues."""
    Q = np.linalg.qr(random.normal(size=(values.size, values.size)))[0]
    M = (Q * values) @ Q.T
    return 0.5 * (M + M.T)


def nearly_singular(random: Random) -> np.ndarray:
    """beta 1e-8."""
    M = chain(random)
    return M - (np.linalg.eigvalsh(M)[0] - 1e-8) * np.eye(N)


def slivers(random: Random) -> np.ndarray:
    """A square of triangles, every other column of them 1e-6 wide, held along two sides."""
    x = np.cumsum(np.tile([1.0, 1e-6], 4)[:7])
    points = np.array([(a + 1e-7 * random.uniform(), b) for b in np.linspace(0, 1, 7) for a in x])
    M = np.zeros((49, 49))
    for corner in (7 * j + i for j in range(6) for i in range(6)):
        for triangle in ([0, 1, 8], [0, 8, 7]):
            nodes = corner + np.array(triangle)
            M[np.ix_(nodes, nodes)] += _laplace(points[nodes])
    free = np.array([k for k in range(49) if k % 7 and k // 7])
    return 0.5 * (M + M.T)[np.ix_(free, free)]


def _laplace(p: np.ndarray) -> np.ndarray:
    edges = p[[2, 0, 1]] - p[[1, 2, 0]]
    area = 0.5 * abs(edges[0, 0] * edges[1, 1] - edges[0, 1] * edges[1, 0])
    return edges @ edges.T / (4 * area)


def contacts(random: Random, count: int = FEW, dim: int = N) -> np.ndarray:
    """A few of the unknowns."""
    return np.sort(random.permutation(dim)[:count])


def translate(part: ConvexSet, force: Any, few: np.ndarray | None = None, dim: int = N) -> AnySet:
    """force(t) + a set on all unknowns, or on a few."""
    if few is None:
        return Moving(part, force)
    E = np.zeros((dim, few.size))
    E[few, np.arange(few.size)] = 1.0
    return Moving(image(E, part), force)


def one_step(M: np.ndarray, force: np.ndarray, part: Any, few: np.ndarray | None = None) -> Hard:
    """One step of a body at rest under a force; `part` is a set, or the bounds of friction."""
    dim = len(M)
    part = part if isinstance(part, ConvexSet) else Box(-part, part)
    return Hard(lambda: SweepingProcess(M, None, translate(part, force, few, dim), np.zeros(dim)))


def friction_step(random: Random, M: np.ndarray, units: Any = 1.0, forces: float = 1.0) -> Hard:
    """One step with friction at a few unknowns, lengths in units of 1 / units."""
    few, units = contacts(random), np.broadcast_to(units, N)
    f, g = forces * 3 * random.normal(size=N), forces * random.uniform(0.2, 2.0, FEW)
    scaled = forces * (units[:, None] * M * units)
    return one_step(scaled, units * f, units[few] * g, few)
