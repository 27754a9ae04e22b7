"""The problems that come with the library: one scene a TOML file, its data beside it.

Found in a clone (problems/ at the root) and in an installed package (sweepopt/problems) alike,
with the core install alone: a listing reads titles and assembles nothing.
"""

from __future__ import annotations

import os
import tomllib
from pathlib import Path

from sweepopt.errors import InputError


def list_problems() -> dict[str, str]:
    """Titles of the problems by their names.

    Examples
    --------
    >>> "tube" in list_problems()
    True
    """
    return {
        path.stem: str(tomllib.loads(path.read_text(encoding="utf-8")).get("title", ""))
        for path in sorted(_folder().glob("*.toml"))
    }


def find_problem(name: str) -> Path:
    """The scene file of a problem.

    Raises
    ------
    InputError
        If there is none of that name; the message lists those there are.

    Examples
    --------
    >>> find_problem("tube").name
    'tube.toml'
    """
    return _listed("*.toml", name, "a scene file nor a problem")


def find_scene(scene: str) -> Path:
    """The file of a scene that is given by its path or by the name of a problem."""
    return _given(scene) or find_problem(scene)


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
    return _given(study) or _listed("*/*.toml", study, "a study file nor a study")


def _given(name: str) -> Path | None:
    """The path that a name is."""
    path = Path(name)
    return path if path.suffix == ".toml" or os.path.isfile(path) else None


def _listed(pattern: str, name: str, what: str) -> Path:
    known = {path.stem: path for path in _folder().glob(pattern)}
    if name not in known:
        names = ", ".join(sorted(known)) or "none"
        raise InputError(f"{name!r} is neither {what}; there are: {names}")
    return known[name]


def _folder() -> Path:
    package = Path(__file__).resolve().parent.parent
    installed = package / "problems"
    return installed if installed.is_dir() else package.parent / "problems"
