"""What is kept of a run: some states and velocities, one row of statistics a step, how it ended.

The loop over time writes into a `Run`, the checkpoint stores and restores its arrays, the solution
is made of it. `saving` reads what the user wants to keep.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sweepopt.checks import TIME_SLACK, Array, axes, takes, vector
from sweepopt.display import by_parts
from sweepopt.errors import InputError, Status, shown
from sweepopt.io import writable

if TYPE_CHECKING:
    from sweepopt.integrate.exact import Trajectory
    from sweepopt.velocity import Plan, Velocity

Index = Any  # int, slice or array of ints
SaveFunction = Callable[[float, Array, Array], Any]


class States(NamedTuple):
    """States and velocities of the kept steps by their number, wherever they are.

    Attributes
    ----------
    steps : ndarray of int, shape (k,)
        The kept steps, counted in the run.
    u : callable
        The states at the kept nodes i; node 0 is the start.
    velocity : callable
        The velocities of the kept steps i; step i ends at node i + 1.
    """

    steps: Array
    u: Callable[[Index], Array]
    velocity: Callable[[Index], Array]


COLUMNS = ["t", "seconds", "iterations", "attempts", "certificate", "relative", "solver"]
ROW = np.dtype({"names": COLUMNS, "formats": ["f8", "f4", "i4", "i4", "f8", "f8", "i2"]})
"""A step's statistics in 38 bytes; t is its end, the solver the number of its name."""


class StepTable(np.ndarray):
    """`Solution.stats`: a structured array that shows few of its rows, and says which columns."""

    def __getitem__(self, key: Any) -> Any:
        names = self.dtype.names or ()
        if isinstance(key, str) and key not in names:
            raise InputError(f"stats has no column {key!r}; there are: {', '.join(names)}")
        value = super().__getitem__(key)
        return np.asarray(value) if isinstance(key, str) else value

    def __repr__(self) -> str:
        plain = np.asarray(self)
        if self.ndim != 1 or not self.dtype.names:
            return repr(plain)
        rows = np.array2string(plain, threshold=6)
        return f"{len(self)} steps: {', '.join(self.dtype.names)}\n{rows}"

    __str__ = __repr__


class Statistics(NamedTuple):
    """The statistics of n steps: rows of type ROW, names of solvers."""

    rows: Array
    solvers: tuple[str, ...]

    def table(self) -> StepTable:
        """With full numbers and the names themselves, shape (n,)."""
        names = np.array([*self.solvers, ""])
        kinds = [int if ROW[name].kind == "i" else float for name in COLUMNS[:-1]]
        table = self.rows.astype({"names": COLUMNS, "formats": [*kinds, names.dtype]})
        table["solver"] = names[self.rows["solver"]]
        return table.view(StepTable)


class Saving(NamedTuple):
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

    steps: Array
    function: SaveFunction | None = None
    path: Path | None = None


class Pass(NamedTuple):
    """One pass of adaptive steps over the run.

    Attributes
    ----------
    steps : int
    error : float
        Estimate of max_i |u_i - u(t_i)|_A, |.|_B where A = 0, from the difference to the pass
        before; nan of the first pass and of one that was stopped.
    seconds : float
        Of its steps.
    """

    steps: int
    error: float
    seconds: float


class StepInfo(NamedTuple):
    """What a callback sees after a step.

    Attributes
    ----------
    step : int
        Its index.
    t : float
        Its end.
    u : ndarray, shape (dim,)
        The state at t.
    velocity : ndarray, shape (dim,)
    certificate : float
        As in `Solution.stats`: the worst of the programs that the step solved.
    """

    step: int
    t: float
    u: Array
    velocity: Array
    certificate: float

    def __repr__(self) -> str:
        return by_parts(self)


Callback = Callable[[StepInfo], "bool | None"]


class Step(NamedTuple):
    """A step, whole or in parts.

    Attributes
    ----------
    velocity : Velocity
        The mean velocity with the worst certificate of the programs and all their work. In parts
        that is no bound of the error of one whole step, which nobody knows.
    cause : str
        Why the step cannot be taken in parts at all.
    end : ndarray or None
        The state at its end, where that is not a sum.
    """

    velocity: Velocity
    cause: str = ""
    end: Array | None = None


class Run:
    """A run as far as it has come.

    Parameters
    ----------
    times : ndarray, shape (n+1,)
    mus : ndarray, shape (n,)
        The steps between them.
    plan : Plan
    saving : Saving
    u0 : ndarray, shape (dim,)
        Of the unknowns that enter the steps.

    Attributes
    ----------
    recorded : list
        What the function of `saving` returned for each step.
    status : Status
    cause : str
        Which step failed and why.
    relative : float
        The certificate of the step that failed.
    exact : Trajectory or None
        The dense trajectory of the scheme "exact".
    """

    def __init__(self, times: Array, mus: Array, plan: Plan, saving: Saving, u0: Array) -> None:
        self.times, self.mus, self.plan, self.saving = times, mus, plan, saving
        self.recorded: list[Any] = []
        self.status, self.cause, self.relative = Status.SUCCESS, "", 0.0
        self.exact: Trajectory | None = None
        # of the progress bar, to a share of the time in steps: phases are parts of them
        self.advance: Callable[[float], Any] | None = None
        # written to, all of it is in memory from here on: a run grows by nothing later
        self._rows, self._ends = np.full(len(mus), 0, ROW), times.data  # gives floats of Python
        self._solvers: dict[str, int] = {}
        self._nodes = np.zeros((self.saving.steps.size + 1, u0.size))
        self._velocities = np.zeros((self.saving.steps.size, u0.size))
        self._nodes[0] = u0
        # steps that are done and kept, the last state, velocity and compensation of its sum: one
        # assignment, so that Ctrl-C finds them of the same step
        self._last = 0, 0, u0, np.zeros(u0.size), np.zeros(u0.size)

    @property
    def steps(self) -> int:
        """How many there are in the grid."""
        return len(self._rows)

    @property
    def done(self) -> int:
        """How many steps are done."""
        return self._last[0]

    @property
    def u(self) -> Array:
        """The last state."""
        return self._last[2]

    @property
    def compensation(self) -> Array:
        """What rounding has kept out of the last state (`compensated_sum`)."""
        return self._last[4]

    def add(self, u: Array, velocity: Velocity, seconds: float, compensation: Any = 0.0) -> None:
        """Take the next step: the state at its end, its mean velocity with what is known of it."""
        i, k, *_ = self._last
        z, certificate, relative, solver, iterations, attempts, *_ = velocity
        number = self._solvers.setdefault(solver, len(self._solvers))
        self._rows[i] = (
            self._ends[i + 1],
            seconds,
            iterations,
            attempts,
            certificate,
            relative,
            number,
        )
        if i == self.saving.steps[k]:
            self._nodes[k + 1], self._velocities[k] = u, z
            k += 1
        self._last = i + 1, k, u, z, compensation

    def states(self) -> States:
        """The kept ones of the steps that are done, and the last one."""
        done, k, u, velocity, _ = self._last
        steps = self.saving.steps[:k]
        if done and done - 1 not in steps[-1:]:
            steps = np.append(steps, done - 1)
            self._nodes[k + 1], self._velocities[k] = u, velocity
        nodes, velocities = self._nodes[: len(steps) + 1], self._velocities[: len(steps)]
        return States(steps, nodes.__getitem__, velocities.__getitem__)

    def statistics(self) -> Statistics:
        """Those of the steps that are done."""
        return Statistics(self._rows[: self.done], tuple(self._solvers))

    def divided(self) -> str:
        """A sentence that says how many steps missed tol whole and met it in equal parts.

        No step is meant that a breakpoint of the load divides, and "" is said of none.
        """
        parts = [name.rpartition("/")[2].isdigit() for name in self._solvers]  # "osqp/4"
        in_parts = np.array(parts, dtype=bool)[self._rows["solver"][: self.done]]
        planned = np.searchsorted(self.times, self.plan.breakpoints) - 1
        steps = np.setdiff1d(np.flatnonzero(in_parts), planned).size
        if not steps:
            return ""
        return f"{steps} step{'s' * (steps > 1)} missed tol as a whole and met it in equal parts."

    def store(self) -> tuple[dict[str, Any], dict[str, Array]]:
        """All that `restore` needs, in terms of JSON and in arrays."""
        done, k, *last = self._last
        plain = {
            "done": done,
            "steps": self.steps,
            "status": self.status.name,
            "solvers": list(self._solvers),
        }
        return plain, {
            "rows": self._rows[:done],
            "nodes": self._nodes[: k + 1],
            "velocities": self._velocities[:k],
            "last": np.array(last),
        }

    def restore(self, plain: Mapping[str, Any], arrays: Mapping[str, Array]) -> None:
        """Take the first steps from what an earlier run has stored."""
        self.status = Status[plain["status"]]
        self._solvers = {name: number for number, name in enumerate(plain["solvers"])}
        done, k = plain["done"], len(arrays["velocities"])
        self._rows[:done] = arrays["rows"]
        self._nodes[: k + 1], self._velocities[:k] = arrays["nodes"], arrays["velocities"]
        u, velocity, compensation = arrays["last"]
        self._last = done, k, u, velocity, compensation


# ---- what is kept -------------------------------------------------------------------------------


def saving(save: Any, times: Array, dim: int, memory: float) -> Saving:
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
    n, path = len(times) - 1, None
    kept: Any = []
    if save is None:
        kept = np.arange(n)
    elif isinstance(save, (str, PathLike)):
        if save != "last" and Path(save).suffix != ".nc":
            raise InputError(f"save is {shown(str(save))}; a file must end with .nc, or say 'last'")
        path = None if save == "last" else writable("save", save)
    elif isinstance(save, (int, np.integer)) and not isinstance(save, bool):
        if save < 1:
            raise InputError(f"save is {save}; a stride must be positive")
        kept = range(int(save) - 1, n, int(save))
    elif callable(save):
        takes("save", save, "t", "u", "z")
    elif isinstance(save, Iterable) and axes(save):
        kept = _steps_ending_at(vector("save", save), times)
    else:
        raise InputError(
            f"save must be None, 'last', a stride, times, a function of (t, u, z) or the name of "
            f"an .nc file; got {shown(save)}"
        )
    steps = np.union1d(np.array(kept, dtype=int), n - 1)  # the last one always
    size = 8.0 * dim * (2 * steps.size + 1)
    if size > memory:
        raise InputError(
            f"steps: keeping {steps.size} states and velocities of {dim} unknowns takes "
            f"{size / 1e9:.3g} GB, more than memory = {memory / 1e9:.3g} GB; pass save='last', "
            "save=k for every k-th step, save=[times], save=f(t, u, z) or save='run.nc', or a "
            "larger memory (passes of Adaptive and error= keep all states: ask for less accuracy)"
        )
    return Saving(steps, save if callable(save) else None, path)


def _steps_ending_at(saved: Array, times: Array) -> Array:
    """The steps that end at the times to be saved; the start always is."""
    after = np.clip(np.searchsorted(times, saved), 1, len(times) - 1)
    nearest = after - (saved - times[after - 1] < times[after] - saved)
    away = np.abs(times[nearest] - saved) > TIME_SLACK * np.abs(times).max()
    if away.any():
        raise InputError(
            f"save asks for t = {saved[away][0]:g}, which is not on the time grid; choose steps "
            "so that it is, or keep all steps and interpolate"
        )
    return nearest[nearest > 0] - 1
