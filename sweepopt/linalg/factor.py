"""A symmetric positive definite matrix factorised once: solves and the two norms it defines.

Where factors do not fit in memory conjugate gradients take their place.
"""

from __future__ import annotations

import math
import os
from functools import cached_property, partial
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from sweepopt.checks import Array, Matrix, divisor
from sweepopt.errors import IndefiniteError, MissingExtraError, SolverRefusedError
from sweepopt.linalg.cholesky import factorised, has_cholmod
from sweepopt.linalg.conjugate_gradients import ConjugateGradients
from sweepopt.linalg.eigenvalues import largest_ratio
from sweepopt.linalg.matrices import (
    PIVOT,
    SEMIDEFINITE,
    UNIT,
    Reduced,
    euclidean,
    is_diagonal,
    is_dominant,
    largest_eigenvalue,
    rounding_weights,
)
from sweepopt.linalg.ordering import is_solid
from sweepopt.linalg.twice_precision import Precise

NEGLIGIBLE = 1e-12
"""Share of a vector, or of the largest of several, below which parts of it are rounding."""


class Factor:
    """M = M^T > 0 with its factorisation.

    Parameters
    ----------
    M : ndarray or sparse, shape (dim, dim)
    name : str
        How error messages call M.

    Attributes
    ----------
    unknowns : ndarray of int or slice
        Those that a program with M has: all.
    order : ndarray of int or None
        An order of the unknowns with little fill, for a sparse M.
    has_factors : bool
        Whether its equations are solved by factors, not by conjugate gradients.

    Raises
    ------
    IndefiniteError
        If M is not positive definite.
    """

    unknowns: Any = slice(None)

    def __init__(
        self,
        M: Matrix,
        name: str = "M",
        *,
        unknowns: Array | None = None,
        order: Array | None = None,
    ) -> None:
        self.M, self.dim = M, M.shape[0]
        self.diagonal = M.diagonal()
        if not (self.diagonal > 0).all():
            i = int(np.flatnonzero(self.diagonal <= 0)[0])
            raise IndefiniteError(
                f"{name} must be positive definite, but {name}[{i}, {i}] = {self.diagonal[i]:g}"
            )
        i = int(np.argmin(self.diagonal))
        divisor(f"{name}[{i}, {i}]", self.diagonal[i])
        self.is_diagonal = is_diagonal(M)
        self.root = np.sqrt(self.diagonal)
        self.order, self._unknowns = order, unknowns
        try:
            # pivots of inf or nan are refused below
            with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
                pivots = self._engine.pivots / self.diagonal
        except RecursionError:  # a RuntimeError that says nothing about M
            raise
        except (scipy.linalg.LinAlgError, RuntimeError, ArithmeticError):
            pivots = np.zeros(1)
        except MemoryError as error:
            raise SolverRefusedError(
                f"the factors of {name}, {self.dim} unknowns, do not fit in memory; "
                "take a coarser mesh"
            ) from error
        # relative to the diagonal: the test does not depend on units
        if not pivots.min() > PIVOT:
            raise IndefiniteError(f"{name} must be positive definite; it has an eigenvalue <= 0")
        self.order, self.has_factors = self._engine.order, self._engine.has_factors

    @cached_property
    def _engine(self) -> Any:
        """What solves with M, and eliminates all unknowns but those that are kept."""
        M, order, kept = self.M, self.order, self._unknowns
        need, there = factor_bytes(M), _physical_memory()
        if need > 0.6 * there:  # the rest is for mesh, states and Python
            try:
                return ConjugateGradients(M, kept)
            except MissingExtraError as error:
                raise SolverRefusedError(
                    f"factors of {self.dim} unknowns would need about {need / 1e9:.3g} GB, this "
                    f"machine has {there / 1e9:.3g} GB, and conjugate gradients need a package: "
                    f"{error}"
                ) from error
        if kept is None:
            return factorised(M, order)
        M = sp.csc_array(M)
        order = factorised(M).order if order is None else order
        return factorised(M, np.concatenate([order[~np.isin(order, kept)], kept]), kept.size)

    def forget(self) -> None:
        """Drop the factors; a solve that needs them makes them again."""
        self.__dict__.pop("_engine", None)

    def __reduce__(self) -> tuple[Any, ...]:
        """For copies and pickle: the factors are made again."""
        return partial(type(self), self.M, unknowns=self._unknowns, order=self.order), ()

    def solve(self, w: Array) -> Array:
        """M^-1 w."""
        return self._engine.solve(w)

    @property
    def small(self) -> Factor:
        """The matrix of the program for the `unknowns` alone: of all unknowns M itself."""
        return self

    def reduce(self, r: Array) -> Reduced:
        """A force r seen from the `unknowns`."""
        return Reduced(None, r)

    def recover(self, forward: Any, zeta: Array) -> Array:
        """The z that is zeta on the `unknowns` and balances r beside them."""
        return zeta

    def solve_many(self, rows: Array) -> Array:
        """M^-1 of each row, shape (k, dim)."""
        return self.solve(np.asfortranarray(rows.T)).T

    @cached_property
    def inverse(self) -> Array:
        """M^-1, of a matrix of few unknowns."""
        inverse = self.solve_many(np.eye(self.dim))
        return 0.5 * (inverse + inverse.T)

    def dual_norm_bound(self, w: Array) -> float:
        """A bound of |w|_{M^-1} that costs no solve: |D^-1/2 w| / sqrt(lambda_min), D = diag(M).

        lambda_min is that of D^-1/2 M D^-1/2.
        """
        return euclidean(w / self.root) * self.bound_factor

    def is_within(self, w: Array, limit: float) -> bool:
        """Whether |w|_{M^-1} <= limit; a solve only where bounds of it do not decide."""
        size = euclidean(w / self.root)
        if size > limit * self.stretch:
            return False
        return size * self.bound_factor <= limit or self.dual_norm(w) <= limit

    def apply(self, z: Array, q: Array, enough: float, least: float = 0.0) -> tuple[Array, float]:
        """M z + q and |z|_M; rounding may be `enough` times that or `least`."""
        force = self.M.dot(z)
        size = math.sqrt(max(z.dot(force), 0.0))
        if enough < math.inf and not self.rounding(z, euclidean(q / self.root)) <= enough * max(
            size, least
        ):
            return self.precisely(z, q), size
        return force + q, size

    def rounding(self, z: Array, q: float) -> float:
        """A bound in |.|_{M^-1} of what M @ z + q rounds, without a solve.

        Parameters
        ----------
        z : ndarray, shape (dim,)
        q : float
            |D^-1/2 q|, D = diag(M).
        """
        return UNIT * (euclidean(self._weights * z) + q) * self.bound_factor

    @cached_property
    def _weights(self) -> Array:
        return rounding_weights(self.M, self.root)

    @cached_property
    def margin(self) -> float:
        """How much larger |w|_{M^-1} may be than rounded factors say."""
        roundings = float((self._weights / self.root).max())
        return 1 + min(UNIT * roundings * self.bound_factor**2, 1.0)

    @cached_property
    def stretch(self) -> float:
        """|z|_M <= this times |z| in units of the diagonal of M."""
        return math.sqrt((abs(self.M) @ (1 / self.root) / self.root).max())

    @cached_property
    def precisely(self) -> Precise:
        """(z, *more) -> M z + the others, rounded once."""
        return Precise(self.M)

    @cached_property
    def bound_factor(self) -> float:
        """1 / sqrt(lambda_min), lambda_min that of D^-1/2 M D^-1/2, D = diag(M).

        Lanczos meets the largest eigenvalue of the inverse from below, here to 0.1 %; 10 % are
        added. The norm is applied to rounding errors only.
        """
        scaled = largest_eigenvalue(lambda w: self.root * self.solve(self.root * w), self.dim, 1e-3)
        return 1.1 * math.sqrt(scaled)

    def norm(self, z: Array) -> float:
        """|z|_M = sqrt<Mz, z>."""
        return float(np.sqrt(max(z @ (self.M @ z), 0.0)))

    def dual_norm(self, w: Array) -> float:
        """|w|_{M^-1} = sqrt<M^-1 w, w>, the length of half a solve where that is known."""
        if not w.any():
            return 0.0
        forward = getattr(self._engine, "forward", None)
        return math.sqrt(max(w @ self.solve(w), 0.0)) if forward is None else euclidean(forward(w))

    @cached_property
    def smallest_eigenvalue(self) -> float:
        """beta: a number with <Mx, x> >= beta |x|^2, the largest one or a little less.

        It is proved: 0, if nothing is.
        """
        one = sp.eye_array(self.dim) if sp.issparse(self.M) else np.eye(self.dim)
        beta = 1 / largest_ratio(self, one)
        return beta if self.is_diagonal else math.nextafter(beta, 0.0)


class Elimination(Factor):
    """A factorisation L L^T that ends with a few unknowns, to eliminate all others exactly.

    For M z = r + E^T s, E selecting the unknowns, one forward and one backward substitution frame
    a problem for zeta = E z alone, with the Schur complement N = (E M^-1 E^T)^-1, which is the
    trailing block of the factor: a step costs as much as one without the set.

    Parameters
    ----------
    M : ndarray or sparse, shape (dim, dim)
    unknowns : ndarray of int, shape (m,)
        The unknowns to keep.
    order : ndarray of int, optional
        An order with little fill, as a `Factor` of a matrix of the same pattern tells it.
    """

    def __init__(self, M: Matrix, unknowns: Array, order: Array | None = None) -> None:
        super().__init__(M, unknowns=unknowns, order=order)
        self.unknowns, self.N = unknowns, self._engine.N

    @cached_property
    def small(self) -> Factor:
        """N with its own factors."""
        return Factor(self.N)

    def reduce(self, r: Array) -> Reduced:
        """The force N E M^-1 r on zeta, |r|_{M^-1}, and what `recover` needs of r."""
        return self._engine.reduce(r)

    def recover(self, forward: Array, zeta: Array) -> Array:
        """z with M z = r + E^T s and E z = zeta."""
        return self._engine.recover(forward, zeta)


def factor_bytes(M: Matrix) -> float:
    """The memory that factors of M need, about.

    A factor of P1 elements in the plane has about 2 n log2 n entries (measured from 1e4 to 1e6
    unknowns), and a run holds about 120 bytes for each. One of a solid has less than 20 n^(4/3)
    (see `ordering`), for each of which runs held 20 to 32 bytes with CHOLMOD's blocks, here 40. A
    diagonal matrix is its own factor; a dense one is in memory already.
    """
    n = M.shape[0]
    if not sp.issparse(M) or M.nnz <= n:
        return 0.0
    if is_solid(M):
        return (40 if has_cholmod() else 120) * 20 * n ** (4 / 3)
    return 240.0 * n * math.log2(n + 1)


def _physical_memory() -> float:
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):  # not on every system
        return 8e9


def is_semidefinite(M: Matrix) -> bool:
    """Whether a symmetric matrix is positive semidefinite up to rounding, in its own units."""
    diagonal = M.diagonal()
    # a zero on the diagonal of a semidefinite matrix has a zero row
    empty = diagonal == 0
    if abs(M[empty]).sum() > 0:
        return False
    shift = np.where(empty, 1.0, SEMIDEFINITE * diagonal)
    M = M + (sp.diags_array(shift) if sp.issparse(M) else np.diag(shift))
    if is_dominant(M):
        return True
    try:
        Factor(M)
    except IndefiniteError:
        return False
    return True


def require_semidefinite(name: str, M: Matrix) -> None:
    """Refuse a symmetric matrix that is not positive semidefinite up to rounding.

    Raises
    ------
    IndefiniteError
        Naming a negative entry of the diagonal, or one that is too large beside it, if there is.
    """
    if is_semidefinite(M):
        return
    diagonal, entry = M.diagonal(), sp.coo_array(M)
    i, j = entry.coords
    products = diagonal[i] * diagonal[j]
    k, least = int(np.argmax(entry.data**2 - products)), int(diagonal.argmin())
    fault = "it has a negative eigenvalue"
    if diagonal[least] < 0:
        fault = f"{name}[{least}, {least}] = {diagonal[least]:g}"
    elif entry.data[k] ** 2 > products[k]:
        fault = (
            f"{name}[{i[k]}, {j[k]}] = {entry.data[k]:g} is larger than the geometric mean "
            f"{math.sqrt(products[k]):g} of {name}[{i[k]}, {i[k]}] and {name}[{j[k]}, {j[k]}]"
        )
    raise IndefiniteError(
        f"{name} must be positive semidefinite, but {fault}; check the signs of what it is made of"
    ) from None  # Factor, which is asked first, only says that it failed
