"""M z + q rounded once: where M is badly conditioned, M z cancels to less than its own rounding.

M and z are cut into slices of few bits (Ozaki, Ogita, Oishi, Rump, Numer. Algorithms 59, 2012): the
products of slices are exact in double precision, and their sum is taken with its rounding errors.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Matrix


class Precise:
    """Products with a symmetric positive semidefinite matrix in more than twice the precision.

    Of `slices` slices the last one is all that is left; its products are rounded, the others are
    exact and summed with their rounding errors.

    Parameters
    ----------
    M : ndarray or sparse, shape (dim, dim)
        Rows with a zero on the diagonal are zero.
    slices : int

    Attributes
    ----------
    share : float
        Of what a product in double precision may round, for what is left of it here.

    Examples
    --------
    >>> M = np.array([[1.0, 1.0], [1.0, 1.0 + 2**-50]])
    >>> Precise(M)(np.array([1.0, -1.0]), np.array([0.0, 2.0**-50]))
    array([0., 0.])
    """

    def __init__(self, M: Matrix, slices: int = 3) -> None:
        # in units of the diagonal, by powers of 2: nothing is rounded
        diagonal = M.diagonal()
        self._unit = np.exp2(np.floor(0.5 * np.log2(np.where(diagonal > 0, diagonal, 1.0))))
        rest = _scaled(M, 1 / self._unit)
        entries = rest.data if sp.issparse(rest) else rest
        terms = int(np.diff(rest.tocsr().indptr).max()) if sp.issparse(rest) else rest.shape[1]
        self._bits = int((53 - math.ceil(math.log2(terms + 1))) // 2)
        self.share = slices * math.sqrt(len(diagonal)) * 2.0 ** (-self._bits * (slices - 1))
        self._slices = []
        for part in _cut(entries, self._bits, slices):
            one = rest.copy()
            if sp.issparse(one):
                one.data = part
            else:
                one = part
            self._slices.append(one)

    def __call__(self, z: np.ndarray, *more: np.ndarray) -> np.ndarray:
        """M z + the sum of the others."""
        parts = _cut(self._unit * z, self._bits, len(self._slices))
        terms = [entry / self._unit for entry in more]
        tail, rounded = np.zeros_like(z), np.zeros_like(z)
        for M in self._slices:
            tail = parts.pop() + tail  # what the slices before leave of z
            products = (M @ np.array([*parts, tail]).T).T
            terms += list(products[:-1])
            rounded += products[-1]
        return self._unit * _sum([*terms, rounded])


def product_error(factor: float, M: Matrix) -> Any:
    """What rounding keeps out of `factor * M`, entry by entry and exactly (Dekker's product)."""
    rest = M.copy()
    entries = rest.data if sp.issparse(rest) else rest
    high, low = _halves(entries)
    factor_high, factor_low = _halves(np.float64(factor))
    missed = factor_high * high - factor * entries
    missed = ((missed + factor_high * low) + factor_low * high) + factor_low * low
    if sp.issparse(rest):
        rest.data = missed
        return rest
    return missed


def sum_error(A: Matrix, B: Matrix, total: Matrix) -> Any:
    """What rounding keeps out of `total` = A + B, entry by entry and exactly (Knuth's two-sum)."""
    added = total - A
    return (A - (total - added)) + (B - added)


def _halves(x: Any) -> tuple[Any, Any]:
    """x as a sum of two numbers of half its bits (Veltkamp)."""
    shifted = (2.0**27 + 1) * x
    high = shifted - (shifted - x)
    return high, x - high


def _cut(x: np.ndarray, bits: int, slices: int) -> list[np.ndarray]:
    """Slices with x = their sum, each but the last of few bits beside the largest entry."""
    largest = float(np.abs(x).max(initial=0.0))
    parts = []
    for _ in range(slices - 1):
        # adding and taking away a large number rounds to its last bit
        power = math.frexp(largest)[1] + 54 - bits
        shift = math.ldexp(0.75, power) if largest and power < 1024 else 0.0
        part = (x + shift) - shift
        parts.append(part)
        x = x - part
        largest = math.ldexp(largest, -bits) if largest else 0.0
    return [*parts, x]


def _sum(terms: list[np.ndarray]) -> np.ndarray:
    """The sum, with what each addition rounds away (Knuth's two-sum)."""
    total, lost = terms[0], np.zeros_like(terms[0])
    for term in terms[1:]:
        following = total + term
        added = following - total
        lost += (total - (following - added)) + (term - added)
        total = following
    return total + lost


def _scaled(M: Matrix, weights: np.ndarray) -> Any:
    if sp.issparse(M):
        W = sp.diags_array(weights)
        return sp.csr_array(W @ M @ W)
    return weights[:, None] * M * weights
