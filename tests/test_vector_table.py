"""Loads that are vectors given at times: no sum of histories, the same bounds."""

import numpy as np
import pytest
from cases import isotropic

import sweepopt as so

TIMES = np.array([0.0, 0.3, 1.1, 2.0])
VALUES = np.array([[0.0, 0.0, 0.0], [1.0, -2.0, 0.5], [3.0, 1.0, -1.0], [-1.0, 0.5, 2.0]])
HATS = so.Separable([(so.Table(TIMES, v), e) for v, e in zip(VALUES.T, np.eye(3), strict=True)])


def run(load, viscosity, scheme="sdirk2"):
    B = np.array([[2.0, -1, 0], [-1, 2, -1], [0, -1, 2]])
    C = so.Moving(so.Box(-0.3 * np.ones(3), 0.4 * np.ones(3)), load)
    process = so.SweepingProcess(viscosity * np.diag([1.0, 2, 1]), B, C, np.zeros(3))
    return so.solve(process, t_end=2.0, steps=60, scheme=scheme, tol=1e-10)


@pytest.mark.parametrize("viscosity", [0.5, 0.0])
def test_it_is_the_sum_of_tables_with_the_same_guaranteed_bound(viscosity):
    sol, same = run(so.VectorTable(TIMES, VALUES), viscosity), run(HATS, viscosity)
    assert sol.u == pytest.approx(same.u, abs=1e-9)
    bound, of_sum = sol.error_bound(), same.error_bound()
    assert bound.guaranteed
    assert float(bound) == pytest.approx(of_sum, rel=1e-4)
    variation = sol.process.variation([0.0, 2.0])
    assert variation.guaranteed
    steps = sum(map(sol.process.metric.dual_norm, np.diff(VALUES, axis=0)))
    assert variation == pytest.approx(steps)
    assert variation < same.process.variation([0.0, 2.0])


@pytest.mark.parametrize("viscosity", [0.5, 0.0])
def test_exact_takes_it_as_the_sum_of_tables(viscosity):
    exact, same = (run(f, viscosity, scheme="exact") for f in (so.VectorTable(TIMES, VALUES), HATS))
    assert exact.exact.switches.size > 3
    assert exact.u == pytest.approx(same.u, abs=1e-14)


def test_exact_takes_offsets_of_rows_given_so():
    rows, offsets = np.vstack([np.eye(3), -np.eye(3)]), np.hstack([VALUES + 0.4, 0.3 - VALUES])
    sol, same = (
        so.solve(isotropic(C, 0.0, 1.0), t_end=2.0, steps=60, scheme="exact")
        for C in (
            so.Polyhedron(rows, so.VectorTable(TIMES, offsets)),
            so.Moving(so.Box(-0.3 * np.ones(3), 0.4 * np.ones(3)), HATS),
        )
    )
    assert sol.u == pytest.approx(same.u, abs=1e-14)
