"""The secular equation: how far along its curve a ball is left and met."""

from __future__ import annotations

import numpy as np

STEPS = 100  # a bound that is not met: each change of regime takes a few


def secular(a: np.ndarray, k: np.ndarray, radius: float) -> float:
    """The root nu > 0 of  |x(nu)| = radius,  x_i(nu) = a_i / (1 + nu k_i),  for radius < |a|.

    1 / |x(nu)| is concave and grows, so that Newton's method from nu = 0 rises to the root and
    never passes it, whatever the k_i (J. More, D. Sorensen, Computing a trust region step, SIAM J.
    Sci. Stat. Comput. 4(3), 1983).

    Parameters
    ----------
    a : ndarray, shape (n,)
    k : ndarray, shape (n,), > 0
    radius : float, > 0

    Examples
    --------
    >>> secular(np.array([3.0, 4.0]), np.array([1.0, 1.0]), 2.5)
    1.0
    """
    nu = 0.0
    for _ in range(STEPS):
        falling = 1 + nu * k
        x = a / falling
        square = float(x @ x)
        step = (np.sqrt(square) / radius - 1) * square / float(x @ (x * k / falling))
        nu += max(step, 0.0)  # a step back is rounding
        if step <= 1e-15 * nu:
            break
    return float(nu)
