"""Files: text and tables that users write, the problems of the library, files replaced as a whole.

A file that cannot be read is an `InputError` that names the file, the place in it and the fault; a
file that is written takes its place only when it is complete.
"""

import base64
import csv
import errno
import json
import math
import os
import platform
import re
import sys
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from sweepopt.checks import Array
from sweepopt.errors import CheckpointError, DamagedFileError, InputError, shown, suggestion

if os.name == "posix":
    import fcntl


# ---- paths and text ----


def as_path(name: str, value: Any) -> Path:
    """A path, or an error that names the argument."""
    if not isinstance(value, (str, os.PathLike)):
        raise InputError(f"{name} must be a path, got {shown(value)}")
    return Path(value)


def writable(name: str, value: Any) -> Path:
    """The path of a file that can be written, or an error that names the argument."""
    path, given = as_path(name, value), shown(str(value))
    try:
        path = path.resolve()
        occupied, folder = path.exists() and not path.is_file(), path.parent.is_dir()
    except (OSError, ValueError, RuntimeError) as error:  # too long, a zero byte, a circle of links
        raise InputError(f"{name} is {given}, which is no path: {error}") from None
    if not folder:
        raise InputError(f"{name} is {given}, but there is no folder {str(path.parent)!r}")
    if occupied:
        raise InputError(f"{name} is {given}, which is no regular file")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"{name} is {given}, where no file can be written")
    return path


def folder_at(name: str, path: Path) -> Path:
    """A folder, which is made if it is not there, or an error that names the argument."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = f"where no folder can be made: {error.strerror}"
        raise InputError(f"{name} is {shown(str(path))}, {reason}") from None
    return path


def read_bytes(path: Path) -> bytes:
    """The content of a file.

    Raises
    ------
    InputError
        Naming the file and why it cannot be read; a device or a pipe has no end.
    """
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise OSError(errno.EINVAL, "no regular file")
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{str(path)!s:.300}: cannot be read ({error.strerror})") from None
    except ValueError as error:  # a zero byte or half a surrogate is in no file's name
        raise InputError(f"{shown(str(path))}: cannot be read ({error})") from None


def read_text(path: Path) -> str:
    """A file of UTF-8 text, with or without a byte order mark."""
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(
            f"{path}: is not UTF-8 text; save it as UTF-8, a table as "
            "CSV; so.Solution.load reads runs in .nc, so.resume checkpoints"
        ) from None


def parse_toml(where: str, text: str) -> dict[str, Any]:
    """The tables of TOML text.

    Raises
    ------
    InputError
        Naming `where` and the fault.
    """
    try:
        return tomllib.loads(text)
    except ValueError as error:  # not TOML, or a number of thousands of digits
        hint, fault = "", str(error)
        if match := re.search(r"declare \((.*)\) twice", fault):
            name = ".".join(re.findall(r"'(.+?)'", match[1]))
            hint = f"; put all keys under one [{name}], or write [[{name}]] above each of several"
        elif "overwrite" in fault:
            hint = "; it is there already: leave one out, or write [[...]] above each of several"
        elif "Unclosed" in fault:
            hint = "; entries of { } and [ ] have commas between them"
        elif "Invalid value" in fault or "newline" in fault:
            hint = "; text and formulas are in quotes"
        raise InputError(f"{where}: is not TOML: {fault}{hint}") from None
    except RecursionError:
        raise InputError(f"{where}: is not TOML: brackets within brackets without end") from None


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file."""
    return parse_toml(str(path), read_text(path))


# ---- tables ----


def read_columns(path: str | Path, time: str | None, *others: str) -> tuple[Array, list[int]]:
    """Named columns of a CSV file with decimal points and commas between the cells.

    Parameters
    ----------
    path : str or Path
        First line that is neither empty nor a ``#`` comment: the column names.
    time : str, optional
        The first of the columns; without it "t" or "time", else the one on the left.
    *others : str
        The others.

    Returns
    -------
    columns : ndarray, shape (1 + len(others), m)
    rows : list of int
        Line number of each row in the file.

    Raises
    ------
    InputError
        Naming the file, the column and the row at fault.
    """
    for name in others if time is None else (time, *others):
        if not isinstance(name, str):
            raise InputError(f"{path}: the name of a column must be text, got {shown(name)}")
    table = {}
    for row, line in enumerate(read_text(as_path("path", path)).splitlines(), start=1):
        if line.strip() and line.lstrip()[0] != "#":
            try:
                table[row] = [cell.strip() for cell in next(csv.reader([line]))]
            except csv.Error as error:  # a cell beyond the reader's limit
                raise InputError(f"{path}, row {row}: {error}; is it a table?") from None
    if len(table) < 2:
        raise InputError(
            f"{path}: has no rows; write the column names, t,{others[0]}, and a row for each time"
        )
    header = table.pop(next(iter(table)))
    if time is None:
        words = {name: re.split(r"\W", name.lower())[0] for name in header}
        left = [name for name in header if name not in others]
        time = next((name for name in left if words[name] in ("t", "time")), (*left, "t")[0])
    names = time, *others
    for name in names:
        if header.count(name) != 1:
            there = name in header
            fault = "is there twice" if there else "is missing"
            cases = [one for one in header if one.lower() == name.lower() and not there]
            hint = f"; did you mean {cases[0]}?" if cases else ""
            # the line itself is not shown: a stranger's scene may name any file
            if not any(one[:1].isalpha() for one in header):
                hint = "; write a line of names above"
            if len(header) == 1 and (mark := re.search("[;\t ]", header[0])):
                hint = f"; it is separated by {mark[0]!r}, write commas between the cells"
            raise InputError(
                f"{path}: column {name!r} {fault} among its {len(header)} column names{hint}"
            )
    rows = []
    for row, cells in table.items():
        if len(cells) > len(header):
            raise InputError(
                f"{path}, row {row}: {len(cells)} cells under {len(header)} column names; "
                "write decimals with a point (1.5, not 1,5)"
            )
        by_name = dict(zip(header, cells, strict=False))
        rows.append(
            [
                _number(f"{path}, column {name!r}, row {row}", by_name.get(name, ""))
                for name in names
            ]
        )
    return np.transpose(rows), list(table)


def _number(where: str, cell: str) -> float:
    with suppress(ValueError):
        # Python reads 1_0 as 10
        if "_" not in cell and math.isfinite(value := float(cell)):
            return value
    remedy = "write 1.5, not 1,5" if "," in cell else "leave out rows without one"
    raise InputError(f"{where}: {shown(cell)} is not a finite number; {remedy}")


# ---- problems that come with the library: one scene or study a TOML file, its data beside it ----


def list_scenes() -> dict[str, str]:
    """Titles of the problems by their names.

    Examples
    --------
    >>> "tube" in list_scenes()
    True
    """
    files = sorted(_problems().glob("*.toml"))
    return {path.stem: str(read_toml(path).get("title", "")) for path in files}


def find_scene(scene: str) -> Path:
    """The file of a scene that is given by its path or by the name of a problem.

    Raises
    ------
    InputError
        If there is none of that name; the message lists those there are.

    Examples
    --------
    >>> find_scene("tube").name
    'tube.toml'
    """
    return _find("*.toml", scene, "a scene file nor a problem")


def find_study(study: str) -> Path:
    """The file of a study that is given by its path or by the name of one of the library.

    Raises
    ------
    InputError
        If there is none of that name; the message lists those there are.

    Examples
    --------
    >>> find_study("accuracy").name
    'accuracy.toml'
    """
    return _find("*/*.toml", study, "a study file nor a study")


def _find(pattern: str, name: str, what: str) -> Path:
    path = Path(name)
    if path.suffix == ".toml" or os.path.isfile(path):
        return path
    known = {path.stem: path for path in _problems().glob(pattern)}
    if name not in known:
        names = ", ".join(sorted(known)) or "none"
        near = suggestion(name, known)
        if re.fullmatch(r"[A-Z]\d\d", name):  # a name of study/problems.py
            near = "; small test problems such as S03 are for studies and `sweepopt compare`"
        raise InputError(f"{name!r} is neither {what}; there are: {names}{near}")
    return known[name]


def _problems() -> Path:
    """In an installed package sweepopt/problems, in a clone problems/ at the root."""
    package = Path(__file__).resolve().parent
    installed = package / "problems"
    return installed if installed.is_dir() else package.parent / "problems"


# ---- files replaced as a whole ----


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


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Keep other runs from writing `path`; the lock of a run that is killed is no longer one.

    Raises
    ------
    InputError
        If another run has it.
    CheckpointError
        If there can be no lock.
    """
    file = path.with_name(f".{path.name}.lock")
    try:
        handle = file.open("wb")
    except OSError as error:
        raise CheckpointError(
            f"checkpoint: no file can be made beside {path} ({error.strerror}); choose another "
            "folder or a shorter name"
        ) from error
    with handle:
        try:
            if os.name == "posix":
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if not os.fstat(handle.fileno()).st_nlink:  # removed by who had it until now
                raise BlockingIOError
        except BlockingIOError:
            message = "is being written by another run; wait for its end or choose another name"
            raise InputError(f"checkpoint: {path} {message}") from None
        try:
            yield
        finally:
            file.unlink(missing_ok=True)


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


def _force(path: Path, flags: int) -> None:
    """Wait until the disk has it."""
    handle = os.open(path, flags)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_npz(
    path: Path,
    record: dict[str, Any],
    arrays: Mapping[str, Array],
    previous: Path | None,
) -> None:
    """Replace a file by an .npz of a record (plain JSON types) and of arrays of numbers.

    The file that was there before goes to `previous`.
    """
    text = np.frombuffer(json.dumps(record).encode(), np.uint8)
    with replacing(path, previous) as part, part.open("wb") as file:
        np.savez(file, allow_pickle=False, **{"record": text, **arrays})


def read_npz(path: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    """The record and the arrays that `write_npz` wrote; each has a checksum, the zip's own.

    Raises
    ------
    OSError
        If it cannot be opened.
    DamagedFileError
        If anything in it is not as it was written.
    """
    with path.open("rb") as stream:
        try:
            if stream.read(2) != b"PK":
                raise ValueError("it is no checkpoint; runs in .nc are for so.Solution.load")
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as file:
                if any(one.compress_size != one.file_size for one in file.zip.infolist()):
                    raise ValueError("it is compressed, so nobody knows how large it is")
                if broken := file.zip.testzip():
                    raise ValueError(f"the checksum of {broken} does not fit")
                arrays = dict(file)
                if "record" not in arrays:
                    raise ValueError("it has other arrays")
                return json.loads(arrays.pop("record").tobytes()), arrays
        except Exception as error:  # zipfile, json and numpy have no list of what they raise
            raise DamagedFileError(f"{path} is damaged or no file of ours: {error}") from error


PACKAGES = ("numpy", "scipy", "cvxpy", "osqp", "clarabel", "cvxopt", "daqp", "pyamg")
"""Their versions may change the last bits of a result, and its time."""
_version = cache(metadata.version)  # it reads a file of each package


def versions_of(packages: Iterable[str] = PACKAGES) -> dict[str, str]:
    """The versions of Python, of those that are installed, and of the library."""
    versions = {"python": platform.python_version()}
    for name in packages:
        with suppress(metadata.PackageNotFoundError):
            versions[name] = _version(name)
    # a clone on the path has no metadata
    return {**versions, "sweepopt": sys.modules["sweepopt"].__version__}


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
