"""Nests of numbers, text and arrays as JSON, for a checkpoint: they come back to the last bit."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np


def encoded(value: Any) -> Any:
    """The nest in terms of JSON.

    Raises
    ------
    TypeError
        If it is none of numbers, text and arrays, alone or in tuples, lists and dicts.
    """
    kind = type(value)
    if value is None or kind in (bool, float, str) or (kind is int and abs(value) < 2**63):
        return value  # Python writes no integer of any length
    if isinstance(value, (np.ndarray, np.generic)) and value.dtype.kind in "biuf":
        content = base64.b64encode(value.tobytes()).decode()
        return {
            "array": kind is np.ndarray,
            "dtype": value.dtype.str,
            "shape": value.shape,
            "bytes": content,
        }
    if kind in (list, tuple):
        return {kind.__name__: [encoded(part) for part in value]}
    if kind is dict and all(type(key) is str for key in value):
        return {"dict": {key: encoded(part) for key, part in value.items()}}
    raise TypeError(f"{kind.__name__} is not stored")


def decoded(value: Any) -> Any:
    """What `encoded` took."""
    match value:
        case {"dict": parts}:
            return {key: decoded(part) for key, part in parts.items()}
        case {"list": parts}:
            return [decoded(part) for part in parts]
        case {"tuple": parts}:
            return tuple(map(decoded, parts))
        case {"array": is_array, "dtype": dtype, "shape": shape, "bytes": content}:
            flat = np.frombuffer(base64.b64decode(content), dtype)
            return flat.reshape(shape).copy() if is_array else flat[0]
    return value
