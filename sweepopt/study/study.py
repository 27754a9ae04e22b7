"""A work-precision study: what every combination of problem, scheme, solver and size costs.

    table = run(read_study("accuracy.toml"), "results/accuracy")

One row a combination, failures included, kept as soon as it is finished: run again, it goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import nullcontext
from dataclasses import MISSING, asdict, dataclass, fields
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sweepopt.checks import count, listed, number
from sweepopt.errors import InputError, brought_by, shown
from sweepopt.integrate import schemes
from sweepopt.io import as_path, read_toml
from sweepopt.study.cell import THROUGH_CVXPY, Cell, CellRow, blank, failed, run_cell
from sweepopt.study.ledger import Ledger
from sweepopt.study.reference import absent, make_reference
from sweepopt.study.sources import Source, find_source
from sweepopt.velocity import solvers

if TYPE_CHECKING:
    from pandas import DataFrame

IN_FLIGHT = 64
"""Cells handed to an executor at a time: each carries its reference."""
Jobs = Iterable[tuple[Cell, tuple[Any, ...]]]
"""Cells and the arguments of the function that is called for each."""
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
    keys = {field.name: field for field in fields(Study) if field.name != "folder"}
    for key in data:
        if key not in keys:
            raise InputError(f"{path}: {key}: unknown key; there are: {', '.join(keys)}")
    for key, field in keys.items():
        if field.default is MISSING and key not in data:
            raise InputError(f"{path}: {key}: is missing")
    try:
        study = Study(**data, folder=str(path.parent))
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
    _require_pandas()
    cells, ledger = study.cells(), Ledger(Path(folder))
    ledger.describe(asdict(study))
    todo = [cell for cell in cells if ledger.row(cell) is None]
    progress(f"{len(cells)} cells, {len(cells) - len(todo)} of them finished before")
    grids = {(cell.problem, cell.steps): cell for cell in todo}
    missing = [cell for cell in grids.values() if ledger.reference(cell) is None]
    with nullcontext(executor) if executor else ThreadPoolExecutor(1) as pool:
        jobs: Jobs = ((cell, (cell.problem, cell.steps)) for cell in missing)
        for k, (cell, future) in enumerate(_computed(pool, make_reference, jobs), start=1):
            error = future.exception()
            ledger.keep_reference(cell, absent(str(error)) if error else future.result())
            progress(f"reference {k} of {len(missing)}: {cell.problem.name} {cell.steps} steps")
        jobs = ((cell, (cell, ledger.reference(cell))) for cell in todo)
        for k, (cell, future) in enumerate(_computed(pool, run_cell, jobs), start=1):
            error = future.exception()
            row = failed(blank(cell), error) if error else future.result()
            ledger.keep(row)
            progress(f"{k} of {len(todo)}: {cell}: {row.status}")
    return read_table(study, folder)


def read_table(study: Study, folder: str | Path) -> DataFrame:
    """The finished cells of a study as a table, whether or not there are more to come."""
    _require_pandas()
    import pandas as pd

    ledger = Ledger(Path(folder))
    rows = [row for cell in study.cells() if (row := ledger.row(cell)) is not None]
    return pd.DataFrame(rows, columns=list(CellRow._fields))


def _computed(
    executor: Executor, function: Callable[..., Any], jobs: Jobs
) -> Iterator[tuple[Cell, Future[Any]]]:
    """Cells and their finished futures as they come, a limited number of jobs under way.

    Raises what a function raised, but for the death of its workers.
    """
    running: dict[Future[Any], Cell] = {}
    jobs = iter(jobs)
    try:
        while True:
            while len(running) < IN_FLIGHT and (job := next(jobs, None)) is not None:
                cell, arguments = job
                running[executor.submit(function, *arguments)] = cell
            if not running:
                return
            done = wait(running, return_when=FIRST_COMPLETED).done
            for future in sorted(done, key=lambda one: one.exception() is not None):
                error = future.exception()
                if error is not None and type(error).__name__ not in WORKER_DIED:
                    raise error
                yield running.pop(future), future
    finally:
        for future in running:
            future.cancel()


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
