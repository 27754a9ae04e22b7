"""What a function given as `save` returned at each step, as JSON and arrays for a checkpoint.

Each record is split into its numbers and arrays and a description of what holds them. All records
must have one description, so that the k-th numbers of all of them are one array.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from sweepopt.errors import InputError, shown

NUMBERS = {"bool": bool, "int": int, "float": float}
LARGEST = {bool: 1, int: 2**63 - 1, float: np.inf}  # that an array holds


def pack(recorded: list[Any]) -> tuple[Any, list[np.ndarray]]:
    """The description of the records in terms of JSON, and an array for each number in them.

    Raises
    ------
    InputError
        If they are not numbers or arrays, alone or in tuples, lists and dicts, all alike.
    """
    if not recorded:
        return None, []
    description, _ = _split(recorded[0])
    rows = []
    for record in recorded:
        own, leaves = _split(record)
        if own != description:
            raise InputError(
                "save: with checkpoint= all records must be alike, the same types and shapes; one "
                f"is {shown(recorded[0])}, another {shown(record)}"
            )
        rows.append(leaves)
    return description, [np.array(column) for column in zip(*rows, strict=True)]


def unpack(description: Any, columns: Mapping[int, np.ndarray], count: int) -> list[Any]:
    """The records from their description and their arrays."""
    order = range(len(columns))
    return [_join(description, iter([columns[k][i] for k in order])) for i in range(count)]


def _split(record: Any) -> tuple[Any, list[Any]]:
    """Description, numbers and arrays of one record."""
    if record is None:
        return "none", []
    if type(record) in LARGEST and not abs(record) > LARGEST[type(record)]:
        return type(record).__name__, [record]
    if isinstance(record, (np.ndarray, np.generic)) and record.dtype.kind in "biuf":
        return [record.dtype.str, list(record.shape), isinstance(record, np.ndarray)], [record]
    if type(record) in (tuple, list):
        keys, values = None, record
    elif type(record) is dict and all(type(key) is str for key in record):
        keys, values = list(record), record.values()
    else:
        raise InputError(
            "save: a function returns numbers or arrays, or tuples, lists and dicts of them, if "
            f"there is a checkpoint=; it returned {shown(record)}"
        )
    parts = [_split(part) for part in values]
    description = {
        "kind": type(record).__name__,
        "keys": keys,
        "parts": [part for part, _ in parts],
    }
    return description, [leaf for _, leaves in parts for leaf in leaves]


def _join(description: Any, leaves: Iterator[Any]) -> Any:
    if description == "none":
        return None
    if isinstance(description, str):
        return NUMBERS[description](next(leaves))
    if isinstance(description, list):
        return np.array(next(leaves)) if description[2] else next(leaves)
    parts = [_join(part, leaves) for part in description["parts"]]
    if description["keys"] is not None:
        return dict(zip(description["keys"], parts, strict=True))
    return tuple(parts) if description["kind"] == "tuple" else parts
