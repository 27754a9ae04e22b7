"""What a process really needs: looked at before the loop, and a value that prints itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sweepopt.checks import Matrix
from sweepopt.linalg import Elimination, Factor, dense
from sweepopt.process import SweepingProcess
from sweepopt.program import Velocity, VelocityProgram, closed_form, has_closed_form, rate
from sweepopt.schemes import Scheme
from sweepopt.sets import ConvexSet
from sweepopt.solvers import NEWTON, Solve, Solver, choose, newton

POLISHED = 1e-12  # relative certificates above this are polished


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
    solvers : tuple of Solver
        The chosen one, then those that repair a step it misses; empty for a linear process.
    scheme : Scheme
    tol : float
        Bound of each program's relative certificate.
    left_out : tuple of str
        What the process does not have and the run does not compute.
    contact : ndarray of int or None
        The few unknowns the set acts on, if all others are eliminated; None keeps them.
    closed_form : bool
        Whether a formula takes the place of the solver where there is one (solver "auto").
    """

    unknowns: int
    nonsmooth_unknowns: int
    solvers: tuple[Solver, ...]
    scheme: Scheme
    tol: float
    left_out: tuple[str, ...]
    contact: np.ndarray | None = None
    closed_form: bool = False

    def velocity(self, M: Matrix) -> VelocityOf:
        """Compile (q, C) -> certified velocity for one matrix; not to be shared by threads."""
        if not self.solvers:
            return self._linear(Factor(M))
        if self.contact is not None:
            return self._eliminated(Elimination(M, self.contact))
        return self._program(Factor(M))

    def _linear(self, M: Factor) -> VelocityOf:
        """C is a point c: M z = c - q."""

        def solve(q: np.ndarray, C: ConvexSet) -> Solved:
            force = C.anchor - q
            z = M.solve(force)
            size = float(np.sqrt(abs(force @ z)))  # both |z|_M and |M^-1 q|_M
            velocity = rate(z, M.dual_norm_bound(M.M @ z - force), size, size)
            return Solved(velocity, "linear", 0, 1)

        return solve

    def _eliminated(self, M: Elimination) -> VelocityOf:
        """C = c + E^T S: the velocity of the unknowns zeta = E z solves a small program.

        N = (E M^-1 E^T)^-1, linear term N E M^-1 (q - c), set S (MATH.md section 5). From zeta the
        force w = N (zeta + E M^-1 (q - c)) gives z = M^-1 (c - q + E^T w), whose E z is zeta: z
        misses the inclusion by what zeta misses it, in the same norm, plus rounding.
        """
        small = self._program(Factor(M.N))

        def solve(q: np.ndarray, C: ConvexSet) -> Solved:
            selection = C.selection()
            assert selection is not None
            force = selection.shift - q
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
        rungs = self._ladder()
        compiled: dict[int, tuple[VelocityProgram, Solve]] = {}
        simple: ConvexSet | None = None

        def solve(q: np.ndarray, C: ConvexSet) -> Solved:
            nonlocal simple
            if simple is None or not simple.same_cone(C):
                simple = C if self.closed_form and has_closed_form(M, C) else None
            if simple is not None:
                return Solved(closed_form(M, q, C), "closed form", 0, 0)
            rest = VelocityProgram(M, C).at_rest(q, C)
            if rest is not None:
                return Solved(rest, "at rest", 0, 0)
            best = Solved(Velocity(np.zeros_like(q), np.inf, np.inf), "none", 0, len(rungs))
            for attempt, solver in enumerate(rungs, start=1):
                if attempt not in compiled or not compiled[attempt][0].cone.same_cone(C):
                    program = VelocityProgram(M, C)
                    compiled[attempt] = program, solver.compile(program)
                program, run = compiled[attempt]
                answer = run(q, C)
                velocity = program.certify(q, C, answer.z, answer.y)
                if np.isnan(velocity.relative):
                    # nothing to compare: the first answer that its solver calls solved stands
                    if "solved" in answer.status.lower() or answer.status == "optimal":
                        return Solved(velocity, solver.name, answer.iterations, attempt)
                    continue
                if velocity.relative > POLISHED and NEWTON.treats(C):
                    z, _ = newton(dense(M.M), q, C, velocity.z, NEWTON.max_iter)
                    polished = program.certify(q, C, z, answer.y)
                    velocity = min(velocity, polished, key=lambda found: found.relative)
                if velocity.relative < best.velocity.relative:
                    best = Solved(velocity, solver.name, answer.iterations, attempt)
                if best.velocity.relative <= self.tol:
                    break
            return best

        return solve

    @property
    def eliminated(self) -> int:
        """How many unknowns leave the program before it is solved."""
        return 0 if self.contact is None else self.unknowns - len(self.contact)

    def _ladder(self) -> list[Solver]:
        """The solver, its refinements, then the other solvers and theirs."""
        rungs: list[Solver] = []
        for solver in self.solvers:
            rung: Solver | None = solver
            while rung is not None:
                rungs.append(rung)
                rung = rung.refined()
        return rungs

    def __str__(self) -> str:
        solver = self.solvers[0].name if self.solvers else "linear solves, no optimiser"
        if self.closed_form and self.solvers:
            solver += ", a formula where M is diagonal"
        lines = [
            f"unknowns            {self.unknowns}",
            f"nonsmooth unknowns  {self.nonsmooth_unknowns}",
            f"eliminated          {self.eliminated}",
            f"scheme              {self.scheme.name} (order {self.scheme.order})",
            f"solver              {solver}",
            f"tolerance           {self.tol:g} (relative certificate of each program)",
        ]
        lines += [f"left out            {what}" for what in self.left_out]
        return "\n".join(lines)


def make_plan(
    process: SweepingProcess, C: ConvexSet, scheme: Scheme, solver: Any, tol: float
) -> Plan:
    """Look at the process and at one member C of its moving set."""
    left_out = []
    if process.B is None:
        left_out.append("B: there is none, velocities do not depend on history")
    if process.rate_independent:
        left_out.append("A: it is zero, the process is rate-independent")
    solvers: tuple[Solver, ...] = ()
    contact = None
    if C.singleton:
        left_out.append("optimiser: C(t) is a point, each step is one linear solve")
    else:
        selection = C.selection()
        solvers = choose(solver, C if selection is None else selection.part)
        contact = None if selection is None else selection.unknowns
    return Plan(
        process.dim,
        C.nonsmooth_dim,
        solvers,
        scheme,
        tol,
        tuple(left_out),
        contact,
        solver == "auto",
    )
