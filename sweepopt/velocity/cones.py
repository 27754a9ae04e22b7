"""Balls on many combinations of the unknowns, as the rows of a gradient: all matrices are sparse.

For C = c + E^T S, S balls of radii g, z minimises 1/2 <M z, z> + <q - c, z> + sum g_k |E_k z|. The
method of multipliers (Rockafellar, Math. Oper. Res. 1(2), 1976) puts s = P_S(s0 + sigma E z), s0
the multipliers of the last round. A round is solved by Newton's method, whose matrices are
M + sigma E^T D E, D the derivative of P_S in which the last s stands for g v/|v| (Hintermueller
and Stadler, SIAM J. Sci. Comput. 28(1), 2006): without that it takes ten times the steps, or
cycles. A block k that sticks, or creeps less than g_k/sigma, is then set to rest: connected blocks,
a plug, get one value, or 0 where they are held, and E_k z = 0. So (z, -E^T s) is a pair, normal but
for the angles between E_k z and s_k. Where it makes that better, s_k becomes g_k E_k z / |E_k z|,
which is normal and changes the residual. (With multipliers alone a pipe of 271 unknowns ends at
7e-8, with both at 4e-13.) The pair is the base of the next round: of z = base + w only the creep w
of a plug enters sigma E w, free of the rounding of its velocity, so that sigma can grow a
hundredfold in each round.
"""

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from sweepopt.checks import Array
from sweepopt.linalg import Factor, row_lengths
from sweepopt.sets import ROUNDING, Balls, ConvexSet, shape_of
from sweepopt.velocity.certificate import Proposal
from sweepopt.velocity.energies import Energy, Local, State

PENALTY = 1e6  # sigma of the first round, in units of M as E sees it: a plug creeps 1e-6 of g / M


class Rows(NamedTuple):
    """The blocks of E.

    Attributes
    ----------
    E : sparse, shape (b m, dim)
        First component of all blocks, then the second, and so on: arrays of shape (b, m).
    local : Local
        Each block on its own unknowns.
    tied : ndarray of bool, shape (m,)
        Whether E_k z = 0 for equal values on the unknowns, and no others; else it holds them at 0.
    """

    E: sp.csr_array
    local: Local
    tied: Array


def radii(S: ConvexSet) -> Array:
    """The radii of the balls that S is made of."""
    return np.concatenate([part.offsets for part in S.form().parts])


def blocks(S: ConvexSet) -> Rows | None:
    """The rows of S = E^T of balls of one dimension around 0, if all blocks are tied or held."""
    columns, F, parts = S.form()
    if F.shape[0] or not all(isinstance(shape_of(part), Balls) for part in parts):
        return None
    E, m = sp.csr_array(columns.T, copy=True), radii(S).size
    b, centers = divmod(E.shape[0], m)  # a ball elsewhere has its center in the offsets
    if centers or len({part.dim // part.offsets.size for part in parts}) > 1:
        return None
    E.eliminate_zeros()
    local = Local.of(E, b)
    entries = local.entries
    if not 0 < entries.shape[2] <= b + 1:  # more have states at rest that are no constants
        return None
    sums, sizes = entries.sum(axis=2), np.abs(entries).sum(axis=2)
    tied = (np.abs(sums) <= ROUNDING * sizes).all(axis=1)
    if not np.array_equal(np.linalg.matrix_rank(entries), np.maximum(local.counts - tied, 0)):
        return None
    return Rows(E[np.arange(m * b).reshape(m, b).T.ravel()], local, tied)


class Cones:
    """(residual, z) -> the pair of the next round; to be used by `refined`.

    Parameters
    ----------
    M : Factor
        Sparse.
    S : ConvexSet
        Any one of the family.
    tol : float
        Of the certificate.
    """

    def __init__(self, M: Factor, S: ConvexSet, tol: float) -> None:
        rows = blocks(S)
        assert rows is not None
        self._M, self._tol, self._rows, self.S, self._radii = M, tol, rows, S, radii(S)
        self._transposed = sp.csr_array(rows.E.T)
        self._sizes = abs(rows.E)
        m, b, _ = rows.local.entries.shape
        compliance = (rows.E * rows.E) @ (1 / M.diagonal)
        compliance = compliance.reshape(b, m).mean(axis=0)
        # a block of zeros, all of whose nodes are on the wall, has any
        self._weights = 1 / np.where(compliance > 0, compliance, compliance.max())
        self._energy = Energy(M.M, rows.E, [rows.local])
        self._z, self._s = np.zeros(M.dim), np.zeros((b, m))
        self._sigma, self._size = self._weights, 0.0

    def propose(self, S: ConvexSet, residual: Array, z: Array | None) -> Proposal:
        """The pair for the linear term residual - M z, from the base z."""
        g, dim = self._radii if S is self.S else radii(S), self._M.dim
        base, start, enough = z, np.zeros(dim), 0.1 * self._tol
        if base is None:
            base, start = start, self._z
            self._sigma, self._size = PENALTY * self._weights, self._M.dual_norm(residual)
            enough = max(enough, PENALTY * ROUNDING)  # of sigma E z
        else:
            # the certificate falls tenfold, with a factor of 10 it stalls at 2e-6
            self._sigma = 100 * self._sigma
        sigma, s0 = self._sigma, in_balls(self._s, g)
        rates_base = self._rates(base)
        before = 0 * s0, s0, np.zeros((1, 1, 1))

        def law(x: Array) -> tuple[Array, Any]:
            rates = x.reshape(len(s0), -1)
            v = s0 + sigma * (rates_base + rates)
            s = in_balls(v, g)

            def derivative() -> list[Array]:
                """With the multipliers that the step before expects."""
                nonlocal before
                rates_before, s_before, D = before
                steps = (D * (rates - rates_before)).sum(axis=1)
                D = self._derivative(g, v, in_balls(s_before + steps, g))
                before = rates, s, D
                return [D]

            return s.ravel(), derivative

        def converged(state: State) -> bool:
            size = max(self._size, self._M.norm(base + state.w))
            return self._M.is_within(state.R, enough * size)

        state, iterations = self._energy.minimise(residual, start, law, converged)
        self._z, self._s = base + state.w, state.s.reshape(len(s0), -1)
        creep = sigma * (rates_base + state.x.reshape(len(s0), -1))
        rigid = (row_lengths((s0 + creep).T) <= g) | (row_lengths(creep.T) <= g)
        z = self._plugs(rigid, self._z)
        at = z[self._rows.local.unknowns]
        still = (at == at[:, :1]).all(axis=1) & (self._rows.tied | (at[:, 0] == 0))
        s, gap = self._normals(g, z, still)
        self.w = w = -(self._transposed @ s)
        rounding = ROUNDING * (self._sizes.T @ np.abs(s))
        return Proposal(z, w, gap, self._M.dual_norm_bound(rounding), self._size, iterations)

    def _normals(self, g: Array, z: Array, still: Array) -> tuple[Array, float]:
        """Forces s of all blocks, and the gap <g, |E z|> - <s, E z> at most; E_k z = 0 at `still`.

        A block has its multiplier, or the normal g E z / |E z|, as the certificate asks for.
        """
        s, rates = self._s, np.where(still, 0.0, self._rates(z))
        speed = row_lengths(rates.T)
        rounding = ROUNDING * row_lengths((self._sizes @ np.abs(z)).reshape(s.shape).T)
        share = np.divide(1.0, speed, out=np.zeros_like(speed), where=speed > 0)
        normal = g * share * rates
        # of rates that are off by r: g r^2 / 2 (|v| - r) for r < |v| / 2, else 2 g r
        of_normal = 4 * g * rounding**2 * share
        # 2 g r, and g r for the rounding of both products
        of_s = np.maximum(g * speed - (s * rates).sum(axis=0), 0.0) + ~still * (3 * g * rounding)
        # |E_k^T (normal - s)|^2 in the metric of M^-1 is about |normal - s|^2 / weights
        residual = row_lengths((normal - s).T) ** 2 / self._weights
        exact = (speed > 0) & (residual + 2 * of_normal < 2 * of_s)
        return np.where(exact, normal, s).ravel(), float(np.where(exact, of_normal, of_s).sum())

    def _rates(self, z: Array) -> Array:
        """E z, a column for each block."""
        return (self._rows.E @ z).reshape(self._s.shape)

    def _derivative(self, g: Array, v: Array, s: Array) -> Array:
        """sigma where a block sticks, else sigma/|v| (g I - (s n^T + n s^T)/2) with n = v/|v|."""
        size = row_lengths(v.T)
        flows = size > g
        size = np.where(flows, size, 1.0)
        of_one = np.where(flows, g / size, 1.0) * self._sigma
        of_two = np.where(flows, 0.5 / size**2, 0.0) * self._sigma
        turned = s[:, None] * (of_two * v)
        return of_one * np.eye(len(s))[:, :, None] - turned - turned.transpose(1, 0, 2)

    def _plugs(self, rigid: Array, z: Array) -> Array:
        """z with one value, the mean, on connected rigid blocks; 0 where one of them is held."""
        unknowns, ground = self._rows.local.unknowns[rigid], self._M.dim
        first = unknowns[:, :1]
        ends = np.where(self._rows.tied[rigid, None], first, ground)
        others = np.hstack([unknowns[:, 1:], ends])
        ties = np.broadcast_to(first, others.shape).ravel(), others.ravel()
        graph = sp.csr_array((np.ones(others.size), ties), shape=(ground + 1, ground + 1))
        count, label = connected_components(graph, directed=False)
        held, label = label[-1], label[:-1]
        values = np.bincount(label, z, count) / np.maximum(np.bincount(label, minlength=count), 1)
        values[held] = 0.0
        return values[label]


def in_balls(v: Array, g: Array) -> Array:
    """The projection of each column on its ball."""
    size = row_lengths(v.T)
    return v * np.divide(g, size, out=np.ones_like(g), where=size > g)
