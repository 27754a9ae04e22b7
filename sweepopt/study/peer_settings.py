"""How each of the other packages is used: forms of the problem, methods, settings to be tried."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from sweepopt.study.problems import BLOCK

Settings = dict[str, Any]
"""What `peer_runs` is told beside the numbers of the problem."""


class Peer(NamedTuple):
    """How a package is used.

    Attributes
    ----------
    name : str
        The package and the form of the problem that it is given.
    package : str
    rungs : callable
        From an error to the settings that might do, cheap ones first.
    thorough : bool
        Try all of them and take the fastest, as it is not clear which are cheap.
    """

    name: str
    package: str
    rungs: Callable[[float], Iterator[Settings]]
    thorough: bool = False


def _steps(form: str, method: str) -> Callable[[float], Iterator[Settings]]:
    """Numbers of equal steps, a factor 1.4 apart; 3,000 at most with order 1."""
    most = 3_000.0 if method == "backward_euler" else 60_000.0

    def rungs(wanted: float) -> Iterator[Settings]:
        steps = 30.0 if wanted > 1e-4 else 300.0 if wanted > 1e-6 else 8_000.0
        steps = min(steps, most)
        while steps <= most:
            yield {"form": form, "method": method, "steps": int(steps), "tol": 1e-3 * wanted}
            steps *= 1.4

    return rungs


def _adaptive(form: str) -> Callable[[float], Iterator[Settings]]:
    def rungs(wanted: float) -> Iterator[Settings]:
        for k in range(8):
            rtol = 10.0 * wanted * 10.0 ** (-k / 2)
            limit, tol = BLOCK.t_end / 10, 1e-3 * min(wanted, rtol)
            yield {"form": form, "method": "composite", "rtol": rtol, "h_max": limit, "tol": tol}

    return rungs


def _elements(mode: str) -> Callable[[float], Iterator[Settings]]:
    """Radau IIA elements of 2 to 5 stages; the tolerances follow the error."""

    def rungs(wanted: float) -> Iterator[Settings]:
        stages = (2, 3) if wanted > 1e-4 else (3, 4) if wanted > 1e-6 else (4, 5)
        for intervals, count, elements in itertools.product((5, 10, 20, 30), stages, (2, 3)):
            sizes = {"intervals": intervals, "stages": count, "elements": elements}
            yield {"mode": mode, **sizes, "tol": min(0.1 * wanted, 1e-6)}

    return rungs


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
