"""Stiff bodies: what scheme "auto" makes of them, beside the best of three schemes; one table.

A body, a load and a seed make a process; its A is scaled such that step * Lam is that of the row.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from sweepopt.driver import solve
from sweepopt.loads import Separable, Sine, Table
from sweepopt.problem import SweepingProcess
from sweepopt.results import Solution
from sweepopt.sets import Balls, Box, ConvexSet, Moving
from sweepopt.study.cell import REFINED, largest_norm, reference_states
from sweepopt.study.hard.bodies import Random, chain, spectral
from sweepopt.study.hard.suite import TARGET, Judgement, run_case

BEST_OF = ("implicit-euler", "midpoint", "sdirk2")


Body = tuple[Any, Any, ConvexSet, np.ndarray]
"""A and B, the set C(t) less the load, and two shapes of loads in columns."""
BODIES = {"one mass": 1, "chain": 7, "mixed": 7, "discs": 4, "square": 0}
"""How many unknowns; of the square so many as its mesh has."""


def _body(name: str, random: Random) -> Body:
    if name == "square":
        return _square(random)
    discs, n = name == "discs", BODIES[name]
    A = B = np.eye(n)
    if n > 1:
        A = spectral(random, -6, 0, n) if name == "mixed" else chain(random, n)
        B = chain(random, n)
    g = random.uniform(0.5, 1.2, 2) if discs else random.uniform(0.3, 1.2, n)
    shapes = random.normal(size=(n, 2))
    shapes *= 2.5 * math.sqrt(n) / np.linalg.norm(shapes, axis=0)
    return A, B, Balls(g, 2) if discs else Box(-g, g), shapes


def _square(random: Random) -> Body:
    """The scene "square", pulled and twisted; its loads have any history."""
    from sweepopt.fem import read_scene

    g, pull, force = random.uniform([0.3, 2, 2], [0.8, 4, 4]).tolist()
    changes = {
        "domain.refinements": 1,
        "effects.elasticity.kappa": 1.0,
        "effects.friction.g": g,
        "effects.traction.f2": pull,
        "effects.body_force": {"f0": force, "history": {"waveform": "constant"}},
    }
    problem: Any = read_scene("square", changes=changes).problem
    return problem.A, problem.B, -problem.dissipation, problem.load.shapes


def _table(random: Random) -> Table:
    times = np.concatenate([[0.0], np.sort(random.uniform(0, 1, 6)), [1.0]])
    return Table(times, random.uniform(0.5, 1.5, 8) * (-1.0) ** np.arange(8) * (times > 0))


LOADS: dict[str, Callable[[Random], Any]] = {
    "sines": lambda random: Sine(1.0, 1 / random.uniform(1, 4)),
    "tables": _table,
}


class StiffRow(NamedTuple):
    """A run with scheme "auto".

    Attributes
    ----------
    error : float
        The largest of all nodes, in the norm of A, of B where A = 0.
    over_best, bound_over_error : float
        The error over the smallest one of BEST_OF; the error bound over the error at all nodes
        of the reference, of which REFINED are in a step.
    ringing : float
        Total variation of the velocities over that of the reference's means in the same steps.
    false_sticks : int
        Steps in which an unknown's velocity is 0.0 that slips all the time.
    verdict : str
        "met", or what is wrong.
    """

    body: str
    load: str
    mu_Lam: float
    steps: int
    seed: int
    scheme: str = ""
    error: float = math.nan
    over_best: float = math.nan
    bound_over_error: float = math.nan
    ringing: float = math.nan
    false_sticks: int = 0
    seconds: float = math.nan
    verdict: str = ""


def make(body: str, load: str, seed: int, mu_Lam: float, steps: int) -> SweepingProcess:
    """The process of a row, on [0, 1]."""
    random = np.random.default_rng(seed)
    A, B, C, shapes = _body(body, random)
    terms = [(LOADS[load](random), shape) for shape in shapes.T]
    u0 = np.zeros(len(shapes))
    factor = SweepingProcess(A, B, C, u0).Lam / steps / mu_Lam
    return SweepingProcess(factor * A, B, Moving(C, Separable(terms)), u0)


def stiff_bodies(
    seeds: Sequence[int] = (0,),
    bodies: Sequence[str] = tuple(BODIES),
    loads: Sequence[str] = tuple(LOADS),
    stiffness: Sequence[float] = (1e-2, 1.0, 4.0, 1e2, 1e8, math.inf),
    steps: Sequence[int] = (60,),
    bounds: bool = True,
) -> Iterator[StiffRow]:
    """Stiff bodies.

    Scheme "auto" beside the best of three: its error is at most twice theirs and below its bound,
    its velocities do not ring, and what slips does not rest.

    Parameters
    ----------
    seeds : sequence of int
    bodies, loads : sequence of str
    stiffness : sequence of float
        step * Lam; infinite for A = 0.
    steps : sequence of int
    bounds : bool
        Whether each run's error bound is computed.

    Examples
    --------
    >>> row = next(stiff_bodies(bodies=["one mass"], loads=["sines"], stiffness=[1e6]))
    >>> row.scheme, row.over_best < 2, row.false_sticks
    ('sdirk32', True, 0)
    """
    for body, load, seed, mu_Lam, n in product(bodies, loads, seeds, stiffness, steps):
        process = make(body, load, seed, mu_Lam, n)
        yield _judge(StiffRow(body, load, mu_Lam, n, seed), process, bounds)


def _ratio(x: float, y: float) -> float:
    """x / y; 1 where a body that never moves makes both 0."""
    return float(x / y) if y else math.inf if x else 1.0


def _judge(row: StiffRow, process: SweepingProcess, bounds: bool) -> Any:
    """The row with what a run of a process on [0, 1] is worth."""
    how: Any = {"t_end": 1.0, "steps": row.steps, "tol": TARGET, "on_unstable": "ignore"}

    def compare(sol: Solution, _: bool) -> Judgement:
        reference = reference_states(process, 1.0, row.steps, 1)
        fine, exact = reference.u, reference.u[::REFINED]
        moves = np.diff(fine, axis=0).reshape(row.steps, REFINED, -1)
        others = [solve(process, scheme=scheme, **how) for scheme in BEST_OF]
        error, *least = (largest_norm(process, one.u - exact) for one in (sol, *others))
        between = largest_norm(process, sol(np.linspace(0, 1, len(fine))) - fine)
        bound = float(sol.error_bound()) if bounds else math.nan
        means = moves.sum(axis=1) * row.steps
        rings, changes = (abs(np.diff(z, axis=0)).sum() for z in (sol.velocity, means))
        slow = 0.05 * abs(moves).max(axis=(0, 1))  # what is slower may be rounding
        always = (moves > slow).all(axis=1) | (moves < -slow).all(axis=1)
        entries: dict[str, Any] = {
            "scheme": sol.plan.scheme.name,
            "error": error,
            "over_best": _ratio(error, min(least)),
            "bound_over_error": _ratio(bound, between),
            "ringing": _ratio(rings, changes),
            "false_sticks": int((always & (sol.velocity == 0)).any(axis=1).sum()),
        }
        return entries, {
            "false stick": entries["false_sticks"],
            "no reference": bounds and reference.uncertainty > 0.1 * bound,
            "bound below the error": bound < between - reference.uncertainty,
            "error above twice the best": entries["over_best"] > 2,
            "velocities ring": entries["ringing"] > 1.1,
        }

    return run_case(row, lambda: process, compare, scheme="auto", **how)
