"""Matrices of images, column by column: what they select, and in which units."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Matrix
from sweepopt.sets.base import binary
from sweepopt.sets.shapes import Box


def selected(M: Matrix) -> np.ndarray | None:
    """The rows that M picks, if its columns are distinct unit vectors."""
    entries = sp.coo_array(M)
    entries.eliminate_zeros()
    rows = np.zeros(M.shape[1], dtype=int)
    rows[entries.col] = entries.row
    if entries.nnz != M.shape[1] or not (entries.data == 1).all():
        return None
    distinct = np.unique(entries.col).size == np.unique(entries.row).size == entries.nnz
    return rows if distinct else None


def column_sizes(M: Matrix) -> list[float]:
    """The largest entry of each column, its sign apart."""
    largest = abs(M).max(axis=0)
    found: list[float] = (largest.toarray() if sp.issparse(M) else largest).tolist()
    return found


def with_own_columns(M: Matrix, box: Box) -> tuple[Matrix, Box]:
    """The same set with columns of numbers near 1: their units, powers of two, go to the box."""
    units = np.array([binary(size) for size in column_sizes(M)])
    if (units == 1).all():
        return M, box
    columns = M @ sp.diags_array(1 / units, format="csc") if sp.issparse(M) else M / units
    return columns, Box(units * box.lower, units * box.upper)


def gathered(M: Matrix, box: Box) -> tuple[Matrix, Box] | None:
    """M and a box with intervals on one unknown added up, those on none left out.

    For an M whose columns are unit vectors or zero; None if there is nothing to gather. A contact
    node that is named twice is one with the sum of its bounds.
    """
    entries = sp.coo_array(M)
    entries.eliminate_zeros()
    if np.unique(entries.col).size < entries.nnz or not (entries.data == 1).all():
        return None
    rows, place = np.unique(entries.row, return_inverse=True)
    if not rows.size or rows.size == M.shape[1]:
        return None
    lower, upper = np.zeros((2, rows.size))
    np.add.at(lower, place, box.lower[entries.col])
    np.add.at(upper, place, box.upper[entries.col])
    unit = (np.ones(rows.size), (rows, np.arange(rows.size)))
    E = sp.csc_array(unit, shape=(M.shape[0], rows.size))
    return (E if sp.issparse(M) else E.toarray()), Box(lower, upper)
