"""Projections and supports that have no closed form: a cone program, and a fixed point."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from sweepopt.errors import EmptySetError, SweepoptError
from sweepopt.sets.base import DENSE, RANK, ROUNDING, ConvexSet, binary
from sweepopt.sets.cvxpy_lock import in_turn

if TYPE_CHECKING:
    import cvxpy as cp

# steps of Clarabel that stay off the boundary of the cones, where it is stuck before its tolerance
CAREFUL: dict[str, float] = {
    "max_step_fraction": 0.8,
    "iterative_refinement_reltol": 1e-15,
    "iterative_refinement_abstol": 1e-15,
}
TIGHT = {"tol_gap_abs": 1e-12, "tol_gap_rel": 1e-12, "tol_feas": 1e-12, **CAREFUL}
SWEEPS = 500  # alternating projections before a program takes over
QUICK = 10  # of them, before anything else is tried
FEW = (10, 40, 160)  # of them, before Newton's method tries to finish
CONFIRMING = 5  # and after it
NEWTON_STEPS = 30
HALVINGS = 6
MEMORY = 10  # steps that Anderson's acceleration looks back
RUNAWAY = 1e3  # the longest step of it, in units of the data


@in_turn
def support_by_program(C: ConvexSet, z: np.ndarray) -> float:
    """sigma(C, z) from its epigraph, for sets without a closed form; infeasible means +inf."""
    import cvxpy as cp

    length = float(np.abs(z).max())
    if not length:
        return 0.0
    y, constraints = C.features(cp.Constant(z / length))
    unit = binary(np.abs(C.offsets).max(initial=0.0))
    value = (C.offsets / unit) @ cp.hstack(y) if y else cp.Constant(0.0)
    problem = cp.Problem(cp.Minimize(value), constraints)
    solve_tightly(problem)
    if problem.status in (cp.INFEASIBLE, cp.INFEASIBLE_INACCURATE):
        return float("inf")
    if problem.value is None or not np.isfinite(problem.value):
        raise EmptySetError(f"{type(C).__name__} has no point: nothing meets all its conditions")
    return length * unit * float(problem.value)


def project_by_program(C: ConvexSet, w: np.ndarray) -> np.ndarray:
    """P_C(w), for sets without a closed form."""
    return w - normal_by_program(C, w)[0]


@in_turn
def normal_by_program(C: ConvexSet, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """w - P_C(w) = argmin 1/2 |p|^2 - <w, p> + sigma(C, p), and the value of its features.

    A solver's gap leaves an error of its square root, relative to the unit of length. So the
    program is solved in units of the size of the data, and where |p| turns out to be much smaller
    once more in units of |p|.
    """
    import cvxpy as cp

    p = cp.Variable(C.dim)
    features, constraints = C.features(p)
    y = cp.hstack(features) if features else cp.Constant(np.zeros(1))
    offsets = C.offsets if features else np.zeros(1)
    size = binary(max(np.abs(w).max(initial=0.0), np.abs(C.offsets).max(initial=0.0)))

    def solve(unit: float) -> tuple[np.ndarray, np.ndarray]:
        objective = 0.5 * cp.sum_squares(p) + (offsets @ y - w @ p) / unit
        problem = cp.Problem(cp.Minimize(objective), constraints)
        solve_tightly(problem)
        if p.value is None:
            raise EmptySetError(
                f"{type(C).__name__} has no point: nothing meets all its conditions"
            )
        return unit * p.value, unit * y.value

    found = solve(size)
    distance = float(np.linalg.norm(found[0]))
    if distance < 0.01 * size:
        # a failure at this scale says nothing about the set
        with contextlib.suppress(SweepoptError):
            found = solve(binary(max(distance, 1e-6 * size)))
    return found


def solve_tightly(problem: cp.Problem) -> None:
    """Solve a small side program with Clarabel as far as double precision goes.

    Its "inaccurate" only means that 1e-12 was not reached; whoever calls checks the answer.
    """
    import cvxpy as cp

    with _clarabel_failures_named():
        problem.solve(solver=cp.CLARABEL, **TIGHT)


@contextlib.contextmanager
def _clarabel_failures_named() -> Iterator[None]:
    import cvxpy as cp

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Solution may be inaccurate")
        try:
            yield
        except cp.SolverError as error:
            raise SweepoptError(f"Clarabel failed on a side program: {error}") from error


Step = Callable[[np.ndarray], np.ndarray]


class _Reached(NamedTuple):
    """Where sweeps ended, and whether that is a fixed point to rounding."""

    x: np.ndarray
    fixed: bool


def fixed_point(
    step: Step,
    x: np.ndarray,
    like: np.ndarray,
    sweeps: int = SWEEPS,
    slope: Callable[[np.ndarray], np.ndarray | None] | None = None,
) -> np.ndarray | None:
    """x = step(x) to rounding for a nonexpansive step; None if so many sweeps do not suffice.

    Sweeps crawl where two sets are nearly tangent. With a `slope`, Newton's method tries to finish
    when a few plain ones have come to the right faces, and sweeps only confirm what it finds.

    Parameters
    ----------
    step : callable
    x : ndarray, shape (dim,)
        Start.
    like : ndarray
        Data in the units of x: rounding is relative to the larger of the two.
    slope : callable
        x -> a generalised derivative of `step`, shape (dim, dim), or None.
    """
    if slope is not None and x.size <= DENSE:
        start = x
        for few in (few for few in FEW if few <= sweeps):
            reached = _sweep(step, start, like, few, memory=0)
            start = reached.x
            if not reached.fixed:
                ahead = _newton(step, slope, start, _size(start, like))
                reached = _sweep(step, ahead, like, CONFIRMING, memory=0)
            if reached.fixed:
                return reached.x
    reached = _sweep(step, x, like, sweeps, MEMORY)
    return reached.x if reached.fixed else None


def _size(x: np.ndarray, like: np.ndarray) -> float:
    return float(max(np.abs(like).max(initial=0.0), np.abs(x).max()))


def _newton(
    step: Step, slope: Callable[[np.ndarray], np.ndarray | None], x: np.ndarray, size: float
) -> np.ndarray:
    """Semismooth Newton steps on x - step(x) = 0, the shortest ones where many x solve it.

    A step that makes the residual larger is halved: sets with hardly a curvature need that.
    """
    start, residual = x, step(x) - x
    for _ in range(NEWTON_STEPS):
        if np.abs(residual).max() <= ROUNDING * max(size, np.abs(x).max()):
            break
        D = slope(x)
        if D is None:
            break
        change = np.linalg.lstsq(np.eye(x.size) - D, residual, rcond=RANK)[0]
        ahead, left = _shortened(step, x, change, float(np.linalg.norm(residual)))
        if np.abs(ahead).max() > RUNAWAY * size:
            return start  # nearly parallel faces: what solves x = step(x) there is rounding of x
        small = np.abs(ahead - x).max() <= ROUNDING * np.abs(x).max()
        x, residual = ahead, left
        if small:
            break
    return x


def _shortened(
    step: Step, x: np.ndarray, change: np.ndarray, size: float
) -> tuple[np.ndarray, np.ndarray]:
    """x + change, or on the way there, and its residual: at a kink no part need be better."""
    tried = []
    for halvings in range(HALVINGS):
        ahead = x + 0.5**halvings * change
        tried.append((ahead, step(ahead) - ahead))
        if np.linalg.norm(tried[-1][1]) < size:
            return tried[-1]
    return tried[0]


def _sweep(step: Step, x: np.ndarray, like: np.ndarray, sweeps: int, memory: int) -> _Reached:
    """Anderson's acceleration (Walker and Ni, SIAM J. Numer. Anal. 49, 2011), with the plain
    iteration, whose residual never grows, as the safeguard of Zhang, O'Donoghue and Boyd (2020).

    Without memory the plain iteration: slow, but it never leaves the faces that it comes to.
    """
    images: list[np.ndarray] = []
    residuals: list[np.ndarray] = []
    size = _size(x, like)
    for _ in range(sweeps):
        image = step(x)
        residual = image - x
        if np.abs(residual).max() <= ROUNDING * max(size, np.abs(image).max()):
            return _Reached(image, True)
        if residuals and np.linalg.norm(residual) > np.linalg.norm(residuals[-1]):
            x, images, residuals = images[-1], [], []
            continue
        old = max(len(images) - memory, 0)
        images, residuals = [*images[old:], image], [*residuals[old:], residual]
        x = image
        if len(images) > 1:
            mix = np.linalg.lstsq(np.diff(residuals, axis=0).T, residual, rcond=1e-12)[0]
            ahead = image - np.diff(images, axis=0).T @ mix
            # no fixed point: the acceleration runs off, and would hide the residual in its size
            x = ahead if np.abs(ahead).max() <= RUNAWAY * size else image
    return _Reached(x, False)
