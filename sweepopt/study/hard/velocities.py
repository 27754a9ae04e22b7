"""Hard programs: every one through every path and solver, the true error beside the certificate.

What makes a program hard was listed one by one; solvers fail where two or three of it meet. A case
names what it is made of, and a seed makes it.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, partial
from itertools import product
from math import nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sweepopt import loads
from sweepopt.checks import Array
from sweepopt.io import read_toml
from sweepopt.problem import SweepingProcess
from sweepopt.results import Solution
from sweepopt.sets import Moving, image
from sweepopt.study.hard import bodies
from sweepopt.study.hard.bodies import Random, between, chain, spectral
from sweepopt.study.hard.exact import Exact, Program
from sweepopt.study.hard.suite import TARGET, Judgement, run_case
from sweepopt.study.problems import construct

Names = Sequence[str]

EMPTY = "a strip that is missing by 1e-9"

# ---- cases ------------------------------------------------------------------------------------

STIFFNESS: dict[str, Callable[[Random, Array], Any]] = {
    "no B": lambda random, A: None,
    "B = 0": lambda random, A: None,
    "any B": lambda random, A: chain(random, len(A)),
    "B of rank one": lambda random, A: np.outer(*2 * [random.normal(size=len(A))]),
    "B = rho A, rho 1e-6 to 1e6": lambda random, A: 10.0 ** random.integers(-6, 7) * A,
    "B up to 1e10": lambda random, A: spectral(random, 0, 10, len(A)),
    "viscosity 1e-2 to 1e-12": lambda random, A: (
        10.0 ** -random.integers(2, 13) * A,
        chain(random, len(A)),
    ),
    "A = 0": lambda random, A: (0 * A, A),
    "all of B 1e10": lambda random, A: 1e10 * chain(random, len(A)),
}
"""B for a matrix A, or A and B in its place."""
DATA = read_toml(Path(__file__).with_suffix(".toml"))
MATRICES, CONTACTS, LOADS, UNITS, HISTORIES, FAMILIES = DATA.values()
TABLES = (MATRICES, CONTACTS, LOADS, UNITS, STIFFNESS, HISTORIES)


def entry_of(table: Mapping[str, Any], names: Names) -> Any:
    """The entry of a table that is named, the first one if none is."""
    return table[next((name for name in names if name in table), next(iter(table)))]


def make(names: Names, random: Random) -> SweepingProcess:
    """The process that these ingredients and a seed make."""
    A = construct(bodies, entry_of(MATRICES, names), random)
    n = len(A)
    few, part, edge, block = construct(bodies, entry_of(CONTACTS, names), random, n)
    length, force = entry_of(UNITS, names) or (2.0 ** random.integers(-40, 41, n), 1.0)
    units = length * np.ones(n)
    units[few] = np.repeat(units[few[::block]], block)
    _, _, start, *factors = entry_of(HISTORIES, names)
    terms: list[Any] = [
        (construct(loads, factor), force * units * _load(names, random, n, few, edge))
        for factor in factors
    ]
    B = entry_of(STIFFNESS, names)(random, A)
    A, B = (
        M if M is None else force * np.outer(units, units) * M
        for M in (B if isinstance(B, tuple) else (A, B))
    )
    u0 = start * random.normal(size=n) if start else np.zeros(n)
    if B is not None:
        terms.append((loads.Constant(), B @ u0))
    C = part(force * units[few])
    if not np.array_equal(few, np.arange(n)):
        C = image(np.eye(n)[:, few], C)
    return SweepingProcess(A, B, Moving(C, loads.Separable(terms)), u0)


def _load(names: Names, random: Random, n: int, few: Array, edge: Any) -> Array:
    shares = entry_of(LOADS, names)
    if not shares or edge is None:
        return 3 * random.normal(size=n)
    signs, *sizes = shares
    # one sign takes no number from the seed
    beside = random.choice(signs, few.size) if len(signs) > 1 else np.full(few.size, signs[0])
    if sizes:
        low, high = sizes
        beside *= between(random, low, high, few.size)
    return np.bincount(few, edge * (1 + beside), n)


def combination(random: Random) -> Names:
    """A matrix, contact, load, units and stiffness, drawn by chance."""
    # from so many first entries of the tables but the last one
    tables = zip(TABLES, (7, 11, 4, 7, 8), strict=False)
    names = [list(table)[random.integers(count)] for table, count in tables]
    if names[1:3] == ["a box", "another load"]:
        names[1] = "a box that names contacts twice"
    # what is at the threshold comes there and stays
    history = "a load that stays" if LOADS[names[2]] else "four steps"
    return (*names, "one step" if names[4] == "no B" else history)


# ---- runs -----

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
    seconds: float = nan
    verdict: str = ""


def hard_programs(
    seeds: Sequence[int] = (0,),
    families: Sequence[str] = tuple(FAMILIES),
    solvers: Sequence[str] = SOLVERS,
    paths: Sequence[str] = PATHS,
    combinations: int = 8,
    tol: float = 1e-9,
) -> Iterator[HardRow]:
    """Hard cases.

    Programs on which solvers alone fail, through every path and solver. Of each run the worst step,
    judged by its exact velocity: the true error stays below 1e-8 and below the certificate.

    Parameters
    ----------
    seeds : sequence of int
        Whole numbers >= 0; each makes every family anew.
    families, solvers, paths : sequence of str
        A solver or a path that cannot treat a case leaves no row.
    combinations : int
        How many cases are drawn by chance for each seed.
    tol : float
        What `solve` is asked for.

    Examples
    --------
    >>> row = next(hard_programs(families=["threshold"], solvers=["auto"]))
    >>> row.verdict, row.error < 1e-12
    ('met', True)
    """
    cases: list[Any] = [
        (name, seed, FAMILIES[name], np.random.default_rng(seed))
        for name, seed in product(families, seeds)
    ]
    for seed, k in product(seeds, range(combinations)):
        random = np.random.default_rng([seed, k])
        cases.append((f"combination {k}", seed, combination(random), random))
    for case in cases:
        yield from _runs(product(paths, solvers), tol, *case)


def _runs(
    methods: Iterable[Any], tol: float, name: str, seed: int, names: Names, random: Random
) -> Iterator[HardRow]:
    (t_end, steps, *_), process = entry_of(HISTORIES, names), make(names, random)
    mu = t_end / steps
    program = Program(process.A, process.B, mu)

    @cache
    def exact(t: float, *u: float) -> Exact:
        # the time as a step makes it
        return program.solve(np.array(u), process.C.at(t + mu))

    refused = "EmptySetError" if EMPTY in names else ""
    answer = f"refuse: {refused}" if refused else ""
    for path, solver in methods:
        row = run_case(
            HardRow(name, seed, path, solver, ", ".join(names), answer),
            process.as_sweeping,
            partial(_judge, program, exact),
            refused,
            t_end=t_end,
            steps=steps,
            scheme="implicit-euler",
            solver=solver,
            tol=tol,
            path=path,
        )
        if row:
            yield row


def _judge(program: Program, exact: Callable[..., Exact], solution: Solution, _: bool) -> Judgement:
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
    }
    return entries, {
        "no certificate": np.isnan(certificate),
        f"error above {TARGET:g}": error > TARGET,
        "certificate below the error": excess > 0,
    }
