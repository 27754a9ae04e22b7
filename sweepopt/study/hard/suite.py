"""Every hard case through every path and solver: the true error beside the certificate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from math import nan
from typing import Any, NamedTuple

import numpy as np

from sweepopt.checks import count, number
from sweepopt.problem import SweepingProcess
from sweepopt.results import Solution
from sweepopt.study.hard.bodies import Random
from sweepopt.study.hard.exact import Judge
from sweepopt.study.hard.families import (
    FAMILIES,
    HISTORIES,
    REFUSED,
    Names,
    chosen,
    combination,
    make,
)
from sweepopt.study.hard.trajectories import TRAJECTORIES, TrajectoryRow, runs
from sweepopt.study.hard.verdicts import TARGET, Faults, judged
from sweepopt.study.records import among, check_lists

PATHS = ("full", "eliminated", "proportional")
SOLVERS = ("auto", "newton", "daqp", "osqp", "clarabel", "cvxpy:osqp", "cvxpy:clarabel")


@dataclass(frozen=True)
class HardStudy:
    """What `sweepopt study hard` runs; all there is by default.

    Parameters
    ----------
    seeds : sequence of int
        Whole numbers >= 0; each makes every family anew.
    families, solvers, paths : sequence of str
    combinations : int
        How many cases are drawn by chance for each seed.
    trajectories : sequence of str
        Rows of trajectories.toml; each seed draws every one of them anew.
    tol : float
        What `solve` is asked for.

    Raises
    ------
    InputError
        Naming the key and the entry.

    Examples
    --------
    >>> HardStudy(seeds=[0, 1], families=["threshold"]).families
    ['threshold']
    """

    seeds: Sequence[int] = (0,)
    families: Sequence[str] = tuple(FAMILIES)
    solvers: Sequence[str] = SOLVERS
    paths: Sequence[str] = PATHS
    combinations: int = 8
    trajectories: Sequence[str] = tuple(TRAJECTORIES)
    tol: float = 1e-9

    def __post_init__(self) -> None:
        count("combinations", self.combinations, least=0)
        number("tol", self.tol, minimum=0.0, strict=True)
        names = {"solvers": SOLVERS, "paths": PATHS}
        if self.families != []:  # without any, this part is left out
            names["families"] = tuple(FAMILIES)
        if self.trajectories != []:
            names["trajectories"] = tuple(TRAJECTORIES)
        check_lists(self, seeds=(count, 0), **{key: among(known) for key, known in names.items()})


class HardRow(NamedTuple):
    """One hard case, path and solver; the worst of its steps.

    Attributes
    ----------
    drawn : str
        What is hard about it.
    answer : str
        The true one: of the last step, or the error that is right.
    error, certificate : float
        True and stated |z - z*|_M, relative to max(|z*|_M, |M^-1 q|_M).
    excess : float
        Largest error - certificate in the unit of the forces, less ROUNDING where nothing moves:
        above 0 a certificate was wrong.
    solved_by, attempts : str, int
        Which solver answered the last step, and the most attempts at a step.
    seconds : float
        Of the run.
    verdict : str
        "met", "refused" where that is right, else what is wrong.
    """

    family: str
    seed: int
    path: str
    solver: str
    drawn: str = ""
    answer: str = ""
    error: float = nan
    certificate: float = nan
    excess: float = nan
    solved_by: str = ""
    attempts: int = 0
    seconds: float = nan
    verdict: str = ""


def rows(study: HardStudy) -> Iterator[HardRow]:
    """Run the cases of a study.

    A solver or a path that cannot treat a case leaves no row.

    Yields
    ------
    HardRow

    Examples
    --------
    >>> row = next(rows(HardStudy(families=["threshold"], solvers=["auto"])))
    >>> row.verdict, row.error < 1e-12
    ('met', True)
    """
    for name, seed, names, random in _cases(study):
        (t_end, steps, *_), process = chosen(HISTORIES, names), make(names, random)
        exact = Judge(process, t_end / steps)
        refused = chosen(REFUSED, names)
        for path, solver in product(study.paths, study.solvers):
            row = HardRow(name, seed, path, solver, ", ".join(names))
            row = judged(
                row._replace(answer=f"refuse: {refused}" if refused else ""),
                partial(SweepingProcess.as_sweeping, process),
                partial(_judge, exact),
                refused,
                t_end=t_end,
                steps=steps,
                scheme="implicit-euler",
                solver=solver,
                tol=study.tol,
                path=path,
            )
            if row:
                yield row


def _cases(study: HardStudy) -> Iterator[tuple[str, int, Names, Random]]:
    for name, seed in product(study.families, study.seeds):
        yield name, seed, FAMILIES[name], np.random.default_rng(seed)
    for seed, k in product(study.seeds, range(study.combinations)):
        random = np.random.default_rng([seed, k])
        yield f"combination {k}", seed, combination(random), random


def _judge(judge: Judge, solution: Solution, _: bool) -> tuple[dict[str, Any], Faults]:
    """The last answer in words, the worst of all steps, and what is wrong with it."""
    stats = solution.stats
    # of a step that is taken in parts the velocity is the mean of theirs, of no one program
    proved = stats["certificate"], stats["solver"]
    starts = solution.u, solution.t.tolist(), solution.velocity
    steps = [
        judge.step(*step)
        for *step, solver in zip(*starts, *proved, strict=False)
        if "/" not in str(solver)
    ]
    error, certificate, excess = map(float, np.max(steps or [(nan, nan, nan)], axis=0))
    z = judge.exact(solution.u[-2], float(solution.t[-2])).z
    entries = {
        "answer": f"|z| = {judge.program.norm(z):.3g}, {np.count_nonzero(z)} of {len(z)} move",
        "error": error,
        "certificate": certificate,
        "excess": excess,
        "solved_by": stats["solver"][-1],
        "attempts": stats["attempts"].max(),
    }
    return entries, {
        "no certificate": np.isnan(certificate),
        f"error above {TARGET:g}": error > TARGET,
        "certificate below the error": excess > 0,
    }


def trajectory_rows(study: HardStudy) -> Iterator[TrajectoryRow]:
    """Run the trajectories of a study through every scheme, as `rows` does its cases."""
    for name, seed in product(study.trajectories, study.seeds):
        yield from runs(name, seed, tol=study.tol)
