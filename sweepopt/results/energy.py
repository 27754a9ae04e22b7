"""Where the work of the loads goes: stored, dissipated by viscosity, dissipated by friction."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sweepopt.checks import Array
from sweepopt.display import by_parts
from sweepopt.integrate import States
from sweepopt.problem import SweepingProcess


class Energy(NamedTuple):
    """Energies from the start to each time, shape (n+1,); dissipated + stored = work + O(mu).

    Of a body with a prescribed displacement only `friction` is known: the others are nan after the
    start, as what is held and moved is no unknown.

    Attributes
    ----------
    stored : ndarray
        1/2 <B u, u>, its change since t_0.
    viscous : ndarray
        int <A u', u'>.
    friction : ndarray
        int J(u'), J the support function of D where C(t) = f(t) - D.
    work : ndarray
        int <f, u'>.
    """

    stored: Array
    viscous: Array
    friction: Array
    work: Array

    def __repr__(self) -> str:
        return by_parts(self)

    @property
    def balance(self) -> Array:
        """stored + viscous + friction - work: zero but for errors of the scheme and within steps.

        u is taken as linear within a step, also where scheme="exact" knows it at both ends.
        """
        return self.stored + self.viscous + self.friction - self.work


def energy_of(process: SweepingProcess, t: Array, states: States) -> Energy:
    """Energies of a run of which all steps are kept; forces are taken at the middle of each."""
    mu, known = np.diff(t), np.nan if process.moved else 1.0
    powers = np.zeros((3, len(t)))  # viscous, friction, work; none before the start
    for i in range(len(mu)):
        z = states.velocity(i)
        C = process.set_at(float(t[i] + 0.5 * mu[i]), states.u(i) + 0.5 * mu[i] * z)
        work = C.anchor @ z
        powers[:, i + 1] = known * z @ (process.A @ z), C.support(-z) + work, known * work
    stored = np.array([0.5 * known * u @ process.times_B(u) for u in map(states.u, range(len(t)))])
    return Energy(stored - stored[0], *np.cumsum(powers * np.append(0.0, mu), axis=1))
