"""Small and random processes, and what tests of several files measure; of light imports."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import sweepopt as so


@dataclass(frozen=True)
class Spiral:
    """speed t cos(rate t + phase): a history that declares a bound of its variation."""

    speed: float
    rate: float
    phase: float

    def __call__(self, t: Any) -> Any:
        return self.speed * np.asarray(t) * np.cos(self.rate * np.asarray(t) + self.phase)

    def variation(self, a: float, b: float) -> float:
        """At most int speed (1 + rate |t|) dt."""
        return self.speed * (b - a + self.rate * (b * abs(b) - a * abs(a)) / 2)

    def breakpoints(self, a: float, b: float) -> np.ndarray:
        """None."""
        return np.empty(0)


SQUARE = so.Box([-1.0, -1.0], [1.0, 1.0])


def springs(n):
    """Springs of stiffness 1 in a row of n masses, held at both ends."""
    return 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)


def worst_certificate(sol):
    """The largest relative one of all steps."""
    return sol.stats["relative"].max()


def refuses(words):
    """Bad input gets an InputError with these words, a regular expression."""
    return pytest.raises(so.InputError, match=words)


def block(load, A=0.5, B=2.0, u0=0.0):
    """One unknown in the interval of half width 1 around a load."""
    return so.SweepingProcess(A, B, so.Moving(so.Box(-1, 1), load), u0)


def isotropic(C, A=1.0, B=None):
    """The process of C from 0 whose A and B are multiples of the identity."""
    one = np.eye(C.dim)
    return so.SweepingProcess(A * one, None if B is None else B * one, C, np.zeros(C.dim))


def close_bound(sol, times, u, most, known=1.0):
    """The bound of a run is guaranteed, above its error and at most so many times it.

    u at these times is exact, or known to a share 1 - `known` of the error.
    """
    bound, error = sol.error_bound(), max(map(sol.process.metric.norm, sol(times) - u))
    assert bound.guaranteed
    assert bound.lower <= 1.1 * error  # the worst time may be between those looked at
    assert 0.0 < known * error <= bound <= most * error


def slow(*values):
    """Values of a test that are left to -m slow."""
    return pytest.param(*values, marks=pytest.mark.slow)


def slope(steps, errors):
    """The observed order: errors are as steps to the power of minus that."""
    return -np.polyfit(np.log(steps), np.log(errors), 1)[0]


# ---- random processes -------------------------------------------------------------------------


def random_matrix(random, n, rank=None):
    turn = np.linalg.qr(random.normal(size=(n, n)))[0]
    values = 10 ** random.uniform(-1, 1, n)
    values[rank:] = values[rank:] * (rank is None)
    M = turn * values @ turn.T
    return 0.5 * (M + M.T)


def random_history(random, a, b, whole):
    """A load on [a, b]; in whole numbers, which meet thresholds exactly, from 0 at 0 on."""
    if whole:
        kinds = [
            so.Triangle(float(random.integers(1, 4)), float(random.choice([4, 6, 8]))),
            so.Table(np.arange(13.0), np.append(0.0, np.cumsum(random.integers(-1, 2, 12)))),
            so.Sine(float(random.integers(1, 4)), float(random.choice([4, 6, 12]))),
            so.Polynomial([0.0, 1.0, -1 / 12]),
        ]
    else:
        period, inner = random.uniform(0.3, 3) * (b - a), np.sort(random.uniform(a, b, 3))
        kinds = [
            so.Sine(random.uniform(0.5, 3), period, random.uniform(0, 6)),
            so.Triangle(random.uniform(0.5, 3), period),
            so.Table([a - 1, *inner, b + 1], 2 * random.normal(size=5)),
            so.Polynomial(random.normal(size=7) / 6.0 ** np.arange(7)),
        ]
    return kinds[random.integers(len(kinds))]


def random_set(random, n, polyhedral, whole):
    low, up = random.integers(0, 2, (2, n)) if whole else random.uniform(0.1, 2, size=(2, n))
    first, ones = np.eye(n)[:, :1], np.ones(n)
    G, h = random.normal(size=(n + 2, n)), random.uniform(0.2, 1.5, n + 2)
    if whole:
        G, h = np.vstack([first.T, random.integers(-1, 2, (2 * n, n))]), 1.0
        G = G[np.abs(G).sum(axis=1) > 0]
        G, h = np.vstack([G, 2.5 * G]), np.repeat([1, 2.5], len(G))
    kinds = [
        lambda: so.Box(-low, up),
        lambda: so.Box(-low, np.where(random.random(n) < 0.5, np.inf, up)),
        lambda: so.Orthant(n) - (0 if whole else 1) * ones,
        lambda: so.Polyhedron(G, h),
        lambda: so.Polytope(np.vstack([np.eye(n), -np.eye(n)]) if whole else G),
    ]
    if not polyhedral:
        kinds += [
            lambda: so.Ball(0.3 * random.normal(size=n), low[0]),
            lambda: so.Balls(low, 1),
            lambda: so.Ellipsoid(0.3 * random.normal(size=n), random_matrix(random, n)),
            lambda: so.Box(-low, up) + so.Ball(np.zeros(n), 0.3),
            lambda: -so.Ball(ones, 1.5),
            lambda: so.image(first, so.Box(-1, 1)) + random.normal(size=n),
            lambda: so.image(first, so.Ball(0.0, 1.0)) + random.normal(size=n),
            lambda: so.product(*(so.Ball(0.0, r) for r in low)),
        ]
    return kinds[random.integers(len(kinds))]()


def random_process(seed, rate_independent=None, polyhedral=False, whole=False):
    """A process and a coarse, uneven grid; polyhedral sets under loads in closed form, or any."""
    random = np.random.default_rng(seed)
    n, a = int(random.integers(1, 6)), 0.0 if whole else float(random.choice([0.0, -1.3, 2.7]))
    b = a + (12.0 if whole else float(random.uniform(0.5, 6)))
    if rate_independent is None:
        rate_independent = random.random() < 0.4
    if whole:
        chain = springs(n)
        A, B = (random.integers(0, 2) * chain + np.eye(n), random.integers(0, 3) * chain)
    else:
        A = random_matrix(random, n)
        singular = random.random() >= 0.6
        B = random_matrix(random, n, int(random.integers(0, n + 1)) if singular else None)
    if rate_independent:
        A, B = 0 * A, A

    def vector(size):
        return random.integers(-1, 2, size) * 1.0 if whole else random.normal(size=size)

    load = [(random_history(random, a, b, whole), vector(n)) for _ in range(2)]
    scale = None
    if not polyhedral and random.random() < 0.2:
        scale = so.Sine(0.5, b - a, 0.0, 1.2)
    if not polyhedral and random.random() < 0.2:
        load[0] = Spiral(0.4, 6 / (b - a), random.uniform(0, 6)), load[0][1]
    C = so.Moving(random_set(random, n, polyhedral, whole), so.Separable(load), scale)
    if polyhedral and random.random() < 0.2:
        m = int(random.integers(1, 3 * n + 2))
        h = [(so.Constant(2.0), np.ones(m)), (so.Triangle(1.0, 4.0), np.sign(vector(m)))]
        C = so.Polyhedron(vector(m * n).reshape(m, n), so.Separable(h))
    u0 = 0.0 * vector(n) if whole else vector(n)
    if rate_independent:
        u0 = np.linalg.solve(B, C.at(a).project(B @ u0))
    steps = int(random.integers(3, 21))
    inner = np.arange(1, steps) + 0.8 * (random.random(steps - 1) - 0.5)
    times = np.concatenate([[a], a + (b - a) * inner / steps, [b]])
    return so.SweepingProcess(A, B, C, u0), times
