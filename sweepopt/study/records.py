"""Tables of a study's file as records that check themselves; errors name the key at fault."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import MISSING, fields
from typing import Any, TypeVar

from sweepopt.checks import listed
from sweepopt.errors import InputError, shown

Record = TypeVar("Record")


def read_record(where: str, kind: type[Record], data: Any, **given: Any) -> Record:
    """A dataclass whose fields are the keys of a table, those that are given apart."""
    if not isinstance(data, dict):
        raise InputError(f"{where.rstrip('.')} must be a table, got {shown(data)}")
    keys = {field.name: field for field in fields(kind) if field.name not in given}  # type: ignore[arg-type]
    for key in data:
        if key not in keys:
            raise InputError(f"{where}{key}: unknown key; there are: {', '.join(keys)}")
    for key, field in keys.items():
        if field.default is MISSING and key not in data:
            raise InputError(f"{where}{key}: is missing")
    try:
        return kind(**data, **given)
    except InputError as error:
        raise InputError(f"{where}{error}") from error


def each(name: str, values: Any, check: Callable[..., Any], *limits: Any) -> tuple[Any, ...]:
    """A list with one entry or more, each of them checked under its own name."""
    entries = enumerate(listed(name, values))
    return tuple(check(f"{name}[{k}]", entry, *limits) for k, entry in entries)


def known(name: str, value: Any, names: Iterable[str], advice: str = "use") -> Any:
    """One of some names, which a refusal lists after the advice."""
    if value not in tuple(names):
        raise InputError(f"{name}: {shown(value)} is not known; {advice} {', '.join(names)}")
    return value


def check_lists(record: Any, **checks: tuple[Any, ...]) -> None:
    """Each list of a record by its own check and limits."""
    for key, (check, *limits) in checks.items():
        each(key, getattr(record, key), check, *limits)
