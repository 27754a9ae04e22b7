"""Sets that move: anything with `dim` and `at(t)`, and the same algebra as sets that do not.

A moving set is a family t -> C(t). The programs ask for `at(t)` and nothing else; where the
members differ in their offsets only (all of `Moving`, `Polyhedron(G, h(t))`), one compiled program
serves them all.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from sweepopt.checks import Array, dimension, instant, meaning, number, symmetric, takes, vector
from sweepopt.errors import EmptySetError, InputError, result_of, shown
from sweepopt.linalg import require_semidefinite
from sweepopt.loads import Constant, History, Separable, VectorTable
from sweepopt.sets.aligned import Similar
from sweepopt.sets.base import DENSE, ConvexSet, Operators
from sweepopt.sets.shapes import Point


class Summands(NamedTuple):
    """C(t) = sum_k phi_k(t) f_k + S + sum_i r_i(t) T_i, as data.

    Attributes
    ----------
    center : tuple of (callable, ndarray)
        phi_k, f_k.
    constant : ConvexSet
        S.
    scaled : tuple of (callable, ConvexSet)
        r_i, T_i.
    """

    center: tuple[Any, ...]
    constant: ConvexSet
    scaled: tuple[Any, ...]


class MovingSet(Operators):
    """C(t) given by a function of time.

    Parameters
    ----------
    at : callable
        t -> ConvexSet, always of the same dim.
    dim : int, optional
        Taken from at(0.0) when not given: give it if the set is not defined at t = 0.
    histories : sequence of callable
        Functions of time that `at` is made of, such as Table: steps of `solve` end at their
        breakpoints.

    Raises
    ------
    InputError
        If `at` returns no set, or one of another dim.
    EmptySetError
        From `at(t)`, if C(t) is seen to have no point.

    Examples
    --------
    >>> from sweepopt.sets import Ball
    >>> C = MovingSet(lambda t: Ball([t, 0.0], 1 + t))
    >>> C.at(2.0).support([1.0, 0.0])
    5.0
    """

    operands: tuple[MovingSet, ...] = ()  # what an operation made it of
    summands: Summands | None = None  # where that is linear, and they move by data
    histories: tuple[Any, ...] = ()

    def __init__(
        self,
        at: Callable[..., ConvexSet],
        dim: int | None = None,
        histories: Sequence[Callable[[float], Any]] = (),
    ) -> None:
        if not callable(at):
            raise InputError(f"at must be a function of t that returns a set, got {shown(at)}")
        if dim is None:  # else it is made in every step
            takes("at", at, "t")
        if not isinstance(histories, (list, tuple)) or not all(map(callable, histories)):
            raise InputError(f"histories must be a list of functions of time, got {histories!r}")
        self.histories = tuple(histories)
        self._at = at
        if dim is not None:
            self.dim = dimension(dim)
            return
        try:
            self.dim = self._member(0.0).dim
        except InputError as error:
            hint = "; give dim= if the set is not defined at t = 0"
            raise type(error)(f"{error}{hint}") from None

    def at(self, t: float) -> ConvexSet:
        """C(t)."""
        t = instant("t", t)
        C = self._member(t)
        if C.dim != self.dim:
            raise InputError(f"C(t) at t = {t:g} has dim {C.dim}, not {self.dim}")
        return C

    def contains(self, *_: Any, **__: Any) -> Any:
        """Refused, as are `support` and `project`: C(t) has them."""
        raise InputError("C moves: ask it at a time, C.at(t).contains(w), .support(z), .project(w)")

    support = project = contains

    def at_many(self, times: Array) -> list[ConvexSet]:
        """C(t) at each of the times; data are evaluated at all of them at once."""
        return [self.at(t) for t in times.tolist()]

    @property
    def moving_parts(self) -> list[MovingSet]:
        """The sets that operations made it of and that move by data of their own, or itself."""
        if type(self) is not MovingSet or not self.operands:
            return [self]
        return [part for C in self.operands for part in C.moving_parts]

    def member(self, at: float | dict[MovingSet, ConvexSet]) -> ConvexSet:
        """C(t), or what the operations make of sets that are given for each of the parts."""
        if isinstance(at, dict):
            return at[self] if self in at else self._at(at)
        return self.at(at)

    def members(self, times: Array) -> list[tuple[float, ConvexSet]]:
        """Look at every C(t), and keep one of each run that differs in the offsets only.

        Also the first one that acts on other unknowns than those before: it tells that they change.

        Returns
        -------
        list of (t, C(t))

        Raises
        ------
        EmptySetError
            If C(t) is empty; the message names t.
        InputError
            If C(t) is not finite or changes its dimension.
        """
        kept: list[tuple[float, ConvexSet]] = []
        acts_on: set[bytes] = set()
        last = None
        for t in map(float, times):  # no list: of many steps it is large
            C = self.at(t)
            if C is not last:
                try:
                    C.require_nonempty(f"C(t) at t = {t:g}")
                except EmptySetError:
                    for part in self.operands:
                        part.at(t)  # a scale < 0 for example
                    raise
            other = False
            if len(acts_on) < 2 and not C.singleton:
                key = b"" if C.selection is None else C.selection.unknowns.tobytes()
                other = key not in acts_on
                acts_on.add(key)
            if last is None or other or not last.same_cone(C):
                kept.append((t, C))
            last = C
        return kept

    def _made(self, t: float) -> ConvexSet:
        """What the function makes, whatever that is."""
        return self._at(t)

    def _member(self, t: float) -> ConvexSet:
        try:
            C = result_of(self._made, t, "C(t)")
        except InputError as error:
            where = f"C(t) at t = {t:g}"
            if str(error).startswith(where):
                raise
            raise type(error)(f"{where}: {error}") from None
        if not isinstance(C, ConvexSet):
            raise InputError(
                f"C(t) at t = {t:g} must be a set, got {shown(C)}; return one, or, "
                "if the function says where C(t) is, give so.Moving(set, center=function)"
            )
        return C


class Moving(MovingSet):
    """C(t) = center(t) + scale(t) * shape.

    Parameters
    ----------
    shape : ConvexSet
    center : callable t -> (dim,), Separable, VectorTable, array_like or None
        Where the set is, such as a load; None is 0.
    scale : callable t -> float >= 0, Table, float or None
        How large it is, such as a friction bound that changes; None is 1.

    Raises
    ------
    InputError
        If shape moves, center has another dim, or scale is negative.

    Examples
    --------
    >>> from sweepopt.sets import Box
    >>> C = Moving(Box(-1, 1), center=lambda t: 1.5 * t)
    >>> C.at(2.0).project([0.0])
    array([2.])
    """

    center_name = "center"  # how errors call it: the load of a variational inequality is one

    def __init__(self, shape: ConvexSet, center: Any = None, scale: Any = None) -> None:
        if not isinstance(shape, ConvexSet):
            raise InputError(
                f"shape must be a set that does not move, got {shown(shape)}; it comes before "
                "center and scale, and a function of t that returns a set is so.MovingSet(function)"
            )
        self.shape, self.dim = shape, shape.dim
        if callable(center):
            takes(self.center_name, center, "t")
            if isinstance(center, History) and not hasattr(center, "dim"):
                if self.dim > 1:
                    raise InputError(
                        f"a load or center must have {self.dim} entries at a time, got "
                        f"{shown(center)}; with its direction f it is so.Separable([(history, f)])"
                    )
                center = Separable([(center, 1.0)])
        elif center is not None:
            center = Separable([(Constant(), vector("center", center, self.dim))])
        if callable(scale):
            takes("scale", scale, "t")
        elif scale is not None:
            scale = Constant(number("scale", scale, 0.0))
        self.center, self.scale = center, scale
        if isinstance(center, (Separable, VectorTable)) and center.dim != self.dim:
            raise InputError(f"center must have {self.dim} entries, got {center.dim}")

    @property
    def summands(self) -> Summands | None:  # type: ignore[override]
        """None where a function moves the center, or a table more than DENSE unknowns."""
        few = isinstance(self.center, VectorTable) and self.dim <= DENSE
        if not (self.center is None or few or isinstance(self.center, Separable)):
            return None
        terms = () if self.center is None else self.center.terms
        if self.scale is None:
            return Summands(terms, self.shape, ())
        return Summands(terms, Point(np.zeros(self.dim)), ((self.scale, self.shape),))

    def _picture(self) -> str:
        return self.shape._picture()

    def center_at(self, t: float) -> Array:
        """center(t), shape (dim,)."""
        t = instant("t", t)
        if self.center is None:
            return np.zeros(self.dim)
        name = f"{self.center_name}(t)"
        return vector(f"{name} at t = {t:g}", result_of(self.center, t, name), self.dim)

    def scale_at(self, t: float) -> float:
        """scale(t)."""
        t = instant("t", t)
        if self.scale is None:
            return 1.0
        name = f"scale(t) at t = {t:g}"
        return number(name, instant(name, result_of(self.scale, t, "scale(t)")), minimum=0.0)

    def members(self, times: Array) -> list[tuple[float, ConvexSet]]:
        if self.scale is not None:
            return super().members(times)
        # translates of one set: their centres are all there is to look at
        if isinstance(self.center, Separable):
            self.center.values(times)
        elif self.center is not None:
            for t in map(float, times):
                self.center_at(t)
        return self.at(float(times[0])).members(times)

    def at(self, t: float) -> ConvexSet:
        if self.center is None:
            instant("t", t)
            return self._scaled(t)
        return _translate(self._scaled(t), self.center_at(t))

    def at_many(self, times: Array) -> list[ConvexSet]:
        if not isinstance(self.center, Separable):
            return super().at_many(times)
        return list(map(_translate, map(self._scaled, times.tolist()), self.center.at_many(times)))

    def _scaled(self, t: float) -> ConvexSet:
        return self.shape if self.scale is None else self.scale_at(t) * self.shape


def _translate(C: ConvexSet, v: Array) -> ConvexSet:
    return Point(C.anchor + v) if isinstance(C, Point) else Similar(C, v)


class MovingOffsets(MovingSet):
    """C(t) = { w : G w <= h(t) }, which `Polyhedron(G, h)` gives for a callable h.

    Attributes
    ----------
    shape : ConvexSet
        The member with h = 0; also of one on some of the unknowns, the others 0.
    offsets : callable t -> (m,)
        h, a `Separable` for example.
    """

    def __init__(self, shape: Any, offsets: Callable[[float], Any]) -> None:
        self.shape, self.offsets, self.dim = shape, offsets, shape.dim

    def _made(self, t: float) -> Any:
        return self.shape.member(self.offsets(t))


@meaning(L="; give lipschitz")
class StateDependent(MovingSet):
    """C(t, u): a set that moves with time and with the state, in a quasi-variational problem.

    Each stage of a scheme has the set at its own time and state. A scheme that is explicit in u
    knows that state; an implicit one finds it by fixed-point iteration (MATH.md section 3).

    Parameters
    ----------
    at : callable
        (t, u) -> ConvexSet, always of the same dim.
    lipschitz : array_like or sparse, shape (dim, dim)
        L, symmetric positive semidefinite, which is taken on trust: for all t, states u, v and
        directions y, z, with sigma the support function,
        ``|sigma(C(t, u), y) - sigma(C(t, u), z) - sigma(C(t, v), y) + sigma(C(t, v), z)|`` is at
        most ``|u - v|_L |y - z|_L``. For intervals [-g_k(u_k), g_k(u_k)] it is the diagonal matrix
        of the Lipschitz constants of g_k.
    histories : sequence of callable
        As of `MovingSet`.

    Raises
    ------
    InputError
        If `at` is no function, or L is not symmetric positive semidefinite; of sums, multiples and
        the like of it, as what these add belongs into `at`.

    Examples
    --------
    Friction that falls from 1 to 1/2 with the slip u:

    >>> import numpy as np
    >>> import sweepopt as so
    >>> def friction(t, u):
    ...     g = 0.5 + 0.5 * np.exp(-abs(u))
    ...     return so.Box(t - g, t + g)
    >>> C = so.StateDependent(friction, lipschitz=0.5)
    >>> process = so.SweepingProcess(A=1.0, B=2.0, C=C, u0=0.0)
    >>> sol = so.solve(process, t_end=2.0, steps=100)
    >>> sol.plan.contraction < 0.01, round(float(sol.u[-1, 0]), 3)
    (True, 0.317)
    """

    _state: Array | None = None  # without it there is no set

    def __init__(
        self,
        at: Callable[[float, Array], ConvexSet],
        lipschitz: Any,
        histories: Sequence[Callable[[float], Any]] = (),
    ) -> None:
        takes("at", at, "t", "u")
        self.lipschitz = symmetric("lipschitz", lipschitz)
        require_semidefinite("lipschitz", self.lipschitz)
        super().__init__(at, self.lipschitz.shape[0], histories)

    def of(self, u: Array) -> StateDependent:
        """The sets t -> C(t, u) of one state."""
        other = copy.copy(self)
        other._state = u
        return other

    def _made(self, t: float) -> ConvexSet:
        if self._state is None:
            raise InputError(WITHOUT_STATE)
        return self._at(t, self._state)


WITHOUT_STATE = (
    "C(t, u) is no set without a state: what is added to it, or made of it, belongs into its "
    "function of (t, u)"
)

AnySet = ConvexSet | MovingSet
"""A set, whether it moves or not."""
