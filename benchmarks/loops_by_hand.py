"""What a certified step costs, beside the loops over time that a user writes by hand.

    python benchmarks/loops_by_hand.py --cells 32 100

Every path of the library and every loop runs once in each round, in turn, so that what slows the
machine slows all of them; the table has the ratios of each round and the accuracy beside the time.
The loops (cvxpy, Clarabel, OSQP, SciPy) prove nothing. Each prepares what its author would keep
between the steps and returns q -> z, the minimiser of

    1/2 <M z, z> + <q, z> + sum of threshold_k |z[contact_k]|,   M = A + mu B,

which is a step of implicit Euler.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import io
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf, nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import scipy.sparse as sp
import scipy.sparse.linalg as spla

import sweepopt as so
from sweepopt.study import machine

SCHEME = "implicit-euler"
NAIVE, LINEAR = "cvxpy-rebuilt", "frictionless"
BLOCKS = (1, 200)
BLOCK_STEPS = 20  # a block's step is so short that each round takes more of them
Velocity = Callable[[np.ndarray], np.ndarray]


# ---- the processes ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Case:
    """A process with the load phi(t) shape and friction on some unknowns, at rest at t = 0.

    `frictionless` is the same without its set; `best` is the library's most accurate path.
    """

    name: str
    problem: Any
    frictionless: Any
    phi: Callable[[Any], Any]
    shape: np.ndarray
    contact: np.ndarray
    threshold: np.ndarray
    times: np.ndarray
    best: str

    @property
    def steps(self) -> int:
        return len(self.times) - 1

    @property
    def mu(self) -> float:
        return float(self.times[-1]) / self.steps

    @property
    def M(self) -> Any:
        return self.problem.A + self.mu * self.problem.B


def square(cells: int, steps: int) -> Case:
    """Antiplane friction on the unit square, P1: clamped above, rubbing below, pulled at the right.

    Uniform coefficients, so that B = 2 A; one period of the traction, in which slip zones grow,
    stop and turn round. 32, 100, 316 and 1000 cells a side give 1,056, 10,100, 100,172 and
    1,001,000 unknowns.
    """
    from skfem import MeshTri

    from sweepopt.fem import Elasticity, Friction, Traction, Viscosity, antiplane

    side = np.linspace(0.0, 1.0, cells + 1)
    mesh = MeshTri.init_tensor(side, side).with_defaults()
    wave = so.Sine(amplitude=2.0, period=4.0)
    pulled = [Viscosity(1.0), Elasticity(2.0), Traction("right", history=wave)]
    scene = antiplane(mesh, clamped="top", effects=[*pulled, Friction("bottom", g=0.5)])
    return Case(
        f"unit square, {cells} cells a side",
        scene.problem,
        antiplane(mesh, clamped="top", effects=pulled).problem,
        wave,
        scene.problem.load.shapes[:, 0],
        scene.contact.unknown,
        scene.contact.threshold,
        np.linspace(0.0, 4.0, steps + 1),
        "eliminated",
    )


def blocks(dim: int, steps: int) -> Case:
    """Blocks with dashpots 0.5, springs 2 and friction bound 1, pulled by up to 3."""
    shape = np.linspace(3.0, 1.5, dim)
    A, B = (sp.diags_array(np.full(dim, value), format="csc") for value in (0.5, 2.0))
    if dim == 1:
        A, B = A.toarray(), B.toarray()
    C = so.Moving(so.Box(-np.ones(dim), np.ones(dim)), center=lambda t: np.sin(2 * t) * shape)
    return Case(
        "a block on a spring" if dim == 1 else f"{dim} blocks on springs",
        so.SweepingProcess(A, B, C, np.zeros(dim)),
        None,
        lambda t: np.sin(2 * t),
        shape,
        np.arange(dim),
        np.ones(dim),
        np.linspace(0.0, 8.0, steps + 1),
        "auto",
    )


# ---- runs -------------------------------------------------------------------------------------


class Run(NamedTuple):
    """A trajectory and what it cost: seconds a step, seconds once, seconds a step to read u."""

    u: np.ndarray
    step: float
    setup: float
    recover: float = 0.0
    certificate: float = nan
    attempts: float = nan


def steady(seconds: np.ndarray) -> float:
    """Seconds a step: the mean without the first and the slowest one, which hold the set-up."""
    return float(np.sort(seconds[1:])[:-1].mean())


def loop(prepare: Callable[[Case], Velocity]) -> Callable[[Case], Run]:
    """The loop over time by hand."""

    def run(case: Case) -> Run:
        u, seconds = np.zeros((case.steps + 1, case.shape.size)), np.zeros(case.steps)
        B, mu = case.problem.B, case.mu
        with contextlib.redirect_stdout(io.StringIO()):  # OSQP's polish prints all the same
            begun = time.perf_counter()
            velocity = prepare(case)
            for i, t in enumerate(case.times[1:]):
                started = time.perf_counter()
                q = B @ u[i] - case.phi(t) * case.shape
                u[i + 1] = u[i] + mu * velocity(q)
                seconds[i] = time.perf_counter() - started
            wall = time.perf_counter() - begun
        step = steady(seconds)
        return Run(u, step, wall - step * case.steps)

    return run


def library(
    path: str, solver: str = "auto", friction: bool = True, tol: float = 1e-6
) -> Callable[[Case], Run]:
    """`sweepopt.solve` on one path.

    A step costs what the loop's own clock says, and its share of the look at C(t) at all times that
    precedes the loop; the rest of the call is set-up.
    """

    def run(case: Case) -> Run:
        process = (case.problem if friction else case.frictionless).as_sweeping()
        times = [time.perf_counter()]
        sol = so.solve(
            process,
            t_end=float(case.times[-1]),
            steps=case.steps,
            scheme=SCHEME,
            solver=solver,
            tol=tol,
            path=path,
        )
        times.append(time.perf_counter())
        u = np.asarray(sol.u)
        times.append(time.perf_counter())
        process.check(case.times)
        times.append(time.perf_counter())
        wall, read, checked = np.diff(times)
        step = steady(sol.stats["seconds"]) + checked / case.steps
        return Run(
            u,
            step,
            wall - step * case.steps,
            read / case.steps,
            float(sol.stats["relative"].max()),
            float(sol.stats["attempts"].mean()),
        )

    return run


def whole(run: Callable[[Case], Run]) -> Callable[[Case], Run]:
    """The same with its set-up shared by the steps: what a tiny process costs all in all."""

    def shared(case: Case) -> Run:
        found = run(case)
        return found._replace(step=found.step + found.setup / case.steps, setup=0.0)

    return shared


# ---- loops by hand ----------------------------------------------------------------------------


def cvxpy_checked(case: Case) -> Velocity:
    """The problem stated anew at each step, at cvxpy's defaults; cvxpy tests M every time."""
    return _stated_anew(case, case.M)


def cvxpy_rebuilt(case: Case) -> Velocity:
    """The same with M declared positive definite: the naive loop at its best."""
    import cvxpy as cp

    return _stated_anew(case, cp.psd_wrap(case.M))


def _stated_anew(case: Case, M: Any) -> Velocity:
    import cvxpy as cp

    def velocity(q: np.ndarray) -> np.ndarray:
        z = cp.Variable(q.size)
        friction = case.threshold @ cp.abs(z[case.contact])
        cp.Problem(cp.Minimize(0.5 * cp.quad_form(z, M) + q @ z + friction)).solve(cp.CLARABEL)
        return z.value

    return velocity


def cvxpy_parameters(case: Case) -> Velocity:
    """One problem whose linear term is a parameter (DPP)."""
    import cvxpy as cp

    z, q = cp.Variable(case.shape.size), cp.Parameter(case.shape.size)
    friction = case.threshold @ cp.abs(z[case.contact])
    quadratic = 0.5 * cp.quad_form(z, cp.psd_wrap(case.M))
    problem = cp.Problem(cp.Minimize(quadratic + q @ z + friction))

    def velocity(force: np.ndarray) -> np.ndarray:
        q.value = force
        problem.solve(cp.CLARABEL, enforce_dpp=True)
        return z.value

    return velocity


def clarabel_by_hand(case: Case) -> Velocity:
    """Clarabel on |z_k| <= s_k, its linear term updated, at the library's tolerance of 1e-9."""
    import clarabel

    P, rows = _epigraph(case)
    cones = [clarabel.NonnegativeConeT(rows.shape[0])]
    settings = clarabel.DefaultSettings()
    settings.verbose = settings.presolve_enable = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-9
    start = np.append(-case.shape, case.threshold)
    engine = clarabel.DefaultSolver(P, start, rows, np.zeros(rows.shape[0]), cones, settings)

    def velocity(q: np.ndarray) -> np.ndarray:
        engine.update(q=np.append(q, case.threshold))
        return np.array(engine.solve().x)[: q.size]

    return velocity


def osqp_by_hand(case: Case) -> Velocity:
    """OSQP on |z_k| <= s_k, its linear term updated, warm started, at 1e-8 without polish."""
    import osqp

    P, rows = _epigraph(case)
    below, start = np.full(rows.shape[0], -np.inf), np.append(-case.shape, case.threshold)
    engine = osqp.OSQP()
    settings = {"eps_abs": 1e-8, "eps_rel": 1e-8, "max_iter": 20_000, "verbose": False}
    engine.setup(P, start, rows, below, np.zeros(rows.shape[0]), **settings)

    def velocity(q: np.ndarray) -> np.ndarray:
        engine.update(q=np.append(q, case.threshold))
        return engine.solve(raise_error=False).x[: q.size]

    return velocity


def _epigraph(case: Case) -> tuple[sp.csc_matrix, sp.csc_matrix]:
    """P and the rows G of  min 1/2 <P x, x> + <q, x>, G x <= 0,  x = (z, s), |z_k| <= s_k."""
    m, dim = case.contact.size, case.shape.size
    select = sp.csr_array((np.ones(m), (np.arange(m), case.contact)), shape=(m, dim))
    P = sp.block_diag([sp.csc_matrix(case.M), sp.csc_matrix((m, m))])
    one = sp.eye_array(m)
    rows = sp.block_array([[select, -one], [-select, -one]])
    return sp.csc_matrix(sp.triu(P)), sp.csc_matrix(rows)


def linear_by_hand(case: Case) -> Velocity:
    """The frictionless step: one solve with SciPy's factorisation."""
    factor = spla.splu(
        sp.csc_matrix(case.M),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    return lambda q: factor.solve(-q)


def closed_form_by_hand(case: Case) -> Velocity:
    """M diagonal: entry by entry."""
    weight, bound = case.M.diagonal(), case.threshold
    return lambda q: (q.clip(-bound, bound) - q) / weight


# ---- who takes part ---------------------------------------------------------------------------


class Contestant(NamedTuple):
    """A way to compute a trajectory.

    Attributes
    ----------
    path : str
    run : callable
        Case -> Run.
    accuracy : float
        How far from the reference it may be, relative.
    most : float
        Unknowns; a slow one leaves out larger cases.
    friction : bool
        Whether it computes the process, or the one without its set.
    by_hand : str
        The loop that solves the same programs without proof.
    """

    path: str
    run: Callable[[Case], Run]
    accuracy: float
    most: float = inf
    friction: bool = True
    by_hand: str = ""


SMALL, SMALLER = 30_000, 11_000  # unknowns: seconds a step beyond
SQUARE = (
    Contestant("proportional", library("proportional"), 1e-10),
    Contestant("eliminated", library("eliminated"), 1e-10),
    Contestant(LINEAR, library("full", friction=False), 1e-12, inf, False, "linear-by-hand"),
    Contestant("linear-by-hand", loop(linear_by_hand), 1e-12, friction=False),
    Contestant("full-auto", library("full"), 1e-6, SMALL),
    Contestant("full-clarabel", library("full", "clarabel"), 1e-6, SMALL, True, "clarabel-by-hand"),
    Contestant("clarabel-by-hand", loop(clarabel_by_hand), 1e-4, SMALL),
    Contestant("full-osqp", library("full", "osqp"), 1e-6, SMALL, True, "osqp-by-hand"),
    Contestant("osqp-by-hand", loop(osqp_by_hand), 1e-4, SMALL),
    Contestant("cvxpy-parameters", loop(cvxpy_parameters), 1e-3, SMALLER),
    Contestant(NAIVE, loop(cvxpy_rebuilt), 1e-3, SMALLER),
    Contestant("cvxpy-checked", loop(cvxpy_checked), 1e-3, SMALLER),
)
TINY = (
    Contestant("closed-form", whole(library("auto")), 1e-12, by_hand="closed-form-by-hand"),
    Contestant("closed-form-by-hand", whole(loop(closed_form_by_hand)), 1e-12),
)


# ---- the table --------------------------------------------------------------------------------

FORMATS = {
    "path": "{:s}",
    "ms/step": "{:.4g}",
    "+-": "{:.0%}",
    "set-up s": "{:.3f}",
    "u ms": "{:.3g}",
    "tries": "{:.2f}",
    "certificate": "{:.0e}",
    "difference": "{:.0e}",
    "x faster": "{:.3g}",
    "x linear": "{:.3g}",
    "x by hand": "{:.2f}",
}
LEGEND = """\
ms/step     the mean over a run without its set-up (blocks: with it), the median over the rounds
+-          (largest - smallest) / median of the rounds
u ms        reading all of u after the run, a step
tries       solver calls a step
certificate the worst, relative: what tol bounds; loops by hand have none
difference  of u from the reference's, the largest in |.|_A, relative
x faster    than cvxpy-rebuilt
x linear    the cost in units of the frictionless step
x by hand   the cost in units of the loop by hand over the same programs"""


def bench(
    cells: Sequence[int] = (32, 100),
    steps: int = 50,
    rounds: int = 3,
    only: Sequence[str] | None = None,
) -> pd.DataFrame:
    """Time all that take part; a row each, by case."""
    cases = [(square(size, steps), SQUARE) for size in cells]
    cases += [(blocks(dim, BLOCK_STEPS * steps), TINY) for dim in BLOCKS]
    rows: list[dict[str, Any]] = []
    for case, contestants in cases:
        chosen = [
            one
            for one in contestants
            if case.shape.size <= one.most and (only is None or one.path in only)
        ]
        rows += measured(case, chosen, rounds)
    return pd.DataFrame(rows)


def measured(case: Case, contestants: Sequence[Contestant], rounds: int) -> list[dict[str, Any]]:
    """Run the contestants in turn, several rounds, and compare each with its reference."""
    references = {
        friction: library(case.best if friction else "full", friction=friction, tol=1e-9)(case).u
        for friction in {contestant.friction for contestant in contestants}
    }
    runs: dict[str, list[Run]] = {contestant.path: [] for contestant in contestants}
    away = dict.fromkeys(runs, 0.0)
    for _ in range(rounds):
        for contestant in contestants:
            print(f"{case.name}: {contestant.path}", file=sys.stderr)
            gc.collect()
            run = contestant.run(case)
            apart = difference(case, run.u, references[contestant.friction])
            away[contestant.path] = max(away[contestant.path], apart)
            runs[contestant.path].append(run._replace(u=np.empty(0)))

    def ratio(one: str, other: str) -> float:
        """Of times, each round for itself."""
        pairs = zip(runs[one], runs.get(other, []), strict=False)
        ratios = [a.step / b.step for a, b in pairs]
        return float(np.median(ratios)) if ratios else nan

    rows = []
    for path, _, _, _, _, by_hand in contestants:
        steps = [run.step for run in runs[path]]
        rows.append(
            {
                "case": f"{case.name}: {case.shape.size:,} unknowns, {case.contact.size:,} with "
                f"friction, {case.steps:,} steps, {rounds} rounds",
                "path": path,
                "ms/step": 1e3 * float(np.median(steps)),
                "+-": float(np.ptp(steps) / np.median(steps)),
                "set-up s": max(float(np.median([run.setup for run in runs[path]])), 0.0),
                "u ms": 1e3 * float(np.median([run.recover for run in runs[path]])),
                "tries": runs[path][0].attempts,
                "certificate": runs[path][0].certificate,
                "difference": away[path],
                "x faster": 1.0 / ratio(path, NAIVE),
                "x linear": ratio(path, LINEAR),
                "x by hand": ratio(path, by_hand),
            }
        )
    return rows


def difference(case: Case, u: np.ndarray, reference: np.ndarray) -> float:
    """max_i |u_i - r_i|_A / max_i |r_i|_A."""
    A = case.problem.A
    apart, size = (max(float(x @ (A @ x)) for x in rows) for rows in (u - reference, reference))
    return float(np.sqrt(apart / size))


def text(table: pd.DataFrame) -> str:
    """The rows as text: a block for each case, the legend below."""
    blocks_ = [f"{machine()}\nscheme {SCHEME}; in each round all paths of a case run in turn"]
    for case, rows in table.groupby("case", sort=False):
        shown = rows.drop(columns="case")
        formatters = {
            name: (lambda x, form=FORMATS[name]: "-" if x != x else form.format(x))
            for name in shown.columns
        }
        blocks_.append(f"{case}\n{shown.to_string(index=False, formatters=formatters)}")
    return "\n\n".join([*blocks_, LEGEND])


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="A certified step beside loops by hand.")
    parser.add_argument("--cells", type=int, nargs="+", default=[32, 100], help="cells a side")
    parser.add_argument("--steps", type=int, default=50, help="at least 3")
    parser.add_argument("--rounds", type=int, default=3, help="each path runs once a round")
    paths = [contestant.path for contestant in (*SQUARE, *TINY)]
    parser.add_argument("--only", nargs="+", metavar="PATH", choices=paths, help=", ".join(paths))
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write the rows too")
    chosen = parser.parse_args(arguments)
    table = bench(chosen.cells, chosen.steps, chosen.rounds, chosen.only)
    print(text(table))
    if chosen.csv is not None:
        table.to_csv(chosen.csv, index=False)


if __name__ == "__main__":
    main()
