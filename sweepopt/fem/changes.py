"""Changes of a scene's data before anything is assembled: values by path, effects left out."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from typing import Any

from sweepopt.errors import InputError, shown
from sweepopt.io import parse_toml

STEP = re.compile(r"([^.\[\]]+)|\[(\d+)\]")


def parse_changes(texts: Iterable[str]) -> dict[str, Any]:
    """The changes that texts such as ``effects.friction.g=0.5`` state; values are TOML.

    Raises
    ------
    InputError
        If there is no ``=`` or the value is no TOML.

    Examples
    --------
    >>> parse_changes(["effects.friction.g=0.5", "solve.scheme='midpoint'"])
    {'effects.friction.g': 0.5, 'solve.scheme': 'midpoint'}
    """
    changes = {}
    for text in texts:
        path, equals, value = text.partition("=")
        if not equals:
            raise InputError(
                f"{shown(text)} is no change; write PATH=VALUE, such as time.steps=100"
            )
        where = f"{path.strip()}={value} (text is in quotes)"
        table = parse_toml(where, f"value = {value}")
        if table.keys() != {"value"}:
            raise InputError(f"{where}: must be one value")
        changes[path.strip()] = table["value"]
    return changes


def changed(data: Mapping[str, Any], changes: Mapping[str, Any]) -> Mapping[str, Any]:
    """The data with other values at paths such as ``effects.traction[0].f2``.

    The last key of a path may be new; the tables before it may not.

    Raises
    ------
    InputError
        Naming the path, where it ends and what is there.

    Examples
    --------
    >>> changed({"time": {"end": 1.0}}, {"time.end": 2.0, "time.steps": 4})
    {'time': {'end': 2.0, 'steps': 4}}
    """
    if not isinstance(changes, Mapping):
        raise InputError(f"changes must be a mapping of paths to values, got {shown(changes)}")
    result = deepcopy(dict(data)) if changes else data
    for path, value in changes.items():
        keys = _steps(path)
        table: Any = result
        for depth, key in enumerate(keys):
            last = depth == len(keys) - 1
            _check_step(path, table, keys[:depth], key, may_be_new=last)
            if last:
                table[key] = value
            else:
                table = table[key]
    return result


def remaining(labels: Sequence[str], without: Sequence[str]) -> list[str]:
    """Labels of effects without those named: all of a kind (``traction``) or one of it.

    Raises
    ------
    InputError
        If there is no such effect; the message names those there are.

    Examples
    --------
    >>> remaining(["effects.friction", "effects.traction[0]"], ["traction"])
    ['effects.friction']
    """
    kept = list(labels)
    for name in [without] if isinstance(without, str) else without:
        wanted = f"effects.{str(name).removeprefix('effects.')}"
        gone = [
            one for one in labels if one == wanted or one.startswith((f"{wanted}.", f"{wanted}["))
        ]
        if not gone:
            there = ", ".join(one.removeprefix("effects.") for one in labels)
            raise InputError(f"without: there is no effect {shown(name)}; there are: {there}")
        kept = [one for one in kept if one not in gone]
    return kept


def _steps(path: Any) -> list[str | int]:
    """The keys and indices of a path."""
    text = path if isinstance(path, str) else ""
    steps: list[str | int] = [key or int(index) for key, index in STEP.findall(text)]
    joined = "".join(f"[{one}]" if isinstance(one, int) else f".{one}" for one in steps)
    if not steps or joined.removeprefix(".") != text:
        raise InputError(
            f"{shown(path)} is no path of a value; write keys with dots between them and indices "
            "in brackets, such as effects.traction[0].f2"
        )
    return steps


def _check_step(
    path: str, table: Any, before: Sequence[str | int], key: str | int, may_be_new: bool
) -> None:
    """Refuse a step of a path that leads nowhere."""
    where = "".join(f"[{one}]" if isinstance(one, int) else f".{one}" for one in before)
    where = where.removeprefix(".") or "the scene"
    if isinstance(key, int):
        if not isinstance(table, list):
            raise InputError(f"{path}: {where} is no list, but {shown(table)}; leave [{key}] out")
        if key >= len(table):
            raise InputError(
                f"{path}: {where} has {len(table)} entries; use [0] to [{len(table) - 1}]"
            )
    elif not isinstance(table, Mapping):
        remedy = f"name an entry, such as {where}[0]" if isinstance(table, list) else "set it whole"
        raise InputError(f"{path}: {where} is no table, but {shown(table)}; {remedy}")
    elif key not in table and not may_be_new:
        raise InputError(
            f"{path}: {where} has no table {key!r}; there are: {', '.join(table)}. Set the whole "
            f"table to add it, such as {path.partition(key)[0]}{key}={{...}}"
        )
