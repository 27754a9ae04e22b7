"""What operations make of sets that move by data, between the times at which it is looked at.

Let phi be the values of the histories, C(t) = C(phi(t)). The graph { (phi, w) : w in C(phi) } is
convex for c + r S, r >= 0, and for { w : G w <= h }, and sums, multiples, images, products and
intersections keep it so. Hence

* a curve is in C(t) if its Bernstein coefficients w_k are in C(phi_k), phi_k those of phi(t);
* sigma(C(phi), p) <= a_0 + <a, phi>: for c + r S it is <c, p> + r sigma(S, p), for rows <h, y> with
  any y >= 0, G^T y = p, and for C & D the sum of those of C and D, with any p_1 + p_2 = p.

Where phi is known up to an error the parts are made as much smaller.
"""

from __future__ import annotations

import math
from collections import defaultdict
from typing import Any

import numpy as np

from sweepopt.errors import EmptySetError
from sweepopt.linalg import dense
from sweepopt.loads import Separable
from sweepopt.sets import operations
from sweepopt.sets.aligned import Aligned, Similar
from sweepopt.sets.balls import Ball
from sweepopt.sets.base import ConvexSet, Form, NoHalfspacesError, places
from sweepopt.sets.lifted import AHEAD, Intersection
from sweepopt.sets.moving import Moving, MovingOffsets, MovingSet
from sweepopt.sets.polyhedra import Polyhedron

Values = dict[Any, float]
"""By history."""


def histories(C: Any) -> list[Any]:
    """The phi of a set that operations made; empty if a part moves by a function."""
    if not isinstance(C, MovingSet):
        return []
    if C.made_of:
        each = [histories(part) for part in C.operands]
        return list(dict.fromkeys(phi for some in each for phi in some)) if all(each) else []
    if type(C) not in (Moving, MovingOffsets) or not isinstance(_moves(C), Separable | None):
        return []
    scale = getattr(C, "scale", None)
    return [*(phi for phi, _ in _terms(C)), *([] if scale is None else [scale])]


def member(C: Any, phi: Values, error: Values) -> Any:
    """A set in C(phi + x) for all |x| <= error."""
    if not isinstance(C, MovingSet):
        return C
    if C.made_of:
        name, *parts = C.made_of
        return getattr(operations, name)(*(member(part, phi, error) for part in parts))
    terms = _terms(C)
    c: Any = sum(phi[one] * f for one, f in terms)
    if isinstance(C, MovingOffsets):
        return C.shape.with_offsets(c - sum(error[one] * np.abs(f) for one, f in terms))
    assert isinstance(C, Moving)
    S, off = C.shape, sum(error[one] * float(np.linalg.norm(f)) for one, f in terms)
    if C.scale is not None:
        off += error[C.scale] * S.magnitude() if error[C.scale] else 0.0
        if phi[C.scale] < 0:
            raise EmptySetError("its scale is nearly 0")
        S = phi[C.scale] * S
    return _smaller(S, off) + c if terms else _smaller(S, off)


def support(C: Any, p: np.ndarray, phi: Values) -> Values:
    """a, and a_0 with the key None, of a bound of sigma(C(.), p) that is close at phi."""
    a: Values = defaultdict(float)
    if not isinstance(C, MovingSet):
        a[None] = C.support(p) if isinstance(C, ConvexSet) else float(C @ p)
    elif C.made_of:
        factor, each = _of_parts(C.made_of[0], C.made_of[1:], p, phi)
        for part, normal in each:
            for one, value in support(part, normal, phi).items():
                a[one] += factor * value
    else:
        terms, y = _terms(C), p
        if isinstance(C, Moving):
            a[C.scale] += C.shape.support(p)
        elif isinstance(C, MovingOffsets):
            y = _multipliers(C.shape, p, sum(phi[one] * f for one, f in terms))
        for one, f in terms:
            a[one] += float(f @ y)
    return a


def _multipliers(S: Any, p: np.ndarray, h: Any) -> np.ndarray:
    """y >= 0 with G^T y = p and about the least <h, y>."""
    if isinstance(S, Aligned):  # 0 beside its unknowns
        return _multipliers(S.parts[0], p[S.unknowns], h)
    inside = S.with_offsets(h).project(np.zeros(S.dim))
    y: np.ndarray = S.multiplier_rows(p[None], np.maximum(h - S.G @ inside, 0.0))[0]
    return y


def _of_parts(name: str, parts: Any, p: np.ndarray, phi: Values) -> Any:
    """r and the parts C_i with p_i: sigma(C, p) <= r times the sum of sigma(C_i, p_i)."""
    match name:
        case "scale":
            return abs(parts[0]), [(parts[1], math.copysign(1.0, parts[0]) * p)]
        case "_image":
            return 1.0, [(parts[1], parts[0].T @ p)]
        case "product":
            return 1.0, [(C, p[at]) for C, at in zip(parts, places(parts), strict=True)]
        case "intersect":
            return 1.0, zip(parts, _split(parts, p, phi), strict=True)
    return 1.0, [(C, p) for C in parts]


def _split(parts: Any, p: np.ndarray, phi: Values) -> tuple[np.ndarray, np.ndarray]:
    """p_1 + p_2 = p, normal to C and D in about the point of C & D that is furthest along p."""
    C, D = (member(part, phi, dict.fromkeys(phi, 0.0)) for part in parts)
    both = Intersection(C, D)
    size = both.magnitude()
    size = size if math.isfinite(size) else float(np.abs(both.offsets).max())
    far = AHEAD * size / float(np.linalg.norm(p))
    near = both.near(far * p)
    # n = E^T (v - w) - F^T lam, the last lam of the rows by which the points of C and D are one
    E, F, _ = Form.common(C.form(), D.form())
    lam = np.linalg.lstsq(dense(F.T), E.T @ (near.v - near.w) - near.start.n)[0]
    second = D.normal(near.w + lam[-p.size :]) / far
    return p - second, second


def _smaller(S: ConvexSet, distance: float) -> ConvexSet:
    """The points of S whose neighbours up to that distance are in S."""
    if not distance:
        return S
    if isinstance(S, Ball) and S.radius >= distance:
        return Ball(S.center, S.radius - distance)
    if isinstance(S, Similar):
        return Similar(_smaller(S.parts[0], distance / abs(S.factor)), S.v, S.factor)
    N, d, E, _ = S.halfspaces()
    if E.size:
        raise NoHalfspacesError(type(S).__name__)
    return Polyhedron(N, d - distance * np.linalg.norm(dense(N), axis=1))


def _moves(C: Any) -> Any:
    return C.offsets if isinstance(C, MovingOffsets) else C.center


def _terms(C: Any) -> Any:
    """(phi, f) of what moves a set that no operation made."""
    moves = _moves(C)
    return () if moves is None else moves.terms
