"""Study files: TOML whose keys are the fields of `Study`."""

from __future__ import annotations

import tomllib
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from sweepopt.errors import InputError
from sweepopt.study.study import Study

KEYS = {field.name: field for field in fields(Study) if field.name != "folder"}


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises
    ------
    InputError
        Naming the file.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not UTF-8 text, as TOML must be") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: is not TOML: {error}") from error


def read_study(path: str | Path) -> Study:
    """Read a study from a TOML file.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    Study

    Raises
    ------
    InputError
        Naming the file and the key at fault.

    Notes
    -----
    ::

        title = "What accuracy costs"                   # optional
        problems = ["S03", "tube", "scenes/mine.toml"]  # relative to this file
        schemes = ["catching-up", "midpoint"]
        solvers = ["auto", "clarabel", "cvxpy:scs"]
        steps = [100, 1000]
        tols = [1e-6]                                   # optional
        repeats = 3                                     # optional
        [hard]                                          # optional: hard cases, run afterwards
        seeds = [0]
    """
    path = Path(path)
    data = read_toml(path)
    for key in data:
        if key not in (*KEYS, "hard"):
            raise InputError(f"{path}: {key}: unknown key; there are: {', '.join(KEYS)}")
    for key, field in KEYS.items():
        if field.default is MISSING and key not in data:
            raise InputError(f"{path}: {key}: is missing")
    try:
        data.pop("hard", None)
        study = Study(**data, folder=str(path.parent))
        study.sources()
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return study
