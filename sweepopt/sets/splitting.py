"""The projection on a set in its flat form: no projection is iterated in another.

The point of { c + E s : s in S, F s = g } nearest to v minimises 1/2 |c + E s - v|^2, and Douglas
and Rachford's splitting (P. Lions, B. Mercier, SIAM J. Numer. Anal. 16, 1979) knows only two maps:
the projections on the parts of S, and a linear one, factorised once, for the rest.
"""

from __future__ import annotations

import contextlib
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy.linalg

from sweepopt.sets.base import RANK, ROUNDING, Perturbation
from sweepopt.sets.flat import Flat, solutions
from sweepopt.sets.iteration import fixed_point

LAST = 2 * float(np.finfo(float).eps)  # what one number of many is rounded
SQUARED = 1e-5  # pivots whose squares are more than this share can be divided by
LIGHT = 1e-4  # columns of what should move little, beside what may


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

    def perturbation(self, p: np.ndarray) -> Perturbation:
        """How far w and p, near v - w, are from a pair at most."""
        return self.splitting.perturbation(self, p) or rounded(self.v)


def rounded(v: np.ndarray) -> Perturbation:
    """The same where nothing is known but v, of which w and p are parts."""
    perturbation = np.full(v.size, 10 * ROUNDING * np.abs(v).max())
    return Perturbation(perturbation, perturbation)


class Normal(NamedTuple):
    """p and lam with E^T p - F^T lam normal to the parts."""

    p: np.ndarray
    multipliers: np.ndarray


class Splitting:
    """The two maps of a flat set, in units of s: one a part, which keeps its own metric."""

    def __init__(self, flat: Flat, units: np.ndarray) -> None:
        self.flat, self.units = flat, units
        ends = np.cumsum([0, *(part.dim for part in flat.parts)])
        places = [slice(*pair) for pair in pairwise(ends)]
        self._each = [
            (part, at, float(units[at.start])) for part, at in zip(flat.parts, places, strict=True)
        ]
        self.E, self.F = flat.E / units, flat.F / units
        self.start, Z = solutions(self.F, flat.g)
        seen = self.E @ Z
        self._K = Z @ np.linalg.solve(np.eye(Z.shape[1]) + seen.T @ seen, Z.T)

    def projected(self, x: np.ndarray) -> np.ndarray:
        return np.concatenate([unit * part.project(x[at] / unit) for part, at, unit in self._each])

    def pull(self, v: np.ndarray, s: np.ndarray) -> np.ndarray:
        """E^T (v - w)."""
        return np.asarray(self.E.T @ (v - self.flat.c - self.E @ s))

    def rounding_scale(self, x: np.ndarray) -> np.ndarray:
        """The size of what projections round, entry by entry."""
        rounding_scale = np.zeros(x.size)
        for part, at, unit in self._each:
            rounding_scale[at] = unit * part.rounding_scale(x[at] / unit)
        return rounding_scale

    def size(self, v: np.ndarray) -> float:
        """Of E^T v and E^T c, whatever cancels."""
        return float(np.abs(self.E).max(initial=0.0) * np.abs([v, self.flat.c]).max())

    def _derivative(self, x: np.ndarray) -> np.ndarray | None:
        D = np.zeros((x.size, x.size))
        for part, at, unit in self._each:
            found = part.derivative(x[at] / unit)
            if found is None:
                return None
            D[at, at] = np.diag(found) if found.ndim == 1 else found
        return D

    def nearest(self, v: np.ndarray, x: np.ndarray, sweeps: int, like: float) -> Near | None:
        """From x = s - n, n the normal; None if so many sweeps do not suffice.

        `like` is the size of what is rounded in s and n.
        """
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

        found = fixed_point(step, x, np.array([like]), sweeps, slope)
        if found is None:
            return None
        s, image = near(found), 2 * near(found) - found
        held = self.projected(image)
        # a far start may have left nothing but its rounding: judged by the data, and without it
        limits = np.abs(self.flat.g) + like * np.abs(self.F).sum(axis=1)
        missed = np.abs(self.flat.g - self.F @ held)
        if np.abs(held - s).max() > 10 * ROUNDING * like or (missed > 10 * ROUNDING * limits).any():
            return None
        return Near(v, self.point(v, held), held, image, self)

    def point(self, v: np.ndarray, s: np.ndarray) -> np.ndarray:
        """c + E s, or v itself where that is the same to rounding: v is in C."""
        w = self.flat.c + self.E @ s
        rounding = ROUNDING * (np.abs(self.flat.c) + np.abs(self.E) @ np.abs(s))
        return v.copy() if (np.abs(v - w) <= rounding).all() else w

    def normal(self, near: Near) -> Normal:
        """v - w, changed by what rounding of v keeps it from being one to the parts' normals."""
        inner = self._normals(near)
        p, F, E = near.v - near.w, self.F.T, self.E.T
        found = np.linalg.lstsq(F, E @ p - inner, rcond=RANK)[0]
        missed = inner - E @ p + F @ found
        change = np.linalg.lstsq(np.hstack([E, -F]), missed, rcond=RANK)[0]
        return Normal(p + change[: p.size], found + change[p.size :])

    def _normals(self, near: Near) -> np.ndarray:
        """Those of the parts, computed by the parts."""
        x = near.image
        return np.concatenate([unit * part.normal(x[at] / unit) for part, at, unit in self._each])

    def perturbation(self, near: Near, p: np.ndarray) -> Perturbation | None:
        """How far w and p are from a pair, to first order; None where parts have no derivative.

        A part's point s and its normal n move along its normals by  ds = D dx, dn = (I - D) dx. The
        dx, dlam and the small dw, dp that make  n = E^T p - F^T lam,  F s = g  and  w = c + E s
        true are linear in what these miss, which is known but for rounding.
        """
        D = self._derivative(near.image)
        if D is None:
            return None
        s, n, E, F = near.s, near.image - near.s, self.E, self.F
        multipliers = np.linalg.lstsq(F.T, E.T @ p - n, rcond=RANK)[0]
        turns = np.eye(s.size) - D
        if not p.any():  # which is normal everywhere
            n, multipliers, turns = 0 * n, 0 * multipliers, 0 * turns
        rounding_scale = self.rounding_scale(near.image)
        sizes = np.abs(s) + rounding_scale
        forces = (
            np.abs(E.T) @ np.abs(p) + np.abs(F.T) @ np.abs(multipliers) + p.any() * rounding_scale
        )
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
        back = LIGHT * _inverse(system, 2 * k)
        # what is known adds up, what is rounding adds up as the root of squares
        moved = np.abs(back @ missed) + np.sqrt(back**2 @ rounding**2)
        return Perturbation(moved[:k], moved[k:])

    def derivative(self, near: Near) -> np.ndarray | None:
        """dw/dv."""
        D = self._derivative(near.image)
        if D is None:
            return None
        one, pull = np.eye(len(D)), self._K @ self.E.T
        jacobian = self._K - D @ (2 * self._K - one)
        dx = np.linalg.lstsq(jacobian, (2 * D - one) @ pull, rcond=RANK)[0]
        return np.asarray(self.E @ (self._K @ dx + pull))


def _inverse(wide: np.ndarray, last: int) -> np.ndarray:
    """The last rows of the pseudo-inverse: W^T (W W^T)^-1 where rounding of the squares allows."""
    with contextlib.suppress(np.linalg.LinAlgError):
        L, low = scipy.linalg.cho_factor(wide @ wide.T, lower=True)
        sizes = L.diagonal()
        if sizes.min() > SQUARED * sizes.max():
            return np.asarray(scipy.linalg.cho_solve((L, low), wide[:, -last:]).T)
    return np.asarray(np.linalg.pinv(wide, rcond=RANK)[-last:])
