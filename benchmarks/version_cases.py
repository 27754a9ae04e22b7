"""The cases that `versions.py` compares: ``python version_cases.py NAME`` prints one as JSON.

Only the public face of the library is used, so that any version can run them; matrices are
assembled here.
"""

from __future__ import annotations

import json
import sys
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

import sweepopt as so


class Measured(NamedTuple):
    """A run: its last state, worst relative certificate and seconds.

    Attributes
    ----------
    step : float or None
        Median of the steps' own times; None where steps are not the point.
    rest : float
        What the run took besides its steps.
    cpu : float
        Of the processor, for the whole run: what a busy machine disturbs least.
    value : float or None
        A number that belongs to the case: a bound, a number of steps.
    """

    u: Any
    certificate: float
    step: float | None
    rest: float
    cpu: float
    value: float | None = None


class Clock:
    """Seconds since it was made, by the wall and of the processor."""

    def __init__(self) -> None:
        self._started = time.perf_counter(), time.process_time()

    def read(self) -> tuple[float, float]:
        return time.perf_counter() - self._started[0], time.process_time() - self._started[1]


def worst(solution: so.Solution) -> float:
    return float(solution.stats["relative"].max())


def timed(process: Any, **settings: Any) -> Measured:
    """Solve, again and again for a second; the least of each time counts.

    The last state is read too.
    """
    found: list[Measured] = []
    spent = 0.0
    while not found or (spent < 1.0 and len(found) < 10):
        clock = Clock()
        solution = so.solve(process, **settings)
        u = solution.u[-1]
        seconds, cpu = clock.read()
        steps, spent = solution.stats["seconds"], spent + seconds
        rest = seconds - float(steps.sum())
        found.append(Measured(u, worst(solution), float(np.median(steps)), rest, cpu))
    least = {key: min(getattr(run, key) for run in found) for key in ("step", "rest", "cpu")}
    return found[0]._replace(**least)


def square(cells: int, path: str, steps: int = 50, tol: float = 1e-6) -> Measured:
    """Antiplane shear of the unit square, P1 on equal right triangles, B = 2 A, one period.

    Clamped above, friction below, pulled at the right; path "linear" has no friction. After a run
    on a small square, in which imports are made.
    """
    if cells > 4:
        square(4, path, 3)

    # on these triangles the form is a sum of products of forms on intervals
    def interval(nodes: int) -> tuple[Any, Any]:
        K = sp.diags_array(
            [-np.ones(nodes - 1), np.full(nodes, 2.0), -np.ones(nodes - 1)],
            offsets=[-1, 0, 1], format="lil",
        )  # fmt: skip
        weight = np.ones(nodes)
        K[0, 0] = K[-1, -1] = 1.0
        weight[[0, -1]] = 0.5
        return cells * K, weight / cells

    K, weight = interval(cells + 1)
    free = slice(0, cells)  # of the rows of nodes from the lowest one: the last is clamped
    K_up, up = K[free, free], weight[free]
    A = sp.csc_array(sp.kron(sp.diags_array(up), K) + sp.kron(K_up, sp.diags_array(weight)))
    dim, below = cells * (cells + 1), np.arange(cells + 1)
    pulled = np.zeros((cells, cells + 1))
    pulled[:, -1] = up
    load = so.Separable([(so.Sine(2.0, period=4.0), pulled.ravel())])
    friction = None
    if path != "linear":
        select = sp.csc_array((np.ones(below.size), (below, below)), shape=(dim, below.size))
        friction = so.image(select, so.Box(-0.5 * weight, 0.5 * weight))
    body = so.EvolutionVI(A, 2 * A, load=load, dissipation=friction, u0=np.zeros(dim))
    path = "auto" if path == "linear" else path
    return timed(body, t_end=4.0, steps=steps, scheme="midpoint", path=path, tol=tol)


def blocks(dim: int, steps: int) -> Measured:
    """Blocks with dashpots 0.5 and springs 2, pulled by a function of time.

    A step is the processor's time of the whole run, set-up included, by the number of steps.
    """
    pull = np.linspace(3.0, 1.5, dim)
    A, B = (sp.diags_array(np.full(dim, x), format="csc") for x in (0.5, 2.0))
    if dim == 1:
        A, B = A.toarray(), B.toarray()
    C = so.Moving(so.Box(-np.ones(dim), np.ones(dim)), center=lambda t: np.sin(2 * t) * pull)
    process = so.SweepingProcess(A, B, C, np.zeros(dim))
    so.solve(process, t_end=8.0, steps=10)
    found = timed(process, t_end=8.0, steps=steps)
    return found._replace(step=found.cpu / steps, rest=0.0)


def chain(dim: int, make: Callable[[Any], Any] | None = None) -> Any:
    """Blocks in a chain of dashpots and springs, each pulled by two sines."""
    laplace = 2 * np.eye(dim) - np.eye(dim, k=1) - np.eye(dim, k=-1)
    k = np.arange(dim)
    load = so.Separable(
        [
            (so.Sine(1.0, period=2 * np.pi), 3.0 * np.cos(k)),
            (so.Sine(1.0, period=np.pi), np.sin(2.0 * k + 1)),
        ]
    )
    shape = so.Box(-1 / (1 + k), 1 / (1 + k)) if make is None else make(dim)
    A, B = 0.5 * laplace + np.eye(dim), 2.0 * laplace
    return so.SweepingProcess(A, B, so.Moving(shape, load), np.zeros(dim))


def composed(name: str) -> Measured:
    """A set made of others, on 12 blocks in a chain."""

    def make(dim: int) -> Any:
        random = np.random.default_rng(0)
        box, ball = so.Box(-np.ones(dim), np.ones(dim)), so.Ball(np.zeros(dim), 1.2)
        few = so.Box(-np.ones(dim // 2), np.ones(dim // 2))
        rows = so.Polyhedron(random.normal(size=(dim, dim // 2)), np.ones(dim))
        sets = {
            "product": lambda: so.product(so.Ball(np.zeros(dim // 2), 1.0), rows),
            "sum": lambda: 0.5 * box + ball,
            "intersection": lambda: box & ball,
            "image": lambda: so.image(random.normal(size=(dim, dim // 2)), few) + 0.2 * ball,
        }
        return sets[name]()

    process = chain(12, make)
    so.solve(process, t_end=1.0, steps=3)
    return timed(process, t_end=10.0, steps=200)


def exact() -> Measured:

    so.solve(chain(2), t_end=1.0, steps=3, scheme="exact")
    found = timed(chain(12), t_end=10.0, steps=100, scheme="exact")
    return found._replace(step=None)


def adaptive() -> Measured:
    process = chain(3)
    so.solve(process, t_end=1.0, steps=3)
    clock = Clock()
    solution = so.solve(process, t_end=10.0, steps=so.Adaptive(1e-5))
    times = clock.read()
    steps = sum(run.steps for run in solution.passes)
    return Measured(solution.u[-1], worst(solution), None, *times, steps)


def error_bound() -> Measured:
    solution = so.solve(chain(3), t_end=10.0, steps=1000)
    clock = Clock()
    bound = float(solution.error_bound())
    return Measured(solution.u[-1], worst(solution), None, *clock.read(), bound)


CASES: dict[str, Callable[[], Measured]] = {
    "one unknown": partial(blocks, 1, 10_000),
    "200 boxes": partial(blocks, 200, 1000),
    **{
        f"{path} {name}": partial(square, cells, path)
        for name, cells in (("1e3", 32), ("1e4", 100))
        for path in ("proportional", "eliminated", "linear")
    },
    **{
        f"{path} 1e5": partial(square, 316, path, 20)
        for path in ("proportional", "eliminated", "linear")
    },
    "full 1e3": partial(square, 32, "full"),
    "full 1e3, tol 1e-2": partial(square, 32, "full", tol=1e-2),
    "full 1e3, tol 1e-8": partial(square, 32, "full", tol=1e-8),
    "full 1e4": partial(square, 100, "full", 12),
    **{name: partial(composed, name) for name in ("product", "sum", "intersection", "image")},
    "exact": exact,
    "adaptive": adaptive,
    "error_bound": error_bound,
    **{
        f"{path} 1e6": partial(square, 1000, path, 8)
        for path in ("proportional", "eliminated", "linear")
    },
}


def main(name: str) -> None:
    """Run a case and say what it took; without a case, which there are."""
    if not name:
        print(json.dumps(list(CASES)))
        return
    warnings.simplefilter("ignore", so.SweepoptWarning)
    found = CASES[name]()
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.exists() else []
    peak = [float(line.split()[1]) / 1e3 for line in lines if line.startswith("VmHWM")]
    # sums with random weights: their difference is that of the states, to about a fifth
    random = np.random.default_rng(0)
    sums = [float(random.normal(size=found.u.size) @ found.u) for _ in range(16)]
    told = {**found._replace(u=None)._asdict(), "peak": peak[0] if peak else None, "sums": sums}
    print(json.dumps(told))


if __name__ == "__main__":
    main(" ".join(sys.argv[1:]))
