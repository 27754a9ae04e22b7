"""The velocity of one matrix A + gamma B: rest, and the method that a C(t) needs.

Where q is in C nothing moves. A point needs a linear solve, a set on few unknowns a program for
these, any other set a program for all unknowns. A program is solved by a formula where its matrix
is diagonal, else by the solvers of `cascade.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import HUGE, Array
from sweepopt.errors import IndefiniteError
from sweepopt.linalg import Elimination, Factor, is_solid
from sweepopt.sets import Box, ConvexSet, Point, Similar, exchange_matrix, same_array
from sweepopt.velocity.cascade import Cascade, by_solve, refined
from sweepopt.velocity.certificate import (
    Inclusion,
    Instance,
    Velocity,
    at_rest,
    one_unknown,
    unsolved,
)
from sweepopt.velocity.cones import Cones
from sweepopt.velocity.program import untranslated
from sweepopt.velocity.return_mapping import ReturnMapping

if TYPE_CHECKING:
    from sweepopt.checks import Matrix
    from sweepopt.problem import SweepingProcess
    from sweepopt.velocity.plan import Plan
    from sweepopt.velocity.proportional import Reduction

VelocityOf = Callable[[Array, ConvexSet], Velocity]
EVERY: Any = slice(None)


def compile_velocity(process: SweepingProcess, plan: Plan, gamma: float) -> StateVelocity:
    """(u, C) -> the velocity z with -z in N_C(A z + B (u + gamma z)), certified.

    The process is that of the unknowns which enter.
    """
    if plan.reduction is not None:
        return ReducedVelocity(plan, plan.reduction, gamma)
    return StateVelocity(plan, process.matrix(gamma), process.metric, process.A, process.B, gamma)


def compile_projection(plan: Plan, M: Factor) -> VelocityOf:
    """(q, C) -> the z with -z in N_C(M z + q), certified: M z + q is q projected on C."""
    return StateVelocity(plan, M.M, M).of_force


class StateVelocity:
    """(u, C) -> the velocity z with -z in N_C(A z + B (u + gamma z)), certified.

    What a C needs is compiled when it comes; not to be shared by threads.

    Parameters
    ----------
    plan : Plan
    M : ndarray or sparse, shape (dim, dim)
        A + gamma B, rounded.
    metric : Factor
        Of M itself, or of a matrix with its pattern.
    A, B : ndarray or sparse, shape (dim, dim), optional
    gamma : float
    """

    def __init__(
        self,
        plan: Plan,
        M: Matrix,
        metric: Factor,
        A: Matrix | None = None,
        B: Matrix | None = None,
        gamma: float = 0.0,
    ) -> None:
        self._M, self._metric, self._B, self._data = M, metric, B, (A, B, gamma)
        none = np.zeros(0, dtype=int)
        self._plan, self._contact = plan, none if plan.contact is None else plan.contact
        self._regular = True  # M, as far as is known
        data = M, metric, self._data, self._contact
        self._of_matrix = lru_cache(3)(partial(_new_inclusion, *data))  # all, few, the last M + H
        self._tol = plan.tol if math.isfinite(plan.tol) else 1e-6  # where all is welcome
        # of certificates: unproved, what a velocity misses shows in the trajectory's residual
        self._limit = self._tol if plan.proved else HUGE
        self.forget()

    def forget(self) -> None:
        """Drop what solvers remember of earlier calls; the factorisations stay."""
        self._cascade: Cascade | None = None
        self._mapping: tuple[Inclusion, ReturnMapping] | None = None
        self._cones: Cones | None = None
        self._one = lru_cache(1)(one_unknown)
        self._set: tuple[ConvexSet, ConvexSet] | None = None

    def __call__(self, u: Array, C: ConvexSet) -> Velocity:
        if u.size == 1 and self._plan.solver == "auto":
            c, S = untranslated(C)
            if isinstance(S, Box) and not S.singleton:
                formula = self._one(self._of_matrix(False), S, self._tol)
                velocity = formula(float(u[0]), float(c[0]))
                if velocity is not None:
                    return velocity
        if self._B is None:
            return self.of_force(np.zeros_like(u), C)
        return self.of_force(self._B.dot(u), C, u)

    def norm(self, z: Array) -> float:
        """|z|_M."""
        return math.sqrt(max(z.dot(self._M.dot(z)), 0.0))

    def of_force(self, q: Array, C: ConvexSet, u: Array | None = None) -> Velocity:
        """The z with -z in N_C(M z + q); u has q = B u, without it M and q are taken as exact."""
        if C.singleton:
            of, inclusion = Instance(q - C.anchor, q, C.anchor, C, u), self._of_matrix(False)
            velocity = refined(inclusion, by_solve(inclusion.M), of, self._tol)
            return velocity._replace(solver="linear", attempts=1)
        c, S = untranslated(C)
        selection, few = S.selection, EVERY
        if selection is not None and same_array(selection.unknowns, self._contact):
            of_part, part = untranslated(selection.part)
            shifted = c.copy() if selection.shift is None else c + selection.shift
            shifted[self._contact] += of_part
            if not self._plan.condensed:
                few, c, S = self._contact, shifted, part
            else:
                mapped = self._by_return_mapping(
                    Instance(q - shifted, q, shifted, part, u, self._contact)
                )
                if mapped is not None and mapped.relative <= self._limit:
                    return mapped
        if self._set is None or self._set[0] is not S:
            self._set = S, S.copy_for_run(self._set and self._set[1])
        S = self._set[1]
        of = Instance(q - c, q, c, S, u, few)
        inclusion = self._inclusion(of, few is not EVERY)
        best = self._by_cones(of) if self._plan.cones else unsolved(of)
        if best.relative <= self._limit:
            return best
        if self._cascade is None or not self._cascade.serves(inclusion, S):
            data, anew = (inclusion, self._plan.solver, of, self._tol), self._cascade is not None
            self._cascade = Cascade(*data, self._plan.proved, anew)
        velocity = self._cascade(of)
        return best if best.relative < velocity.relative else velocity

    def _by_return_mapping(self, of: Instance) -> Velocity | None:
        """By return mapping, and certified; None where alpha' = |p'| is not certain."""
        if not of.S.exchanges(of.force[self._contact]):
            return None
        if self._mapping is None:
            inclusion = self._with_exchange(of)
            mapping = ReturnMapping(inclusion.M, self._contact, of.S, self._tol)
            self._mapping = inclusion, mapping
        inclusion, mapping = self._mapping
        if inclusion.rests(of, self._tol):
            return at_rest(of.q)
        velocity = refined(inclusion, partial(mapping.propose, of.S), of, self._limit)
        return velocity._replace(solver="return mapping", attempts=1)

    def _by_cones(self, of: Instance) -> Velocity:
        """By the method of multipliers, and certified."""
        inclusion = self._of_matrix(False)
        if self._cones is None or not (self._cones.S is of.S or self._cones.S.same_cone(of.S)):
            self._cones = Cones(inclusion.M, of.S, self._tol)
        velocity = refined(inclusion, partial(self._cones.propose, of.S), of, self._tol)
        return velocity._replace(solver="cones", attempts=1, w=self._cones.w + of.c)

    def _inclusion(self, of: Instance, few: bool) -> Inclusion:
        """Of M; of M + H where M is singular and the set exchanges stiffness."""
        if self._regular:
            with suppress(IndefiniteError):
                return self._of_matrix(few)
            self._regular = False
        return self._with_exchange(of, few)

    def _with_exchange(self, of: Instance, few: bool = False) -> Inclusion:
        """Of M + H, H the stiffness that the set exchanges; of M where there is none."""
        H = exchange_matrix(self._M, of.S, of.unknowns, of.force)
        return self._of_matrix(few) if H is None else self._of_matrix(few, H.diagonal().tobytes())


def _new_inclusion(
    M: Matrix,
    metric: Factor,
    data: tuple[Any, Any, float],
    contact: Array,
    few: bool,
    exchange: bytes = b"",
) -> Inclusion:
    """Of M, or of M + H for the diagonal of H."""
    A, B, gamma = data
    if exchange:
        H = sp.diags_array(np.frombuffer(exchange))
        M, A = M + H, None if A is None else A + H
    if few:
        return Inclusion(Elimination(M, contact, metric.order), A, B, gamma)
    if metric.M is not M:
        if sp.issparse(M) and is_solid(M):  # of 107,855 unknowns factors take 0.9 GB
            metric.forget()
        metric = Factor(M, order=metric.order)
    return Inclusion(metric, A, B, gamma)


class ReducedVelocity(StateVelocity):
    """The same for the process of a `Reduction`: a program for the contact, quotients beside it.

    Its certificate is that of all unknowns.
    """

    def __init__(self, plan: Plan, reduction: Reduction, gamma: float) -> None:
        rho, N = reduction.rho, reduction.metric
        B = rho * N.M if rho else None
        M = N.M if B is None or not gamma else N.M + gamma * B
        super().__init__(replace(plan, contact=None, reduction=None), M, N, N.M, B, gamma)
        self._reduction, self._gamma = reduction, gamma

    def __call__(self, y: Array, C: ConvexSet) -> Velocity:
        few, rho, gamma = self._reduction.few, self._reduction.rho, self._gamma
        on_contact: ConvexSet
        c, S = untranslated(C)
        if C.singleton:  # shrunk to a point
            c, on_contact = C.anchor, Point(C.anchor[:few])
        elif (selection := S.selection) is not None:
            on_contact = Similar(selection.part, c[:few])
        velocity = super().__call__(y[:few], on_contact)
        rates = (c[few:] - rho * y[few:]) / (1 + gamma * rho)
        velocity = velocity._replace(z=np.concatenate([velocity.z, rates]))
        return self._reduction.certified(gamma, y, velocity) if self._plan.proved else velocity
