"""Sets made of others, and where the search for their nearest points starts.

Parts s of a flat set have three kinds of units: their own; plain ones, in which the columns of E
and F are near 1, where searches start; and those of a splitting, in which s and its normals n are
of one size, so that x = s - n rounds neither away.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from sweepopt.sets.base import RANK, ConvexSet, binary
from sweepopt.sets.flat import Raised
from sweepopt.sets.iteration import CONFIRMING, SWEEPS
from sweepopt.sets.nearest import nearest_on_rows
from sweepopt.sets.splitting import Near, Splitting

# sweeps to try, and what counts as rounding of the data: parts may be projected on less exactly
EFFORTS = ((40, 1.0), (100, 10.0), (40, 1e3))
FAR = 1e3  # the longest start, in units of the data
STRIDE = 7  # powers of two from one point on the way to the next
UNITS = 16  # splittings that are kept


class Start(NamedTuple):
    """Parts s and their normals n, in the units of the plain splitting."""

    s: np.ndarray
    n: np.ndarray


class Sizes(NamedTuple):
    """Of s and of n: what is rounded in them, and where a start is too far away."""

    s: float
    n: float

    @property
    def unit(self) -> float:
        """A power of two in which unit s and n / unit are of one size, where n is the larger."""
        return binary(float(np.sqrt(self.n / self.s))) if 0 < self.s < self.n else 1.0


class Composed(ConvexSet):
    """A set made of others.

    Attributes
    ----------
    nested : bool
        Whether these are composed too.
    """

    nested: bool
    _last: tuple[np.ndarray, Near | None] | None = None

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
    def _rows(self) -> Raised | None:
        return None if self._plain is None else self._plain.flat.raised()

    @cached_property
    def _splittings(self) -> dict[float, Splitting]:
        return {}

    def _in(self, unit: float) -> Splitting:
        """The splitting in other units, a power of two each: there are few."""
        plain = self._plain
        assert plain is not None
        if unit == 1.0:
            return plain
        if unit not in self._splittings:
            if len(self._splittings) >= UNITS:
                self._splittings.clear()
            self._splittings[unit] = Splitting(plain.flat, unit * plain.units)
        return self._splittings[unit]

    def near(self, v: np.ndarray) -> Near | None:
        """The point nearest to v, exact to rounding, and its parts; None if it is not found."""
        last = self._last
        if last is None or not np.array_equal(last[0], v):
            # a projection, its normal and the pair are asked for one after the other
            last = self._last = (v.copy(), self._found(v))
        return last[1]

    @property
    def sweeps(self) -> int:
        """Where a part iterates too, the work and what it rounds multiply: a program is near."""
        return SWEEPS // 10 if self.nested else SWEEPS

    def quick(self, v: np.ndarray) -> Near | None:
        """The same by a few sweeps of the set's own, or None."""
        return None

    def pair(self, v: np.ndarray, s: np.ndarray, n: np.ndarray) -> Near | None:
        """The same for parts and their normals that are known."""
        plain = self._plain
        if plain is None:
            return None
        start = Start(plain.units * s, n / plain.units)
        sizes = _sizes(plain, v, start)
        # a far v may have rounded them
        near = self._from(v, start, sizes, CONFIRMING, 1.0) if sizes.unit > 1 else None
        return near or Near(v, plain.point(v, start.s), start.s, start.s + start.n, plain)

    def derivative(self, v: np.ndarray) -> np.ndarray | None:
        near = self.near(v)
        return None if near is None else near.splitting.derivative(near)

    def _found(self, v: np.ndarray) -> Near | None:
        plain = self._plain
        if plain is None:
            return None
        near = None if self.nested else self.quick(v)
        if near is not None:
            return near
        starts = self._starts(plain, v)
        # the last one only on flat faces, or where else projections would iterate in projections
        for sweeps, rounding in EFFORTS if self.nested or self.polyhedral else EFFORTS[:-1]:
            for start, sizes in starts:
                found = self._from(v, start, sizes, sweeps, rounding)
                if found is not None:
                    return found
            if rounding == 1.0:
                starts = [*self._on_the_way(plain, v, starts[-1][1]), *starts]
        return None

    def _starts(self, plain: Splitting, v: np.ndarray) -> list[tuple[Start, Sizes]]:
        """On the rows of the parts if these are known, and from where v is pulled."""
        s = plain.projected(plain.start + plain.pull(v, plain.start))
        own = Start(s, plain.pull(v, s))
        data = _sizes(plain, v, own)
        on_rows = self._on_rows(plain, v)
        return [*self._kept(plain, v, on_rows, data), (own, data)]

    def _kept(
        self, plain: Splitting, v: np.ndarray, start: Start | None, data: Sizes
    ) -> list[tuple[Start, Sizes]]:
        """A start, if it is not so far away that its rounding would be all there is."""
        if start is None:
            return []
        sizes = _sizes(plain, v, start)
        far = sizes.s > FAR * data.s or sizes.n > FAR * data.n
        return [] if far else [(start, Sizes(min(sizes.s, data.s), min(sizes.n, data.n)))]

    def _from(
        self, v: np.ndarray, start: Start, sizes: Sizes, sweeps: int, rounding: float
    ) -> Near | None:
        # in units in which the normal is not larger than s: the sum rounds both
        unit = sizes.unit
        x, like = unit * start.s - start.n / unit, max(unit * sizes.s, sizes.n / unit)
        return self._in(unit).nearest(v, x, sweeps, rounding * like)

    def _on_the_way(
        self, plain: Splitting, v: np.ndarray, data: Sizes
    ) -> list[tuple[Start, Sizes]]:
        """From points between c and a far v: their faces are soon the same, and less is rounded."""
        c, near, found = plain.flat.c, None, None
        size, length = np.abs(plain.projected(plain.start)).max(), plain.size(v)
        powers = int(np.log2(length / size)) // STRIDE if 0 < size < length else 0
        for power in range(powers, 0, -1):
            ahead = c + 2.0 ** (-STRIDE * power) * (v - c)
            starts = self._starts(plain, ahead)
            starts = [*self._kept(plain, ahead, found, starts[-1][1]), *starts]
            near = self._from(ahead, *starts[0], *EFFORTS[0])
            if near is not None:
                unit = near.splitting.units / plain.units
                found = Start(near.s / unit, unit * (near.image - near.s))
            found = found and found._replace(n=2.0**STRIDE * found.n)
        return self._kept(plain, v, found, data)

    def _on_rows(self, plain: Splitting, v: np.ndarray) -> Start | None:
        """By the rows that the parts are made of: right but for rounding, as a rule.

        E^T (v - w) = n + F^T lam, where the rows tell what n is along E of the parts.
        """
        rows, flat = self._rows, plain.flat
        found = None if rows is None else nearest_on_rows(flat.seen(rows.held), v)
        if rows is None or found is None:
            return None
        s, (_, E, G, _) = rows.held.point(found.s), rows.free
        pull = flat.E.T @ (v - flat.point(s))
        inner = E.T @ pull - G.T @ found.multipliers
        n = pull - flat.F.T @ np.linalg.lstsq((flat.F @ E).T, inner, rcond=RANK)[0]
        return Start(plain.units * s, n / plain.units)


def _sizes(plain: Splitting, v: np.ndarray, start: Start) -> Sizes:
    rounded = [
        np.abs(x).max(initial=0.0) for x in (start.s, plain.start, plain.rounding_scale(start.s))
    ]
    return Sizes(float(max(rounded)), max(float(np.abs(start.n).max()), plain.size(v)))
