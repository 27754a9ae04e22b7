"""The two problems of the theory and how they are one.

Sweeping process:  -u'(t) in N_{C(t)}(A u'(t) + B u(t)),  u(0) = u0.
Evolution variational inequality: u'(t) in K with
<A u' + B u - f, v - u'> + J(v) - J(u') >= 0 for all v in K.
With D = dJ(0) + polar(K) they are the same for C(t) = f(t) - D (Adly and Haddad, SIAM J. Math.
Anal. 50(1), 2018, Proposition in section 4). The assumptions of the theory are checked here, before
any solver runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple

import numpy as np
import scipy.sparse as sp

from sweepopt.checks import (
    Array,
    Matrix,
    agree,
    at_path,
    axes,
    entries,
    increasing,
    meaning,
    number,
    read_only,
    symmetric,
    takes,
    vector,
)
from sweepopt.display import Displayed, Rows, arguments, brief
from sweepopt.errors import (
    IndefiniteError,
    InitialStateWarning,
    InputError,
    SweepoptWarning,
    VariationWarning,
    shown,
    warn,
)
from sweepopt.linalg import EPS, Factor, kernel, largest_ratio, require_semidefinite
from sweepopt.problem.motion import Variation, jumps, variation
from sweepopt.sets import (
    ROUNDING,
    AnySet,
    ConvexSet,
    Moving,
    MovingSet,
    Point,
    StateDependent,
    check_features,
    exchange_matrix,
    image,
    kind_without_certificate,
)

Nearest = Callable[[Array, ConvexSet], Array]
LOOSE = 64 * EPS  # share of a row's entries that assembly rounds in their sum
NOT_HELD = (
    "A and B let the body move as a whole: A u = B u = 0 for one u other than 0 (their common "
    "kernel), whose size nothing determines. Clamp a part of the body, or of each piece (leave "
    "these unknowns out of A and B), or give a foundation or dashpot. A bounded C(t) is not "
    "enough, as it leaves the velocity open on its faces: give a little elasticity to an element "
    "without any"
)
MANY = 1000
"""Unknowns of dense matrices that are worth a warning: steps of 4,000 take 1.7 s, sparse 3 ms."""


class VelocityBound(NamedTuple):
    """An a priori bound of |u'(t)|_A on [0, T] and what it is made of.

    Attributes
    ----------
    value : float
    variation : float
        v(T) of C, in |.|_{A^-1}.
    distance : float
        At least that of B u0 to C(0), in |.|_{A^-1}.
    guaranteed : bool
        Whether v(T) is, as `Variation` says.
    """

    value: float
    variation: float
    distance: float
    guaranteed: bool


@meaning(
    load="; C(t) = f(t) - D: give C, or take EvolutionVI, which has load and dissipation",
    dissipation="; take EvolutionVI, which has load and dissipation",
    K="; a stiffness is B; a cone of velocities is cone=K of EvolutionVI",
    x0="; the start is u0",
)
class SweepingProcess(Displayed):
    """-u'(t) in N_{C(t)}(A u'(t) + B u(t)),  u(0) = u0.

    Parameters
    ----------
    A : array_like or sparse, shape (dim, dim), or None
        Symmetric positive semidefinite, a number for one unknown; None or 0 is A = 0. Where it is
        singular, as for bodies that are elastic in parts, u0 must be compatible:
        `compatible_start` computes one that is.
    B : array_like or sparse, shape (dim, dim), or None
        Symmetric positive semidefinite; None or 0 leaves it out. A and B have no common kernel.
    C : ConvexSet, MovingSet or callable
        The constraint set, of dimension dim, or a function of t that returns it. A `StateDependent`
        one makes the problem quasi-variational: the constraint is C(t, u(t)).
    u0 : array_like, shape (dim,)
        A number for one unknown.
    fields : dict of str to slice, optional
        Names of parts of u, ``{"u": slice(0, 8), "p": slice(8, 12)}``, for `Solution.field`.

    Raises
    ------
    InputError
        If a shape, an entry or an assumption of the theory is wrong.

    Notes
    -----
    `metric` has the norms of the theory: A, or A + tau B where A is singular, with the longest time
    tau = A_ii / B_ii of an unknown; B itself where A = 0 (MATH.md section 1).

    Examples
    --------
    >>> from sweepopt.sets import Box, Moving
    >>> C = Moving(Box(-1, 1), center=lambda t: 1.5 * t)
    >>> process = SweepingProcess(A=0.5, B=2.0, C=C, u0=0.0)
    >>> round(process.beta, 12)
    0.5
    """

    time_scale = 0.0
    moved = False  # whether a body's boundaries are moved by data, whose work is in no load
    unknowns_digest = ""  # a checksum of what they are, where it is known; files of runs hold it
    _instead: ClassVar = {"solve": "it is a function, so.solve(process, t_end=1.0, steps=100)"}

    def __init__(
        self, A: Any, B: Any, C: AnySet, u0: Any, fields: dict[str, slice] | None = None
    ) -> None:
        self.A, self.B, sizes = _matrices(A, B)
        if callable(C) and not isinstance(C, (type, MovingSet)):
            takes(
                "C", C, "t", remedy="; one of t and u is given as so.StateDependent(C, lipschitz)"
            )
            C = MovingSet(C)
        if not isinstance(C, (ConvexSet, MovingSet)):
            raise InputError(
                f"C must be a set or a moving set, got {shown(C)}; an interval is so.Box(-1, 1), "
                "one that moves so.Moving(so.Box(-1, 1), center=f), sets of some unknowns each "
                "so.product(*sets), and any C(t) that a function returns so.MovingSet(function)"
            )
        self.u0 = entries("u0", u0)
        agree(**sizes, C=C.dim, u0=self.u0.size)
        self.dim = self.u0.size
        self.C = C.of(self.u0) if isinstance(C, StateDependent) else C
        self.fields = _valid_fields(fields or {}, self.dim)
        self.rate_independent = bool(abs(self.A).max() == 0)
        self._require_held(np.ones(self.dim))
        if self.B is not None:
            require_semidefinite("B", self.B)
        try:
            self.metric = Factor(self.A, "A")
        except IndefiniteError as error:
            require_semidefinite("A", self.A)
            if self.B is None:
                raise IndefiniteError(
                    f"{error}; A may be singular only where B is positive, and B is 0"
                ) from None
            self._set_weak_metric(self.B)
        u = self.metric.solve(np.ones(self.dim))  # near a null vector, if there is one
        # then M u is not the load: off by 2 or more in 108 such matrices, 0 on a spring of 1e-11
        if abs(self.metric.M @ u - 1).max() > 1:
            self._require_held(u)
        self.coercive = self.time_scale == 0.0

    def _rows(self) -> Rows:
        yield type(self).__name__, f"dim {self.dim}, {'sparse' if sp.issparse(self.A) else 'dense'}"
        parts = ((name, getattr(self, name, None)) for name in arguments(self))
        yield from ((name, brief(x)) for name, x in parts if x is not None and name != "fields")

    def _picture(self) -> str:
        return self.C._picture()

    def _set_weak_metric(self, B: Matrix) -> None:
        """The metric A + tau B of a singular A: tau is the longest time that the diagonals show."""
        a, b = self.A.diagonal(), B.diagonal()
        times = a[b > 0] / b[b > 0]
        self.time_scale = float(times.max(initial=0.0)) or 1.0
        M = B if self.rate_independent else self.A + self.time_scale * B
        try:
            self.metric = Factor(M, "A + tau B")
        except IndefiniteError:
            C = self.C.shape if isinstance(self.C, Moving) else self.C.at(0.0)
            # isotropic hardening alone bounds p by alpha' >= |p'|
            if (H := exchange_matrix(M, C)) is not None:
                self.metric = Factor(M + H, "A + tau B")
                return
            raise IndefiniteError(NOT_HELD) from None

    def _require_held(self, u: Array) -> None:
        """Refuse A and B that both map u to rounding, or the piece of the body that moves most."""
        u = np.where(abs(u) > np.sqrt(EPS) * abs(u).max(), u, 0.0)
        given = [M for M in (self.A, self.B) if M is not None]
        if all((abs(M @ u) <= LOOSE * (abs(M) @ abs(u))).all() for M in given):
            raise IndefiniteError(NOT_HELD)

    def as_sweeping(self) -> SweepingProcess:
        """The process itself; for an `EvolutionVI` C(t) = f(t) - (D + the polar cone of K)."""
        return self

    def as_vi(self) -> EvolutionVI:
        """The variational inequality with f(t) = center(t) and D = -shape, for translated sets.

        Raises
        ------
        InputError
            If C(t) is not written as a translate of one set.
        """
        if isinstance(self.C, ConvexSet):
            shape, load = self.C, None
        elif isinstance(self.C, Moving) and self.C.scale is None:
            shape, load = self.C.shape, self.C.center
        else:
            raise InputError("only C(t) = center(t) + shape (Moving without scale) is a VI")
        return EvolutionVI(self.A, self.B, load=load, dissipation=-shape, u0=self.u0)

    @cached_property
    def beta(self) -> float:
        """The constant of coercivity <Ax, x> >= beta |x|^2; 0 where A is singular."""
        return self.metric.smallest_eigenvalue if self.coercive else 0.0

    @cached_property
    def Lam(self) -> float:
        """A bound of the eigenvalues of A^-1 B: |B(u - v)|_{A^-1} <= Lam |u - v|_A.

        The largest one or a little more, never less (`sweepopt.linalg.largest_ratio`).
        """
        if self.B is None:
            return 0.0
        if not self.coercive:
            return float("inf")
        return largest_ratio(self.metric, self.B)

    def largest_ratio_to_metric(self, gamma: Any) -> Any:
        """A number c with A + gamma B <= c metric, of each gamma."""
        if self.coercive:
            return 1 + gamma * self.Lam
        return np.maximum(float(not self.rate_independent), gamma / self.time_scale)

    def set_at(self, t: float, u: Array) -> ConvexSet:
        """C(t), or C(t, u) where it depends on the state, which its function cannot change."""
        if not isinstance(self.C, StateDependent):
            return self.C.at(t)
        return self.C.of(read_only(u.view())).at(t)

    @cached_property
    def state_rate(self) -> float:
        """The largest eigenvalue of A^-1 L, L the Lipschitz matrix of C(t, u); 0 of a C(t)."""
        C = self.C
        return largest_ratio(self.metric, C.lipschitz) if isinstance(C, StateDependent) else 0.0

    def contraction(self, gamma: float) -> float:
        """By how much a set C(t, u + gamma z) that is z's own brings two velocities z together.

        The iteration z -> the velocity of C(t, u + gamma z) contracts in |.|_M, M = A + gamma B, by
        gamma times the largest eigenvalue of M^-1 L, L the Lipschitz matrix of C. It is 0 where C
        does not depend on the state or the stage is explicit.
        """
        C: Any = self.C
        if not (gamma and self.state_rate):
            return 0.0
        try:
            metric = Factor(self.matrix(gamma), "A + gamma B")
        except IndefiniteError:
            raise InputError(
                "C(t, u) depends on the state, and A + gamma B is singular: give kinematic "
                "hardening or a viscosity beside isotropic hardening, and viscosity or elasticity "
                "to what has neither"
            ) from None
        return gamma * largest_ratio(metric, C.lipschitz)

    def refuse_state(self, what: str) -> None:
        """Refuse what is known of a C(t) only that does not depend on the state.

        Raises
        ------
        InputError
            Naming it and what to use.
        """
        if isinstance(self.C, StateDependent):
            raise InputError(
                f"{what} needs a C(t) that does not depend on the state u: the normal cones of "
                "C(t, u) are not monotone in u; take equal steps, and compare with a run of twice "
                "as many"
            )

    def matrix(self, gamma: float) -> Matrix:
        """A + gamma B, rounded."""
        return self.A if self.B is None or not gamma else self.A + gamma * self.B

    def times_B(self, u: Array) -> Array:
        """B u, zero where there is no B."""
        return np.zeros(self.dim) if self.B is None else self.B.dot(u)

    def check(self, times: Array) -> list[tuple[float, ConvexSet]]:
        """Check C(t) on the given increasing times, before any solver runs.

        Returns what `MovingSet.members` does, and raises its errors.

        Warns
        -----
        VariationWarning
            If C(t) jumps by an infinite distance, as far as that can be seen.
        """
        members = self.C.members(times)
        for _, C in members:
            _check_written(C)
            if not C.certifiable:
                self.refuse_state(f"{kind_without_certificate(C)}, which has no certificates,")
        for (_, before), (t, C) in pairwise(members):
            # a change of offsets is a finite one
            if before.distance_bound(C) == np.inf:
                warn(
                    f"C(t) jumps by an infinite distance at t = {t:g}: it is not of bounded "
                    "variation, as the theory asks; the steps are solved all the same",
                    VariationWarning,
                )
        return members

    def check_start(self, t: float, nearest: Nearest | None = None) -> bool:
        """Check B u0 in C(t) for the time t at which u0 holds; whether it is outside.

        Parameters
        ----------
        nearest : callable, optional
            (w, C) -> the point of C nearest to w, in any norm; Euclidean without it.

        Raises
        ------
        InputError
            If no A z + B u0 is in C(t), seen on the kernel of A: then no solution starts there.

        Warns
        -----
        InitialStateWarning
            If B u0 is not in C(t) elsewhere: the solution exists, but it starts moving.
        """
        force, C = self.times_B(self.u0), self.C.at(t)
        excess = _excess(force, C, nearest)
        if not excess.any():
            return False
        what, home = self._balance(t)
        where = f"{what} is not {home}; its distance is {np.linalg.norm(excess):g}"
        if not self.coercive:
            K = self.kernel
            size = max(np.abs(force).max(), np.abs(C.anchor).max())  # what K.T cancels rounds
            if K.shape[1] and _excess(K.T @ force, image(K.T, C), size=size).any():
                raise InputError(
                    f"{where}, and A is singular: no velocity makes up for that, so that no "
                    "solution starts there; change u0, to so.compatible_start(process) for example"
                )
        remedy = f"a u0 with {what} {home}, or " if self.B is not None else ""
        warn(
            f"{where}. The solution exists and starts with a velocity; for a start at rest give "
            f"{remedy}loads and prescribed motions that begin slowly, with a dissipation that "
            "contains 0, as so.Box(-g, g)",
            InitialStateWarning,
        )
        return True

    def start_excess(self, t: float) -> Array:
        """B u0 less the nearest point of C(t), 0 where it is in C(t); u0 holds at t."""
        return _excess(self.times_B(self.u0), self.C.at(t))

    def _balance(self, t: float) -> tuple[str, str]:
        """What is where if the body can be at rest, in words."""
        return "B u0", f"in C({t:g})"

    @cached_property
    def kernel(self) -> Matrix:
        """A basis of the kernel of A, shape (dim, k)."""
        return kernel(self.A) if not self.coercive else np.zeros((self.dim, 0))

    def check_jumps(self, start: float, end: float) -> None:
        """Look for finite jumps of center(t), scale(t) and h(t) that are data, between two times.

        A table jumps between times no further apart than 1e-12 of the largest time of the run.

        Warns
        -----
        VariationWarning
            Naming the times and sizes of the first ones.
        """
        sentences = [sentence for _, sentence in jumps(self.C, self.metric, start, end)]
        if sentences:
            rest = len(sentences) - 5
            more = f", and {rest} more" if rest > 0 else ""
            warn(
                f"C(t) jumps {', '.join(sentences[:5])}{more}, in the norm of A^-1. The "
                "theory asks for a C(t) that moves absolutely continuously; the steps are solved "
                "all the same, and are most accurate if they end at the jumps",
                VariationWarning,
            )

    def variation(self, times: Array) -> Variation:
        """The total variation v(T) of C between the first and the last time, in |.|_{A^-1}.

        d_H(C(t), C(s)) <= v(t) - v(s). Of data, center(t), scale(t) and h(t) with histories that
        know their variation, it is the sum of those of all terms, whatever times lie between: exact
        for one term that moves a translate or an interval, an upper bound for several, and for a
        `Modulated` one, by the product rule. Else it is the sum of the distances of C at
        neighbouring times, which a finer grid brings closer to it.

        Parameters
        ----------
        times : array_like, shape (k,)
            Increasing.

        Returns
        -------
        Variation
            A float, with `guaranteed`.

        Raises
        ------
        InputError
            If the distance of two members is not known: a polyhedron of dependent rows in more than
            one dimension whose offsets move, sets of different kinds.
        """
        self.refuse_state("the variation of C(t)")
        return variation(self.C, self.metric, increasing("times", times))

    def velocity_bound(self, times: Array, paper: bool = False) -> VelocityBound:
        """An a priori bound of the velocity, MATH.md section 3:

        |u'(t)|_A <= d(B u0, C(0)) + v(T), distances and v in |.|_{A^-1}.

        Parameters
        ----------
        times : ndarray
            Grid from 0 to T; what is between its ends matters only where C(t) is no data.
        paper : bool
            The constant that the paper prints, 8 v(T) exp(Lam T) in these norms: 8 v(T) because it
            truncates C, and B u0 in C(0); where it is up to rounding, the distance is added.

        Raises
        ------
        InputError
            If A is singular: the velocity then has no bound from these data, take differences of
            `Solution.u`; if v(T) is not known; if
            B u0 is not in C(0), with `paper`.
        """
        if not self.coercive:
            raise InputError("the a priori bound is one of |u'|_A; it needs A coercive, not A = 0")
        v = self.variation(times)
        times = vector("times", times)
        start = float(times[0])
        force, C = self.times_B(self.u0), self.C.at(start)
        distance, factor = self.metric.dual_norm(force - C.project(force)), 1.0
        if paper:
            if self.start_excess(start).any():
                raise InputError(
                    f"the paper's bound asks for B u0 in C({start:g}), whose distance is "
                    f"{distance:g}; leave paper out, or change u0"
                )
            with np.errstate(over="ignore"):
                factor = 8 * float(np.exp(self.Lam * (times[-1] - start)))
        value = distance + (factor * v if v else 0.0)
        return VelocityBound(float(value), float(v), distance, v.guaranteed)


@meaning(
    C="; its C(t) is load - dissipation: give these, or take SweepingProcess(A, B, C, u0)",
    f="; f is load",
    center="; the load moves the set: give load",
    force="; a force is a load",
    M="; there is no inertia: a viscosity is A, a stiffness B",
    J="; J is the support function of the set dissipation",
    D="; D is dissipation",
    friction="; a friction bound g is dissipation=so.Box(-g, g)",
    mu="; a friction bound g is dissipation=so.Box(-g, g)",
    g="; a friction bound g is dissipation=so.Box(-g, g)",
    K="; a stiffness is B, the cone K is cone",
    x0="; the start is u0",
)
class EvolutionVI(SweepingProcess):
    """Find u'(t) in K: <A u' + B u - f(t), v - u'> + J(v) - J(u') >= 0 for all v in K.

    It is the sweeping process with C(t) = f(t) - (D + polar(K)).

    Parameters
    ----------
    A, B, u0
        As in SweepingProcess.
    load : callable t -> (dim,), Separable, VectorTable, array_like or None
        f; a vector is constant, None is no load.
    dissipation : ConvexSet or None
        D, the friction forces that are possible: ``Box(-g, g)`` for a friction bound g. J is its
        support function, J(v) = g |v| there; None is J = 0.
    cone : ConvexSet or None
        K, the velocities that are possible: ``Orthant(n)`` for u' >= 0. A closed convex cone; None
        is the whole space.
    fields
        As in SweepingProcess.

    Raises
    ------
    InputError
        If a shape or an entry is wrong, a set moves, or K is not a cone.

    Examples
    --------
    >>> from sweepopt.sets import Box
    >>> D = Box(-1, 1)
    >>> vi = EvolutionVI(A=0.5, B=2.0, load=lambda t: 1.5 * t, dissipation=D, u0=0.0)
    >>> vi.C.at(0.0).support([1.0])
    1.0
    """

    def __init__(
        self,
        A: Any,
        B: Any,
        *,
        load: Any = None,
        dissipation: ConvexSet | None = None,
        cone: ConvexSet | None = None,
        u0: Any,
        fields: dict[str, slice] | None = None,
    ) -> None:
        A, B, sizes = _matrices(A, B)
        for name, given in (("dissipation", dissipation), ("cone", cone)):
            if given is not None and not isinstance(given, ConvexSet):
                raise InputError(
                    f"{name} must be a set that does not move, got {shown(given)}; a friction "
                    "bound g is so.Box(-g, g), a list of sets so.product(*sets), a cone of "
                    "velocities >= 0 so.Orthant(n); with a set that moves C(t) = load - "
                    "dissipation, take SweepingProcess(A, B, C=so.Moving(-set, center=load, "
                    "scale=g), u0=u0)"
                )
            if given is not None:
                sizes[name] = given.dim
        if not callable(load) and (axes(load) == 2 or isinstance(load, str)):
            raise InputError(
                "load must be a function of t or one vector; one row a time is "
                "so.VectorTable(times, rows), histories with their vectors so.Separable(pairs)"
            )
        if callable(load):
            takes("load", load, "t")
        self.load = load if callable(load) or load is None else entries("load", load)
        if (size := getattr(self.load, "dim" if callable(load) else "size", None)) is not None:
            sizes["load"] = size
        agree(**sizes, u0=vector("u0", u0).size)
        dim = A.shape[0]
        self.dissipation, self.cone = dissipation, cone
        D: ConvexSet = Point(np.zeros(dim)) if dissipation is None else dissipation
        if cone is not None:
            with at_path("cone: "):
                D = D + cone.polar()
        C: AnySet = -D
        if self.load is not None:
            C = moved = Moving(-D, center=self.load)
            moved.center_name = "load"
        super().__init__(A, B, C, u0, fields)

    def _balance(self, t: float) -> tuple[str, str]:
        names = {"the dissipation set": self.dissipation, "the polar cone of K": self.cone}
        home = " + ".join(name for name, given in names.items() if given is not None)
        if not home:
            return "B u0", f"equal to f({t:g})"
        return f"f({t:g}) - B u0", f"in {home}"


def _matrices(A: Any, B: Any) -> tuple[Matrix, Matrix | None, dict[str, int]]:
    """A, zero where it is left out, B if it is not, and the sizes of those that are given."""
    given = {
        name: symmetric(name, M)
        for name, M in (("A", A), ("B", B))
        if not (M is None or (np.isscalar(M) and M == 0))  # of any number of unknowns
    }
    parts = {name: M for name, M in given.items() if abs(M).max() > 0}
    if not parts:
        raise InputError("A and B are both zero: nothing determines the velocity; give one of them")
    sizes = {name: M.shape[0] for name, M in given.items()}
    for name, M in given.items():
        if isinstance(M, np.ndarray) and len(M) >= MANY and np.count_nonzero(M) < M.size / 10:
            warn(
                f"{name} is dense, {M.nbytes / 1e6:.0f} MB of which most are zeros: pass "
                f"scipy.sparse.csr_array({name}), and a step takes a small part of the time",
                SweepoptWarning,
            )
    one = next(iter(given.values()))
    zero = sp.csr_array(one.shape) if sp.issparse(one) else np.zeros(one.shape)
    return parts.get("A", zero), parts.get("B"), sizes


def sweeping(process: Any) -> SweepingProcess:
    """The process, if it is one."""
    if not isinstance(process, SweepingProcess):
        raise InputError(
            f"process must be a SweepingProcess or an EvolutionVI, got {shown(process)}; make one: "
            "so.SweepingProcess(A, B, C, u0); a scene is run by scene.solve(), one of the library "
            "by so.scene(name).solve()"
        )
    return process


def _valid_fields(fields: Any, dim: int) -> dict[str, slice]:
    """Names of parts of the unknowns, none of which is in two."""
    if not isinstance(fields, dict):
        raise InputError(f'fields must be a dict such as {{"u": slice(0, 2)}}: {shown(fields)}')
    owner: dict[int, str] = {}
    for name, part in fields.items():
        if not isinstance(name, str) or not isinstance(part, slice):
            raise InputError(
                f"fields: {shown(name)} must be a name with a slice, not {shown(part)}"
            )
        try:
            inside = range(part.start or 0, dim if part.stop is None else part.stop, part.step or 1)
        except (TypeError, ValueError):
            inside = range(0)
        if not inside or min(inside) < 0 or max(inside) >= dim:
            raise InputError(f"fields[{name!r}] = {part} must hold some of the {dim} unknowns")
        for i in inside:
            if owner.setdefault(i, name) != name:
                raise InputError(f"fields {owner[i]!r} and {name!r} overlap in unknown {i}")
    return dict(fields)


def _excess(force: Array, C: ConvexSet, nearest: Nearest | None = None, size: float = 0.0) -> Array:
    """The force less the nearest point of C; 0 where that is rounding of these or of `size`."""
    point = nearest(force, C) if nearest else C.project(force)
    distance = float(np.linalg.norm(force - point))
    size = max(size, *(np.abs(x).max() for x in (force, point, C.anchor)))
    # a set around 0 gives its own size; an unbounded one has none
    if distance > 1e-9 * size:
        extent = C.magnitude()
        if not (np.isfinite(extent) and distance <= 1e-12 * extent):
            return force - point
    return np.zeros(force.size)


def _check_written(C: ConvexSet) -> None:
    """Spot-check the sets that users write, alone or in others."""
    for part in _leaves(C):
        if not type(part).__module__.startswith(f"{__package__.partition('.')[0]}."):
            _check_set(part)


def _leaves(C: ConvexSet) -> Iterator[ConvexSet]:
    """The sets that products, translates, multiples, sums and intersections were made of."""
    parts: tuple[ConvexSet, ...] = getattr(C, "parts", ()) or C.form().parts
    if parts == (C,):
        yield C
    else:
        for part in parts:
            yield from _leaves(part)


def _check_set(C: ConvexSet) -> None:
    """Spot-check that sigma(C, .) is positively homogeneous, and that v - P(v) is normal to C at
    P(v) in C, by the support function; features.
    """
    name, direction = type(C).__name__, np.cos(np.arange(C.dim) + 1.0)
    for z in (direction, -direction):
        once, twice = (number(f"{name}.support(z)", C.support(v), finite=False) for v in (z, 2 * z))
        if not (once == twice or abs(twice - 2 * once) <= 1e-6 * abs(twice)):
            raise InputError(
                f"{name}.support is not positively homogeneous: "
                f"sigma(z) = {once:g} but sigma(2z) = {twice:g}"
            )
    widths = np.abs([C.support(direction), C.support(-direction)])
    reach = 2 * widths[np.isfinite(widths)].sum() / (direction @ direction) or 1.0
    inside = vector(f"{name}.project(v)", C.project(C.anchor), C.dim)
    for d in (direction, -direction):
        v = inside + reach * d
        w = vector(f"{name}.project(v)", C.project(given := v.copy()), C.dim)
        if (given != v).any():
            raise InputError(f"{name}.project(v) writes into v: let it take v = v.copy() first")
        p = C.normal(v)
        for z in (p, d):
            sigma, product = C.support(z), float(z @ w)
            tol = 1e-6 * (np.linalg.norm(v) + np.linalg.norm(w)) * np.linalg.norm(z)
            if product > sigma + tol or (z is p and tol < sigma - product < np.inf):
                raise InputError(
                    f"{name}.project contradicts {name}.support: for w = project(v) and "
                    f"z = {'v - w' if z is p else shown(z)} it is <z, w> = {product:g}, but "
                    f"support(z) = {sigma:g}, which is the supremum of <z, w> over C"
                )
    check_features(C)


def proportion(A: Matrix, B: Matrix | None) -> float | None:
    """rho with B = rho A to rounding, entry by entry; None if there is none."""
    if B is None:
        return 0.0
    if sp.issparse(A) != sp.issparse(B):
        return None
    i = int(np.argmax(A.diagonal()))
    rho = float(B[i, i] / A[i, i])
    difference = abs(B - rho * A) - ROUNDING * rho * abs(A)
    return rho if difference.max() <= 0 else None
