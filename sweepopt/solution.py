"""A trajectory that can prove how good it is."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sweepopt.errors import InputError, Status, SweepoptError
from sweepopt.plan import Plan, VelocityOf
from sweepopt.process import SweepingProcess

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from xarray import Dataset

STATS = np.dtype(
    [
        ("t", float),
        ("seconds", float),
        ("iterations", int),
        ("attempts", int),
        ("certificate", float),
        ("relative", float),
        ("solver", "U16"),
    ]
)


class Energy(NamedTuple):
    """Energies from the start to each time, shape (n+1,); dissipated + stored = work + O(mu).

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

    stored: np.ndarray
    viscous: np.ndarray
    friction: np.ndarray
    work: np.ndarray

    @property
    def balance(self) -> np.ndarray:
        """stored + viscous + friction - work: zero up to the error of the scheme."""
        return self.stored + self.viscous + self.friction - self.work


@dataclass(frozen=True, eq=False)
class Solution:
    """The piecewise-linear interpolant u_n and its diagnostics.

    Attributes
    ----------
    process : SweepingProcess
    plan : Plan
    t : ndarray, shape (n+1,)
    u : ndarray, shape (n+1, dim)
    velocity : ndarray, shape (n, dim)
        velocity[i] = (u_{i+1} - u_i) / mu.
    stats : structured ndarray, shape (n,)
        One row a step: t (its end), seconds, iterations, attempts, certificate (a bound of
        |z - z*|_M), relative (the certificate in units of the program's size, what tol bounds),
        solver (who found it: a solver's name, "linear", "closed form" or "at rest").
    status : Status
    cause : str
        Which step failed and why, when the run stopped at it.
    """

    process: SweepingProcess
    plan: Plan
    t: np.ndarray
    u: np.ndarray
    velocity: np.ndarray
    stats: np.ndarray
    status: Status
    cause: str = ""

    @property
    def success(self) -> bool:
        """Whether the run reached t_end with no step known to be wrong."""
        return self.status in (Status.SUCCESS, Status.UNCERTIFIED)

    @property
    def message(self) -> str:
        """The status as a sentence, and the cause of an early stop."""
        return f"{self.status.value} {self.cause}".rstrip()

    def __call__(self, t: Any) -> np.ndarray:
        """u_n(t) = u_i + (t - t_i) / mu (u_{i+1} - u_i).

        Parameters
        ----------
        t : float or array_like, shape (k,)

        Returns
        -------
        ndarray, shape (dim,) or (k, dim)

        Raises
        ------
        InputError
            If a time is outside of [t[0], t[-1]].
        """
        times = self._inside(t)
        i = self._interval(times)
        share = (times - self.t[i]) / (self.t[i + 1] - self.t[i])
        # the form with two weights meets both nodes exactly
        share = share[..., None]
        return (1 - share) * self.u[i] + share * self.u[i + 1]

    def viability(self, t: Any = None) -> np.ndarray:
        """How far the viability condition A u' + B u in C(t) is missed, in the A^-1 metric.

        Parameters
        ----------
        t : float or array_like, shape (k,), optional
            Without it: for each step a bound of the distance of the stage's M z + q to its C, from
            the certificate: |.|_{A^-1} <= sqrt(1 + mu a_kk Lam) |.|_{M^-1}. With it: the distance
            of A u_n'(t) + B u_n(t) to C(t), u_n' the left derivative (the right one at t[0]);
            O(mu) for the first-order schemes.

        Returns
        -------
        ndarray, shape (n,), () or (k,)
        """
        if t is None:
            implicit = max(row[-1] for row in self.plan.scheme.a) * np.diff(self.t)
            ratio = self.process.Lam if not self.process.rate_independent else 1.0
            ratios = float(not self.process.rate_independent) + implicit * ratio
            return self.stats["certificate"] * np.sqrt(ratios)
        return self._at_times(t, lambda _, force, C: self._distance(force, C))

    def residual(self, t: Any) -> np.ndarray:
        """The residual of the variational inequality, sigma(C(t), -u_n') + <u_n', A u_n' + B u_n>.

        For C(t) = f - D it is J(u') - <f, u'> + <A u' + B u, u'>: minus the least value that
        <A u' + B u - f, v - u'> + J(v) - J(u') takes where the viability condition holds. Zero for
        the exact solution; O(mu) for first-order schemes; in units of power.

        Parameters
        ----------
        t : float or array_like, shape (k,)

        Returns
        -------
        ndarray, shape () or (k,)
        """
        return self._at_times(t, lambda z, force, C: C.support(-z) + float(z @ force))

    @cached_property
    def _nearest(self) -> VelocityOf:
        return self.plan.velocity(self.process.metric.M)

    def _distance(self, force: np.ndarray, C: Any) -> float:
        # the velocity program with M = A, q = w is the projection of w on C in the A^-1 metric
        found = self._nearest(force, C).velocity
        if found.relative > self.plan.tol:
            raise SweepoptError(
                f"the distance to C(t) is known to {found.relative:.2g} only, tol is "
                f"{self.plan.tol:g}; solve with a looser tol to see it all the same"
            )
        return self.process.metric.norm(found.z)

    def _at_times(self, t: Any, measure: Any) -> np.ndarray:
        times = self._inside(t)
        values = []
        for time, i in zip(times.ravel(), self._interval(times).ravel(), strict=True):
            z = self.velocity[i]
            force = self.process.A @ z + self.process.times_B(self(float(time)))
            values.append(measure(z, force, self.process.C.at(float(time))))
        return np.array(values).reshape(times.shape)

    def _inside(self, t: Any) -> np.ndarray:
        try:
            times = np.asarray(t, dtype=float)
        except (TypeError, ValueError) as error:
            raise InputError(f"t must be a time or an array of times, got {t!r:.60}") from error
        if len(self.t) < 2:
            raise InputError("the run has no complete step to interpolate")
        slack = 1e-12 * max(abs(self.t[0]), abs(self.t[-1]))
        bad = ~((times >= self.t[0] - slack) & (times <= self.t[-1] + slack))
        if bad.any():
            raise InputError(
                f"t = {times[bad].flat[0]:g} is outside of [{self.t[0]:g}, {self.t[-1]:g}]"
            )
        return np.clip(times, self.t[0], self.t[-1])

    def _interval(self, times: np.ndarray) -> np.ndarray:
        """i with t in (t_i, t_{i+1}]."""
        return np.maximum(np.searchsorted(self.t, times, side="left") - 1, 0)

    def to_xarray(self) -> Dataset:
        """The trajectory and its statistics as an xarray.Dataset (needs the extra "fem")."""
        from sweepopt.store import to_xarray

        return to_xarray(self)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Components of u_n over time, stick phases shaded (needs the extra "plot")."""
        from sweepopt.plot import plot_solution

        return plot_solution(self, ax)

    def energy(self) -> Energy:
        """Energies of the run; forces are taken at the middle of each step.

        For a C that is not a translate C = f - D, `work` is zero and `friction` holds
        int sigma(C, -u').
        """
        mu = np.diff(self.t)
        viscous, friction, work = np.zeros((3, len(mu)))
        for i, z in enumerate(self.velocity):
            C = self.process.C.at(float(self.t[i] + 0.5 * mu[i]))
            viscous[i] = z @ (self.process.A @ z)
            work[i] = C.anchor @ z
            friction[i] = C.support(-z) + work[i]
        stored = np.array([0.5 * u @ self.process.times_B(u) for u in self.u])
        viscous, friction, work = (
            np.append(0.0, np.cumsum(mu * rate)) for rate in (viscous, friction, work)
        )
        return Energy(stored - stored[0], viscous, friction, work)
