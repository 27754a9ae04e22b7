"""The benchmark's rows, and how they are printed."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from sweepopt import __version__
from sweepopt.io import versions_of
from sweepopt.study.cases import SCHEME

PACKAGES = ("numpy", "scipy", "cvxpy", "clarabel", "osqp")


class Row(NamedTuple):
    """One contestant on one case; None where a number does not exist.

    Attributes
    ----------
    case : str
    unknowns, contact, steps, rounds : int
    path : str
    ms : float
        Milliseconds a step: the mean over a run without the first and the slowest step, which hold
        the set-up; the median over rounds.
    spread : float
        (largest - smallest) / median over the rounds.
    setup : float
        Seconds of the run that are not steps.
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
        How many times faster than the naive cvxpy loop; like the next two the median of the
        ratios in each round.
    linear : float
        The cost in units of the frictionless step.
    overhead : float
        The cost in units of the loop by hand over the same programs with the same settings.
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


LEGEND = """\
ms/step     the mean over a run without its set-up (blocks: with it), the median over the rounds
+-          (largest - smallest) / median of the rounds
u ms        reading all of u after the run, a step
peak MB     of a process of its own that builds the scene and runs this once
tries       solver calls a step
certificate the worst, relative: what tol bounds; loops by hand have none
difference  of u from the reference's, the largest in |.|_A, relative
x faster    than cvxpy-rebuilt
x linear    the cost in units of the frictionless step
x floor     the cost in units of the loop by hand over the same programs, settings and scaling"""


def table(rows: Sequence[Row]) -> str:
    """All rows as text: what they ran on, a block for each case, the legend."""
    runs = f"scheme {SCHEME}; in each round all paths of a case run in turn"
    cases = groupby(rows, key=lambda row: (row.case, row.steps, row.rounds))
    return "\n\n".join([f"{machine()}\n{runs}", *(_block(list(rows)) for _, rows in cases), LEGEND])


def _block(rows: Sequence[Row]) -> str:
    first = rows[0]
    title = (
        f"{first.case}: {first.unknowns:,} unknowns, {first.contact:,} with friction, "
        f"{first.steps:,} steps, {first.rounds} rounds"
    )
    lines = [[column.title for column in COLUMNS]]
    lines += [[column.shown(row) for column in COLUMNS] for row in rows]
    widths = [max(map(len, cells)) for cells in zip(*lines, strict=True)]
    aligned = [
        "  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True))
        for line in ([line[0].ljust(widths[0]), *line[1:]] for line in lines)
    ]
    return "\n".join([title, *aligned])


def aligned(lines: Sequence[Sequence[str]]) -> str:
    """Lines of cells as text in columns."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in lines
    )


def machine() -> str:
    """Processor, threads and versions, in one line."""
    threads = os.environ.get("OMP_NUM_THREADS", "unset")
    packages = ", ".join(f"{name} {number}" for name, number in versions().items())
    return f"{processor()}, OMP_NUM_THREADS {threads}, {platform.system()}; {packages}"


@cache
def processor() -> str:
    """Name and number of cores."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    name = names[0] if names else platform.processor() or platform.machine()
    return f"{name}, {os.cpu_count()} cores"


def versions() -> dict[str, str]:
    """Of the library, of Python and of what computes."""
    return {"sweepopt": __version__, "python": platform.python_version(), **versions_of(PACKAGES)}
