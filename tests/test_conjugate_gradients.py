"""Conjugate gradients behind the interface of factors: solves, bounds, elimination, whole runs."""

import os
import sys

import numpy as np
import pytest
import scipy.sparse as sp
from cases import refuses, worst_certificate

import sweepopt as so
from sweepopt.linalg import Elimination, Factor


def chain(n, mass=0.0):
    return sp.csc_array(sp.diags_array([-1.0, 2.0 + mass, -1.0], offsets=[-1, 0, 1], shape=(n, n)))


def square(n, contrast=1.0):
    """A Laplacian on a square of n x n nodes whose coefficient jumps."""
    k = np.where(np.arange(n * n) % n < n // 2, contrast, 1.0)
    D = sp.diags_array(np.sqrt(k))
    eye = sp.eye_array(n)
    return sp.csc_array(D @ (sp.kron(chain(n), eye) + sp.kron(eye, chain(n))) @ D)


UNITS = sp.diags_array(10.0 ** np.random.default_rng(1).uniform(-6, 6, 400))
MATRICES = {
    "square": square(40),
    "jumps": square(40, 1e4),
    "units": sp.csc_array(UNITS @ chain(400, 0.01) @ UNITS),
    "mass": chain(400, 100.0),
    "small": chain(30),
}


@pytest.fixture
def little_memory(monkeypatch):
    """A machine with ten kilobytes of memory."""
    sizes = {"SC_PAGE_SIZE": 1024, "SC_PHYS_PAGES": 10}
    real = os.sysconf
    monkeypatch.setattr(os, "sysconf", lambda name: sizes[name] if name in sizes else real(name))


@pytest.mark.parametrize("name", MATRICES)
def test_solves_and_bounds_agree_with_factors(name, request):
    exact = Factor(MATRICES[name])
    request.getfixturevalue("little_memory")
    iterated = Factor(MATRICES[name])
    assert (exact.has_factors, iterated.has_factors) == (True, False)
    rough, point = np.random.default_rng(2).normal(size=exact.dim) * exact.root, np.zeros(exact.dim)
    point[exact.dim // 3] = 1.0
    for w in (rough, exact.M @ (rough / exact.diagonal), point):
        z, size = exact.solve(w), exact.dual_norm(w)
        assert exact.norm(iterated.solve(w) - z) <= 2e-9 * exact.norm(z)
        assert iterated.dual_norm(w) == pytest.approx(size)
        assert iterated.dual_norm_bound(w) >= (1 - 1e-12) * size
    assert not iterated.solve(np.zeros(iterated.dim)).any()


@pytest.mark.parametrize("name", ["square", "jumps", "units"])
def test_elimination_agrees_with_that_of_factors(name, request):
    A, few = MATRICES[name], np.array([3, 50, 51, 200])
    r = np.random.default_rng(3).normal(size=A.shape[0]) * np.sqrt(A.diagonal())
    results = []
    for _ in range(2):
        M = Elimination(A, few)
        forward, force, size = M.reduce(r)
        zeta = np.linalg.solve(M.N, force) + 0.1 / M.root[few]
        results.append((M.N, force, size, M.recover(forward, zeta) * M.root))
        request.getfixturevalue("little_memory")
    for one, other in zip(*results, strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-7, atol=1e-9 * np.abs(one).max())


@pytest.mark.usefixtures("little_memory")
def test_every_run_gives_the_same_numbers():
    w, solved = np.random.default_rng(4).normal(size=1600), []
    for seed in (0, 1):
        np.random.seed(seed)  # noqa: NPY002 (pyamg draws from the global generator)
        solved.append(Factor(MATRICES["jumps"]).solve(w))
    assert np.array_equal(*solved)


@pytest.mark.usefixtures("little_memory")
def test_what_is_not_positive_definite_is_refused():
    neumann, hidden = chain(400).tolil(), chain(400).tolil()
    neumann[0, 0] = neumann[-1, -1] = 1.0
    hidden[100, 101] = hidden[101, 100] = -2.5
    for bad in (neumann - 1e-6 * sp.eye_array(400), hidden):
        with refuses("must be positive definite"):
            Factor(sp.csc_array(bad))


def run(n=30, shift=1.0, steps=8):
    A, E = square(n), sp.eye_array(n * n, format="csc")[:, :n]
    f = np.random.default_rng(5).uniform(0, 3.0, n * n) / n
    C = so.Moving(so.image(E, so.Box(-np.ones(n), np.ones(n))), so.Separable([(so.Sine(1, 4), f)]))
    B = sp.csc_array(A + shift * sp.eye_array(n * n))
    return so.solve(so.SweepingProcess(A, B, C, np.zeros(n * n)), t_end=2.0, steps=steps)


def test_a_body_whose_factors_do_not_fit_moves_as_one_whose_factors_do(
    request,
):
    plain = run()
    request.getfixturevalue("little_memory")
    other = run()
    assert plain.plan.path == other.plan.path == "eliminated"
    assert worst_certificate(other) <= 1e-6
    metric = plain.process.metric
    assert metric.norm(other.u[-1] - plain.u[-1]) <= 1e-8 * metric.norm(plain.u[-1])
    stuck = plain.velocity == 0
    assert stuck.any()
    assert np.array_equal(other.velocity == 0, stuck)


@pytest.mark.usefixtures("little_memory")
@pytest.mark.filterwarnings("ignore::sweepopt.BoundWarning")
def test_a_proportional_body_is_not_factorised_either():
    sol = run(n=8, shift=0.0, steps=2)
    assert sol.plan.path == "eliminated"
    assert "factors: they would need" in str(sol.plan)
    assert worst_certificate(sol) <= 1e-6
    assert not sol.error_bound().guaranteed
    assert not sol.process.variation([0.0, 2.0]).guaranteed


@pytest.mark.usefixtures("little_memory")
def test_without_pyamg_the_message_says_how_much_memory_factors_would_need(
    monkeypatch,
):
    monkeypatch.setitem(sys.modules, "pyamg", None)
    with pytest.raises(so.SolverRefusedError, match=r"need about .* GB.*pyamg.*speed"):
        run()
