"""Every hard case through every path and solver: the true error beside the certificate."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from math import nan
from typing import NamedTuple

import numpy as np

from sweepopt.checks import count, number
from sweepopt.errors import (
    PathError,
    SolverRefusedError,
    SweepoptError,
    SweepoptWarning,
)
from sweepopt.solve import solve
from sweepopt.study.cell import named_solver
from sweepopt.study.hard.bodies import Random
from sweepopt.study.hard.families import FAMILIES, Names, chosen, combination, make
from sweepopt.study.hard.ingredients import HISTORIES, REFUSED, History
from sweepopt.study.hard.judge import Judge
from sweepopt.study.hard.trajectories import TRAJECTORIES, TrajectoryRow, judged
from sweepopt.study.records import each, known

TARGET = 1e-8
"""True error, relative to max(|z*|_M, |M^-1 q|_M), that every step has to meet."""
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
        each("seeds", self.seeds, count, 0)
        count("combinations", self.combinations, least=0)
        number("tol", self.tol, minimum=0.0, strict=True)
        lists = (("solvers", SOLVERS), ("paths", PATHS), ("families", FAMILIES))
        for key, names in (*lists, ("trajectories", TRAJECTORIES)):
            # without families or trajectories, this part is left out
            if key in ("solvers", "paths") or getattr(self, key) != []:
                each(key, getattr(self, key), known, names, "there are:")


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

    @property
    def good(self) -> bool:
        """Whether the right answer was given."""
        return self.verdict in ("met", "refused")


def rows(
    study: HardStudy, progress: Callable[[str], object] = lambda words: None
) -> Iterator[HardRow]:
    """Run the cases of a study.

    A solver or a path that cannot treat a case leaves no row; `progress` is called with the name
    of each case.

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
        progress(f"{name}, seed {seed}")
        history, process = chosen(HISTORIES, names), make(names, random)
        judge = Judge(process, history.t_end / history.steps)
        refused = chosen(REFUSED, names)
        answer = f"refuse: {refused.__name__}" if refused else ""
        for path, solver in product(study.paths, study.solvers):
            row = HardRow(name, seed, path, solver, ", ".join(names), answer)
            try:
                yield _run(judge, row, study.tol, history)
            except (SolverRefusedError, PathError):
                continue
            except SweepoptError as error:
                right = type(error) is refused
                words = "refused" if right else f"{type(error).__name__}: {error}"
                yield row._replace(verdict=words)


def _cases(study: HardStudy) -> Iterator[tuple[str, int, Names, Random]]:
    for name, seed in product(study.families, study.seeds):
        yield name, seed, FAMILIES[name], np.random.default_rng(seed)
    for seed, k in product(study.seeds, range(study.combinations)):
        random = np.random.default_rng([seed, k])
        yield f"combination {k}", seed, combination(random), random


def _run(judge: Judge, row: HardRow, tol: float, history: History) -> HardRow:
    """A run as a row: the last answer in words, and the worst of all steps."""
    started = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SweepoptWarning)
        solution = solve(
            judge.process,
            t_end=history.t_end,
            steps=history.steps,
            scheme="implicit-euler",
            solver=named_solver(row.solver),
            tol=tol,
            path=row.path,
        )
    seconds, stats = time.perf_counter() - started, solution.stats
    starts, answers = (solution.u, solution.t), (solution.velocity, stats["certificate"])
    # of a step that is taken in parts the velocity is the mean of theirs, of no one program
    judged = [
        judge.step(u, float(t), z, certificate)
        for u, t, z, certificate, solver in zip(*starts, *answers, stats["solver"], strict=False)
        if "/" not in str(solver)
    ]
    error, certificate, excess = map(float, np.max(judged or [(nan, nan, nan)], axis=0))
    exact = judge.exact(solution.u[-2], float(solution.t[-2]))
    length, moving = judge.program.norm(exact.z), np.count_nonzero(exact.z)
    faults = {
        "no certificate": np.isnan(certificate),
        f"error above {TARGET:g}": error > TARGET,
        "certificate below the error": excess > 0,
    }
    return row._replace(
        answer=f"|z| = {length:.3g}, {moving} of {len(exact.z)} move",
        error=error,
        certificate=certificate,
        excess=excess,
        solved_by=stats["solver"][-1],
        attempts=stats["attempts"].max(),
        seconds=seconds,
        verdict=next((words for words, fault in faults.items() if fault), "met"),
    )


def trajectory_rows(
    study: HardStudy, progress: Callable[[str], object] = lambda words: None
) -> Iterator[TrajectoryRow]:
    """Run the trajectories of a study through every scheme, as `rows` does its cases."""
    for name, seed in product(study.trajectories, study.seeds):
        progress(f"trajectory {name}, seed {seed}")
        yield from judged(name, seed, tol=study.tol)
