"""What a process really needs: looked at before the loop, and a value that prints itself."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import field
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import Array
from sweepopt.display import Displayed, Rows, record
from sweepopt.errors import PathError, SolverRefusedError
from sweepopt.linalg import factor_bytes, is_diagonal
from sweepopt.problem import SweepingProcess
from sweepopt.sets import ConvexSet
from sweepopt.velocity.cones import blocks
from sweepopt.velocity.program import untranslated
from sweepopt.velocity.proportional import Reduction, reduce
from sweepopt.velocity.return_mapping import condensable
from sweepopt.velocity.solvers import NEWTON, Small, Solver, choose

if TYPE_CHECKING:
    from sweepopt.integrate import Scheme

PATHS = {
    "auto": "the first that applies",
    "proportional": "the contact alone, the other unknowns are recovered when asked for",
    "eliminated": "a program for the contact, two substitutions for the others",
    "return mapping": "a formula for the internal variables at each point, Newton for the others",
    "cones": "multipliers of balls on many combinations of the unknowns, one value for each plug",
    "full": "a program for all unknowns",
}

Members = Sequence[tuple[float, ConvexSet]]  # times, and C(t) at them


@record
class Plan(Displayed):
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
    condensed : bool
        Whether `contact` are internal variables that leave the program, not the ones that it keeps.
    cones : bool
        Whether the set is one of balls on many sparse combinations of the unknowns.
    contraction : float
        Of a C(t, u): the largest factor by which fixed-point iteration brings the velocity of a
        stage closer to that of its own state; 0 where nothing is iterated.
    proved : bool
        Whether velocities are certified and refined; where not, a solver's first normal pair is
        taken: for trajectories whose residual is bounded as a whole.
    breakpoints : ndarray
        Those of the load inside of steps, which are taken in parts that end there.
    """

    unknowns: int
    nonsmooth_unknowns: int
    solver: Any
    solvers: tuple[Solver, ...]
    scheme: Scheme
    tol: float
    left_out: tuple[str, ...]
    contact: Array | None
    reduction: Reduction | None
    condensed: bool
    cones: bool
    contraction: float = 0.0
    proved: bool = True
    breakpoints: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def path(self) -> str:
        """Which unknowns enter a step."""
        if self.reduction is not None:
            return "proportional"
        if not self.solvers:
            return "linear"
        if self.condensed:
            return "return mapping"
        if self.cones:
            return "cones"
        return "full" if self.contact is None else "eliminated"

    @property
    def entering(self) -> int:
        """How many unknowns enter a step and are kept of it."""
        return self.unknowns if self.reduction is None else self.reduction.process.dim

    def process_of(self, process: SweepingProcess) -> SweepingProcess:
        """The process of the unknowns that enter, which the loop moves."""
        return process if self.reduction is None else self.reduction.process

    def state(self, y: Array) -> Array:
        """All unknowns of states, shape (dim,) or in rows, from those that enter."""
        return y if self.reduction is None else self.reduction.state(y)

    def velocity(self, y: Array) -> Array:
        """The same of velocities."""
        return y if self.reduction is None else self.reduction.velocity(y)

    @property
    def eliminated(self) -> int:
        """How many unknowns leave the program before it is solved."""
        if self.contact is None:
            return 0
        return len(self.contact) if self.condensed else self.unknowns - len(self.contact)

    def _rows(self) -> Rows:
        solver = self.solvers[0].name if self.solvers else "linear solves, no optimiser"
        if self.solver == "auto" and self.solvers:
            solver += ", closed form where M is diagonal"
        if self.condensed:
            solver = "return mapping, Newton's method with the consistent tangent"
        if self.cones:
            solver = "method of multipliers, Newton's method for each round"
        if self.scheme.exact:
            solver = "closed forms between the switches, which are located"
        order = "" if self.scheme.exact else f" (order {self.scheme.order})"
        reason = f": {self.scheme.reason}" if self.scheme.reason else ""
        yield "path", f"{self.path}: {PATHS.get(self.path, 'a linear solve a step')}"
        yield "unknowns", self.unknowns
        yield "nonsmooth unknowns", self.nonsmooth_unknowns
        yield "eliminated", self.eliminated
        yield "scheme", f"{self.scheme.name}{order}{reason}"
        yield "solver", solver
        yield "tolerance", f"{self.tol:g} (relative certificate of each program)"
        if self.contraction:
            yield "fixed point", f"C(t, u), iterated; contraction {self.contraction:.2g}"
        if self.breakpoints.size:
            inside = "of the load lie inside of steps, which are taken in parts that end there"
            yield "breakpoints", f"{self.breakpoints.size} {inside}"
        for what in self.left_out:
            yield "left out", what


def make_plan(
    process: SweepingProcess,
    members: Members,
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
    PathError
        If the path does not apply.
    SolverRefusedError
        If the solver is not known or cannot treat one of the sets.
    """
    solvers, contact = _solvers(process.dim, members, solver, path, tol)
    if path in ("eliminated", "proportional") and contact is None:
        raise PathError(
            f"path={path!r} needs a C(t) that acts on the same few unknowns at all times: write it "
            "as so.image(E^T, S) with E selecting them"
        )
    cones = solver == "auto" and not scheme.exact and _has_cones(process, members, contact, path)
    reduced: Reduction | str = "the unknowns shall be kept"
    if path in ("auto", "proportional") and contact is not None and not cones:
        reduced = reduce(process, tol, members[0][0])
    reduction = None if isinstance(reduced, str) else reduced
    if path == "proportional" and reduction is None:
        raise PathError(f"path='proportional' does not apply: {reduced}")
    condensed = False
    if scheme.exact and reduction is None:
        contact = None  # the closed form has all unknowns in it
    elif reduction is None and solver == "auto" and path in ("auto", "return mapping"):
        condensed = _condenses(process, members, contact, path)
    if path == "return mapping" and not condensed:
        raise PathError(
            "path='return mapping' needs C(t) = f(t) + E^T S with S a box, balls or cones, E "
            "selecting unknowns on which A and B are diagonal, and constant on each ball, and "
            'solver="auto"'
        )
    if path == "cones" and not cones:
        raise PathError(
            "path='cones' needs C(t) = f(t) + E^T S with S balls of one dimension around 0 and E "
            "sparse, E_k z = 0 only where z is constant, or 0, on the unknowns of block k; sparse "
            'A and B, a scheme that is not exact and solver="auto"'
        )
    cones = cones and not condensed
    return Plan(
        unknowns=process.dim,
        nonsmooth_unknowns=max(C.nonsmooth_dim for _, C in members),
        solver=solver,
        solvers=solvers,
        scheme=scheme,
        tol=tol,
        left_out=tuple(_left_out(process, solvers, all(C.certifiable for _, C in members))),
        contact=None if cones else contact,
        reduction=reduction,
        condensed=condensed,
        cones=cones,
    )


def _has_cones(
    process: SweepingProcess,
    members: Members,
    contact: Array | None,
    path: str,
) -> bool:
    """Whether the sets are balls on sparse combinations of unknowns, and too many for other ways.

    Those are a dense program of few unknowns and the formula for a diagonal M. Clarabel is none: on
    7 to 169 unknowns of a pipe it takes 5 to 24 times as long, and its plugs are not exactly rigid.
    """
    metric, sets = process.metric, [untranslated(C).S for _, C in members if not C.singleton]
    finite = Small.max_dim * all(S.polyhedral for S in sets)  # by a finite method
    most = finite if contact is None else NEWTON.max_dim
    size = process.dim if contact is None else contact.size
    if path not in ("auto", "cones") or not sp.issparse(metric.M) or not metric.has_factors:
        return False
    diagonal = all(is_diagonal(M) for M in (process.A, process.B) if M is not None)
    formula = diagonal and all(S.exact for S in sets)
    if path == "auto" and (size <= most or formula):
        return False
    return bool(sets) and all(blocks(S) is not None for S in sets)


def _condenses(
    process: SweepingProcess,
    members: Members,
    contact: Array | None,
    path: str,
) -> bool:
    """Whether the unknowns of the sets are condensed point by point.

    Where they are fewer than the others, and few enough for Newton's method, the dense program
    that eliminates the others is the smaller one.
    """
    if contact is None or not sp.issparse(process.metric.M) or not process.metric.has_factors:
        return False
    if path == "auto" and contact.size <= min(process.dim - contact.size, NEWTON.max_dim):
        return False
    selections = [C.selection for _, C in members]
    return all(
        selection is not None and condensable(M, contact, selection.part)
        for selection in selections
        for M in (process.A, process.B)
        if M is not None
    )


def _solvers(
    dim: int, members: Members, solver: Any, path: str, tol: float
) -> tuple[tuple[Solver, ...], Array | None]:
    """Who solves for the sets, and the few unknowns that all of them act on, if there are such."""
    solvers: tuple[Solver, ...] = ()
    contacts: list[Array] = []
    for t, C in members:
        selection = None if path == "full" else C.selection
        try:
            chosen = choose(solver, C if selection is None else selection.part, tol)
        except SolverRefusedError as error:
            if t == members[0][0]:  # of no later set, or of a name that is not known
                raise
            raise SolverRefusedError(f"{error} (C(t) at t = {t:g})") from None
        if not C.singleton:
            solvers = solvers or chosen
            contacts.append(np.arange(dim) if selection is None else selection.unknowns)
    same = all(np.array_equal(contact, contacts[0]) for contact in contacts)
    return solvers, contacts[0] if contacts and same and contacts[0].size < dim else None


def _left_out(
    process: SweepingProcess, solvers: tuple[Solver, ...], certifiable: bool
) -> Iterator[str]:
    """What the process does not have."""
    if not certifiable:
        yield "certificates: C(t) proves no answer, the run ends as uncertified"
    if process.B is None:
        yield "B: there is none, velocities do not depend on history"
    if process.rate_independent:
        yield "A: it is zero, the process is rate-independent"
    if not process.metric.has_factors:
        size = factor_bytes(process.metric.M) / 1e9
        yield f"factors: they would need {size:.3g} GB; conjugate gradients take their place"
    if not solvers:
        yield "optimiser: C(t) is a point, each step is one linear solve"
