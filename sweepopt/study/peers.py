"""Other people's packages on the scalar case, each in a Python of its own, beside ours.

    python -m sweepopt.study.peers --solve-nivp PYTHON --nosnoc PYTHON

The packages (solve_nivp 0.1.2, nosnoc 0.2.0) are no dependency: install each in a virtual
environment and name its python. What is not named is left out, and the table says so. For each
error the settings of a package are tried from cheap to dear; the first that is accurate enough at
its own nodes then runs in turn with ours, which is timed in the same way.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from math import inf, nan
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np

from sweepopt.errors import InputError
from sweepopt.solve import solve
from sweepopt.study import peer_runs
from sweepopt.study.equal_error import Found, cheapest, timed
from sweepopt.study.peer_settings import PEERS, Peer, Settings
from sweepopt.study.problems import BLOCK
from sweepopt.study.rows import aligned, machine
from sweepopt.study.smoothed import friction_of
from sweepopt.study.ways import Task, ours

SCRIPT = Path(peer_runs.__file__)
ERRORS = (1e-3, 1e-5, 1e-8)
PATIENCE = 120.0
"""Seconds after which a run of a package is ended."""
LOST = 5e-3
"""Relative; a run that ends so much before t_end did not succeed."""


class Answer(NamedTuple):
    """A run of a package: its error at its own nodes, inf if it failed, and how it failed."""

    error: float
    seconds: float = nan
    version: str = ""
    message: str = ""


class PeerRow(NamedTuple):
    """A row of the table.

    Attributes
    ----------
    wanted : float
    name, setting : str
    error, seconds : float
        Of the package, seconds the median over the rounds.
    ours, our_setting : str
        The fastest of our ways at the wanted error.
    our_error, our_seconds : float
    ratio : float
        seconds / our_seconds, the median of the rounds' ratios.
    note : str
    """

    wanted: float
    name: str
    setting: str = ""
    error: float = nan
    seconds: float = nan
    ours: str = ""
    our_setting: str = ""
    our_error: float = nan
    our_seconds: float = nan
    ratio: float = nan
    note: str = ""


def compare_peers(
    pythons: dict[str, str],
    *,
    errors: Sequence[float] = ERRORS,
    rounds: int = 3,
    progress: Callable[[str], object] | None = None,
) -> list[PeerRow]:
    """Our fastest way beside each package at each error.

    Parameters
    ----------
    pythons : dict
        From "solve_nivp" and "nosnoc" to the python executable that has the package; what is left
        out gets one row that says so.
    errors : sequence of float
        Absolute, sup over the nodes; u is of the size 0.7.
    rounds : int
        In each of them the package and ours run in turn.
    progress : callable, optional

    Returns
    -------
    list of PeerRow

    Raises
    ------
    InputError
        If a package is not one of these.
    """
    packages = list(dict.fromkeys(peer.package for peer in PEERS))
    for name in pythons:
        if name not in packages:
            raise InputError(f"pythons: {name!r} is not compared; use {', '.join(packages)}")
    rows = [
        PeerRow(nan, package, note="skipped: no python that has it was named")
        for package in packages
        if package not in pythons
    ]
    say, task = progress or (lambda _: None), Task(BLOCK.process(), BLOCK.t_end)
    for wanted in errors if pythons else ():
        best = our_best(task, wanted)
        for peer in PEERS:
            if peer.package in pythons:
                rows.append(_compared(peer, pythons[peer.package], wanted, best, rounds))
                say(peer_table(rows[-1:]))
    return rows


def our_best(task: Task, wanted: float) -> Found:
    """The fastest of our ways at an error."""
    found = [cheapest(task, way, wanted) for way in ours(task)]
    fastest = timed(found, rounds=3)[0].way
    return next(one for one in found if one.way == fastest)


def _compared(peer: Peer, python: str, wanted: float, best: Found, rounds: int) -> PeerRow:
    row = PeerRow(wanted, peer.name)
    tried: list[tuple[Answer, Settings]] = []
    for settings in peer.rungs(wanted):
        tried.append((ask(python, peer.package, settings), settings))
        if tried[-1][0].error <= wanted and not peer.thorough:
            break
    enough = [one for one in tried if one[0].error <= wanted]
    if not enough:
        answer, settings = min(tried, key=lambda one: one[0].error)
        row = row._replace(setting=_words(settings), error=answer.error, seconds=answer.seconds)
        return row._replace(note=f"not reached {answer.message}".strip())
    answer, settings = min(enough, key=lambda one: one[0].seconds)
    theirs, mine = [], []
    for _ in range(rounds):
        theirs.append(ask(python, peer.package, settings).seconds)
        mine.append(peer_runs.timed(best.run.states)[0])
    return PeerRow(
        wanted,
        peer.name,
        _words(settings),
        answer.error,
        median(theirs),
        best.way,
        best.run.setting,
        best.error,
        median(mine),
        median(a / b for a, b in zip(theirs, mine, strict=True)),
        answer.version,
    )


def ask(python: str, package: str, settings: Settings) -> Answer:
    """Run a package once in its own python and judge what it found."""
    friction = friction_of(BLOCK.process())
    case = {"a": friction.a, "b": friction.b, "g": friction.g, "t_end": BLOCK.t_end, **settings}
    command = [python, str(SCRIPT), package, json.dumps(case)]
    try:
        told = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    except OSError as failure:
        return Answer(inf, message=f"({python}: {failure.strerror})")
    except subprocess.TimeoutExpired:
        return Answer(inf, message=f"(no end after {PATIENCE:g} s)")
    if told.returncode != 0:
        return Answer(inf, message=f"({(told.stderr.strip().splitlines() or ['it died'])[-1]})")
    found = json.loads(told.stdout)
    error = error_at_nodes(np.array(found["t"]), np.array(found["u"]))
    return Answer(error, found["seconds"], f"{package} {found['version']}")


def error_at_nodes(t: np.ndarray, u: np.ndarray) -> float:
    """The largest |u - exact| at the nodes of a run, inf if it did not come to the end."""
    kept = np.append(True, np.diff(t) > 1e-12 * BLOCK.t_end)  # elements may shrink to nothing
    t, u = t[kept], u[kept]
    if len(t) < 2 or abs(t[-1] - BLOCK.t_end) > LOST * BLOCK.t_end or not np.isfinite(u).all():
        return inf
    exact = solve(BLOCK.process(), steps=t, scheme="exact").u[:, 0]
    return float(np.abs(u - exact).max())


def _words(settings: Settings) -> str:
    left_out = ("form", "method", "mode", "h_max", "tol")
    return ", ".join(f"{key} {value:.3g}" for key, value in settings.items() if key not in left_out)


def peer_table(rows: Sequence[PeerRow]) -> str:
    """The comparison as text."""
    lines = [["error", "who", "setting", "error", "s", "ours", "error", "s", "ratio", ""]]
    for row in rows:
        lines.append(
            [
                f"{row.wanted:g}",
                row.name,
                row.setting,
                f"{row.error:.1e}",
                f"{row.seconds:.3g}",
                f"{row.ours} {row.our_setting}",
                f"{row.our_error:.1e}",
                f"{row.our_seconds:.2g}",
                f"{row.ratio:.3g}",
                row.note,
            ]
        )
    return aligned([[cell.replace("nan", "-") for cell in line] for line in lines])


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Other packages on the scalar case, beside ours.")
    parser.add_argument("--solve-nivp", metavar="PYTHON", help="one that has solve_nivp 0.1.2")
    parser.add_argument("--nosnoc", metavar="PYTHON", help="one that has nosnoc 0.2.0")
    parser.add_argument("--error", type=float, nargs="+", default=list(ERRORS))
    parser.add_argument("--rounds", type=int, default=3)
    chosen = parser.parse_args(arguments)
    named = {"solve_nivp": chosen.solve_nivp, "nosnoc": chosen.nosnoc}
    pythons = {package: python for package, python in named.items() if python}
    rows = compare_peers(
        pythons,
        errors=chosen.error,
        rounds=chosen.rounds,
        progress=lambda words: print(words, file=sys.stderr, flush=True),
    )
    print(f"{machine()}\n{BLOCK.name}: {BLOCK.title}, a = b = 1, g = 0.3, f = sin t, t_end 10\n")
    print(peer_table(rows))


if __name__ == "__main__":
    main()
