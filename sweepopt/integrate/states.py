"""What is kept of a run: which steps, where they go, and how they come back."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from sweepopt.checks import TIME_SLACK, axes, vector
from sweepopt.errors import InputError, shown
from sweepopt.io import writable

MEMORY = 4e9
"""Bytes that the kept states may take."""

Index = Any  # int, slice or array of ints


class States(Protocol):
    """States and velocities of the kept steps, by their number."""

    def u(self, i: Index) -> np.ndarray:
        """The states at the kept nodes i; node 0 is the start."""
        ...

    def velocity(self, i: Index) -> np.ndarray:
        """The velocities of the kept steps i; step i ends at node i + 1."""
        ...


@dataclass(frozen=True, eq=False)
class Kept:
    """States in memory, shapes (k + 1, dim) and (k, dim)."""

    nodes: np.ndarray
    velocities: np.ndarray

    def u(self, i: Index) -> np.ndarray:
        return self.nodes[i]

    def velocity(self, i: Index) -> np.ndarray:
        return self.velocities[i]


@dataclass(frozen=True, eq=False)
class Lifted:
    """States of few unknowns in memory; `lift` gives all unknowns of a node or of a step.

    Attributes
    ----------
    few : Kept
    alpha : callable -> Kept
        Coefficients of the load at every node and step of the run, computed when asked for.
    steps : ndarray, shape (k,)
        The kept steps, counted in the run.
    lift : callable (few, alpha) -> ndarray, shape (dim,)
    dim : int
        How many unknowns there are in all.
    """

    few: Kept
    alpha: Callable[[], Kept]
    steps: np.ndarray
    lift: Callable[[np.ndarray, np.ndarray], np.ndarray]
    dim: int

    def u(self, i: Index) -> np.ndarray:
        return self._lift(self.few.nodes[i], self.alpha().nodes[self._nodes[i]])

    def velocity(self, i: Index) -> np.ndarray:
        return self._lift(self.few.velocities[i], self.alpha().velocities[self.steps[i]])

    @cached_property
    def _nodes(self) -> np.ndarray:
        return np.append(0, self.steps + 1)

    def _lift(self, few: np.ndarray, alpha: np.ndarray) -> np.ndarray:
        lifted = np.zeros((*few.shape[:-1], self.dim))
        for index in np.ndindex(few.shape[:-1]):
            lifted[index] = self.lift(few[index], alpha[index])
        return lifted


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


def _steps_ending_at(wanted: np.ndarray, times: np.ndarray) -> np.ndarray:
    """The steps that end at the wanted times; the start is always kept."""
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    nearest = after - (wanted - times[after - 1] < times[after] - wanted)
    away = np.abs(times[nearest] - wanted) > TIME_SLACK * np.abs(times).max()
    if away.any():
        raise InputError(
            f"save asks for t = {wanted[away][0]:g}, which is not on the time grid; choose steps "
            "so that it is, or keep all steps and interpolate"
        )
    return np.unique(nearest[nearest > 0] - 1)


@dataclass(eq=False)
class Keeper:
    """Takes the states of a run as they come, and keeps those of the wanted steps."""

    steps: np.ndarray
    u0: np.ndarray
    _row: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self._u = np.zeros((self.steps.size + 1, self.u0.size))
        self._z = np.zeros((self.steps.size, self.u0.size))
        self._u[0] = self.u0
        self._next = int(self.steps[0])
        self._last: tuple[int, np.ndarray, np.ndarray] | None = None
        # Ctrl-C may come between a step and its count
        self._before: tuple[int, np.ndarray, np.ndarray] | None = None

    def put(self, i: int, u: np.ndarray, z: np.ndarray) -> None:
        """Take the state after step i and the velocity of the step."""
        self._before = self._last
        if i == self._next:
            self._u[self._row + 1], self._z[self._row] = u, z
            self._row += 1
            self._next = int(self.steps[self._row]) if self._row < self.steps.size else -1
            self._last = None
        else:
            self._last = (i, u, z)

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """What is kept so far; `last` is the step that is kept only if none follows."""
        last = [] if self._last is None else [np.stack(self._last[1:])]
        return {
            "nodes": self._u[: self._row + 1],
            "velocities": self._z[: self._row],
            "last": np.array(last).reshape(-1, 2, self.u0.size),
        }

    def restore(self, done: int, columns: Mapping[str, np.ndarray]) -> None:
        """Take what an earlier run kept of its steps."""
        self._row = int(np.searchsorted(self.steps, done))
        self._u[: self._row + 1], self._z[: self._row] = columns["nodes"], columns["velocities"]
        self._next = int(self.steps[self._row]) if self._row < self.steps.size else -1
        for u, z in columns["last"]:
            self._last = (done - 1, u, z)

    def close(self, done: int) -> tuple[np.ndarray, Kept]:
        """The kept ones of the steps that are done, with the last one, and their states."""
        k = int(np.searchsorted(self.steps, done))
        steps = self.steps[:k]
        for last in (self._last, self._before):
            if last is not None and last[0] == done - 1 and done - 1 not in steps[-1:]:
                steps = np.append(steps, done - 1)
                self._u[k + 1], self._z[k] = last[1:]
                k += 1
        return steps, Kept(self._u[: k + 1], self._z[:k])
