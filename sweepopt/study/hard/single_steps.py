"""Hard programs: one step each, made from any seed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sweepopt.errors import EmptySetError
from sweepopt.sets import Balls, Box, HalfSpace, Orthant, Point, Polyhedron, product
from sweepopt.study.hard.bodies import (
    FEW,
    Hard,
    N,
    Random,
    chain,
    contacts,
    friction_step,
    nearly_singular,
    one_step,
    rod,
    slivers,
    spectral,
)


def _beside(random: Random, g: np.ndarray, shares: np.ndarray) -> Hard:
    """Loads beside their bounds by these shares of them."""
    return one_step(chain(random), random.choice([-1.0, 1.0], N) * g * (1 + shares), g)


def threshold(random: Random) -> Hard:
    """Each load is its friction bound, or up to 1e-14 beside it."""
    g = random.uniform(0.5, 2.0, N)
    return _beside(random, g, random.choice([0, 0, 0, 1e-14, -1e-14], N))


def weakly_active(random: Random) -> Hard:
    """Loads beside their bounds by 1e-3 to 1e-13 of these."""
    g = random.uniform(0.5, 2.0, N)
    return _beside(random, g, random.choice([-1.0, 1.0], N) * 10 ** random.uniform(-13, -3, N))


def small_beta(random: Random) -> Hard:
    """beta 1e-8."""
    return friction_step(random, nearly_singular(random))


def condition(random: Random) -> Hard:
    """cond(A) = 1e12."""
    return friction_step(random, spectral(random, np.logspace(-12, 0, N)))


def condition_all(random: Random) -> Hard:
    """cond(A) = 1e12, all in contact."""
    M, g = spectral(random, np.logspace(-12, 0, N)), random.uniform(0.2, 2.0, N)
    return one_step(M, 3 * random.normal(size=N), g)


def mixed_bounds(random: Random) -> Hard:
    """g from 0 to 1e12 and inf in one contact."""
    g = random.permutation(np.concatenate([[0.0, 0.0, np.inf, np.inf], np.logspace(-12, 12, 10)]))
    return one_step(chain(random), 3 * random.normal(size=N), g, contacts(random))


def mixed_bounds_all(random: Random) -> Hard:
    """g from 0 to 1e12 and inf at all unknowns."""
    g = 10 ** random.uniform(-12, 12, N)
    g[random.permutation(N)[:6]] = [0.0, 0.0, np.inf, np.inf, 1e12, 1e-12]
    return one_step(chain(random), 3 * random.normal(size=N), g)


def forces_up(random: Random) -> Hard:
    """Forces x 2^40."""
    return friction_step(random, chain(random), forces=2.0**40)


def forces_down(random: Random) -> Hard:
    """Forces x 2^-40."""
    return friction_step(random, chain(random), forces=2.0**-40)


def lengths_up(random: Random) -> Hard:
    """Lengths x 2^40."""
    return friction_step(random, chain(random), units=2.0**-40)


def lengths_down(random: Random) -> Hard:
    """Lengths x 2^-40."""
    return friction_step(random, chain(random), units=2.0**40)


def mixed_units(random: Random) -> Hard:
    """Units of 2^-40 to 2^40 mixed inside one A."""
    return friction_step(random, chain(random), units=2.0 ** random.integers(-40, 41, N))


def graded(random: Random) -> Hard:
    """A rod with cells from 1 to 1e-6."""
    h = random.permutation(np.logspace(-6, 0, N + 1))
    k = random.uniform(0.5, 2.0, N + 1) / h
    return friction_step(random, rod(k))


def jumps(random: Random) -> Hard:
    """Coefficients that jump by 1e8."""
    k = random.choice([1.0, 1e8], N + 1) * random.uniform(0.5, 2.0, N + 1)
    return friction_step(random, rod(k))


def sliver_triangles(random: Random) -> Hard:
    """A square of sliver triangles: widths of 1e-6 of their heights, every other column."""
    return friction_step(random, slivers(random))


def singleton(random: Random) -> Hard:
    """C(t) one point."""
    return one_step(chain(random), random.normal(size=N), Point(random.normal(size=N)))


def thin(random: Random) -> Hard:
    """A box of widths 1e-14 to 1."""
    g = 10 ** random.uniform(-14, 0, N)
    return one_step(chain(random), 3 * random.normal(size=N), g)


def unbounded(random: Random) -> Hard:
    """An orthant: contact that only pushes."""
    return one_step(chain(random), random.normal(size=N), Orthant(FEW), contacts(random))


def half_space(random: Random) -> Hard:
    """A half-space."""
    return one_step(chain(random), 3 * random.normal(size=N), HalfSpace(random.normal(size=N), 0.3))


def near_parallel(random: Random) -> Hard:
    """Half-spaces whose normals differ by 1e-7."""
    row = random.normal(size=4)
    G = row + 1e-7 * random.normal(size=(3, 4))
    return one_step(chain(random, 4), -5 * row + random.normal(size=4), Polyhedron(G, np.ones(3)))


def _strip(random: Random, force: float, width: float) -> Hard:
    row = random.normal(size=4)
    part = Polyhedron([row, -row], [0.5, -0.5 + width])
    return one_step(chain(random, 4), force * random.normal(size=4), part)


def near_empty(random: Random) -> Hard:
    """A strip 1e-9 wide."""
    return _strip(random, 5.0, 1e-9)


def empty(random: Random) -> Hard:
    """A strip that is missing by 1e-9."""
    return replace(_strip(random, 1.0, -1e-9), refused=EmptySetError)


def wedge(random: Random) -> Hard:
    """A polyhedron of many rows on a few unknowns."""
    G = random.normal(size=(10, 5))
    few = contacts(random, 5)
    return one_step(chain(random), 5 * random.normal(size=N), Polyhedron(G, np.ones(10)), few)


def cone_units(random: Random) -> Hard:
    """Second-order-cone friction, forces x 2^-40."""
    few = contacts(random, 8)
    radii = random.uniform(0.2, 1.0, 4)
    scale = 2.0**-40
    return one_step(
        scale * chain(random), scale * random.normal(size=N), Balls(scale * radii, 2), few
    )


def cone_threshold(random: Random) -> Hard:
    """Balls whose loads are at their radii up to 1e-12."""
    radii = random.uniform(0.5, 2.0, N // 2)
    angle = random.uniform(0, 6, N // 2)
    size = radii * (1 + random.choice([1e-6, -1e-6, 1e-10, 1e-12, -1e-12], N // 2))
    force = (size * np.array([np.cos(angle), np.sin(angle)])).T.ravel()
    return one_step(chain(random), force, Balls(radii, 2))


def repeated(random: Random) -> Hard:
    """The same contact unknown named three times."""
    few = contacts(random)
    again = np.concatenate([few, few[:3], few[:1]])
    g = random.uniform(0.2, 1.0, again.size)
    return one_step(chain(random), 3 * random.normal(size=N), g, again)


def parts(random: Random) -> Hard:
    """A box, a disc and a half-line side by side, glued unknowns between them."""
    ends = random.uniform(0.2, 1.0, 5)
    part = product(Box(-ends, ends), Box([-np.inf] * 2, [np.inf] * 2), Orthant(3))
    few = contacts(random, part.dim)
    return one_step(chain(random), 3 * random.normal(size=N), part, few)


def combined_box(random: Random) -> Hard:
    """Condition 1e6 to 1e12, mixed units, g from 0 to 1e12 and inf."""
    M = spectral(random, np.logspace(-random.uniform(6, 12), 0, N))
    units = 2.0 ** random.integers(-40, 41, N)
    few, g = contacts(random), 10 ** random.uniform(-6, 2, FEW)
    g[random.permutation(FEW)[:4]] = [0.0, np.inf, 1e12, 1e-12]
    scaled, force = units[:, None] * M * units, units * random.normal(size=N)
    return one_step(scaled, force, units[few] * g, few)


def combined_balls(random: Random) -> Hard:
    """Second-order-cone friction, condition 1e6 to 1e12, radii from 1e-6 to 1e2."""
    M = spectral(random, np.logspace(-random.uniform(6, 12), 0, N))
    few, radii = contacts(random, 8), 10 ** random.uniform(-6, 2, 4)
    return one_step(M, random.normal(size=N), Balls(radii, 2), few)


def combined_rows(random: Random) -> Hard:
    """A polyhedron whose rows differ by 1e-6, condition 1e4 to 1e10, forces x 2^40."""
    M = spectral(random, np.logspace(-random.uniform(4, 10), 0, N))
    row, scale = random.normal(size=5), 2.0**40
    G = np.concatenate([row + 1e-6 * random.normal(size=(2, 5)), random.normal(size=(3, 5))])
    few = contacts(random, 5)
    return one_step(
        scale * M, scale * random.normal(size=N), Polyhedron(G, scale * np.ones(5)), few
    )
