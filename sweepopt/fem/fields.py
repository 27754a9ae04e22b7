"""Data in space and time: a number, one per group, a profile, a formula, or a Python function."""

import ast
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sweepopt.checks import Array, at_path, choice, floats, number
from sweepopt.errors import InputError, shown, suggestion
from sweepopt.loads import check_points

Indices = NDArray[np.int64]

DIRECTIONS = {
    "x": lambda x: x[0],
    "y": lambda x: x[1],
    "z": lambda x: x[2],
    "radius": lambda x: np.hypot(x[0], x[1]),
    "angle": lambda x: np.mod(np.degrees(np.arctan2(x[1], x[0])), 360.0),
}
"""What a profile may run along; the angle in degrees in [0, 360), from the x axis to the y axis."""


def coordinate(argument: str, name: str, x: Array) -> Array:
    """x, y, z, radius or angle of points, shape (d, ...).

    Raises
    ------
    InputError
        If bodies of this dimension have no such coordinate.
    """
    known = {1: ("x",), 2: ("x", "y", "radius", "angle")}.get(len(x), tuple(DIRECTIONS))
    return DIRECTIONS[choice(argument, name, known)](x)


@dataclass(frozen=True, eq=False)
class Profile:
    """Piecewise linear in one direction.

    Parameters
    ----------
    along : {"x", "y", "z", "radius", "angle"}
        Radius and angle (degrees in [0, 360)) about the origin.
    at, values : array_like, shape (m,)
        `at` increases strictly and must cover the body where the profile is used.

    Raises
    ------
    InputError
        If `along` is not known or `at` does not increase; when called, if `at` does not cover x.

    Examples
    --------
    >>> import numpy as np
    >>> stiff_outside = Profile("radius", [1.0, 2.0], [3.0, 5.0])
    >>> float(stiff_outside(np.array([0.0, 1.5])))
    4.0
    """

    along: str
    at: ArrayLike
    values: ArrayLike

    def __post_init__(self) -> None:
        choice("along", self.along, DIRECTIONS)
        at, values = check_points("at", self.at, self.values)
        object.__setattr__(self, "at", at)
        object.__setattr__(self, "values", values)

    def __call__(self, x: Array) -> Array:
        where = coordinate("along", self.along, np.asarray(x))
        at: Any = self.at
        slack = 1e-9 * np.abs(at).max()
        if where.min() < at[0] - slack or where.max() > at[-1] + slack:
            raise InputError(
                f"at covers [{at[0]:g}, {at[-1]:g}] but {self.along} runs over "
                f"[{where.min():g}, {where.max():g}]; extend the profile"
            )
        return np.interp(where, at, np.asarray(self.values))


Datum = float | str | Mapping[str, float] | Profile | Callable[..., ArrayLike]
"""What an effect takes for a coefficient. A function gets x of shape (d, ...), and the time if it
takes two arguments, and returns numbers of shape (...)."""

FUNCTIONS = {
    name: getattr(np, name)
    for name in ("sin", "cos", "tan", "exp", "log", "sqrt", "abs", "minimum", "maximum")
}
OPERATORS = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: np.power,
    ast.USub: np.negative,
    ast.UAdd: np.positive,
}


class Formula:
    """Arithmetic in x, y, z, radius, angle, t and pi, such as ``"0.3 * (1 + x**2)"``.

    Parameters
    ----------
    text : str
        Numbers, ``+ - * / **``, brackets, and the functions of `FUNCTIONS`; data, never code.

    Raises
    ------
    InputError
        If there is anything else in it; when called, if the body has no such coordinate.

    Examples
    --------
    >>> float(Formula("2 * x + t")(np.array([1.0]), 3.0))
    5.0
    """

    def __init__(self, text: str) -> None:
        self.text = text
        try:
            self.tree = ast.parse(text, mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise self._refusal() from None
        self.names = {node.id for node in ast.walk(self.tree) if isinstance(node, ast.Name)}
        unknown = self.names - {*DIRECTIONS, *FUNCTIONS, "t", "pi"}
        if unknown:
            known = ", ".join([*DIRECTIONS, "t", "pi", *FUNCTIONS])
            raise InputError(
                f"must be a number or a formula of {known}, got {shown(min(unknown))} "
                f"in {shown(text)}{suggestion(min(unknown), known.split(', '))}"
            )
        self(np.ones((3, 1)))

    def __call__(self, x: Array, t: float = 0.0) -> Any:
        try:
            with np.errstate(all="ignore"):  # what is no finite number is refused by who asks
                return self._value(self.tree, x, t)
        except (TypeError, OverflowError, RecursionError):
            raise self._refusal() from None

    def _refusal(self) -> InputError:
        power = "; a power is x**2" if "^" in self.text else ""
        return InputError(
            f"must be a number or a formula such as 1 + 2*x**2, got {shown(self.text)}{power}"
        )

    def _value(self, node: Any, x: Array, t: float) -> Any:
        match node:
            case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
                return np.float64(value)
            case ast.Name(id="t" | "pi" as name):
                return np.float64({"t": t, "pi": np.pi}[name])
            case ast.Name(id=name) if name in DIRECTIONS:
                return coordinate(f"of {shown(self.text)}:", name, x)
            case ast.UnaryOp(op=op, operand=one):
                function, terms = OPERATORS.get(type(op)), [one]
            case ast.BinOp(left=one, op=op, right=two):
                function, terms = OPERATORS.get(type(op)), [one, two]
            case ast.Call(func=ast.Name(id=name), args=terms, keywords=[]):
                function = FUNCTIONS.get(name)
            case _:
                raise self._refusal()
        if function is None or function.nin != len(terms):
            raise self._refusal()
        return function(*(self._value(one, x, t) for one in terms))


parsed = lru_cache(Formula)
"""The formula of a text, parsed once: formulas with t are evaluated in every step."""


def in_time(datum: Any) -> bool:
    """Whether a datum is a function of x and t."""
    if isinstance(datum, str):
        return "t" in parsed(datum).names
    if not callable(datum) or isinstance(datum, Profile):
        return False
    try:
        arguments = inspect.signature(datum).parameters.values()
    except (TypeError, ValueError):  # of a built-in function
        return False
    given = [
        one.name
        for one in arguments
        if one.default is one.empty and one.kind <= one.POSITIONAL_OR_KEYWORD
    ]
    if len(given) > 2 or given[1:] == ["y"]:
        raise InputError(
            f"must be a function of the points as one array, such as lambda x: 1 + x[0] * x[1], or "
            f"of them and the time, lambda x, t: t * x[0]; got a function of {', '.join(given)}"
        )
    return len(given) == 2


class Coefficient(NamedTuple):
    """What errors call a coefficient, and which numbers it may be.

    Attributes
    ----------
    name : str
    minimum : float or None
        None for any finite number.
    strict : bool
        Whether the minimum itself is refused.
    finite : bool
        Whether inf is refused.
    vector : bool
        Whether a body with vectors has a list of data, one for each of x, y and z.
    """

    name: str
    minimum: float | None = None
    strict: bool = False
    finite: bool = True
    vector: bool = False

    def check(self, datum: Any) -> None:
        """Check the numbers of a datum; a function is checked where it is evaluated.

        Raises
        ------
        InputError
            Naming the coefficient, the group and the value.
        """
        limits = self[1:4]
        if self.vector and isinstance(datum, (list, tuple)):
            for one in datum:
                self.check(one)
        elif isinstance(datum, Mapping):
            for key, value in datum.items():
                number(f"{self.name}.{key}", value, *limits)
        elif isinstance(datum, str) or callable(datum):
            with at_path(f"{self.name} "):
                in_time(datum)
        else:
            number(self.name, datum, *limits)

    def parts(self, datum: Any, components: int) -> list[Any]:
        """The data of x, y and z, or the one of an antiplane body, as a list."""
        parts = list(datum) if isinstance(datum, (list, tuple)) else [datum]
        if len(parts) != components:
            form, kinds = f"[{', '.join('xyz'[:components])}]", ""
            if components == 1:
                form = "one value"
                kinds = (
                    "; displacements are numbers in a body of kind antiplane, the default, or "
                    "lumped, and vectors in plane strain, plane stress and solid"
                )
            raise InputError(f"{self.name} must be {form}, got {shown(datum)}{kinds}")
        return parts

    def values(
        self,
        datum: Datum,
        points: ArrayLike,
        groups: Mapping[str, Indices] | None = None,
        t: float | None = None,
    ) -> Array:
        """Values at points of cells.

        Parameters
        ----------
        datum : number, formula, mapping, Profile or callable
        points : array_like, shape (d, cells, ...)
        groups : mapping of str to indices of cells
            What a mapping may name; every cell must be covered by exactly one named group.
        t : float, optional
            The time, of functions of x and t; none where these are refused.

        Returns
        -------
        ndarray, shape (cells, ...)
        """
        x = np.asarray(points)
        values = np.empty(x.shape[1:])
        if isinstance(datum, Mapping):
            self._fill(values, datum, groups or {})
            return values
        with at_path(f"{self.name} "):
            moves = in_time(datum)
        if moves and t is None:
            raise InputError(
                f"{self.name} does not move here; leave out t (a function takes the points alone, "
                "lambda x: 1 + x[0]), or give an effect with a history"
            )
        function: Any = parsed(datum) if isinstance(datum, str) else datum
        try:
            with at_path(f"{self.name} " if isinstance(datum, str) else f"{self.name}."):
                if callable(function):
                    function = function(x, t) if moves else function(x)
            values[:] = floats(self.name, function, "numbers, one for each point x")
        except InputError:
            raise
        except (TypeError, ValueError) as error:
            raise InputError(
                f"{self.name} must turn points x of shape (d, ...) into numbers of shape (...), as "
                f"lambda x: 1 + x[0] * x[1] does; {error}"
            ) from error
        limits = self
        if isinstance(datum, str):  # one that divides by 0 does not mean inf
            limits = self._replace(name=f"{self.name}, {shown(datum)},", finite=True)
        if moves and self.minimum is not None and values.min() < self.minimum:
            raise InputError(
                f"{limits.name} must be >= {self.minimum:g}, got {values.min():g} at t = {t:g}; "
                f"end the run before, or write maximum({self.minimum:g}, ...)"
            )
        for extreme in (values.min(), values.max()):
            limits.check(extreme)
        return values

    def _fill(
        self, values: Array, datum: Mapping[str, float], groups: Mapping[str, Indices]
    ) -> None:
        times = np.zeros(len(values), dtype=int)
        for key, value in datum.items():
            if key not in groups:
                known = f"there are: {', '.join(sorted(groups))}"
                if not groups:
                    known = "the mesh names none; give one value, a formula, or a mesh with groups"
                raise InputError(f"{self.name}.{key} is not a group here; {known}")
            values[groups[key]] = value
            times[groups[key]] += 1
        if np.any(times != 1):
            wrong = [key for key in sorted(groups) if np.any(times[groups[key]] != 1)]
            raise InputError(
                f"{self.name} must give one value to each cell, but gives none or several in "
                f"{', '.join(wrong) or 'cells of no group'}; cover every group once"
            )


class SlipLaw(Protocol):
    """A function phi >= 0 of an array of slips (m) that knows its Lipschitz constant."""

    @property
    def lipschitz(self) -> float:
        """The largest |phi'| (1/m)."""
        ...

    def __call__(self, slip: Array) -> Array:
        """phi(s), of the shape of s, without unit."""
        ...


@dataclass(frozen=True)
class SlipWeakening:
    """``phi(s) = r + (1 - r) exp(-s / d)``: from g at rest to r g after a long way.

    Parameters
    ----------
    distance : float
        d (m), > 0, in which most of the change happens.
    residual : float
        r >= 0, without unit; above 1 friction grows with the slip.

    Raises
    ------
    InputError
        If a number is out of its range.

    Examples
    --------
    >>> law = SlipWeakening(distance=0.5, residual=0.2)
    >>> law.lipschitz, float(law(np.array(0.0)))
    (1.6, 1.0)
    """

    distance: float
    residual: float = 0.0

    def __post_init__(self) -> None:
        number("distance", self.distance, 0.0, strict=True)
        number("residual", self.residual, 0.0)

    @property
    def lipschitz(self) -> float:
        """The largest |phi'| (1/m)."""
        return abs(1 - self.residual) / self.distance

    def __call__(self, slip: Array) -> Array:
        return self.residual + (1 - self.residual) * np.exp(-slip / self.distance)
