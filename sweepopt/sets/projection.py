"""The projection on a lifted set: a splitting method that Newton's method finishes.

The point of { c + E s : s in S, F s = g } nearest to v minimises 1/2 |c + E s - v|^2. Douglas and
Rachford's splitting (P. Lions, B. Mercier, SIAM J. Numer. Anal. 16, 1979) needs two maps only: the
projections on the parts of S, which are exact, and a linear map that is factorised once. Its fixed
point x has s = P_S(x) and the normal x - s of S; an answer counts only if it is one to rounding.
Sparse data stay sparse: beyond DENSE unknowns there is no Newton's method.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from sweepopt.linalg import dense
from sweepopt.sets.base import RANK, ROUNDING, Form, Perturbation, binary

LAST = 2 * float(np.finfo(float).eps)  # what one number of many is rounded
SQUARED = 1e-5  # pivots whose squares are more than this share can be divided by
LIGHT = 1e-4  # columns of what should move little, beside what may
SWEEPS = 500  # of the accelerated splitting, before a program takes over
FEW = (10, 40, 160)  # plain sweeps, before Newton's method tries to finish
CONFIRMING = 5  # and after it
NEWTON_STEPS = 30
HALVINGS = 6
MEMORY = 10  # steps that Anderson's acceleration looks back
RUNAWAY = 1e3  # the longest step of it, in units of the data
UNITS = 16  # powers of two for which a factorisation is kept

Map = Callable[[np.ndarray], np.ndarray]
Slope = Callable[[np.ndarray], np.ndarray | None]


class Projection(NamedTuple):
    """The point w = c + E s of C nearest to v; s = P(image), both in units of the splitting."""

    v: np.ndarray
    w: np.ndarray
    s: np.ndarray
    image: np.ndarray
    splitting: Splitting

    @property
    def parts(self) -> np.ndarray:
        """s in the units of the parts."""
        return self.s / self.splitting.units

    def perturbation(self, p: np.ndarray) -> Perturbation:
        """How far w and p, near v - w, are from an exact pair at most."""
        known = self.splitting.perturbation(self, p) if self.splitting.small else None
        return known or rounded(self.v)


def rounded(v: np.ndarray) -> Perturbation:
    """The same where nothing is known but v, of which w and p are parts."""
    size = np.full(v.size, 10 * ROUNDING * np.abs(v).max())
    return Perturbation(size, size)


class Start(NamedTuple):
    """Points s of the parts and their normals n, each in units of the parts."""

    s: np.ndarray
    n: np.ndarray


class Effort(NamedTuple):
    """What is tried from a start: so many sweeps, and a unit of s.

    In smaller units the linear map pulls harder on E s = v: that helps at points of the boundary.
    What counts as rounding of the data grows, as parts may be projected on less exactly.
    """

    sweeps: int
    rounding: float
    unit: float


FIRST = (Effort(160, 1.0, 1.0), Effort(SWEEPS, 1.0, 0.125))
LATER = (Effort(100, 10.0, 1.0), Effort(100, 10.0, 0.125))
# 900 discs on a gradient (1,800 unknowns): gap 1e-15 after 500 accelerated sweeps, 1 in unit 1
SPARSE = Effort(SWEEPS, 1.0, 1 / 32)
ON_FACES = Effort(40, 1e3, 1.0)  # of polyhedra, where no tangent faces amplify what is rounded


class Projector:
    """The splittings of one lifted set, in the units that points at all distances ask for.

    The parts' points s and normals n are both in the iterate x: where n is much larger it would
    round s away, so that s is measured in a larger unit (n in a smaller one), a power of two.
    """

    def __init__(self, form: Form) -> None:
        self.form, self.small = form, form.small
        # units in which the columns of E and F are near 1, one for each part
        columns = np.sqrt(sum(_squares(M) for M in (form.E, form.F)))
        sizes = [binary(float(np.linalg.norm(columns[at]))) for at in places(form)]
        self._units = np.repeat(sizes, [part.dim for part in form.parts])
        self._kept: dict[float, Splitting] = {}

    def splitting(self, unit: float) -> Splitting:
        """In another unit."""
        splitting = self._kept.get(unit)
        if splitting is None:  # threads may build it twice, but none reads what another one clears
            splitting = Splitting(self.form, unit * self._units)
            if len(self._kept) >= UNITS:
                self._kept.clear()
            self._kept[unit] = splitting
        return splitting

    def start(self, v: np.ndarray) -> Start:
        """From where v pulls a point of F s = g."""
        plain = self.splitting(1.0)
        s = plain.projected(plain.start + plain.pull(v, plain.start))
        return Start(s / self._units, self._units * plain.pull(v, s))

    def __call__(self, v: np.ndarray, start: Start, effort: Effort) -> Projection | None:
        """The projection of v; None if no answer is confirmed to rounding of the data."""
        plain = self.splitting(1.0)
        s, n = self._units * start.s, start.n / self._units
        size_s = float(max(np.abs(x).max() for x in (s, plain.start, plain.rounding_scale(s))))
        size_n = max(float(np.abs(n).max()), plain.size(v))
        unit = binary(float(np.sqrt(size_n / size_s))) if 0 < size_s < size_n else 1.0
        unit *= effort.unit
        like = effort.rounding * max(unit * size_s, size_n / unit)
        return self.splitting(unit).nearest(v, unit * s - n / unit, like, effort.sweeps)

    def approximate(self, v: np.ndarray) -> np.ndarray:
        """A point s of S with c + E s near the projection of v, where none is confirmed."""
        start = self.start(v)
        x = SPARSE.unit * self._units * start.s - start.n / (SPARSE.unit * self._units)
        return self.splitting(SPARSE.unit).approximate(v, x)

    def from_program(self, v: np.ndarray, p: np.ndarray, multipliers: np.ndarray) -> Start:
        """A start from an approximate normal p of C and multipliers of F s = g."""
        form = self.form
        both, target = np.vstack([dense(form.E), dense(form.F)]), np.append(v - p, form.g)
        if form.c is not None:
            target[: p.size] -= form.c
        s = np.linalg.lstsq(both * self._units**-1.0, target, rcond=RANK)[0] / self._units
        return Start(s, form.E.T @ p - form.F.T @ multipliers)


class Splitting:
    """The two maps of a lifted set, in units of s: one a part, which keeps its own metric."""

    def __init__(self, form: Form, units: np.ndarray) -> None:
        self.form, self.units = form, units
        self.small = form.small
        self._each = [
            (part, at, float(units[at.start]))
            for part, at in zip(form.parts, places(form), strict=True)
        ]
        scale = sp.diags_array(1 / units)
        kept: Callable[[Any], Any] = dense if self.small else sp.csr_array
        self.c = form.image_of_zero()
        self.E, self.F = kept(form.E @ scale), kept(form.F @ scale)
        if self.small:
            self.start, Z = solutions(self.F, form.g)
            seen = self.E @ Z
            self._K = Z @ np.linalg.solve(np.eye(Z.shape[1]) + seen.T @ seen, Z.T)
        else:
            n, m = self.E.shape[1], self.F.shape[0]
            inner = sp.eye_array(n) + self.E.T @ self.E
            system = [[inner, self.F.T], [self.F, None]] if m else [[inner]]
            self._factor = splu(sp.csc_array(sp.block_array(system)))
            self.start = self._factor.solve(np.append(np.zeros(n), form.g))[:n]

    def _near(self, v: np.ndarray) -> Map:
        """x -> argmin of 1/2 |c + E s - v|^2 + 1/2 |s - x|^2 under F s = g."""
        if self.small:
            center = self.start + self._K @ (self.pull(v, self.start) - self.start)
            return lambda x: np.asarray(center + self._K @ x)
        pulled = self.E.T @ (v - self.c)
        return lambda x: self._factor.solve(np.append(pulled + x, self.form.g))[: x.size]

    def projected(self, x: np.ndarray) -> np.ndarray:
        """P_S(x)."""
        return np.concatenate([unit * part.project(x[at] / unit) for part, at, unit in self._each])

    def pull(self, v: np.ndarray, s: np.ndarray) -> np.ndarray:
        """E^T (v - w)."""
        return np.asarray(self.E.T @ (v - self.c - self.E @ s))

    def rounding_scale(self, x: np.ndarray) -> np.ndarray:
        """The size of what projections round, entry by entry."""
        scale = np.zeros(x.size)
        for part, at, unit in self._each:
            scale[at] = unit * part.rounding_scale(x[at] / unit)
        return scale

    def size(self, v: np.ndarray) -> float:
        """Of E^T v and E^T c, whatever cancels."""
        return float(abs(self.E).max() * max(np.abs(v).max(), np.abs(self.c).max()))

    def _derivative(self, x: np.ndarray) -> np.ndarray | None:
        D = np.zeros((x.size, x.size))
        for part, at, unit in self._each:
            own = part.derivative(x[at] / unit)
            if own is None:
                return None
            D[at, at] = np.diag(own) if own.ndim == 1 else own
        return D

    def _step(self, v: np.ndarray) -> Map:
        """One sweep of the splitting."""
        near = self._near(v)

        def step(x: np.ndarray) -> np.ndarray:
            s = near(x)
            return x + self.projected(2 * s - x) - s

        return step

    def approximate(self, v: np.ndarray, x: np.ndarray) -> np.ndarray:
        """A point s of S, in units of the parts, after as many sweeps as ever are tried."""
        found = _sweep(self._step(v), x, 0.0, SWEEPS, MEMORY).x
        return self.projected(2 * self._near(v)(found) - found) / self.units

    def nearest(self, v: np.ndarray, x: np.ndarray, like: float, sweeps: int) -> Projection | None:
        """From x = s - n, n the normal; None if no fixed point is confirmed.

        `like` is the size of what is rounded in s and n.
        """
        near, step = self._near(v), self._step(v)

        def slope(x: np.ndarray) -> np.ndarray | None:
            D, one = self._derivative(2 * near(x) - x), np.eye(x.size)
            return None if D is None else one + D @ (2 * self._K - one) - self._K

        found = fixed_point(step, x, like, slope if self.small else None, sweeps)
        if found is None:
            return None
        s, image = near(found), 2 * near(found) - found
        held = self.projected(image)
        # a far start may have left nothing but its rounding: judged by the data, and without it
        limits = np.abs(self.form.g) + like * abs(self.F).sum(axis=1)
        missed = np.abs(self.form.g - self.F @ held)
        if np.abs(held - s).max() > 10 * ROUNDING * like or (missed > 10 * ROUNDING * limits).any():
            return None
        return Projection(v, self.point(v, held), held, image, self)

    def point(self, v: np.ndarray, s: np.ndarray) -> np.ndarray:
        """c + E s, or v itself where that is the same to rounding: v is in C."""
        w = self.c + self.E @ s
        rounding = ROUNDING * (np.abs(self.c) + abs(self.E) @ np.abs(s))
        return v.copy() if (np.abs(v - w) <= rounding).all() else w

    def normals(self, near: Projection) -> np.ndarray:
        """The normals of the parts, computed by the parts."""
        x = near.image
        return np.concatenate([unit * part.normal(x[at] / unit) for part, at, unit in self._each])

    def normal(self, near: Projection) -> np.ndarray:
        """v - w, changed by what rounding of v keeps it from being one to the parts' normals."""
        p = near.v - near.w
        if not self.small:
            return p
        n, F, E = self.normals(near), self.F.T, self.E.T
        multipliers = np.linalg.lstsq(F, E @ p - n, rcond=RANK)[0]
        missed = n - E @ p + F @ multipliers
        return p + np.linalg.lstsq(np.hstack([E, -F]), missed, rcond=RANK)[0][: p.size]

    def perturbation(self, near: Projection, p: np.ndarray) -> Perturbation | None:
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
        scale = self.rounding_scale(near.image)
        sizes = np.abs(s) + scale
        forces = np.abs(E.T) @ np.abs(p) + np.abs(F.T) @ np.abs(multipliers) + p.any() * scale
        ties = np.abs(F) @ sizes + np.abs(self.form.g)
        points = np.abs(E) @ sizes + np.abs(self.c)
        missed = np.concatenate(
            [E.T @ p - F.T @ multipliers - n, self.form.g - F @ s, np.zeros(p.size)]
        )
        rounding = LAST * np.concatenate([forces, ties, points])
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

    def derivative(self, near: Projection) -> np.ndarray | None:
        """dw/dv."""
        D = self._derivative(near.image) if self.small else None
        if D is None:
            return None
        one, pull = np.eye(len(D)), self._K @ self.E.T
        jacobian = self._K - D @ (2 * self._K - one)
        dx = np.linalg.lstsq(jacobian, (2 * D - one) @ pull, rcond=RANK)[0]
        return np.asarray(self.E @ (self._K @ dx + pull))


def places(form: Form) -> list[slice]:
    """Where in s each part is."""
    ends = np.cumsum([0, *(part.dim for part in form.parts)]).tolist()
    return [slice(*pair) for pair in pairwise(ends)]


class Solutions(NamedTuple):
    """{ s : F s = g } = { one + Z y }, the columns of Z orthonormal; the least squares if none."""

    one: np.ndarray
    Z: np.ndarray


def solutions(F: np.ndarray, g: np.ndarray) -> Solutions:
    """All solutions of a small linear system."""
    U, sizes, Vt = np.linalg.svd(F)
    rank = int((sizes > RANK * sizes.max(initial=0.0)).sum())
    return Solutions(Vt[:rank].T @ ((U.T @ g)[:rank] / sizes[:rank]), Vt[rank:].T)


def _squares(M: Any) -> np.ndarray:
    return np.asarray((M * M).sum(axis=0), dtype=float).ravel()


def _inverse(wide: np.ndarray, last: int) -> np.ndarray:
    """The last rows of the pseudo-inverse: W^T (W W^T)^-1 where rounding of the squares allows."""
    with contextlib.suppress(np.linalg.LinAlgError):
        L, low = scipy.linalg.cho_factor(wide @ wide.T, lower=True)
        sizes = L.diagonal()
        if sizes.min() > SQUARED * sizes.max():
            return np.asarray(scipy.linalg.cho_solve((L, low), wide[:, -last:]).T)
    return np.asarray(np.linalg.pinv(wide, rcond=RANK)[-last:])


# ---- fixed points of nonexpansive maps ----------------------------------------------------------


class _Reached(NamedTuple):
    """Where sweeps ended, and whether that is a fixed point to rounding."""

    x: np.ndarray
    fixed: bool


def fixed_point(
    step: Map, x: np.ndarray, like: float, slope: Slope | None = None, sweeps: int = SWEEPS
) -> np.ndarray | None:
    """x = step(x) to rounding for a nonexpansive step; None if so many sweeps do not suffice.

    Sweeps crawl where two sets are nearly tangent. With a `slope`, Newton's method tries to finish
    when a few plain ones have come to the right faces, and sweeps only confirm what it finds.

    Parameters
    ----------
    step : callable
    x : ndarray, shape (dim,)
        Start.
    like : float
        The size of the data in the units of x: rounding is relative to the larger of the two.
    slope : callable
        x -> a generalised derivative of `step`, shape (dim, dim), or None.
    """
    start, sharpest = x, (lambda x: x) if slope is None else partial(_sharpened, step, slope)
    for few in [few for few in FEW if few <= sweeps and slope is not None]:
        reached = _sweep(step, start, like, few, memory=0)
        start = reached.x
        if not reached.fixed and slope is not None:
            ahead = _newton(step, slope, start, max(like, float(np.abs(start).max())))
            reached = _sweep(step, ahead, like, CONFIRMING, memory=0)
        if reached.fixed:
            return sharpest(reached.x)
    reached = _sweep(step, start, like, sweeps, MEMORY)
    return sharpest(reached.x) if reached.fixed else None


def _sharpened(step: Map, slope: Slope, x: np.ndarray) -> np.ndarray:
    """One Newton step more, where sets are nearly tangent and a small residual means little."""
    residual, D = step(x) - x, slope(x)
    if D is None or not residual.any():
        return x
    ahead = x + np.linalg.lstsq(np.eye(x.size) - D, residual, rcond=RANK)[0]
    smaller = np.abs(step(ahead) - ahead).max() <= np.abs(residual).max()
    return ahead if smaller else x


def _newton(step: Map, slope: Slope, x: np.ndarray, size: float) -> np.ndarray:
    """Semismooth Newton steps on x - step(x) = 0, the shortest ones where many x solve it.

    A step that makes the residual larger is halved: sets with hardly a curvature need that.
    """
    start, residual = x, step(x) - x
    for _ in range(NEWTON_STEPS):
        if np.abs(residual).max() <= ROUNDING * max(size, np.abs(x).max()):
            break
        D = slope(x)
        if D is None:
            break
        change = np.linalg.lstsq(np.eye(x.size) - D, residual, rcond=RANK)[0]
        ahead, left = _shortened(step, x, change, float(np.linalg.norm(residual)))
        if np.abs(ahead).max() > RUNAWAY * size:
            return start  # nearly parallel faces: what solves x = step(x) there is rounding of x
        small = np.abs(ahead - x).max() <= ROUNDING * np.abs(x).max()
        x, residual = ahead, left
        if small:
            break
    return x


def _shortened(
    step: Map, x: np.ndarray, change: np.ndarray, size: float
) -> tuple[np.ndarray, np.ndarray]:
    """x + change, or on the way there, and its residual: at a kink no part need be better."""
    tried = []
    for halvings in range(HALVINGS):
        ahead = x + 0.5**halvings * change
        tried.append((ahead, step(ahead) - ahead))
        if np.linalg.norm(tried[-1][1]) < size:
            return tried[-1]
    return tried[0]


def _sweep(step: Map, x: np.ndarray, like: float, sweeps: int, memory: int) -> _Reached:
    """Anderson's acceleration (Walker and Ni, SIAM J. Numer. Anal. 49, 2011), with the plain
    iteration, whose residual never grows, as the safeguard of Zhang, O'Donoghue and Boyd (2020).

    Without memory the plain iteration: slow, but it never leaves the faces that it comes to.
    """
    images: list[np.ndarray] = []
    residuals: list[np.ndarray] = []
    size = max(like, float(np.abs(x).max()))
    for _ in range(sweeps):
        image = step(x)
        residual = image - x
        if np.abs(residual).max() <= ROUNDING * max(size, np.abs(image).max()):
            return _Reached(image, True)
        if residuals and np.linalg.norm(residual) > np.linalg.norm(residuals[-1]):
            x, images, residuals = images[-1], [], []
            continue
        old = max(len(images) - memory, 0)
        images, residuals = [*images[old:], image], [*residuals[old:], residual]
        x = image
        if len(images) > 1:
            mix = np.linalg.lstsq(np.diff(residuals, axis=0).T, residual, rcond=1e-12)[0]
            ahead = image - np.diff(images, axis=0).T @ mix
            # no fixed point: the acceleration runs off, and would hide the residual in its size
            x = ahead if np.abs(ahead).max() <= RUNAWAY * size else image
    return _Reached(x, False)
