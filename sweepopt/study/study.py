"""A work-precision study: what every combination of problem, scheme, solver and size costs.

    table = run(read_study("accuracy.toml"), "results/accuracy")

One row a combination, failures included, kept as soon as it is finished: run again, it goes on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from sweepopt.checks import count, listed, number
from sweepopt.errors import InputError, brought_by, shown
from sweepopt.integrate import schemes
from sweepopt.study.executors import Serial
from sweepopt.study.ledger import Ledger
from sweepopt.study.measure import THROUGH_CVXPY, Cell, CellRow, blank, failed, run_cell
from sweepopt.study.reference import absent, make_reference
from sweepopt.study.sources import Source, find_source
from sweepopt.velocity import solvers

if TYPE_CHECKING:
    from pandas import DataFrame

Say = Callable[[str], object]
IN_FLIGHT = 64
"""Cells handed to an executor at a time: each carries its reference."""
LOST = ("WorkerDiedError", "KilledWorker")
"""Exceptions, ours and dask's, of a task whose workers died; others end the study."""


@dataclass(frozen=True)
class Study:
    """What shall be compared: the product of its lists.

    Parameters
    ----------
    problems : tuple of str
        Names of `sweepopt.study.problems`, scenes of the library, paths of scene files.
    schemes : tuple of str
    solvers : tuple of str
        Names that `sweepopt.solve` knows, or "cvxpy:NAME" for any solver installed for cvxpy.
    steps : tuple of int
    tols : tuple of float
        Of the solvers.
    repeats : int
        Timed runs of each cell, after one that is not.
    title : str
    folder : str
        Where relative paths of scenes start.

    Raises
    ------
    InputError
        Naming the list and the entry at fault.

    Examples
    --------
    >>> study = Study(("S03", "P09"), ("midpoint", "sdirk2"), ("auto",), (100, 200, 400))
    >>> len(study.cells())
    12
    """

    problems: tuple[str, ...]
    schemes: tuple[str, ...]
    solvers: tuple[str, ...]
    steps: tuple[int, ...]
    tols: tuple[float, ...] = (1e-6,)
    repeats: int = 3
    title: str = ""
    folder: str = "."

    def __post_init__(self) -> None:
        checks: dict[str, Callable[[str, Any], object]] = {
            "problems": _text,
            "schemes": _scheme,
            "solvers": _solver,
            "steps": count,
            "tols": lambda name, value: number(name, value, minimum=0.0, strict=True),
        }
        for name, check in checks.items():
            entries = listed(name, getattr(self, name))
            for k, entry in enumerate(entries):
                check(f"{name}[{k}]", entry)
                if entry in entries[:k]:
                    raise InputError(f"{name}[{k}]: {shown(entry)} is there twice")
            object.__setattr__(self, name, entries)
        count("repeats", self.repeats)
        _text("title", self.title)

    def sources(self) -> list[Source]:
        """The problems, their files read for a digest.

        Raises
        ------
        InputError
            If one is not there.
        """
        found = []
        for k, name in enumerate(self.problems):
            try:
                found.append(find_source(name, self.folder))
            except InputError as error:
                raise InputError(f"problems[{k}]: {error}") from error
            if found[-1].name in (other.name for other in found[:-1]):
                raise InputError(f"problems[{k}]: another one is called {found[-1].name!r} too")
        return found

    def cells(self) -> list[Cell]:
        """All combinations, the problem slowest."""
        parts = self.schemes, self.solvers, self.steps, self.tols
        return [
            Cell(*combination, repeats=self.repeats)
            for combination in product(self.sources(), *parts)
        ]


def run(
    study: Study,
    folder: str | Path,
    *,
    executor: Executor | None = None,
    progress: Say | None = None,
) -> DataFrame:
    """Compute the cells of a study that are not in the folder yet.

    Parameters
    ----------
    study : Study
    folder : str or Path
        Where finished cells are kept, one file each. Killed at any moment, the study goes on from
        there; a file that is not whole is computed again.
    executor : concurrent.futures.Executor, optional
        `Processes(n)`, `dask_executor(client)`, or any other whose tasks run in processes with one
        thread; by default cells are computed here, one after the other. The rows are the same bit
        for bit, times apart.
    progress : callable, optional
        Told what is finished, for example `print`.

    Returns
    -------
    pandas DataFrame
        A row a cell, with the columns of `CellRow`.

    Raises
    ------
    InputError
        If a problem is not there.
    MissingExtraError
        If a package of the extra "study" is missing.
    """
    _require_pandas()
    say = progress or (lambda _: None)
    executor = executor or Serial()
    cells = study.cells()
    ledger = Ledger(Path(folder))
    ledger.describe(asdict(study))
    todo = [cell for cell in cells if ledger.row(cell) is None]
    say(f"{len(cells)} cells, {len(cells) - len(todo)} of them finished before")

    grids = {(cell.problem, cell.steps): cell for cell in todo}
    missing = [cell for cell in grids.values() if ledger.reference(cell) is None]
    references = (Job(cell, (cell.problem, cell.steps)) for cell in missing)
    for k, (cell, found) in enumerate(_computed(executor, make_reference, references), start=1):
        found = absent(str(found)) if isinstance(found, BaseException) else found
        ledger.keep_reference(cell, found)
        say(f"reference {k} of {len(missing)}: {cell.problem.name} {cell.steps} steps")

    jobs = (Job(cell, (cell, ledger.reference(cell))) for cell in todo)
    for k, (cell, found) in enumerate(_computed(executor, run_cell, jobs), start=1):
        row = failed(blank(cell), found) if isinstance(found, BaseException) else found
        ledger.keep(row)
        say(f"{k} of {len(todo)}: {cell}: {row.status}")
    return read_table(study, folder)


def read_table(study: Study, folder: str | Path) -> DataFrame:
    """The finished cells of a study as a table, whether or not there are more to come."""
    _require_pandas()
    import pandas as pd

    ledger = Ledger(Path(folder))
    rows = [row for cell in study.cells() if (row := ledger.row(cell)) is not None]
    return pd.DataFrame(rows, columns=list(CellRow._fields))


class Job(NamedTuple):
    """A cell and the arguments of the function that is computed for it."""

    cell: Cell
    arguments: tuple[Any, ...]


class Done(NamedTuple):
    """A cell and what was found, or the exception of the workers that died of it."""

    cell: Cell
    found: Any


def _computed(
    executor: Executor, function: Callable[..., Any], jobs: Iterable[Job]
) -> Iterator[Done]:
    """Results as they come, a limited number of jobs under way."""
    running: dict[Future[Any], Cell] = {}
    try:
        for job in jobs:
            running[executor.submit(function, *job.arguments)] = job.cell
            yield from _harvest(running, math.inf if len(running) >= IN_FLIGHT else 0.0)
        while running:
            yield from _harvest(running, math.inf)
    finally:
        for future in running:
            future.cancel()


def _harvest(running: dict[Future[Any], Cell], patience: float) -> Iterator[Done]:
    """What is done, waiting for the first one if there is patience."""
    timeout = None if patience == math.inf else patience
    for future in wait(running, timeout, FIRST_COMPLETED).done:
        cell = running.pop(future)
        error = future.exception()
        if error is not None and type(error).__name__ not in LOST:
            raise error
        yield Done(cell, error or future.result())


def _text(name: str, value: Any) -> None:
    if not isinstance(value, str):
        raise InputError(f"{name} must be text, got {shown(value)}")


def _scheme(name: str, value: Any) -> None:
    _known(name, value, ("auto", *schemes.SCHEMES))


def _solver(name: str, value: Any) -> None:
    if not (isinstance(value, str) and value.startswith(THROUGH_CVXPY)):
        _known(name, value, ("auto", *solvers.REGISTRY, f"{THROUGH_CVXPY}NAME"))


def _known(name: str, value: Any, names: tuple[str, ...]) -> None:
    if value not in names:
        raise InputError(f"{name}: {shown(value)} is not known; use {', '.join(names)}")


def _require_pandas() -> None:
    with brought_by("study"):
        import pandas  # noqa: F401
