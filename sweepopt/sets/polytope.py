"""The hull of points, projected by an active set."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.checks import matrix, vector
from sweepopt.errors import EmptySetError
from sweepopt.linalg import dense
from sweepopt.sets.active_set import least_distance, projector
from sweepopt.sets.base import DENSE, ROUNDING, ConvexSet, Features, Lifted, binary, same_array
from sweepopt.sets.iteration import project_by_program

if TYPE_CHECKING:
    import cvxpy as cp


class Polytope(ConvexSet):
    """The convex hull of points:  sigma(z) = max_i <vertices_i, z>.

    Parameters
    ----------
    vertices : array_like, shape (m, dim)

    Raises
    ------
    InputError
        If an entry is not finite.
    EmptySetError
        If there are no vertices.

    Examples
    --------
    >>> Polytope([[0, 0], [1, 0], [0, 1]]).project([1.0, 1.0])
    array([0.5, 0.5])
    """

    polyhedral = True

    def __init__(self, vertices: Any) -> None:
        self.vertices = dense(matrix("vertices", vertices))
        if not self.vertices.size:
            raise EmptySetError("vertices is empty; give at least one point")
        self.dim = self.vertices.shape[1]
        # the feature is the support function of the set in units of its size
        self.offsets = np.array([binary(np.abs(self.vertices).max())])

    def support(self, z: np.ndarray) -> float:
        return float((self.vertices @ vector("z", z, self.dim)).max())

    def project(self, w: np.ndarray) -> np.ndarray:
        w = vector("w", w, self.dim)
        held = self._held(w)
        if held is None:
            return project_by_program(self, w)
        if held is self.vertices:
            return w
        # a mean of the vertices that hold it: a point of the hull, however far away w is
        edges = (held[1:] - held[0]).T
        shares = np.maximum(np.linalg.lstsq(edges, w - held[0], rcond=None)[0], 0.0)
        return held[0] + edges @ (shares / max(shares.sum(), 1.0))

    def _held(self, w: np.ndarray) -> np.ndarray | None:
        """The vertices of the face nearest to w, all of them if w is in the hull."""
        # with a_i = v_i - w: if u is the shortest with <a_i, u> >= 1 for all i, then u / |u|^2 is
        # the point of the hull of the a_i nearest to 0; no such u exists if 0 is in the hull
        arms = self.vertices - w
        size = float(np.abs(arms).max())
        if size == 0:
            return self.vertices
        ones = np.ones(len(arms))
        try:
            found = least_distance(-arms / size, -ones, ROUNDING * ones)
        except EmptySetError:
            return self.vertices
        return None if found is None else self.vertices[found.active]

    def derivative(self, v: np.ndarray) -> np.ndarray | None:
        held = self._held(v)
        return None if held is None else projector(held[1:] - held[0])

    def lifted(self) -> Lifted | None:
        if max(self.vertices.shape) > DENSE:
            return None
        # the shares of all vertices but the last, which has the rest
        last, n = self.vertices[-1], len(self.vertices) - 1
        edges = (self.vertices[:-1] - last).T
        return Lifted(last, edges, np.vstack([-np.eye(n), np.ones(n)]), np.append(np.zeros(n), 1.0))

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        size = cp.Variable(1)
        return Features([size], [(self.vertices / self.offsets) @ p <= size])

    def same_cone(self, other: ConvexSet) -> bool:
        return isinstance(other, Polytope) and same_array(self.vertices, other.vertices)

    def magnitude(self) -> float:
        return float(np.linalg.norm(self.vertices, axis=1).max())

    def _distance(self, other: ConvexSet) -> float | None:
        if not (isinstance(other, Polytope) and self.vertices.shape == other.vertices.shape):
            return None
        return float(np.linalg.norm(self.vertices - other.vertices, axis=1).max())
