"""Lists of a study's file that are checked entry by entry, and rows of results on the disk."""

from __future__ import annotations

import contextlib
import json
import os
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from sweepopt.checks import listed
from sweepopt.errors import InputError, shown

Record = TypeVar("Record")


def each(name: str, values: Any, check: Callable[..., Any], *limits: Any) -> tuple[Any, ...]:
    """A list with one entry or more, each checked under its own name and none there twice."""
    entries: dict[str, Any] = {}
    for k, value in enumerate(listed(name, values)):
        entry = check(f"{name}[{k}]", value, *limits)
        if str(entry) in entries:
            raise InputError(f"{name}[{k}]: {shown(value)} is there twice")
        entries[str(entry)] = entry
    return tuple(entries.values())


def append_row(path: Path, row: Any) -> None:
    """Add a named tuple of numbers and words, a line of JSON; it is on the disk when this returns.

    Kill -9 at any moment loses none of the lines.
    """
    line = json.dumps(row._asdict(), default=np.generic.item)
    with path.open("ab") as file:
        # a new line first: one that a kill cut short must not spoil this one
        file.write(f"\n{zlib.crc32(line.encode()):08x} {line}".encode())
        file.flush()
        os.fsync(file.fileno())


def read_rows(path: Path, kind: type[Record]) -> list[Record]:
    """The rows of a named tuple's class; lines that are damaged or have other columns are not."""
    rows = []
    for line in path.read_bytes().splitlines() if path.exists() else ():
        checksum, _, text = line.partition(b" ")
        if checksum == b"%08x" % zlib.crc32(text):
            with contextlib.suppress(TypeError):
                rows.append(kind(**json.loads(text)))
    return rows
