"""Polyhedra: half-spaces, { w : G w <= h } and the hull of points, projected by active sets."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.optimize
import scipy.sparse as sp

from sweepopt.checks import matrix, number, vector
from sweepopt.errors import EmptySetError, InputError
from sweepopt.sets.base import (
    ROUNDING,
    ConvexSet,
    Features,
    project_by_program,
    same_array,
    support_by_program,
)

if TYPE_CHECKING:
    import cvxpy as cp

DENSE_ROWS = 1000  # up to here the active-set projection is used, beyond a sparse QP


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

    def __new__(cls, G: Any, h: Any) -> Any:
        if callable(h):
            from sweepopt.sets.moving import MovingSet

            return MovingSet(lambda t, fixed=matrix("G", G): cls(fixed, h(t)))
        return super().__new__(cls)

    def __init__(self, G: Any, h: Any) -> None:
        self.G = matrix("G", G)
        rows, self.dim = self.G.shape
        self.offsets = self.h = vector("h", h, rows, finite=False)
        if np.isinf(self.h).any():
            i = int(np.flatnonzero(np.isinf(self.h))[0])
            raise InputError(f"h[{i}] is {self.h[i]}; leave out rows without a bound")

    def support(self, z: np.ndarray) -> float:
        z = vector("z", z, self.dim)
        if not z.any():
            return 0.0
        size = float(np.abs(z).max())
        result = scipy.optimize.linprog(self.h, A_eq=self.G.T, b_eq=z / size, method="highs")
        if result.status == 2:
            return float("inf")
        if result.status == 3:
            raise EmptySetError("Polyhedron has no point: { w : G w <= h } is empty")
        return size * float(result.fun)

    def project(self, w: np.ndarray) -> np.ndarray:
        w = vector("w", w, self.dim)
        slack = self.h - self.G @ w
        if (slack >= 0).all():
            return w
        if self.G.shape[0] > DENSE_ROWS:
            return project_by_program(self, w)
        G = self.G.toarray() if sp.issparse(self.G) else self.G
        return w + least_distance(G, slack)

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        y = cp.Variable(self.h.size, nonneg=True)
        return Features([y], [self.G.T @ y == p])

    def same_cone(self, other: ConvexSet) -> bool:
        return isinstance(other, Polyhedron) and same_array(self.G, other.G)

    def require_nonempty(self, where: str = "C") -> None:
        try:
            inside = self.project(np.zeros(self.dim))
        except EmptySetError as error:
            raise EmptySetError(f"{where} is empty: no w satisfies G w <= h") from error
        excess = self.G @ inside - self.h
        size = abs(self.G) @ np.abs(inside) + np.abs(self.h)
        if (excess > 1e-12 * size).any():
            i = int(np.argmax(excess - 1e-12 * size))
            raise EmptySetError(f"{where} is empty: row {i} of G w <= h is violated everywhere")

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

    def __new__(cls, normal: Any, offset: Any) -> Any:
        return object.__new__(cls)

    def __init__(self, normal: Any, offset: float) -> None:
        self.normal = vector("normal", normal)
        self.offset = number("offset", offset)
        if not self.normal.any():
            raise InputError("normal must not be zero")
        super().__init__(self.normal[None, :], [self.offset])

    def support(self, z: np.ndarray) -> float:
        z = vector("z", z, self.dim)
        factor = float(self.normal @ z / (self.normal @ self.normal))
        # z must be a multiple of the normal up to rounding
        if factor < 0 or np.linalg.norm(z - factor * self.normal) > ROUNDING * np.linalg.norm(z):
            return float("inf")
        return factor * self.offset

    def project(self, w: np.ndarray) -> np.ndarray:
        w = vector("w", w, self.dim)
        excess = float(self.normal @ w) - self.offset
        return w - max(excess, 0.0) / float(self.normal @ self.normal) * self.normal


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
        # the point of the hull of (vertices - w) nearest to 0 is sum theta_i (v_i - w) / sum theta
        # for the theta >= 0 that minimises |sum theta_i (v_i - w)|^2 + s^2 (1 - sum theta)^2
        w = vector("w", w, self.dim)
        arms = self.vertices - w
        size = float(np.abs(arms).max())
        if size == 0:
            return w
        theta = nonnegative_least_squares(
            np.vstack([arms.T / size, np.ones(len(arms))]), np.append(np.zeros(self.dim), 1.0)
        )
        return theta @ self.vertices / theta.sum()

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

    def support(self, z: np.ndarray) -> float:
        import cvxpy as cp

        problem = self._solve(cp.Maximize(vector("z", z, self.dim) @ self._w))
        unbounded = problem.status in (cp.UNBOUNDED, cp.UNBOUNDED_INACCURATE)
        return float("inf") if unbounded else float(problem.value)

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
        return problem


def least_distance(G: np.ndarray, slack: np.ndarray) -> np.ndarray:
    """The shortest u with G u <= slack, exact to rounding on the active set found.

    Lawson and Hanson, Solving Least Squares Problems (1974), chapter 23: the residual of a
    nonnegative least-squares problem gives u, or proves that there is none.

    Raises
    ------
    EmptySetError
        If no u exists.
    """
    lengths = np.linalg.norm(G, axis=1)
    if (slack[lengths == 0] < 0).any():
        raise EmptySetError("Polyhedron has no point: a zero row of G has a negative h")
    G, slack = G[lengths > 0] / lengths[lengths > 0, None], slack[lengths > 0] / lengths[lengths > 0]
    size = float(-slack.min())
    if size <= 0:
        return np.zeros(G.shape[1])
    slack = slack / size
    target = np.zeros(G.shape[1] + 1)
    target[-1] = 1.0
    y = nonnegative_least_squares(np.vstack([-G.T, -slack]), target)
    residual = np.append(G.T @ y, 1 + slack @ y)
    # residual[-1] = |residual|^2 at the optimum: both vanish exactly when the rows are incompatible
    if residual[-1] <= 1e-13 * (1 + np.abs(slack) @ y):
        raise EmptySetError("Polyhedron has no point: { w : G w <= h } is empty")
    u = -residual[:-1] / residual[-1]
    # one solve on the active rows brings u from the accuracy of the residual to rounding
    active = y > 0
    polished = np.linalg.lstsq(G[active], slack[active], rcond=None)[0]
    excess = np.maximum(G @ u - slack, 0).max()
    if (G @ polished - slack).max() <= max(excess, ROUNDING * np.abs(slack).max()):
        u = polished
    return size * u


def nonnegative_least_squares(E: np.ndarray, f: np.ndarray) -> np.ndarray:
    """argmin |E y - f| over y >= 0."""
    return scipy.optimize.nnls(E, f, maxiter=30 * E.shape[1])[0]
