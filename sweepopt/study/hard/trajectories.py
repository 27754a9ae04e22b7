"""Hard trajectories through every scheme, judged by exact ones.

What is allowed: a scheme of order p has local errors like the differences of order p + 1 of the
exact states at nodes and middles of steps, also where bodies stop and start. Its error is at most
LOCAL times their sum: no step moves two states apart, and those that slip approach each other by
the stability function. A scheme that warns is held to p = 0, the way that the bodies go. What a run
adds is allowed in the size of its certificates and of rounding.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import inf, nan
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from sweepopt.checks import HUGE
from sweepopt.errors import StabilityWarning, SweepoptError
from sweepopt.integrate import SCHEMES, Scheme
from sweepopt.io import read_toml
from sweepopt.linalg import EPS
from sweepopt.loads import Constant, Separable, Sine, Table
from sweepopt.problem import SweepingProcess
from sweepopt.results import Solution
from sweepopt.sets import Box, Moving, Polyhedron
from sweepopt.solve import solve
from sweepopt.study.cell import guaranteed_bound
from sweepopt.study.hard.bodies import Random
from sweepopt.study.hard.play import Play

LOCAL = 2.0  # once is not enough for catching-up: C(t) of one end of the step, u of the other
TARGET = 1e-8
"""What a run may add to the error of its scheme, in units of the way that the bodies go."""
ROUNDING = 64 * EPS  # of u and of f / B, which cancel where bodies are far from the origin
BOUNDED = 600  # steps: bounds of longer runs take minutes
CLEAR, EVEN = 0.1, 0.5
"""A body slips clearly in a step if its mean velocities in the halves of this and of those beside
it are above CLEAR of the largest of all times and above EVEN of the largest of theirs."""

_FILE = read_toml(Path(__file__).with_suffix(".toml"))

TRAJECTORIES: dict[str, dict[str, Any]] = {
    name: {**_FILE["usual"], **row} for name, row in _FILE["hard"].items()
}
"""By name, with all keys; trajectories.toml explains them."""


class TrajectoryRow(NamedTuple):
    """One trajectory and scheme.

    Attributes
    ----------
    steps, mu_Lam : int, float
        The largest of the bodies.
    error, allowed : float
        sup over the nodes of |u_i - u(t_i)|_A (|.|_B where A = 0), and what the scheme should have.
    bound : float
        `Solution.error_bound` over the error of u_n at nodes and middles of steps; nan if unknown.
    energy : float
        Largest imbalance over what the scheme's quadrature allows.
    false_sticks, false_slips : int
        Steps of a body that rest exactly though it slips clearly, in the step and beside it; steps
        that move though it rests, and at the run's own state too.
    warned : bool
        Whether the run warned that the scheme may be wrong.
    verdict : str
        "met", "warned", "refused" where that is right, else what is wrong.
    """

    trajectory: str
    seed: int
    scheme: str
    steps: int = 0
    mu_Lam: float = nan
    error: float = nan
    allowed: float = nan
    bound: float = nan
    energy: float = nan
    false_sticks: int = 0
    false_slips: int = 0
    warned: bool = False
    seconds: float = nan
    verdict: str = ""

    @property
    def good(self) -> bool:
        """Whether the right answer was given."""
        return self.verdict in ("met", "warned", "refused")


class Case:
    """A trajectory drawn from a seed: its process, its grid, and the bodies one by one.

    Parameters
    ----------
    keys : dict
        A row of TRAJECTORIES.
    random : numpy Generator
    """

    def __init__(self, keys: dict[str, Any], random: Random) -> None:
        row = SimpleNamespace(**keys)
        n, self.refused = row.unknowns, row.refused
        (mu,), (steps,) = _draw(random, row.step), _draw(random, row.steps)
        self.t = [float(mu) * k for k in range(int(steps) + 1)]
        stiffness, A, g = (_draw(random, x, n) for x in (row.mu_Lam, row.A, row.g))
        self.mu_Lam, self.stiffness = float(stiffness.max()), np.minimum(stiffness, HUGE)
        self.B = A if self.mu_Lam == inf else stiffness * A / mu
        self.A = 0 * A if self.mu_Lam == inf else A
        compliance = np.divide(1.0, self.B, out=0 * A, where=self.B > 0)
        amplitude, period = g * _draw(random, row.load, n), mu * _draw(random, row.period, n)
        self.offset = _draw(random, row.offset, n)
        self.center = compliance * self.offset
        scale = Table([0.0, self.t[-1]], [1.0, 1.0])
        if row.closes:
            places = np.array([0.0, 0.3, 0.45, 0.7, 1.0]) + 0.1 * random.uniform(0, 1, 5)
            places[[0, -1]] = 0.0, 1.0
            scale = Table(self.t[-1] * places, [1.0, 0.0, 0.0, 1.2, 0.6])
        self.shapes = np.linalg.qr(random.normal(size=(n, n)))[0] if row.rotated else np.eye(n)
        starts = _draw(random, row.start, n) * g * compliance
        self.u0 = self.shapes @ (self.center + starts)
        self.bodies, terms = [], []
        for k, shape in enumerate(self.shapes.T):
            load, wave, history = _drive(random, row.drive, amplitude[k], period[k], self.t[-1])
            friction = scale.times.tolist(), (g[k] * scale.values).tolist()
            A_k, B_k, start = (float(x[k]) for x in (self.A, self.B, starts))
            self.bodies.append(Play(A_k, B_k, start, load, friction, wave))
            terms += [(history, shape), (Constant(float(self.offset[k])), shape)]
        sides = np.vstack([self.shapes.T, -self.shapes.T])
        C = Polyhedron(sides, np.tile(g, 2)) if row.rotated else Box(-g, g)
        self.C = Moving(C, Separable(terms), scale if row.closes else 1.0)

    def process(self) -> SweepingProcess:
        """The process, which may be refused."""
        A, B = ((self.shapes * x) @ self.shapes.T for x in (self.A, self.B))
        return SweepingProcess(0.5 * (A + A.T), 0.5 * (B + B.T), self.C, self.u0)

    def norm(self, u: np.ndarray) -> float:
        """sup over times of |u|_A, |.|_B where A = 0; u of shape (times, unknowns)."""
        return float(np.sqrt(u**2 @ (self.A if self.A.any() else self.B)).max())

    def expected_refusal(self, scheme: str) -> str:
        """The error that is right, if one is."""
        tableau = SCHEMES.get(scheme)
        if tableau is None or self.refused:
            return str(self.refused)
        if not self.A.any() and not tableau.implicit:
            return "InputError"
        return "UnstableStepError" if tableau.explicit and self.mu_Lam > 2 else ""


def judged(
    name: str, seed: int, schemes: Sequence[str] = ("auto", *SCHEMES), tol: float = 1e-9
) -> Iterator[TrajectoryRow]:
    """Run a trajectory through schemes.

    Examples
    --------
    >>> row = next(judged("ordinary", 0, ["midpoint"]))
    >>> row.verdict, row.error <= row.allowed
    ('met', True)
    """
    case = Case(TRAJECTORIES[name], np.random.default_rng([seed, *name.encode()]))
    exact = None
    for scheme in schemes:
        row = TrajectoryRow(name, seed, scheme, len(case.t) - 1, case.mu_Lam)
        right = case.expected_refusal(scheme)
        try:
            solution, row = _run(case, row, tol)
        except SweepoptError as error:
            # exact treats what it can, and says so if it cannot
            met = type(error).__name__ == (right or ("InputError" if scheme == "exact" else ""))
            yield row._replace(verdict="refused" if met else f"{type(error).__name__}: {error}")
            continue
        if right:
            yield row._replace(verdict=f"not refused with {right}")
            continue
        if exact is None:
            halves = [t for a, b in pairwise(case.t) for t in (a, 0.5 * (a + b))] + case.t[-1:]
            exact = np.transpose([body.states(halves) for body in case.bodies])
        yield _verdict(case, row, solution, exact)


def _run(case: Case, row: TrajectoryRow, tol: float) -> tuple[Solution, TrajectoryRow]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        started = time.perf_counter()
        solution = solve(
            case.process(), t_end=case.t[-1], steps=row.steps, scheme=row.scheme, tol=tol
        )
        seconds = time.perf_counter() - started
    warned = any(issubclass(one.category, StabilityWarning) for one in caught)
    return solution, row._replace(warned=warned, seconds=seconds)


def _verdict(
    case: Case, row: TrajectoryRow, solution: Solution, exact: np.ndarray
) -> TrajectoryRow:
    """The row with what the run is worth; `exact` is at nodes and middles of steps."""
    scheme, mus = solution.plan.scheme, np.diff(case.t)[:, None]
    u, z = solution.u @ case.shapes - case.center, solution.velocity @ case.shapes
    way = np.transpose([_ways(body, case.t) for body in case.bodies])
    sizes = abs(exact).max(axis=0) + abs(case.center)
    sizes += (abs(case.offset) + way.sum(axis=0)) / np.maximum(case.B, case.A / case.t[-1])
    slack = TARGET * case.norm(exact - exact[0]) + ROUNDING * case.norm(sizes[None])
    slack += float(mus[:, 0] @ np.nan_to_num(solution.stats["certificate"]))
    allowed = slack
    if not scheme.exact:
        order = 0 if row.warned else int(scheme.order)
        allowed += LOCAL * _sum_of_local_errors(case, scheme, order, exact)
    error = case.norm(u - exact[::2])
    between = max(error, case.norm(0.5 * (u[1:] + u[:-1]) - exact[1::2]))
    bound = guaranteed_bound(solution) if row.steps <= BOUNDED else None
    false_sticks = int((_slips_clearly(exact) & (z == 0)[1:-1]).sum())
    false_slips = int((_rests(case, scheme.c, u, exact) & (abs(z) * mus > slack)).sum())
    energy, moves = solution.energy(), abs(np.diff(u, axis=0))
    # forces of stages and those at the middle of a step differ by what they change in the step
    quadrature = np.append(0.0, np.cumsum((moves * (case.B * moves + way)).sum(axis=1)))
    quadrature += TARGET * np.maximum.accumulate(abs(np.array(energy)), axis=1).sum(axis=0)
    quadrature += ROUNDING * (case.B @ sizes**2) + np.finfo(float).tiny
    imbalance = float((abs(energy.balance) / quadrature).max())
    faults = {
        f"stopped: {solution.message}": not solution.success,
        "error above that of the scheme": error > allowed,
        "bound below the error": bound is not None and between > float(bound) + slack,
        "energy out of balance": imbalance > 1 and not scheme.exact,
        "false stick": false_sticks > 0 and not row.warned,
        "false slip": false_slips > 0,
    }
    usual = "warned" if row.warned else "met"
    return row._replace(
        error=error,
        allowed=allowed,
        bound=float(bound) / between if bound is not None and between > slack else nan,
        energy=imbalance,
        false_sticks=false_sticks,
        false_slips=false_slips,
        verdict=next((words for words, fault in faults.items() if fault), usual),
    )


def _sum_of_local_errors(case: Case, scheme: Scheme, order: int, exact: np.ndarray) -> float:
    """The largest of all nodes; those of earlier steps fade while a body slips clearly."""
    local = np.zeros(exact[1:].shape)
    local[order:] = abs(np.diff(exact, order + 1, axis=0))
    rates = np.array([abs(scheme.amplification(-x)) for x in case.stiffness])
    sums = np.zeros(exact[::2].shape)
    slips = np.pad(_slips_clearly(exact), ((1, 1), (0, 0)))
    for i, step in enumerate(local.reshape(-1, 2, len(rates)).sum(axis=1)):
        sums[i + 1] = np.where(slips[i], rates, 1.0) * sums[i] + step
    return case.norm(sums)


def _ways(body: Play, times: Sequence[float]) -> np.ndarray:
    """How far f and r go in each step, together."""
    marks = body.monotone(times)
    forces = [[body.f(t), body.r(t)] for t in marks]
    way = np.append(0.0, np.cumsum(abs(np.diff(forces, axis=0)).sum(axis=1)))
    return np.diff(way[np.searchsorted(marks, times)])


def _slips_clearly(exact: np.ndarray) -> np.ndarray:
    """For all steps but the first and the last, from states at nodes and middles of steps."""
    moves = np.diff(exact, axis=0)
    six = np.array([moves[k : len(moves) - 5 + k : 2] for k in range(6)])
    one_sign = abs(np.sign(six).sum(axis=0)) == 6
    least, largest = abs(six).min(axis=0), abs(six).max(axis=0)
    return one_sign & (least > EVEN * largest) & (least > CLEAR * abs(moves).max(axis=0))


def _rests(case: Case, c: Sequence[float], u: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Whether a body rests in each step, and at the run's own state and the times of its stages."""
    halves = np.diff(exact, axis=0) == 0
    rests = halves[::2] & halves[1::2]
    for k, body in enumerate(case.bodies):
        for share in (0.0, *c):
            times = [a + share * (b - a) for a, b in pairwise(case.t)]
            f, r = (np.array([force(t) for t in times]) for force in (body.f, body.r))
            rests[:, k] &= abs(f - body.B * u[:-1, k]) < r
    return rests


def _drive(
    random: Random, kind: str, amplitude: float, period: float, end: float
) -> tuple[Any, tuple[float, float], Any]:
    """Knots of a load, its wave, and both as a history of the library."""
    if kind == "sine":
        wave = float(amplitude), 2 * np.pi / float(period)
        return ([0.0, end], [0.0, 0.0]), wave, Sine(float(amplitude), float(period))
    count = int(end / period) + 2
    starts = period * (np.arange(count) + np.append(0.0, 0.3 * random.uniform(size=count - 1)))
    values = amplitude * random.uniform(-1, 1, count)
    values[0] = 0.0
    if kind == "holds":  # ramps of a twentieth of the period
        starts = np.delete(np.column_stack([starts, starts + 0.05 * period]).ravel(), 1)
        values = np.repeat(values, 2)[:-1]
    starts, values = np.append(starts, starts[-1] + end), np.append(values, values[-1])
    return (starts.tolist(), values.tolist()), (0.0, 1.0), Table(starts, values)


def _draw(random: Random, ends: Any, n: int = 1) -> np.ndarray:
    """Numbers: one, or drawn between two by logarithm, or between such a pair for each unknown."""
    low, high = np.array(ends, float).T if np.ndim(ends) else (ends, ends)
    x = random.uniform(size=n)
    return np.asarray(low ** (1 - x) * high**x)
