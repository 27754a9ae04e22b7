"""Conjugate gradients behind the interface of factors: solves, bounds, elimination, whole runs."""

from __future__ import annotations

import os
import sys

import numpy as np
import pytest
import scipy.sparse as sp

import sweepopt as so
from sweepopt.linalg import Elimination, Factor
from sweepopt.linalg.conjugate_gradients import ConjugateGradients, IterativeElimination

pytest.importorskip("pyamg")


def chain(n: int, mass: float = 0.0) -> sp.csc_array:
    rows = [np.full(n - 1, -1.0), np.full(n, 2.0 + mass), np.full(n - 1, -1.0)]
    return sp.csc_array(sp.diags_array(rows, offsets=[-1, 0, 1]))


def square(n: int, contrast: float = 1.0) -> sp.csc_array:
    """A Laplacian on a square of n x n nodes whose coefficient jumps."""
    k = np.where(np.arange(n * n) % n < n // 2, contrast, 1.0)
    D = sp.diags_array(np.sqrt(k))
    eye = sp.eye_array(n)
    return sp.csc_array(D @ (sp.kron(chain(n), eye) + sp.kron(eye, chain(n))) @ D)


def in_other_units(n: int) -> sp.csc_array:
    units = sp.diags_array(10.0 ** np.random.default_rng(1).uniform(-6, 6, n))
    return sp.csc_array(units @ chain(n, 0.01) @ units)


MATRICES = {
    "square": square(40),
    "jumps": square(40, 1e4),
    "units": in_other_units(400),
    "mass": chain(400, 100.0),
    "diagonal": sp.csc_array(sp.diags_array(np.geomspace(1e-8, 1e8, 300))),
    "small": chain(30),
    "one unknown": sp.csc_array([[2.0]]),
}


def forces(M: Factor) -> list[np.ndarray]:
    rough = np.random.default_rng(2).normal(size=M.dim) * M.root
    point = np.zeros(M.dim)
    point[M.dim // 3] = 1.0
    return [rough, M.M @ (rough / M.diagonal), point]


@pytest.mark.parametrize("name", MATRICES)
def test_solves_and_bounds_agree_with_factors(name: str) -> None:
    iterated, factorised = ConjugateGradients(MATRICES[name]), Factor(MATRICES[name])
    for w in forces(factorised):
        z, exact = factorised.solve(w), factorised.dual_norm(w)
        assert factorised.norm(iterated.solve(w) - z) <= 2e-9 * factorised.norm(z)
        assert iterated.dual_norm(w) == pytest.approx(exact)
        assert iterated.dual_norm_bound(w) >= (1 - 1e-12) * exact
    assert not iterated.solve(np.zeros(iterated.dim)).any()


@pytest.mark.parametrize("name", ["square", "jumps", "units"])
def test_elimination_agrees_with_that_of_factors(name: str) -> None:
    A, few = MATRICES[name], np.array([3, 50, 51, 200])
    r = np.random.default_rng(3).normal(size=A.shape[0]) * np.sqrt(A.diagonal())
    found = []
    for M in (Elimination(A, few), IterativeElimination(A, few)):
        forward, pull = M.reduce(r)
        zeta = np.linalg.solve(M.N, pull) + 0.1 / M.root[few]
        found.append((M.N, pull, M.size(forward), M.recover(forward, M.N @ zeta) * M.root))
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-7, atol=1e-9 * np.abs(one).max())


def test_every_run_gives_the_same_numbers() -> None:
    w, found = np.random.default_rng(4).normal(size=1600), []
    for seed in (0, 1):
        np.random.seed(seed)  # noqa: NPY002 (pyamg draws from the global generator)
        found.append(ConjugateGradients(MATRICES["jumps"]).solve(w))
    assert np.array_equal(*found)


def test_what_is_not_positive_definite_is_refused() -> None:
    neumann, hidden = chain(400).tolil(), chain(400).tolil()
    neumann[0, 0] = neumann[-1, -1] = 1.0
    hidden[100, 101] = hidden[101, 100] = -2.5
    for bad in (neumann - 1e-6 * sp.eye_array(400), hidden, np.diag([1.0, -1.0])):
        with pytest.raises(so.InputError, match="must be positive definite"):
            ConjugateGradients(sp.csc_array(bad))


@pytest.fixture
def little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine with a megabyte of memory."""
    sizes = {"SC_PAGE_SIZE": 1024, "SC_PHYS_PAGES": 1024}
    real = os.sysconf
    monkeypatch.setattr(os, "sysconf", lambda name: sizes[name] if name in sizes else real(name))


def run(n: int = 50, load: float = 3.0, shift: float = 1.0) -> so.Solution:
    A, few = square(n), np.arange(n)
    E = sp.csc_array((np.ones(n), (few, np.arange(n))), shape=(n * n, n))
    f = np.random.default_rng(5).uniform(0, load, n * n) / n
    C = so.Moving(so.image(E, so.Box(-np.ones(n), np.ones(n))), so.Separable([(so.Sine(1, 4), f)]))
    process = so.SweepingProcess(
        A, sp.csc_array(A + shift * sp.eye_array(n * n)), C, np.zeros(n * n)
    )
    return so.solve(process, t_end=2.0, steps=8)


def test_a_body_whose_factors_do_not_fit_moves_as_one_whose_factors_do(
    request: pytest.FixtureRequest,
) -> None:
    plain = run()
    request.getfixturevalue("little_memory")
    other = run()
    assert plain.plan.path == other.plan.path == "eliminated"
    assert other.stats["relative"].max() <= 1e-6
    A = plain.process.A
    size = np.sqrt(plain.u[-1] @ (A @ plain.u[-1]))
    difference = other.u[-1] - plain.u[-1]
    assert np.sqrt(difference @ (A @ difference)) <= 1e-8 * size
    stuck = plain.velocity == 0
    assert stuck.any()
    assert np.array_equal(other.velocity == 0, stuck)


def test_a_proportional_body_is_not_factorised_either(little_memory: None) -> None:
    sol = run(n=20, shift=0.0)
    assert sol.plan.path == "eliminated"
    assert "factors: they would need" in str(sol.plan)
    assert sol.stats["relative"].max() <= 1e-6
    assert not sol.error_bound().guaranteed


def test_without_pyamg_the_message_says_how_much_memory_factors_would_need(
    little_memory: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyamg", None)
    with pytest.raises(so.SolverRefusedError, match=r"need about .* GB.*pyamg.*speed"):
        run()
