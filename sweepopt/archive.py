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
PLAIN = "biuf"  # kinds of entries: truth, whole numbers, floats
PARSING = (  # what zipfile, json and numpy raise for bytes that make no sense
    OSError,
    ValueError,
    KeyError,
    TypeError,
    IndexError,
    AttributeError,
    EOFError,
    OverflowError,
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
    """Replace a file by one with these arrays of numbers; the one before it goes to `previous`."""
    arrays = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    about = {name: _about(array) for name, array in arrays.items()}
    head = np.frombuffer(sealed({"record": record, "arrays": about}), dtype=np.uint8)
    with replacing(path, previous) as part, part.open("wb") as file:
        np.savez(file, **{RECORD: head, **arrays})  # type: ignore[arg-type]


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
    if array.dtype.kind not in PLAIN:
        raise TypeError(f"arrays of {array.dtype} are not written")
    digest = hashlib.sha256(array.data if array.size else b"").hexdigest()
    return {"dtype": array.dtype.str, "shape": list(array.shape), "sha256": digest}


def _check_sizes(members: list[zipfile.ZipInfo], size: int) -> None:
    """No member takes more memory than the file has bytes."""
    for info in members:
        if info.compress_type != zipfile.ZIP_STORED or info.file_size != info.compress_size:
            raise ValueError(f"{info.filename!r} is compressed")
    if sum(info.file_size for info in members) > size:
        raise ValueError("its arrays are larger than the file")


def _member(file: zipfile.ZipFile, info: zipfile.ZipInfo, about: Any) -> np.ndarray:
    """One array; `about` is what it must be, None for the record, which has no other record."""
    with file.open(info) as stream:
        lead = stream.read(10)
        if lead[:8] != b"\x93NUMPY\x01\x00":
            raise ValueError(f"{info.filename!r} is written in another format")
        # numpy's own header is not parsed: the record has type and shape
        stream.read(int.from_bytes(lead[8:], "little"))
        rest = info.file_size - stream.tell()
        about = about or {"dtype": "|u1", "shape": [rest]}
        dtype = np.dtype(about["dtype"])
        if dtype.kind not in PLAIN or math.prod(about["shape"]) * dtype.itemsize != rest:
            raise ValueError(f"{info.filename!r} has another size than it should")
        array = np.frombuffer(stream.read(), dtype).reshape(about["shape"])
    if "sha256" in about and about != _about(array):
        raise ValueError(f"{info.filename!r} is not what was written")
    return array
