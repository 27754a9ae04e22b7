"""Any composed set in one form, and the projection on it: no projection is iterated in another.

Sums, cuts, images and products, translated, scaled and nested in each other, are all

    C = { c + E s : s in S_1 x S_2 x ..., F s = g }

with parts S_i whose projections are exact. The point nearest to v minimises 1/2 |c + E s - v|^2,
and Douglas and Rachford's splitting (P. Lions, B. Mercier, SIAM J. Numer. Anal. 16, 1979) knows
only two maps: the projections on the parts, and a linear one, factorised once, for the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.linalg

from sweepopt.sets.base import DENSE, ROUNDING, ConvexSet, Lost, binary
from sweepopt.sets.iteration import fixed_point
from sweepopt.sets.nearest import Lifted, nearest_on_rows
from sweepopt.sets.shapes import Box

DEPENDENT = 1e-13  # singular values that are no more than this share of the largest are rounding
LAST = 2 * float(np.finfo(float).eps)  # what one number of many is rounded
LIGHT = 1e-4  # columns of what should move little, beside what may
# sweeps to try, and what counts as rounding of the data: parts may be projected on less exactly
EFFORTS = ((40, 1.0), (300, 10.0), (100, 1e3))


class Flat(NamedTuple):
    """C = { c + E s : s in parts[0] x parts[1] x ..., F s = g }."""

    c: np.ndarray
    E: np.ndarray
    F: np.ndarray
    g: np.ndarray
    parts: tuple[ConvexSet, ...]

    @classmethod
    def of(cls, part: ConvexSet) -> Flat | None:
        """A set that is its own part, if its projection is exact and it is small."""
        if part.dim > DENSE or not (part.exact and part.certifiable):
            return None
        n = part.dim
        return cls(np.zeros(n), np.eye(n), np.zeros((0, n)), np.zeros(0), (part,))

    @classmethod
    def beside(cls, sets: Sequence[ConvexSet]) -> Flat | None:
        """The product of sets; None if one of them has no such form."""
        found = [C.flat() for C in sets]
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

    def lifted(self) -> Lifted | None:
        """The s of C as the image of rows, if all parts are such sets."""
        found = [part.lifted() for part in self.parts]
        lifts = [lift for lift in found if lift is not None]
        if len(lifts) < len(found):
            return None
        c, E, G, h = zip(*lifts, strict=True)
        whole = Lifted(
            np.concatenate(c),
            scipy.linalg.block_diag(*E),
            scipy.linalg.block_diag(*G),
            np.concatenate(h),
        )
        y, Z = solutions(self.F @ whole.E, self.g - self.F @ whole.c)
        return Lifted(whole.point(y), whole.E @ Z, whole.G @ Z, whole.h - whole.G @ y)


class Solutions(NamedTuple):
    """{ s : F s = g } = { one + Z y }, the columns of Z orthonormal; the least squares if none."""

    one: np.ndarray
    Z: np.ndarray


def solutions(F: np.ndarray, g: np.ndarray) -> Solutions:
    U, sizes, Vt = np.linalg.svd(F)
    rank = int((sizes > DEPENDENT * sizes.max(initial=0.0)).sum())
    return Solutions(Vt[:rank].T @ ((U.T @ g)[:rank] / sizes[:rank]), Vt[rank:].T)


class Near(NamedTuple):
    """The point w = c + E s of C nearest to v; s = P(image), both in units of the splitting."""

    v: np.ndarray
    w: np.ndarray
    s: np.ndarray
    image: np.ndarray
    splitting: Splitting

    @property
    def parts(self) -> np.ndarray:
        """s as the parts see it."""
        return self.s / self.splitting.units

    def lost(self, p: np.ndarray, step: float) -> Lost:
        """How far w and p / step, p near v - w, are from a pair at most."""
        found = self.splitting.lost(self, p)
        return rounded(self.v, step) if found is None else found._replace(p=found.p / step)


def rounded(v: np.ndarray, step: float) -> Lost:
    """The same where nothing is known but v, of which w and step * p are parts."""
    lost = np.full(v.size, 10 * ROUNDING * np.abs(v).max())
    return Lost(lost, lost / step)


class Normal(NamedTuple):
    """p and lam with E^T p - F^T lam normal to the parts."""

    p: np.ndarray
    multipliers: np.ndarray


class Splitting:
    """The two maps of a flat set, in units of s: one a part, which keeps its own metric."""

    def __init__(self, flat: Flat, units: np.ndarray) -> None:
        self.flat, self.units = flat, units
        self._cuts = np.cumsum([part.dim for part in flat.parts])[:-1]
        self.E, self.F = flat.E / units, flat.F / units
        self.start, Z = solutions(self.F, flat.g)
        seen = self.E @ Z
        self._K = Z @ np.linalg.solve(np.eye(Z.shape[1]) + seen.T @ seen, Z.T)

    def _each(self, x: np.ndarray) -> list[tuple[ConvexSet, np.ndarray, float]]:
        """Parts, what they see of x, and their units."""
        blocks, units = np.split(x / self.units, self._cuts), np.split(self.units, self._cuts)
        each = zip(self.flat.parts, blocks, units, strict=True)
        return [(part, block, float(unit[0])) for part, block, unit in each]

    def projected(self, x: np.ndarray) -> np.ndarray:
        return np.concatenate([unit * part.project(block) for part, block, unit in self._each(x)])

    def pull(self, v: np.ndarray, s: np.ndarray) -> np.ndarray:
        """E^T (v - w)."""
        return np.asarray(self.E.T @ (v - self.flat.c - self.E @ s))

    def _derivative(self, x: np.ndarray) -> np.ndarray | None:
        found = [part.derivative(block) for part, block, _ in self._each(x)]
        known = [D for D in found if D is not None]
        if len(known) < len(found):
            return None
        return np.asarray(
            scipy.linalg.block_diag(*(np.diag(D) if D.ndim == 1 else D for D in known))
        )

    def nearest(self, v: np.ndarray, x: np.ndarray, sweeps: int, rounding: float) -> Near | None:
        """From x = s - n, n the normal; None if so many sweeps do not suffice."""
        one, center = np.eye(x.size), self.start + self._K @ (self.pull(v, self.start) - self.start)

        def near(x: np.ndarray) -> np.ndarray:
            """argmin of 1/2 |c + E s - v|^2 + 1/2 |s - x|^2 under F s = g."""
            return np.asarray(center + self._K @ x)

        def step(x: np.ndarray) -> np.ndarray:
            s = near(x)
            return x + self.projected(2 * s - x) - s

        def slope(x: np.ndarray) -> np.ndarray | None:
            D = self._derivative(2 * near(x) - x)
            return None if D is None else one + D @ (2 * self._K - one) - self._K

        pulled = np.abs(self.E).max() * np.concatenate([v, self.flat.c])
        like = rounding * np.concatenate([pulled, self.start])
        found = fixed_point(step, x, np.concatenate([like, rounding * x]), sweeps, slope)
        if found is None:
            return None
        s, image = near(found), 2 * near(found) - found
        held = self.projected(image)
        size = max(np.abs(part).max(initial=0.0) for part in (rounding * image, like))
        if np.abs(held - s).max() > 10 * ROUNDING * size:
            return None  # the start was so far away that its rounding is all there is
        return Near(v, self.flat.c + self.E @ held, held, image, self)

    def normal(self, near: Near) -> Normal:
        """v - w, changed by what rounding of v keeps it from being one to the parts' normals."""
        inner = self._normals(near)
        p, F, E = near.v - near.w, self.F.T, self.E.T
        found = np.linalg.lstsq(F, E @ p - inner, rcond=DEPENDENT)[0]
        missed = inner - E @ p + F @ found
        change = np.linalg.lstsq(np.hstack([E, -F]), missed, rcond=DEPENDENT)[0]
        return Normal(p + change[: p.size], found + change[p.size :])

    def _normals(self, near: Near) -> np.ndarray:
        """Those of the parts, computed by the parts."""
        return np.concatenate([unit * part.normal(x) for part, x, unit in self._each(near.image)])

    def lost(self, near: Near, p: np.ndarray) -> Lost | None:
        """How far w and p are from a pair, to first order; None where parts have no derivative.

        A part's point s and its normal n move along its normals by  ds = D dx, dn = (I - D) dx. The
        dx, dlam and the small dw, dp that make  n = E^T p - F^T lam,  F s = g  and  w = c + E s
        true are linear in what these miss, which is known but for rounding.
        """
        D = self._derivative(near.image)
        if D is None:
            return None
        s, n, E, F = near.s, near.image - near.s, self.E, self.F
        multipliers = np.linalg.lstsq(F.T, E.T @ p - n, rcond=DEPENDENT)[0]
        turns = np.eye(s.size) - D
        if not p.any():  # which is normal everywhere
            n, multipliers, turns = 0 * n, 0 * multipliers, 0 * turns
        blur = np.concatenate(
            [
                np.full(x.size, 0.0 if isinstance(part, Box) else unit * np.abs(x).max())
                for part, x, unit in self._each(near.image)
            ]
        )
        sizes = np.abs(s) + blur
        forces = np.abs(E.T) @ np.abs(p) + np.abs(F.T) @ np.abs(multipliers) + p.any() * blur
        places = np.abs(F) @ sizes + np.abs(self.flat.g)
        points = np.abs(E) @ sizes + np.abs(self.flat.c)
        missed = np.concatenate(
            [E.T @ p - F.T @ multipliers - n, self.flat.g - F @ s, np.zeros(p.size)]
        )
        rounding = LAST * np.concatenate([forces, places, points])
        m, k = F.shape[0], p.size
        system = np.block(
            [
                [turns, F.T, np.zeros((s.size, k)), -LIGHT * E.T],
                [F @ D, np.zeros((m, m + 2 * k))],
                [E @ D, np.zeros((k, m)), -LIGHT * np.eye(k), np.zeros((k, k))],
            ]
        )
        back = LIGHT * np.linalg.pinv(system, rcond=DEPENDENT)[-2 * k :]
        # what is known adds up, what is rounding adds up as the root of squares
        moved = np.abs(back @ missed) + np.sqrt(back**2 @ rounding**2)
        return Lost(moved[:k], moved[k:])

    def derivative(self, near: Near) -> np.ndarray | None:
        """dw/dv."""
        D = self._derivative(near.image)
        if D is None:
            return None
        one, pull = np.eye(len(D)), self._K @ self.E.T
        jacobian = self._K - D @ (2 * self._K - one)
        dx = np.linalg.lstsq(jacobian, (2 * D - one) @ pull, rcond=DEPENDENT)[0]
        return np.asarray(self.E @ (self._K @ dx + pull))


class Composed(ConvexSet):
    """A set made of others.

    Attributes
    ----------
    nested : bool
        Whether these are composed too.
    """

    nested: bool

    @cached_property
    def _plain(self) -> Splitting | None:
        """In units in which the columns of E and F are near 1."""
        form = self.flat() if self.certifiable else None
        if form is None:
            return None
        dims = [part.dim for part in form.parts]
        columns = np.split(np.vstack([form.E, form.F]), np.cumsum(dims)[:-1], axis=1)
        sizes = [binary(float(np.linalg.norm(block))) for block in columns]
        return Splitting(form, np.repeat(sizes, dims))

    @cached_property
    def _rows(self) -> Lifted | None:
        return None if self._plain is None else self._plain.flat.lifted()

    @cached_property
    def _splittings(self) -> dict[float, Splitting]:
        return {}

    def _in(self, unit: float) -> Splitting:
        """The splitting in other units, a power of two each: there are few."""
        if unit not in self._splittings:
            assert self._plain is not None
            self._splittings[unit] = Splitting(self._plain.flat, unit * self._plain.units)
        return self._splittings[unit]

    def near(self, v: np.ndarray) -> Near | None:
        """The point nearest to v, exact to rounding, and its parts; None if it is not found."""
        plain = self._plain
        if plain is None:
            return None
        starts = [plain.projected(plain.start + plain.pull(v, plain.start))]
        if self._rows is not None:
            c, E = plain.flat.point(self._rows.c), plain.flat.E @ self._rows.E
            y = nearest_on_rows(self._rows._replace(c=c, E=E), v)
            if y is not None:
                starts = [plain.units * self._rows.point(y), *starts]
        # the last one only on flat faces, or where else projections would iterate in projections
        for sweeps, rounding in EFFORTS if self.nested or self.polyhedral else EFFORTS[:-1]:
            for s in starts:
                # in units in which the normal is not larger than s: the sum rounds both
                normal = plain.pull(v, s)
                size, length = np.abs(s).max(initial=0.0), np.abs(normal).max(initial=0.0)
                unit = binary(float(np.sqrt(length / size))) if 0 < size < length else 1.0
                x = unit * s - normal / unit
                found = self._in(unit).nearest(v, x, sweeps, rounding)
                if found is not None:
                    return found
        return None

    def derivative(self, v: np.ndarray) -> np.ndarray | None:
        near = self.near(v)
        return None if near is None else near.splitting.derivative(near)
