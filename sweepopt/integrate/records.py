"""What a function recorded at each step, as arrays: numbers, arrays and tuples of these."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from sweepopt.errors import InputError, shown

PLAIN = {"bool": bool, "int": int, "float": float}
LARGEST = {bool: 1, int: 2**63 - 1, float: np.inf}  # that an array holds


def packed(recorded: list[Any]) -> tuple[Any, list[np.ndarray]]:
    """The form of the records in terms of JSON, and an array for each number or array in them.

    Raises
    ------
    InputError
        If they are not numbers or arrays, alone or in tuples, lists and dicts, all alike.
    """
    if not recorded:
        return None, []
    form, _ = _split(recorded[0])
    rows = []
    for record in recorded:
        own, leaves = _split(record)
        if own != form:
            raise InputError(
                "save: with checkpoint= all records must be alike, the same types and shapes; one "
                f"is {shown(recorded[0])}, another {shown(record)}"
            )
        rows.append(leaves)
    return form, [np.array(column) for column in zip(*rows, strict=True)]


def unpacked(form: Any, columns: Mapping[int, np.ndarray], count: int) -> list[Any]:
    """The records from their form and their arrays."""
    return [_joined(form, iter([columns[k][i] for k in range(len(columns))])) for i in range(count)]


def _split(record: Any) -> tuple[Any, list[Any]]:
    """Form and leaves of one record."""
    if record is None:
        return "none", []
    if type(record) in PLAIN.values() and not abs(record) > LARGEST[type(record)]:
        return type(record).__name__, [record]
    if isinstance(record, (np.ndarray, np.generic)) and record.dtype.kind in "biuf":
        return [record.dtype.str, list(record.shape), isinstance(record, np.ndarray)], [record]
    if type(record) in (tuple, list):
        parts = [_split(part) for part in record]
        form: Any = {type(record).__name__: [form for form, _ in parts]}
    elif type(record) is dict and all(type(key) is str for key in record):
        parts = [_split(part) for part in record.values()]
        form = {"dict": [form for form, _ in parts], "keys": list(record)}
    else:
        raise InputError(
            "save: a function returns numbers or arrays, or tuples, lists and dicts of them, if "
            f"there is a checkpoint=; it returned {shown(record)}"
        )
    return form, [leaf for _, leaves in parts for leaf in leaves]


def _joined(form: Any, leaves: Any) -> Any:
    if form == "none":
        return None
    if isinstance(form, str):
        return PLAIN[form](next(leaves))
    if isinstance(form, list):
        return np.array(next(leaves)) if form[2] else next(leaves)
    if "dict" in form:
        return {key: _joined(f, leaves) for key, f in zip(form["keys"], form["dict"], strict=True)}
    ((kind, forms),) = form.items()
    parts = [_joined(part, leaves) for part in forms]
    return tuple(parts) if kind == "tuple" else parts
