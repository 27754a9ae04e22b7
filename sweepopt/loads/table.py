"""Histories given by measured points, and the lines between them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sweepopt.checks import (
    TIME_SLACK,
    at_path,
    axes,
    entries,
    increasing,
    matrix,
    number,
    with_checks,
)
from sweepopt.display import Brief, record
from sweepopt.errors import InputError
from sweepopt.io import read_columns
from sweepopt.loads.history import Array, History, as_times, interval


@record
class Table(Brief, History):
    """Piecewise linear history through measured points.

    Parameters
    ----------
    times : array_like, shape (m,)
        Strictly increasing; nothing is said, hence nothing answered, outside them.
    values : array_like, shape (m,)

    Raises
    ------
    InputError
        If the times do not increase, or a number is missing or not finite; when called, if a time
        is outside of the table.

    Examples
    --------
    >>> force = Table([0.0, 1.0, 3.0], [0.0, 2.0, 1.0])
    >>> force([0.5, 2.0]), force.variation(0.5, 2.0)
    (array([1. , 1.5]), 1.5)
    """

    times: Array
    values: Array

    def __init__(self, times: ArrayLike, values: ArrayLike) -> None:
        points = check_points("times", times, values)
        object.__setattr__(self, "times", points[0])
        object.__setattr__(self, "values", points[1])

    @classmethod
    @with_checks
    def from_csv(
        cls, path: str | Path, column: str, *, time: str | None = None, scale: float = 1.0
    ) -> Table:
        """Read two columns of a CSV file.

        Parameters
        ----------
        path : str or Path
            First line that is neither empty nor a ``#`` comment: the column names.
        column : str
            Name of the column of values.
        time : str, optional
            Name of the column of times; without it "t" or "time", else the first
            column that is another one.
        scale : float
            Factor on the values, e.g. 1e3 for kPa to Pa.

        Raises
        ------
        InputError
            Naming the file, the column and the row (line of the file) at fault.
        """
        factor = number("scale", scale)
        (times, values), rows = read_columns(path, time, column)
        with at_path(f"{path}: "):
            check_points("times", times, values, rows)
            return cls(times, factor * values)

    def __call__(self, t: ArrayLike) -> Any:
        at = self._inside(t)
        value = np.interp(at, self.times, self.values)
        return float(value) if type(at) is float else value

    def _inside(self, t: ArrayLike) -> Any:
        """The times as floats, none of them outside."""
        at = as_times(t)
        first, last = self.times[0], self.times[-1]
        slack = TIME_SLACK * max(abs(first), abs(last))
        outside = (at < first - slack) | (at > last + slack)
        if np.any(outside):
            raise InputError(
                f"t = {np.asarray(at)[outside].flat[0]:.12g} lies outside the table, which covers "
                f"[{first:.12g}, {last:.12g}]; extend the table, or let the run lie within it, "
                f"t_end = {last:.12g}"
            )
        return at

    def slope(self, t: Any) -> Any:
        """phi' at times that are no breakpoints."""
        k = np.clip(np.searchsorted(self.times, self._inside(t)) - 1, 0, self.times.size - 2)
        return (self.values[k + 1] - self.values[k]) / (self.times[k + 1] - self.times[k])

    def breakpoints(self, a: float, b: float) -> Array:
        """The table's times strictly inside (a, b)."""
        a, b = interval(a, b)
        first = np.searchsorted(self.times, a, side="right")
        return self.times[first : np.searchsorted(self.times, b)]

    def turning_points(self, a: float, b: float) -> Array:
        """Those of its times where an entry turns, or begins or ends to rest."""
        slopes = np.sign(np.diff(self.values, axis=0))
        change = slopes[1:] != slopes[:-1]
        turns = change.any(axis=tuple(range(1, change.ndim)))
        return np.intersect1d(self.breakpoints(a, b), self.times[1:-1][turns])


class VectorTable(Table):
    """Piecewise linear load f(t) in R^dim through given vectors; an evaluation costs O(dim).

    Parameters
    ----------
    times : array_like, shape (m,)
        Strictly increasing; nothing is said, hence nothing answered, outside them.
    values : array_like, shape (m, dim)

    Attributes
    ----------
    dim : int

    Raises
    ------
    InputError
        As of `Table`, and if the values have not one row for each time.

    Examples
    --------
    >>> f = VectorTable([0.0, 1.0, 3.0], [[0.0, 0.0], [2.0, 0.0], [2.0, 4.0]])
    >>> f(2.0), f.variation(0.5, 3.0)
    (array([2., 2.]), 5.0)
    """

    def __init__(self, times: ArrayLike, values: ArrayLike) -> None:
        rows = matrix("values", values)
        t, _ = check_points("times", times, rows[:, 0] if rows.size else ())
        object.__setattr__(self, "times", t)
        object.__setattr__(self, "values", rows)

    @property
    def dim(self) -> int:
        """Entries of f(t)."""
        return self.values.shape[1]

    @property
    def terms(self) -> tuple[tuple[Table, Array], ...]:
        """A table and a direction for each entry, as those of `Separable`."""
        one = np.eye(self.dim)
        return tuple((Table(self.times, phi), one[k]) for k, phi in enumerate(self.values.T))

    def __call__(self, t: ArrayLike) -> Any:
        """f(t), shape (dim,) of a number and (k, dim) of k times."""
        at = self._inside(t)
        i = np.clip(np.searchsorted(self.times, at, side="right") - 1, 0, self.times.size - 2)
        share = np.clip((at - self.times[i]) / (self.times[i + 1] - self.times[i]), 0.0, 1.0)
        share = np.asarray(share)[..., None]
        return (1 - share) * self.values[i] + share * self.values[i + 1]

    def variation(self, a: float, b: float, norm: Callable[[Array], Any] | None = None) -> float:
        """Exact total variation on [a, b], Euclidean unless `norm` of forces is given."""
        a, b = interval(a, b)
        values = self(np.concatenate([[a], self.breakpoints(a, b), [b]]))
        return float(sum(map(norm or np.linalg.norm, np.diff(values, axis=0))))


def check_points(
    name: str, times: ArrayLike, values: ArrayLike, rows: Sequence[int] = ()
) -> tuple[Array, Array]:
    """The points of a table as read-only vectors.

    Errors call its times by `name`, and points by their rows in a file if these are given.
    """
    if axes(values) == 2:
        raise InputError(
            f"values must have one axis, got shape {np.shape(values)}; rows of vectors are "
            "so.VectorTable(times, values)"
        )
    sort = "; sort the table, and leave a small gap at a jump, such as 1e-13 of the largest time"
    t, phi = increasing(name, times, sort, rows), entries("values", values)
    if phi.shape != t.shape:
        raise InputError(f"values has {phi.size} entries, {name} has {t.size}; give one each")
    return t, phi
