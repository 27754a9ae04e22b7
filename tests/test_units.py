"""Answers do not depend on units: powers of 2 of forces, lengths, times, over all sets of the zoo.

Energies are in force * length: A in force * time / length, B in force / length, C in force.
"""

from __future__ import annotations

from functools import singledispatch
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from laws import ZOO

import sweepopt as so
from sweepopt.sets.algebra import Negation, Scaling, Translation
from sweepopt.sets.image import Image
from sweepopt.sets.pairs import Intersection, Sum
from sweepopt.sets.product import Product
from sweepopt.sets.units import in_units
from sweepopt.study.hard.bodies import rod

pytestmark = pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
POWERS = (-40, -13, 0, 17, 40)
ENOUGH = 1e-12


@singledispatch
def rescaled(C: Any, F: float, where: bool) -> so.ConvexSet:
    """F C, written down by somebody who measures in other units.

    `where` says which data hold the unit, for sets that have a choice.
    """
    raise NotImplementedError(type(C).__name__)


@rescaled.register
def _(C: so.Point, F: float, where: bool) -> so.ConvexSet:
    return so.Point(F * C.offsets)


@rescaled.register
def _(C: so.Box, F: float, where: bool) -> so.ConvexSet:
    return so.Box(F * C.lower, F * C.upper)


@rescaled.register
def _(C: so.Ball, F: float, where: bool) -> so.ConvexSet:
    return so.Ball(F * C.center, F * C.radius)


@rescaled.register
def _(C: so.Balls, F: float, where: bool) -> so.ConvexSet:
    return so.Balls(F * C.radii, C.block)


@rescaled.register
def _(C: so.Ellipsoid, F: float, where: bool) -> so.ConvexSet:
    return so.Ellipsoid(F * C.center, F * F * C.shape)


@rescaled.register
def _(C: so.Polyhedron, F: float, where: bool) -> so.ConvexSet:
    return so.Polyhedron(C.G / F, C.h) if where else so.Polyhedron(C.G, F * C.h)


@rescaled.register
def _(C: so.HalfSpace, F: float, where: bool) -> so.ConvexSet:
    row = C.G[0]
    return so.HalfSpace(row / F, C.offset) if where else so.HalfSpace(row, F * C.offset)


@rescaled.register
def _(C: so.Polytope, F: float, where: bool) -> so.ConvexSet:
    return so.Polytope(F * C.vertices)


@rescaled.register
def _(C: so.SecondOrderCone, F: float, where: bool) -> so.ConvexSet:
    return C


@rescaled.register
def _(C: Translation, F: float, where: bool) -> so.ConvexSet:
    return rescaled(C.part, F, where) + F * C.v


@rescaled.register
def _(C: Scaling, F: float, where: bool) -> so.ConvexSet:
    return F * C.factor * C.part if where else C.factor * rescaled(C.part, F, where)


@rescaled.register
def _(C: Negation, F: float, where: bool) -> so.ConvexSet:
    return -rescaled(C.part, F, where)


@rescaled.register
def _(C: Product, F: float, where: bool) -> so.ConvexSet:
    return so.product(*(rescaled(part, F, where) for part in C.parts))


@rescaled.register
def _(C: Image, F: float, where: bool) -> so.ConvexSet:
    return so.image(F * C.M, C.part) if where else so.image(C.M, rescaled(C.part, F, where))


@rescaled.register
def _(C: Sum, F: float, where: bool) -> so.ConvexSet:
    return rescaled(C.first, F, where) + rescaled(C.second, F, where)


@rescaled.register
def _(C: Intersection, F: float, where: bool) -> so.ConvexSet:
    return rescaled(C.first, F, where) & rescaled(C.second, F, where)


def spd(random: np.random.Generator, dim: int) -> np.ndarray:
    R = random.normal(size=(dim, dim))
    return R @ R.T + np.eye(dim)


def run(C: so.ConvexSet, seed: int, F: float = 1.0, L: float = 1.0, T: float = 1.0) -> so.Solution:
    """Some steps of a small process whose data are in the units F, L and T."""
    random = np.random.default_rng(seed)
    A, B = spd(random, C.dim), spd(random, C.dim)
    f = 3 * random.normal(size=C.dim)
    C = so.Moving(C, center=so.Separable([(so.Sine(1.0, 5.0 * T), F * f)]))
    process = so.SweepingProcess(F * T / L * A, F / L * B, C, np.zeros(f.size))
    return so.solve(process, t_end=2 * T, steps=4, tol=1e-9)


# what a user states in cvxpy has no data that could be told from each other
KINDS = [name for name in ZOO if name != "constraints"]


@pytest.mark.parametrize("name", KINDS)
@settings(max_examples=2, deadline=None, derandomize=True, phases=[Phase.generate])
@given(
    seed=st.integers(0, 10**6),
    powers=st.tuples(*(st.sampled_from(POWERS) for _ in range(3))),
    where=st.booleans(),
)
def test_units_change_nothing_but_rounding(
    name: str, seed: int, powers: tuple[int, int, int], where: bool
) -> None:
    C = ZOO[name].sample(seed).C
    F, L, T = (2.0**power for power in powers)
    plain, other = run(C, seed), run(rescaled(C, F, where), seed, F, L, T)
    assert plain.stats["relative"].max() <= 1e-9
    for one, two in ((plain.u, other.u / L), (plain.velocity, other.velocity * (T / L))):
        np.testing.assert_allclose(two, one, rtol=0, atol=ENOUGH * np.abs(one).max())
        assert np.array_equal(two == 0, one == 0)


def mixed(name: str) -> tuple[so.ConvexSet, np.ndarray, so.ConvexSet | None]:
    """A set of the zoo, units of its entries from 2^-20 to 2^20, and the set in these."""
    C = ZOO[name].sample(5).C
    units = 2.0 ** np.random.default_rng(6).integers(-20, 21, C.dim)
    return C, units, in_units(C, units)


MIXED = [name for name in ZOO if mixed(name)[2] is not None]


@pytest.mark.parametrize("name", MIXED)
def test_entries_may_have_units_of_their_own(name: str) -> None:
    C, units, other = mixed(name)
    assert other is not None
    random = np.random.default_rng(7)
    for z in random.normal(size=(4, C.dim)):
        np.testing.assert_allclose(other.support(z / units), C.support(z), rtol=1e-9, atol=1e-9)
    A, f = spd(random, C.dim), 3 * random.normal(size=C.dim)
    found = []
    for D, unit in ((C, np.ones(C.dim)), (other, units)):
        process = so.SweepingProcess(unit[:, None] * A * unit, None, D + unit * f, np.zeros(C.dim))
        sol = so.solve(process, t_end=1.0, steps=1, path="full")
        assert sol.stats["relative"].max() <= 1e-9
        found.append(sol.velocity[0] * unit)
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-9 * np.abs(found[0]).max())


@pytest.mark.parametrize("seed", range(4))
def test_a_hull_is_met_in_the_units_of_a_body_whose_stiffness_jumps(seed: int) -> None:
    pytest.importorskip("mpmath")
    from sweepopt.study.hard import Program

    random, n = np.random.default_rng(seed), 6
    A, g = rod(10.0 ** random.integers(-6, 7, n + 1)), random.uniform(0.2, 2.0, n)
    f = 3 * random.normal(size=n)
    hull = so.Polytope(np.vstack([np.zeros(n), np.diag(g)])) + f
    rows = so.Polyhedron(np.vstack([-np.eye(n), 1 / g]), np.append(np.zeros(n), 1.0)) + f
    process = so.SweepingProcess(A, None, hull, np.zeros(n))
    z = so.solve(process, t_end=1.0, steps=1).velocity[0]
    program = Program(A)
    exact = program.solve(program.term(np.zeros(n)), rows, z)
    assert program.error(z, exact) <= 1e-10 * exact.size


@pytest.mark.parametrize("columns", [2, 6])
def test_columns_of_an_image_may_have_units_of_their_own(columns: int) -> None:
    random = np.random.default_rng(columns)
    M, g = random.normal(size=(4, columns)), random.uniform(0.2, 0.8, size=columns)
    found = []
    for power in (0, -27, 13, 40):
        units = np.where(np.arange(columns) % 2, 1.0, 2.0**power)
        found.append(run(so.image(M * units, so.Box(-g / units, g / units)), columns).u)
    assert found[0].any()
    for u in found[1:]:
        np.testing.assert_allclose(u, found[0], rtol=0, atol=ENOUGH * np.abs(found[0]).max())
