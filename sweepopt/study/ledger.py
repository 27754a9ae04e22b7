"""Rows that are finished, a line of JSON each, so that kill -9 at any moment loses none of them."""

from __future__ import annotations

import contextlib
import json
import os
import zlib
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

Row = TypeVar("Row")


def append_row(path: Path, row: Any) -> None:
    """Add a named tuple of numbers and words; it is on the disk when this returns."""
    line = json.dumps(row._asdict(), default=np.generic.item)
    with path.open("ab") as file:
        # a new line first: one that a kill cut short must not spoil this one
        file.write(f"\n{zlib.crc32(line.encode()):08x} {line}".encode())
        file.flush()
        os.fsync(file.fileno())


def read_rows(path: Path, kind: type[Row]) -> list[Row]:
    """The rows of a named tuple's class; lines that are damaged or have other columns are not."""
    rows = []
    for line in path.read_bytes().splitlines() if path.exists() else ():
        checksum, _, text = line.partition(b" ")
        if checksum == b"%08x" % zlib.crc32(text):
            with contextlib.suppress(TypeError):
                rows.append(kind(**json.loads(text)))
    return rows
