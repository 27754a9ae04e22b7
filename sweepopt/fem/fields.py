"""Data that vary in space: a number, one per physical group, a profile, or a Python function."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sweepopt.checks import choice, floats, vector
from sweepopt.errors import InputError, shown
from sweepopt.fem.mesh import Indices

Array = NDArray[np.float64]

DIRECTIONS: dict[str, Callable[[Array], Array]] = {
    "x": lambda x: x[0],
    "y": lambda x: x[1],
    "radius": lambda x: np.hypot(x[0], x[1]),
    "angle": lambda x: np.mod(np.degrees(np.arctan2(x[1], x[0])), 360.0),
}
"""What a profile may run along; the angle in degrees in [0, 360), from the x axis to the y axis."""


@dataclass(frozen=True, eq=False)
class Profile:
    """Piecewise linear in one direction.

    Parameters
    ----------
    along : {"x", "y", "radius", "angle"}
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
        at = vector("at", self.at)
        if at.size < 2 or np.any(np.diff(at) <= 0.0):
            raise InputError("at must have two entries or more and increase strictly")
        object.__setattr__(self, "at", at)
        object.__setattr__(self, "values", vector("values", self.values, at.size))

    def __call__(self, x: Array) -> Array:
        where = DIRECTIONS[self.along](np.asarray(x))
        at, values = np.asarray(self.at), np.asarray(self.values)
        slack = 1e-9 * np.abs(at).max()
        if where.min() < at[0] - slack or where.max() > at[-1] + slack:
            raise InputError(
                f"at covers [{at[0]:g}, {at[-1]:g}] but {self.along} runs over "
                f"[{where.min():g}, {where.max():g}]; extend the profile"
            )
        return np.asarray(np.interp(where, at, values))


Datum = float | Mapping[str, float] | Profile | Callable[[Array], ArrayLike]
"""What an effect takes for a coefficient. A function gets x of shape (2, ...) and returns (...)."""


@dataclass(frozen=True)
class Range:
    """Values a coefficient may take: at least `minimum`, or above it if `strict`."""

    minimum: float = -np.inf
    strict: bool = False
    infinite: bool = False

    def check(self, name: str, values: ArrayLike) -> None:
        """Refuse values that are not finite or lie below the minimum."""
        array = floats(name, values, "a number")
        relation, low = (
            (">", array <= self.minimum) if self.strict else (">=", array < self.minimum)
        )
        for bad, wanted in (
            (np.isnan(array) if self.infinite else ~np.isfinite(array), "finite"),
            (low, f"{relation} {self.minimum:g}"),
        ):
            if np.any(bad):
                raise InputError(f"{name} must be {wanted}, got {array[bad].flat[0]:g}")


ANY = Range()
NON_NEGATIVE = Range(0.0)
POSITIVE = Range(0.0, strict=True)
FRICTION = Range(0.0, infinite=True)


def check_datum(name: str, datum: Any, allowed: Range = ANY) -> None:
    """Check a coefficient as far as no mesh is needed; a function is checked where it is used.

    Raises
    ------
    InputError
        Naming the coefficient, the group and the value.
    """
    numbers = {} if callable(datum) else {name: datum}
    if isinstance(datum, Mapping):
        numbers = {f"{name}.{key}": value for key, value in datum.items()}
        if not numbers:
            raise InputError(f"{name} must name a group or more")
    elif isinstance(datum, Profile):
        allowed.check(f"{name}.values", datum.values)
    for label, value in numbers.items():
        # no words, True or lists of one, which numpy would turn into a number
        if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.number)):
            raise InputError(f"{label} must be a number, got {shown(value)}")
        allowed.check(label, value)


def evaluate(
    name: str,
    datum: Datum,
    points: ArrayLike,
    groups: Mapping[str, Indices],
    allowed: Range = ANY,
) -> Array:
    """Values of a coefficient at points of cells.

    Parameters
    ----------
    name : str
        What to call it in an error.
    datum : number, mapping, Profile or callable
    points : array_like, shape (2, cells, ...)
    groups : mapping of str to indices of cells
        What a mapping may name; every cell must be covered by exactly one named group.

    Returns
    -------
    ndarray, shape (cells, ...)
    """
    x = np.asarray(points)
    values = np.full(x.shape[1:], np.nan)
    if isinstance(datum, Mapping):
        _fill_groups(name, values, datum, groups)
    elif not callable(datum):
        values[:] = datum
    else:
        try:
            values[:] = np.asarray(datum(x), dtype=float)
        except InputError as error:
            raise InputError(f"{name}.{error}") from error
        except (TypeError, ValueError, OverflowError) as error:
            raise InputError(
                f"{name} must turn points of shape (2, ...) into numbers of shape (...); {error}"
            ) from error
    allowed.check(name, values)
    return values


def _fill_groups(
    name: str, values: Array, datum: Mapping[str, float], groups: Mapping[str, Indices]
) -> None:
    covered = np.zeros(len(values), dtype=int)
    for key, value in datum.items():
        if key not in groups:
            known = ", ".join(sorted(groups)) or "none"
            raise InputError(f"{name}.{key} is not a group here; there are: {known}")
        values[groups[key]] = value
        covered[groups[key]] += 1
        if covered.max() > 1:
            raise InputError(f"{name}.{key} overlaps another group of {name}; name disjoint ones")
    if not covered.all():
        open_groups = [key for key in sorted(groups) if not covered[groups[key]].all()]
        raise InputError(
            f"{name} gives no value for {', '.join(open_groups) or 'triangles of no group'}; "
            "cover every group"
        )
