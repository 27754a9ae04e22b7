"""Checksums of what defines a problem, part by part, so that one can say which part differs."""

from __future__ import annotations

import hashlib
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from sweepopt.loads import DATA, Separable
from sweepopt.problem import SweepingProcess
from sweepopt.sets import ConvexSet

SAMPLES = 256  # times at which C(t) is compared
ENTRIES = 2e7  # that their vectors may have in all


def fingerprint(process: SweepingProcess, times: np.ndarray) -> dict[str, str]:
    """sha256 of A, B, u0, of the data that move C(t), and of C(t) at up to SAMPLES of the times.

    A function of time is compared by the values it gives there, data and shapes by their numbers.
    """
    count = int(np.clip(ENTRIES / process.dim, 16, SAMPLES))
    some = np.unique(np.linspace(0, len(times) - 1, count).astype(int))
    members = [process.C.at(t) for t in times[some].tolist()]
    data = [getattr(process.C, name, None) for name in ("center", "scale", "offsets")]
    parts = {"A": process.A, "B": process.B, "u0": process.u0, "C(t)": [*data, *members]}
    return {name: _Digest()(part) for name, part in parts.items()}


class _Digest:
    """The checksum of a nest of sets, arrays and numbers."""

    def __init__(self) -> None:
        self._known: dict[int, str] = {}  # shapes that many members share, by their id

    def __call__(self, value: Any) -> str:
        if isinstance(value, ConvexSet):
            if id(value) not in self._known:
                self._known[id(value)] = self._of(type(value).__name__, *self._entries(value))
            return self._known[id(value)]
        if sp.issparse(value):
            entries = sp.csc_array(value)
            indices = entries.indices.astype(np.int64), entries.indptr.astype(np.int64)
            return self._of("sparse", entries.shape, entries.data, *indices)
        if isinstance(value, np.ndarray):
            array = np.ascontiguousarray(value)
            content = hashlib.sha256(array.tobytes()).hexdigest()
            return self._of(array.dtype.str, str(array.shape), content)
        if isinstance(value, Separable):
            return self._of("Separable", *value.terms)
        if isinstance(value, DATA):
            return self._of(type(value).__name__, *(vars(value)[name] for name in vars(value)))
        if isinstance(value, (list, tuple)):
            return self._of("list", *value)
        value = value.item() if isinstance(value, np.generic) else value
        if isinstance(value, (str, bool, int, float)) or value is None:
            return _sha(f"{type(value).__name__} {value!r}")
        return _sha(type(value).__name__)

    def _of(self, kind: str, *parts: Any) -> str:
        return _sha(" ".join([kind, *map(self, parts)]))

    def _entries(self, C: ConvexSet) -> list[Any]:
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


def _sha(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
