"""Multigrid in place of a factorisation, for a matrix whose factors do not fit in memory.

M z = w is solved by conjugate gradients, preconditioned by one symmetric V-cycle V of a smoothed
aggregation hierarchy (pyamg). V is also what certifies: with lambda the smallest eigenvalue of V M,
|w|^2_{M^-1} <= <V w, w> / lambda, which costs one cycle and is sharp within a small factor.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from sweepopt.checks import Matrix
from sweepopt.errors import IndefiniteError, SolverRefusedError, brought_by
from sweepopt.linalg import PIVOT, Factor

RESIDUAL = 1e-13  # of a solve, in the norm of V
LIMIT = 1000  # conjugate gradient steps of one solve
SHARE = 0.6  # of the physical memory, for factors
COARSEST = 50  # unknowns that a dense factorisation takes over
# measured on P1 and P2 Laplacians with jumps of 1e4 and graded meshes: 17 to 28 steps a solve at
# 9e4 unknowns, where Ruge-Stueben needs 20 to 300 and takes 40 % longer a step
STRENGTH = ("symmetric", {"theta": 0.08})
# local weights, as those of a spectral radius come from a random start: each run is the same
SMOOTHING = ("jacobi", {"omega": 4 / 3, "weighting": "local"})
TORN = 0.3  # energy of the tear, in relation to the coarse function's, above which it is left out


class Level(NamedTuple):
    """A matrix of the hierarchy, its diagonal, the prolongation to it and the next diagonal."""

    A: sp.csr_array
    diagonal: np.ndarray
    P: sp.csr_array
    coarse_diagonal: np.ndarray


class Cycle:
    """A symmetric V-cycle for the unknowns that are not stuck: positive definite, near M_FF^-1.

    Parameters
    ----------
    levels : sequence of Level
    coarsest : ndarray
        The dense matrix below them.
    stuck : ndarray of int
        Unknowns held at 0.
    """

    def __init__(self, levels: Sequence[Level], coarsest: np.ndarray, stuck: np.ndarray) -> None:
        self._relax = _pyamg().relaxation.relaxation.gauss_seidel_indexed
        self._levels, self.stuck = levels, stuck
        self._stuck: list[np.ndarray] = []
        self._free: list[np.ndarray] = []
        for level in levels:
            self._stuck.append(stuck)
            self._free.append(_others(stuck, level.A.shape[0]).astype(level.A.indices.dtype))
            torn = level.P[stuck].power(2).T @ level.diagonal[stuck]
            stuck = np.flatnonzero(torn > TORN * level.coarse_diagonal)
        self._last = _others(stuck, len(coarsest))
        if self._last.size:
            block = coarsest[np.ix_(self._last, self._last)]
            self._cholesky = scipy.linalg.cho_factor(block, lower=True)

    def __call__(self, r: np.ndarray) -> np.ndarray:
        return self._descend(0, r)

    def _descend(self, k: int, r: np.ndarray) -> np.ndarray:
        x = np.zeros_like(r)
        if k == len(self._levels):
            if self._last.size:
                x[self._last] = scipy.linalg.cho_solve(self._cholesky, r[self._last])
            return x
        A, P, stuck, free = self._levels[k].A, self._levels[k].P, self._stuck[k], self._free[k]
        self._relax(A, x, r, free, sweep="forward")
        rest = r - A @ x
        rest[stuck] = 0.0
        correction = P @ self._descend(k + 1, P.T @ rest)
        correction[stuck] = 0.0
        x += correction
        self._relax(A, x, r, free, sweep="backward")
        return x


class Multigrid(Factor):
    """A sparse M = M^T > 0 with a multigrid hierarchy in place of a factorisation.

    Parameters
    ----------
    M : sparse, shape (dim, dim)
    name : str
        How error messages call M.

    Raises
    ------
    IndefiniteError
        If M is not positive definite, as far as the hierarchy and one solve show.
    SolverRefusedError
        If multigrid does not converge for M.
    MissingExtraError
        If pyamg is not installed.
    """

    _mistrust = 0.0  # what its solves miss is not bounded here, as lambda_min(M) is not known

    def __init__(self, M: Matrix, name: str = "M") -> None:
        _pyamg()
        super().__init__(sp.csr_array(M.T), name)  # M = M^T: no copy of a CSC matrix

    def _factorise_sparse(self) -> np.ndarray:
        weights = sp.diags_array(1 / self.root)
        self._A = sp.csr_array(weights @ self.M @ weights)
        # constants, in the scaled unknowns or in the given ones: whatever costs least energy
        candidates = np.ones(self.dim), self.root / self.root.max()
        smoothest = min(candidates, key=lambda x: (x @ (self._A @ x)) / (x @ x))
        hierarchy = (
            _pyamg()
            .smoothed_aggregation_solver(
                self._A,
                B=smoothest[:, None],
                strength=STRENGTH,
                smooth=SMOOTHING,
                improve_candidates=None,
                max_coarse=COARSEST,
                max_levels=30,
            )
            .levels
        )
        matrices = [self._A] + [sp.csr_array(level.A) for level in hierarchy[1:]]
        diagonals = [A.diagonal() for A in matrices]
        self._levels = [
            Level(A, fine, sp.csr_array(level.P), coarse)
            for A, fine, level, coarse in zip(
                matrices[:-1], diagonals[:-1], hierarchy[:-1], diagonals[1:], strict=True
            )
        ]
        self._coarsest = matrices[-1].toarray()
        if self._levels and not self._levels[-1].P.count_nonzero():
            self._coarsest = np.zeros((0, 0))  # no unknown depends on another: nothing is coarse
        elif not (diagonals[-1] > 0).all():
            return diagonals[-1]
        else:
            root = np.sqrt(diagonals[-1])
            pivots = np.linalg.eigvalsh(self._coarsest / np.outer(root, root))
            if not pivots[0] > PIVOT:
                return pivots
        return self._probe()

    def _probe(self) -> np.ndarray:
        """Eigenvalues of V M from a solve: its coefficients are those of a Lanczos iteration."""
        self._cycle = self.cycle(np.zeros(0, dtype=int))
        start = np.random.default_rng(0).normal(size=self.dim)
        _, alphas, betas = _conjugate_gradients(self._A, self._cycle, start, RESIDUAL)
        if len(alphas) == LIMIT:
            raise SolverRefusedError(
                f"multigrid does not converge within {LIMIT} steps for this matrix; factorise it"
            )
        inverse, ratios = 1 / np.array(alphas), np.array(betas)
        diagonal = inverse.copy()
        diagonal[1:] += ratios[1:] * inverse[:-1]
        found = scipy.linalg.eigvalsh_tridiagonal(diagonal, np.sqrt(ratios[1:]) * inverse[:-1])
        self._smallest, self._largest = float(found[0]), float(max(found[-1], 1.0))
        return found

    def cycle(self, stuck: np.ndarray) -> Cycle:
        """The V-cycle of D^-1/2 M D^-1/2, D = diag(M), for the unknowns that are not stuck."""
        return Cycle(self._levels, self._coarsest, stuck)

    def solve(self, w: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
        """M^-1 w, to the residual RESIDUAL or to where rounding lets it stagnate.

        Parameters
        ----------
        w : ndarray, shape (dim,)
        start : ndarray, shape (dim,), optional
            An approximate solution.
        """
        right = w / self.root
        x = np.zeros_like(right) if start is None else start * self.root
        rest = right if start is None else right - self._A @ x
        target, missed = RESIDUAL * self._size(right), self._size(rest)
        while missed > target:
            dx = _conjugate_gradients(self._A, self._cycle, rest, target / missed).x
            # the recursion's residual drifts from the true one: look again
            rest = right - self._A @ (x + dx)
            before, missed = missed, self._size(rest)
            if missed < before:
                x = x + dx
            if missed > 0.5 * before:
                break
        return x / self.root

    def solve_many(self, rows: np.ndarray) -> np.ndarray:
        return np.array([self.solve(row) for row in rows])

    def dual_norm_bound(self, w: np.ndarray) -> float:
        """A bound of |w|_{M^-1} that costs one cycle: sqrt(<V w, w> / lambda_min(V M)).

        Lanczos meets lambda_min from above: 10 % are added, as in `Factor`.
        """
        return 1.1 * self._size(w / self.root) / math.sqrt(self._smallest)

    def rounding(self, z: np.ndarray, q: np.ndarray) -> float:
        """0: what M @ z rounds is not bounded here, as lambda_min(M) is not known."""
        return 0.0

    def dual_norm_floor(self, w: np.ndarray) -> float:
        """A number below |w|_{M^-1} that costs one cycle: sqrt(<V w, w> / lambda_max(V M))."""
        return self._size(w / self.root) / math.sqrt(self._largest)

    def _size(self, r: np.ndarray) -> float:
        return math.sqrt(max(r @ self._cycle(r), 0.0))

    def correct(self, r: np.ndarray, cycle: Cycle, reduction: float) -> tuple[np.ndarray, int]:
        """dz with M_FF dz_F = r_F, 0 where `cycle` holds unknowns, and the number of steps.

        The residual shrinks by the factor `reduction` in the norm of the cycle.
        """
        right = r / self.root
        right[cycle.stuck] = 0.0
        dx, alphas, _ = _conjugate_gradients(self._A, cycle, right, reduction)
        return dx / self.root, len(alphas)


class _Iterated(NamedTuple):
    """What conjugate gradients found, and their coefficients: those of a Lanczos iteration."""

    x: np.ndarray
    alphas: list[float]
    betas: list[float]


def _conjugate_gradients(
    A: sp.csr_array, cycle: Cycle, r: np.ndarray, reduction: float
) -> _Iterated:
    """A x = r on the unknowns of the cycle."""
    x, direction = np.zeros_like(r), np.zeros_like(r)
    first = size = 0.0
    alphas: list[float] = []
    betas: list[float] = []
    while True:
        y = cycle(r)
        before, size = size, float(r @ y)
        first = first or size
        if 0 <= size <= reduction**2 * first or len(alphas) == LIMIT:
            return _Iterated(x, alphas, betas)
        betas.append(size / before if before else 0.0)
        direction = y + betas[-1] * direction
        image = A @ direction
        image[cycle.stuck] = 0.0
        curvature = float(direction @ image)
        if not (size > 0 and curvature > 0):
            raise IndefiniteError(
                "the matrix must be positive definite; multigrid met a curvature <= 0"
            )
        alphas.append(size / curvature)
        x += alphas[-1] * direction
        r = r - alphas[-1] * image


def _others(few: np.ndarray, count: int) -> np.ndarray:
    """range(count) without a few."""
    keep = np.ones(count, dtype=bool)
    keep[few] = False
    return np.flatnonzero(keep)


def _pyamg() -> Any:
    with brought_by("speed"):
        import pyamg
    return pyamg


def factorise(M: Matrix, name: str = "M") -> Factor:
    """M factorised, or with a multigrid hierarchy where its factors would not fit in memory."""
    fills = sp.issparse(M) and M.nnz > M.shape[0]  # a diagonal matrix is its own factor
    return Multigrid(M, name) if fills and not fits(M.shape[0]) else Factor(M, name)


def fits(dim: int) -> bool:
    """Whether a plane body of so many unknowns can be factorised on this machine.

    A factor of P1 elements in the plane has about 2 n log2 n entries (measured from 1e4 to 1e6
    unknowns), and a run holds about 120 bytes for each.
    """
    return 240.0 * dim * math.log2(dim + 1) <= SHARE * _physical_memory()


def _physical_memory() -> float:
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):  # not on every system
        return 8e9
