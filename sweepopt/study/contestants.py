"""Who takes part: the library's paths and the loops by hand, as tables."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from math import inf

import numpy as np

from sweepopt.solve import solve
from sweepopt.study import by_hand
from sweepopt.study.by_hand import Run, loop, steady
from sweepopt.study.cases import SCHEME, Case


@dataclass(frozen=True)
class Contestant:
    """A way to compute a trajectory.

    Attributes
    ----------
    path : str
    run : callable
        Case -> Run.
    accuracy : float
        How far from the reference it may be, relative; what the tests hold it to.
    limit : float
        Most unknowns it is asked for.
    friction : bool
        Whether it computes the process, or the one without its set.
    floor : str
        The loop by hand that solves the same programs with the same settings, without proof.
    needs : str
        A package without which it does not take part.
    """

    path: str
    run: Callable[[Case], Run]
    accuracy: float
    limit: float = inf
    friction: bool = True
    floor: str = ""
    needs: str = "numpy"


def library(
    path: str, solver: str = "auto", friction: bool = True, tol: float = 1e-6
) -> Callable[[Case], Run]:
    """`sweepopt.solve` on one path.

    A step costs what the loop's own clock says (`steady`), and its share of the look at C(t) on all
    times that precedes the loop. The rest of the call is set-up.
    """

    def run(case: Case) -> Run:
        begun = clock.perf_counter()
        problem = case.problem if friction else case.frictionless
        assert problem is not None
        process = problem.as_sweeping()
        sol = solve(
            process,
            t_end=float(case.times[-1]),
            steps=case.steps,
            scheme=SCHEME,
            solver=solver,
            tol=tol,
            path=path,
        )
        done = clock.perf_counter()
        u = np.asarray(sol.u)
        read = clock.perf_counter()
        process.check(case.times)
        checked = clock.perf_counter()
        step = steady(sol.stats["seconds"]) + (checked - read) / case.steps
        return Run(
            u,
            step,
            done - begun - step * case.steps,
            (read - done) / case.steps,
            float(sol.stats["relative"].max()),
            float(sol.stats["attempts"].mean()),
        )

    return run


def whole(run: Callable[[Case], Run]) -> Callable[[Case], Run]:
    """The same with its set-up shared by the steps: what a tiny process costs all in all."""

    def shared(case: Case) -> Run:
        found = run(case)
        wall = found.setup + found.step * case.steps
        return found._replace(step=wall / case.steps, setup=0.0)

    return shared


def reference(case: Case, friction: bool = True) -> Run:
    """The library's most accurate answers, for a process without its set one linear solve."""
    return library(case.best if friction else "full", friction=friction, tol=1e-9)(case)


PROVED = 1e-6  # what the certificates of the library's default tol allow
PATIENT, NAIVE = 30_000, 11_000  # seconds a step beyond

CONTESTANTS = (
    Contestant("proportional", library("proportional"), 1e-10),
    Contestant("eliminated", library("eliminated"), 1e-10),
    Contestant(
        "frictionless",
        library("full", friction=False),
        1e-12,
        friction=False,
        floor="linear-by-hand",
    ),
    Contestant("linear-by-hand", loop(by_hand.linear_by_hand), 1e-12, friction=False),
    Contestant("multigrid", library("multigrid"), 1e-7, needs="pyamg"),
    Contestant("full-auto", library("full"), PROVED, PATIENT),
    Contestant(
        "full-clarabel", library("full", "clarabel"), PROVED, PATIENT, floor="clarabel-floor"
    ),
    Contestant("clarabel-floor", loop(by_hand.clarabel_same_program), 1e-4, PATIENT),
    Contestant("full-osqp", library("full", "osqp"), PROVED, PATIENT, floor="osqp-floor"),
    Contestant("osqp-floor", loop(by_hand.osqp_same_program), 1e-4, PATIENT),
    Contestant("clarabel-by-hand", loop(by_hand.clarabel_by_hand), 1e-4, PATIENT),
    Contestant("osqp-by-hand", loop(by_hand.osqp_by_hand), 1e-4, PATIENT),
    Contestant("cvxpy-parameters", loop(by_hand.cvxpy_parameters), 1e-3, NAIVE),
    Contestant("cvxpy-rebuilt", loop(by_hand.cvxpy_rebuilt), 1e-3, NAIVE),
    Contestant("cvxpy-checked", loop(by_hand.cvxpy_checked), 1e-3, NAIVE),
)
"""Of a square; the loop by hand that a path is compared with runs next to it."""

TINY = (
    Contestant("closed-form", whole(library("auto")), 1e-12, floor="closed-form-by-hand"),
    Contestant("closed-form-by-hand", whole(loop(by_hand.closed_form_by_hand)), 1e-12),
)
"""Of blocks on springs."""
