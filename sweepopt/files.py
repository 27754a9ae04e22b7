"""Files that are replaced as a whole, forced to the disk, and records that carry a checksum.

kill -9, a full disk or a power cut at any moment leaves the old file or the new one.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def replacing(path: Path, previous: Path | None = None) -> Iterator[Path]:
    """A new file that takes the place of `path` when the block ends well, and else disappears.

    Parameters
    ----------
    path : Path
    previous : Path, optional
        Where the file that was in its place goes.
    """
    part = part_of(path)
    try:
        yield part
        _force(part, os.O_RDWR)
        if previous is not None and path.exists():
            os.replace(path, previous)
        os.replace(part, path)
        if os.name == "posix":  # the folder's entries too
            _force(path.parent, os.O_RDONLY)
    finally:
        part.unlink(missing_ok=True)


def part_of(path: Path) -> Path:
    """Where this process writes what is to take the place of `path`."""
    return path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")


def remove_parts(path: Path) -> None:
    """Remove what writers of `path` that were killed have left beside it."""
    name = rf"\.{re.escape(path.stem)}\.\d+\.part{re.escape(path.suffix)}"
    for file in path.parent.iterdir():
        if re.fullmatch(name, file.name):
            file.unlink(missing_ok=True)


def put(path: Path, content: bytes) -> None:
    """Replace a file as a whole, on the disk when this returns."""
    with replacing(path) as part:
        part.write_bytes(content)


def sealed(content: dict[str, Any]) -> bytes:
    """A record as JSON with its checksum."""
    return json.dumps(
        {"sha256": _checksum(content), "content": content}, indent=1, allow_nan=False
    ).encode()


def unsealed(data: bytes) -> Any:
    """The content of a record.

    Raises
    ------
    ValueError
        If it is not whole.
    """
    try:
        found = json.loads(data)
        content = found["content"]
        whole = found["sha256"] == _checksum(content)
    except (KeyError, TypeError, RecursionError) as error:
        raise ValueError(f"no record: {error}") from error
    if not whole:
        raise ValueError("the checksum does not fit")
    return content


def _checksum(content: Any) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _force(path: Path, flags: int) -> None:
    """Wait until the disk has it."""
    handle = os.open(path, flags)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
