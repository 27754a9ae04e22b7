"""The study's table as the diagram and the report read it: one row a cell, plain Python values."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from math import nan
from typing import TYPE_CHECKING, Any, TypeAlias

from sweepopt.errors import InputError

if TYPE_CHECKING:
    from pandas import DataFrame

Cell: TypeAlias = dict[str, Any]


def _flag(value: Any) -> bool:
    if value not in (0, 1):
        raise ValueError("not True or False")
    return bool(value)


def _whole(value: Any) -> int | float:
    if value != int(value):
        raise ValueError("not a whole number")
    return int(value)


# how an entry is read; what is missing is "", False or nan
TEXT, NUMBER, WHOLE, FLAG = str, float, _whole, _flag
MISSING: dict[Any, Any] = {TEXT: "", FLAG: False, NUMBER: nan, WHOLE: nan}
VERSIONS = ("sweepopt", "python", "numpy", "scipy", "cvxpy", "clarabel", "osqp")
COLUMNS: dict[str, Callable[[Any], Any]] = {
    **dict.fromkeys(("problem", "scheme", "solver"), TEXT),
    "steps": WHOLE,
    "tol": NUMBER,
    "status": TEXT,
    "success": FLAG,
    "message": TEXT,
    "error": NUMBER,
    "error_is": TEXT,
    "bound": NUMBER,
    "guaranteed": FLAG,
    **dict.fromkeys(("certificate", "wall", "cpu"), NUMBER),
    **dict.fromkeys(("repeats", "steps_done", "solver_calls", "unknowns"), WHOLE),
    **dict.fromkeys(("path", *VERSIONS, "machine", "cell"), TEXT),
}
COSTS = {
    "wall": "wall time (s)",
    "cpu": "processor time (s)",
    "steps": "time steps",
    "solver_calls": "solver calls",
}
ACCURACIES = {"error": "largest error over the steps", "bound": "bound of the error"}


def read_cells(table: DataFrame, columns: Iterable[str] = COLUMNS) -> list[Cell]:
    """The rows of a study's table as dicts of str, int, float and bool.

    Parameters
    ----------
    table : pandas DataFrame
    columns : iterable of str
        The columns to read, all of which must be there.

    Raises
    ------
    InputError
        If the table is no DataFrame, has no row, lacks a column or has an entry of another kind.
    """
    wanted = list(dict.fromkeys(columns))
    if not hasattr(table, "columns") or not hasattr(table, "iloc"):
        raise InputError(f"table must be a pandas DataFrame, got {type(table).__name__}")
    missing = [name for name in wanted if name not in table.columns]
    if missing:
        raise InputError(f"table lacks the columns {missing}; pass the table of a study as it is")
    if not len(table):
        raise InputError("table has no rows; run the study first")
    read = [_column(name, table[name]) for name in wanted]
    return [dict(zip(wanted, row, strict=True)) for row in zip(*read, strict=True)]


def _column(name: str, column: Any) -> list[Any]:
    kind = COLUMNS[name]
    values = []
    for row, (value, absent) in enumerate(zip(column.tolist(), column.isna(), strict=True)):
        try:
            values.append(MISSING[kind] if absent else kind(value))
        except (TypeError, ValueError, OverflowError) as error:
            what = {TEXT: "text", FLAG: "True or False", WHOLE: "a whole number"}
            wanted = what.get(kind, "a number")
            raise InputError(
                f"table[{name!r}] has {value!r} in row {row}; give {wanted}"
            ) from error
    return values


def distinct(cells: Iterable[Cell], name: str) -> list[Any]:
    """The values of a column, each once, in the order of the table."""
    return list(dict.fromkeys(cell[name] for cell in cells))
