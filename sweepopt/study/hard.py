"""Families of hard programs: what solvers alone get wrong, from any seed.

Each makes a small process, so that its exact velocities can be computed (`exact`), and where a
solution does not exist says which error is right. Nothing in them is tuned to a seed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from sweepopt.errors import EmptySetError, SweepoptError
from sweepopt.process import SweepingProcess
from sweepopt.sets import (
    AnySet,
    Balls,
    Box,
    ConvexSet,
    HalfSpace,
    Moving,
    Orthant,
    Point,
    Polyhedron,
    image,
    product,
)

Random = np.random.Generator
N, FEW = 36, 14  # unknowns, and those of them in contact
EPS = 2.0**-52


@dataclass(frozen=True)
class Hard:
    """A process and how it is run; `refused` is the error that is the right answer."""

    process: Callable[[], SweepingProcess]
    t_end: float = 1.0
    steps: int = 1
    refused: type[SweepoptError] | None = None


def chain(random: Random, n: int = N) -> np.ndarray:
    """A chain of springs of different stiffness, held a little everywhere: positive definite."""
    k = random.uniform(0.5, 2.0, n + 1)
    return np.diag(k[:-1] + k[1:] + 0.01) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)


def spectral(random: Random, values: np.ndarray) -> np.ndarray:
    """A full matrix with these eigenvalues."""
    Q = np.linalg.qr(random.normal(size=(values.size, values.size)))[0]
    M = (Q * values) @ Q.T
    return 0.5 * (M + M.T)


def pushed(
    M: np.ndarray, force: np.ndarray, part: ConvexSet, few: np.ndarray | None = None
) -> Hard:
    """One step of a body at rest under a force, with a set on all unknowns or on a few."""
    return Hard(lambda: SweepingProcess(M, None, _moved(part, force, few), np.zeros(len(M))))


def _moved(part: ConvexSet, force: Any, few: np.ndarray | None, dim: int = N) -> AnySet:
    if few is None:
        return Moving(part, force)
    E = np.zeros((dim, few.size))
    E[few, np.arange(few.size)] = 1.0
    return Moving(image(E, part), force)


def _contact(random: Random) -> np.ndarray:
    return np.sort(random.permutation(N)[:FEW])


def _friction(random: Random, M: np.ndarray, units: Any = 1.0, forces: float = 1.0) -> Hard:
    """Friction at a few unknowns, in lengths of 1 / units."""
    few, units = _contact(random), np.broadcast_to(units, N)
    f, g = forces * 3 * random.normal(size=N), forces * random.uniform(0.2, 2.0, FEW)
    scaled = forces * (units[:, None] * M * units)
    return pushed(scaled, units * f, Box(-units[few] * g, units[few] * g), few)


def threshold(random: Random) -> Hard:
    """Each load is its friction bound, or up to 1e-14 beside it."""
    g = random.uniform(0.5, 2.0, N)
    beside = 1 + random.choice([0, 0, 0, 1e-14, -1e-14], N)
    return pushed(chain(random), random.choice([-1.0, 1.0], N) * g * beside, Box(-g, g))


def weakly_active(random: Random) -> Hard:
    """Loads beside their bounds by 1e-3 to 1e-13 of these."""
    g = random.uniform(0.5, 2.0, N)
    beside = 1 + random.choice([-1.0, 1.0], N) * 10 ** random.uniform(-13, -3, N)
    return pushed(chain(random), random.choice([-1.0, 1.0], N) * g * beside, Box(-g, g))


def small_beta(random: Random) -> Hard:
    """beta 1e-8."""
    M = chain(random)
    return _friction(random, M - (np.linalg.eigvalsh(M)[0] - 1e-8) * np.eye(N))


def condition(random: Random) -> Hard:
    """cond(A) = 1e12."""
    return _friction(random, spectral(random, np.logspace(-12, 0, N)))


def condition_all(random: Random) -> Hard:
    """cond(A) = 1e12, all in contact."""
    M, g = spectral(random, np.logspace(-12, 0, N)), random.uniform(0.2, 2.0, N)
    return pushed(M, 3 * random.normal(size=N), Box(-g, g))


def mixed_bounds(random: Random) -> Hard:
    """g from 0 to 1e12 and inf in one contact."""
    g = random.permutation(np.concatenate([[0.0, 0.0, np.inf, np.inf], np.logspace(-12, 12, 10)]))
    return pushed(chain(random), 3 * random.normal(size=N), Box(-g, g), _contact(random))


def mixed_bounds_all(random: Random) -> Hard:
    """g from 0 to 1e12 and inf at all unknowns."""
    g = 10 ** random.uniform(-12, 12, N)
    g[random.permutation(N)[:6]] = [0.0, 0.0, np.inf, np.inf, 1e12, 1e-12]
    return pushed(chain(random), 3 * random.normal(size=N), Box(-g, g))


def forces_up(random: Random) -> Hard:
    """Forces x 2^40."""
    return _friction(random, chain(random), forces=2.0**40)


def forces_down(random: Random) -> Hard:
    """Forces x 2^-40."""
    return _friction(random, chain(random), forces=2.0**-40)


def lengths_up(random: Random) -> Hard:
    """Lengths x 2^40."""
    return _friction(random, chain(random), units=2.0**-40)


def lengths_down(random: Random) -> Hard:
    """Lengths x 2^-40."""
    return _friction(random, chain(random), units=2.0**40)


def mixed_units(random: Random) -> Hard:
    """Units of 2^-40 to 2^40 mixed inside one A."""
    return _friction(random, chain(random), units=2.0 ** random.integers(-40, 41, N))


def graded(random: Random) -> Hard:
    """A rod with cells from 1 to 1e-6."""
    h = random.permutation(np.logspace(-6, 0, N + 1))
    k = random.uniform(0.5, 2.0, N + 1) / h
    M = np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
    return _friction(random, M)


def jumps(random: Random) -> Hard:
    """Coefficients that jump by 1e8."""
    k = random.choice([1.0, 1e8], N + 1) * random.uniform(0.5, 2.0, N + 1)
    M = np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
    return _friction(random, M)


def slivers(random: Random) -> Hard:
    """A square of sliver triangles: heights of 1e-6 of the edges, every other column."""
    x = np.cumsum(np.tile([1.0, 1e-6], 4)[:7]) + 0.0
    points = np.array([(a + 1e-7 * random.uniform(), b) for b in np.linspace(0, 1, 7) for a in x])
    M = np.zeros((49, 49))
    for j in range(6):
        for i in range(6):
            a, b, c, d = 7 * j + i, 7 * j + i + 1, 7 * j + i + 7, 7 * j + i + 8
            for triangle in ([a, b, d], [a, d, c]):
                M[np.ix_(triangle, triangle)] += _laplace(points[triangle])
    free = np.array([k for k in range(49) if k % 7 and k // 7])  # held along two sides
    return _friction(random, M[np.ix_(free, free)])


def _laplace(p: np.ndarray) -> np.ndarray:
    edges = p[[2, 0, 1]] - p[[1, 2, 0]]
    area = 0.5 * abs(edges[0, 0] * edges[1, 1] - edges[0, 1] * edges[1, 0])
    return edges @ edges.T / (4 * area)


def singleton(random: Random) -> Hard:
    """C(t) one point."""
    return pushed(chain(random), random.normal(size=N), Point(random.normal(size=N)))


def thin(random: Random) -> Hard:
    """A box of widths 1e-14 to 1."""
    g = 10 ** random.uniform(-14, 0, N)
    return pushed(chain(random), 3 * random.normal(size=N), Box(-g, g))


def unbounded(random: Random) -> Hard:
    """An orthant: contact that only pushes."""
    return pushed(chain(random), random.normal(size=N), Orthant(FEW), _contact(random))


def half_space(random: Random) -> Hard:
    """A half-space."""
    return pushed(chain(random), 3 * random.normal(size=N), HalfSpace(random.normal(size=N), 0.3))


def near_parallel(random: Random) -> Hard:
    """Half-spaces whose normals differ by 1e-7."""
    row = random.normal(size=4)
    G = row + 1e-7 * random.normal(size=(3, 4))
    return pushed(chain(random, 4), -5 * row + random.normal(size=4), Polyhedron(G, np.ones(3)))


def near_empty(random: Random) -> Hard:
    """A strip 1e-9 wide."""
    row = random.normal(size=4)
    return pushed(
        chain(random, 4), 5 * random.normal(size=4), Polyhedron([row, -row], [0.5, -0.5 + 1e-9])
    )


def empty(random: Random) -> Hard:
    """A strip that is missing by 1e-9."""
    row = random.normal(size=4)
    made = pushed(
        chain(random, 4), random.normal(size=4), Polyhedron([row, -row], [0.5, -0.5 - 1e-9])
    )
    return Hard(made.process, refused=EmptySetError)


def wedge(random: Random) -> Hard:
    """A polyhedron of many rows on a few unknowns."""
    G = random.normal(size=(10, 5))
    few = np.sort(random.permutation(N)[:5])
    return pushed(chain(random), 5 * random.normal(size=N), Polyhedron(G, np.ones(10)), few)


def corner(random: Random) -> Hard:
    """A corner of C(t) sweeps past: 30 steps."""
    G = np.array([[1.0, 0.2], [0.3, 1.0], [-1.0, -0.6]]) + 0.1 * random.normal(size=(3, 2))
    phase = random.uniform(0, 6)
    load = lambda t: 3 * np.array([np.cos(t + phase), np.sin(2 * t + phase)])  # noqa: E731
    A, B = chain(random, 2), chain(random, 2)
    C = Moving(Polyhedron(G, np.ones(3)), load)
    return Hard(lambda: SweepingProcess(A, B, C, np.zeros(2)), 6.0, 30)


def rotating(random: Random) -> Hard:
    """Second-order-cone friction under a load that rotates through zero: 20 steps."""
    few, radii = np.sort(random.permutation(N)[:8]), random.uniform(0.2, 1.0, 4)
    one, two = random.normal(size=(2, N))
    load = lambda t: np.sin(t - 0.5) * (np.cos(t) * one + np.sin(t) * two)  # noqa: E731
    A, B = chain(random), chain(random)
    C = _moved(Balls(radii, 2), load, few)
    return Hard(lambda: SweepingProcess(A, B, C, np.zeros(N)), 6.0, 20)


def cone_units(random: Random) -> Hard:
    """Second-order-cone friction, forces x 2^-40."""
    few = np.sort(random.permutation(N)[:8])
    radii = random.uniform(0.2, 1.0, 4)
    scale = 2.0**-40
    return pushed(
        scale * chain(random), scale * random.normal(size=N), Balls(scale * radii, 2), few
    )


def cone_threshold(random: Random) -> Hard:
    """Balls whose loads are at their radii up to 1e-12."""
    radii = random.uniform(0.5, 2.0, N // 2)
    angle = random.uniform(0, 6, N // 2)
    size = radii * (1 + random.choice([1e-6, -1e-6, 1e-10, 1e-12, -1e-12], N // 2))
    force = (size * np.array([np.cos(angle), np.sin(angle)])).T.ravel()
    return pushed(chain(random), force, Balls(radii, 2))


def _run(
    random: Random, nu: float, B: np.ndarray | None, t_end: float = 6.0, steps: int = 12
) -> Hard:
    few, g = _contact(random), random.uniform(0.2, 1.0, FEW)
    shape, A = random.normal(size=N), nu * chain(random)
    C = _moved(Box(-g, g), lambda t: 3 * np.sin(t) * shape, few)
    return Hard(lambda: SweepingProcess(A, B, C, np.zeros(N)), t_end, steps)


def no_stiffness(random: Random) -> Hard:
    """B = 0."""
    return _run(random, 1.0, None)


def singular_stiffness(random: Random) -> Hard:
    """B of rank one."""
    row = random.normal(size=N)
    return _run(random, 1.0, np.outer(row, row))


def viscosity(random: Random) -> Hard:
    """A -> 0: viscosity 1e-2 to 1e-12."""
    return _run(random, 10.0 ** -random.integers(2, 13), chain(random))


def no_viscosity(random: Random) -> Hard:
    """A = 0."""
    return _run(random, 0.0, chain(random))


def stiff(random: Random) -> Hard:
    """|B| / beta = 1e10."""
    return _run(random, 1.0, 1e10 * spectral(random, np.logspace(-10, 0, N)))


def stiff_uniform(random: Random) -> Hard:
    """B = 1e10 chain."""
    return _run(random, 1.0, 1e10 * chain(random))


def short_steps(random: Random) -> Hard:
    """Steps of 1e-10."""
    few, g = _contact(random), random.uniform(0.2, 1.0, FEW)
    shape, A, B = random.normal(size=N), chain(random), chain(random)
    C = _moved(Box(-g, g), lambda t: (1 + t) * 3 * shape, few)
    return Hard(lambda: SweepingProcess(A, B, C, np.zeros(N)), 1e-9, 10)


def long_steps(random: Random) -> Hard:
    """Steps of 10."""
    return _run(random, 1.0, chain(random), 100.0, 10)


def jumping(random: Random) -> Hard:
    """A load that jumps from 0 to 1e6 and back."""
    few, g = _contact(random), random.uniform(0.2, 1.0, FEW)
    shape, A, B = random.normal(size=N), chain(random), chain(random)
    C = _moved(Box(-g, g), lambda t: (1e6 if int(t) % 2 else 1e-6) * shape, few)
    return Hard(lambda: SweepingProcess(A, B, C, np.zeros(N)), 6.0, 12)


def repeated(random: Random) -> Hard:
    """The same contact unknown named three times."""
    few = _contact(random)
    again = np.concatenate([few, few[:3], few[:1]])
    g = random.uniform(0.2, 1.0, again.size)
    M, force = chain(random), 3 * random.normal(size=N)
    return Hard(lambda: SweepingProcess(M, None, _moved(Box(-g, g), force, again), np.zeros(N)))


def parts(random: Random) -> Hard:
    """A box, a disc and a half-line side by side, glued unknowns between them."""
    ends = random.uniform(0.2, 1.0, 5)
    part = product(Box(-ends, ends), Box([-np.inf] * 2, [np.inf] * 2), Orthant(3))
    few = np.sort(random.permutation(N)[: part.dim])
    return pushed(chain(random), 3 * random.normal(size=N), part, few)


FAMILIES = {
    name: made
    for name, made in list(globals().items())
    if callable(made)
    and getattr(made, "__annotations__", {}).get("return") == "Hard"
    and name not in ("pushed", "_friction", "_run")
}
