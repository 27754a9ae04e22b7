"""Factorisations, their norms and the exact elimination."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from sweepopt.errors import InputError
from sweepopt.linalg import Elimination, Factor, is_semidefinite


def laplacian(n: int) -> np.ndarray:
    return 2.1 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)


MATRICES = {
    "dense": laplacian(30),
    "sparse": sp.csc_array(laplacian(80)),
    "mixed units": np.diag([1e-6, 1.0, 1e6]) @ laplacian(3) @ np.diag([1e-6, 1.0, 1e6]),
}


@pytest.mark.parametrize("M", MATRICES.values(), ids=MATRICES)
def test_solves_and_norms_are_those_of_the_matrix(M: np.ndarray) -> None:
    factor, full = Factor(M), M.toarray() if sp.issparse(M) else M
    w = np.cos(np.arange(len(full)) + 1.0) * np.sqrt(full.diagonal())
    z = np.linalg.solve(full, w)
    assert factor.norm(factor.solve(w) - z) <= 1e-12 * factor.norm(z)
    assert factor.dual_norm(w) == pytest.approx(np.sqrt(w @ z))
    assert factor.dual_norm(w) <= factor.dual_norm_bound(w)


def test_the_bound_of_the_dual_norm_is_met_by_the_slowest_mode() -> None:
    M = laplacian(80)
    mode = np.linalg.eigh(M)[1][:, 0]
    factor = Factor(sp.csc_array(M))
    assert factor.dual_norm(mode) <= factor.dual_norm_bound(mode) <= 1.2 * factor.dual_norm(mode)


@pytest.mark.parametrize("M", MATRICES.values(), ids=MATRICES)
@pytest.mark.parametrize("count", [1, 2, 3])
def test_elimination_is_exact(M: np.ndarray, count: int) -> None:
    full = M.toarray() if sp.issparse(M) else M
    n = len(full)
    unknowns = np.array([2, 0, 1])[:count]
    E = np.eye(n)[unknowns]
    elimination = Elimination(M, unknowns)
    N = np.linalg.inv(E @ np.linalg.inv(full) @ E.T)
    assert pytest.approx(N, rel=1e-9) == elimination.N
    r = np.sin(np.arange(n) + 1.0) * np.sqrt(full.diagonal())
    s = np.cos(np.arange(count) + 2.0) * np.sqrt(full.diagonal()[unknowns])
    forward, pull = elimination.reduce(r)
    free = np.linalg.solve(full, r)
    assert np.linalg.norm(forward) == pytest.approx(elimination.dual_norm(r))
    assert pull == pytest.approx(N @ free[unknowns])
    z = elimination.recover(forward, pull + s)
    exact = np.linalg.solve(full, r + E.T @ s)
    assert elimination.norm(z - exact) <= 1e-11 * elimination.norm(exact)
    assert elimination.norm(elimination.solve(r) - free) <= 1e-11 * elimination.norm(free)


@pytest.mark.parametrize("convert", [np.asarray, sp.csc_array])
def test_indefinite_and_singular_matrices_are_refused(convert: type) -> None:
    for bad in (np.ones((2, 2)), np.diag([1.0, 0.0]), np.array([[1.0, 2.0], [2.0, 1.0]])):
        with pytest.raises(InputError, match="positive definite"):
            Factor(convert(bad))
    # a free-floating body: singular to rounding only
    n = 40
    neumann = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    neumann[0, 0] = neumann[-1, -1] = 1.0
    with pytest.raises(InputError, match="positive definite"):
        Factor(convert(neumann))
    assert is_semidefinite(convert(neumann))
    assert not is_semidefinite(convert(neumann - 1e-6 * np.eye(n)))
    assert is_semidefinite(convert(np.diag([1e-12, 0.0, 1e12])))
    assert not is_semidefinite(convert(np.array([[0.0, 1.0], [1.0, 5.0]])))
