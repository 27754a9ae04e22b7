"""Which packages compute here."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import metadata


def versions_of(packages: Iterable[str]) -> dict[str, str]:
    """The versions of those that are installed, and of the library."""
    found = {}
    for name in dict.fromkeys(packages):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    from sweepopt import __version__  # a clone on the path has no metadata

    return {**found, "sweepopt": __version__}
