"""Checksums of what defines a problem, part by part, so that one can say which part differs."""

from __future__ import annotations

import hashlib
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from sweepopt.loads import History, Separable
from sweepopt.problem import SweepingProcess
from sweepopt.sets import ConvexSet

SAMPLES = 256  # times at which C(t) is compared
ENTRIES = 2e7  # that the vectors there may have in all: more take seconds


def fingerprint(process: SweepingProcess, times: np.ndarray) -> dict[str, str]:
    """sha256 of A, B, u0, of the data that move C(t), and of C(t) at up to SAMPLES of the times.

    A function of time is compared by the values it gives there, data and shapes by their numbers.
    """
    count = int(np.clip(ENTRIES / process.dim, 16, SAMPLES))
    some = np.unique(np.linspace(0, len(times) - 1, count).astype(int))
    members = [process.C.at(t) for t in times[some].tolist()]
    data = [getattr(process.C, name, None) for name in ("center", "scale", "offsets")]
    parts = {"A": process.A, "B": process.B, "u0": process.u0, "C(t)": [*data, *members]}
    known: dict[int, str] = {}
    return {name: _checksum(part, known) for name, part in parts.items()}


def _checksum(value: Any, known: dict[int, str]) -> str:
    """sha256 of a nest of sets, loads, arrays and numbers; `known` are sets that many share."""
    if id(value) in known:
        return known[id(value)]
    parts: list[Any] | tuple[Any, ...] = []
    text = type(value).__name__
    if isinstance(value, ConvexSet):
        parts = _attributes(value)
    elif isinstance(value, Separable):
        parts = value.terms
    elif isinstance(value, History):
        parts = list(vars(value).values())
    elif isinstance(value, (list, tuple)):
        text, parts = "list", value
    elif sp.issparse(value):
        matrix = sp.csc_array(value)
        indices = matrix.indices.astype(np.int64), matrix.indptr.astype(np.int64)
        text, parts = "sparse", [matrix.shape, matrix.data, *indices]
    elif isinstance(value, np.ndarray):
        content = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        text = f"{value.dtype.str} {value.shape} {content}"
    elif value is None or isinstance(value, (str, bool, int, float, np.generic)):
        plain = value.item() if isinstance(value, np.generic) else value
        text = f"{type(plain).__name__} {plain!r}"
    whole = " ".join([text, *(_checksum(part, known) for part in parts)])
    checksum = hashlib.sha256(whole.encode()).hexdigest()
    if isinstance(value, ConvexSet):
        known[id(value)] = checksum
    return checksum


def _attributes(C: ConvexSet) -> list[Any]:
    """What a set is made of: its public attributes, none that are computed later."""
    later = {
        name
        for kind in type(C).__mro__
        for name, entry in vars(kind).items()
        if isinstance(entry, cached_property)
    }
    public = sorted(name for name in vars(C) if not name.startswith("_") and name not in later)
    entries = [entry for name in public for entry in (name, getattr(C, name))]
    if any(callable(entry) for entry in entries):  # what it does is seen in what it gives
        direction = np.cos(np.arange(C.dim) + 1.0)
        entries += [f"{C.support(z):.6e}" for z in (direction, -direction)]
    return entries
