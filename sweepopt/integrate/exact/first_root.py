"""The first time at which one of several closed forms turns negative, which cannot be missed.

A bound M of |f''| on all of the rest proves f > 0 up to the root of f + f' h - M h^2 / 2: each step
is the largest that is proved free of roots. From the left it converges to a simple root like
Newton's method and never passes it.
"""

from __future__ import annotations

import numpy as np

from sweepopt.errors import SweepoptError
from sweepopt.integrate.exact.exponential_sum import ExponentialSum
from sweepopt.linalg import EPS

NOISE = 16 * EPS  # rounding of a value, in units of the sum of its absolute terms
ITERATIONS = 100_000  # a simple root takes about ten
TINY = np.sqrt(np.finfo(float).tiny)  # a product with it does not underflow


@np.errstate(over="ignore", divide="ignore", invalid="ignore")
def first_root(f: ExponentialSum, orders: np.ndarray) -> float:
    """The first tau in (0, length) at which an entry of f turns negative; length if none does.

    Parameters
    ----------
    f : ExponentialSum
    orders : ndarray of int, shape (rows,)
        How many leading Taylor coefficients of an entry are zero at tau = 0; the next one is
        positive, so that an entry that starts from zero rises from it.
    """
    length, df = f.length, f.derivative()
    ddf, tau = df.derivative(), 0.0
    for _ in range(ITERATIONS):
        b = f.basis(tau)
        value, slope = (f.weights @ b).real, (df.weights @ b).real
        noise = NOISE * (f.sizes @ np.abs(b))
        zero = value <= noise
        falls = zero & (slope <= NOISE * (df.sizes @ np.abs(b)))
        M = np.maximum(ddf.sizes @ f.bound(tau), TINY)
        height = np.where(zero, 0.0, value)
        root = np.sqrt(slope**2 + 2 * M * height)
        h = np.where(slope < 0, 2 * height / (root - slope), (slope + root) / M)
        h = np.where(zero, np.maximum(h, np.sqrt(noise / M)), h)
        if tau == 0.0:
            until = _positive_until(f, orders)
            # until = 0: rounding hides the leading derivative, and the values decide
            falls, h = falls & (orders == 0), np.where((orders > 0) & (until > 0), until, h)
        if falls.any():
            beyond = _beyond_touch(f, np.flatnonzero(falls), tau, noise[falls])
            if beyond is None:
                return tau
            h[falls] = beyond
        tau += max(float(h.min(initial=np.inf)), EPS * tau)
        if tau >= length:
            return length
    raise SweepoptError(
        f"no event in {ITERATIONS} steps that are proved free of events; the rates of the "
        "process are too far apart for scheme='exact', use implicit-euler or sdirk2"
    )


def _beyond_touch(
    f: ExponentialSum, rows: np.ndarray, tau: float, noise: np.ndarray
) -> np.ndarray | None:
    """Steps after which entries at zero are positive again, where they only touch it.

    Where f'' stays above half of its value c up to h = 4 |f'| / c, f falls by f'^2 / c at most:
    this must be rounding. None if an entry may turn negative.
    """
    first = f.with_weights(f.weights[rows]).derivative()
    second = first.derivative()
    third = second.derivative()
    slope, c = np.minimum(first(tau), 0.0), second(tau)
    if not (c > 0).all():
        return None
    h = 4 * np.abs(slope) / c
    steady = third.sizes @ f.bound(tau) * h <= 0.5 * c
    return h if (steady & (slope**2 <= 4 * noise * c)).all() else None


def _positive_until(f: ExponentialSum, orders: np.ndarray) -> np.ndarray:
    """Up to where an entry that rises from zero with its k-th derivative stays positive."""
    until, curve = np.full(orders.size, np.inf), f
    for order in range(1, int(orders.max(initial=0)) + 1):
        curve = curve.derivative()
        leading = np.maximum(curve(0.0), 0.0)
        ratio = 0.5 * leading / (curve.derivative().sizes @ f.bound(0.0))
        # 0 / 0 is a constant
        until = np.where((orders == order) & (ratio >= 0), ratio, until)
    return until
