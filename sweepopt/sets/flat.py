"""Any composed set in one form, made of the sets whose projections are exact.

Sums, cuts, images and products, translated, scaled and nested in each other, are all

    C = { c + E s : s in S_1 x S_2 x ..., F s = g }
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.linalg

from sweepopt.sets.base import DENSE, RANK, ConvexSet, Lifted


class Flat(NamedTuple):
    """C = { c + E s : s in parts[0] x parts[1] x ..., F s = g }."""

    c: np.ndarray
    E: np.ndarray
    F: np.ndarray
    g: np.ndarray
    parts: tuple[ConvexSet, ...]

    @classmethod
    def of(cls, C: ConvexSet) -> Flat | None:
        """A set that is its own part if its projection is exact, or what it is made of."""
        return cls.alone(C) or C.flat()

    @classmethod
    def alone(cls, part: ConvexSet) -> Flat | None:
        if part.dim > DENSE or not (part.exact and part.certifiable):
            return None
        n = part.dim
        return cls(np.zeros(n), np.eye(n), np.zeros((0, n)), np.zeros(0), (part,))

    @classmethod
    def beside(cls, sets: Sequence[ConvexSet]) -> Flat | None:
        """The product of sets; None if one of them has no such form."""
        found = [cls.of(C) for C in sets]
        forms = [form for form in found if form is not None]
        if len(forms) < len(found) or sum(form.E.shape[1] for form in forms) > DENSE:
            return None
        c, E, F, g, parts = zip(*forms, strict=True)
        block, stack = scipy.linalg.block_diag, np.concatenate
        return cls(stack(c), block(*E), block(*F), stack(g), sum(parts, ()))

    def point(self, s: np.ndarray) -> np.ndarray:
        """c + E s."""
        return np.asarray(self.c + self.E @ s)

    def pushed(self, M: np.ndarray) -> Flat:
        """M C."""
        return self._replace(c=M @ self.c, E=M @ self.E)

    def met(self, D: np.ndarray) -> Flat:
        """The w of C with D w = 0."""
        return self._replace(
            F=np.vstack([self.F, D @ self.E]), g=np.concatenate([self.g, -D @ self.c])
        )

    def seen(self, rows: Lifted) -> Lifted:
        """The points of C from its s."""
        return rows._replace(c=self.point(rows.c), E=self.E @ rows.E)

    def raised(self) -> Raised | None:
        """As the image of rows, if all parts are such sets."""
        found = [part.lifted() or _lifted(part) for part in self.parts]
        lifts = [lift for lift in found if lift is not None]
        if len(lifts) < len(found):
            return None
        c, E, G, h = zip(*lifts, strict=True)
        block, stack = scipy.linalg.block_diag, np.concatenate
        free = Lifted(stack(c), block(*E), block(*G), stack(h))
        y, Z = solutions(self.F @ free.E, self.g - self.F @ free.c)
        held = Lifted(free.point(y), free.E @ Z, free.G @ Z, free.h - free.G @ y)
        return Raised(free, held)


class Raised(NamedTuple):
    """S, and its s with F s = g, as images of rows."""

    free: Lifted
    held: Lifted


def _lifted(part: ConvexSet) -> Lifted | None:
    """That of an exact set which is made of another one."""
    form = part.flat()
    found = None if form is None or part in form.parts else form.raised()
    return found and form and form.seen(found.held)


class Solutions(NamedTuple):
    """{ s : F s = g } = { one + Z y }, the columns of Z orthonormal; the least squares if none."""

    one: np.ndarray
    Z: np.ndarray


def solutions(F: np.ndarray, g: np.ndarray) -> Solutions:
    U, sizes, Vt = np.linalg.svd(F)
    rank = int((sizes > RANK * sizes.max(initial=0.0)).sum())
    return Solutions(Vt[:rank].T @ ((U.T @ g)[:rank] / sizes[:rank]), Vt[rank:].T)
