"""What is made of two sets: what sums and intersections have in common."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from sweepopt.sets.base import ConvexSet, NormalPair
from sweepopt.sets.composed import Composed


class Pair(Composed):
    """What a sum and an intersection have in common."""

    exact = False

    def __init__(self, first: ConvexSet, second: ConvexSet) -> None:
        self.first, self.second, self.dim = first, second, first.dim
        self.offsets = np.concatenate([first.offsets, second.offsets])
        self.polyhedral = first.polyhedral and second.polyhedral
        self.certifiable = first.certifiable and second.certifiable
        self.nested = not (first.exact and second.exact)

    def same_cone(self, other: ConvexSet) -> bool:
        return (
            isinstance(other, Pair)
            and type(self) is type(other)
            and self.first.same_cone(other.first)
            and self.second.same_cone(other.second)
        )

    def normal_pair(
        self, p: np.ndarray, w: np.ndarray, tau: np.ndarray, y: np.ndarray
    ) -> NormalPair | None:
        if not self.certifiable:
            return None
        step = float(np.mean(tau))
        return self._pair_near(w, step * p, step * y).over(step)

    @abstractmethod
    def _pair_near(self, w: np.ndarray, p: np.ndarray, y: np.ndarray) -> NormalPair:
        """A pair near (w, p), p in the units of w; y are the features of p."""

    def require_nonempty(self, where: str = "C") -> None:
        self.first.require_nonempty(where)
        self.second.require_nonempty(where)
