"""C(t) = { w : N w <= d(t) } with d in closed form: what the exact integrator moves."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg

from sweepopt.errors import InputError, shown
from sweepopt.integrate.exact.forces import Forces
from sweepopt.linalg import dense
from sweepopt.loads import Constant, Separable
from sweepopt.problem import SweepingProcess
from sweepopt.sets import AnySet, ConvexSet, Moving, MovingOffsets, NoHalfspacesError, halfspaces

NONSMOOTH = 50  # unknowns in a set's inequalities
UNKNOWNS = 300  # all of them: a phase has a dense eigenproblem of what moves
SAME = 1e-14  # unit rows and offsets that differ by less are opposite ones


@dataclass(frozen=True, eq=False)
class Rows:
    """The process in the rows of C(t), which are unit vectors in the metric.

    Attributes
    ----------
    N : ndarray, shape (m, n)
        Rows, divided by their length in the metric M of the process: A, or B where A = 0.
    frozen : ndarray of bool, shape (m,)
        Rows that hold as equations at all times.
    R : ndarray, shape (m, n)
        N L with M = L L^T; unit vectors.
    NB, S : ndarray, shapes (m, n), (m, m)
        N B and R R^T = N M N^T.
    SB : ndarray, shape (m, m)
        N B N^T.
    forces : Forces
        d.
    Lam : float
        The largest rate of the process; 0 where A = 0.
    rate_independent : bool
    """

    N: np.ndarray
    frozen: np.ndarray
    R: np.ndarray
    NB: np.ndarray
    S: np.ndarray
    SB: np.ndarray
    forces: Forces
    Lam: float
    rate_independent: bool

    @cached_property
    def fixed(self) -> list[int]:
        """The rows that always hold as equations."""
        return np.flatnonzero(self.frozen).tolist()


class _Motion(NamedTuple):
    """C(t) = { N w <= base + sum phi_k(t) D_k }, the last rows as equations."""

    N: np.ndarray
    terms: list[tuple[Any, np.ndarray]]
    equations: int


def rows_of(process: SweepingProcess) -> Rows:
    """The rows of a process.

    Raises
    ------
    InputError
        If a set is curved or has no rows, the load is a black box, or there are too many unknowns.
    """
    if process.dim > UNKNOWNS:
        raise _refused(
            f"has {process.dim} unknowns in its steps, more than {UNKNOWNS}. A body whose B is a "
            "multiple of A and whose set acts on few unknowns needs these alone; for others use "
            "midpoint or sdirk2"
        )
    N, terms, equations = _motion(process.C)
    metric = dense(process.metric.M)
    B = np.zeros_like(metric) if process.B is None else dense(process.B)
    lower = scipy.linalg.cholesky(metric, lower=True)
    R = N @ lower
    lengths = np.linalg.norm(R, axis=1)
    kept = np.flatnonzero(lengths > 0)
    N, R = N[kept] / lengths[kept, None], R[kept] / lengths[kept, None]
    frozen = np.arange(lengths.size)[kept] >= lengths.size - equations
    forces = Forces([phi for phi, _ in terms], [D[kept] / lengths[kept] for _, D in terms])
    kept, frozen = _opposite(R, forces, frozen)
    N, R, forces = N[kept], R[kept], forces.only(kept)
    nonsmooth = process.dim - int(frozen.sum())
    if nonsmooth > NONSMOOTH:
        raise _refused(
            f"has {nonsmooth} nonsmooth unknowns, more than {NONSMOOTH}; use midpoint or sdirk2"
        )
    lam = 0.0 if process.rate_independent else process.Lam
    NB = N @ B
    return Rows(N, frozen, R, NB, R @ R.T, NB @ N.T, forces, lam, process.rate_independent)


def _motion(C: AnySet) -> _Motion:
    shape: Any = C
    terms: list[tuple[Any, np.ndarray]] = []
    if isinstance(C, MovingOffsets):
        shape = C.shape
        terms = _terms(C.offsets, "h")
    elif isinstance(C, Moving):
        if callable(C.scale):
            raise _refused(
                "has a set whose scale moves; state the moving bounds as offsets, "
                "so.Polyhedron(G, so.Separable(...))"
            )
        shape = C.shape if C.scale is None else C.scale_at(0.0) * C.shape
        terms = [] if C.center is None else _terms(C.center, C.center_name)
    elif not isinstance(C, ConvexSet):
        raise _refused(
            "has a set that is a function of time; write it as so.Moving(shape, "
            "center=so.Separable(...)) or so.Polyhedron(G, so.Separable(...))"
        )
    try:
        found = halfspaces(shape)
    except NoHalfspacesError as error:
        raise _refused(
            f"has a set that is not a polyhedron with known rows: {error}; use midpoint"
        ) from error
    N = np.vstack([found.N, found.E])
    base = np.concatenate([found.d, found.e])
    if not isinstance(C, MovingOffsets):
        terms = [(phi, N @ f) for phi, f in terms]
    return _Motion(N, [(Constant(1.0), base), *terms], len(found.e))


def _terms(load: Any, name: str) -> list[tuple[Any, np.ndarray]]:
    if isinstance(load, np.ndarray):
        return [(Constant(1.0), load)]
    if not isinstance(load, Separable):
        raise _refused(
            f"has a black-box {name}: a function of time tells no kinks; write it as "
            "so.Separable([(history, vector), ...]) of Polynomial, Sine, Triangle or Table"
        )
    for k, (history, _) in enumerate(load.terms):
        if not hasattr(history, "piece") or not hasattr(history, "breakpoints"):
            raise _refused(
                f"has {name} whose terms[{k}][0], {shown(history)}, has no closed form; use "
                "Constant, Polynomial, Sine, Triangle or Table, or give it piece(a, b) and "
                "breakpoints(a, b)"
            )
    return list(load.terms)


def _opposite(R: np.ndarray, forces: Forces, frozen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows that are not repeated, and which of them hold as equations.

    A pair n w <= d, -n w <= -d is an equation at all times; so is what a Box with equal bounds has.
    """
    size, gram = forces.sizes, R @ R.T
    kept = np.ones(len(R), dtype=bool)
    frozen = frozen.copy()
    for i in range(len(R)):
        for j in np.flatnonzero(np.abs(gram[i, :i]) > 1 - 1e-12).tolist() if kept[i] else []:
            sign = np.sign(gram[i, j])
            near = np.abs(R[i] - sign * R[j]).max() <= SAME
            apart = np.abs(forces.weights[i] - sign * forces.weights[j])
            if near and kept[j] and (apart <= SAME * np.maximum(size[i], size[j])).all():
                if sign < 0 or frozen[i]:
                    frozen[j] = True
                kept[i] = False
                break
    return np.flatnonzero(kept), frozen[kept]


def _refused(reason: str) -> InputError:
    return InputError(f"scheme 'exact' does not apply: the process {reason}")
