"""Sets side by side:  sigma(C x D, (y, z)) = sigma(C, y) + sigma(D, z)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.linalg

from sweepopt.checks import vector
from sweepopt.errors import InputError
from sweepopt.sets.base import ConvexSet, CurveGap, Features, NormalPair, Perturbation
from sweepopt.sets.flat import Flat
from sweepopt.sets.moving import MovingSet
from sweepopt.sets.shapes import Box, Point

if TYPE_CHECKING:
    import cvxpy as cp


class Product(ConvexSet):
    """C_1 x C_2 x ...: the parts one after the other in the vector."""

    def __init__(self, parts: tuple[ConvexSet, ...]) -> None:
        self.parts = parts
        self.dim = sum(part.dim for part in parts)
        self.offsets = np.concatenate([part.offsets for part in parts])
        self.polyhedral = all(part.polyhedral for part in parts)
        self.certifiable = all(part.certifiable for part in parts)
        self.exact = all(part.exact for part in parts)
        self._cuts = np.cumsum([part.dim for part in parts])[:-1]
        self._offset_cuts = np.cumsum([part.offsets.size for part in parts])[:-1]

    def support(self, z: np.ndarray) -> float:
        blocks = np.split(vector("z", z, self.dim), self._cuts)
        return sum(part.support(block) for part, block in zip(self.parts, blocks, strict=True))

    def project(self, w: np.ndarray) -> np.ndarray:
        blocks = np.split(vector("w", w, self.dim), self._cuts)
        projected = [part.project(block) for part, block in zip(self.parts, blocks, strict=True)]
        return np.concatenate(projected)

    def normal(self, v: np.ndarray) -> np.ndarray:
        blocks = np.split(v, self._cuts)
        return np.concatenate(
            [part.normal(block) for part, block in zip(self.parts, blocks, strict=True)]
        )

    def weights(self, tau: np.ndarray) -> np.ndarray:
        blocks = np.split(tau, self._cuts)
        return np.concatenate([part.weights(x) for part, x in zip(self.parts, blocks, strict=True)])

    def nearest(self, w: np.ndarray, tau: np.ndarray) -> np.ndarray:
        cut = zip(self.parts, np.split(w, self._cuts), np.split(tau, self._cuts), strict=True)
        return np.concatenate([part.nearest(*blocks) for part, *blocks in cut])

    def derivative(self, v: np.ndarray) -> np.ndarray | None:
        blocks = np.split(v, self._cuts)
        found = [part.derivative(x) for part, x in zip(self.parts, blocks, strict=True)]
        known = [D for D in found if D is not None]
        if len(known) < len(found):
            return None
        if all(D.ndim == 1 for D in known):
            return np.concatenate(known)
        return scipy.linalg.block_diag(*(D if D.ndim == 2 else np.diag(D) for D in known))

    def features(self, p: cp.Expression) -> Features:
        y: list[Any] = []
        constraints: list[Any] = []
        start = 0
        for part in self.parts:
            more, others = part.features(p[start : start + part.dim])
            y, constraints, start = y + more, constraints + others, start + part.dim
        return Features(y, constraints)

    def normal_pair(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray
    ) -> NormalPair | None:
        cut = [np.split(x, self._cuts) for x in (p, w, tau)]
        found = [
            part.normal_pair(*blocks)
            for part, *blocks in zip(self.parts, *cut, np.split(y, self._offset_cuts), strict=True)
        ]
        known = [one for one in found if one is not None]
        if len(known) < len(found):
            return None
        return NormalPair(
            np.concatenate([one.p for one in known]),
            np.concatenate([one.w for one in known]),
            sum(one.gap for one in known),
            _beside([one.perturbation for one in known], [part.dim for part in self.parts]),
        )

    def gap(self, p: np.ndarray, w: np.ndarray) -> float:
        blocks = zip(self.parts, np.split(p, self._cuts), np.split(w, self._cuts), strict=True)
        return sum(part.gap(*one) for part, *one in blocks)

    def gap_along_curve(self, p: np.ndarray, w: np.ndarray, ratio: float) -> CurveGap:
        cut = (np.split(x, self._cuts, axis=1) for x in (p, w))
        each = zip(self.parts, *cut, strict=True)
        return CurveGap.beside(part.gap_along_curve(a, b, ratio) for part, a, b in each)

    def flat(self) -> Flat | None:
        return Flat.beside(self.parts)

    def same_cone(self, other: ConvexSet) -> bool:
        return (
            isinstance(other, Product)
            and len(self.parts) == len(other.parts)
            and all(a.same_cone(b) for a, b in zip(self.parts, other.parts, strict=True))
        )

    def require_nonempty(self, where: str = "C") -> None:
        for part in self.parts:
            part.require_nonempty(where)

    def magnitude(self) -> float:
        return float(np.linalg.norm([part.magnitude() for part in self.parts]))

    def _distance(self, other: ConvexSet) -> float | None:
        if not isinstance(other, Product) or not np.array_equal(self._cuts, other._cuts):
            return None
        found = [a.distance_bound(b) for a, b in zip(self.parts, other.parts, strict=True)]
        known = [distance for distance in found if distance is not None]
        return float(np.linalg.norm(known)) if len(known) == len(found) else None

    @property
    def anchor(self) -> np.ndarray:
        return np.concatenate([part.anchor for part in self.parts])

    @property
    def nonsmooth_dim(self) -> int:
        return sum(part.nonsmooth_dim for part in self.parts)

    def polar(self) -> ConvexSet:
        return Product(tuple(part.polar() for part in self.parts))


def _beside(each: list[Perturbation | None], dims: list[int]) -> Perturbation | None:
    """What is perturbation in all parts, nothing if in none."""
    if not any(each):
        return None
    nothing = (Perturbation(np.zeros(dim), np.zeros(dim)) for dim in dims)
    perturbation = [one or none for one, none in zip(each, nothing, strict=True)]
    return Perturbation(
        np.concatenate([one.w for one in perturbation]),
        np.concatenate([one.p for one in perturbation]),
    )


def product(*sets: Any) -> Any:
    """C x D x ..., one after the other in the vector; moving sets too.

    Parameters
    ----------
    *sets : ConvexSet or MovingSet
        One or more.

    Raises
    ------
    InputError
        If there is none, or one is no set.

    Examples
    --------
    >>> from sweepopt.sets import Ball
    >>> product(Ball([0.0, 0.0], 1.0), Box([-1], [1])).support([3.0, 4.0, 2.0])
    7.0
    """
    if not sets or not all(isinstance(C, (ConvexSet, MovingSet)) for C in sets):
        raise InputError("product(C, D, ...) takes one or more sets")
    if any(isinstance(C, MovingSet) for C in sets):
        return MovingSet(lambda t: product(*(C.at(t) for C in sets)), sum(C.dim for C in sets))
    if all(isinstance(C, Box) for C in sets):
        return Box(np.concatenate([C.lower for C in sets]), np.concatenate([C.upper for C in sets]))
    if all(isinstance(C, Point) for C in sets):
        return Point(np.concatenate([C.offsets for C in sets]))
    return Product(tuple(sets))
