"""The hull of points, projected by an active set."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from sweepopt.checks import Array, matrix
from sweepopt.errors import EmptySetError
from sweepopt.linalg import dense
from sweepopt.sets.base import (
    RANK,
    ROUNDING,
    ConvexSet,
    Features,
    Halfspaces,
    NoHalfspacesError,
    binary,
)
from sweepopt.sets.least_distance import nonnegative_least_squares, projector

if TYPE_CHECKING:
    import cvxpy as cp


HULL = 8  # dimensions up to which a hull is computed


class _Face(NamedTuple):
    """Vertices, and a mean of them."""

    vertices: Array
    point: Array


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

    polyhedral, fixed, differentiable = True, ("vertices",), True

    def __init__(self, vertices: Any) -> None:
        self.vertices = dense(matrix("vertices", vertices))
        if not self.vertices.size:
            raise EmptySetError("vertices is empty; give at least one point")
        self.dim = self.vertices.shape[1]
        # the feature is the support function of the set in units of its size
        self.offsets = np.array([binary(np.abs(self.vertices).max())])

    def support(self, z: Array) -> float:
        return float((self.vertices @ z).max())

    def support_rows(self, rows: Array) -> Array:
        sigma: Array = (rows @ self.vertices.T).max(axis=1)
        return sigma

    def project(self, w: Array) -> Array:
        if self.dim == 1:  # the nearest of all points between
            return np.clip(w, self.vertices.min(), self.vertices.max())
        face = self._memo(w, self._nearest_face)
        return w if face is None else face.point.copy()

    def _nearest_face(self, w: Array) -> _Face | None:
        """The vertices whose hull is the face nearest to w, and the nearest point; None inside.

        Of all y >= 0 those that minimise |sum_i y_i (v_i - w) / unit|^2 + (sum_i y_i - 1)^2 are
        multiples of the shares of the nearest point, but for absolute tolerances of NNLS. So Wolfe
        goes on (Finding the nearest point in a polytope, Math. Programming 11, 1976): a vertex
        ahead of the point enters, those whose share would be negative leave. From the
        second turn on all is measured from the vertex with the largest share: no rounding of a far
        w, or vertex, hides another one.
        """
        V, size = self.vertices, max(np.abs(w).max(), np.abs(self.vertices).max()) or 1.0
        system = np.vstack([(V - w).T / size, np.ones(len(V))])
        y = nonnegative_least_squares(system, np.eye(self.dim + 1)[-1]).y
        active, visited = np.flatnonzero(y), set[frozenset[int]]()
        shares = y[active] / y.sum()
        while True:
            while True:
                edges = (V[active[1:]] - V[active[0]]).T
                rest = np.linalg.lstsq(edges, w - V[active[0]], rcond=None)[0]
                wanted = np.append(1 - rest.sum(), rest)
                if (wanted > 0).all():
                    break
                limits = np.where(wanted <= 0, 0.0, 2.0)  # 0 where a share is and stays 0
                falling = (wanted <= 0) & (shares > wanted)
                np.divide(shares, shares - wanted, out=limits, where=falling)
                last = int(np.argmin(limits))
                shares = np.delete(shares + limits[last] * (wanted - shares), last)
                active = np.delete(active, last)
            order = np.argsort(-wanted, kind="stable")
            active, shares = active[order], wanted[order]
            arms = V - V[active[0]]
            point = V[active[0]] + shares[1:] @ arms[active[1:]]
            p = w - point
            if np.abs(p).max() <= 10 * ROUNDING * size:
                return None
            ahead = arms @ p - ROUNDING * (np.abs(arms) @ (np.abs(w) + np.abs(point)))
            ahead[active] = 0.0
            new = int(np.argmax(ahead))
            # on a face that was left before only rounding says that it is ahead
            if not ahead[new] > 0 or (face := frozenset(active.tolist())) in visited:
                break
            visited.add(face)
            active, shares = np.append(active, new), np.append(shares, 0.0)
        return _Face(V[active], point)

    def derivative(self, v: Array) -> Array:
        face = self._memo(v, self._nearest_face)
        if face is None:
            return np.eye(self.dim)
        return projector(face.vertices[1:] - face.vertices[0])

    def halfspaces(self) -> Halfspaces:
        """The facets of the hull, in its affine span where it is flat."""
        points, span, centre, E = _in_span(self.vertices)
        N, d = _facets(points)
        N, e = N @ span, E @ centre
        lengths = np.linalg.norm(N, axis=1)
        return Halfspaces(N / lengths[:, None], d / lengths + N @ centre / lengths, E, e)

    def features(self, p: cp.Expression) -> Features:
        import cvxpy as cp

        size = cp.Variable(1)
        return Features([size], [(self.vertices / self.offsets) @ p <= size])

    @cached_property
    def shift_sizes(self) -> Array:
        return np.full(self.dim, np.abs(self.vertices).max())

    def magnitude(self) -> float:
        return float(np.linalg.norm(self.vertices, axis=1).max())


class _InSpan(NamedTuple):
    """Points of an affine space by `points = span (w - centre)`, E w = E centre; none is far."""

    points: Array
    span: Array
    centre: Array
    E: Array


def _in_span(points: Array) -> _InSpan:
    """Points in the units of their extents, so that a thin hull is as well known as a round one."""
    centre = points.mean(axis=0)
    _, extents, axes = np.linalg.svd(np.linalg.qr(points - centre, mode="r"))
    flat = int((extents > 10 * ROUNDING * np.abs(points).max()).sum())
    if flat > HULL:
        raise NoHalfspacesError(f"a hull in {flat} dimensions, {HULL} are the most")
    span = axes[:flat] / extents[:flat, None]
    return _InSpan((points - centre) @ span.T, span, centre, axes[flat:])


def hull_vertices(points: Array) -> Array:
    """The points that their hull needs."""
    inside = _in_span(points).points
    if inside.shape[1] < 2:
        return points[np.unique([inside.argmin(), inside.argmax()])] if inside.size else points[:1]
    return points[convex_hull(inside).vertices]


def convex_hull(points: Array) -> ConvexHull:
    """Qhull's, of points that are not flat."""
    try:
        return ConvexHull(points)
    except QhullError as error:
        raise NoHalfspacesError("a hull whose facets are not found") from error


def _facets(points: Array) -> tuple[Array, Array]:
    """N and d of the hull of points that is not flat, each facet once, from all of its points."""
    dim = points.shape[1]
    N = np.vstack([np.eye(dim), -np.eye(dim)])  # in no or one dimension
    if dim > 1:
        hull, normals = convex_hull(points), []
        left = np.ones(len(hull.simplices), dtype=bool)
        while left.any():
            first = int(left.argmax())
            n, on = hull.equations[first, :-1], points @ hull.equations[first, :-1]
            on = on + hull.equations[first, -1] > -RANK  # points of size 1
            left &= ~on[hull.simplices].all(axis=1)
            left[first] = False
            better = np.linalg.svd(points[on] - points[on].mean(axis=0), False)[2][-1]
            normals.append(better if better @ n > 0 else -better)
        N = np.array(normals)
    return N, (N @ points.T).max(axis=1)  # through the vertices to rounding
