"""The first time at which one of several closed forms turns negative, which cannot be missed.

A bound M of |f''| on all of the rest proves f > 0 up to the root of f + f' h - M h^2 / 2: each step
is the largest that is proved free of roots. From the left it converges to a simple root like
Newton's method and never passes it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sweepopt.errors import SweepoptError
from sweepopt.integrate.exact.curves import Curve
from sweepopt.linalg import EPS

NOISE = 16 * EPS  # of the sum of absolute terms: what a value may be off by
STEPS = 100_000


class Crossing(NamedTuple):
    """When, and which functions are zero there."""

    tau: float
    rows: np.ndarray


def first_crossing(f: Curve, orders: np.ndarray) -> Crossing | None:
    """The first tau in (0, length] at which an entry of f turns negative; None if none does.

    Parameters
    ----------
    f : Curve
    orders : ndarray of int, shape (rows,)
        How many leading Taylor coefficients of an entry are zero at tau = 0; the next one is
        positive, so that an entry that starts from zero rises from it.
    """
    basis, length = f.basis, f.basis.length
    df = f.derivative()
    values, slopes, bends = f.weights, df.weights, df.derivative().sizes
    rises, reach = orders > 0, _reach(f, orders)
    tau = 0.0
    for _ in range(STEPS):
        b = basis.at(tau)
        a = np.abs(b)
        value, slope = values @ b, slopes @ b
        noise = NOISE * (np.abs(values) @ a)
        zero = value <= noise
        hit = zero & (slope <= NOISE * (np.abs(slopes) @ a))
        bend = np.maximum(bends @ basis.bound(tau), np.finfo(float).tiny)
        height = np.where(zero, 0.0, value)
        root = np.sqrt(slope**2 + 2 * bend * height)
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            h = np.where(slope < 0, 2 * height / (root - slope), (slope + root) / bend)
        h = np.where(zero, np.maximum(h, np.sqrt(noise / bend)), h)
        if tau == 0.0:
            hit, h = hit & ~rises, np.where(rises, reach, h)
        if hit.any():
            over = _grazes(f, np.flatnonzero(hit), tau, noise[hit])
            if over is None:
                return Crossing(tau, np.flatnonzero(hit))
            h[hit] = over
        tau += max(float(h.min(initial=np.inf)), EPS * tau)
        if tau >= length:
            return None
    raise SweepoptError(
        f"an event is not found in {STEPS} steps that are proved free of events; the rates of the "
        "process are too far apart for scheme='exact', use implicit-euler or sdirk2"
    )


def _grazes(f: Curve, rows: np.ndarray, tau: float, noise: np.ndarray) -> np.ndarray | None:
    """Steps after which entries at zero rise again, if none of them turns negative beyond rounding.

    Where f'' stays above half of its value c up to h = 4 |f'| / c, f falls by f'^2 / c at most.
    """
    first = Curve(f.basis, f.weights[rows]).derivative()
    second = first.derivative()
    third = second.derivative()
    b = f.basis.at(tau)
    slope, bend = np.minimum(first.weights @ b, 0.0), second.weights @ b
    if not (bend > 0).all():
        return None
    step = 4 * np.abs(slope) / bend
    steady = third.sizes @ f.basis.bound(tau) * step <= 0.5 * bend
    return step if (steady & (slope**2 <= 4 * noise * bend)).all() else None


def _reach(f: Curve, orders: np.ndarray) -> np.ndarray:
    """Up to where an entry that rises from zero with its k-th derivative stays positive."""
    reach = np.full(orders.size, np.inf)
    curve, bound, start = f, f.basis.bound(0.0), f.basis.at(0.0)
    for order in range(1, int(orders.max(initial=0)) + 1):
        curve = curve.derivative()
        rising = orders == order
        if rising.any():
            leading = curve.weights[rising] @ start
            limit = curve.derivative().sizes[rising] @ bound
            with np.errstate(divide="ignore", over="ignore"):
                reach[rising] = 0.5 * np.where(leading > 0, leading, 0.0) / limit
            reach[rising & ~(reach >= 0)] = np.inf  # 0 / 0: a constant
    return reach
