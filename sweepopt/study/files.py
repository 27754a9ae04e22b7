"""Study files: TOML whose keys are the fields of `Study`."""

from __future__ import annotations

from dataclasses import MISSING, fields
from pathlib import Path

from sweepopt.errors import InputError
from sweepopt.io import as_path, read_toml
from sweepopt.study.study import Study

KEYS = {field.name: field for field in fields(Study) if field.name != "folder"}


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

    Examples
    --------
    >>> from sweepopt.io import find_study
    >>> read_study(find_study("accuracy")).repeats > 0
    True
    """
    path = as_path("path", path)
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
