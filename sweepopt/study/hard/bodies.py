"""Matrices of small bodies: springs in a row, full matrices of any spectrum, slivers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Random = np.random.Generator
N = 36  # unknowns, if a matrix does not say otherwise


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


def _nearly_singular(random: Random) -> np.ndarray:
    M = chain(random)
    return M - (np.linalg.eigvalsh(M)[0] - 1e-8) * np.eye(N)


def _slivers(random: Random) -> np.ndarray:
    """The Laplacian on a rectangle of 7 by 7 cells cut in triangles, held along its sides.

    Linear elements on right triangles: a sum of Kronecker products of two rods.
    """
    wide = np.tile([1.0, 1e-6], 4)[:7] + 1e-7 * random.uniform(size=7)
    mass = np.diag(wide[:-1] + wide[1:]) / 2
    return np.kron(np.eye(6), rod(1 / wide)) + np.kron(rod(np.ones(7)), mass)


MATRICES: dict[str, Callable[[Random], np.ndarray]] = {
    "a chain": chain,
    "cond 1e12": lambda random: spectral(random, np.logspace(-12, 0, N)),
    "cond 1e7": lambda random: spectral(random, np.logspace(-7, 0, N)),
    "beta 1e-8": _nearly_singular,
    "cells 1 to 1e-6": lambda random: rod(1 / random.permutation(np.logspace(-6, 0, N + 1))),
    "jumps of 1e8": lambda random: rod(random.choice([1.0, 1e8], N + 1)),
    "triangles 1e-6 as wide as high": _slivers,
    "ten springs": lambda random: chain(random, 10),
    "four springs": lambda random: chain(random, 4),
    "two springs": lambda random: chain(random, 2),
    "one spring": lambda random: chain(random, 1),
}
