"""What is known of a run so far: the states that are kept, the statistics of its steps, its end.

The loop over time writes into a `Run`, the checkpoint reads and restores it, the solution is made
of it. `saving` reads what the user wants to keep.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from sweepopt.checks import TIME_SLACK, axes, vector
from sweepopt.errors import InputError, Status, shown
from sweepopt.io import writable

if TYPE_CHECKING:
    from sweepopt.integrate.exact import Trajectory

MEMORY = 4e9
"""Bytes that the kept states may take."""

Index = Any  # int, slice or array of ints


# ---- states -------------------------------------------------------------------------------------


class States(Protocol):
    """States and velocities of the kept steps, by their number."""

    def u(self, i: Index) -> np.ndarray:
        """The states at the kept nodes i; node 0 is the start."""
        ...

    def velocity(self, i: Index) -> np.ndarray:
        """The velocities of the kept steps i; step i ends at node i + 1."""
        ...


@dataclass(frozen=True, eq=False)
class StatesInMemory:
    """States of shape (k + 1, dim) and velocities of shape (k, dim)."""

    nodes: np.ndarray
    velocities: np.ndarray

    def u(self, i: Index) -> np.ndarray:
        return self.nodes[i]

    def velocity(self, i: Index) -> np.ndarray:
        return self.velocities[i]


@dataclass(frozen=True, eq=False)
class ReconstructedStates:
    """States of few unknowns in memory; `reconstruct` gives all of a node or of a step.

    Attributes
    ----------
    few : StatesInMemory
    alpha : callable -> StatesInMemory
        Coefficients of the load at every node and step of the run, computed when asked for.
    steps : ndarray, shape (k,)
        The kept steps, counted in the run.
    reconstruct : callable (few, alpha) -> ndarray, shape (dim,)
    dim : int
        How many unknowns there are in all.
    """

    few: StatesInMemory
    alpha: Callable[[], StatesInMemory]
    steps: np.ndarray
    reconstruct: Callable[[np.ndarray, np.ndarray], np.ndarray]
    dim: int

    def u(self, i: Index) -> np.ndarray:
        return self._all(self.few.nodes[i], self.alpha().nodes[self._nodes[i]])

    def velocity(self, i: Index) -> np.ndarray:
        return self._all(self.few.velocities[i], self.alpha().velocities[self.steps[i]])

    @cached_property
    def _nodes(self) -> np.ndarray:
        return np.append(0, self.steps + 1)

    def _all(self, few: np.ndarray, alpha: np.ndarray) -> np.ndarray:
        every = np.zeros((*few.shape[:-1], self.dim))
        for index in np.ndindex(few.shape[:-1]):
            every[index] = self.reconstruct(few[index], alpha[index])
        return every


# ---- statistics ---------------------------------------------------------------------------------

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
"""A row of `Solution.stats`."""


class Summary(NamedTuple):
    """What the programs of a step have in common: their worst certificate, all their work.

    Attributes
    ----------
    certificate, relative : float
        Bound of the velocity's error, and in units of the program's size; nan without a proof.
    solver : str
        Who answered the last one.
    """

    iterations: int
    attempts: int
    certificate: float
    relative: float
    solver: str


@dataclass(frozen=True, eq=False)
class Statistics:
    """The statistics of n steps.

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
    """The statistics of a run as it goes: a column each takes 30 bytes a step in all."""

    def __init__(self, steps: int) -> None:
        def column(kind: Any) -> np.ndarray:
            # written to, all of it is in memory from here on: a run grows by nothing later
            return np.full(steps, 0, kind)

        # in the order of a `Summary`
        self._numbers = {
            "iterations": column(np.int32),
            "attempts": column(np.int32),
            "certificate": column(float),
            "relative": column(float),
        }
        self._seconds, self._solver = column(np.float32), column(np.int16)
        self._names: dict[str, int] = {}
        self._columns = tuple(self._numbers.values())

    def add(self, i: int, step: Summary, seconds: float) -> None:
        """Write what is known of step i."""
        for column, value in zip(self._columns, step, strict=False):
            column[i] = value
        self._seconds[i] = seconds
        self._solver[i] = self._names.setdefault(step.solver, len(self._names))

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """All columns; that of the solvers holds numbers of `solvers`."""
        return {**self._numbers, "seconds": self._seconds, "solver": self._solver}

    @property
    def solvers(self) -> list[str]:
        """Who found the velocities, in order of appearance."""
        return list(self._names)

    def restore(self, columns: Mapping[str, np.ndarray], solvers: list[str]) -> None:
        """Take the columns of the first steps from an earlier run."""
        for name, column in self.columns.items():
            column[: len(columns[name])] = columns[name]
        self._names = {name: number for number, name in enumerate(solvers)}

    def statistics(self, ends: np.ndarray, beside: float) -> Statistics:
        """Those of the steps with these end times; each took so many seconds beside the loop."""
        n = len(ends)
        self._seconds[:n] += np.float32(beside)
        columns = {name: column[:n] for name, column in self.columns.items()}
        return Statistics({"t": ends, **columns}, tuple(self.solvers))


# ---- the run ------------------------------------------------------------------------------------


class KeptStates(NamedTuple):
    """The kept steps, counted in the run, and their states."""

    steps: np.ndarray
    states: StatesInMemory


class Run:
    """A run as far as it has come.

    Parameters
    ----------
    steps : int
        Of the grid.
    kept : ndarray of int
        The steps whose end is kept; the last step that is done always is.
    u0 : ndarray, shape (dim,)

    Attributes
    ----------
    log : Log
    status : Status
    cause : str
        Which step failed and why.
    relative : float
        The certificate of the step that failed.
    overshot : int or None
        The first step that may have overshot.
    exact : Trajectory or None
        The dense trajectory of the scheme "exact".
    """

    def __init__(self, steps: int, kept: np.ndarray, u0: np.ndarray) -> None:
        self.log = Log(steps)
        self.status, self.cause, self.relative = Status.SUCCESS, "", 0.0
        self.overshot: int | None = None
        self.exact: Trajectory | None = None
        self._kept = kept
        self._nodes = np.zeros((kept.size + 1, u0.size))
        self._velocities = np.zeros((kept.size, u0.size))
        self._nodes[0] = u0
        # steps that are done, the state and the velocity of the last one: one assignment, so that
        # Ctrl-C finds them of the same step
        self._last = 0, u0, np.zeros(u0.size)
        self._go_on(0)

    @property
    def done(self) -> int:
        """How many steps are done."""
        return self._last[0]

    def add(self, u: np.ndarray, velocity: np.ndarray, step: Summary, seconds: float) -> None:
        """Take the next step: the state at its end, its velocity, what is known of it."""
        self.log.add(self._last[0], step, seconds)
        self.add_state(u, velocity)

    def add_state(self, u: np.ndarray, velocity: np.ndarray) -> None:
        """Take the state and velocity of the next step, which is in the log already."""
        i, row = self._last[0], self._row
        if i == self._next:
            self._nodes[row + 1], self._velocities[row] = u, velocity
        self._last = i + 1, u, velocity
        if i == self._next:
            self._go_on(row + 1)

    def _go_on(self, row: int) -> None:
        """Wait for the step that is kept next, in this row."""
        self._row = row
        self._next = int(self._kept[row]) if row < self._kept.size else -1

    def kept(self) -> KeptStates:
        """The kept ones of the steps that are done, and the last one."""
        done, u, velocity = self._last
        k = int(np.searchsorted(self._kept, done))
        steps = self._kept[:k]
        if done and done - 1 not in steps[-1:]:
            steps = np.append(steps, done - 1)
            self._nodes[k + 1], self._velocities[k] = u, velocity
            k += 1
        return KeptStates(steps, StatesInMemory(self._nodes[: k + 1], self._velocities[:k]))

    def arrays(self) -> dict[str, np.ndarray]:
        """All that `restore` needs in arrays."""
        done, u, velocity = self._last
        k = int(np.searchsorted(self._kept, done))
        arrays = {f"log.{name}": column[:done] for name, column in self.log.columns.items()}
        arrays |= {"nodes": self._nodes[: k + 1], "velocities": self._velocities[:k]}
        return {**arrays, "u": u, "velocity": velocity}

    def restore(self, done: int, arrays: Mapping[str, np.ndarray], solvers: list[str]) -> None:
        """Take the first steps from `arrays` of an earlier run."""
        columns = {name: arrays[f"log.{name}"] for name in self.log.columns}
        self.log.restore(columns, solvers)
        k = int(np.searchsorted(self._kept, done))
        self._nodes[: k + 1], self._velocities[:k] = arrays["nodes"], arrays["velocities"]
        self._last = done, arrays["u"], arrays["velocity"]
        self._go_on(k)


# ---- what is kept -------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Saving:
    """What `save=` asks for, checked.

    Attributes
    ----------
    steps : ndarray of int
        The steps whose end is kept in memory; the last step that is done always is.
    function : callable or None
        (t, u, z) -> anything, recorded for every step.
    path : Path or None
        A NetCDF file for the states of all steps.
    """

    steps: np.ndarray
    function: Callable[[float, np.ndarray, np.ndarray], Any] | None = None
    path: Path | None = None


def saving(save: Any, times: np.ndarray, dim: int, memory: float) -> Saving:
    """Read the argument `save` of solve for a run over `times`.

    Parameters
    ----------
    dim : int
        Unknowns of a state as it is kept in memory.
    memory : float
        Bytes that the kept states may take.

    Raises
    ------
    InputError
        If save is none of what it may be, or the states do not fit.
    """
    n = len(times) - 1
    last = np.array([n - 1])
    if save is None:
        chosen = Saving(np.arange(n))
    elif isinstance(save, str) and save == "last":
        chosen = Saving(last)
    elif isinstance(save, (str, PathLike)):
        if Path(save).suffix != ".nc":
            raise InputError(f"save is {shown(str(save))}; a file must end with .nc, or say 'last'")
        chosen = Saving(last, path=writable("save", save))
    elif callable(save):
        chosen = Saving(last, function=save)
    elif isinstance(save, (int, np.integer)) and not isinstance(save, bool):
        if save < 1:
            raise InputError(f"save is {save}; a stride must be positive")
        chosen = Saving(np.union1d(np.arange(min(save, n) - 1, n, min(save, n)), last))
    elif isinstance(save, Iterable) and axes(save):
        chosen = Saving(np.union1d(_steps_ending_at(vector("save", save), times), last))
    else:
        raise InputError(
            f"save must be None, 'last', a stride, times, a function of (t, u, z) or the name of "
            f"an .nc file; got {shown(save)}"
        )
    size = 8.0 * dim * (2 * chosen.steps.size + 1)
    if size > memory:
        raise InputError(
            f"steps: keeping {chosen.steps.size} states and velocities of {dim} unknowns takes "
            f"{size / 1e9:.3g} GB, more than memory = {memory / 1e9:.3g} GB; pass save='last', "
            "save=k for every k-th step, save=[times], save=f(t, u, z) or save='run.nc', or a "
            "larger memory"
        )
    return chosen


def _steps_ending_at(saved: np.ndarray, times: np.ndarray) -> np.ndarray:
    """The steps that end at the times to be saved; the start always is."""
    after = np.clip(np.searchsorted(times, saved), 1, len(times) - 1)
    nearest = after - (saved - times[after - 1] < times[after] - saved)
    away = np.abs(times[nearest] - saved) > TIME_SLACK * np.abs(times).max()
    if away.any():
        raise InputError(
            f"save asks for t = {saved[away][0]:g}, which is not on the time grid; choose steps "
            "so that it is, or keep all steps and interpolate"
        )
    return np.unique(nearest[nearest > 0] - 1)
