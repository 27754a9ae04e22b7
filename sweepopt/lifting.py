"""All unknowns of a proportional material from those that enter its steps."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from sweepopt.errors import Status, SweepoptError
from sweepopt.exact import Lifting, Trajectory, mover
from sweepopt.march import Run, Summary
from sweepopt.plan import Plan
from sweepopt.states import Keeper, Kept, Lifted, States


class Lift:
    """All unknowns from those that enter the steps; the coefficients of the load come first."""

    def __init__(self, plan: Plan, times: np.ndarray, mus: np.ndarray) -> None:
        self._plan, self._times, self._mus = plan, times, mus

    @cached_property
    def _moved(self) -> tuple[Kept, Run]:
        """The coefficients of the whole run."""
        assert self._plan.reduction is not None
        process = self._plan.reduction.coefficients
        n = len(self._mus)
        keeper = Keeper(np.arange(n), process.u0)
        run = mover(process, self._plan.of_coefficients)(self._times, self._mus, keeper)
        if run.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        if run.done < n:
            raise SweepoptError(f"the load's coefficients: {run.cause or run.status.value}")
        return keeper.close()[1], run

    @property
    def _alpha(self) -> Kept:
        return self._moved[0]

    @property
    def seconds(self) -> np.ndarray:
        """What each step costs beside the loop."""
        if self._plan.reduction is None:
            return np.zeros(len(self._mus))
        return self._moved[1].log.table(self._times[1:])["seconds"]

    def state(self, node: int, u: np.ndarray) -> np.ndarray:
        """The state at a node of the grid."""
        reduction = self._plan.reduction
        return u if reduction is None else reduction.lift(u, self._alpha.nodes[node])

    def velocity(self, i: int, z: np.ndarray) -> np.ndarray:
        """The velocity of a step."""
        reduction = self._plan.reduction
        return z if reduction is None else reduction.lift(z, self._alpha.velocities[i])

    def prove(self, i: int, zeta: np.ndarray, velocity: np.ndarray, step: Summary) -> Summary:
        """The certificate of all unknowns from that of those that entered the step."""
        assert self._plan.reduction is not None
        gamma = self._mus[i] * self._plan.scheme.a[-1][-1]
        alphas = self._alpha.nodes[i], self._alpha.velocities[i]
        error, size = self._plan.reduction.residual((zeta, velocity), alphas, gamma)
        certificate = step.certificate + error
        if step.relative > 0:
            size = max(size, step.certificate / step.relative)
        relative = certificate / size if certificate > 0 else certificate
        return step._replace(certificate=certificate, relative=relative)

    def trajectory(self, few: Trajectory | None) -> Trajectory | None:
        """The exact trajectory of all unknowns from that of those that entered."""
        reduction = self._plan.reduction
        if few is None or reduction is None:
            return few
        exact = self._moved[1].exact
        assert exact is not None  # the same scheme moves the coefficients
        return replace(few, lifting=Lifting(exact, reduction.lift))

    def of(self, kept: Kept, steps: np.ndarray) -> States:
        """The kept states as states of all unknowns."""
        reduction = self._plan.reduction
        if reduction is None:
            return kept
        return Lifted(kept, lambda: self._alpha, steps, reduction.lift, self._plan.unknowns)
