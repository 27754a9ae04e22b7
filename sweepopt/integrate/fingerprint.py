"""Checksums of what defines a problem, part by part, so that one can say which part differs."""

from __future__ import annotations

import hashlib
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from sweepopt.loads import History, Separable
from sweepopt.problem import SweepingProcess
from sweepopt.sets import ConvexSet, MovingSet

SAMPLES = 256  # times at which C(t) is compared
ENTRIES = 2e7  # that the vectors there may have in all: more take seconds


def fingerprint(process: SweepingProcess, times: np.ndarray) -> dict[str, str]:
    """sha256 of A, B, u0, of the data in C, and of C(t) at up to SAMPLES of the times.

    A function of time is compared by the values it gives there, data and shapes by their numbers.
    """
    count = int(np.clip(ENTRIES / process.dim, 16, SAMPLES))
    some = np.unique(np.linspace(0, len(times) - 1, count).astype(int))
    members = [process.C.at(t) for t in times[some].tolist()]
    parts = {"A": process.A, "B": process.B, "u0": process.u0, "C(t)": [process.C, members]}
    known: dict[int, str] = {}
    return {name: _checksum(part, known) for name, part in parts.items()}


def _checksum(value: Any, known: dict[int, str]) -> str:
    """sha256 of a nest of sets, loads, arrays and numbers; `known` are sets that many share."""
    if id(value) in known:
        return known[id(value)]
    text: str = type(value).__name__
    parts: list[Any] = []
    if isinstance(value, (ConvexSet, MovingSet, Separable, History)):
        parts = _attributes(value)
    elif isinstance(value, (list, tuple)):
        parts = list(value)
    elif sp.issparse(value):
        matrix = sp.csc_array(value)
        places = (index.astype(np.int64) for index in (matrix.indices, matrix.indptr))
        parts = [matrix.shape, matrix.data, *places]
    elif isinstance(value, np.ndarray):
        content = hashlib.sha256(np.ascontiguousarray(value).data).hexdigest()
        text = f"{value.dtype.str} {value.shape} {content}"
    elif value is None or isinstance(value, (str, int, float, np.generic)):
        text = repr(value.item() if isinstance(value, np.generic) else value)
    whole = " ".join([text, *(_checksum(part, known) for part in parts)])
    checksum = hashlib.sha256(whole.encode()).hexdigest()
    if isinstance(value, ConvexSet):
        known[id(value)] = checksum
    return checksum


def _attributes(value: Any) -> list[Any]:
    """What a set or a load is made of: its public attributes, none that are computed later."""
    kinds = [vars(kind) for kind in type(value).__mro__]
    later = {name for kind in kinds for name in kind if isinstance(kind[name], cached_property)}
    names = sorted(name for name in vars(value).keys() - later if name[0] != "_")
    entries = [*names, *(getattr(value, name) for name in names)]
    if isinstance(value, ConvexSet) and any(map(callable, entries)):
        # what a function in it does is seen in what it gives
        direction = np.cos(np.arange(value.dim) + 1.0)
        entries += [f"{value.support(z):.6e}" for z in (direction, -direction)]
    return entries
