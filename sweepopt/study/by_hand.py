"""What a user writes without the library: loops over time with cvxpy, Clarabel, OSQP or SciPy.

Each function prepares what its author would keep between the steps and returns q -> z, the
minimiser of 1/2 <M z, z> + <q, z> + J(z), J(z) = sum of threshold_k |z[contact_k]|. None of them
proves its answer. The two on the "same program" are handed what the library compiles, with the
library's settings and scaling: the floor of what a driver can cost.
"""

from __future__ import annotations

import contextlib
import io
import time as clock
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from sweepopt.linalg import Factor
from sweepopt.problem import EvolutionVI
from sweepopt.study.cases import Case
from sweepopt.velocity import OSQP, Canonical, Clarabel, VelocityProgram

Velocity = Callable[[np.ndarray], np.ndarray]


class Run(NamedTuple):
    """A trajectory and what it cost.

    Attributes
    ----------
    u : ndarray, shape (n+1, dim)
    step, setup : float
        Seconds a step, and seconds once.
    recover : float
        Seconds a step for reading all of u after the run.
    certificate : float or None
        Worst relative certificate; None without one.
    attempts : float or None
        Solver calls a step.
    """

    u: np.ndarray
    step: float
    setup: float
    recover: float = 0.0
    certificate: float | None = None
    attempts: float | None = None


def steady(seconds: np.ndarray) -> float:
    """Seconds a step: the mean without the first and the slowest one.

    Set-up waits in the first step, and in the first one that moves: a solver is compiled there.
    """
    return float(np.sort(seconds[1:])[:-1].mean())


def loop(prepare: Callable[[Case], Velocity]) -> Callable[[Case], Run]:
    """The loop over time by hand."""

    def run(case: Case) -> Run:
        u, seconds = np.zeros((case.steps + 1, case.dim)), np.zeros(case.steps)
        B, mu = case.B, case.mu
        # OSQP's polish speaks even when it is told to be quiet
        with contextlib.redirect_stdout(io.StringIO()):
            begun = clock.perf_counter()
            velocity = prepare(case)
            for i, t in enumerate(case.times[1:]):
                started = clock.perf_counter()
                q = B @ u[i] - case.phi(t) * case.shape
                u[i + 1] = u[i] + mu * velocity(q)
                seconds[i] = clock.perf_counter() - started
            wall = clock.perf_counter() - begun
        step = steady(seconds)
        return Run(u, step, wall - step * case.steps)

    return run


# ---- without a proof, as users write it -------------------------------------------------------


def cvxpy_checked(case: Case) -> Velocity:
    """The problem stated anew at each step, at cvxpy's defaults; cvxpy tests M every time."""
    return _stated_anew(case, case.M)


def cvxpy_rebuilt(case: Case) -> Velocity:
    """The same told that M is positive definite: the naive loop at its best."""
    import cvxpy as cp

    return _stated_anew(case, cp.psd_wrap(case.M))


def _stated_anew(case: Case, M: Any) -> Velocity:
    import cvxpy as cp

    def velocity(q: np.ndarray) -> np.ndarray:
        z = cp.Variable(case.dim)
        friction = case.threshold @ cp.abs(z[case.contact])
        cp.Problem(cp.Minimize(0.5 * cp.quad_form(z, M) + q @ z + friction)).solve(cp.CLARABEL)
        return z.value

    return velocity


def cvxpy_parameters(case: Case) -> Velocity:
    """One problem whose linear term is a parameter (DPP)."""
    import cvxpy as cp

    z, q = cp.Variable(case.dim), cp.Parameter(case.dim)
    friction = case.threshold @ cp.abs(z[case.contact])
    quadratic = 0.5 * cp.quad_form(z, cp.psd_wrap(case.M))
    problem = cp.Problem(cp.Minimize(quadratic + q @ z + friction))

    def velocity(force: np.ndarray) -> np.ndarray:
        q.value = force
        problem.solve(cp.CLARABEL, enforce_dpp=True)
        return z.value

    return velocity


def clarabel_by_hand(case: Case) -> Velocity:
    """Clarabel on |z_k| <= s_k, its linear term updated, at the library's tolerance."""
    import clarabel

    P, rows = _epigraph(case)
    cones = [clarabel.NonnegativeConeT(rows.shape[0])]
    start, settings = np.append(-case.shape, case.threshold), _clarabel_settings()
    engine = clarabel.DefaultSolver(P, start, rows, np.zeros(rows.shape[0]), cones, settings)

    def velocity(q: np.ndarray) -> np.ndarray:
        engine.update(q=np.append(q, case.threshold))
        return np.array(engine.solve().x)[: case.dim]

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
        return engine.solve(raise_error=False).x[: case.dim]

    return velocity


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


# ---- the library's own program without its driver ----------------------------------------------


def clarabel_same_program(case: Case) -> Velocity:
    """Clarabel's update loop on what the library compiles."""
    import clarabel

    program, canonical = _same_program(case, "CLARABEL")
    P = sp.triu(canonical.P / program.stiffness, format="csc")
    A, b = canonical.data["A"], canonical.data["b"]
    cones = [clarabel.NonnegativeConeT(len(b))]
    settings = _clarabel_settings()

    def start(linear: np.ndarray) -> Any:
        return clarabel.DefaultSolver(P, linear, A, b, cones, settings)

    return _driven(program, canonical, start, lambda engine: engine.solve())


def osqp_same_program(case: Case) -> Velocity:
    """OSQP's update loop on what the library compiles."""
    import osqp

    program, canonical = _same_program(case, "OSQP")
    P = sp.triu(canonical.P / program.stiffness, format="csc")
    rows, top = sp.csc_matrix(canonical.data["F"]), canonical.data["G"]
    ours = OSQP()

    def start(linear: np.ndarray) -> Any:
        engine = osqp.OSQP()
        engine.setup(
            sp.csc_matrix(P),
            linear,
            rows,
            np.full(len(top), -np.inf),
            top,
            eps_abs=ours.tol,
            eps_rel=ours.tol,
            max_iter=ours.max_iter,
            polishing=True,
            verbose=False,
        )
        return engine

    return _driven(program, canonical, start, lambda engine: engine.solve(raise_error=False))


def _driven(
    program: VelocityProgram,
    canonical: Canonical,
    start: Callable[[np.ndarray], Any],
    solve: Callable[[Any], Any],
) -> Velocity:
    """Update, solve, scale: nothing else. The engine is set up at the first step."""
    dim, stiffness = program.M.dim, program.stiffness
    Q, offsets = canonical.map[:, :dim], canonical.map[:, dim:] @ program.cone.offsets
    back = Q.T.tocsr()
    engine: Any = None

    def velocity(q: np.ndarray) -> np.ndarray:
        nonlocal engine
        linear = Q @ q + offsets
        force = np.abs(linear).max()
        if engine is None:
            engine = start(linear / force)
        else:
            engine.update(q=linear / force)
        return back @ (np.array(solve(engine).x) * (force / stiffness))

    return velocity


def _same_program(case: Case, solver: str) -> tuple[VelocityProgram, Canonical]:
    """The program of C = -D; a translation by f changes its linear term only."""
    D = case.problem.dissipation if isinstance(case.problem, EvolutionVI) else None
    assert D is not None
    program = VelocityProgram(Factor(case.M), -D)
    return program, program.canonical(solver)


def _clarabel_settings() -> Any:
    """The library's."""
    import clarabel

    ours, settings = Clarabel(), clarabel.DefaultSettings()
    settings.verbose = settings.presolve_enable = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = ours.tol
    settings.max_iter = ours.max_iter
    return settings


def _epigraph(case: Case) -> tuple[sp.csc_matrix, sp.csc_matrix]:
    """P and the rows G of  min 1/2 <P x, x> + <q, x>, G x <= 0,  x = (z, s), |z_k| <= s_k."""
    m = case.contact.size
    select = sp.csr_array((np.ones(m), (np.arange(m), case.contact)), shape=(m, case.dim))
    P = sp.block_diag([sp.csc_matrix(case.M), sp.csc_matrix((m, m))])
    size = sp.eye_array(m)
    rows = sp.block_array([[select, -size], [-select, -size]])
    return sp.csc_matrix(sp.triu(P)), sp.csc_matrix(rows)
