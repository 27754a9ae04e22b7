"""Every hard case through every path and solver: the true error beside the certificate."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from sweepopt.errors import PathError, SolverRefusedError, SweepoptError, SweepoptWarning
from sweepopt.integrate import StepInfo
from sweepopt.linalg import EPS
from sweepopt.problem import SweepingProcess
from sweepopt.results import Solution
from sweepopt.sets import Moving
from sweepopt.solve import solve
from sweepopt.study.hard import FAMILIES
from sweepopt.study.hard.bodies import Hard
from sweepopt.study.hard.combinations import combination
from sweepopt.study.hard.exact import Exact, Program
from sweepopt.velocity import Cvxpy

TARGET = 1e-8
"""True error, relative to max(|z*|_M, |M^-1 q|_M), that every step has to meet."""
SLACK = 16 * EPS
"""What a body may miss that is at rest, relative to the forces: its rule calls this rounding."""
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
        Largest error - certificate in the unit of the forces, less SLACK where nothing moves:
        above 0 a certificate was wrong.
    rung, attempts : str, int
        Who found the last step, and the longest way to a step.
    seconds : float
        Of the run.
    verdict : str
        "met", "refused" where that is right, else what is wrong.
    """

    family: str
    seed: int
    path: str
    solver: str
    drawn: str
    answer: str
    error: float
    certificate: float
    excess: float
    rung: str
    attempts: int
    seconds: float
    verdict: str

    @property
    def good(self) -> bool:
        """Whether the right answer was given."""
        return self.verdict in ("met", "refused")


class Judge:
    """The exact velocities of one case, found once for all of its runs."""

    def __init__(self, process: SweepingProcess, gamma: float) -> None:
        self._program, self._process = Program(process.A, process.B, gamma), process
        self._known: dict[bytes, Exact] = {}

    def of(self, u: np.ndarray, t: float, near: np.ndarray) -> Exact:
        """The velocity of the state u for C(t): from A, B and u, where nothing is rounded."""
        C = self._process.C.at(t)
        key = (b"" if self._process.B is None else u.tobytes()) + (
            C.anchor.tobytes() if isinstance(self._process.C, Moving) else b""
        )
        if not isinstance(self._process.C, Moving):
            key += np.float64(t).tobytes()
        if key not in self._known:
            self._known[key] = self._program.solve(self._program.term(u), C, near)
        return self._known[key]

    def error(self, z: np.ndarray, exact: Exact) -> float:
        """|z - z*|_M."""
        return self._program.error(z, exact)


def rows(
    families: Iterable[str] = FAMILIES,
    seeds: Iterable[int] = (0,),
    *,
    solvers: Iterable[str] = SOLVERS,
    paths: Iterable[str] = PATHS,
    combinations: int = 0,
    tol: float = 1e-6,
    progress: Callable[[str], None] = lambda words: None,
) -> Iterator[HardRow]:
    """Run the cases.

    Parameters
    ----------
    families : iterable of str
        Names in FAMILIES.
    seeds : iterable of int
    solvers : iterable of str
        Names in SOLVERS; those that cannot treat a case leave no row.
    paths : iterable of str
    combinations : int
        How many cases are drawn by chance for each seed.
    tol : float
        What `solve` is asked for.
    progress : callable
        Told each case.

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
    for case in _cases(families, seeds, combinations):
        progress(f"{case.name}, seed {case.seed}")
        try:
            process, judge = case.hard.process(), None
        except SweepoptError as error:
            yield _row(case, "", "", f"{type(error).__name__}: {error}", None)
            continue
        for path in paths:
            for solver in solvers:
                found = _run(case.hard, process, path, SOLVERS[solver], tol)
                if found is None:
                    continue
                if isinstance(found, _Run) and judge is None:
                    judge = Judge(process, case.hard.t_end / case.hard.steps)
                yield _row(case, path, solver, found, judge)


class _Case(NamedTuple):
    name: str
    seed: int
    hard: Hard


def _cases(families: Iterable[str], seeds: list[int], combinations: int) -> Iterator[_Case]:
    for name in families:
        for seed in seeds:
            yield _Case(name, seed, FAMILIES[name](np.random.default_rng(seed)))
    for seed in seeds:
        for k in range(combinations):
            random = np.random.default_rng([seed, k])
            yield _Case(f"combination {k}", seed, combination(random))


class _Run(NamedTuple):
    solution: Solution
    steps: list[StepInfo]
    seconds: float


def _run(
    hard: Hard, process: SweepingProcess, path: str, solver: Any, tol: float
) -> _Run | str | None:
    """The run, an error as a sentence, or None if the path or the solver does not apply."""
    steps: list[StepInfo] = []

    def keep(step: StepInfo) -> None:
        steps.append(step)

    started = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SweepoptWarning)
            solution = solve(
                process,
                t_end=hard.t_end,
                steps=hard.steps,
                scheme="implicit-euler",
                solver=solver,
                tol=tol,
                path=path,
                callback=keep,
            )
    except (SolverRefusedError, PathError):
        return None
    except SweepoptError as error:
        if hard.refused is not None and isinstance(error, hard.refused):
            return ""
        return f"{type(error).__name__}: {error}"
    return _Run(solution, steps, time.perf_counter() - started)


def _row(case: _Case, path: str, solver: str, found: _Run | str, judge: Judge | None) -> HardRow:
    hard, nan = case.hard, float("nan")
    which = case.name, case.seed, path, solver, hard.drawn
    if isinstance(found, str) or judge is None:
        answer = "" if hard.refused is None else f"refuse: {hard.refused.__name__}"
        return HardRow(*which, answer, nan, nan, nan, "", 0, nan, str(found) or "refused")
    try:
        judged = _judged(hard, found, judge)
    except SweepoptError as error:
        return HardRow(*which, UNKNOWN, nan, nan, nan, "", 0, found.seconds, str(error))
    verdict = "met"
    if hard.refused is not None:
        verdict = f"not refused: {hard.refused.__name__} is right"
    elif judged.error > TARGET:
        verdict = f"error above {TARGET:g}"
    elif judged.excess > 0:
        verdict = "certificate below the error"
    stats = found.solution.stats
    found_by = str(stats["solver"][-1]), int(stats["attempts"].max())
    return HardRow(*which, *judged, *found_by, found.seconds, verdict)


class _Judged(NamedTuple):
    answer: str
    error: float
    certificate: float
    excess: float


def _judged(hard: Hard, run: _Run, judge: Judge) -> _Judged:
    """The last answer in words, and the worst of all steps."""
    process, t = run.solution.process, run.solution.t
    solvers = run.solution.stats["solver"]
    error = certificate = excess = 0.0
    answer, u = "", process.u0
    for step in run.steps:
        if "/" in str(solvers[step.step]):
            u = step.u
            continue  # taken in parts: its velocity is the mean of theirs, of no one program
        # the time as a step makes it: a load may change within a rounding unit of t
        at = float(t[step.step]) + hard.t_end / hard.steps
        exact = judge.of(u, at, step.velocity)
        missed, size = judge.error(step.velocity, exact), exact.size or 1.0
        error, certificate = max(error, missed / size), max(certificate, step.certificate / size)
        slack = 0.0 if step.velocity.any() else SLACK
        excess = max(excess, (missed - step.certificate) / (exact.forces or 1.0) - slack)
        answer = f"|z| = {exact.length:.3g}, {np.count_nonzero(exact.z)} of {process.dim} move"
        u = step.u
    return _Judged(answer, error, certificate, excess)
