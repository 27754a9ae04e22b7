"""The reference cases as processes: exact solutions that every path of the library must meet."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import sweepopt as so

DATA = Path(__file__).parent / "data"
GRIDS = (101, 211, 503, 1009, 2003)


@dataclass(frozen=True)
class Case:
    """A reference case: its process, end time, exact values on grids, tabulated errors."""

    name: str
    process: so.SweepingProcess
    t_end: float
    errors: dict[str, dict[str, float]]
    polyhedral: bool

    def exact(self, n: int) -> np.ndarray:
        """u on the grid of n steps, shape (n+1, dim)."""
        return _grids()[f"{self.name}_{n}"]

    def error(self, sol: so.Solution) -> float:
        """max_i |u_i - u(t_i)| in the norm of A, of B where A = 0."""
        return max(map(self.process.metric.norm, sol.u - self.exact(len(sol.t) - 1)))


def embedded(this: Case, others: int = 9) -> so.SweepingProcess:
    """The case as the contact of a larger body, which moves it as if it were alone.

    In coordinates u = T y with y = (case, rest) the rest has its own A and B and no load, so that
    it stays at rest; T mixes it with the case's unknowns in u, and the case's unknowns come last.
    """
    alone = this.process
    m, dim = alone.dim, alone.dim + others
    random = np.random.default_rng(1)
    mix = np.eye(dim)
    mix[:others, others:] = random.normal(size=(others, m))
    inner = random.normal(size=(others, others))
    inner = inner @ inner.T + np.eye(others)
    back = np.linalg.inv(mix)

    def grown(part: Any, rate: float) -> np.ndarray:
        whole = np.zeros((dim, dim))
        whole[:others, :others] = rate * inner
        whole[others:, others:] = part
        whole = back.T @ whole @ back
        return 0.5 * (whole + whole.T)

    B = np.zeros((m, m)) if alone.B is None else alone.B
    ratio = np.trace(B) / np.trace(alone.A) if alone.A.any() else 1.0
    E = np.eye(dim)[others:]
    C: Any = so.image(E.T, alone.C)
    if isinstance(alone.C, so.Moving):
        load = [(lambda t, k=k: alone.C.center_at(t)[k], E[k]) for k in range(m)]
        C = so.Moving(so.image(E.T, alone.C.shape), so.Separable(load))
    A = grown(alone.A, 1.0 if alone.A.any() else 0.0)
    return so.SweepingProcess(A, grown(B, ratio), C, mix[:, others:] @ alone.u0)


def wave(points: list[tuple[float, Any]]) -> Any:
    """The piecewise linear function through (t, value) pairs."""
    times = np.array([t for t, _ in points])
    values = np.array([np.atleast_1d(value) for _, value in points], dtype=float)
    return lambda t: np.array([np.interp(t, times, column) for column in values.T])


def interval(g: float) -> so.Box:
    return so.Box([-g], [g])


SETS: dict[str, Any] = {
    "S01": lambda: so.Moving(interval(1), lambda t: [1.5 * t]),
    "S02": lambda: so.Moving(
        interval(0.5), wave([(0, 0.0)] + [(k, 2.0 * (-1) ** (k // 2)) for k in range(1, 14, 2)])
    ),
    "S03": lambda: so.Moving(interval(1), lambda t: [3 * np.sin(2 * t)]),
    "S04": lambda: so.Polyhedron(
        [[1.0], [-1.0]],
        lambda t: [
            1 + 0.6 * np.sin(2 * t) + 0.5 * np.sin(t),
            1 - np.sin(t) + 0.3 * np.cos(3 * t),
        ],
    ),
    "V05": lambda: so.Moving(
        so.Ball([0, 0], 1), lambda t: 2.5 * np.array([np.cos(2 * t), np.sin(2 * t)])
    ),
    "P09": lambda: so.Moving(
        so.Box([-1, -0.6, -0.4], [1, 0.6, 0.4]),
        lambda t: [3 * np.sin(t), np.sin(t) + np.sin(2 * t), 2 * np.sin(2 * t)],
    ),
    "P10": lambda: so.Moving(so.Orthant(1), lambda t: [2 * np.sin(t) + t / 4]),
    "L13": lambda: so.MovingSet(
        lambda t: so.Point([1 + np.sin(3 * t), t / 2, np.cos(3 * t)])
    ),
    "B14": lambda: so.Moving(
        so.Ball([0, 0], 1), lambda t: 0.8 * t * np.array([np.cos(2 * t), np.sin(2 * t)])
    ),
    "B15": lambda: so.Moving(
        so.Box([-1, -0.5], [1, 0.5]),
        wave([(0, [0, 0]), (3, [3, 1]), (6, [-3, 2.5]), (9, [0, -2])]),
    ),
    "M16": lambda: so.Moving(
        interval(1), lambda t: [3 * np.sin(2 * t) + 1.5 * np.sin(5 * t)]
    ),
    "M17": lambda: so.Moving(so.Ball([0, 0], 1), lambda t: [t, 0.0]),
    "E20": lambda: so.Moving(
        so.Box([-1, -1.1, -0.8, -0.9], [1, 1.1, 0.8, 0.9]),
        wave(
            [(t, level * np.array([2 / 3, 2 / 3, 3 / 4, 3 / 4]))
             for t, level in ((0, 0), (2, 6), (6, -6), (10, 6))]
        ),
    ),
}  # fmt: skip


@cache
def _grids() -> dict[str, np.ndarray]:
    with np.load(DATA / "reference_grids.npz") as grids:
        return dict(grids)


@cache
def case(name: str) -> Case:
    """The reference case of that name."""
    data = json.loads((DATA / "reference_cases.json").read_text())["cases"][name]
    C = SETS[name]()
    return Case(
        name=name,
        process=so.SweepingProcess(data["A"], data["B"], C, data["u0"]),
        t_end=data["T"],
        errors=data["errors"],
        polyhedral=C.at(0.0).polyhedral,
    )
