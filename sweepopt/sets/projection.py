"""The projection on a lifted set: Newton's method, near points that a proximal method finds.

The point of { E s : s in S, F s = 0 } nearest to v minimises 1/2 |E s - v|^2. Douglas and
Rachford's splitting (P. Lions, B. Mercier, SIAM J. Numer. Anal. 16, 1979) needs two maps only: the
projections on the parts of S, which are exact, and a linear map that is factorised once. Its fixed
point x has s = P_S(x) and the normal x - s of S; an answer is exact only if it is one to rounding.
Newton's method finds it from a good start; from any start the proximal point method does, whose
steps are smooth convex programs (X. Li, D. Sun, K.-C. Toh, A highly efficient semismooth Newton
augmented Lagrangian method, SIAM J. Optim. 28, 2018). Sparse data stay sparse: beyond DENSE
unknowns there is no Newton's method.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import lru_cache
from itertools import chain
from typing import NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from sweepopt.checks import Array
from sweepopt.linalg import dense, euclidean, row_lengths
from sweepopt.sets.base import (
    RANK,
    ROUNDING,
    TINY,
    ConvexSet,
    Form,
    Perturbation,
    binary,
    once,
    placed,
)
from sweepopt.sets.shapes import Box

# Of 600 projections on random composed sets (2 to 12 unknowns, three operations, thin and touching
# sets, columns of 1e-2 to 1e2) all are exact but one on sets that touch. On the first 150 of them
# 50 Newton steps, or a growth of 2, end no other way; a growth of 10 gives one up.
NEWTON_STEPS = 25  # from a start, and for each of as many proximal points
GROWTH = 4.0  # of the proximal parameter after each
REGULAR = 1e-3  # multiple of 1 in the Hessian, for a gradient as large as what it adds up
SWEEPS = 500  # of large sets: 900 discs on a gradient (1,800 unknowns) take as many
# Multipliers of sets that touch have no bound: 1e3 times |v - w| where no projection is exact. Of a
# flat and a round set that overlap by d of their size they are |v - w| / sqrt(d). What an exact
# projection says of its rounding is right to first order, while d is known to 4 digits.
TENSION = 1e3
TENSION_EXACT = 1e6
# Of points 1e-6 to 0.1 inside the boundary of a polytope + a box 1 of 100 projections was moved, by
# more than 50 times the rounding of s: faces that meet there are nearly parallel
HIDDEN = 100 * ROUNDING
INSIDE = 1e-6  # of the size of a part from its boundary: rounding moves no point so far
TENSE = 2.0**-12  # of L^-1: normals 2^24 times as large as points, and more than TENSION_EXACT
LOOK_BACK = 10  # steps that Anderson's acceleration looks back, as in Walker and Ni's tests

Map = Callable[[Array], Array]


class Projection(NamedTuple):
    """The point w = E s of C nearest to v; s = P(image), both in units of the splitting.

    `exact` says whether it is that to rounding of the data, `scale` how much P rounds.
    """

    v: Array
    w: Array
    s: Array
    image: Array
    scale: Array
    exact: bool
    splitting: Splitting

    @property
    def p(self) -> Array:
        """What v is away from C, a normal of it at w."""
        return self.v - self.w

    @property
    def start(self) -> Start:
        """From which a projection of another point nearby may start."""
        return Start(self.s, self.image - self.s).scaled(1 / self.splitting.units)


class Start(NamedTuple):
    """Points s of the parts and their normals n."""

    s: Array
    n: Array

    def scaled(self, units: Array) -> Start:
        """In these units of s."""
        return Start(units * self.s, self.n / units)


class Projector:
    """The splittings of one lifted set, in the units that points at all distances ask for.

    The parts' points s and normals n are both in the iterate x: where n is much larger it would
    round s away, so that s is measured in a larger unit (n in a smaller one), a power of two.
    """

    def __init__(self, form: Form) -> None:
        # units in which the columns of E and F are near 1, as far as parts keep their metric
        squares = row_lengths(form.rows.T) ** 2
        weights = np.concatenate([part.weights(squares[at]) for part, at in placed(form.parts)])
        units = np.array([binary(size) for size in np.sqrt(weights).tolist()])
        self.splitting = lru_cache(16)(lambda unit: Splitting(form, unit * units))

    def __call__(self, v: Array, start: Start | None = None, patient: bool = True) -> Projection:
        """The projection of v, as exactly as it is found; without a start from where v pulls 0.

        Without patience from the start alone.
        """
        plain = self.splitting(1.0)
        pull = plain.E.T @ v
        if start is not None and (
            start.s.size != pull.size
            # what cancels among normals, as of opposite rows, stays from larger forces; zeros tell
            # nothing of a set that does not hold 0
            or np.abs(start.n / plain.units).max() >= TENSION * np.abs(pull).max()
        ):
            start = None
        if start is None:
            s = plain.projected(pull)
            start = Start(s, plain.E.T @ (v - plain.E @ s)).scaled(1 / plain.units)
        for point in chain([start], plain.proximal_points(v, start) if patient else ()):
            near = self._from(v, point)
            if near.exact:
                break
        return near

    def _from(self, v: Array, start: Start) -> Projection:
        """From a start, in units in which its points are as large as its normals.

        Where normals have become large on the way, the units for them are known only then.
        """
        plain = self.splitting(1.0)
        s, n = start.scaled(plain.units)
        size_s = float(max(np.abs(s).max(), plain.extent))
        size_n = max(float(np.abs(n).max()), plain.pull_size(v))
        unit = binary(float(np.sqrt(size_n / size_s))) if 0 < size_s < size_n else 1.0
        size = max(unit * size_s, size_n / unit)
        return self.splitting(unit).projection(v, unit * s - n / unit, size)


class NearestPair(NamedTuple):
    """About z, the points of the parts, and the normals that add up to -z.

    If they are known to rounding, w is the point of C, and `perturbation` how far the pair is from
    an exact one, in |.|_M and |.|_{M^-1} together; inf where rounding hides that.
    """

    z: Array
    start: Start
    w: Array | None
    perturbation: float


class InMetric:
    """For the z with -z in N_C(M z + q): M z + q is the point of C nearest to q in that of M^-1.

    With M = u L L^T it is L w, w the point of L^-1 C nearest to L^-1 q. The unit u is that of M:
    normals are forces then, as points are, and neither is rounding beside the other. Those of parts
    that hardly overlap are up to 1e6 times as large: then u is so much smaller.
    """

    def __init__(self, C: ConvexSet, M: Array) -> None:
        self._C, self._form = C, C.form()
        self._root = _inverse_root(M)
        self._E = dense(self._form.E)
        # any normal is one of a point
        points = np.concatenate([np.full(S.dim, S.singleton) for S in self._form.parts])
        self._alone, self._sums = _normals_of(self._E, dense(self._form.F), points)
        self._projector = lru_cache(2)(self._in_unit)

    def _in_unit(self, share: float) -> Projector:
        return Projector(self._form._replace(E=share * self._root[1] @ self._E))

    def __call__(self, q: Array, proved: bool) -> NearestPair:
        """From the one before, of this set or another; without a proof there is no perturbation."""
        pair = self._nearest(q, 1.0, proved)
        if proved and pair.perturbation == np.inf:
            other = self._nearest(q, TENSE, proved)
            pair = other if other.perturbation < np.inf else pair
        self._C._start = pair.start
        return pair

    def _nearest(self, q: Array, share: float, proved: bool) -> NearestPair:
        u, inverse, start = share**2 * self._root[0], share * self._root[1], self._C._start
        v = inverse @ q
        near = self._projector(share)(v, start and Start(start.s, u * start.n))
        p, (s, n) = inverse.T @ near.p, near.start
        perturbation, w = np.inf, self._E @ s if near.exact else None
        if near.exact and proved:
            # 0.0 where the normals that p adds up are rounding of the points
            pulls = np.abs(near.image - near.s) > ROUNDING * (np.abs(near.s) + near.scale)
            rests = (self._alone & ~pulls).any(axis=1)
            rests |= ~(self._sums & np.append(pulls, True)).any(axis=1)
            p[rests | (np.abs(p) <= ROUNDING * np.abs(p).max())] = 0.0
            perturbation = self._perturbation(near, p, u, inverse)
        return NearestPair(0.0 - p / u, Start(s, n / u), w, perturbation)

    def _perturbation(self, near: Projection, p: Array, u: float, inverse: Array) -> float:
        """From E, not from L^-1 E, which is rounded: that only weighs what is left of it."""
        splitting = near.splitting
        E, sizes = self._E / splitting.units, np.abs(near.s) + near.scale
        shifts = splitting.shifts(near, E.T @ p, np.abs(E.T) @ np.abs(p))
        if shifts is None or splitting.is_tense(near):
            return np.inf
        of_w = np.abs(inverse) @ (ROUNDING / 4 * np.abs(E) @ sizes)
        # the pair is that of w + M p, w and p are shifted alike, and p counts twice
        return (3 * euclidean(shifts) + euclidean(of_w)) / np.sqrt(u)


@once
def _inverse_root(M: Array) -> tuple[float, Array]:
    """A power of two u and L^-1 of M = u L L^T, L of a determinant near 1."""
    root = np.linalg.cholesky(M)
    size = binary(float(np.exp(np.log(root.diagonal()).mean())))
    return size**2, size * np.linalg.inv(root)


@once
def _normals_of(E: Array, F: Array, points: Array) -> tuple[Array, Array]:
    """Of E^T p - F^T lam = n: which n_j are p_i alone but for a factor, and which ones p_i adds up.

    A last column says where the n_j, but for those of points, do not know p_i.
    """
    alone = (E != 0) & ~F.any(axis=0) & (np.count_nonzero(E, axis=0) == 1) & ~points
    columns = np.vstack([E, F]) * ~points
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), TINY)
    inverse = np.linalg.pinv(columns.T)
    unknown = np.abs(inverse @ columns.T - np.eye(len(columns))).max(axis=1) > REGULAR
    sums = np.abs(inverse) > RANK * np.abs(inverse).max(axis=1, keepdims=True)
    return alone, np.column_stack([sums, unknown])[: len(E)]


class Splitting:
    """The two maps of a lifted set, in units of s: one a part, which keeps its own metric."""

    def __init__(self, form: Form, units: Array) -> None:
        self.small, self.units = form.small, units
        self.smooth = form.small and all(part.differentiable for part in form.parts)
        self.parts = placed(form.parts)
        self._curved = np.concatenate([np.full(S.dim, not S.polyhedral) for S in form.parts])
        # a box rounds nothing
        self._rounded = [
            (part, at, float(np.abs(part.offsets).max(initial=0.0)))
            for part, at in self.parts
            if not isinstance(part, Box)
        ]
        extents = (units[at].max() * size for _, at, size in self._rounded)
        self.extent = float(max(extents, default=0.0))
        m, n = form.F.shape
        if self.small:
            rows = form.rows / units
            self.E, self.F = rows[: -m or None], rows[len(rows) - m :]
            self._K, self._reflection, self._multipliers = _maps(self.E, self.F)
        else:
            scale = sp.diags_array(1 / units)
            self.E, self.F = sp.csr_array(form.E @ scale), sp.csr_array(form.F @ scale)
            inner = sp.eye_array(n) + self.E.T @ self.E
            system = [[inner, self.F.T], [self.F, None]]
            self._factor = splu(sp.csc_array(sp.block_array(system)))
        self._sums = abs(self.E).sum(axis=1)
        self._largest = float(abs(self.E).max())

    def K(self, x: Array) -> Array:
        """argmin of 1/2 |E s|^2 + 1/2 |s|^2 - <x, s> under F s = 0."""
        if self.small:
            return np.asarray(self._K @ x)
        return self._factor.solve(np.append(x, np.zeros(self.F.shape[0])))[: x.size]

    def projected(self, x: Array) -> Array:
        """P_S(x)."""
        x = x / self.units
        return self.units * np.concatenate([part.project(x[at]) for part, at in self.parts])

    def rounding_scale(self, x: Array) -> Array:
        """The size of what projections round, entry by entry; 0 of parts that do not bind."""
        x, scale = x / self.units, np.zeros(x.size)
        for part, at, size in self._rounded:
            size = max(float(np.abs(x[at]).max()), size)
            if not part.is_inside(x[at], INSIDE * size):
                scale[at] = self.units[at] * size
        return scale

    def derivative_of_parts(self, x: Array) -> Array | None:
        """Of the projection on the parts; None for large sets, and where a part has none."""
        if not self.smooth:
            return None
        D, x = np.zeros((x.size, x.size)), x / self.units
        for part, at in self.parts:
            blocks = part.blocks(x[at])
            if blocks is None:
                return None
            for few, block in blocks:
                if few.size == part.dim == few.shape[1]:
                    D[at, at] = block[0]
                else:
                    D[at, at][few[:, :, None], few[:, None]] = block
        return D

    def projection(self, v: Array, x: Array, size: float) -> Projection:
        """From x = s - n, n the normal; `size` is that of what is rounded in s and n."""
        center = self.K(self.E.T @ v)

        def at(x: Array) -> Iterate:
            """s the argmin of 1/2 |E s - v|^2 + 1/2 |s - x|^2 under F s = 0."""
            s = center + self.K(x)
            image = 2 * s - x
            return Iterate(s, image, self.projected(image))

        def step(x: Array) -> Array:
            s, _, on_parts = at(x)
            return x + (on_parts - s)

        if self.smooth:
            (s, image, on_parts), fixed = self._newton(v, at, x, size)
        else:
            x, fixed = fixed_point(step, x, size)
            s, image, on_parts = at(x)
        exact = fixed and bool(np.abs(on_parts - s).max() <= 10 * ROUNDING * size)
        scale = self.rounding_scale(image)
        near = Projection(v, self._point(v, on_parts, size), on_parts, image, scale, exact, self)
        return near._replace(w=v.copy()) if self._hides_rest(near, size) else near

    def pull_size(self, v: Array) -> float:
        """Of the terms of E^T v."""
        return self._largest * float(np.abs(v).max())

    def _size(self, v: Array, image: Array, scale: Array) -> float:
        """Of what rounds in points s and normals n, image = s + n."""
        return max(float(np.abs(image).max()), float(scale.max()), self.pull_size(v))

    def _hides_rest(self, near: Projection, size: float) -> bool:
        """Whether v is in C but for what the projection rounds: that is known to first order."""
        p = near.p
        if not (near.exact and p.any() and (np.abs(p) <= HIDDEN * size * self._sums).all()):
            return False
        moved = self.perturbation(near, p)
        return moved is not None and euclidean(p) <= 2 * euclidean(moved.w)

    def _newton(
        self, v: Array, at: Callable[[Array], Iterate], x: Array, size: float
    ) -> tuple[Iterate, bool]:
        """Whole Newton steps on P_S(image) = s, and whether they end there to rounding.

        A multiple of 1 that goes to 0 with the residual makes the Jacobian regular where many x
        solve it (X. Xiao, Y. Li, Z. Wen, L. Zhang, A regularized semi-smooth Newton method with
        projection steps, J. Sci. Comput. 76, 2018). Where they go to and fro, proximal points help.
        """
        iterate, one, before = at(x), np.eye(x.size), np.inf
        for _ in range(NEWTON_STEPS):
            r = iterate.on_parts - iterate.s
            off = np.abs(r).max()
            if off <= ROUNDING * size:
                scale = self.rounding_scale(iterate.image)
                if 2 * off > before or off <= ROUNDING * self._size(v, iterate.image, scale):
                    return iterate, True
            before = off
            D = self.derivative_of_parts(iterate.image)
            if D is None:
                break
            share = euclidean(r) / max(size, float(np.abs(x).max()))
            regular = self._K - D @ self._reflection + min(max(share, RANK), 1.0) * one
            x = x + np.linalg.solve(regular, r)
            iterate = at(x)
        return iterate, False

    def proximal_points(self, v: Array, start: Start) -> Iterator[Start]:
        """Points s of the parts and their normals, nearer and nearer to those of the projection.

        The next s minimises 1/2 |E s - v|^2 + 1/2c |s - s_0|^2 on S under F s = 0. It is the point
        P_S(s_0 + c n), n = E^T p - F^T lam, at which the gradient (p - v + E s, -F s) of the dual
        program in (p, lam) is 0. That program is convex, without constraints, and smooth: Newton
        steps on it descend. Where they are too many, c is too large.
        """
        if not self.smooth:
            return
        s, _ = start.scaled(self.units)
        A, zero = np.vstack([self.E, -self.F]), np.zeros(len(self.F))
        y = np.append(v - self.E @ s, zero)
        pull = float(np.abs(A.T @ y).max())
        size_s = float(max(np.abs(s).max(), self.extent))
        # beyond it the rounding of projections of s + c n is as large as n
        most = REGULAR / (ROUNDING * float((A * A).sum()))
        c = min(size_s / pull, most) if size_s and pull else 1.0
        for _ in range(NEWTON_STEPS):
            y, solved = self._dual_point(A, np.append(v, zero), s, c, y)
            s = self.projected(s + c * (A.T @ y))
            yield Start(s, A.T @ y).scaled(1 / self.units)
            c = min(GROWTH * c, most) if solved else GROWTH**-2 * c

    def _dual_point(self, A: Array, goal: Array, center: Array, c: float, y: Array) -> FixedPoint:
        """Newton steps from y = (p, lam) on the dual program of a proximal point of center,

            min 1/2 |p|^2 - <goal, y> + max over s in S of <A^T y, s> - 1/2c |s - center|^2,

        A the rows of E and -F. How far each step goes, the slope along it says, which only grows.
        """
        one = (np.arange(y.size) < len(self.E)).astype(float)

        def gradient(y: Array) -> Array:
            return one * y - goal + A @ self.projected(center + c * (A.T @ y))

        for _ in range(NEWTON_STEPS):
            x, g = center + c * (A.T @ y), gradient(y)
            size = (np.abs(A) @ np.abs(self.projected(x)) + np.abs(goal) + one * np.abs(y)).max()
            share = np.abs(g).max() / size if size else 0.0
            if share <= 1e4 * ROUNDING:  # a good start for Newton's method, if not all digits
                return FixedPoint(y, True)
            D = self.derivative_of_parts(x)
            if D is None:
                break
            H = np.diag(one) + c * A @ D @ A.T
            regular = max(REGULAR * share, RANK) * H.diagonal().mean()
            step = -np.linalg.solve(H + regular * np.eye(len(H)), g)
            y = y + _step_length(gradient, y, step, float(g @ step)) * step
        return FixedPoint(y, False)

    def _point(self, v: Array, s: Array, size: float) -> Array:
        """E s, or v itself where that is the same to rounding: v is in C.

        All parts are known to rounding of the largest one, which rows of F hand on.
        """
        w, rounding = self.E @ s, ROUNDING * size * self._sums
        return v.copy() if (np.abs(v - w) <= rounding).all() else w

    def normals(self, pull: Array, n: Array) -> tuple[Array, Array]:
        """E^T p - F^T lam of a pull E^T p, next to normals n, and the sizes of F^T lam."""
        multipliers = self._multipliers @ (pull - n)
        return pull - self.F.T @ multipliers, np.abs(self.F.T) @ np.abs(multipliers)

    def is_tense(self, near: Projection) -> bool:
        """Whether multipliers of F s = 0 are many times as large as v - w, as forces on parts.

        They have no bound where the parts meet in no interior point. An exact projection on flat
        parts is linear in the data, however large these are.
        """
        pull = self.E.T @ near.p
        n, _ = self.normals(pull, near.image - near.s)
        of, most = (self._curved, TENSION_EXACT) if near.exact else (slice(None), TENSION)
        return euclidean((pull - n)[of]) > most * euclidean(pull)

    def perturbation(self, near: Projection, p: Array) -> Perturbation | None:
        """How far w = E s and p are from the projection of w + p and its normal, to first order.

        None where parts have no derivative.
        """
        shifts = self.shifts(near, self.E.T @ p, np.abs(self.E.T) @ np.abs(p))
        if shifts is None:
            return None
        sizes = np.abs(near.s) + near.scale
        of_w = np.abs(near.w - self.E @ near.s) + ROUNDING / 4 * np.abs(self.E) @ sizes
        return Perturbation(shifts + of_w, shifts)

    def shifts(self, near: Projection, pull: Array, sizes: Array) -> Array | None:
        """How far E s is from the projection of E s + p, of the pull E^T p and what it adds up.

        What rounds to one side of a boundary, where the derivative of a part jumps by 1, may be on
        the other: at the rim of a cut disc it then moves 1 / angle times as far.
        """
        if not self.smooth:
            return None
        s, F, scale = near.s, self.F, near.scale
        # of image = 2 s - x, what rounds in one part moves others by K
        push = 2 * ROUNDING * (np.abs(self._K) + np.eye(s.size)) @ (np.abs(s) + scale)
        each = [self.derivative_of_parts(near.image + x) for x in (0.0, push, -push)]
        known = [D for D in each if D is not None]
        if len(known) < len(each):
            return None
        some = float(pull.any())  # 0 is normal everywhere
        n = some * (near.image - s)
        normals, forces = self.normals(pull, n)
        left = np.concatenate([normals - n, -F @ s])
        rounding = [sizes + forces + some * scale, np.abs(F) @ (np.abs(s) + scale)]
        rounded, shifts = ROUNDING / 4 * np.concatenate(rounding), np.zeros(len(self.E))
        for D in known:
            if D is known[0] or np.abs(D - known[0]).max() > 0.5:
                response = self._response(D)
                # what is known adds up, what is rounding adds up as the root of squares
                shift = np.abs(response @ left) + np.sqrt(((response * rounded) ** 2).sum(axis=1))
                shifts = np.maximum(shifts, shift)
        return shifts

    def derivative(self, near: Projection) -> Array | None:
        """dw/dv."""
        D = self.derivative_of_parts(near.image)
        return None if D is None else self._response(D)[:, : len(D)] @ self.E.T

    def _response(self, D: Array) -> Array:
        """The derivative of w = E s by what is left of  E^T (v - w) - F^T lam - n = 0 and -F s = 0.

        A part's point s and its normal n move along its normals by  ds = D dx, dn = (I - D) dx. The
        transposed system has as many right-hand sides as w entries. Where it is singular, as parts
        move and their sum does not, its shortest solution is taken.
        """
        (m, n), F = self.F.shape, self.F
        transposed, right = np.zeros((n + m, n + m)), np.zeros((n + m, len(self.E)))
        right[:n] = D @ self.E.T
        transposed[:n, :n] = right[:n] @ self.E + np.eye(n) - D
        transposed[:n, n:], transposed[n:, :n] = D @ F.T, F
        with suppress(np.linalg.LinAlgError):
            response = np.linalg.solve(transposed, right).T
            if np.abs(response).max() <= 1 / RANK:
                return response
        return _shortest(transposed, right).T


def _step_length(gradient: Map, y: Array, step: Array, slope: float) -> float:
    """Where at most half of the slope along a step is left, between bounds that close in."""
    length, low, high = 1.0, 0.0, np.inf
    while ROUNDING < length < 1 / ROUNDING:
        left = gradient(y + length * step) @ step
        if abs(left) <= 0.5 * abs(slope) or high - low <= ROUNDING * length:
            break
        low, high = (low, length) if left > 0 else (length, high)
        length = 2 * length if np.isinf(high) else 0.5 * (low + high)
    return length


@once
def _maps(E: Array, F: Array) -> tuple[Array, Array, Array]:
    """K, 2 K - 1 and the multipliers of F^T."""
    n = E.shape[1]
    U, sizes, V = np.linalg.svd(F)
    rank = int((sizes > RANK * sizes.max(initial=0.0)).sum())
    Z, image = V[rank:].T, E @ V[rank:].T
    K = Z @ np.linalg.solve(np.eye(n - rank) + image.T @ image, Z.T)
    return K, 2 * K - np.eye(n), (U[:, :rank] / sizes[:rank]) @ V[:rank]


def _shortest(M: Array, right: Array) -> Array:
    """The shortest least-squares solution."""
    return np.asarray(
        scipy.linalg.lstsq(M, right, RANK, lapack_driver="gelsy", check_finite=False)[0]
    )


class Iterate(NamedTuple):
    """Of an x: s, its image 2 s - x, and the point of the parts that is next to the image."""

    s: Array
    image: Array
    on_parts: Array


class FixedPoint(NamedTuple):
    """Where an iteration ended, and whether that is its limit to rounding."""

    x: Array
    fixed: bool


def fixed_point(step: Map, x: Array, size: float) -> FixedPoint:
    """x = step(x) for a nonexpansive step, `size` that of its data.

    Anderson's acceleration (Walker and Ni, SIAM J. Numer. Anal. 49, 2011), with the plain
    iteration, whose residual never grows, as the safeguard of Zhang, O'Donoghue and Boyd (2020).
    """
    images: deque[Array] = deque(maxlen=LOOK_BACK + 1)
    residuals: deque[Array] = deque(maxlen=LOOK_BACK + 1)
    size = max(size, float(np.abs(x).max()))
    for _ in range(SWEEPS):
        image = step(x)
        residual = image - x
        if np.abs(residual).max() <= ROUNDING * max(size, np.abs(image).max()):
            return FixedPoint(image, True)
        if residuals and np.linalg.norm(residual) > np.linalg.norm(residuals[-1]):
            x = images[-1]
            images.clear()
            residuals.clear()
            continue
        images.append(image)
        residuals.append(residual)
        x = image
        if len(images) > 1:
            mix = np.linalg.lstsq(np.diff(residuals, axis=0).T, residual, rcond=1e-12)[0]
            ahead = image - np.diff(images, axis=0).T @ mix
            # no fixed point: the acceleration runs off, and would hide the residual in its size
            x = ahead if np.abs(ahead).max() <= 1e3 * size else image
    return FixedPoint(x, False)
