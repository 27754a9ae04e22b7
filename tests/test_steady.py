"""Each route to a velocity: what is held stays, units change nothing, small viscosity does no harm.

The routes are those a plan chooses from; every one has its own formulas, and its own rounding.
"""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pytest
import scipy.sparse as sp
from cases import slow

import sweepopt as so
from sweepopt.study.hard.bodies import chain

N = 12
FEW = np.array([1, 4, 5, 8, 10, 11])
E = np.eye(N)[:, FEW]
A, B = chain(np.random.default_rng(11), N), chain(np.random.default_rng(12), N)
G = np.random.default_rng(13).uniform(0.3, 1.5, N)


class Route(NamedTuple):
    """How a process is solved, the matrices and the set that this asks for."""

    settings: dict[str, Any]
    A: np.ndarray = A
    B: np.ndarray = B
    shape: str = "box"
    few: bool = False

    def part(self, force=1.0):
        """The set, on the few unknowns if there are some, with bounds in units of a force."""
        g = force * (G[FEW] if self.few else G)
        if self.shape == "ball":
            return so.Ball(np.zeros(g.size), 0.8 * force)
        return so.Balls(g[::2], 2) if self.shape == "discs" else so.Box(-g, g)

    def C(self, load, force=1.0):
        part = self.part(force)
        return so.Moving(so.image(E, part) if self.few else part, load)

    def edge(self, seed):
        """A force that is on the edge of the set, to the last bit of its bounds."""
        random, g = np.random.default_rng(seed), G[FEW] if self.few else G
        if self.shape == "box":
            f = g * random.choice([-1.0, 1.0], g.size)
        else:
            f = self.part().project(1e3 * random.normal(size=g.size))
        return E @ f if self.few else f


ROUTES = {
    "closed form": Route({}, A=np.diag(A.diagonal()), B=np.zeros((N, N))),
    "newton": Route({"solver": "newton"}),
    "daqp": Route({"solver": "daqp"}),
    "clarabel, full": Route({"solver": "clarabel", "path": "full"}, few=True),
    "clarabel, discs": Route({"solver": "clarabel"}, shape="discs"),
    "clarabel, eliminated": Route({"solver": "clarabel", "path": "eliminated"}, few=True),
    "osqp, full": Route({"solver": "osqp", "path": "full"}, few=True),
    "osqp, eliminated": Route({"solver": "osqp", "path": "eliminated"}, few=True),
    "discs, eliminated": Route({"path": "eliminated"}, shape="discs", few=True),
    "active set": Route({"solver": "active-set"}),
    "cvxpy": Route({"solver": "cvxpy"}),
    "proportional": Route({"path": "proportional"}, B=2.0 * A, few=True),
    "exact": Route({"scheme": "exact"}, few=True),
    "cones": Route({"path": "cones"}, sp.csc_array(A), sp.csc_array(B), "discs"),
}


# ---- what is held ------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.5, 1.0])
@pytest.mark.parametrize(
    "steps, away",
    [(20, 0.0), (20, 1e6), slow(100_000, 1.0)],
)
@pytest.mark.parametrize("name", [name for name in ROUTES if name != "exact"])  # it rounds u
def test_a_body_that_is_held_does_not_move_at_all(name, away, steps, share):
    # away from zero the load carries B u0, and the force that is left is what the two miss
    route = ROUTES[name]
    u0 = away * np.random.default_rng(14).normal(size=N)
    C = route.C(route.B @ u0 + share * route.edge(15))
    sol = so.solve(
        so.SweepingProcess(route.A, route.B, C, u0),
        **{"t_end": 100.0, "steps": steps, "save": max(steps // 1000, 1), **route.settings},
    )
    assert (sol.velocity == 0.0).all()
    assert (sol.u == u0).all()


# ---- units -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ROUTES)
def test_units_of_forces_and_lengths_change_no_number(name):
    route = ROUTES[name]
    shape = 3 * np.random.default_rng(16).normal(size=N)

    def motion(force, length):
        # forces in units of `force`, lengths in units of `length`; A and B are forces per length
        load = so.Separable([(so.Sine(1.0, 5.0), force * shape)])
        matrices = (force / length * M for M in (route.A, route.B))
        process = so.SweepingProcess(*matrices, route.C(load, force), np.zeros(N))
        sol = so.solve(process, **{"t_end": 2.0, "steps": 4, **route.settings})
        return np.concatenate([sol.u, sol.velocity]) / length

    plain = motion(1.0, 1.0)
    assert plain.any()
    for force, length in ((2.0**40, 2.0**-40), (2.0**-40, 1.0), (1.0, 2.0**40)):
        scaled = motion(force, length)
        assert np.abs(scaled - plain).max() <= 1e-12 * np.abs(plain).max(), (force, length)
        assert ((scaled == 0) == (plain == 0)).all()


# ---- viscosity ---------------------------------------------------------------------------------

DAMPED = [name for name in ROUTES if name not in ("closed form", "exact", "cones")]


@pytest.mark.parametrize("name", DAMPED)
def test_as_viscosity_falls_the_error_falls_with_it_and_no_step_fails(name):
    route = ROUTES[name]
    shape = 3 * np.random.default_rng(17).normal(size=N)
    load = so.Separable([(so.Sine(1.0, 5.0), shape)])

    def run(nu, settings):
        process = so.SweepingProcess(nu * route.A, route.B, route.C(load), np.zeros(N))
        return so.solve(
            process,
            **{"t_end": 2.0, "steps": 10, "scheme": "implicit-euler", "tol": 1e-10, **settings},
        )

    limit = run(0.0, {}).u  # A = 0: no route but those for all unknowns, or the contact
    errors = []
    for k in range(2, 13, 2):
        sol = run(10.0**-k, route.settings)
        assert sol.success
        errors.append(float(np.abs(sol.u - limit).max() / np.abs(limit).max()))
    assert all(later < 0.04 * earlier for earlier, later in pairwise(errors[:4]))
    assert max(errors[4:]) <= 1e-9
