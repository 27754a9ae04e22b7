"""A guaranteed bound of the error of a whole trajectory, without unknown constants (MATH 4).

Let v be a Lipschitz function, w(t) any selection in C(t), and

    r = A v' + B v - w,      G = sigma(C(t), -v') + <v', w>  >= 0.

Then for e = u - v, as monotonicity of the normal cone gives <e', A e' + B e + r> <= G:

    |e(t)|_A <= K(t) |e(0)|_A + int K(t - s) sqrt(2 G + |r|^2) ds      (fan; | | of A^-1 for r)
    |e(t)|_B^2 <= |e(0)|_B^2 + int 2 G + |r|^2 / 2                     (energy)
    |e(t)|_A <= |e(0)|_A + sqrt(t (|e(0)|_B^2 + int 2 G + |r|^2)).

K(tau) = min(exp(nu tau), 1 + sqrt(Lam tau / 2)), nu = (Lam - lam)^2 / (8 (Lam + lam)), with
lam <= Lam the extreme eigenvalues of A^-1 B, and |e|_A <= |e|_B / sqrt(lam). Where A = 0, | | are
those of B and

    |e(t)|_B <= R + sqrt(R^2 + 2 int G),   R = sup |r| + int |r'|,

r continuous: <e', B e> <= G - <e', r>, and int <e', r> = <e, r> - int <e, r'> for e(0) = 0.

v is taken through the nodes of a run: cubic on each step with the slopes Phi(t_i, u_i), or linear
where sigma would be infinite. w(t) = center(t) + scale(t) s(t), s a curve in S between projections,
so that a solver's inexactness is in r and G. Both are bounded on the whole of each step: G by the
convexity of sigma, r as a polynomial and the interpolation error of histories (`residuals`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sweepopt.integrate import MEMORY, SCHEMES, Grid, Run, divided, integrate, saving, time_grid
from sweepopt.linalg import EPS
from sweepopt.problem import Norms, SweepingProcess
from sweepopt.results.nodes import Nodes, cubic
from sweepopt.results.residuals import Residuals, residuals
from sweepopt.velocity import Plan, compile_projection

SUMMED = 64 * EPS  # rounding of a run's sums, in units of |u|_A and the root of its steps
FINER = 8  # of a step, for the second run where A = 0: its error is of first order too
TOL = 1e-9  # of the second run's programs: their error is in the bound


class ErrorBound(float):
    """A bound of sup_t |u(t) - u_n(t)|_A (|.|_B where A = 0), a number that knows more.

    Attributes
    ----------
    guaranteed : bool
        Whether it holds for certain, up to rounding: False where C(t) is known at samples only.
    t : ndarray, shape (n+1,)
    of_t : ndarray, shape (n,)
        The bound on each step [t_i, t_{i+1}].
    B : ndarray, shape (n,)
        The bound of |u(t) - u_n(t)|_B on each step.
    lower : float
        A lower bound of the same supremum; 0 where none is known.
    """

    guaranteed: bool
    t: np.ndarray
    of_t: np.ndarray
    B: np.ndarray
    lower: float

    @classmethod
    def make(
        cls, guaranteed: bool, t: np.ndarray, of_t: np.ndarray, B: np.ndarray, lower: float
    ) -> ErrorBound:
        # what overflows on the way, inf - inf for example, is not bounded
        of_t, B = (np.where(np.isnan(one), np.inf, one) for one in (of_t, B))
        bound = cls(of_t.max(initial=0.0))
        bound.guaranteed, bound.t, bound.of_t, bound.B = guaranteed, t, of_t, B
        bound.lower = lower if math.isfinite(lower) else 0.0
        return bound


def error_bound(
    process: SweepingProcess,
    plan: Plan,
    run: Nodes,
    variation: Callable[[float], float] | None = None,
) -> ErrorBound:
    """The bound of a run, with v through its own nodes or those of a more accurate second run."""
    own = plan.scheme.order >= 2 and not process.rate_independent
    norms = Norms(process)
    if norms.beta == 0 or norms.Lam == math.inf:  # A, to rounding, may be singular
        none = np.full(len(run.t) - 1, math.inf)
        return ErrorBound.make(False, run.t, none, none, 0.0)
    plan = replace(plan, reduction=None, tol=min(plan.tol, TOL))
    nodes = run if own else _second_run(process, plan, run.t)
    phi = compile_projection(plan, process.metric)
    integrals = residuals(process, phi, norms, nodes, variation)
    error_A, error_B = _growth(norms, nodes.t, integrals)
    states = np.column_stack([np.interp(nodes.t, run.t, u) for u in run.u.T])
    difference = _difference(nodes, integrals.slopes, states)
    rounding = SUMMED * math.sqrt(len(nodes.t)) * norms.A(nodes.u).max()
    parts = (len(nodes.t) - 1) // (len(run.t) - 1)

    def on_steps(bound: np.ndarray) -> np.ndarray:
        return (bound + rounding).reshape(-1, parts).max(axis=1)

    # without factors Lam is what an iteration shows of it, and proved by no pivots
    proved = process.metric.method == "factors"
    return ErrorBound.make(
        guaranteed=integrals.guaranteed and proved,
        t=run.t,
        of_t=on_steps(norms.A(difference).max(axis=1) + error_A[1:]),
        B=on_steps(norms.B(difference).max(axis=1) + error_B[1:]),
        lower=0.0 if own else max(float((norms.A(nodes.u - states) - error_A).max()), 0.0),
    )


def _second_run(process: SweepingProcess, plan: Plan, t: np.ndarray) -> Nodes:
    """Midpoint on the same grid; where A = 0 implicit Euler on a finer one."""
    if process.rate_independent:
        return nodes_of(process, replace(plan, scheme=SCHEMES["implicit-euler"]), divided(t, FINER))
    return nodes_of(process, replace(plan, scheme=SCHEMES["midpoint"]), t)


def nodes_of(process: SweepingProcess, plan: Plan, t: np.ndarray) -> Nodes:
    """All nodes of a run on the grid t; where its programs miss tol, their residual is bounded."""
    times, mus = time_grid(None, t)
    grid = Grid(times, mus, plan, saving(None, times, process.dim, MEMORY))
    for tol in (plan.tol, math.inf):
        run = Run(grid, process.u0)
        integrate(process, replace(plan, tol=tol), run)
        if run.done == len(mus):
            break
    states = run.states()
    return Nodes(times, states.u(slice(None)), states.velocity(slice(None)))


def _growth(norms: Norms, t: np.ndarray, integrals: Residuals) -> tuple[np.ndarray, np.ndarray]:
    """The smallest of the theorem's bounds of |u - v|_A and |u - v|_B at each node.

    Off, of 180 bounds: the fan makes 38 larger (up to 14 times), |.|_B / sqrt(lam) 132 (6.5), the
    energy 8 (1.8), for |.|_B the root of the squares 148 (15), the sum 53 (6.5).
    """
    gaps, squares = integrals.gaps, integrals.squares
    if norms.rate_independent:
        R = np.maximum.accumulate(integrals.largest) + np.cumsum(integrals.turning)
        error = np.append(0.0, R + np.sqrt(R**2 + np.cumsum(gaps)))
        return error, error
    once = np.sqrt(np.diff(t) * (gaps + squares))  # Cauchy and Schwarz: int sqrt(2 G + |r|^2)
    B = np.zeros(len(t))
    root = math.sqrt(norms.Lam)
    for i, (a, b) in enumerate(zip(gaps + 0.5 * squares, root * once, strict=True)):
        B[i + 1] = min(math.sqrt(B[i] ** 2 + a), B[i] + b)
    energy = np.sqrt((t - t[0]) * np.append(0.0, np.cumsum(gaps + squares)))
    A = np.minimum(energy, _fan(norms, t, once))
    if norms.lam > 0:
        A = np.minimum(A, B / math.sqrt(norms.lam))
    return A, B if norms.Lam else np.zeros(len(t))


def _fan(norms: Norms, t: np.ndarray, once: np.ndarray) -> np.ndarray:
    """sum_j K(t_i - t_j) int_j sqrt(2 G + |r|^2) at every node; of many, at 2000 of them."""
    n = len(once)
    ends = np.append(np.arange(0, n, max(n // 2000, 1)), n)
    some = np.array([float(norms.growth(t[m] - t[:m]) @ once[:m]) for m in ends])
    # it never falls: between two of them the later one holds
    return some[np.searchsorted(ends, np.arange(n + 1))]


def _difference(nodes: Nodes, slopes: np.ndarray, u: np.ndarray) -> np.ndarray:
    """v - u_n on each step, u at its nodes: Bernstein coefficients, shape (n, 4, dim)."""
    h = np.diff(nodes.t)[:, None, None]
    share = (np.arange(4) / 3)[:, None]
    return (
        cubic(nodes.u[:-1], nodes.u[1:], h * slopes)
        - (1 - share) * u[:-1, None]
        - share * u[1:, None]
    )
