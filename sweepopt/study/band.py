"""A component of a run over time, with the band that surely holds the solution's."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sweepopt.errors import SweepoptError
from sweepopt.results import Solution


class Curve(NamedTuple):
    """u[component] at the times t, and the half-width of its band; nan if there is no bound."""

    t: np.ndarray
    u: np.ndarray
    band: np.ndarray
    component: int


def most_moving(solution: Solution) -> Curve:
    """The component that moves most, with a bound of |u_k(t_i) - u_n,k(t_i)|.

    |e_k| <= |e|_A sqrt((A^-1)_kk).
    """
    k = int(np.argmax(np.ptp(solution.u, axis=0)))
    t, u = solution.t, solution.u[:, k]
    try:
        of_t = solution.error_bound().of_t
    except SweepoptError:
        return Curve(t, u, np.full(len(t), np.nan), k)
    unit = np.zeros(solution.process.dim)
    unit[k] = 1.0
    factor = float(np.sqrt(solution.process.metric.solve(unit)[k]))
    # a node belongs to two steps; both bounds hold there
    band = np.concatenate([of_t[:1], np.minimum(of_t[:-1], of_t[1:]), of_t[-1:]])
    return Curve(t, u, factor * np.where(np.isfinite(band), band, np.nan), k)
