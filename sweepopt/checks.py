"""Turn what a user passes into finite float arrays, or say which entry is wrong and why."""

import math
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import wraps
from inspect import ismodule, signature
from types import MappingProxyType
from typing import Any, TypeAlias, TypeVar

import numpy as np
import scipy.sparse as sp
from scipy.linalg import blas

from sweepopt.errors import InputError, note, shown, suggestion

F = TypeVar("F")
R = TypeVar("R")
Array: TypeAlias = np.ndarray
Matrix: TypeAlias = Any  # np.ndarray or scipy.sparse.csr_array, as `matrix` returns them

HUGE = 1e75
"""Numbers beyond this overflow when a few of them are multiplied."""
TIME_SLACK = 1e-12
"""Share of the time scale by which a time may miss a node or a range: rounding of t0 + i mu."""
MEMORY = 4e9
"""Bytes that the kept states of a run may take if nobody says more."""
LONGEST = 10**8
"""Unknowns, or steps of a run, at most: vectors, or times and statistics, alone take gigabytes."""


def meaning(**arguments: str) -> Callable[[F], F]:
    """Note on a public name what stands here for arguments of other libraries."""

    def noted(thing: F) -> F:
        thing.meaning = arguments  # type: ignore[attr-defined]
        return thing

    return noted


def public(thing: Any) -> Any:
    """A name of the public face: what is no argument of it is an InputError with a remedy.

    Classes are changed in place, functions in their modules, so that they can be pickled.
    """
    if isinstance(thing, type):
        for name in vars(thing).keys() & {"__new__", "__init__"}:
            setattr(thing, name, with_checks(getattr(thing, name), thing))
    elif callable(thing):
        thing = with_checks(thing)
        setattr(sys.modules[thing.__module__], thing.__name__, thing)
    return thing


def face(names: dict[str, Any]) -> list[str]:
    """The public names of a room: what its `__init__` imports but for modules; `dir` shows them."""
    things = {key: one for key, one in names.items() if key[0] != "_" and not ismodule(one)}
    names.update({key: public(one) for key, one in things.items()}, __dir__=things.keys)
    return sorted(things)


def with_checks(function: Any, owner: Any = None) -> Any:
    """The function, which names its arguments where it is called with others."""
    owner = owner or function
    call, name = signature(function), owner.__name__
    meant = vars(owner).get("meaning") or getattr(function, "meaning", {})
    every = [one for key, one in call.parameters.items() if key not in ("self", "cls", "_cls")]
    known = [one.name for one in every if one.kind is not one.VAR_KEYWORD]
    none = "give them by name" if len(known) < len(every) else "it takes none"
    only = [key for key, one in call.parameters.items() if one.kind is one.KEYWORD_ONLY]

    @wraps(function)
    def checked(*args: Any, **named: Any) -> Any:
        try:
            return function(*args, **named)
        except TypeError:
            try:
                call.bind(*args, **named)
            except TypeError as error:
                all_names = ", ".join(known)
                remedy = f"give by name {all_names}" if known else none
                if only and "missing" not in str(error):
                    remedy = f"give by name, as {only[0]}=...: {', '.join(only)}"
                fault = f"{name}: {error}; {remedy}"
                for unknown in (key for key in named if key not in known):
                    hint = meant.get(unknown) or suggestion(unknown, known)
                    fault = f"{name} has no argument {unknown}{hint or f'; there are: {all_names}'}"
                raise InputError(fault) from None
            raise

    return checked


def takes(name: str, function: Any, *given: str, remedy: str = "") -> None:
    """Refuse what is no function of the given arguments, as far as its signature tells."""
    wanted = f"{name} must be a function of ({', '.join(given)}), got {shown(function)}"
    if not callable(function):
        raise InputError(wanted)
    try:
        call = signature(function)
        call.bind(*given)
        names = [*call.parameters][: len(given)]
        if names != [*given] and {*names} == {*given}:
            raise TypeError("the same names in another order")
    except TypeError as error:
        raise InputError(f"{wanted} ({error}){remedy}") from None
    except ValueError:  # some of other languages have no signature
        return


def from_table(
    where: str,
    kind: Callable[..., R],
    table: Any,
    read: Callable[[str, Any], Any] = lambda _, value: value,
    missing: Mapping[str, str] = MappingProxyType({}),
    **given: Any,
) -> R:
    """What a function or a record makes of a table whose keys are its arguments.

    Parameters
    ----------
    where : str
        What errors put in front of a key, such as "effects.friction.".
    read : callable (key, value)
        Makes an argument of a value of the table.
    missing : mapping of str to str
        Ends of the message that a key is missing.
    given : dict
        Arguments that are no keys.
    """
    keys = {name: one for name, one in signature(kind).parameters.items() if name not in given}
    if not isinstance(table, Mapping):
        paths = ", ".join(f"{where}{key}" for key in keys) or "none"
        raise InputError(
            f"{where.rstrip('.')}: must be a table, got {shown(table)}; its keys are: {paths}"
        )
    known, meant = ", ".join(keys), getattr(kind, "meaning", {})
    faults = [
        f"{where}{key}: unknown key; there are: {known}{meant.get(key) or suggestion(key, keys)}"
        for key in table
        if key not in keys
    ]
    faults += [
        f"{where}{key}: is missing{missing.get(key, '')}"
        for key, argument in keys.items()
        if argument.default is argument.empty and key not in table
    ]
    if faults:
        raise InputError("; ".join(faults))
    values = {key: read(key, value) for key, value in table.items()}
    with at_path(where):
        return kind(**values, **given)


@contextmanager
def at_path(where: str) -> Iterator[None]:
    """Put a path in front of the messages of input errors, which start with a field's name."""
    try:
        yield
    except InputError as error:
        error.args = (f"{where}{error}",)  # the same error: one traceback, which has its place
        raise
    except Exception as error:  # of a user's class or function
        if where:
            note(error, f"This was raised for {where.rstrip('.: ')}.")
        raise


def agree(**sizes: int) -> None:
    """Refuse arguments whose numbers of unknowns differ, blaming those that differ from most."""
    (most, _), *others = Counter(sizes.values()).most_common()
    if others:
        odd = " and ".join(name for name, size in sizes.items() if size != most)
        every = ", ".join(
            f"{name} is {size} x {size}" if name in "AB" else f"{name} has dim {size}"
            for name, size in sizes.items()
        )
        size = sizes.get("dissipation", sizes.get("C", most))
        hint = "; a set for some unknowns E u is so.image(E.T, set)" * (size < most)
        if {sizes.get("A"), sizes.get("B")} & {1} and most > 1:
            hint = f"; a number a of each unknown is a * sp.eye_array({most})"
        if size == 1 < most:
            g = f"g * np.ones({most})"
            hint = f"; a bound g of each unknown is so.Box(-{g}, {g})"
        raise InputError(f"{every}: give all the same number of unknowns; at odds: {odd}{hint}")


def number(
    name: str,
    value: Any,
    minimum: float | None = None,
    strict: bool = False,
    finite: bool = True,
) -> float:
    """A finite float, at least (or above) `minimum`; no True or False, and no list of one."""
    if type(value) is float and abs(value) <= HUGE:  # as in every step
        result = value
    else:
        array = floats(name, value, "one number")
        if array.ndim:
            raise InputError(
                f"{name} must be one number, got {array.size} of them in a list; give the number "
                "itself"
            )
        result = float(bounded(name, array, "a finite number" if finite else "a number", finite))
    if minimum is not None and (result < minimum or (strict and result == minimum)):
        raise InputError(f"{name} must be {'>' if strict else '>='} {minimum:g}, got {result:g}")
    if strict and minimum == 0:
        divisor(name, result)
    return result


def tolerance(tol: Any) -> float:
    """A positive number below 1, which is relative to the size of a velocity."""
    result = number("tol", tol, minimum=0.0, strict=True)
    if result >= 1:
        raise InputError(
            f"tol must be < 1, got {result:g}: it is relative, and from 1 on no motion passes "
            "for any; give 1e-6 for example"
        )
    return result


def instant(name: str, value: Any) -> float:
    """A finite time or value of a function: one number in any wrapping, a float at no cost."""
    if isinstance(value, float) and math.isfinite(value):
        return float(value)
    array = floats(name, value, "one number")
    return number(name, array.reshape(()) if array.size == 1 else array)


def axes(value: Any) -> int:
    """How many axes an array_like has; one if its lists have different lengths."""
    try:
        return np.ndim(value)
    except ValueError:
        return 1


def divisor(name: str, value: float) -> None:
    """Refuse a positive number by which nothing can be divided without overflow."""
    if value < 1 / HUGE:
        raise InputError(
            f"{name} is {value:g}, below {1 / HUGE:g}: what it divides would overflow; choose "
            "other units"
        )


def count(name: str, value: Any, least: int = 1, most: float = math.inf, remedy: str = "") -> int:
    """A whole number, positive or at least 0; 100.0 is one."""
    if isinstance(value, (float, np.floating)) and value.is_integer():
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        wanted = "a positive whole number" if least == 1 else f"a whole number >= {least}"
        raise InputError(f"{name} must be {wanted}, got {shown(value)}")
    if value > most:
        raise InputError(f"{name} is {shown(value)}, more than {most:.0e}; {remedy}")
    return int(value)


def step_count(steps: Any) -> int:
    """A positive whole number of steps."""
    return count("steps", steps, most=LONGEST, remedy="run it in parts")


def dimension(dim: Any) -> int:
    """A positive whole number of unknowns."""
    return count("dim", dim, most=LONGEST, remedy="its vectors fill the memory")


def choice(name: str, value: Any, allowed: Iterable[str]) -> str:
    """One of the words that are allowed."""
    words = tuple(allowed)
    if not isinstance(value, str) or value not in words:
        known = ", ".join(word or "'' (left out)" for word in words)
        raise InputError(
            f"{name} must be one of {known}; got {shown(value)}{suggestion(value, words)}"
        )
    return value


def listed(
    name: str, value: Any, check: Callable[..., Any] = lambda _, entry: entry, *limits: Any
) -> tuple[Any, ...]:
    """A list with one entry or more, each of them checked by its name, such as "cells[0]"."""
    if not isinstance(value, (list, tuple)) or not value:
        raise InputError(f"{name} must be a list with one entry or more, got {shown(value)}")
    return tuple(check(f"{name}[{k}]", entry, *limits) for k, entry in enumerate(value))


def vector(name: str, value: Any, dim: int | None = None, finite: bool = True) -> Array:
    """A float array of shape (dim,); a scalar counts as one entry."""
    array = floats(name, value, "an array of numbers", ndmin=1)
    if array.ndim != 1:
        flat = "; flatten it by np.ravel" if array.size == max(array.shape) else ""
        raise InputError(f"{name} must have one axis, got shape {array.shape}{flat}")
    if dim is not None and array.size != dim:
        raise InputError(f"{name} must have {dim} entries, got {array.size}")
    if array.size and blas.dnrm2(array) <= HUGE:  # as most are; much quicker than entry by entry
        return array
    return bounded(name, array, "finite numbers" if finite else "numbers", finite)


def read_only(array: Array) -> Array:
    """An array that nobody can change."""
    array.setflags(write=False)
    return array


def entries(name: str, value: Any, finite: bool = True) -> Array:
    """A float vector with at least one entry, as no set has dim 0, that nobody can change."""
    result = read_only(vector(name, value, finite=finite))
    if not result.size:
        raise InputError(f"{name} must have at least one entry")
    return result


def times(t: Any) -> Array:
    """Finite times as floats, of any shape; () for one of them."""
    return bounded("t", floats("t", t, "a time or an array of times"), "finite times")


def increasing(name: str, value: Any, remedy: str = "", rows: Sequence[int] = ()) -> Array:
    """Two numbers or more in order; errors call them by their rows of a file if these are given."""
    result = entries(name, value)
    if result.size < 2:
        raise InputError(f"{name} must have two entries or more")
    late = np.flatnonzero(np.diff(result) < 1 / HUGE)
    if late.size:
        k = int(late[0])
        places = [f"row {row}" for row in rows] or [f"entry {i}" for i in range(result.size)]
        raise InputError(
            f"{name} must increase strictly, but {places[k + 1]} ({result[k + 1]:g}) follows "
            f"{places[k]} ({result[k]:g}){remedy}"
        )
    return result


def times_inside(value: Any, nodes: Array) -> Array:
    """Times between the ends of a run; one that misses a node by rounding is that node."""
    array, (start, end) = times(value), nodes[[0, -1]].tolist()
    slack = TIME_SLACK * max(abs(start), abs(end))
    outside = ~((array >= start - slack) & (array <= end + slack))
    if outside.any():
        raise InputError(f"t = {array[outside].flat[0]:g} is outside of [{start:g}, {end:g}]")
    nearest = nodes[np.minimum(np.searchsorted(nodes, array - slack), len(nodes) - 1)]
    return np.where(np.abs(nearest - array) <= slack, nearest, array)


def matrix(name: str, value: Any) -> Matrix:
    """A finite float matrix with two axes: dense as an ndarray, sparse as CSR.

    A copy whose entries nobody can change, as what is made of them would not follow.
    """
    if sp.issparse(value):
        result = sp.csr_array(value, copy=True)
        result.sum_duplicates()  # in place, which others do later where it is not done
        result.data = read_only(floats(name, result.data, "a matrix of numbers"))
    else:
        result = read_only(floats(name, value, "a matrix of numbers"))
    if result.ndim != 2:
        raise InputError(
            f"{name} must have two axes, got shape {result.shape}; one row is [[1.0, 2.0]], a "
            "diagonal matrix np.diag(values)"
        )
    return bounded(name, result, "finite numbers")


def symmetric(name: str, value: Any, dim: int | None = None) -> Matrix:
    """A finite symmetric matrix; an asymmetry above rounding is refused with its entry.

    A number is that of one unknown. An asymmetry of rounding is taken out: factors look at one
    triangle, residuals at both.
    """
    if not sp.issparse(value) and axes(value) == 0:
        value = floats(name, value, "a matrix of numbers", ndmin=2)
    result = matrix(name, value)
    rows, columns = result.shape
    if not rows:
        raise InputError(f"{name} has no entries; give at least one unknown")
    if rows != columns or (dim is not None and rows != dim):
        wanted = "square" if dim is None else f"of shape ({dim}, {dim})"
        raise InputError(f"{name} must be {wanted}, got shape {result.shape}")
    difference = abs(result - result.T)
    if difference.max() > 1e-12 * abs(result).max():
        i, j = np.unravel_index(difference.argmax(), difference.shape)
        raise InputError(
            f"{name} must be symmetric: {name}[{i}, {j}] = {result[i, j]:.15g} but "
            f"{name}[{j}, {i}] = {result[j, i]:.15g}; leave out rows and columns of what is held, "
            "if a finite element code has put a 1 on the diagonal there (with scikit-fem: condense,"
            f" not enforce); pass ({name} + {name}.T) / 2 if rounding did it"
        )
    if difference.max() > 0:
        result = matrix(name, 0.5 * (result + result.T))
    return result


def floats(name: str, value: Any, what: str, ndmin: int = 0) -> Array:
    """A float copy of value; complex and logical numbers and words are refused, not cast."""
    if type(value) is np.ndarray and value.dtype == float and value.ndim >= ndmin:
        return value.copy("K")  # as in every step
    try:
        if isinstance(value, np.ma.MaskedArray):  # under a mask there is any number
            value = np.ma.filled(value.astype(float), np.nan)
        array = np.array(value, ndmin=ndmin)
        for entry in array.flat if array.dtype == object else ():
            if entry is None:
                raise TypeError("None is no number; a function without return gives it")
            if not hasattr(entry, "__float__"):
                remedy = "; give its .toarray().ravel()" if sp.issparse(value) else ""
                raise TypeError(f"{type(entry).__name__} is no number{remedy}")
        if array.dtype.kind in "SU":
            raise TypeError("text is no number; leave out the quotes")
        if array.dtype.kind not in "iufO":
            raise TypeError(f"entries are {array.dtype}; give numbers")
        with np.errstate(over="ignore"):
            result = array.astype(float, copy=False)
        if np.isinf(result).any() and (array != result).any():
            raise OverflowError("an entry is beyond the largest float; choose other units")
        return result
    except (TypeError, ValueError, OverflowError) as error:
        reason, several = str(error), (list, tuple)
        if "inhomogeneous" in reason:
            reason = "its rows have different lengths"
        pairs = value if isinstance(value, several) else []
        pairs = [one if isinstance(one, several) else [one] for one in pairs]
        if any(callable(part) for pair in pairs for part in pair):
            reason = "histories with their vectors are so.Separable([(phi, f), ...])"
        raise InputError(f"{name} must be {what}, got {shown(value)} ({reason})") from None


def bounded(name: str, value: Matrix, wanted: str, finite: bool = True) -> Matrix:
    """The array, unless an entry is nan, infinite, or so large that products overflow."""
    entries = value.data if sp.issparse(value) else value
    bad = ~(np.abs(entries) <= HUGE)
    if not finite:
        bad &= ~np.isinf(entries)
    if not bad.any():
        return value
    entry, place = entries[bad][0], np.argwhere(bad)[0]
    if sp.issparse(value):
        place = np.transpose(sp.coo_array(value).coords)[place[0]]
    at = f"[{', '.join(map(str, place))}]" if len(place) else ""
    label = f"entry {at} of {name}" if at and " " in name else name + at
    if not math.isfinite(entry):
        raise InputError(f"{label} is {entry}; give {wanted}")
    raise InputError(
        f"{label} is {entry:g}, beyond {HUGE:g}: products overflow; choose other units"
    )


def require_columns(table: Any, columns: Iterable[str]) -> None:
    """Refuse what is no table with these columns."""
    if missing := [name for name in columns if name not in getattr(table, "columns", ())]:
        raise InputError(
            f"table lacks the columns {missing}; pass the table of a study, or of compare, as it is"
        )
