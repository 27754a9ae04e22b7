"""Hard trajectories through every scheme, judged by exact ones.

Bodies that are coupled only by rotation are solved exactly along their axes, by scheme "exact".

What is allowed: a scheme of order p has local errors like the differences of order p + 1 of the
exact states at nodes and middles of steps, also where bodies stop and start. Catching-up has C(t)
at the end of a step and u at its start, which adds step * Lam times the motion in the step. The
error of a run is at most the sum of its local errors, as no step moves two states apart, and those
that slip approach each other by the stability function. A scheme that warns is held to p = 0, the
way that the bodies go. What a run adds is allowed in the size of its certificates and of rounding.
"""

from collections.abc import Iterator, Sequence
from functools import cached_property, partial
from itertools import pairwise, product
from math import inf, nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sweepopt.checks import HUGE, Array
from sweepopt.driver import solve
from sweepopt.integrate import SCHEMES, Scheme
from sweepopt.io import read_toml
from sweepopt.linalg import EPS
from sweepopt.loads import Constant, Separable, Sine, Table
from sweepopt.problem import SweepingProcess
from sweepopt.results import Solution, guaranteed_bound
from sweepopt.sets import Box, ConvexSet, Moving, Polyhedron
from sweepopt.study.hard.bodies import Random
from sweepopt.study.hard.exact import ROUNDING
from sweepopt.study.hard.suite import TARGET, Judgement, run_case

BOUNDED = 600  # steps: bounds of longer runs take minutes

USUAL, HARD = read_toml(Path(__file__).with_suffix(".toml")).values()
DRAWN = ("mu_Lam", "A", "g", "load", "period", "offset")  # for each unknown
TRAJECTORIES: dict[str, dict[str, Any]] = {name: USUAL | row for name, row in HARD.items()}
"""By name, with all keys; trajectories.toml explains them."""


class TrajectoryRow(NamedTuple):
    """One trajectory and scheme.

    Attributes
    ----------
    steps, mu_Lam : int, float
        The largest of the bodies.
    error, allowed : float
        sup over the nodes of |u_i - u(t_i)|_A (|.|_B where A is singular), and what the scheme
        should have.
    bound : float
        `Solution.error_bound` over the error of u_n at nodes and middles of steps; nan if unknown.
    energy : float
        Largest imbalance over what the scheme's quadrature allows.
    false_sticks, false_slips : int
        Steps of a body that rest exactly though it slips clearly, in the step and beside it; steps
        that move though it rests, and at the run's own state too.
    verdict : str
        "met", "warned" where the run says that its scheme may be wrong, "refused" where that is
        right, else what is wrong.
    """

    trajectory: str
    seed: int
    scheme: str
    steps: int
    mu_Lam: float
    error: float = nan
    allowed: float = nan
    bound: float = nan
    energy: float = nan
    false_sticks: int = 0
    false_slips: int = 0
    seconds: float = nan
    verdict: str = ""


class Case:
    """A trajectory drawn from a seed: its process, its grid, and the bodies one by one.

    Parameters
    ----------
    keys : dict
        A row of TRAJECTORIES.
    random : numpy Generator
    """

    def __init__(self, keys: dict[str, Any], random: Random) -> None:
        n, self.keys = keys["unknowns"], keys

        def draw(key: str, count: int = n) -> Array:
            """One number, or numbers between two by logarithm, or such a pair for each unknown."""
            ends = keys[key]
            low, high = np.transpose(ends) if np.ndim(ends) else (ends, ends)
            x = random.uniform(size=count)
            return low ** (1 - x) * high**x

        (self.mu,), (steps,) = draw("step", 1), draw("steps", 1)
        self.t = self.mu * np.arange(round(steps) + 1)
        self.stiffness, A, self.g, load, period, self.offset = map(draw, DRAWN)
        self.mu_Lam, viscous = float(self.stiffness.max()), self.stiffness < inf
        self.A = np.where(viscous, A, 0.0)
        self.B = np.where(viscous, self.stiffness * A / self.mu, A)
        self.metric = self.A if viscous.all() else self.B
        compliance = np.divide(1.0, self.B, out=0 * A, where=self.B > 0)
        self.center = compliance * self.offset
        self.scale: Any = Constant(1.0)
        if keys["closes"]:
            places = np.array([0.0, 0.3, 0.45, 0.7, 1.0]) + 0.1 * random.uniform(0, 1, 5)
            places[[0, -1]] = 0.0, 1.0
            self.scale = Table(self.t[-1] * places, [1.0, 0.0, 0.0, 1.2, 0.6])
        self.axes = np.eye(n)
        if keys["rotated"]:
            self.axes = np.linalg.qr(random.normal(size=(n, n)))[0]
        self.starts = draw("start") * self.g * compliance
        drives = zip(self.g * load, self.mu * period, strict=True)
        self.loads = [_drive(random, keys["drive"], *one, self.t[-1]) for one in drives]

    def process(self) -> SweepingProcess:
        """The process, which may be refused."""
        loads = [*self.loads, *map(Constant, self.offset.tolist())]
        return self._along(self.axes, loads, self.center + self.starts)

    def _along(self, axes: Array, loads: list[Any], u0: Array) -> SweepingProcess:
        A, B = ((axes * x) @ axes.T for x in (self.A, self.B))
        g = abs(axes) @ self.g
        C: ConvexSet = Box(-g, g)
        if np.count_nonzero(axes) > len(axes):
            C = Polyhedron(np.vstack([axes.T, -axes.T]), np.tile(self.g, 2))
        terms = Separable([(load, axes[:, k % axes.shape[1]]) for k, load in enumerate(loads)])
        scale = self.scale if self.keys["closes"] else None  # C(t) is made three times as fast
        return SweepingProcess(A, B, Moving(C, terms, scale), axes @ u0)

    @cached_property
    def exact(self) -> Array:
        """States at nodes and middles of steps, of each body on its axis, from its centre."""
        times = np.sort([*self.t, *0.5 * (self.t[1:] + self.t[:-1])])
        bodies = [self._along(one[None], self.loads, self.starts) for one in np.eye(len(self.g))]
        return np.hstack([solve(one, steps=times, scheme="exact").u for one in bodies])

    def way(self) -> Array:
        """How far load and friction bound of each body go in each step, together."""
        steps = [*pairwise(self.t.tolist())]
        r, *f = ([one.variation(*step) for step in steps] for one in (self.scale, *self.loads))
        return np.transpose(f) + np.outer(r, self.g)

    def norm(self, u: Array) -> float:
        """sup over times of |u|_A, |.|_B where A is singular; u of shape (times, unknowns)."""
        return float(np.sqrt(u**2 @ self.metric).max())

    def expected_refusal(self, scheme: str) -> str:
        """The error that is right, if one is."""
        tableau = SCHEMES.get(scheme)
        if tableau is None or self.keys["refused"]:
            return self.keys["refused"]
        if not self.A.all() and (not tableau.implicit or (tableau.exact and self.A.any())):
            return "InputError"
        return "UnstableStepError" if tableau.explicit and self.mu_Lam > 2 else ""

    def possible_refusal(self, scheme: str, tol: float) -> str:
        """An error that is an answer: "exact" takes no A whose rounding exceeds tol.

        The rounding of A's entries changes the motion of its softest body by EPS * cond(A): seed 3
        of nearly_singular by 9e-8 of its size, more than the 1.4e-9 that the closed form misses.
        """
        A = self.A[self.A > 0]
        rounded = A.size and EPS * A.max() > tol * A.min()
        return "StepError" if rounded and scheme == "exact" else ""


def hard_trajectories(
    seeds: Sequence[int] = (0,),
    trajectories: Sequence[str] = tuple(TRAJECTORIES),
    schemes: Sequence[str] = ("auto", *SCHEMES),
    tol: float = 1e-9,
) -> Iterator[TrajectoryRow]:
    """Hard trajectories.

    Runs beside exact trajectories: the error is that of the scheme's order, bounds lie above it,
    energies balance, and what slips clearly does not rest.

    Parameters
    ----------
    seeds : sequence of int
        Each draws every trajectory anew.
    trajectories : sequence of str
        Rows of trajectories.toml.
    schemes : sequence of str
    tol : float
        What `solve` is asked for.

    Examples
    --------
    >>> row = next(hard_trajectories(trajectories=["ordinary"], schemes=["midpoint"]))
    >>> row.verdict, row.error <= row.allowed
    ('met', True)
    """
    for name, seed in product(trajectories, seeds):
        case = Case(TRAJECTORIES[name], np.random.default_rng([seed, *name.encode()]))
        for scheme in schemes:
            yield run_case(
                TrajectoryRow(name, seed, scheme, len(case.t) - 1, case.mu_Lam),
                case.process,
                partial(_judge, case),
                case.expected_refusal(scheme),
                case.possible_refusal(scheme, tol),
                t_end=float(case.t[-1]),
                steps=len(case.t) - 1,
                scheme=scheme,
                tol=tol,
            )


def _judge(case: Case, solution: Solution, warned: bool) -> Judgement:
    """What a run is worth, and what is wrong with it."""
    scheme, exact = solution.plan.scheme, case.exact
    u, z = solution.u @ case.axes - case.center, solution.velocity @ case.axes
    way = case.way()
    sizes = abs(exact).max(axis=0) + abs(case.center)
    sizes += (abs(case.offset) + way.sum(axis=0)) / np.maximum(case.B, case.A / case.t[-1])
    # u and f / B cancel where bodies are far from the origin
    slack = TARGET * case.norm(exact - exact[0]) + ROUNDING * case.norm(sizes[None])
    slack += float(case.mu * np.nan_to_num(solution.stats["certificate"]).sum())
    allowed = slack
    if not scheme.exact:
        order = 0 if warned else int(scheme.order)
        allowed += _sum_of_local_errors(case, scheme, order)
    error = case.norm(u - exact[::2])
    between = max(error, case.norm(0.5 * (u[1:] + u[:-1]) - exact[1::2]))
    bound = float(guaranteed_bound(solution)) if len(z) <= BOUNDED else nan
    energy, moves = solution.energy(), abs(np.diff(u, axis=0))
    # forces of stages and those at the middle of a step differ by what they change in the step
    quadrature = np.append(0.0, np.cumsum((moves * (case.B * moves + way)).sum(axis=1)))
    quadrature += TARGET * np.maximum.accumulate(abs(np.array(energy)), axis=1).sum(axis=0)
    quadrature += ROUNDING * (case.B @ sizes**2) + np.finfo(float).tiny
    entries = {
        "error": error,
        "allowed": allowed,
        "bound": bound / between if between > slack else nan,
        "energy": float((abs(energy.balance) / quadrature).max()),
        "false_sticks": int((_slips_clearly(exact) & (z == 0)[1:-1]).sum()),
        "false_slips": int((_rests(case, scheme.c, u) & (abs(z) * case.mu > slack)).sum()),
    }
    return entries, {
        f"stopped: {solution.message}": not solution.success,
        "error above that of the scheme": error > allowed,
        "bound below the error": between > bound + slack,
        "energy out of balance": entries["energy"] > 1 and not scheme.exact,
        "false stick": entries["false_sticks"] and not warned,
        "false slip": entries["false_slips"],
    }


def _sum_of_local_errors(case: Case, scheme: Scheme, order: int) -> float:
    """The largest of all nodes; those of earlier steps fade while a body slips clearly."""
    exact, local = case.exact, np.zeros(case.exact[1:].shape)
    local[order:] = abs(np.diff(exact, order + 1, axis=0))
    local, stiffness = local[::2] + local[1::2], np.minimum(case.stiffness, HUGE)
    if scheme.explicit:
        local += stiffness * abs(np.diff(exact[::2], axis=0))
    rates = abs(scheme.amplification(-stiffness))
    sums = np.zeros(exact[::2].shape)
    slips = np.pad(_slips_clearly(exact), ((1, 1), (0, 0)))
    for i, step in enumerate(local):
        sums[i + 1] = np.where(slips[i], rates, 1.0) * sums[i] + step
    return case.norm(sums)


def _slips_clearly(exact: Array) -> Array:
    """For all steps but the first and the last, from states at nodes and middles of steps.

    A body slips clearly in a step if its mean velocities in the halves of this and of those beside
    it are above a tenth of the largest of all times and above half of the largest of theirs.
    """
    six = sliding_window_view(np.diff(exact, axis=0), 6, axis=0)[::2]
    low, high = six.min(axis=-1), six.max(axis=-1)
    # the least is negative where the six have not one sign
    least, largest = np.maximum(low, -high), np.maximum(high, -low)
    return (least > 0.5 * largest) & (least > 0.1 * largest.max(axis=0))


def _rests(case: Case, c: Sequence[float], u: Array) -> Array:
    """Whether a body rests in each step, and at the run's own state and the times of its stages."""
    halves = np.diff(case.exact, axis=0) == 0
    rests = halves[::2] & halves[1::2]
    for share in (0.0, *c):
        times = case.t[:-1] + share * case.mu
        f = np.transpose([load(times) for load in case.loads])
        rests &= abs(f - case.B * u[:-1]) < np.outer(case.scale(times), case.g)
    return rests


def _drive(random: Random, kind: str, amplitude: float, period: float, end: float) -> Any:
    """A load."""
    if kind == "sine":
        return Sine(float(amplitude), float(period))
    count = int(end / period) + 2
    starts = period * (np.arange(count) + np.append(0.0, 0.3 * random.uniform(size=count - 1)))
    values = amplitude * random.uniform(-1, 1, count)
    values[0] = 0.0
    if kind == "holds":  # ramps of a twentieth of the period
        starts = np.delete(np.column_stack([starts, starts + 0.05 * period]).ravel(), 1)
        values = np.repeat(values, 2)[:-1]
    return Table([*starts, starts[-1] + end], [*values, values[-1]])
