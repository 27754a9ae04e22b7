"""Factorisations, their norms and the exact elimination."""

import math
import sys
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
import scipy.sparse.linalg as spla
import skfem
from cases import refuses, slow, springs
from cvxopt import cholmod

from sweepopt.errors import InputError
from sweepopt.linalg import (
    EPS,
    Elimination,
    Factor,
    InBlocks,
    cholesky,
    dense,
    is_semidefinite,
    is_solid,
    largest_eigenvalue,
    largest_ratio,
)


def laplacian(n):
    return 2.1 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)


MATRICES = {
    "dense": laplacian(30),
    "sparse": sp.csc_array(laplacian(80)),
    "sparse, mixed units": sp.csc_array(
        laplacian(40) * np.outer(*2 * [10.0 ** (np.arange(40) % 7 - 3.0)])
    ),
    "in two parts": sp.csc_array(scipy.linalg.block_diag(laplacian(9), 3.0 * laplacian(11))),
    "mixed units": np.diag([1e-6, 1.0, 1e6]) @ laplacian(3) @ np.diag([1e-6, 1.0, 1e6]),
}
of_matrices = pytest.mark.parametrize("M", MATRICES.values(), ids=MATRICES)
both_kinds = pytest.mark.parametrize("convert", [np.asarray, sp.csc_array])


def plate(side):
    """The five-point Laplacian of a square, whose factors fill in."""
    one, line = sp.eye_array(side), sp.csc_array(laplacian(side))
    return sp.csc_array(sp.kron(one, line) + sp.kron(line, one))


@pytest.fixture(params=["cholmod", "superlu"])
def engine(request, monkeypatch):
    """Who factorises sparse matrices."""
    if request.param == "superlu":
        monkeypatch.setattr(cholesky, "LIMIT", 0)
    return request.param


@pytest.mark.usefixtures("engine")
@of_matrices
@pytest.mark.parametrize("count", [1, 3])
def test_solves_norms_and_eliminations_are_those_of_the_matrix(M, count):
    full = dense(M)
    n, units = len(full), np.sqrt(full.diagonal())
    unknowns = np.array([2, 0, n - 2])[:count]
    E = np.eye(n)[unknowns]
    elimination = Elimination(M, unknowns)
    N = np.linalg.inv(E @ np.linalg.inv(full) @ E.T)
    assert pytest.approx(N, rel=1e-9) == elimination.N
    r, s = np.sin(np.arange(n) + 1.0) * units, np.cos(np.arange(count) + 2.0) * units[unknowns]
    free, exact = np.linalg.solve(full, np.column_stack([r, r + E.T @ s])).T
    forward, pull, size = elimination.reduce(r)
    assert pull == pytest.approx(N @ free[unknowns])
    z = elimination.recover(forward, np.linalg.solve(N, pull + s))
    assert elimination.norm(z - exact) <= 1e-11 * elimination.norm(exact)
    for factor in (elimination, Factor(M)):
        assert factor.norm(factor.solve(r) - free) <= 1e-11 * factor.norm(free)
        assert factor.dual_norm(r) == pytest.approx(size) == pytest.approx(np.sqrt(r @ free))
        assert factor.dual_norm(r) <= factor.dual_norm_bound(r)


@pytest.mark.usefixtures("engine")
@both_kinds
def test_indefinite_and_singular_matrices_are_refused(convert):
    for bad in (np.ones((2, 2)), np.diag([1.0, 0.0]), np.array([[1.0, 2.0], [2.0, 1.0]])):
        with refuses("positive definite"):
            Factor(convert(bad))
    # a free-floating body: singular to rounding only
    n = 40
    neumann = springs(n)
    neumann[0, 0] = neumann[-1, -1] = 1.0
    with refuses("positive definite"):
        Factor(convert(neumann))
    assert is_semidefinite(convert(neumann))
    assert not is_semidefinite(convert(neumann - 1e-6 * np.eye(n)))
    assert is_semidefinite(convert(np.diag([1e-12, 0.0, 1e12])))
    assert not is_semidefinite(convert(np.array([[0.0, 1.0], [1.0, 5.0]])))


def test_an_order_has_little_fill_and_serves_an_elimination(engine):
    M = plate(25)
    order = Factor(M).order
    assert np.array_equal(np.sort(order), np.arange(M.shape[0]))
    fill = [
        spla.splu(sp.csc_matrix(one), permc_spec="NATURAL").L.nnz for one in (M[order][:, order], M)
    ]
    assert fill[0] < 0.6 * fill[1], engine
    columns = np.random.default_rng(0).normal(size=(7, M.shape[0]))
    exact = np.linalg.solve(M.toarray(), columns.T).T
    few = np.arange(0, M.shape[0], 26)
    for factor in (Factor(M), Elimination(M, few), Elimination(M, few, order)):
        assert factor.solve_many(columns) == pytest.approx(exact, rel=1e-12, abs=1e-12)
        assert factor.solve(columns[3]) == pytest.approx(exact[3], rel=1e-12, abs=1e-12)


@pytest.mark.usefixtures("engine")
def test_pivots_are_those_of_their_unknowns():
    # one unknown whose pivot is rounding, beside others in units far above and below its own
    units = 10.0 ** np.array([30.0, 0.0, 0.0, -30.0, 20.0, -20.0])
    M = np.diag(units)
    M[1, 2] = M[2, 1] = 1.0 - 1e-17
    with refuses("positive definite"):
        Factor(sp.csc_array(M))
    with refuses("positive definite"):
        Elimination(sp.csc_array(M), np.array([3]), np.arange(6))
    M[1, 2] = M[2, 1] = 0.5
    w = np.sqrt(units)
    assert Factor(sp.csc_array(M)).solve(w) == pytest.approx(np.linalg.solve(M, w))


@pytest.mark.usefixtures("engine")
def test_what_overflows_in_a_factor_is_refused_without_a_warning():
    M = np.diag(np.full(5, 1e-74))
    M[0, 1] = M[1, 0] = M[3, 2] = M[2, 3] = 1e75
    with refuses("positive definite"):
        Factor(sp.csc_array(M))


def test_what_others_set_for_their_factors_is_left_alone():
    M = sp.csc_array(np.diag([1.0, 1e-3, 2.0]))
    others = {"supernodal": 1, "dbound": 0.5}
    cholmod.options.update(others)
    try:
        assert Factor(M).solve(np.ones(3)) == pytest.approx([1.0, 1e3, 0.5])
        assert cholmod.options == others
    finally:
        cholmod.options.clear()


def test_a_package_that_cannot_be_loaded_is_done_without(monkeypatch):
    monkeypatch.setitem(sys.modules, "cvxopt", None)
    cholesky.has_cholmod.cache_clear()
    try:
        assert not cholesky.has_cholmod()
        assert Factor(plate(3)).solve(np.zeros(9)).shape == (9,)
    finally:
        cholesky.has_cholmod.cache_clear()


def hidden(n=200):
    """A matrix whose largest eigenvector no Lanczos iteration from the usual start ever meets."""
    start = np.random.default_rng(0).normal(size=n)
    # within the first entries the rest is a multiple of 1: powers of it turn no start into v
    rest = np.append(np.full(60, 0.5), np.linspace(0.0, 1.0, n - 60))
    rest[-1] = 2.0
    v = np.random.default_rng(5).normal(size=60)
    v -= start[:60] * (v @ start[:60]) / (start[:60] @ start[:60])
    v = np.append(v / np.linalg.norm(v), np.zeros(n - 60))
    return sp.csc_array(np.diag(rest) + 2.0 * np.outer(v, v)), 2.5


def test_the_largest_ratio_is_never_below_the_eigenvalue():
    B, exact = hidden()
    A = Factor(sp.csc_array(np.diag(np.ones(200))))
    assert largest_eigenvalue(B.dot, 200, 1e-4) == pytest.approx(2.0)  # what there is to see
    assert exact <= largest_ratio(A, B) <= 2.0 * exact
    root = sp.csc_array(laplacian(200))
    scaled = sp.csc_array(root @ B @ root.T)
    assert exact <= largest_ratio(Factor(sp.csc_array(root @ root.T)), scaled) <= 2.0 * exact


def is_exactly_semidefinite(*terms):
    """Whether the sum of s M over the terms is, eliminated in exact numbers."""
    n = terms[0][1].shape[0]
    M = [
        [sum(Fraction(s) * Fraction(float(dense(X)[i, j])) for s, X in terms) for j in range(n)]
        for i in range(n)
    ]
    for k in range(n):
        if M[k][k] < 0 or (M[k][k] == 0 and any(M[k][k:])):
            return False
        for i in range(k + 1, n if M[k][k] else 0):
            share = M[i][k] / M[k][k]
            M[i] = [entry - share * pivot for entry, pivot in zip(M[i], M[k], strict=True)]
    return True


def spectral(random, n, condition):
    """A matrix with eigenvalues from 1 down to 1 / condition."""
    Q = np.linalg.qr(random.normal(size=(n, n)))[0]
    values = np.append([1.0, 1 / condition], condition ** -random.uniform(0, 1, n - 2))
    return (M := (Q * values) @ Q.T) / 2 + M.T / 2


def of_kind(kind, random, n, condition):
    if kind == 0:
        return spectral(random, n, condition)
    if kind == 1:
        return np.diag(condition ** -random.uniform(0, 1, n))
    if kind == 2:  # a chain that is hardly held
        return laplacian(n) - np.diag(0.1 - condition ** -random.uniform(0, 1, n))
    G = np.round(8 * random.normal(size=(n, (n + 1) // 2)))
    return G @ G.T  # exactly singular from two unknowns on


@both_kinds
@pytest.mark.parametrize("digits", [2, 15])
def test_constants_are_on_the_guaranteed_side(convert, digits):
    random, proved = np.random.default_rng(digits), 0
    for case in range(36):
        n, condition = int(random.integers(2, 8)), 10.0 ** random.uniform(0, digits)
        M = of_kind(case % 3, random, n, condition)
        N = (
            random.uniform(0.1, 10) * M
            if case % 5 == 0
            else of_kind(case % 4, random, n, condition)
        )
        units = 10.0 ** random.uniform(-4, 4, n) if digits > 2 and case % 2 else np.ones(n)
        M, N = ((X * units) * units[:, None] for X in (M, N))
        M, N = (M + M.T) / 2, (N + N.T) / 2
        try:
            A = Factor(convert(M))
        except InputError:
            continue
        Lam, beta = largest_ratio(A, convert(N)), A.smallest_eigenvalue
        assert beta == 0 or is_exactly_semidefinite((1, M), (-beta, np.eye(n)))
        assert Lam == math.inf or is_exactly_semidefinite((Lam, M), (-1, N))
        if digits == 2:  # and none is far from the eigenvalue
            assert not is_exactly_semidefinite((1, M), (-beta * (1 + 1e-8), np.eye(n)))
            assert not is_exactly_semidefinite((Lam * (1 - 1e-8), M), (-1, N))
        proved += beta > 0 and Lam < math.inf
    assert proved >= 30


def of_solid(N):
    """Mass and stiffness of a cube of N^3 nodes, each beside 26, and the angles of eigenvectors."""
    T, K = (
        sp.diags_array([a, b, a], offsets=[-1, 0, 1], shape=(N, N))
        for a, b in ((1.0, 4.0), (-1.0, 2.0))
    )
    products = [(K, T, T), (T, K, T), (T, T, K)]
    B = sum(sp.kron(sp.kron(a, b), c) for a, b, c in products)
    A = sp.kron(sp.kron(T, T), T)
    return sp.csc_array(A), sp.csc_array(B), np.arange(1, N + 1) * np.pi / (N + 1)


@pytest.mark.parametrize("N", [8, slow(14)])
def test_bounds_of_a_solid_are_proved_and_near_the_eigenvalues(N):
    A, B, angles = of_solid(N)
    factor, cos = Factor(A), np.cos(angles)
    assert is_solid(A)
    assert not is_solid(sp.csc_array(laplacian(N**3)))
    exact = 3 * ((2 - 2 * cos) / (4 + 2 * cos)).max()
    assert exact <= largest_ratio(factor, B) <= exact * (1 + 2e-6)
    smallest = (4 + 2 * cos).min() ** 3
    assert smallest * (1 - 2e-6) <= factor.smallest_eigenvalue <= smallest
    x = factor.solve(B @ angles.repeat(N * N))
    factor.forget()
    assert np.array_equal(factor.solve(B @ angles.repeat(N * N)), x)


def test_the_order_of_a_solid_leaves_less_fill_than_minimum_degree():
    cells = skfem.MeshTet.init_tensor(*(np.arange(n + 1.0) for n in (16, 12, 8))).t
    i, j = np.repeat(cells, 4, axis=0).ravel(), np.tile(cells, (4, 1)).ravel()
    nodes = sp.csc_array((np.ones(i.size), (i, j)))
    nodes += sp.diags_array(nodes.sum(axis=0))  # diagonally dominant
    M = sp.csc_array(sp.kron(nodes, np.eye(3) + 1.0))  # three components of a displacement
    order, n = Factor(M).order, M.shape[0]
    assert np.array_equal(np.sort(order), np.arange(n))
    how = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    ours = spla.splu(M[order][:, order], permc_spec="NATURAL", **how).L.nnz
    assert ours < 0.9 * spla.splu(M, permc_spec="MMD_AT_PLUS_A", **how).L.nnz


@pytest.mark.usefixtures("engine")
def test_a_solid_is_told_by_its_largest_component():
    blocks = sp.kron(sp.eye_array(1200), [[2.0, 1.5], [1.5, 2.0]])
    solid, flat = of_solid(9)[0], plate(40)
    cases = [(blocks, False), (sp.block_diag([[[2.0]], flat]), False), (flat, False)]
    cases += [(sp.block_diag([[[2.0]], blocks, solid, solid]), True)]  # two bodies among the pairs
    # a full part with one unknown beside each of its own
    pendants = sp.kron([[0.0, 1.0], [1.0, 0.0]], sp.eye_array(250))
    full = sp.block_diag([np.ones((250, 250)), sp.csc_array((250, 250))])
    cases += [(full + pendants + sp.diags_array([300.0] * 500), True)]
    for M, expected in cases:
        M, n = sp.csc_array(M), M.shape[0]
        assert is_solid(M) == expected
        factor, x = Factor(M), np.cos(np.arange(n))
        assert np.array_equal(np.sort(factor.order), np.arange(n))
        assert factor.solve(M @ x) == pytest.approx(x, rel=1e-11, abs=1e-11)


@both_kinds
def test_a_matrix_at_the_limit_of_rounding_proves_nothing(convert):
    one = np.ones((6, 6)) + np.diag(np.arange(6.0) * 2e-15)
    one[0, 0] += 4e-15
    assert is_exactly_semidefinite((1, one))
    assert Factor(convert(one)).smallest_eigenvalue == 0.0
    assert largest_ratio(Factor(convert(one)), convert(laplacian(6))) == math.inf


def test_factors_that_round_as_much_as_they_may_are_no_proof(monkeypatch):
    """|M - L U| <= gamma |L| |U| lets each entry of this M, all near 1, round by 64 units."""
    n, u, splu = 60, EPS / 2, spla.splu
    signs = np.outer(*2 * [np.tile([1.0, -1.0], 30)])
    M = np.ones((n, n)) + u * (2000 * np.eye(n) - 40 * signs)
    assert not is_exactly_semidefinite((1, M))
    rounding = sp.csc_matrix(np.pad(20 * u * signs, (0, 1)))
    monkeypatch.setattr(spla, "splu", lambda M, **how: splu(M + rounding, **how))
    # its largest diagonal entry and 1e-9 of it are tried first: 2
    B = sp.block_diag([sp.csc_array(2 * np.eye(n) - M), [[2 / (1 + 1e-9)]]], "csc")
    assert 2.0 < largest_ratio(Factor(sp.csc_array(sp.eye_array(n + 1))), B) < 2.0 + 1e-8


def test_factors_that_are_not_symmetric_are_no_proof(monkeypatch):
    M, splu = sp.csc_array(np.ones((6, 6)) + np.eye(6)), spla.splu

    def skew(M, **how):
        lu = splu(M, **how)
        U = 2 * lu.U - sp.diags_array(lu.U.diagonal())
        return SimpleNamespace(L=lu.L, U=U, perm_c=lu.perm_c, perm_r=lu.perm_r)

    assert Factor(M).smallest_eigenvalue == pytest.approx(1.0)
    monkeypatch.setattr(spla, "splu", skew)
    assert Factor(M).smallest_eigenvalue == 0.0


@pytest.mark.usefixtures("engine")
def test_factors_of_one_pattern_refuse_what_is_not_positive_definite():
    lower = sp.csc_array([[2.0, 0.0, 0.0], [-1.0, 2.0, 0.0], [0.0, -1.0, 2.0]])
    factorise, w = InBlocks(lower.indices, lower.indptr), np.array([1.0, -2.0, 3.0])
    full = lower + sp.csc_array(sp.tril(lower, -1)).T
    np.testing.assert_allclose(full @ factorise(lower.data)(w), w)
    np.testing.assert_allclose(full @ factorise(3 * lower.data)(w), w / 3)
    indefinite = lower.data.copy()
    indefinite[-1] = -2.0
    with pytest.raises(ArithmeticError):
        factorise(indefinite)
    np.testing.assert_allclose(full @ factorise(lower.data)(w), w)


def test_a_dense_matrix_of_nan_has_no_factors():
    """LAPACK as OpenBLAS has it reports nothing."""
    with pytest.raises(scipy.linalg.LinAlgError):
        cholesky.factorised(np.array([[np.nan]]))
