"""What a function given as `save` returned at each step, for a checkpoint: JSON and one array.

Numbers, tuples, lists and dicts become JSON; the bytes of all arrays, in order, become one array.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sweepopt.errors import InputError, shown


def pack(recorded: list[Any]) -> tuple[list[Any], np.ndarray]:
    """The records in terms of JSON, and the bytes of the arrays in them.

    Raises
    ------
    InputError
        If they are not numbers or arrays, alone or in tuples, lists and dicts.
    """
    content: list[bytes] = []

    def encoded(value: Any) -> Any:
        if value is None or type(value) in (bool, float):
            return value
        if type(value) is int and abs(value) < 2**63:  # Python writes no integer of any length
            return value
        if isinstance(value, (np.ndarray, np.generic)) and value.dtype.kind in "biuf":
            content.append(value.tobytes())
            kind = "array" if isinstance(value, np.ndarray) else "number"
            return {"kind": kind, "dtype": value.dtype.str, "shape": value.shape}
        if type(value) in (list, tuple):
            return {"kind": type(value).__name__, "parts": [encoded(part) for part in value]}
        if type(value) is dict and all(type(key) is str for key in value):
            return {"kind": "dict", "parts": {key: encoded(part) for key, part in value.items()}}
        raise InputError(
            "save: a function returns numbers or arrays, or tuples, lists and dicts of them, if "
            f"there is a checkpoint=; it returned {shown(value)}"
        )

    records = [encoded(record) for record in recorded]
    return records, np.frombuffer(b"".join(content), np.uint8)


def unpack(records: list[Any], content: np.ndarray) -> list[Any]:
    """What `pack` took."""
    position = 0

    def decoded(value: Any) -> Any:
        nonlocal position
        if not isinstance(value, dict):
            return value
        kind = value["kind"]
        if kind == "dict":
            return {key: decoded(part) for key, part in value["parts"].items()}
        if kind in ("list", "tuple"):
            parts = [decoded(part) for part in value["parts"]]
            return tuple(parts) if kind == "tuple" else parts
        dtype, shape = np.dtype(value["dtype"]), value["shape"]
        begin, position = position, position + int(np.prod(shape)) * dtype.itemsize
        array = np.frombuffer(content[begin:position].tobytes(), dtype).reshape(shape).copy()
        return array if kind == "array" else array[()]

    return [decoded(record) for record in records]
