"""Stick, slip and friction at the contact, computed once for files, summaries and pictures.

On Gamma_3 the friction traction q = eta d_nu u' + kappa d_nu u satisfies |q| <= g, and
q = -g u'/|u'| where u' != 0. Tested with the basis function of node k it reads

    w_k q_k = (A u' + B u - f)_k,      |q_k| <= g_k.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sweepopt.errors import InputError

if TYPE_CHECKING:
    from sweepopt.fem import Contact, Scene
    from sweepopt.results import Solution

Array = NDArray[np.float64]

STATES = {-1: "slips_backward", 0: "sticks", 1: "slips_forward"}


class SlipStatistics(NamedTuple):
    """How much of the contact slips, how often and how far; shares are of its length.

    Attributes
    ----------
    ever, most : float
        Share that slips at some time, and the largest share that slips at once.
    time_of_most : float or None
        End of the first step with that share; None if nothing slips.
    switches : int
        Changes from stick to slip or back, over all nodes and steps.
    reversals : int
        Changes of the direction of slip without a stuck step between.
    largest_total, mean_total : float
        int |u'| dt: its largest value, and its mean over the contact.
    """

    ever: float
    most: float
    time_of_most: float | None
    switches: int
    reversals: int
    largest_total: float
    mean_total: float


@dataclass(frozen=True, eq=False)
class Slip:
    """What m contact nodes do in n steps.

    Attributes
    ----------
    contact : Contact
    t : ndarray, shape (n+1,)
    stage_t : ndarray, shape (n,)
        Where in each step the traction is taken: at the scheme's stage, so that |q| <= g holds as
        exactly as the step is certified; in the middle for schemes of several stages.
    displacement : ndarray, shape (n+1, m)
    velocity : ndarray, shape (n, m)
        Exactly 0.0 where a node sticks.
    traction : ndarray, shape (n, m)
        q_k, against the velocity.
    """

    contact: Contact
    t: Array
    stage_t: Array
    displacement: Array
    velocity: Array
    traction: Array

    @cached_property
    def state(self) -> NDArray[np.int8]:
        """1, 0 or -1: slips forward, sticks, slips backward; shape (n, m)."""
        return np.sign(self.velocity).astype(np.int8)

    @cached_property
    def share(self) -> Array:
        """Share of the contact's length that slips in each step, shape (n,)."""
        weight = self.contact.weight
        return np.minimum((self.state != 0) @ weight / weight.sum(), 1.0)

    @cached_property
    def total(self) -> Array:
        """int |u'| dt of each node, shape (m,)."""
        return np.asarray(np.diff(self.t) @ np.abs(self.velocity))

    @cached_property
    def position(self) -> Array:
        """Arc length along all contact boundaries, one after the other; shape (m,)."""
        starts = self.boundary_starts
        position = np.array(self.contact.arc)
        for start, end in pairwise([*starts, position.size]):
            position[start:end] += position[start - 1] if start else 0.0
        return position

    @cached_property
    def boundary_starts(self) -> list[int]:
        """The first node of each boundary."""
        names = self.contact.boundary
        return [0, *(np.flatnonzero(names[1:] != names[:-1]) + 1).tolist()]

    def statistics(self) -> SlipStatistics:
        """The slip statistics of the run."""
        weight = self.contact.weight / self.contact.weight.sum()
        slipping = self.state != 0
        before, after = self.state[:-1], self.state[1:]
        most = int(np.argmax(self.share))
        return SlipStatistics(
            ever=min(float(slipping.any(axis=0) @ weight), 1.0),
            most=float(self.share[most]),
            time_of_most=float(self.t[most + 1]) if slipping.any() else None,
            switches=int(np.count_nonzero(slipping[:-1] != slipping[1:])),
            reversals=int(np.count_nonzero(before * after == -1)),
            largest_total=float(self.total.max()),
            mean_total=float(self.total @ weight),
        )


def slip_of(scene: Scene, solution: Solution) -> Slip | None:
    """Stick, slip and friction of a run; None for a scene without friction.

    Parameters
    ----------
    scene : Scene
    solution : Solution
        Of the scene's problem, with one step or more.
    """
    contact = scene.contact
    if contact is None:
        return None
    if not solution.complete:
        raise InputError("slip adds up all steps, but not all were kept; leave save= out")
    problem, scheme = scene.problem, solution.plan.scheme
    rows = contact.unknown
    mu = np.diff(solution.t)
    implicit, c = (scheme.a[0][0], scheme.c[0]) if len(scheme.b) == 1 else (0.5, 0.5)
    stage_t = solution.t[:-1] + c * mu
    force = solution.velocity @ problem.A[rows].T
    if problem.B is not None:
        stage_u = solution.u[:-1] + implicit * mu[:, None] * solution.velocity
        force += stage_u @ problem.B[rows].T
    if callable(problem.load):
        force -= np.array([problem.load(float(t))[rows] for t in stage_t])
    elif problem.load is not None:
        force -= problem.load[rows]
    return Slip(
        contact=contact,
        t=solution.t,
        stage_t=stage_t,
        displacement=solution.u[:, rows],
        velocity=solution.velocity[:, rows],
        traction=force / contact.weight,
    )
