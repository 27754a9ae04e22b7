"""What is known of each step of a run, in 30 bytes: columns are made when they are asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

STATS = np.dtype(
    [
        ("t", float),
        ("seconds", float),
        ("iterations", int),
        ("attempts", int),
        ("certificate", float),
        ("relative", float),
        ("solver", "U20"),
    ]
)
WRITTEN = {  # in the order of a step's summary
    "iterations": np.int32,
    "attempts": np.int32,
    "certificate": np.float64,
    "relative": np.float64,
}


@dataclass(frozen=True, eq=False)
class Statistics:
    """A table of one row a step that is used as a structured array of dtype STATS.

    A name gives a column, anything else rows of such an array, `numpy.asarray` all of it.

    Attributes
    ----------
    columns : mapping of ndarray, shape (n,)
        As they are kept; that of the solvers holds numbers of `solvers`.
    solvers : tuple of str
    """

    columns: Mapping[str, np.ndarray]
    solvers: tuple[str, ...]

    dtype = STATS

    def __len__(self) -> int:
        return len(self.columns["t"])

    @property
    def shape(self) -> tuple[int]:
        """(n,), as that of the array."""
        return (len(self),)

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, str) and key in self.columns:
            return self._column(key, slice(None))
        if isinstance(key, (str, list)):
            return self.copy()[key]
        return self._rows(key)

    def __iter__(self) -> Iterator[Any]:
        return iter(self.copy())

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return self.copy() if dtype is None else self.copy().astype(dtype)

    def copy(self) -> np.ndarray:
        """All of it as an array, shape (n,)."""
        return self._rows(slice(None))

    def _rows(self, key: Any) -> Any:
        rows = np.zeros(self.columns["t"][key].shape, dtype=STATS)
        for name in self.columns:
            rows[name] = self._column(name, key)
        return rows[()]

    def _column(self, name: str, key: Any) -> np.ndarray:
        column = self.columns[name][key]
        if name == "solver":
            return np.array([*self.solvers, ""], dtype=STATS[name])[column]
        return column.astype(STATS[name])


class Log:
    """The statistics of each step, a column each: rows of records are slow to write."""

    def __init__(self, steps: int) -> None:
        # written to, all of it is in memory from here on: a run grows by nothing later
        self._columns = {name: np.full(steps, 0, kind) for name, kind in WRITTEN.items()}
        self._seconds = np.full(steps, 0, dtype=np.float32)
        self._solver = np.full(steps, 0, dtype=np.int16)
        self._names: dict[str, int] = {}
        self._write = list(self._columns.values())

    def add(self, i: int, step: tuple[Any, ...], seconds: float) -> None:
        """Write a step's `Summary`, whose last entry is the solver."""
        for column, value in zip(self._write, step, strict=False):
            column[i] = value
        self._seconds[i] = seconds
        self._solver[i] = self._names.setdefault(step[-1], len(self._names))

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """All columns; those of the solvers are numbers of `solvers`."""
        return {**self._columns, "seconds": self._seconds, "solver": self._solver}

    @property
    def solvers(self) -> list[str]:
        """Who found the velocities, in order of appearance."""
        return list(self._names)

    def restore(self, columns: Mapping[str, np.ndarray], solvers: list[str]) -> None:
        """Take the columns of the first steps from an earlier run."""
        for name, column in self.columns.items():
            column[: len(columns[name])] = columns[name]
        self._names = {name: number for number, name in enumerate(solvers)}

    def table(self, ends: np.ndarray, beside: float) -> Statistics:
        """The steps that end at the given times, with the seconds that each took beside."""
        n = len(ends)
        self._seconds[:n] += np.float32(beside)
        columns = {name: column[:n] for name, column in self.columns.items()}
        return Statistics({"t": ends, **columns}, tuple(self.solvers))
