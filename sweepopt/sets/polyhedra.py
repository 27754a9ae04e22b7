"""Polyhedra: half-spaces, { w : G w <= h } and the hull of points, projected by active sets."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.linalg
import scipy.optimize
import scipy.sparse as sp

from sweepopt.checks import matrix, number, vector
from sweepopt.errors import EmptySetError, InputError, SweepoptError
from sweepopt.sets.base import (
    ROUNDING,
    ConvexSet,
    Features,
    Witness,
    project_by_program,
    same_array,
)

if TYPE_CHECKING:
    import cvxpy as cp

ACTIVE_DIM = 1000  # up to here the active-set projection is used, beyond a sparse QP
DEPENDENT = 1e-14  # the part of a unit row outside of the span of others that counts as none


class Polyhedron(ConvexSet):
    """{ w : G w <= h }:  sigma(z) = min { <h, y> : G^T y = z, y >= 0 }.

    Parameters
    ----------
    G : array_like or sparse, shape (m, dim)
    h : array_like, shape (m,), or callable t -> (m,)
        With a callable the set moves: C(t) = { w : G w <= h(t) }.

    Examples
    --------
    >>> triangle = Polyhedron([[-1, 0], [0, -1], [1, 1]], [0, 0, 1])
    >>> triangle.project([1.0, 1.0])
    array([0.5, 0.5])
    """

    polyhedral = True

    def __new__(cls, G: Any = None, h: Any = None) -> Any:  # without arguments: copy
        if callable(h):
            from sweepopt.sets.moving import MovingSet

            first = cls(G, h(0.0))
            return MovingSet(lambda t: first.with_offsets(h(t)), first.dim)
        return super().__new__(cls)

    def __init__(self, G: Any, h: Any) -> None:
        self.G = matrix("G", G)
        self.dim = self.G.shape[1]
        self._set_offsets(h)

    def _set_offsets(self, h: Any) -> None:
        self.offsets = self.h = vector("h", h, self.G.shape[0], finite=False)
        if np.isinf(self.h).any():
            i = int(np.flatnonzero(np.isinf(self.h))[0])
            raise InputError(f"h[{i}] is {self.h[i]}; leave out rows without a bound")

    def with_offsets(self, h: Any) -> Polyhedron:
        """{ w : G w <= h } with the same matrix object, so that `same_cone` is free."""
        other = copy.copy(self)
        other._set_offsets(h)
        return other

    def support(self, z: np.ndarray) -> float:
        z = vector("z", z, self.dim)
        size = float(np.abs(z).max(initial=0.0))
        if not size or not self.h.size:
            return 0.0 if not size else float("inf")
        # seen from a point of the set: h - G x >= 0 is as large as the set, wherever that is
        inside = self.project(np.zeros(self.dim))
        slack = np.maximum(self.h - self.G @ inside, 0.0)
        scale = float(slack.max()) or 1.0
        result = scipy.optimize.linprog(
            slack / scale,
            A_eq=self.G.T,
            b_eq=z / size,
            method="highs",
            options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
        )
        if result.status == 2:
            return float("inf")
        if result.fun is None:
            raise SweepoptError(f"HiGHS failed on the support function: {result.message}")
        return float(inside @ z) + size * scale * float(result.fun)

    def normal(self, v: np.ndarray) -> np.ndarray:
        v = vector("v", v, self.dim)
        slack = self.h - self.G @ v
        if (slack >= 0).all():
            return np.zeros(self.dim)
        u = None
        if self.dim <= ACTIVE_DIM:
            rounding = ROUNDING * (np.abs(self.h) + abs(self.G) @ np.abs(v))
            u = least_distance(self.G, slack, rounding)
        return v - project_by_program(self, v) if u is None else 0.0 - u

    def project(self, w: np.ndarray) -> np.ndarray:
        w = vector("w", w, self.dim)
        return w - self.normal(w)

    def witness(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray
    ) -> Witness | None:
        step = float(np.mean(tau))
        v = w + step * p
        normal = self.normal(v)
        return Witness(normal / step, v - normal, 0.0)

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        y = cp.Variable(self.h.size, nonneg=True)
        return Features([y], [self.G.T @ y == p])

    def same_cone(self, other: ConvexSet) -> bool:
        return isinstance(other, Polyhedron) and same_array(self.G, other.G)

    def require_nonempty(self, where: str = "C") -> None:
        try:
            self.project(np.zeros(self.dim))
        except EmptySetError as error:
            raise EmptySetError(f"{where} is empty: no w satisfies G w <= h") from error

    def polar(self) -> ConvexSet:
        if self.h.any():
            return super().polar()
        from sweepopt.sets.algebra import Image
        from sweepopt.sets.shapes import Orthant

        return Image(self.G.T, Orthant(self.h.size))


class HalfSpace(Polyhedron):
    """{ w : <normal, w> <= offset }:  sigma(s normal) = s offset for s >= 0, +inf elsewhere.

    Parameters
    ----------
    normal : array_like, shape (dim,), not zero
    offset : float
    """

    def __new__(cls, normal: Any = None, offset: Any = None) -> Any:
        return object.__new__(cls)

    def __init__(self, normal: Any, offset: float) -> None:
        row = vector("normal", normal)
        self.offset = number("offset", offset)
        if not row.any():
            raise InputError("normal must not be zero")
        super().__init__(row[None, :], [self.offset])

    def support(self, z: np.ndarray) -> float:
        z = vector("z", z, self.dim)
        row, length = self.G[0], float(np.linalg.norm(self.G[0]))
        factor = float(row @ (z / length)) / length
        # z must be a multiple of the row up to rounding
        if factor < 0 or np.linalg.norm(z - factor * row) > ROUNDING * np.linalg.norm(z):
            return float("inf")
        return factor * self.offset

    def normal(self, v: np.ndarray) -> np.ndarray:
        row, length = self.G[0], float(np.linalg.norm(self.G[0]))
        excess = float(row @ vector("v", v, self.dim)) - self.offset
        return max(excess, 0.0) / length * (row / length)


class Polytope(ConvexSet):
    """The convex hull of points:  sigma(z) = max_i <vertices_i, z>.

    Parameters
    ----------
    vertices : array_like, shape (m, dim)
    """

    polyhedral = True

    def __init__(self, vertices: Any) -> None:
        full = matrix("vertices", vertices)
        self.vertices = full.toarray() if sp.issparse(full) else np.asarray(full)
        if not self.vertices.size:
            raise EmptySetError("vertices is empty; give at least one point")
        self.dim = self.vertices.shape[1]
        self.offsets = np.ones(1)

    def support(self, z: np.ndarray) -> float:
        return float((self.vertices @ vector("z", z, self.dim)).max())

    def project(self, w: np.ndarray) -> np.ndarray:
        # with a_i = v_i - w: if u is the shortest with <a_i, u> >= 1 for all i, then u / |u|^2 is
        # the point of the hull of the a_i nearest to 0; no such u exists if 0 is in the hull
        w = vector("w", w, self.dim)
        arms = self.vertices - w
        size = float(np.abs(arms).max())
        if size == 0:
            return w
        ones = np.ones(len(arms))
        try:
            u = least_distance(-arms / size, -ones, ROUNDING * ones)
        except EmptySetError:
            return w
        return project_by_program(self, w) if u is None else w + size * u / (u @ u)

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        size = cp.Variable(1)
        return Features([size], [self.vertices @ p <= size])

    def same_cone(self, other: ConvexSet) -> bool:
        return isinstance(other, Polytope) and same_array(self.vertices, other.vertices)

    def magnitude(self) -> float:
        return float(np.linalg.norm(self.vertices, axis=1).max())


class Constraints(ConvexSet):
    """{ w : the cvxpy constraints that `build(w)` returns }, for sets the shapes do not cover.

    Its support function is cvxpy's conic dual. It cannot prove a solver's answer: a run on it ends
    with the status "uncertified".

    Parameters
    ----------
    dim : int
    build : callable
        Takes a cvxpy Variable of shape (dim,), returns a list of cvxpy constraints.
    """

    certifiable = False

    def __init__(self, dim: int, build: Any) -> None:
        import cvxpy as cp

        from sweepopt.sets.shapes import dimension

        self.dim = dimension(dim)
        self.offsets = np.ones(1)
        if not callable(build):
            raise InputError("build must be a function from a cvxpy Variable to constraints")
        self.build = build
        self._w = cp.Variable(self.dim)
        self._constraints = build(self._w)
        if not isinstance(self._constraints, (list, tuple)):
            raise InputError("build must return a list of cvxpy constraints")
        for i, constraint in enumerate(self._constraints):
            if not (isinstance(constraint, cp.Constraint) and constraint.is_dcp()):
                raise InputError(f"constraint {i} of build(w) is not a convex cvxpy constraint")
            if any(parameter.value is None for parameter in constraint.parameters()):
                raise InputError(f"constraint {i} of build(w) has a parameter without a value")

    def support(self, z: np.ndarray) -> float:
        import cvxpy as cp

        z = vector("z", z, self.dim)
        size = float(np.abs(z).max()) or 1.0
        problem = self._solve(cp.Maximize((z / size) @ self._w))
        unbounded = problem.status in (cp.UNBOUNDED, cp.UNBOUNDED_INACCURATE)
        return float("inf") if unbounded else size * float(problem.value)

    def project(self, w: np.ndarray) -> np.ndarray:
        import cvxpy as cp

        w = vector("w", w, self.dim)
        self._solve(cp.Minimize(cp.sum_squares(self._w - w)))
        return np.array(self._w.value)

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        size = cp.Variable(1)
        w = cp.Variable(self.dim)
        return Features([size], [cp.suppfunc(w, self.build(w))(p) <= size])

    def witness(self, p: Any, w: Any, tau: Any, y: Any) -> None:
        return None

    def same_cone(self, other: ConvexSet) -> bool:
        # what build(w) holds cannot be compared: another object is another cone
        return self is other

    def require_nonempty(self, where: str = "C") -> None:
        import cvxpy as cp

        try:
            self._solve(cp.Minimize(0))
        except EmptySetError as error:
            raise EmptySetError(f"{where} is empty: no w satisfies the constraints") from error

    def _solve(self, objective: Any) -> Any:
        import cvxpy as cp

        from sweepopt.sets.base import solve_tightly

        problem = cp.Problem(objective, list(self._constraints))
        solve_tightly(problem)
        if problem.status in (cp.INFEASIBLE, cp.INFEASIBLE_INACCURATE):
            raise EmptySetError("Constraints has no point: no w satisfies the constraints")
        if problem.value is None:
            raise SweepoptError(f"Clarabel failed on Constraints: {problem.status}")
        return problem


def least_distance(G: Any, slack: np.ndarray, rounding: np.ndarray) -> np.ndarray | None:
    """The shortest u with G u <= slack, exact to rounding on the active set it finds.

    Goldfarb and Idnani, A numerically stable dual method for solving strictly convex quadratic
    programs, Math. Programming 27 (1983), for the identity: the most violated row enters, rows
    whose multiplier would turn negative leave, and u is solved anew from the active rows.

    Parameters
    ----------
    G : ndarray or sparse, shape (m, dim)
    slack, rounding : ndarray, shape (m,)
        Right hand side, and how much of it is rounding: a smaller violation is none.

    Returns
    -------
    ndarray, shape (dim,), or None
        None if rounding keeps the method from an answer.

    Raises
    ------
    EmptySetError
        If no u exists: some rows with weights >= 0 add up to 0 <w> <= (negative number).
    """
    empty = "Polyhedron has no point: { w : G w <= h } is empty"
    lengths = np.sqrt(np.asarray((G * G).sum(axis=1), dtype=float)).ravel()
    if (slack < -rounding)[lengths == 0].any():
        raise EmptySetError(empty + ", a zero row of G has a negative h")
    rows = np.flatnonzero(lengths > 0)
    weights = 1 / lengths[rows]
    G = (
        sp.csr_array(sp.diags_array(weights) @ G[rows])
        if sp.issparse(G)
        else (weights[:, None] * G[rows])
    )
    slack, rounding = weights * slack[rows], weights * rounding[rows]
    dim = G.shape[1]
    u = np.zeros(dim)
    active: list[int] = []
    multipliers = np.zeros(0)
    Q, R = np.eye(dim), np.zeros((dim, 0))  # Q R = the active rows, transposed
    implied: list[int] = []  # rows that follow from the active ones up to rounding
    seen: set[frozenset[int]] = set()
    while frozenset(active) not in seen:
        seen.add(frozenset(active))
        excess = G @ u - slack
        over = excess - rounding - ROUNDING * np.linalg.norm(u)
        over[active + implied] = -np.inf
        if over.max(initial=-np.inf) <= 0:
            return u
        new = int(np.argmax(over))
        row = G[[new]].toarray()[0] if sp.issparse(G) else G[new]
        entering = 0.0
        while True:
            k = len(active)
            inside, outside = np.split(Q.T @ row, [k])
            shares = scipy.linalg.solve_triangular(R[:k], inside)
            falling = shares > 0
            limits = np.where(falling, multipliers / np.where(falling, shares, 1.0), np.inf)
            last = int(np.argmin(limits)) if k else -1
            longest = float(limits[last]) if k else np.inf
            free = float(outside @ outside)
            wanted = float(row @ u - slack[new]) / free if free > DEPENDENT**2 else np.inf
            length = min(wanted, longest)
            if np.isinf(length):
                # row = sum of shares <= 0 times active rows: a proof that no u exists, or rounding
                value = slack[new] - shares @ slack[active]
                if value < -100 * (rounding[new] + np.abs(shares) @ rounding[active]):
                    raise EmptySetError(empty)
                implied.append(new)
                break
            multipliers = multipliers - length * shares
            entering += length
            if np.isfinite(wanted):
                u = u - length * (Q[:, k:] @ outside)
            if wanted <= longest:
                Q, R = _append(Q, R, row)
                active.append(new)
                heights = scipy.linalg.solve_triangular(R[: k + 1], slack[active], trans=1)
                u = Q[:, : k + 1] @ heights
                multipliers = np.maximum(-scipy.linalg.solve_triangular(R[: k + 1], heights), 0.0)
                break
            Q, R = scipy.linalg.qr_delete(Q, R, last, which="col")
            del active[last]
            multipliers = np.delete(multipliers, last)
    # an active set came back: rounding turns in circles; good if nothing is really violated
    return u if (G @ u - slack).max() <= 1e-12 * np.abs(slack).max() else None


def _append(Q: np.ndarray, R: np.ndarray, column: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """QR of the matrix with one column more."""
    if R.shape[1] == 0:
        return scipy.linalg.qr(column[:, None])
    return scipy.linalg.qr_insert(Q, R, column, R.shape[1], which="col")
