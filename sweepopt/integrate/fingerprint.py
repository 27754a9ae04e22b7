"""Checksums of what defines a problem, part by part, so that one can say which part differs."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from sweepopt.loads import History
from sweepopt.problem import SweepingProcess, motion
from sweepopt.sets import ConvexSet

SAMPLES = 256  # times at which C(t) is compared
ENTRIES = 2e7  # that the vectors there may have in all: more take seconds


def fingerprint(process: SweepingProcess, times: np.ndarray) -> dict[str, str]:
    """sha256 of A, B, u0, of the data in C, and of C(t) at up to SAMPLES of the times.

    A function of time is compared by the values it gives there, data and shapes by their numbers.
    """
    count = int(np.clip(ENTRIES / process.dim, 16, SAMPLES))
    some = times[np.unique(np.linspace(0, len(times) - 1, count).astype(int))]
    moving = motion(process.C)
    loads = [load for load in (moving.center, moving.scale, moving.offsets) if load is not None]
    if moving.shape is None:
        C: list[Any] = [process.C.at(t) for t in some.tolist()]
        C.append(getattr(process.C, "lipschitz", None))
    else:
        C = [moving.shape, *((load.terms, load.at(some)) for load in loads)]
    parts = {"A": process.A, "B": process.B, "u0": process.u0, "C(t)": C}
    return {
        name: hashlib.sha256(b" ".join(_bytes(part))).hexdigest() for name, part in parts.items()
    }


def differences(began: Mapping[str, str], process: SweepingProcess, times: np.ndarray) -> list[str]:
    """The parts of a process that are not those of the fingerprint of another at these times."""
    now = fingerprint(process, times)
    return [name for name in now if began.get(name) != now[name]]


def _bytes(value: Any) -> Iterator[bytes]:
    """Those of a nest of sets, loads, arrays and numbers; of another object its type alone."""
    yield type(value).__name__.encode()
    if isinstance(value, (ConvexSet, History)):
        value = _attributes(value)
    elif sp.issparse(value):
        matrix = sp.csc_array(value)
        places = (index.astype(np.int64) for index in (matrix.indices, matrix.indptr))
        value = [matrix.shape, matrix.data, *places]
    if isinstance(value, (list, tuple)):
        yield str(len(value)).encode()
        for part in value:
            yield from _bytes(part)
    elif isinstance(value, (np.ndarray, np.generic)):
        yield f"{value.dtype.str} {value.shape}".encode()
        yield value.tobytes()
    elif value is None or isinstance(value, (str, int, float)):
        yield repr(value).encode()


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
