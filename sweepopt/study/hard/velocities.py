"""Every hard case through every path and solver: the true error beside the certificate."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import product
from math import nan
from typing import Any, NamedTuple

import numpy as np

from sweepopt.problem import SweepingProcess
from sweepopt.results import Solution
from sweepopt.study.hard.bodies import Random
from sweepopt.study.hard.exact import Exact, Program
from sweepopt.study.hard.families import (
    FAMILIES,
    HISTORIES,
    REFUSED,
    Names,
    combination,
    entry_of,
    make,
)
from sweepopt.study.hard.suite import TARGET, Faults, Suite, run_case

PATHS = ("full", "eliminated", "proportional")
SOLVERS = ("auto", "newton", "daqp", "osqp", "clarabel", "cvxpy:osqp", "cvxpy:clarabel")


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


@dataclass(frozen=True)
class HardStudy(Suite):
    """Hard cases.

    Programs on which solvers alone fail, through every path and solver. Of each run the worst step,
    judged by its exact velocity: the true error stays below 1e-8 and below the certificate.

    Parameters
    ----------
    seeds : sequence of int
        Whole numbers >= 0; each makes every family anew.
    families, solvers, paths : sequence of str
    combinations : int
        How many cases are drawn by chance for each seed.
    tol : float
        What `solve` is asked for.
    """

    by = ("family",)

    seeds: Sequence[int] = (0,)
    families: Sequence[str] = tuple(FAMILIES)
    solvers: Sequence[str] = SOLVERS
    paths: Sequence[str] = PATHS
    combinations: int = 8
    tol: float = 1e-9

    def rows(self) -> Iterator[HardRow]:
        """Run the cases.

        A solver or a path that cannot treat a case leaves no row.

        Yields
        ------
        HardRow

        Examples
        --------
        >>> row = next(HardStudy(families=["threshold"], solvers=["auto"]).rows())
        >>> row.verdict, row.error < 1e-12
        ('met', True)
        """
        for name, seed, names, random in self._cases():
            (t_end, steps, *_), process = entry_of(HISTORIES, names), make(names, random)
            program = Program(process.A, process.B, t_end / steps)
            exact = cache(partial(_exact, process, program, t_end / steps))
            refused = entry_of(REFUSED, names)
            for path, solver in product(self.paths, self.solvers):
                answer = f"refuse: {refused}" if refused else ""
                row = run_case(
                    HardRow(name, seed, path, solver, ", ".join(names), answer),
                    process.as_sweeping,
                    partial(_judge, program, exact),
                    refused,
                    t_end=t_end,
                    steps=steps,
                    scheme="implicit-euler",
                    solver=solver,
                    tol=self.tol,
                    path=path,
                )
                if row:
                    yield row

    def _cases(self) -> Iterator[tuple[str, int, Names, Random]]:
        for name, seed in product(self.families, self.seeds):
            yield name, seed, FAMILIES[name], np.random.default_rng(seed)
        for seed, k in product(self.seeds, range(self.combinations)):
            random = np.random.default_rng([seed, k])
            yield f"combination {k}", seed, combination(random), random


def _exact(process: SweepingProcess, program: Program, mu: float, t: float, *u: float) -> Exact:
    # the time as a step makes it: a load may change within a rounding unit of t
    return program.solve(np.array(u), process.C.at(t + mu))


def _judge(
    program: Program, exact: Callable[..., Exact], solution: Solution, _: bool
) -> tuple[dict[str, Any], Faults]:
    """The last answer in words, the worst of all steps, and what is wrong with it."""
    stats = solution.stats
    # of a step that is taken in parts the velocity is the mean of theirs, of no one program
    right = [exact(t, *u) for t, u in zip(solution.t[:-1].tolist(), solution.u, strict=False)]
    steps = [
        program.compare(*step)
        for *step, solver in zip(
            right, solution.velocity, stats["certificate"], stats["solver"], strict=True
        )
        if "/" not in str(solver)
    ]
    error, certificate, excess = map(float, np.max(steps or [(nan, nan, nan)], axis=0))
    z, length = right[-1].z, program.error(0, right[-1])
    entries = {
        "answer": f"|z| = {length:.3g}, {np.count_nonzero(z)} of {len(z)} move",
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
