"""What is made of two sets: what sums and intersections have in common."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sweepopt.sets.base import (
    ConvexSet,
)
from sweepopt.sets.composed import Composed

if TYPE_CHECKING:
    pass


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

    def require_nonempty(self, where: str = "C") -> None:
        self.first.require_nonempty(where)
        self.second.require_nonempty(where)
