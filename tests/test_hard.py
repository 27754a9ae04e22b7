"""One-step programs on which solvers alone fail: threshold loads, mixed units, bad conditioning."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import sweepopt as so
from sweepopt.plan import make_plan
from sweepopt.schemes import SCHEMES

RNG = np.random.default_rng(0)
N = 60
A = 2.001 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1)
LOAD, G = 3 * RNG.normal(size=N), RNG.uniform(0.5, 2, N)
BASIS = np.linalg.qr(RNG.normal(size=(N, N)))[0]
UNITS = np.logspace(-6, 6, N)
Program = tuple[np.ndarray, np.ndarray, np.ndarray]


def spectral(values: np.ndarray) -> np.ndarray:
    M = BASIS @ np.diag(values) @ BASIS.T
    return 0.5 * (M + M.T)


# M, q, g and the certificate that can be asked for
HARD: dict[str, tuple[Callable[[], Program], float]] = {
    "plain": (lambda: (A, LOAD, G), 1e-12),
    "beta 1e-8": (lambda: (A - (np.linalg.eigvalsh(A)[0] - 1e-8) * np.eye(N), LOAD, G), 1e-12),
    "condition 1e12": (lambda: (spectral(np.logspace(-12, 0, N)), LOAD, G), 1e-6),
    "glued beside nearly free": (lambda: (A, LOAD, np.where(np.arange(N) % 2, 1e12, 1e-3)), 1e-12),
    "g from 1e-12 to 1e12": (lambda: (A, LOAD, np.logspace(-12, 12, N)), 1e-11),
    "forces x 1e-9": (lambda: (1e-9 * A, 1e-9 * LOAD, 1e-9 * G), 1e-12),
    "lengths x 1e9": (lambda: (1e-18 * A, LOAD, G), 1e-12),
    "units mixed inside A": (lambda: (UNITS[:, None] * A * UNITS, LOAD * UNITS, G * UNITS), 1e-12),
    "at the threshold": (lambda: (A, np.where(np.arange(N) % 2, G, -G), G), 0.0),
}


@pytest.mark.parametrize("solver", ["auto", "daqp", "newton", "osqp", "clarabel"])
@pytest.mark.parametrize("name", HARD)
def test_hard_programs_are_solved_with_a_proof(name: str, solver: str) -> None:
    make, certificate = HARD[name]
    M, q, g = make()
    process = so.SweepingProcess(M, None, so.Box(-g, g), np.zeros(N))
    plan = make_plan(process, [(0.0, process.C)], SCHEMES["implicit-euler"], solver, 1e-6)
    velocity = plan.velocity(process.A)(q, process.C).velocity
    assert velocity.relative <= certificate
    # the proof once more, from the inclusion itself: stuck inside, slipping against the bound
    force = M @ velocity.z + q
    slips = velocity.z != 0
    size = np.abs(M) @ np.abs(velocity.z) + np.abs(q)
    assert (np.abs(force[~slips]) <= g[~slips] + 1e-5 * size[~slips]).all()
    assert (np.abs(force + g * np.sign(velocity.z))[slips] <= 1e-5 * size[slips]).all()
