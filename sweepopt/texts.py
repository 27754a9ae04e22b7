"""Files that users write, as bytes, text and TOML: what cannot be read is named, whatever it is."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path
from typing import Any

from sweepopt.errors import InputError, shown


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
        taken, folder = path.is_dir(), path.parent.is_dir()
    except (OSError, ValueError, RuntimeError) as error:  # too long, a zero byte, a circle of links
        raise InputError(f"{name} is {given}, which is no path: {error}") from error
    if not folder:
        raise InputError(f"{name} is {given}, but there is no folder {shown(str(path.parent))}")
    if taken or not os.access(path.parent, os.W_OK):
        raise InputError(f"{name} is {given}, which cannot be written there")
    return path


def read_bytes(path: Path) -> bytes:
    """The content of a file.

    Raises
    ------
    InputError
        Naming the file and why it cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{str(path)!s:.300}: cannot be read ({error.strerror})") from None
    except ValueError as error:  # a zero byte or half a surrogate is in no file's name
        raise InputError(f"{shown(str(path))}: cannot be read ({error})") from None


def read_text(path: Path, advice: str, encoding: str = "utf-8") -> str:
    """A file of UTF-8 text; `advice` ends the sentence for one that is not."""
    try:
        return read_bytes(path).decode(encoding)
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not UTF-8 text{advice}") from None


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
        raise InputError(f"{where}: is not TOML: {error}") from error
    except RecursionError as error:
        raise InputError(f"{where}: is not TOML: brackets within brackets without end") from error


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file."""
    return parse_toml(str(path), read_text(path, ", as TOML must be"))
