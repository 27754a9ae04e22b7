"""Both problems, their conversion, and the theory's assumptions as checks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from cases import case

import sweepopt as so


@pytest.mark.parametrize("convert", [np.asarray, sp.csr_array])
def test_beta_and_lam_are_extreme_eigenvalues_dense_and_sparse(convert: Any) -> None:
    Q = np.linalg.qr(np.random.default_rng(1).normal(size=(80, 80)))[0]
    A = Q @ np.diag(np.linspace(0.5, 4, 80)) @ Q.T
    B = Q @ np.diag(np.linspace(0, 12, 80)) @ Q.T
    chain = 2 * np.eye(80) - np.eye(80, k=1) - np.eye(80, k=-1)
    chain[0, 0] = chain[-1, -1] = 1  # has the constants in its kernel
    known = [((A + A.T) / 2, (B + B.T) / 2, 0.5, 3.0, 12.0)]
    known.append((np.eye(80), chain, 1.0, *2 * [2 + 2 * np.cos(np.pi / 80)]))
    for a, b, *expected in known:
        process = so.SweepingProcess(convert(a), convert(b), so.Ball(np.zeros(80), 1), np.zeros(80))
        norm_B = process.velocity_bound([0.0, 1.0]).norm_B
        assert [process.beta, process.Lam, norm_B] == pytest.approx(expected, rel=1e-8)


def test_a_cone_enters_as_a_minkowski_sum_with_its_polar() -> None:
    D, K = so.Box([-1, -1], [2, 2]), so.Orthant(2)
    vi = so.EvolutionVI(np.eye(2), None, load=[0.5, 3.0], dissipation=D, cone=K, u0=[0, 0])
    C = vi.as_sweeping().C.at(0.0)
    # J = sigma(D, .) + indicator of K, sigma(C, -z) = J(z) - <f, z>
    assert C.support([-1.0, -2.0]) == pytest.approx(2 + 4 - 0.5 - 6)
    assert C.support([1.0, -2.0]) == np.inf


@pytest.mark.parametrize(
    "cone", [so.Orthant(2), so.SecondOrderCone(2), so.Polyhedron([[-1.0, 0.5], [0, -1]], [0, 0])]
)
@pytest.mark.parametrize("dissipation", [so.Box([-0.2, -0.1], [0.3, 0.4]), so.Ball([0, 0], 0.3)])
def test_the_velocity_solves_the_variational_inequality_on_the_cone(
    cone: so.ConvexSet, dissipation: so.ConvexSet
) -> None:
    A, B = np.array([[2.0, 0.3], [0.3, 1.0]]), np.array([[1.0, 0.2], [0.2, 3.0]])

    def f(t: float) -> np.ndarray:
        return np.array([1.5 * np.sin(3 * t), 2 * np.cos(2 * t) - 1.2])

    vi = so.EvolutionVI(A, B, load=f, dissipation=dissipation, cone=cone, u0=[0, 0])
    with pytest.warns(so.InitialStateWarning):
        sol = so.solve(vi, t_end=3.0, steps=60, scheme="implicit-euler")
    assert sol.success
    rng = np.random.default_rng(0)
    tests = [cone.project(v) for v in rng.normal(size=(200, 2))]
    for i, z in enumerate(sol.velocity):
        assert np.linalg.norm(z - cone.project(z)) <= 1e-6
        force = A @ z + B @ sol.u[i + 1] - f(sol.t[i + 1])
        J = dissipation.support
        assert min(force @ (v - z) + J(v) - J(z) for v in tests) >= -1e-5


def test_only_translates_are_variational_inequalities() -> None:
    process = case("P09").process  # the numbers of both forms agree: test_reference.py
    assert process.as_vi().load is process.C.center
    with pytest.raises(so.InputError, match="Moving without scale"):
        case("S04").process.as_vi()


def test_the_a_priori_bound_is_near_the_largest_velocity() -> None:
    # |B| T / beta moderate, one of them with B u0 outside of C(0)
    times = np.linspace(0, 1, 400)
    C = so.Moving(so.Box([-1], [1]), lambda t: [3 * np.sin(2 * t)])
    inside, outside = (so.SweepingProcess([[1.0]], [[0.5]], C, [u0]) for u0 in (0.0, 8.0))
    with pytest.warns(so.InitialStateWarning, match="starts with a velocity"):
        runs = [so.solve(process, t_end=1.0, steps=400) for process in (inside, outside)]
    for sol in runs:
        bound = sol.process.velocity_bound(times)
        assert np.abs(sol.velocity).max() <= bound.value <= 20 * np.abs(sol.velocity).max()
    paper = inside.velocity_bound(times, paper=True)
    assert paper.value == pytest.approx(8 * bound.variation * np.exp(0.5))


def test_the_variation_of_a_translated_and_scaled_set_is_that_of_its_motion() -> None:
    times = np.linspace(0, 2 * np.pi, 501)
    moved = so.Moving(so.Ball([0, 0], 1), lambda t: [np.cos(t), np.sin(t)])
    grown = so.Moving(so.Ball([0, 0], 2), scale=lambda t: 2 + np.sin(t))
    u0, A = np.zeros(2), np.eye(2)
    assert so.SweepingProcess(A, None, moved, u0).variation(times) == pytest.approx(2 * np.pi, 1e-5)
    assert so.SweepingProcess(A, None, grown, u0).variation(times) == pytest.approx(8, 1e-5)
    # [l(t), r(t)] as a polyhedron: the larger of the two ends' changes, step by step
    ends = case("S04").process
    grid = np.linspace(0, 10, 101)
    left = np.abs(np.diff(-1 + np.sin(grid) - 0.3 * np.cos(3 * grid)))
    right = np.abs(np.diff(1 + 0.6 * np.sin(2 * grid) + 0.5 * np.sin(grid)))
    assert ends.variation(grid) == pytest.approx(np.maximum(left, right).sum())


class NeverRuns(so.Clarabel):
    def compile(self, program: object) -> object:
        raise AssertionError("a solver ran on bad input")


def test_an_empty_set_is_refused_with_its_time_before_any_solver_runs() -> None:
    C = so.Polyhedron([[1.0], [-1.0]], lambda t: [1 - t, 0.0])
    process = so.SweepingProcess([[1.0]], [[1.0]], C, [0.0])
    with pytest.raises(so.EmptySetError, match=r"t = 1\.1"):
        so.solve(process, t_end=2.0, steps=20, scheme="catching-up", solver=NeverRuns())


@pytest.mark.filterwarnings("ignore::sweepopt.InitialStateWarning")
@pytest.mark.parametrize(
    "C",
    [
        so.MovingSet(lambda t: so.Point([t, t])),
        so.MovingSet(lambda t: so.HalfSpace([1, 0.5], 1 - 2 * np.sin(t))),
        so.Moving(so.Ball([0, 0], 1), lambda t: [2 * t, t]) + so.Box([-1, 0], [1, 0]),
        -so.Moving(so.Box([-1, -1], [1, 1]), lambda t: [3 * t, 0], lambda t: 1 + t),
    ],
    ids=["point", "half-space", "sum", "negative"],
)
def test_the_a_priori_bound_holds_for_all_kinds_of_moving_sets(C: so.MovingSet) -> None:
    process = so.SweepingProcess(np.eye(2), 0.2 * np.eye(2), C, [0, 0])
    sol = so.solve(process, t_end=2.0, steps=50, scheme="implicit-euler")
    largest = np.linalg.norm(sol.velocity, axis=1).max()
    assert 0 < largest <= process.velocity_bound(np.linspace(0, 2, 51)).value


def test_a_variation_that_is_not_known_is_refused() -> None:
    C = so.Polyhedron([[1.0, 0], [0, 1], [-1, -1]], lambda t: [np.cos(t), 1, 1])
    process = so.SweepingProcess(np.eye(2), None, C, [0, 0])
    with pytest.raises(so.InputError, match="not known for this kind"):
        process.variation(np.linspace(0, 1, 5))
    with pytest.raises(so.InputError, match="strictly increasing"):
        process.variation([1.0, 0.0])


def test_the_bound_of_a_body_at_rest_is_zero_whatever_its_constants() -> None:
    # exp(|B| T / beta) is infinite here, and nothing times it is nothing
    process = so.SweepingProcess([[1e-20]], [[1.0]], so.Box([0], [0]), [0.0])
    assert process.velocity_bound([0.0, 1.0]).value == 0.0


def test_beta_is_found_beside_entries_of_another_size() -> None:
    A = np.array([[5e-20, 1.5e-30, 5e-21], [1.5e-30, 4.5e-40, 0.0], [5e-21, 0.0, 4.25e-20]])
    beta = so.SweepingProcess(A, None, so.WholeSpace(3), np.zeros(3)).beta
    # the determinant of the first two unknowns alone, over the first entry
    assert beta == pytest.approx(4.5e-40 - 2.25e-60 / 5e-20, rel=0.02)


def test_a_jump_to_an_unbounded_set_is_not_of_bounded_variation() -> None:
    C = so.MovingSet(lambda t: so.Box([-1], [1 if t < 0.5 else np.inf]))
    with pytest.warns(so.VariationWarning, match=r"t = 0\.5"):
        assert so.solve(so.SweepingProcess([[1]], None, C, [0]), t_end=1.0, steps=10).success


def test_a_sparse_matrix_whose_indices_are_not_sorted_stays_as_it_is() -> None:
    pointers, indices = np.array([0, 2, 4]), np.array([1, 0, 1, 0])
    A = sp.csc_array((np.array([-1.0, 2.0, 3.0, -1.0]), indices, pointers), shape=(2, 2))
    before = A.toarray()
    for _ in range(2):
        process = so.SweepingProcess(A, None, so.Box([-1, -1], [1, 1]), np.zeros(2))
        assert np.array_equal(process.A.toarray(), before)
    assert np.array_equal(A.toarray(), before)
