"""A work-precision study: what every combination of problem, scheme, solver and size costs.

    table = run(read_study("accuracy.toml"), "results/accuracy")

One row a combination, failures included, kept as soon as it is finished: run again, it goes on.
With one thread a process times compare, and rows are the same bit for bit, wherever they are
computed.
"""

import json
import os
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from itertools import product
from multiprocessing import get_context, parent_process
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
from pandas import DataFrame

from sweepopt.checks import at_path, choice, count, from_table, number
from sweepopt.errors import InputError, brought_by, shown
from sweepopt.integrate import schemes
from sweepopt.io import as_path, folder_at, read_toml
from sweepopt.study.cell import Cell, CellRow, run_cell
from sweepopt.study.hard import SUITES, each, option
from sweepopt.study.problems import Source, find_source
from sweepopt.velocity import solvers

ROWS = "rows.jsonl"


@dataclass(frozen=True)
class Study:
    """What shall be compared: the product of its lists.

    Parameters
    ----------
    problems : tuple of str or Source
        Names of `sweepopt.study.problems`, scenes of the library, paths of scene files, and
        processes of one's own (`own_source`).
    schemes : tuple of str
    solvers : tuple of str
        Names that `sweepopt.solve` knows, or "cvxpy:NAME" for any solver installed for cvxpy.
    steps : tuple of int
    tols : tuple of float
        Of the solvers.
    refinements : tuple of int
        Of the meshes of scenes: how often each triangle is divided into four.
    elements : tuple of str
        Of scenes, in place of their own; "" is their own.
    repeats : int
        How often each run is timed, after once that is not.
    title : str
    folder : str
        Where relative paths of scenes start.

    Raises
    ------
    InputError
        Naming the list and the entry at fault, a problem that is not there for example.

    Examples
    --------
    >>> study = Study(("S03", "P09"), ("midpoint", "sdirk2"), ("auto",), (100, 200, 400))
    >>> len(study.runs())
    12
    """

    problems: tuple[str | Source, ...]
    schemes: tuple[str, ...]
    solvers: tuple[str, ...]
    steps: tuple[int, ...]
    tols: tuple[float, ...] = (1e-6,)
    refinements: tuple[int, ...] = (0,)
    elements: tuple[str, ...] = ("",)
    repeats: int = 3
    title: str = ""
    folder: str = "."

    def __post_init__(self) -> None:
        self.runs()
        if not isinstance(self.title, str):
            raise InputError(f"title must be text, got {shown(self.title)}")

    def runs(self) -> list[Cell]:
        """All combinations, the problem slowest; InputError if a problem's file is gone."""
        checks: dict[str, Any] = {
            "problems": (self._source,),
            "refinements": (count, 0),
            "elements": (choice, ("", "P1", "P2")),
            "schemes": (choice, ("auto", *schemes.SCHEMES)),
            "solvers": (_solver,),
            "steps": (count,),
            "tols": (number, 0.0, True),
        }
        lists = [each(name, getattr(self, name), *check) for name, check in checks.items()]
        lists.append((count("repeats", self.repeats),))
        for k, source in enumerate(lists[0]):
            if source.small and (any(self.refinements) or any(self.elements)):
                raise InputError(
                    f"problems[{k}]: {source.name} has no mesh; leave it out, or refinements and "
                    "elements"
                )
        return [
            Cell(source._replace(refinements=refinements, element=element), *others)
            for source, refinements, element, *others in product(*lists)
        ]

    def reference(self, source: Source) -> Source:
        """What errors of a problem are against: itself, or what is finer than all of its meshes.

        In a study of one mesh and one element errors are those in time, against the exact solution
        on that mesh. Otherwise they are against the solution on a mesh that is refined once more
        than the finest, with the elements of the highest degree. The coarser functions are
        functions on that mesh too, so that nothing is lost in comparing; its own error in space is
        in the numbers.
        """
        if len(self.refinements) == len(self.elements) == 1:
            return source
        element = "P2" if self.elements[1:] else self.elements[0]  # "" may be P2
        return source._replace(refinements=max(self.refinements) + 1, element=element)

    def _source(self, name: str, value: Any) -> Source:
        with at_path(f"{name}: "):
            return find_source(value, self.folder)


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
        solvers = ["auto", "clarabel", "cvxpy:scs"]     # optional
        steps = [100, 1000]
        tols = [1e-6]                                   # optional
        refinements = [0, 1, 2]                         # optional, of the meshes of scenes
        elements = ["P1", "P2"]                         # optional, of scenes
        repeats = 3                                     # optional
        [hard]                                          # optional: hard cases, run afterwards
        seeds = [0]
        [trajectories]                                  # optional: hard trajectories
        seeds = [0]
        [stiff]                                         # optional: stiff bodies, run afterwards
        seeds = [0]

    Examples
    --------
    >>> from sweepopt.io import find_study
    >>> read_study(find_study("accuracy")).repeats > 0
    True
    """
    path = as_path("path", path)
    table = {"solvers": ["auto"]} | read_parts(path)[0]
    return from_table(f"{path}: ", Study, table, folder=str(path.parent))


def read_parts(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """The keys of a study's file, and the rows of its suites by name, which are to be computed."""
    data, rows = read_toml(path), {}
    for name, suite in SUITES.items():
        if name in data:
            where = f"{path}: {name}."
            rows[name] = from_table(where, suite, data.pop(name), partial(option, suite, where))
    return data, rows


def run(
    study: Study,
    folder: str | Path,
    *,
    executor: Executor | None = None,
    progress: Callable[[str], object] = lambda words: None,
) -> DataFrame:
    """Compute the runs of a study that are not in the folder yet.

    Parameters
    ----------
    study : Study
    folder : str or Path
        Where finished runs are kept. Killed at any moment, the study goes on from there; what is
        not whole is computed again.
    executor : concurrent.futures.Executor, optional
        `processes(n)`, `dask_executor(client)`, or any other one; by default runs are computed
        here, one after the other. The rows are the same bit for bit, times apart.
    progress : callable, optional
        Called with a line of text when something is finished, for example `print`.

    Returns
    -------
    pandas DataFrame
        A row a run, with the columns of `CellRow`.

    Raises
    ------
    InputError
        If a problem is not there, or one's own is given to an executor.
    """
    if not isinstance(study, Study):
        raise InputError(f"study must be a Study, got {shown(study)}; read_study makes one")
    cells = study.runs()
    if executor is not None and any(cell.problem.own for cell in cells):
        raise InputError("executor: processes of one's own are computed here; leave it out")
    folder = folder_at("folder", as_path("folder", folder))
    finished = set(read_table(study, folder).run)
    jobs = [(cell, study.reference(cell.problem)) for cell in cells if cell.id not in finished]
    progress(f"{len(cells)} runs, {len(finished)} of them finished before")
    for k, row in enumerate(_compute(jobs, executor), start=1):
        _append_row(folder / ROWS, row)
        progress(f"{k} of {len(jobs)}: {row.run}: {row.status}")
    return read_table(study, folder)


def read_table(study: Study, folder: str | Path) -> DataFrame:
    """The finished runs of a study as a table, whether or not there are more to come."""
    rows, path = {}, as_path("folder", folder) / ROWS
    for line in path.read_bytes().splitlines() if path.exists() else ():
        # lines that are cut short or have other columns are no rows
        with suppress(ValueError, TypeError):
            row = CellRow(**json.loads(line))
            rows[row.run] = row
    finished = [rows[cell.id] for cell in study.runs() if cell.id in rows]
    return DataFrame(finished, columns=list(CellRow._fields))


def _append_row(path: Path, row: CellRow) -> None:
    """Add a line of JSON; it is on the disk when this returns.

    Kill -9 at any moment loses none of the lines.
    """
    line = json.dumps(row._asdict(), default=np.generic.item)
    with path.open("ab") as file:
        # a new line first: one that a kill cut short must not spoil this one
        file.write(f"\n{line}".encode())
        file.flush()
        os.fsync(file.fileno())


def _compute(jobs: list[Any], executor: Executor | None) -> Iterator[CellRow]:
    """The rows as they come.

    Where a process dies, its executor is broken, and dask gives up the cells that several workers
    died of, or beside: these are computed one by one, each in a process of its own. A cell whose
    process dies again is a failed row.
    """
    if executor is None:
        yield from (run_cell(*job) for job in jobs)
        return
    futures = {executor.submit(run_cell, *job): job for job in jobs}
    unfinished = []
    try:
        for future in as_completed(futures):
            error = future.exception()
            if isinstance(error, BrokenExecutor) or type(error).__name__ == "KilledWorker":
                unfinished.append(futures[future])
            else:
                yield future.result()
    finally:
        for future in futures:
            future.cancel()
    for job in unfinished:
        with processes(1) as alone:
            try:
                yield alone.submit(run_cell, *job).result()
            except BrokenExecutor as error:
                yield job[0].failed(error)


def _solver(name: str, value: Any) -> Any:
    cvxpy = value if str(value).startswith("cvxpy:") else "cvxpy:NAME"
    return choice(name, value, ("auto", *solvers.REGISTRY, cvxpy))


# ---- who computes: processes or a dask cluster, which have submit(function, *arguments) -> Future


def processes(workers: int) -> Executor:
    """New processes of this machine as an executor, for `run`.

    Parameters
    ----------
    workers : int

    Notes
    -----
    They are started anew ("spawn"): a script guards its own code with
    ``if __name__ == "__main__":``. All end with the process that started them, even by kill -9.
    """
    return ProcessPoolExecutor(count("workers", workers), get_context("spawn"), _end_with_parent)


def _end_with_parent() -> None:
    """A thread of a worker that waits for the end of the process that started it."""
    parent: Any = parent_process()

    def end() -> None:
        parent.join()
        os._exit(1)

    Thread(target=end, daemon=True).start()


@contextmanager
def dask_executor(client: Any) -> Iterator[Executor]:
    """The workers of a dask cluster as an executor, for `run`.

    Parameters
    ----------
    client : dask.distributed.Client or str
        A client, or the address of a running scheduler, such as "tcp://127.0.0.1:8786".

    Raises
    ------
    InputError
        If the scheduler does not answer, or a worker has several threads: cells in one process
        would share its time. Start workers with ``--nthreads 1``.
    MissingExtraError
        If distributed is not installed.

    Notes
    -----
    Workers read scenes in the files of the machine that runs the study. If a worker dies, another
    one computes its cells.
    """
    with brought_by("dask"):
        from distributed import Client
    try:
        connected = Client(client, timeout=10) if isinstance(client, str) else nullcontext(client)
    except (OSError, ValueError) as error:
        raise InputError(f"scheduler {client!r} does not answer: {error}") from error
    with connected as cluster:
        for address, worker in cluster.scheduler_info(n_workers=-1)["workers"].items():
            if worker["nthreads"] > 1:
                raise InputError(
                    f"worker {address} has {worker['nthreads']} threads, which would share a "
                    "cell's time; start workers with --nthreads 1"
                )
        yield cluster.get_executor(pure=False)
