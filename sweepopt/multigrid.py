"""Velocity programs whose matrix does not fit in memory once it is factorised: multigrid instead.

M z = w is solved by conjugate gradients, preconditioned by one symmetric V-cycle V of a smoothed
aggregation hierarchy (pyamg). V is also what certifies: with lambda the smallest eigenvalue of V M,
|w|^2_{M^-1} <= <V w, w> / lambda, which costs one cycle and is sharp within a small factor.

For a set on few unknowns C = c + E^T S, S separable (friction), -z in N_C(M z + q) is solved by the
semismooth Newton method of `solvers/newton.py` in the full space: stuck unknowns get z = 0, all
others F solve M_FF dz = r. The hierarchy of M serves every F: on each level the coarse unknowns
whose function would be torn by holding the stuck ones are left out, and the others are cut off
there (R. Kornhuber, Monotone multigrid methods, Numer. Math. 69, 1994, truncates so).

Newton's method may cycle. A contact that would reverse stops first, and when the number of contacts
that change their state has not fallen for a while, one changes at a time: that ends for every M > 0
(J. Judice, F. Pires, A block principal pivoting algorithm, Comput. Oper. Res. 21, 1994).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from sweepopt.checks import Matrix
from sweepopt.errors import InputError, MissingExtraError, SolverRefusedError
from sweepopt.linalg import Factor
from sweepopt.program import Velocity, rate
from sweepopt.sets.base import ROUNDING, ConvexSet, Selection

RESIDUAL = 1e-13  # of a solve, in the norm of V
LIMIT = 1000  # conjugate gradient steps of one solve
COARSEST = 50  # unknowns that a dense factorisation takes over
# measured on P1 and P2 Laplacians with jumps of 1e4 and graded meshes: 17 to 28 steps a solve at
# 9e4 unknowns, where Ruge-Stueben needs 20 to 300 and takes 40 % longer a step
STRENGTH = ("symmetric", {"theta": 0.08})
# local weights, as those of a spectral radius come from a random start: each run is the same
SMOOTHING = ("jacobi", {"omega": 4 / 3, "weighting": "local"})
TORN = 0.3  # energy of the tear, in relation to the coarse function's, above which it is left out
# reduction of the residual while the contact state changes; less and less loose if that goes on
LOOSE, LEAST = 0.1, 1e-8
PATIENCE = 10  # Newton steps without fewer changes of the state; then one contact changes at a time


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
    InputError
        If M is not positive definite, as far as the hierarchy and one solve show.
    SolverRefusedError
        If multigrid does not converge for M.
    MissingExtraError
        If pyamg is not installed.
    """

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
            if not pivots[0] > 16 * np.finfo(float).eps:
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
            dx, *_ = _conjugate_gradients(self._A, self._cycle, rest, target / missed)
            # the recursion's residual drifts from the true one: look again
            rest = right - self._A @ (x + dx)
            before, missed = missed, self._size(rest)
            if missed < before:
                x = x + dx
            if missed > 0.5 * before:
                break
        return x / self.root

    def dual_norm_bound(self, w: np.ndarray) -> float:
        """A bound of |w|_{M^-1} that costs one cycle: sqrt(<V w, w> / lambda_min(V M)).

        Lanczos meets lambda_min from above: 10 % are added, as in `Factor`.
        """
        return 1.1 * self._size(w / self.root) / math.sqrt(self._smallest)

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


class Step(NamedTuple):
    """A velocity with its proof, the number of Newton steps and of conjugate gradient steps."""

    velocity: Velocity
    iterations: int
    cycles: int


class MultigridProgram:
    """-z in N_C(M z + q) for one M and all C = c + E^T S with one E, S separable.

    A call starts from the velocity and the contact state that the last one found; not to be shared
    by threads. The certificate is computed from M, q and C alone, whatever the iterations did.

    Parameters
    ----------
    M : Multigrid
    contact : ndarray of int, shape (m,)
        The unknowns that E selects.
    tol : float
        Relative certificate at which a call ends; it ends above it where it stagnates.
    max_iter : int
        Newton steps of a call.
    """

    def __init__(
        self, M: Multigrid, contact: np.ndarray, tol: float = 1e-10, max_iter: int = 300
    ) -> None:
        self.M, self.contact, self.tol, self.max_iter = M, contact, tol, max_iter
        self._columns = M.M[contact].T
        self._last = self._before = np.zeros(M.dim)
        self._side = np.zeros(contact.size)  # signs of the slipping contacts, 0 where stuck
        self._cycle = M.cycle(contact)

    def __call__(self, q: np.ndarray, selection: Selection) -> Step:
        """Solve the program.

        Parameters
        ----------
        q : ndarray, shape (dim,)
        selection : Selection
            `C.selection`, of the unknowns `contact`.

        Raises
        ------
        SolverRefusedError
            If the set is not separable.
        """
        M, contact, part = self.M, self.contact, selection.part
        force = q if selection.shift is None else q - selection.shift
        if _at_rest(q, selection, force):
            self._last = self._before = np.zeros(M.dim)
            return Step(Velocity(np.zeros(M.dim), 0.0, 0.0), 0, 0)
        T = part.steps(M.diagonal[contact])
        size_q = M.dual_norm_floor(force)
        z, best = 2 * self._last - self._before, Velocity(self._last, math.inf, math.inf)
        fewest, stalled, cycles, tight = contact.size + 1, 0, 0, False
        forces = np.zeros(contact.size)
        for iteration in range(self.max_iter + 1):
            w = M.M @ z + force
            v = w[contact] - T * z[contact]
            normal, target = part.normal(v), part.project(v)
            side = self._next_side(part, v, normal, z[contact])
            changes = np.flatnonzero(side != self._side)
            reduction = max(LOOSE ** (1 + stalled), LEAST)
            if not changes.size or iteration == self.max_iter:
                velocity = self._certify(z, w, force, normal / T, target, size_q)
                stagnates = tight and velocity.certificate >= best.certificate
                best = min(best, velocity, key=lambda one: one.certificate)
                if best.relative <= self.tol or stagnates or iteration == self.max_iter:
                    break
                reduction = min(0.3 * self.tol / velocity.relative, 0.3)
            elif changes.size < fewest:
                fewest, stalled = changes.size, 0
            else:
                stalled += 1
                if stalled > PATIENCE:
                    changes = changes[-1:]
            tight = not changes.size
            if not tight:
                self._side[changes] = side[changes]
                self._cycle = M.cycle(contact[self._side == 0])
            # one that is to stop but has to wait keeps its force
            forces = np.where((side == self._side) | (self._side == 0), target, forces)
            w[contact] -= forces
            dz, count = self._newton(z, w, reduction)
            z, cycles = z + dz, cycles + count
        self._before, self._last = self._last, best.z
        return Step(best, iteration, cycles)

    def _next_side(
        self, part: ConvexSet, v: np.ndarray, normal: np.ndarray, z: np.ndarray
    ) -> np.ndarray:
        """The sign of z at the contacts that slip next: none that reverses, it stops first."""
        D = part.derivative(v)
        if D is None or D.ndim != 1:
            raise SolverRefusedError(
                "multigrid treats sets that act on each unknown alone, such as a Box; this is a "
                f"{type(part).__name__}"
            )
        return np.where((D == 1) | (z * self._side < 0), 0.0, -np.sign(normal))

    def _newton(self, z: np.ndarray, rho: np.ndarray, reduction: float) -> tuple[np.ndarray, int]:
        """dz: stuck contacts get 0, all other unknowns solve M dz = -rho."""
        held = np.where(self._side == 0, -z[self.contact], 0.0)
        dz, count = self.M.correct(-rho - self._columns @ held, self._cycle, reduction)
        dz[self.contact] += held
        return dz, count

    def _certify(
        self,
        z: np.ndarray,
        w: np.ndarray,
        force: np.ndarray,
        p: np.ndarray,
        target: np.ndarray,
        size_q: float,
    ) -> Velocity:
        """z with -p on the contact, where p in N_S(target) exactly (Moreau), and its proof.

        What is left is rho = M z + q - c - E^T target, and |z - z*|_M <= |rho|_{M^-1}.
        """
        entries = 0.0 - p
        rho = w + self._columns @ (entries - z[self.contact])
        z = z.copy()
        z[self.contact] = entries
        size_z = math.sqrt(max(float(z @ (rho - force)), 0.0))
        rho[self.contact] -= target
        return rate(z, self.M.dual_norm_bound(rho), size_z, size_q)


def _at_rest(q: np.ndarray, selection: Selection, force: np.ndarray) -> bool:
    """Whether q is in C up to 8 rounding units, the rule of `VelocityProgram.at_rest`."""
    missed = force.copy()
    missed[selection.unknowns] = selection.part.normal(force[selection.unknowns])
    scale = np.abs(q) if selection.shift is None else np.abs(q) + np.abs(selection.shift)
    return bool((np.abs(missed) <= ROUNDING * scale).all())


def _conjugate_gradients(
    A: sp.csr_array, cycle: Cycle, r: np.ndarray, reduction: float
) -> tuple[np.ndarray, list[float], list[float]]:
    """x with A x = r on the unknowns of the cycle, and the coefficients of the iteration."""
    x, direction = np.zeros_like(r), np.zeros_like(r)
    first = size = 0.0
    alphas: list[float] = []
    betas: list[float] = []
    while True:
        y = cycle(r)
        before, size = size, float(r @ y)
        first = first or size
        if 0 <= size <= reduction**2 * first or len(alphas) == LIMIT:
            return x, alphas, betas
        betas.append(size / before if before else 0.0)
        direction = y + betas[-1] * direction
        image = A @ direction
        image[cycle.stuck] = 0.0
        curvature = float(direction @ image)
        if not (size > 0 and curvature > 0):
            raise InputError("the matrix must be positive definite; multigrid met a curvature <= 0")
        alphas.append(size / curvature)
        x += alphas[-1] * direction
        r = r - alphas[-1] * image


def _others(few: np.ndarray, count: int) -> np.ndarray:
    """range(count) without a few."""
    keep = np.ones(count, dtype=bool)
    keep[few] = False
    return np.flatnonzero(keep)


def _pyamg() -> Any:
    try:
        import pyamg
    except ImportError as error:
        raise MissingExtraError("pyamg", "speed") from error
    return pyamg
