"""What a process really needs: looked at before the loop, and a value that prints itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from sweepopt.checks import Matrix
from sweepopt.errors import InputError, SolverRefusedError
from sweepopt.linalg import Elimination, Factor
from sweepopt.process import SweepingProcess
from sweepopt.program import (
    POLISHED,
    Velocity,
    VelocityProgram,
    closed_form,
    has_closed_form,
    rate,
)
from sweepopt.reduction import Reduction, reduce
from sweepopt.schemes import Scheme
from sweepopt.sets import ConvexSet
from sweepopt.sets.base import Selection, same_array
from sweepopt.solvers import Answer, Solve, Solver, choose
from sweepopt.solvers.polish import Polish, polisher

PATHS = {
    "auto": "the first that applies",
    "proportional": "the contact alone, the other unknowns are recovered when asked for",
    "eliminated": "a program for the contact, two substitutions for the others",
    "full": "a program for all unknowns",
}
SOLVED = {"Solved", "solved", "optimal"}  # how Clarabel, OSQP and cvxpy call it


@dataclass(frozen=True)
class Solved:
    """A velocity, who found it and what was tried before."""

    velocity: Velocity
    solver: str
    iterations: int
    attempts: int


VelocityOf = Callable[[np.ndarray, ConvexSet], Solved]


@dataclass(frozen=True, eq=False)
class Plan:
    """How a process is simulated.

    Attributes
    ----------
    unknowns : int
    nonsmooth_unknowns : int
        How many of them the set acts on; 0 means linear solves only.
    solver : str or Solver
        The user's choice.
    solvers : tuple of Solver
        What it means for this set: the first one solves, the others repair a step it misses; empty
        for a linear process.
    scheme : Scheme
    tol : float
        Bound of each program's relative certificate.
    left_out : tuple of str
        What the process does not have and the run does not compute.
    contact : ndarray of int or None
        The few unknowns the set acts on, if all others are eliminated; None keeps them.
    reduction : Reduction or None
        The process of the contact alone, if the material and the load are proportional.
    order : ndarray of int or None
        An order of the unknowns with little fill, for elimination.
    """

    unknowns: int
    nonsmooth_unknowns: int
    solver: Any
    solvers: tuple[Solver, ...]
    scheme: Scheme
    tol: float
    left_out: tuple[str, ...]
    contact: np.ndarray | None = None
    reduction: Reduction | None = None
    order: np.ndarray | None = None

    @property
    def path(self) -> str:
        """Which unknowns enter a step."""
        if self.reduction is not None:
            return "proportional"
        if not self.solvers:
            return "linear"
        return "full" if self.contact is None else "eliminated"

    @property
    def entering(self) -> int:
        """How many unknowns enter a step and are kept of it."""
        return self.unknowns if self.reduction is None else self.reduction.process.dim

    @property
    def of_entering(self) -> Plan:
        """The plan of the process that the loop moves: the reduction's, if there is one."""
        if self.reduction is None:
            return self
        return replace(self, unknowns=self.entering, contact=None, reduction=None)

    @property
    def of_coefficients(self) -> Plan:
        """The plan of the reduction's linear process: a diagonal one, exact to rounding."""
        return replace(self, solvers=(), contact=None, reduction=None, tol=POLISHED)

    @property
    def eliminated(self) -> int:
        """How many unknowns leave the program before it is solved."""
        return 0 if self.contact is None else self.unknowns - len(self.contact)

    def velocity(self, M: Matrix) -> VelocityOf:
        """Compile (q, C) -> certified velocity for one matrix; not to be shared by threads.

        Each C is looked at again: a point needs a linear solve only, a set on the contact unknowns
        a small program, any other set the full one. What a C needs is compiled when it comes.
        """
        contact = np.zeros(0, dtype=int) if self.contact is None else self.contact
        linear = cache(lambda: self._linear(Factor(M)))
        program = cache(lambda: self._program(Factor(M)))
        eliminated = cache(lambda: self._eliminated(Elimination(M, contact, self.order)))

        def solve(q: np.ndarray, C: ConvexSet) -> Solved:
            if C.singleton:
                return linear()(q, C)
            selection = C.selection if contact.size else None
            if selection is None or not same_array(selection.unknowns, contact):
                return program()(q, C)
            return eliminated()(q, selection)

        return solve

    def _linear(self, M: Factor) -> VelocityOf:
        """C is a point c: M z = c - q."""

        def solve(q: np.ndarray, C: ConvexSet) -> Solved:
            force = C.anchor - q
            z = M.solve(force)
            size = float(np.sqrt(abs(force @ z)))  # both |z|_M and |M^-1 q|_M
            velocity = rate(z, M.dual_norm_bound(M.M @ z - force), size, size)
            return Solved(velocity, "linear", 0, 1)

        return solve

    def _eliminated(self, M: Elimination) -> Callable[[np.ndarray, Selection], Solved]:
        """C = c + E^T S: the velocity of the unknowns zeta = E z solves a small program.

        N = (E M^-1 E^T)^-1, linear term N E M^-1 (q - c), set S (MATH.md section 5). From zeta the
        force w = N (zeta + E M^-1 (q - c)) gives z = M^-1 (c - q + E^T w), whose E z is zeta: z
        misses the inclusion by what zeta misses it, in the same norm, plus rounding.
        """
        small = self._program(Factor(M.N))

        def solve(q: np.ndarray, selection: Selection) -> Solved:
            force = -q if selection.shift is None else selection.shift - q
            forward, pull = M.reduce(force)
            size_q = float(np.linalg.norm(forward))
            solved = small(-pull, selection.part)
            zeta = solved.velocity.z
            total = M.N @ zeta
            z = M.recover(forward, total)
            z[M.unknowns] = zeta  # to the last bit: stuck is 0.0
            force[M.unknowns] += total - pull
            rounding = M.dual_norm_bound(M.M @ z - force)
            size_z = float(np.sqrt(abs(force @ z)))
            certificate = solved.velocity.certificate + rounding
            return replace(solved, velocity=rate(z, certificate, size_z, size_q))

        return solve

    def _program(self, M: Factor) -> VelocityOf:
        """One cone at a time: its formula if there is one, else its compiled ladder of solvers."""
        program: VelocityProgram | None = None
        formula = False
        rungs: list[Solver] = []
        compiled: dict[int, Solve] = {}
        judge = _judge(cache(lambda: polisher(M, self.order)))

        def solve(q: np.ndarray, C: ConvexSet) -> Solved:
            nonlocal program, formula, rungs
            if program is None or not program.cone.same_cone(C):
                program = VelocityProgram(M, C)
                formula = self.solver == "auto" and has_closed_form(M, C)
                rungs = ladder(choose(self.solver, C))
                compiled.clear()
            if formula:
                return Solved(closed_form(M, q, C), "closed form", 0, 0)
            rest = program.at_rest(q, C)
            if rest is not None:
                return Solved(rest, "at rest", 0, 0)
            best = Solved(Velocity(np.zeros_like(q), np.inf, np.inf), "none", 0, 0)
            for attempt, solver in enumerate(rungs):
                if attempt not in compiled:
                    compiled[attempt] = solver.compile(program)
                answer = compiled[attempt](q, C)
                if not C.certifiable:
                    # nothing to compare: the first answer that its solver calls solved stands
                    if answer.status in SOLVED:
                        velocity = program.certify(q, C, answer.z, answer.y)
                        return Solved(velocity, solver.name, answer.iterations, attempt + 1)
                    continue
                velocity = judge(program, q, C, answer)
                found = Solved(velocity, solver.name, answer.iterations, attempt + 1)
                if found.velocity.relative < best.velocity.relative:
                    best = found
                if best.velocity.relative <= self.tol:
                    break
            return replace(best, attempts=attempt + 1)

        return solve

    def __str__(self) -> str:
        solver = self.solvers[0].name if self.solvers else "linear solves, no optimiser"
        if self.solver == "auto" and self.solvers:
            solver += ", a formula where M is diagonal"
        lines = [
            f"path                {self.path}: {PATHS.get(self.path, 'a linear solve a step')}",
            f"unknowns            {self.unknowns}",
            f"nonsmooth unknowns  {self.nonsmooth_unknowns}",
            f"eliminated          {self.eliminated}",
            f"scheme              {self.scheme.name} (order {self.scheme.order})",
            f"solver              {solver}",
            f"tolerance           {self.tol:g} (relative certificate of each program)",
        ]
        lines += [f"left out            {what}" for what in self.left_out]
        return "\n".join(lines)


def _judge(
    polish: Callable[[], Polish],
) -> Callable[[VelocityProgram, np.ndarray, ConvexSet, Answer], Velocity]:
    """Certify an answer, polished if that is better; who needed it last is polished at once."""
    needed = False

    def judge(program: VelocityProgram, q: np.ndarray, C: ConvexSet, answer: Answer) -> Velocity:
        nonlocal needed
        raw = None if needed else program.certify(q, C, answer.z, answer.y)
        if raw is not None and raw.relative <= POLISHED:
            return raw
        z = polish()(q, C, answer.z)
        better = None if z is None else program.certify(q, C, z, answer.y)
        needed = better is not None and better.relative <= POLISHED
        if better is not None and needed:
            return better
        raw = raw or program.certify(q, C, answer.z, answer.y)
        return raw if better is None or raw.relative <= better.relative else better

    return judge


def make_plan(
    process: SweepingProcess,
    members: Sequence[tuple[float, ConvexSet]],
    scheme: Scheme,
    solver: Any,
    tol: float,
    path: str = "auto",
) -> Plan:
    """Look at the process and at its sets.

    Parameters
    ----------
    members : sequence of (t, C(t))
        One for each cone that C takes on the grid, as `SweepingProcess.check` returns them.
    path : str
        One of PATHS, or "auto" for the first that applies.

    Raises
    ------
    InputError
        If the path does not apply.
    SolverRefusedError
        If the solver is not known or cannot treat one of the sets.
    """
    left_out = []
    if process.B is None:
        left_out.append("B: there is none, velocities do not depend on history")
    if process.rate_independent:
        left_out.append("A: it is zero, the process is rate-independent")
    solvers: tuple[Solver, ...] = ()
    contacts: list[np.ndarray] = []
    for t, C in members:
        selection = None if path == "full" else C.selection
        try:
            chosen = choose(solver, C if selection is None else selection.part)
        except SolverRefusedError as error:
            raise SolverRefusedError(f"{error} (C(t) at t = {t:g})") from error
        if not C.singleton:
            solvers = solvers or chosen
            contacts.append(np.arange(C.dim) if selection is None else selection.unknowns)
    if not solvers:
        left_out.append("optimiser: C(t) is a point, each step is one linear solve")
    few = bool(contacts) and contacts[0].size < process.dim
    same = all(np.array_equal(contact, contacts[0]) for contact in contacts)
    contact = contacts[0] if few and same else None
    if path in ("eliminated", "proportional") and contact is None:
        raise InputError(
            f"path={path!r} needs a C(t) that acts on the same few unknowns at all times: write it "
            "as so.image(E^T, S) with E selecting them"
        )
    reduced: Reduction | str = "the unknowns shall be kept"
    if path in ("auto", "proportional") and contact is not None:
        reduced = reduce(process)
    if path == "proportional" and isinstance(reduced, str):
        raise InputError(f"path='proportional' does not apply: {reduced}")
    return Plan(
        unknowns=process.dim,
        nonsmooth_unknowns=max(C.nonsmooth_dim for _, C in members),
        solver=solver,
        solvers=solvers,
        scheme=scheme,
        tol=tol,
        left_out=tuple(left_out),
        contact=contact,
        order=process.metric.order,
        reduction=None if isinstance(reduced, str) else reduced,
    )


def ladder(solvers: Sequence[Solver]) -> list[Solver]:
    """The first solver, its refinements, then the other solvers and theirs."""
    rungs: list[Solver] = []
    for solver in solvers:
        rung: Solver | None = solver
        while rung is not None:
            rungs.append(rung)
            rung = rung.refined()
    return rungs
