"""A work-precision study: what every combination of problem, scheme, solver and size costs.

    table = run(read_study("accuracy.toml"), "results/accuracy")

One row a combination, failures included, kept as soon as it is finished: run again, it goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from functools import partial
from itertools import islice, product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sweepopt.checks import count, number
from sweepopt.errors import InputError, brought_by, shown
from sweepopt.integrate import schemes
from sweepopt.io import as_path, read_toml
from sweepopt.study.cell import THROUGH_CVXPY, Cell, CellRow, blank, failed, run_cell
from sweepopt.study.ledger import Ledger
from sweepopt.study.records import each, known, read_record
from sweepopt.study.reference_states import absent, make_reference
from sweepopt.study.sources import Source, find_source
from sweepopt.velocity import solvers

if TYPE_CHECKING:
    from pandas import DataFrame

IN_FLIGHT = 64
"""Cells handed to an executor at a time: each carries its reference."""
Jobs = Iterator[tuple[Any, ...]]
"""Cells, what is called for each, and its arguments."""
WORKER_DIED = ("WorkerDiedError", "KilledWorker")
"""Exceptions, ours and dask's, of a cell whose workers died; others end the study."""


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
            "schemes": known(("auto", *schemes.SCHEMES)),
            "solvers": _solver,
            "steps": count,
            "tols": partial(number, minimum=0.0, strict=True),
        }
        for name, check in checks.items():
            entries = each(name, getattr(self, name), check)
            for k, entry in enumerate(entries):
                if entry in entries[:k]:
                    raise InputError(f"{name}[{k}]: {shown(entry)} is there twice")
            object.__setattr__(self, name, entries)
        count("repeats", self.repeats)
        _text("title", self.title)

    def sources(self) -> list[Source]:
        """The problems, their files read for a digest; InputError if one is not there."""
        sources: list[Source] = []
        for k, name in enumerate(self.problems):
            try:
                sources.append(find_source(name, self.folder))
            except InputError as error:
                raise InputError(f"problems[{k}]: {error}") from error
            if sources[-1].name in (other.name for other in sources[:-1]):
                raise InputError(f"problems[{k}]: another one is called {sources[-1].name!r} too")
        return sources

    def cells(self) -> list[Cell]:
        """All combinations, the problem slowest."""
        lists = self.sources(), self.schemes, self.solvers, self.steps, self.tols
        return [Cell(*combination, repeats=self.repeats) for combination in product(*lists)]


def read_study(path: str | Path) -> Study:
    """Read a study from a TOML file.

    Parameters
    ----------
    path : str or Path

    Raises
    ------
    InputError
        Naming the file and the key at fault.

    Notes
    -----
    ::

        title = "What accuracy costs"                   # optional
        problems = ["S03", "tube", "scenes/mine.toml"]  # relative to this file
        schemes = ["catching-up", "midpoint"]
        solvers = ["auto", "clarabel", "cvxpy:scs"]
        steps = [100, 1000]
        tols = [1e-6]                                   # optional
        repeats = 3                                     # optional
        [hard]                                          # optional: hard cases, run afterwards
        seeds = [0]

    Examples
    --------
    >>> from sweepopt.io import find_study
    >>> read_study(find_study("accuracy")).repeats > 0
    True
    """
    path = as_path("path", path)
    data = read_toml(path)
    data.pop("hard", None)
    study = read_record(f"{path}: ", Study, data, folder=str(path.parent))
    try:
        study.sources()
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return study


def run(
    study: Study,
    folder: str | Path,
    *,
    executor: Executor | None = None,
    progress: Callable[[str], object] = lambda words: None,
) -> DataFrame:
    """Compute the cells of a study that are not in the folder yet.

    Parameters
    ----------
    study : Study
    folder : str or Path
        Where finished cells are kept. Killed at any moment, the study goes on from there; what is
        not whole is computed again.
    executor : concurrent.futures.Executor, optional
        `Processes(n)`, `dask_executor(client)`, or any other; by default cells are computed in one
        thread, one after the other. The rows are the same bit for bit, times apart.
    progress : callable, optional
        Called with a line of text when something is finished, for example `print`.

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
    cells, ledger = study.cells(), Ledger(Path(folder))
    ledger.describe(asdict(study))
    todo = [cell for cell in cells if ledger.row(cell) is None]
    progress(f"{len(cells)} cells, {len(cells) - len(todo)} of them finished before")
    grids = {(cell.problem, cell.steps): cell for cell in todo}
    missing = [cell for cell in grids.values() if ledger.reference(cell) is None]
    with nullcontext(executor) if executor else ThreadPoolExecutor(1) as pool:
        jobs: Jobs = ((cell, make_reference, cell.problem, cell.steps) for cell in missing)
        for k, (cell, made) in enumerate(_computed(pool, jobs), start=1):
            died = isinstance(made, Exception)
            ledger.keep_reference(cell, absent(str(made)) if died else made)
            progress(f"reference {k} of {len(missing)}: {cell.problem.name} {cell.steps} steps")
        jobs = ((cell, run_cell, cell, ledger.reference(cell)) for cell in todo)
        for k, (cell, made) in enumerate(_computed(pool, jobs), start=1):
            row = failed(blank(cell), made) if isinstance(made, Exception) else made
            ledger.keep(row)
            progress(f"{k} of {len(todo)}: {cell}: {row.status}")
    return read_table(study, folder)


def read_table(study: Study, folder: str | Path) -> DataFrame:
    """The finished cells of a study as a table, whether or not there are more to come."""
    with brought_by("study"):
        import pandas as pd

    ledger = Ledger(Path(folder))
    rows = [row for cell in study.cells() if (row := ledger.row(cell)) is not None]
    return pd.DataFrame(rows, columns=list(CellRow._fields))


def _computed(executor: Executor, jobs: Jobs) -> Iterator[tuple[Cell, Any]]:
    """Cells and their results as they come, a limited number of jobs under way.

    The death of a job's workers is its result; other exceptions are raised.
    """
    running: dict[Future[Any], Cell] = {}
    try:
        while True:
            for cell, function, *arguments in islice(jobs, IN_FLIGHT - len(running)):
                running[executor.submit(function, *arguments)] = cell
            if not running:
                return
            done = wait(running, return_when=FIRST_COMPLETED).done
            for future in sorted(done, key=lambda one: one.exception() is not None):
                error = future.exception()
                if error is not None and type(error).__name__ not in WORKER_DIED:
                    raise error
                yield running.pop(future), error or future.result()
    finally:
        for future in running:
            future.cancel()


def _text(name: str, value: Any) -> None:
    if not isinstance(value, str):
        raise InputError(f"{name} must be text, got {shown(value)}")


def _solver(name: str, value: Any) -> None:
    if not (isinstance(value, str) and value.startswith(THROUGH_CVXPY)):
        known(("auto", *solvers.REGISTRY, f"{THROUGH_CVXPY}NAME"))(name, value)
