"""Other people's packages on a block with friction, each in a Python of its own, beside ours.

    python benchmarks/packages.py --solve-nivp PYTHON --nosnoc PYTHON

The packages (solve_nivp 0.1.2, nosnoc 0.2.0) are no dependency: install each in a virtual
environment and name its python. What is not named is left out. For each error the settings of a
package are tried from cheap to dear; the first that is accurate enough at its own nodes then runs
in turn with our fastest way, which is timed in the same way.
"""

from __future__ import annotations

import argparse
import itertools
import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from math import inf, nan
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np
import package_runs
import pandas as pd
from equal_error import Result, Task, cheapest, friction_of, ours, timed

import sweepopt as so
from sweepopt.study import machine
from sweepopt.study.problems import problem

BLOCK, SCRIPT = problem("block"), Path(package_runs.__file__)
ERRORS = (1e-3, 1e-5, 1e-8)
PATIENCE = 120.0
"""Seconds after which a run of a package is ended."""
Settings = dict[str, Any]
"""What `package_runs` gets beside the numbers of the problem."""


class Peer(NamedTuple):
    """How a package is used.

    Attributes
    ----------
    name : str
        The package and the form of the problem that it is given.
    package : str
    settings : callable
        From an error to the settings that might do, cheap ones first.
    thorough : bool
        Try all of them and take the fastest, as it is not clear which are cheap.
    """

    name: str
    package: str
    settings: Callable[[float], Iterator[Settings]]
    thorough: bool = False


def _steps(form: str, method: str) -> Callable[[float], Iterator[Settings]]:
    """Numbers of equal steps, a factor 1.4 apart; 3,000 at most with order 1."""
    most = 3_000.0 if method == "backward_euler" else 60_000.0

    def settings(wanted: float) -> Iterator[Settings]:
        steps = 30.0 if wanted > 1e-4 else 300.0 if wanted > 1e-6 else 8_000.0
        steps = min(steps, most)
        while steps <= most:
            yield {"form": form, "method": method, "steps": int(steps), "tol": 1e-3 * wanted}
            steps *= 1.4

    return settings


def _adaptive(form: str) -> Callable[[float], Iterator[Settings]]:
    def settings(wanted: float) -> Iterator[Settings]:
        for k in range(8):
            rtol = 10.0 * wanted * 10.0 ** (-k / 2)
            limit, tol = BLOCK.t_end / 10, 1e-3 * min(wanted, rtol)
            yield {"form": form, "method": "composite", "rtol": rtol, "h_max": limit, "tol": tol}

    return settings


def _elements(mode: str) -> Callable[[float], Iterator[Settings]]:
    """Radau IIA elements of 2 to 5 stages; the tolerances follow the error."""

    def settings(wanted: float) -> Iterator[Settings]:
        stages = (2, 3) if wanted > 1e-4 else (3, 4) if wanted > 1e-6 else (4, 5)
        for intervals, count, elements in itertools.product((5, 10, 20, 30), stages, (2, 3)):
            sizes = {"intervals": intervals, "stages": count, "elements": elements}
            yield {"mode": mode, **sizes, "tol": min(0.1 * wanted, 1e-6)}

    return settings


PEERS = (
    *(
        Peer(f"solve_nivp, {form}, {method}", "solve_nivp", _steps(form, method))
        for form in ("inclusion", "formula")
        for method in ("backward_euler", "trapezoidal", "composite")
        if (form, method) != ("inclusion", "trapezoidal")
    ),
    Peer("solve_nivp, formula, adaptive", "solve_nivp", _adaptive("formula")),
    *(
        Peer(f"nosnoc, {mode.lower()}", "nosnoc", _elements(mode), thorough=True)
        for mode in ("SCHOLTES_INEQ", "ELASTIC_INEQ")
    ),
)
"""inclusion: friction stated as a projection, which the package solves; formula: u' handed to it in
closed form, so that the package has an ordinary ODE to step through."""


class Answer(NamedTuple):
    """A run of a package: its error at its own nodes, inf if it failed, and how it failed."""

    error: float
    seconds: float = nan
    version: str = ""
    message: str = ""


def compare(pythons: dict[str, str], errors: Sequence[float], rounds: int) -> pd.DataFrame:
    """Our fastest way beside each package at each error; a row a package's use and error."""
    task = Task.of(BLOCK.process(), BLOCK.t_end)
    rows = []
    for wanted in errors if pythons else ():
        best = our_best(task, wanted)
        for peer in PEERS:
            if peer.package in pythons:
                rows.append(compared(peer, pythons[peer.package], wanted, best, rounds))
                print(rows[-1], file=sys.stderr)
    return pd.DataFrame(rows)


def our_best(task: Task, wanted: float) -> Result:
    """The fastest of our ways at an error."""
    results = {way.name: cheapest(task, way, wanted) for way in ours(task)}
    return results[timed(list(results.values()), rounds=3).way[0]]


def compared(peer: Peer, python: str, wanted: float, best: Result, rounds: int) -> dict[str, Any]:
    """A row: the package's cheapest setting that is accurate enough, timed in turn with ours."""
    tried: list[tuple[Answer, Settings]] = []
    for settings in peer.settings(wanted):
        tried.append((ask(python, peer.package, settings), settings))
        if tried[-1][0].error <= wanted and not peer.thorough:
            break
    enough = [one for one in tried if one[0].error <= wanted]
    if enough:
        answer, settings = min(enough, key=lambda one: one[0].seconds)
    else:
        answer, settings = min(tried, key=lambda one: one[0].error)
    left_out = ("form", "method", "mode", "h_max", "tol")
    words = [f"{key} {value:.3g}" for key, value in settings.items() if key not in left_out]
    row = {"wanted": wanted, "who": peer.name, "setting": ", ".join(words), "error": answer.error}
    if not enough:
        note = f"not reached {answer.message}".strip()
        return row | {"s": answer.seconds, "note": note}
    theirs, mine = [], []
    for _ in range(rounds):
        theirs.append(ask(python, peer.package, settings).seconds)
        mine.append(package_runs.timed(best.run.states)[0])
    return row | {
        "s": median(theirs),
        "ours": f"{best.way} {best.run.setting}",
        "our error": best.error,
        "our s": median(mine),
        "ratio": median(a / b for a, b in zip(theirs, mine, strict=True)),
        "note": answer.version,
    }


def ask(python: str, package: str, settings: Settings) -> Answer:
    """Run a package once in its own python and judge what it found."""
    friction = friction_of(BLOCK.process())
    case = {"a": friction.a, "b": friction.b, "g": friction.g, "t_end": BLOCK.t_end, **settings}
    command = [python, str(SCRIPT), package, json.dumps(case)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    except OSError as failure:
        return Answer(inf, message=f"({python}: {failure.strerror})")
    except subprocess.TimeoutExpired:
        return Answer(inf, message=f"(no end after {PATIENCE:g} s)")
    if done.returncode != 0:
        return Answer(inf, message=f"({(done.stderr.strip().splitlines() or ['it died'])[-1]})")
    found = json.loads(done.stdout)
    error = error_at_nodes(np.array(found["t"]), np.array(found["u"]))
    return Answer(error, found["seconds"], f"{package} {found['version']}")


def error_at_nodes(t: np.ndarray, u: np.ndarray) -> float:
    """The largest |u - exact| at the nodes of a run, inf if it did not come to the end."""
    kept = np.append(True, np.diff(t) > 1e-12 * BLOCK.t_end)  # elements may shrink to nothing
    t, u = t[kept], u[kept]
    # nosnoc's last element ends a little beside t_end
    if len(t) < 2 or abs(t[-1] - BLOCK.t_end) > 5e-3 * BLOCK.t_end or not np.isfinite(u).all():
        return inf
    exact = so.solve(BLOCK.process(), steps=t, scheme="exact").u[:, 0]
    return float(np.abs(u - exact).max())


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Other packages on the scalar case, beside ours.")
    parser.add_argument("--solve-nivp", metavar="PYTHON", help="one that has solve_nivp 0.1.2")
    parser.add_argument("--nosnoc", metavar="PYTHON", help="one that has nosnoc 0.2.0")
    parser.add_argument("--error", type=float, nargs="+", default=list(ERRORS))
    parser.add_argument("--rounds", type=int, default=3)
    chosen = parser.parse_args(arguments)
    named = {"solve_nivp": chosen.solve_nivp, "nosnoc": chosen.nosnoc}
    pythons = {package: python for package, python in named.items() if python}
    print(f"{machine()}\n{BLOCK.name}: {BLOCK.title}, a = b = 1, g = 0.3, f = sin t, t_end 10")
    for package in named.keys() - pythons:
        print(f"{package}: skipped, as no python that has it was named")
    table = compare(pythons, chosen.error, chosen.rounds)
    if len(table):
        print(table.to_string(index=False, na_rep="-", float_format="{:.3g}".format))


if __name__ == "__main__":
    main()
