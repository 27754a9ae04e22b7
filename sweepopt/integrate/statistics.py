"""What is known of each step of a run, in 30 bytes; the table of it is made when asked for."""

from __future__ import annotations

from collections.abc import Mapping
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
    """What is kept of n steps.

    Attributes
    ----------
    columns : mapping of ndarray, shape (n,)
        That of the solvers holds numbers of `solvers`.
    solvers : tuple of str
    """

    columns: Mapping[str, np.ndarray]
    solvers: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.columns["t"])

    def table(self) -> np.ndarray:
        """A structured array of dtype STATS, shape (n,)."""
        rows = np.zeros(len(self), dtype=STATS)
        for name in self.columns.keys() - {"solver"}:
            rows[name] = self.columns[name]
        names = np.array([*self.solvers, ""], dtype=STATS["solver"])
        rows["solver"] = names[self.columns["solver"]]
        return rows


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

    def of(self, ends: np.ndarray, beside: float) -> Statistics:
        """The steps that end at the given times, with the seconds that each took beside."""
        n = len(ends)
        self._seconds[:n] += np.float32(beside)
        columns = {name: column[:n] for name, column in self.columns.items()}
        return Statistics({"t": ends, **columns}, tuple(self.solvers))
