"""Hard runs: some steps each, so that one step's answer is the next one's data."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sweepopt.loads import Separable
from sweepopt.problem import SweepingProcess
from sweepopt.sets import Balls, Box, Moving, Polyhedron
from sweepopt.study.hard.bodies import Hard, Random, chain, contacts, spectral, translate

DIM, HALF = 16, 8  # unknowns, and those of them in contact


def _run(
    random: Random,
    A: np.ndarray,
    B: np.ndarray | None,
    phi: Callable[[float], float] = np.sin,
    t_end: float = 6.0,
    steps: int = 12,
) -> Hard:
    few, g = contacts(random, HALF, DIM), random.uniform(0.2, 1.0, HALF)
    shape = 3 * random.normal(size=DIM)
    C = translate(Box(-g, g), Separable([(phi, shape)]), few, DIM)
    return Hard(lambda: SweepingProcess(A, B, C, np.zeros(DIM)), t_end, steps)


def corner(random: Random) -> Hard:
    """A corner of C(t) sweeps past."""
    G = np.array([[1.0, 0.2], [0.3, 1.0], [-1.0, -0.6]]) + 0.1 * random.normal(size=(3, 2))
    phase = random.uniform(0, 6)
    A, B = chain(random, 2), chain(random, 2)
    C = Moving(
        Polyhedron(G, np.ones(3)),
        lambda t: 3 * np.array([np.cos(t + phase), np.sin(2 * t + phase)]),
    )
    return Hard(lambda: SweepingProcess(A, B, C, np.zeros(2)), 6.0, 30)


def rotating(random: Random) -> Hard:
    """Second-order-cone friction under a load that rotates through zero."""
    few, radii = contacts(random, HALF, DIM), random.uniform(0.2, 1.0, HALF // 2)
    one, two = random.normal(size=(2, DIM))
    A, B = chain(random, DIM), chain(random, DIM)
    load = lambda t: np.sin(t - 0.5) * (np.cos(t) * one + np.sin(t) * two)  # noqa: E731
    C = translate(Balls(radii, 2), load, few, DIM)
    return Hard(lambda: SweepingProcess(A, B, C, np.zeros(DIM)), 6.0, 12)


def no_stiffness(random: Random) -> Hard:
    """B = 0"""
    return _run(random, chain(random, DIM), None)


def singular_stiffness(random: Random) -> Hard:
    """B of rank one"""
    row = random.normal(size=DIM)
    return _run(random, chain(random, DIM), np.outer(row, row))


def proportional(random: Random) -> Hard:
    """B = rho A, rho 1e-6 to 1e6"""
    A = chain(random, DIM)
    return _run(random, A, 10.0 ** random.integers(-6, 7) * A)


def viscosity(random: Random) -> Hard:
    """A -> 0: viscosity 1e-2 to 1e-12"""
    nu = 10.0 ** -random.integers(2, 13)
    return _run(random, nu * chain(random, DIM), chain(random, DIM))


def no_viscosity(random: Random) -> Hard:
    """A = 0"""
    return _run(random, np.zeros((DIM, DIM)), chain(random, DIM))


def stiff(random: Random) -> Hard:
    """|B| / beta = 1e10, eigenvalues of B from 1 to 1e10"""
    return _run(random, chain(random, DIM), spectral(random, np.logspace(0, 10, DIM)))


def stiff_uniform(random: Random) -> Hard:
    """|B| / beta = 1e10, all of B stiff"""
    return _run(random, chain(random, DIM), 1e10 * chain(random, DIM))


def short_steps(random: Random) -> Hard:
    """Steps of 1e-10."""
    A, B = chain(random, DIM), chain(random, DIM)
    return _run(random, A, B, lambda t: 1 + t, 1e-9, 10)


def long_steps(random: Random) -> Hard:
    """Steps of 10."""
    return _run(random, chain(random, DIM), chain(random, DIM), np.sin, 100.0, 10)


def jumping(random: Random) -> Hard:
    """A load that jumps from 1e-6 to 1e6 and back."""
    A, B = chain(random, DIM), chain(random, DIM)
    return _run(random, A, B, lambda t: 1e6 if int(t) % 2 else 1e-6)


def _hold(random: Random, share: float) -> Hard:
    """Loads of `share` times the friction bound, which change their signs."""
    g, sign = random.uniform(0.5, 2.0, DIM), random.choice([-1.0, 1.0], DIM)
    A, B, u0 = chain(random, DIM), chain(random, DIM), random.normal(size=DIM)
    equilibrium = B @ u0

    def load(t: float) -> np.ndarray:
        return equilibrium + (share if int(t) % 2 else -share) * g * sign

    return Hard(lambda: SweepingProcess(A, B, Moving(Box(-g, g), load), u0), 10.0, 500)


def hold_half(random: Random) -> Hard:
    """Held at half the threshold, 500 steps."""
    return _hold(random, 0.5)


def hold_almost(random: Random) -> Hard:
    """Held at 0.999 of the threshold, 500 steps."""
    return _hold(random, 0.999)


def hold_exactly(random: Random) -> Hard:
    """Held exactly at the threshold, 500 steps."""
    return _hold(random, 1.0)


def switches(random: Random) -> Hard:
    """Stick and slip change at almost every step, 200 steps."""
    A, B, g = random.uniform(0.5, 2, 1), random.uniform(0.5, 2, 1), random.uniform(0.2, 0.5, 1)
    C = Moving(Box(-g, g), lambda t: [2.0 * np.sin(40 * t)])
    return Hard(lambda: SweepingProcess([A], [B], C, [0.0]), 10.0, 200)
