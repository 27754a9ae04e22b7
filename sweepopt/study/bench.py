"""The benchmark: all contestants in one run, in turn, with the accuracy beside every time."""

from __future__ import annotations

import gc
import os
import platform
from collections.abc import Callable, Iterable, Sequence
from importlib.metadata import version
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sweepopt.checks import count
from sweepopt.errors import InputError
from sweepopt.study.by_hand import Run
from sweepopt.study.cases import SCHEME, Case, blocks, square
from sweepopt.study.contestants import CONTESTANTS, TINY, Contestant, reference
from sweepopt.study.memory import peak

NAIVE, LINEAR = "cvxpy-rebuilt", "frictionless"
BLOCKS = (1, 200)
BLOCK_STEPS = 20  # a block's step is so short that each round takes more of them

PACKAGES = ("numpy", "scipy", "cvxpy", "clarabel", "osqp")

Say = Callable[[str], object]


class Row(NamedTuple):
    """One contestant on one case; None where a number does not exist.

    Attributes
    ----------
    case : str
    unknowns, contact, steps, rounds : int
    path : str
    ms : float
        Milliseconds a step: the mean over a run without its first step, the median over rounds.
    spread : float
        (largest - smallest) / median over the rounds.
    setup : float
        Seconds before the second step.
    recover : float
        Milliseconds a step for reading all of u after the run.
    peak : float
        Peak resident memory in MB of a process that builds the scene and runs this once.
    attempts : float
        Solver calls a step.
    certificate : float
        The worst one, relative; None for loops by hand, which have no proof.
    difference : float
        max_i |u_i - r_i|_A / max_i |r_i|_A, r the reference.
    naive : float
        How many times faster than the naive cvxpy loop.
    linear : float
        Multiple of the frictionless step.
    overhead : float
        Multiple of the loop by hand over the same programs with the same settings.
    """

    case: str
    unknowns: int
    contact: int
    steps: int
    rounds: int
    path: str
    ms: float | None = None
    spread: float | None = None
    setup: float | None = None
    recover: float | None = None
    peak: float | None = None
    attempts: float | None = None
    certificate: float | None = None
    difference: float | None = None
    naive: float | None = None
    linear: float | None = None
    overhead: float | None = None


def bench(
    cells: Sequence[int] = (32, 100),
    *,
    steps: int = 50,
    rounds: int = 3,
    only: Sequence[str] | None = None,
    tiny: bool = True,
    memory: bool = False,
    progress: Say | None = None,
) -> list[Row]:
    """Time the library's paths and the loops by hand on squares of several sizes.

    Parameters
    ----------
    cells : sequence of int
        Cells a side: 32, 100, 316, 1000 give 1,056, 10,100, 100,172 and 1,001,000 unknowns. Slow
        contestants leave out the large ones (`limit` in their table).
    steps : int
        At least 2, the same for everyone.
    rounds : int
        Each round runs every contestant once, set-up included.
    only : sequence of str, optional
        Paths to run; all by default.
    tiny : bool
        Also time one block and 200 blocks on springs, 20 times the steps, set-up in the steps.
    memory : bool
        Also run each contestant in a process of its own for its peak memory (Linux).
    progress : callable, optional
        Told what runs next, for example `print`.

    Returns
    -------
    list of Row
        By case; in each the reference comes first.

    Raises
    ------
    InputError
        If `only` names a path that is not there, or a number is out of range.
    """
    steps, rounds = count("steps", steps), count("rounds", rounds)
    if steps < 2:
        raise InputError("steps must be at least 2: the first one belongs to the set-up")
    sizes = [count("cells", size) for size in cells]
    known = [contestant.path for contestant in (*CONTESTANTS, *TINY)]
    for path in only or ():
        if path not in known:
            raise InputError(f"only: there is no path {path!r}; there are: {', '.join(known)}")
    say = progress or (lambda _: None)

    def chosen(table: Sequence[Contestant], dim: int) -> list[Contestant]:
        return [
            contestant
            for contestant in table
            if dim <= contestant.limit and (only is None or contestant.path in only)
        ]

    rows: list[Row] = []
    for size in sizes:
        case = square(size, steps)
        measured = measure(case, chosen(CONTESTANTS, case.dim), rounds, say)
        rows += _with_memory(measured, size, say) if memory else measured
    for dim in BLOCKS if tiny else ():
        rows += measure(blocks(dim, BLOCK_STEPS * steps), chosen(TINY, dim), rounds, say)
    return rows


def measure(case: Case, contestants: Sequence[Contestant], rounds: int, say: Say) -> list[Row]:
    """Run the contestants in turn, several rounds, and compare each with its reference."""
    if not contestants:
        return []
    say(f"{case.name}: reference")
    references = {friction: reference(case, friction) for friction in _kinds(contestants)}
    runs: dict[str, list[Run]] = {contestant.path: [] for contestant in contestants}
    differences = dict.fromkeys(runs, 0.0)
    for number in range(1, rounds + 1):
        for contestant in contestants:
            say(f"{case.name}: round {number} of {rounds}: {contestant.path}")
            gc.collect()
            run = contestant.run(case)
            away = difference(case, run.u, references[contestant.friction].u)
            differences[contestant.path] = max(differences[contestant.path], away)
            runs[contestant.path].append(run._replace(u=np.empty(0)))

    def row(path: str) -> Row:
        return Row(case.name, case.dim, case.contact.size, case.steps, rounds, path)

    times = {path: _median(run.step for run in found) for path, found in runs.items()}

    def over(path: str, other: str) -> float | None:
        return times[path] / times[other] if other in times else None

    rows = [
        row("reference" if friction else "reference, frictionless")._replace(
            attempts=found.attempts, certificate=found.certificate
        )
        for friction, found in references.items()
    ]
    for contestant in contestants:
        path, found = contestant.path, runs[contestant.path]
        faster = over(path, NAIVE)
        rows.append(
            row(path)._replace(
                ms=1e3 * times[path],
                spread=float(np.ptp([run.step for run in found])) / times[path],
                setup=_median(run.setup for run in found),
                recover=1e3 * _median(run.recover for run in found),
                attempts=found[0].attempts,
                certificate=found[0].certificate,
                difference=differences[path],
                naive=1 / faster if faster else None,
                linear=over(path, LINEAR),
                overhead=over(path, contestant.floor),
            )
        )
    return rows


def difference(case: Case, u: np.ndarray, reference: np.ndarray) -> float:
    """max_i |u_i - r_i|_A / max_i |r_i|_A."""
    A = case.problem.A
    squares = [
        max(float(x @ (A @ x)) for x in rows)
        for rows in ((a - b for a, b in zip(u, reference, strict=True)), reference)
    ]
    return float(np.sqrt(squares[0] / squares[1]))


def machine() -> str:
    """Processor, threads and versions, in one line."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    processor = names[0] if names else platform.processor() or platform.machine()
    threads = os.environ.get("OMP_NUM_THREADS", "unset")
    versions = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    return (
        f"{processor}, {os.cpu_count()} cores, OMP_NUM_THREADS {threads}, {platform.system()}, "
        f"Python {platform.python_version()}, {versions}"
    )


def table(rows: Sequence[Row]) -> str:
    """All rows as text, a block for each case under the line that describes the machine."""
    blocks_ = [machine(), f"scheme {SCHEME}; medians over rounds that run all paths in turn"]
    for _, group in groupby(rows, key=lambda row: (row.case, row.unknowns)):
        block = list(group)
        first = block[0]
        title = (
            f"{first.case}: {first.unknowns:,} unknowns, {first.contact:,} with friction, "
            f"{first.steps:,} steps, {first.rounds} rounds"
        )
        cells = [[column.title for column in COLUMNS]]
        cells += [[column.shown(row) for column in COLUMNS] for row in block]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        lines = [
            "  ".join(
                cell.ljust(width) if k == 0 else cell.rjust(width)
                for k, (cell, width) in enumerate(zip(line, widths, strict=True))
            )
            for line in cells
        ]
        blocks_.append("\n".join([title, *lines]))
    legend = (
        "ms/step: without set-up (blocks: with it); +-: spread over the rounds; u ms: reading all "
        "of u, a step;\npeak MB: of a process of its own; tries: solver calls a step; certificate: "
        "the worst, relative;\ndifference: of u to the reference's, relative in |.|_A; x faster: "
        "than cvxpy-rebuilt; x linear: a multiple\nof frictionless; x floor: of the loop by hand "
        "over the same programs"
    )
    return "\n\n".join([*blocks_, legend])


class Column(NamedTuple):
    """A column of the table: its title, the field of a row, and how a number is written."""

    title: str
    field: str
    form: str

    def shown(self, row: Row) -> str:
        value = getattr(row, self.field)
        return "-" if value is None else format(value, self.form)


COLUMNS = (
    Column("path", "path", "s"),
    Column("ms/step", "ms", ".4g"),
    Column("+-", "spread", ".0%"),
    Column("set-up s", "setup", ".3f"),
    Column("u ms", "recover", ".3g"),
    Column("peak MB", "peak", ",.0f"),
    Column("tries", "attempts", ".2f"),
    Column("certificate", "certificate", ".0e"),
    Column("difference", "difference", ".0e"),
    Column("x faster", "naive", ".3g"),
    Column("x linear", "linear", ".3g"),
    Column("x floor", "overhead", ".2f"),
)


def _kinds(contestants: Sequence[Contestant]) -> list[bool]:
    return sorted({contestant.friction for contestant in contestants}, reverse=True)


def _with_memory(rows: Sequence[Row], cells: int, say: Say) -> list[Row]:
    """The rows with their peak memory, after one of the scene alone."""
    paths = {contestant.path for contestant in CONTESTANTS}
    say(f"{cells} cells a side: memory of the scene")
    found = [Row(*rows[0][:5], "scene alone", peak=peak(cells, rows[0].steps))]
    for row in rows:
        if row.path in paths:
            say(f"{row.case}: memory of {row.path}")
            row = row._replace(peak=peak(cells, row.steps, row.path))
        found.append(row)
    return found


def _median(values: Iterable[float]) -> float:
    return float(np.median(list(values)))
