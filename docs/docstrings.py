"""Docstrings as they are written in the package, made ready for reStructuredText."""

from __future__ import annotations

import re
from typing import Any


def bars(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """|z|_A means itself, outside of code and of examples."""
    for k, line in enumerate(lines):
        if not line.lstrip().startswith((">>>", "...")):
            pieces = re.split(r"(``.*?``|`[^`]*`)", line)
            pieces[::2] = [piece.replace("|", r"\|") for piece in pieces[::2]]
            lines[k] = "".join(pieces)


def types(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Types of attributes are prose with shapes and units, not names of classes."""
    lines[:] = [re.sub(r"^(\s*):type: (.*)$", r"\1*\2*", line) for line in lines]


def setup(app: Any) -> dict[str, Any]:
    """What Sphinx calls; napoleon has the priority 500."""
    app.connect("autodoc-process-docstring", bars, priority=400)
    app.connect("autodoc-process-docstring", types, priority=600)
    return {"parallel_read_safe": True}
