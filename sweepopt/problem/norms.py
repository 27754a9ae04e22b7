"""The norms of a process for many vectors at once, and how errors in them grow (MATH 3)."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sweepopt.checks import Array, Matrix
from sweepopt.errors import InputError
from sweepopt.linalg import Factor, largest_ratio

if TYPE_CHECKING:
    from sweepopt.problem import SweepingProcess


LEAST_SHARE = 1e-3
"""Of a number beside which a norm counts: a bound without a solve is enough where that is less.

The bound of n steps grows by a share of 2e-3 sqrt(n) at most (by 0.2 % on a fault of 51,280
unknowns); that of fretting takes 7 times as long as the run, and 10 times with all solves."""


class Norm:
    """|x|_M of a symmetric positive semidefinite M, and the dual |w|_{M^-1}, many vectors at once.

    Attributes
    ----------
    beta : float
        |x|_M^2 >= beta |x|^2; 0 where no such number is proved.
    """

    def __init__(self, M: Matrix | None, factor: Factor | None) -> None:
        self._M, self._factor = M, factor  # None for 0, and for a singular M
        self.beta = 0.0 if factor is None else factor.smallest_eigenvalue

    def __call__(self, x: Array) -> Array:
        """|x|_M over the last axis."""
        if self._M is None:
            return np.zeros(x.shape[:-1])
        return np.sqrt(np.maximum(squares(self._M, x), 0.0))

    def dual(self, w: Array, beside: Any = 0.0) -> Array:
        """|w|_{M^-1} over the last axis; where it is negligible beside a number, a bound of it.

        Infinite where M has no inverse.
        """
        return self.dual_products(w[..., None, :], beside).of_sum(np.eye(1))

    def dual_products(self, w: Array, beside: Any) -> Products:
        """<w_j, M^-1 w_k> of the rows of each w, shape (..., k, dim)."""
        family = w.reshape(-1, *w.shape[-2:])
        size = np.linalg.norm(family, axis=-1)
        scale = 1 / math.sqrt(self.beta) if self.beta else math.inf
        with np.errstate(invalid="ignore"):
            rest = np.where(size == 0, 0.0, scale * size)  # of NaN it is NaN, not 0
        relevant = rest > LEAST_SHARE * np.broadcast_to(beside, w.shape[:-2]).reshape(-1, 1)
        solved = np.zeros_like(family)
        if self._factor is not None and relevant.any():
            solved[relevant], rest[relevant] = self._factor.solve_many(family[relevant]), 0.0
        products = np.where((rest == 0)[:, :, None], family, 0.0) @ np.swapaxes(solved, 1, 2)
        shape = w.shape[:-1]
        return Products(products.reshape(*shape, shape[-1]), rest.reshape(shape))


class Norms:
    """The norms of a process, and how errors in them grow.

    Attributes
    ----------
    process : SweepingProcess
    weak : bool
        Whether A is singular, or is not proved to be definite, as rounding hides whether it is:
        then B takes its place, and must be positive definite.
    A, B : Norm
    coercivity : float
        beta of A, 0 where A is singular: with tau = beta, w = P_C(A v' + B v - tau v') makes
        2 G + |r|^2 / beta least, a bound of 2 G + |r|^2 in the dual norm of A.
    lam, Lam : float
        Below and above all eigenvalues of A^-1 B; 0 where A is singular; Lam is inf if nothing is
        proved.
    """

    def __init__(self, process: SweepingProcess) -> None:
        self.process = process
        # Lam is inf, and beta 0, where A is singular
        B, self.weak = process.B, process.beta == 0 or process.Lam == math.inf
        factor = process.metric if process.metric.M is B else None
        if B is not None and factor is None:
            with suppress(InputError):  # of a singular one
                factor = Factor(B, "B")
        metric = factor if self.weak else process.metric
        if metric is None or metric.smallest_eigenvalue == 0:
            raise InputError(
                "error bounds need A or B to be positive definite, here both are singular to "
                "rounding; compare with a run of twice the steps"
            )
        self.A, self.B = Norm(metric.M, metric), Norm(B, factor)
        self.coercivity = process.beta
        self.lam, self.Lam = 0.0, 0.0 if self.weak else process.Lam
        if not (self.weak or factor is None):
            self.lam = math.nextafter(1 / largest_ratio(factor, process.A), 0.0)

    def growth(self, tau: Array) -> Array:
        """K(tau) of MATH 3 without sqrt(Lam / lam), which |.|_B / sqrt(lam) does not need."""
        if self.Lam == 0:
            return np.ones_like(tau)
        nu = (self.Lam - self.lam) ** 2 / (8 * (self.Lam + self.lam))
        with np.errstate(over="ignore"):
            return np.minimum(np.exp(nu * tau), 1 + np.sqrt(0.5 * self.Lam * tau))


class Products(NamedTuple):
    """Products of vectors w_1 ... w_k in a dual norm, of each of many families of k vectors.

    Attributes
    ----------
    products : ndarray, shape (..., k, k)
        0 for vectors that are negligible beside a given number.
    rest : ndarray, shape (..., k)
        Bounds of the norms of these, which take no solve; 0 for the others.
    """

    products: Array
    rest: Array

    def of_sum(self, weights: Array) -> Array:
        """A bound of sqrt(sum_i |sum_k weights_ik w_k|^2)."""
        squared = ((weights.T @ weights) * self.products).sum(axis=(-2, -1))
        rest: Array = self.rest @ np.linalg.norm(weights, axis=0)
        return np.sqrt(np.maximum(squared, 0.0)) + rest


def applied(M: Any, x: Array) -> Array:
    """M x over the last axis."""
    return (M @ x.reshape(-1, x.shape[-1]).T).T.reshape(x.shape)


def squares(M: Any, x: Array) -> Array:
    """<Mx, x> over the last axis."""
    return (applied(M, x) * x).sum(axis=-1)
