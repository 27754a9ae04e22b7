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
    path = _folder() / f"{name}.toml"
    if Path(name).name != name or not os.path.isfile(path):
        known = ", ".join(sorted(file.stem for file in _folder().glob("*.toml"))) or "none"
        raise InputError(f"{name!r} is neither a scene file nor a problem; there are: {known}")
    return path


def find_scene(scene: str) -> Path:
    """The file of a scene that is given by its path or by the name of a problem."""
    path = Path(scene)
    return path if path.suffix == ".toml" or os.path.isfile(path) else find_problem(scene)


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
    given = Path(study)
    if given.suffix == ".toml" or os.path.isfile(given):
        return given
    known = {path.stem: path for path in _folder().glob("*/*.toml")}
    if study not in known:
        names = ", ".join(sorted(known)) or "none"
        raise InputError(f"{study!r} is neither a study file nor a study; there are: {names}")
    return known[study]


def _folder() -> Path:
    package = Path(__file__).resolve().parent
    installed = package / "problems"
    return installed if installed.is_dir() else package.parent / "problems"
