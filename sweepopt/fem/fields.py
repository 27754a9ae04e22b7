"""Data that vary in space: a number, one per physical group, a profile, or a Python function."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sweepopt.checks import choice, number
from sweepopt.errors import InputError
from sweepopt.fem.mesh import Indices
from sweepopt.loads import check_points

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
        at, values = check_points("at", self.at, self.values)
        object.__setattr__(self, "at", at)
        object.__setattr__(self, "values", values)

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
    """

    name: str
    minimum: float | None = None
    strict: bool = False
    finite: bool = True

    def check(self, datum: Any) -> None:
        """Check the numbers of a datum; a function is checked where it is evaluated.

        Raises
        ------
        InputError
            Naming the coefficient, the group and the value.
        """
        limits = self[1:]
        if isinstance(datum, Mapping):
            for key, value in datum.items():
                number(f"{self.name}.{key}", value, *limits)
        elif not callable(datum):
            number(self.name, datum, *limits)

    def values(self, datum: Datum, points: ArrayLike, groups: Mapping[str, Indices]) -> Array:
        """Values at points of cells.

        Parameters
        ----------
        datum : number, mapping, Profile or callable
        points : array_like, shape (2, cells, ...)
        groups : mapping of str to indices of cells
            What a mapping may name; every cell must be covered by exactly one named group.

        Returns
        -------
        ndarray, shape (cells, ...)
        """
        x = np.asarray(points)
        values = np.empty(x.shape[1:])
        if isinstance(datum, Mapping):
            self._fill(values, datum, groups)
            return values
        try:
            values[:] = np.asarray(datum(x) if callable(datum) else datum, dtype=float)
        except InputError as error:
            raise InputError(f"{self.name}.{error}") from error
        except (TypeError, ValueError, OverflowError) as error:
            raise InputError(
                f"{self.name} must turn points of shape (2, ...) into numbers of shape (...); "
                f"{error}"
            ) from error
        for extreme in (values.min(), values.max()):
            self.check(extreme)
        return values

    def _fill(
        self, values: Array, datum: Mapping[str, float], groups: Mapping[str, Indices]
    ) -> None:
        times = np.zeros(len(values), dtype=int)
        for key, value in datum.items():
            if key not in groups:
                known = ", ".join(sorted(groups)) or "none"
                raise InputError(f"{self.name}.{key} is not a group here; there are: {known}")
            values[groups[key]] = value
            times[groups[key]] += 1
        if np.any(times != 1):
            wrong = [key for key in sorted(groups) if np.any(times[groups[key]] != 1)]
            raise InputError(
                f"{self.name} must give one value to each cell, but gives none or several in "
                f"{', '.join(wrong) or 'triangles of no group'}; cover every group once"
            )
