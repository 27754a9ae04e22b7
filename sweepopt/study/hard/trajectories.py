"""Hard trajectories through every scheme, judged by exact ones.

What is allowed: a scheme of which no step moves two states apart (`play.least_slope` >= -1) has an
error of at most the sum of its local errors, those of steps from the exact states; where steps keep
the order of states (>= 0), steps from the ends of an interval around the exact state enclose it.
What a run adds is allowed in the size of its certificates and of rounding.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise, product
from math import inf, nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sweepopt.errors import StabilityWarning, SweepoptError
from sweepopt.integrate import SCHEMES, Scheme
from sweepopt.io import read_toml
from sweepopt.linalg import EPS
from sweepopt.loads import Constant, Separable, Sine, Table
from sweepopt.problem import SweepingProcess
from sweepopt.results import Solution
from sweepopt.sets import Box, Moving, Polyhedron
from sweepopt.solve import solve
from sweepopt.study.hard.play import Play, least_slope

Random = np.random.Generator
TARGET = 1e-8
"""What a run may add to the error of its scheme, in units of the way that the bodies go."""
ROUNDING = 64 * EPS  # of u and of f / B, which cancel where bodies are far from the origin
BOUNDED = 600  # steps: bounds of longer runs take minutes
CLEAR, EVEN = 0.1, 0.5
"""A body slips clearly in a step if its mean velocities in the halves of this and of those beside
it are above CLEAR of the largest of all times and above EVEN of the largest of theirs."""


@dataclass(frozen=True)
class Trajectory:
    """A row of trajectories.toml, where its keys are explained."""

    unknowns: int = 1
    steps: Any = 150
    step: Any = (0.01, 0.1)
    mu_Lam: Any = (0.01, 0.5)
    A: Any = (0.3, 3.0)
    B: Any = None
    g: Any = (0.3, 3.0)
    load: Any = (1.5, 5.0)
    drive: str = "sine"
    period: Any = (30.0, 60.0)
    closes: bool = False
    offset: Any = 0.0
    start: Any = 0.0
    rotated: bool = False
    refused: str = ""


TRAJECTORIES = {
    name: Trajectory(**keys)
    for name, keys in read_toml(Path(__file__).with_suffix(".toml")).items()
}


class TrajectoryRow(NamedTuple):
    """One trajectory and scheme.

    Attributes
    ----------
    steps, mu_Lam : int, float
        The largest of the bodies.
    error, allowed : float
        sup over the nodes of |u_i - u(t_i)|_A (|.|_B where A = 0), and what the scheme should have;
        nan where its steps can move states apart.
    off : float
        The same distance from the scheme's own states, in units of TARGET and rounding.
    bound : float
        `Solution.error_bound` over the error of u_n at nodes and middles of steps; nan if unknown.
    energy : float
        Largest imbalance over what the scheme's quadrature allows.
    false_sticks, false_slips : int
        Steps of a body that rest exactly though it slips clearly, in the step and beside it; steps
        that move though it rests, by more than the allowed error from slipping.
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
    off: float = nan
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
    drawn : Trajectory
    random : numpy Generator
    """

    def __init__(self, drawn: Trajectory, random: Random) -> None:
        n, self.refused = drawn.unknowns, drawn.refused
        mu, steps = float(_draw(random, drawn.step)), int(_draw(random, drawn.steps))
        self.t = [mu * k for k in range(steps + 1)]
        stiffness, A, g = (_draw(random, x, n) for x in (drawn.mu_Lam, drawn.A, drawn.g))
        B = A if np.isinf(stiffness).any() else stiffness * A / mu
        B, A = (B if drawn.B is None else _draw(random, drawn.B, n)), np.where(B is A, 0.0, A)
        self.A, self.B = A, B
        with np.errstate(divide="ignore", invalid="ignore"):
            self.mu_Lam = np.where(B > 0, mu * B / A, 0.0)
        amplitude, period = g * _draw(random, drawn.load, n), mu * _draw(random, drawn.period, n)
        self.offset = _draw(random, drawn.offset, n)
        end = self.t[-1]
        opening = ([0.0, end], [1.0, 1.0])
        if drawn.closes:
            places = np.array([0.0, 0.3, 0.45, 0.7, 1.0]) + 0.1 * random.uniform(0, 1, 5)
            places[[0, -1]] = 0.0, 1.0
            opening = ((end * places).tolist(), [1.0, 0.0, 0.0, 1.2, 0.6])
        self.bodies, terms, shapes = [], [], np.eye(n)
        if drawn.rotated:
            shapes = np.linalg.qr(random.normal(size=(n, n)))[0]
        starts = _draw(random, drawn.start, n) * g
        with np.errstate(divide="ignore", invalid="ignore"):
            self.center = np.where(B > 0, self.offset / B, 0.0)
            u0 = self.center + np.where(B > 0, starts / B, 0.0)
        for k in range(n):
            load, wave, history = _drive(random, drawn.drive, amplitude[k], period[k], end)
            friction = opening[0], [float(g[k]) * s for s in opening[1]]
            away = float(u0[k] - self.center[k])
            self.bodies.append(Play(float(A[k]), float(B[k]), away, load, friction, wave))
            terms += [(history, shapes[:, k]), (Constant(float(self.offset[k])), shapes[:, k])]
        scale = Table(*opening) if drawn.closes else 1.0
        sides = np.vstack([shapes.T, -shapes.T])
        shape = Polyhedron(sides, np.tile(g, 2)) if drawn.rotated else Box(-g, g)
        self.shapes, self.u0 = shapes, shapes @ u0
        self.matrices = [(shapes * x) @ shapes.T if drawn.rotated else np.diag(x) for x in (A, B)]
        self.C = Moving(shape, Separable(terms), scale)

    def process(self) -> SweepingProcess:
        """The process, which may be refused."""
        A, B = (0.5 * (M + M.T) for M in self.matrices)
        return SweepingProcess(A, B, self.C, self.u0)

    def norm(self, u: np.ndarray) -> float:
        """sup over times of |u|_A, |.|_B where A = 0; u of shape (times, unknowns)."""
        return float(np.sqrt(u**2 @ (self.A if self.A.any() else self.B)).max())

    def expected_refusal(self, scheme: str) -> str:
        """The error that is right, if one is."""
        tableau = SCHEMES.get(scheme)
        if tableau is None or self.refused:
            return self.refused
        if not self.A.any() and not tableau.implicit:
            return "InputError"
        return "UnstableStepError" if tableau.explicit and self.mu_Lam.max() > 2 else ""


def trajectory_rows(
    names: Sequence[str],
    seeds: Sequence[int],
    schemes: Sequence[str] = ("auto", *SCHEMES),
    *,
    tol: float = 1e-9,
    progress: Callable[[str], object] = lambda words: None,
) -> Iterator[TrajectoryRow]:
    """Run trajectories of trajectories.toml through schemes.

    Examples
    --------
    >>> row = next(trajectory_rows(["ordinary"], [0], ["midpoint"]))
    >>> row.verdict, row.error <= row.allowed
    ('met', True)
    """
    for name, seed in product(names, seeds):
        progress(f"trajectory {name}, seed {seed}")
        case = Case(TRAJECTORIES[name], np.random.default_rng([seed, *name.encode()]))
        exact: list[np.ndarray] = []
        for scheme in schemes:
            row = TrajectoryRow(name, seed, scheme, len(case.t) - 1, float(case.mu_Lam.max()))
            right = case.expected_refusal(scheme)
            try:
                solution, row = _run(case, row, tol)
            except SweepoptError as error:
                # exact treats what it can, and says so if it cannot
                met = type(error).__name__ == (right or ("InputError" if scheme == "exact" else ""))
                words = "refused" if met else f"{type(error).__name__}: {error}"
                yield row._replace(verdict=words)
                continue
            if right:
                yield row._replace(verdict=f"not refused with {right}")
                continue
            if not exact:
                halves = [t for a, b in pairwise(case.t) for t in (a, 0.5 * (a + b))] + case.t[-1:]
                exact = [body.states(halves) for body in case.bodies]
            yield _judged(case, row, solution, np.array(exact).T)


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


def _judged(case: Case, row: TrajectoryRow, solution: Solution, exact: np.ndarray) -> TrajectoryRow:
    """The row with what the run is worth; `exact` is at nodes and middles of steps."""
    scheme, nodes, mus = solution.plan.scheme, exact[::2], np.diff(case.t)[:, None]
    u, z = ((x @ case.shapes) for x in (solution.u, solution.velocity))
    u = u - case.center
    sums, own, energy = _scheme_alone(case, scheme, nodes)
    slack = _slack(case, solution, exact)
    known = not scheme.exact and np.isfinite(sums).all()
    allowed = slack if scheme.exact else case.norm(sums) + slack
    off = case.norm(u - own) / slack if known else nan
    error = case.norm(u - nodes)
    between = max(error, case.norm(0.5 * (u[1:] + u[:-1]) - exact[1::2]))
    bound = _bound(solution) if row.steps <= BOUNDED else nan
    still, clear = z == 0, _slips_clearly(exact)
    rests = np.array(
        [
            _rests(body, case.t, x, e)
            for body, x, e in zip(case.bodies, nodes.T, sums.T, strict=True)
        ]
    )
    moved = ~still & rests.T & (abs(z) * mus > slack)
    false_sticks, false_slips = int((clear & still[1:-1]).sum()), int(moved.sum())
    imbalance = nan if scheme.exact else _imbalance(case, solution, energy)
    faults = {
        f"stopped: {solution.message}": not solution.success,
        "error above that of the scheme": error > allowed,
        "states are not the scheme's": off > 1,
        "bound below the error": between > bound + slack,
        "energy out of balance": imbalance > 1,
        "false stick": false_sticks > 0 and not row.warned,
        "false slip": false_slips > 0,
    }
    usual = "warned" if row.warned else "met"
    return row._replace(
        error=error,
        allowed=allowed,
        off=off,
        bound=bound / between if between > slack else nan,
        energy=imbalance,
        false_sticks=false_sticks,
        false_slips=false_slips,
        verdict=next((words for words, fault in faults.items() if fault), usual),
    )


def _scheme_alone(
    case: Case, scheme: Scheme, nodes: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The scheme's allowed error at each node, its own states, and what steps may leave of energy.

    Energy: a stage has the force A z_k + B U_k + r s_k = f of its own time and state, with
    |s_k| <= 1, and the energies take f and r at the middle and u between the nodes.
    """
    energy, own, sums = np.zeros(nodes[1:].shape), np.zeros(nodes.shape), np.zeros(nodes.shape)
    for k, body in enumerate(() if scheme.exact else case.bodies):
        least = least_slope(scheme, case.mu_Lam[k])
        if least < -1 - ROUNDING:
            sums[:, k] = nan
        own[0, k] = u = body.u0
        way = body.ways(case.t)
        for i, (a, b) in enumerate(pairwise(case.t)):
            # the ends of an interval that the scheme's state is in, or its middle if order is lost
            wide = sums[i, k] if least >= 0 else 0.0
            ends = (body.step(scheme, nodes[i, k] + e, a, b - a)[0] for e in (-wide, wide))
            sums[i + 1, k] = sums[i, k] - wide + max(abs(end - nodes[i + 1, k]) for end in ends)
            before, (u, stages) = u, body.step(scheme, u, a, b - a)
            own[i + 1, k] = u
            mixed = 2 * body.r(a) if len({np.sign(z) for z in stages}) > 1 else 0.0
            lag = (b - a) * body.B * max(map(abs, stages)) + way[i] + mixed
            energy[i, k] = abs(u - before) * lag
    return sums, own, energy


def _slips_clearly(exact: np.ndarray) -> np.ndarray:
    """For all steps but the first and the last, from states at nodes and middles of steps."""
    moves = np.diff(exact, axis=0)
    six = np.array([moves[k : len(moves) - 5 + k : 2] for k in range(6)])
    one_sign = abs(np.sign(six).sum(axis=0)) == 6
    least, largest = abs(six).min(axis=0), abs(six).max(axis=0)
    return one_sign & (least > EVEN * largest) & (least > CLEAR * abs(moves).max(axis=0))


def _slack(case: Case, solution: Solution, exact: np.ndarray) -> float:
    """What a run may add to its scheme: TARGET of the way, rounding, and its certificates."""
    force = np.array([max(abs(body.f(t)) for t in body.marks(case.t)) for body in case.bodies])
    stiffness = np.maximum(case.B, case.A / case.t[-1])
    sizes = abs(exact).max(axis=0) + abs(case.center) + (force + abs(case.offset)) / stiffness
    stated = float(np.diff(case.t) @ np.nan_to_num(solution.stats["certificate"]))
    return TARGET * case.norm(exact - exact[0]) + ROUNDING * case.norm(sizes[None]) + stated


def _bound(solution: Solution) -> float:
    """The guaranteed bound; inf if there is none."""
    with suppress(SweepoptError):
        bound = solution.error_bound()
        return float(bound) if bound.guaranteed else inf
    return inf


def _rests(body: Play, t: Sequence[float], u: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Whether the body rests in each step although its state were wrong by the error."""
    marks = body.marks(t)
    steps = np.clip(np.searchsorted(t, marks, side="right") - 1, 0, len(t) - 2)
    margins = np.array(
        [body.r(x) - abs(body.f(x) - body.B * u[i]) for x, i in zip(marks, steps, strict=True)]
    )
    least = np.full(len(t) - 1, inf)
    np.minimum.at(least, steps, margins)
    ends = [body.r(x) - abs(body.f(x) - body.B * v) for x, v in zip(t[1:], u[:-1], strict=True)]
    return (np.diff(u) == 0) & (np.minimum(least, ends) > 1.01 * body.B * error[1:])


def _imbalance(case: Case, solution: Solution, allowed: np.ndarray) -> float:
    """The largest imbalance of the energies over what is allowed."""
    energy = solution.energy()
    force = max(abs(body.f(t)) for body in case.bodies for t in case.t) + abs(case.offset).max()
    largest = abs(solution.u).max()
    sizes = case.B.max() * largest**2 + force * largest
    moving: Any = sum(np.maximum.accumulate(abs(part)) for part in energy)
    terms = np.append(0.0, np.cumsum(allowed.sum(axis=1)))
    return float(
        (abs(energy.balance) / (terms + TARGET * moving + ROUNDING * sizes + 1e-300)).max()
    )


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


def _draw(random: Random, value: Any, n: int | None = None) -> np.ndarray:
    """A number, one drawn between two by logarithm, or such a pair for each unknown."""
    pairs = np.atleast_1d(np.array(value, float))
    pairs = np.repeat(pairs, 2) if pairs.size == 1 else pairs
    low, high = np.broadcast_to(pairs, (n or 1, 2)).T
    with np.errstate(divide="ignore", invalid="ignore"):
        drawn = low * (high / low) ** random.uniform(size=n or 1)
    drawn = np.where(low == high, low, drawn)
    return drawn if n else drawn[0]


def trajectory_summary(rows: Sequence[TrajectoryRow]) -> str:
    """A line a trajectory, and each row with a wrong answer."""
    import pandas as pd

    table = pd.DataFrame(rows).assign(
        share=[row.error / row.allowed if row.allowed else nan for row in rows]
    )
    families = table.groupby("trajectory", sort=False)
    worst = families[["error", "share", "off", "energy", "false_sticks", "false_slips"]].max()
    worst = worst.assign(bound=families.bound.min(), runs=families.size())
    wrong = [row for row in rows if not row.good]
    lines = [worst.to_string(float_format="{:.1e}".format), ""]
    lines += [f"{len(rows)} runs of trajectories, {len(wrong)} wrong"]
    lines += [f"  {row.trajectory} {row.seed} {row.scheme}: {row.verdict}" for row in wrong]
    return "\n".join(lines)
