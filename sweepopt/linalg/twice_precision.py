"""M z + q rounded once: where M is badly conditioned, M z cancels to less than its own rounding.

M and z are cut into slices of few bits (Ozaki, Ogita, Oishi, Rump, Numer. Algorithms 59, 2012): the
products of slices are exact in double precision, and their sum is taken with its rounding errors.
"""

import math
from typing import Any

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Array, Matrix

SLICES = 3  # of about 23 bits: more than twice the 53 of double precision, less what sums need


class Precise:
    """Products with a symmetric positive semidefinite matrix in more than twice the precision.

    Of the three slices the last one is all that is left; its products are rounded, the others are
    exact and summed with their rounding errors.

    Parameters
    ----------
    M : ndarray or sparse, shape (dim, dim)
        Rows with a zero on the diagonal are zero.

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

    def __init__(self, M: Matrix) -> None:
        is_sparse, M = sp.issparse(M), sp.csr_array(M)
        # in units of the diagonal, by powers of 2: nothing is rounded
        diagonal = M.diagonal()
        self._unit = np.exp2(np.floor(0.5 * np.log2(np.where(diagonal > 0, diagonal, 1.0))))
        weights = sp.diags_array(1 / self._unit)
        scaled = weights @ M @ weights
        entries_of_a_row = int(np.diff(scaled.indptr).max())
        self._bits = (53 - math.ceil(math.log2(entries_of_a_row + 1))) // 2
        self.share = SLICES * math.sqrt(len(diagonal)) * 2.0 ** (-self._bits * (SLICES - 1))
        matrices = [
            sp.csr_array((part, scaled.indices, scaled.indptr), shape=M.shape)
            for part in (_cut(scaled.data, self._bits) if scaled.nnz else [])
        ]
        # products of dense slices are five times as fast as those of full sparse ones
        self._slices = matrices if is_sparse else [one.toarray() for one in matrices]

    def __call__(self, z: Array, *more: Array) -> Array:
        """M z + the sum of the others."""
        return exact_sum([*self.terms(z), *more])

    def terms(self, z: Array, error: Any = 0.0) -> list[Array]:
        """Vectors whose sum is M (z + error), the error no more than z rounds."""
        if not self._slices:
            return [np.zeros_like(z)]
        parts = _cut(self._unit * z, self._bits)
        terms, rounded, tail = [], np.zeros_like(z), self._unit * error
        for M in self._slices:
            tail = parts.pop() + tail  # what the slices before leave of z
            products = [M @ part for part in (*parts, tail)]
            terms += [self._unit * product for product in products[:-1]]
            rounded += products[-1]
        return [*terms, self._unit * rounded]


def exact_sum(terms: list[Array]) -> Array:
    """The sum, with what each addition rounds away (Knuth's two-sum)."""
    total, remainder = terms[0], np.zeros_like(terms[0])
    for term in terms[1:]:
        following = total + term
        added = following - total
        remainder += (total - (following - added)) + (term - added)
        total = following
    return total + remainder


def product_error(factor: Any, x: Any) -> Any:
    """What rounding keeps out of `factor * x`, entry by entry and exactly (Dekker's product)."""
    if sp.issparse(x):
        error = x.copy()
        error.data = product_error(factor, x.data)
        return error
    high, low = _halves(x)
    factor_high, factor_low = _halves(np.asarray(factor, dtype=float))
    error = factor_high * high - factor * x
    return ((error + factor_high * low) + factor_low * high) + factor_low * low


def _halves(x: Any) -> tuple[Any, Any]:
    """x as a sum of two numbers of half its bits (Veltkamp)."""
    shifted = (2.0**27 + 1) * x
    high = shifted - (shifted - x)
    return high, x - high


def _cut(x: Array, bits: int) -> list[Array]:
    """Slices with x = their sum, each but the last of few bits beside the largest entry."""
    largest = float(np.abs(x).max(initial=0.0))
    parts = []
    for _ in range(SLICES - 1):
        # adding and taking away a large number rounds to its last bit
        power = math.frexp(largest)[1] + 54 - bits
        shift = math.ldexp(0.75, power) if largest and power < 1024 else 0.0
        part = (x + shift) - shift
        parts.append(part)
        x = x - part
        largest = math.ldexp(largest, -bits) if largest else 0.0
    return [*parts, x]
