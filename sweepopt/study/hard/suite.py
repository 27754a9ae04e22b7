"""Every hard case through every path and solver: the true error beside the certificate."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from math import nan
from typing import Any, NamedTuple

import numpy as np

from sweepopt.checks import count, number
from sweepopt.errors import (
    InputError,
    PathError,
    SolverRefusedError,
    SweepoptError,
    SweepoptWarning,
    shown,
)
from sweepopt.integrate import StepInfo
from sweepopt.solve import solve
from sweepopt.study.hard import FAMILIES
from sweepopt.study.hard.bodies import Hard
from sweepopt.study.hard.combinations import combination
from sweepopt.study.hard.judge import Judge
from sweepopt.study.records import each, known, read_record
from sweepopt.velocity import Cvxpy

TARGET = 1e-8
"""True error, relative to max(|z*|_M, |M^-1 q|_M), that every step has to meet."""
ROUNDING = 16 * np.finfo(float).eps
"""Relative to the forces: a load above its threshold by no more counts as stuck."""
UNKNOWN = "not known"
"""The answer of a case that 60 digits did not solve: nothing is said of the solvers then."""
PATHS = ("full", "eliminated", "proportional")
SOLVERS: dict[str, Any] = {
    "auto": "auto",
    "newton": "newton",
    "daqp": "daqp",
    "osqp": "osqp",
    "clarabel": "clarabel",
    "cvxpy:osqp": Cvxpy("OSQP"),
    "cvxpy:clarabel": Cvxpy("CLARABEL"),
}


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
    solvers: Sequence[str] = tuple(SOLVERS)
    paths: Sequence[str] = PATHS
    combinations: int = 8
    tol: float = 1e-9

    def __post_init__(self) -> None:
        each("seeds", self.seeds, partial(count, least=0))
        count("combinations", self.combinations, least=0)
        number("tol", self.tol, minimum=0.0, strict=True)
        for key, names in (("families", FAMILIES), ("solvers", SOLVERS), ("paths", PATHS)):
            each(key, getattr(self, key), known(names, "there are:"))


def hard_study(data: Any, where: str = "") -> HardStudy:
    """The table [hard] of a study file; InputError names the key at fault."""
    if not isinstance(data, dict):
        raise InputError(f"{where}hard must be a table, got {shown(data)}")
    return read_record(f"{where}hard.", HardStudy, data)


class HardRow(NamedTuple):
    """One hard case, path and solver; the worst of its steps.

    Attributes
    ----------
    drawn : str
        What is hard about a combination.
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
    families: Iterable[str] = FAMILIES,
    seeds: Iterable[int] = (0,),
    *,
    solvers: Iterable[str] = SOLVERS,
    paths: Iterable[str] = PATHS,
    combinations: int = 0,
    tol: float = 1e-9,
    progress: Callable[[str], object] = lambda words: None,
) -> Iterator[HardRow]:
    """Run the cases; the parameters are those of `HardStudy`.

    A solver or a path that cannot treat a case leaves no row; `progress` is called with the name
    of each case.

    Yields
    ------
    HardRow

    Examples
    --------
    >>> row = next(rows(["threshold"], solvers=["auto"]))
    >>> row.verdict, row.error < 1e-12
    ('met', True)
    """
    seeds, solvers, paths = list(seeds), list(solvers), list(paths)
    for name, seed, hard in _cases(families, seeds, combinations):
        progress(f"{name}, seed {seed}")
        answer = "" if hard.refused is None else f"refuse: {hard.refused.__name__}"
        row = HardRow(name, seed, "", "", hard.drawn, answer)
        try:
            judge = Judge(hard.process(), hard.t_end / hard.steps)
        except SweepoptError as error:
            yield row._replace(verdict=_verdict_on(error, hard))
            continue
        for path in paths:
            for solver in solvers:
                row = row._replace(path=path, solver=solver)
                try:
                    yield _run(hard, judge, row, tol)
                except (SolverRefusedError, PathError):
                    continue
                except SweepoptError as error:
                    yield row._replace(verdict=_verdict_on(error, hard))


def _cases(
    families: Iterable[str], seeds: list[int], combinations: int
) -> Iterator[tuple[str, int, Hard]]:
    for name in families:
        for seed in seeds:
            yield name, seed, FAMILIES[name](np.random.default_rng(seed))
    for seed in seeds:
        for k in range(combinations):
            yield f"combination {k}", seed, combination(np.random.default_rng([seed, k]))


def _verdict_on(error: SweepoptError, hard: Hard) -> str:
    if hard.refused is not None and isinstance(error, hard.refused):
        return "refused"
    return f"{type(error).__name__}: {error}"


def _run(hard: Hard, judge: Judge, row: HardRow, tol: float) -> HardRow:
    """A run as a row: the last answer in words, and the worst of all steps."""
    steps: list[StepInfo] = []
    started = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SweepoptWarning)
        solution = solve(
            judge.process,
            t_end=hard.t_end,
            steps=hard.steps,
            scheme="implicit-euler",
            solver=SOLVERS[row.solver],
            tol=tol,
            path=row.path,
            callback=lambda step: steps.append(step),
        )
    row = row._replace(seconds=time.perf_counter() - started)
    u, error, certificate, excess, judged = judge.process.u0, 0.0, 0.0, 0.0, 0
    for step, solver, t in zip(steps, solution.stats["solver"], solution.t, strict=False):
        before, u = u, step.u
        if "/" in str(solver):
            continue  # taken in parts: its velocity is the mean of theirs, of no one program
        try:
            # the time as a step makes it: a load may change within a rounding unit of t
            exact = judge.of(before, float(t) + hard.t_end / hard.steps)
        except SweepoptError as failure:
            return row._replace(answer=UNKNOWN, verdict=str(failure))
        apart, size = judge.program.error(step.velocity, exact), exact.size or 1.0
        judged, error = judged + 1, max(error, apart / size)
        certificate = float(
            np.maximum(certificate, step.certificate / size)
        )  # nan if there is none
        allowed = 0.0 if step.velocity.any() else ROUNDING
        excess = max(excess, (apart - step.certificate) / (exact.forces or 1.0) - allowed)
        answer = f"|z| = {exact.length:.3g}, {np.count_nonzero(exact.z)} of {len(u)} move"
        row = row._replace(answer=answer)
    verdicts = {
        f"not refused: {getattr(hard.refused, '__name__', '')} is right": hard.refused is not None,
        "all steps were taken in parts: none is judged": not judged,
        "no certificate": np.isnan(certificate),
        f"error above {TARGET:g}": error > TARGET,
        "certificate below the error": excess > 0,
        "met": True,
    }
    return row._replace(
        error=error,
        certificate=certificate,
        excess=excess,
        solved_by=str(solution.stats["solver"][-1]),
        attempts=int(solution.stats["attempts"].max()),
        verdict=next(words for words, so in verdicts.items() if so),
    )


def hard_summary(rows: Sequence[HardRow]) -> str:
    """A line a family, and each row with a wrong answer."""
    lines = [f"{'family':<20}{'runs':>6}{'true error':>12}{'certificate':>13}  solved by"]
    for name, group in groupby(rows, key=lambda row: row.family):
        mine = list(group)
        error = max((row.error for row in mine if row.solved_by), default=nan)
        stated = max((row.certificate for row in mine if row.solved_by), default=nan)
        solvers = ", ".join(sorted({row.solved_by or "refused" for row in mine}))
        lines.append(f"{name:<20}{len(mine):6}{error:12.1e}{stated:13.1e}  {solvers}")
    wrong = [row for row in rows if not row.good]
    lines += ["", f"{len(rows)} runs, {len(wrong)} wrong"]
    lines += [f"  {row.family} {row.seed} {row.path} {row.solver}: {row.verdict}" for row in wrong]
    return "\n".join(lines)
