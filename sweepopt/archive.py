"""A file of arrays and a record that describes them: npz, readable by numpy.load as well.

Everything is checked before it is used: the record has a checksum of itself and one of each array,
with its type and shape; no byte of an array is allocated before the file is known to have it; there
is no pickle in it. What is wrong in any way is a DamagedFileError.
"""

from __future__ import annotations

import hashlib
import math
import struct
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sweepopt.errors import DamagedFileError
from sweepopt.files import replacing, sealed, unsealed

RECORD = "record"
PARSING = (  # what zipfile, json and numpy raise for bytes that make no sense
    OSError,
    ValueError,
    KeyError,
    TypeError,
    IndexError,
    EOFError,
    OverflowError,
    SyntaxError,
    RuntimeError,
    struct.error,
    zlib.error,
    zipfile.BadZipFile,
)


def write_archive(
    path: Path,
    record: dict[str, Any],
    arrays: Mapping[str, np.ndarray],
    previous: Path | None = None,
) -> None:
    """Replace a file by one with these arrays; the file that was there goes to `previous`."""
    arrays = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    about = {name: _about(array) for name, array in arrays.items()}
    head = np.frombuffer(sealed({"record": record, "arrays": about}), dtype=np.uint8)
    with replacing(path, previous) as part, part.open("wb") as file:
        np.savez(file, allow_pickle=False, **{RECORD: head, **arrays})


def read_archive(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The record and the arrays.

    Raises
    ------
    OSError
        If it cannot be opened.
    DamagedFileError
        If anything in it is not as it was written.
    """
    stream = path.open("rb")  # what cannot be opened is not damaged
    try:
        with stream, zipfile.ZipFile(stream) as file:
            members = {info.filename.removesuffix(".npy"): info for info in file.infolist()}
            _check_sizes(list(members.values()), path.stat().st_size)
            head = unsealed(_member(file, members.pop(RECORD), None).tobytes())
            about = head["arrays"]
            if set(about) != set(members):
                raise ValueError("it has not the arrays that its record names")
            arrays = {name: _member(file, members[name], about[name]) for name in about}
            return head["record"], arrays
    except PARSING as error:
        raise DamagedFileError(f"{path} is damaged or no file of ours: {error}") from error


def _about(array: np.ndarray) -> dict[str, Any]:
    digest = hashlib.sha256(array.data if array.size else b"").hexdigest()
    return {"dtype": array.dtype.str, "shape": list(array.shape), "sha256": digest}


def _check_sizes(members: list[zipfile.ZipInfo], size: int) -> None:
    """No member takes more memory than the file has bytes."""
    for info in members:
        if info.compress_type != zipfile.ZIP_STORED or info.file_size != info.compress_size:
            raise ValueError(f"{info.filename!r} is compressed")
    if sum(info.file_size for info in members) > size:
        raise ValueError("its arrays are larger than the file")


def _member(
    file: zipfile.ZipFile, info: zipfile.ZipInfo, about: dict[str, Any] | None
) -> np.ndarray:
    """One array; `about` is what it must be, None for the record."""
    with file.open(info) as stream:
        if np.lib.format.read_magic(stream) != (1, 0):
            raise ValueError(f"{info.filename!r} is written in another format")
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
        size = math.prod(shape) * dtype.itemsize
        if dtype.hasobject or fortran or size != info.file_size - stream.tell():
            raise ValueError(f"{info.filename!r} has another size than it says")
        content = stream.read()
    array = np.frombuffer(content, dtype).reshape(shape)
    if about is not None and about != _about(array):
        raise ValueError(f"{info.filename!r} is not what was written")
    return array
