"""Nests of numbers and arrays as JSON and one array of bytes, for a checkpoint.

What a function given as `save` returned at each step: numbers, tuples, lists and dicts become JSON;
the bytes of all arrays in them, in order, one array.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sweepopt.errors import InputError, shown


def pack(records: list[Any]) -> tuple[list[Any], np.ndarray]:
    """The records in terms of JSON, and the bytes of the arrays in them.

    Raises
    ------
    InputError
        If they are not numbers or arrays, alone or in tuples, lists and dicts.
    """
    content: list[bytes] = []

    def encoded(value: Any) -> Any:
        kind = type(value)
        if value is None or kind in (bool, float) or (kind is int and abs(value) < 2**63):
            return value  # Python writes no integer of any length
        if isinstance(value, (np.ndarray, np.generic)) and value.dtype.kind in "biuf":
            content.append(value.tobytes())
            return {"dtype": value.dtype.str, "shape": value.shape, "array": kind is np.ndarray}
        if kind in (list, tuple):
            return {kind.__name__: [encoded(part) for part in value]}
        if kind is dict and all(type(key) is str for key in value):
            return {"dict": {key: encoded(part) for key, part in value.items()}}
        raise InputError(
            "save: a function returns numbers or arrays, or tuples, lists and dicts of them, if "
            f"there is a checkpoint=; it returned {shown(value)}"
        )

    packed = [encoded(record) for record in records]
    return packed, np.frombuffer(b"".join(content), np.uint8)


def unpack(packed: list[Any], content: np.ndarray) -> list[Any]:
    """What `pack` took."""
    data, position = content.tobytes(), 0

    def decoded(value: Any) -> Any:
        nonlocal position
        match value:
            case {"dict": parts}:
                return {key: decoded(part) for key, part in parts.items()}
            case {"list": parts}:
                return [decoded(part) for part in parts]
            case {"tuple": parts}:
                return tuple(map(decoded, parts))
            case {"dtype": dtype, "shape": shape, "array": is_array}:
                size = math.prod(shape)
                flat = np.frombuffer(data, dtype, size, position)
                position += flat.nbytes
                array = flat.reshape(shape).copy()
                return array if is_array else array[()]
        return value

    return [decoded(record) for record in packed]
