"""Objects that show themselves as a few rows, at a prompt and in a notebook."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from html import escape

Rows = Iterable[tuple[str, object]]


def as_lines(rows: Rows) -> str:
    """One line a row that has a value, the values below each other."""
    return "\n".join(f"{name:<20}{value}" for name, value in rows if str(value))


class Displayed:
    """The base of what shows itself by names and values that are known: nothing is computed."""

    _rows: Callable[[], Rows]

    def __repr__(self) -> str:
        return as_lines(self._rows())

    def _repr_html_(self) -> str:
        texts = ((name, str(value)) for name, value in self._rows())
        rows = (f"<tr><th>{name}<td>{escape(text)}" for name, text in texts if text)
        return f"<table>{''.join(rows)}</table>"
