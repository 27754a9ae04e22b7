"""Suites of cases that are judged, as parts of a study: what they run, and how they are shown."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from sweepopt.study.hard.suite import HardStudy, rows, trajectory_rows
from sweepopt.study.hard.verdicts import TARGET
from sweepopt.study.stiff import StiffStudy
from sweepopt.study.stiff import rows as stiff_rows

KINDS: dict[str, type[Any]] = {"hard": HardStudy, "stiff": StiffStudy}
"""Tables of a study's file beside its own keys."""


class Suite(NamedTuple):
    """Rows of one kind.

    Attributes
    ----------
    part : str
        The table of a study's file.
    rows : callable
        That table as a record -> named tuples with a `verdict`.
    by : list of str
        Columns by which rows are grouped where they are printed.
    title, text : str
        Of the report.
    """

    part: str
    rows: Callable[[Any], Iterator[Any]]
    by: list[str]
    title: str
    text: str


SUITES = {
    "hard": Suite(
        *("hard", rows, ["family"], "Hard cases"),
        "The worst step of each run, judged by its exact velocity: the true error stays below "
        f"{TARGET:g} and below the certificate.",
    ),
    "trajectories": Suite(
        *("hard", trajectory_rows, ["trajectory"], "Hard trajectories"),
        "Runs beside exact trajectories: the error is that of the scheme's order, bounds lie above "
        "it, energies balance, and what slips clearly does not rest.",
    ),
    "stiff": Suite(
        *("stiff", stiff_rows, ["body", "load", "mu_Lam", "scheme"], "Stiff bodies"),
        "The default scheme beside the best of three: its error is at most twice theirs and below "
        "its bound, its velocities do not ring, and what slips does not rest.",
    ),
}
"""By the name of their files: the .jsonl has each row as soon as it is finished, the .csv all."""
