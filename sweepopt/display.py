"""Objects that show themselves: in a few lines at a prompt, with a small picture in a notebook."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from inspect import isroutine, signature
from itertools import cycle
from textwrap import fill
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, dataclass_transform

import numpy as np

from sweepopt.errors import InputError

Rows = Iterable[tuple[str, object]]
Made = TypeVar("Made")
COLOURS = ("#000000", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#0072B2")
"""Told apart with every common colour vision (Okabe and Ito)."""
FORMAT = {"index": False, "na_rep": "-", "float_format": "{:.3g}".format}
"""Of tables that pandas prints."""


def evenly(size: int, most: int) -> np.ndarray:
    """At most `most` >= 2 of 0, 1, ..., size - 1, evenly spread; both ends are among them."""
    return np.unique(np.linspace(0, size - 1, most).round().astype(int))


def as_lines(rows: Rows) -> str:
    """One line a row that has a value, the values below each other."""
    return "\n".join(f"{name:<20}{value}" for name, value in rows if str(value))


def brief(value: Any) -> str:
    """A value on a part of a line: of a large array its shape and range."""
    if isroutine(value) or (callable(value) and " at 0x" in repr(value)):
        return "a function"
    if hasattr(value, "nnz"):
        return f"{'sparse' if value.nnz else '0, sparse'} {value.shape}"
    if not isinstance(value, np.ndarray):
        words = " ".join(repr(value).split())
        return words if len(words) < 100 else f"{words[:95]} ..."
    if value.size == 1:
        return repr(value.item())
    if value.size <= 4 or not np.issubdtype(value.dtype, np.number):
        return np.array2string(value, precision=5, separator=", ", threshold=5).replace("\n", "")
    return f"{value.shape} in [{value.min():.5g}, {value.max():.5g}]"


def svg(curves: Sequence[np.ndarray], equal: bool = False, title: str = "") -> str:
    """Curves through points, each of shape (k, 2), as a small picture; `equal`: one scale."""
    every = np.concatenate(curves)
    low, size = every.min(axis=0), np.ptp(every, axis=0)
    scale = np.array([300.0, 120.0]) / np.where(size > 0, size, 1.0)
    if equal:
        scale[:] = scale.min()
    colours = COLOURS if len(curves) <= len(COLOURS) else COLOURS[:1]
    lines = ""
    for curve, colour in zip(curves, cycle(colours)):
        x, y = ((curve - low) * scale).T
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(5.0 + x, 125.0 - y, strict=True))
        lines += f'<polyline points="{points}" fill="none" stroke="{colour}"/>'
    return (
        f'<svg width="310" height="150" xmlns="http://www.w3.org/2000/svg">{lines}'
        f'<text x="5" y="145" font-size="12">{escape(title)}</text></svg>'
    )


def arguments(thing: Any) -> list[str]:
    """Names of those that made an object: of its class, and of ours that a user's is based on."""
    kinds = type(thing).__mro__
    ours = next(kind for kind in kinds if kind.__module__.startswith(f"{__package__}."))
    return [*{**signature(ours).parameters, **signature(kinds[0]).parameters}]


def by_parts(thing: Any) -> str:
    """An object by what it was made of, the parts that it still has."""
    parts = ((name, getattr(thing, name, None)) for name in arguments(thing))
    none = (type(None), tuple)  # what was not given: None, or an empty list of more
    given = [(name, one) for name, one in parts if not isinstance(one, none) or one]
    operands = getattr(thing, "operands", ())
    words = [f"{name}={brief(one)}" for name, one in given if name != "dim" and not operands]
    if "parts" not in dict(given):  # what an operation made it of
        words += map(brief, operands or getattr(thing, "parts", ()))
    if dim := getattr(thing, "dim", None):
        words.insert(0, f"dim {dim}")
    text = f"{type(thing).__name__}({', '.join(words)})"
    return fill(text, 100, subsequent_indent="    ", max_lines=8, break_long_words=False)


@dataclass_transform(eq_default=False, frozen_default=True)
def record(made: type[Made]) -> type[Made]:
    """A dataclass of a `Brief` class: equal to itself alone, as == of arrays has no one answer."""
    return dataclass(frozen=True, eq=False, repr=False)(made)


class Brief:
    """The base of what shows itself by what it was made of, and stays so."""

    def __setattr__(self, name: str, value: Any) -> None:
        """Set once: what was computed of a value would not follow another one."""
        again = name in vars(self) and name[0] != "_"
        if again and type(self).__module__.partition(".")[0] == __package__:
            kind = type(self).__name__
            raise InputError(f"{name} of {kind} cannot be changed; make a new {kind} with it")
        super().__setattr__(name, value)

    def __repr__(self) -> str:
        return by_parts(self)

    def _picture(self) -> str:
        """An SVG beside the words, if one helps."""
        return ""

    def _repr_html_(self) -> str:
        return f"<pre>{escape(repr(self))}</pre>{self._picture()}"


class Displayed(Brief):
    """The base of what shows itself by names and values that are known: nothing is computed."""

    _rows: Callable[[], Rows]
    _instead: ClassVar[Mapping[str, str]] = {}
    """Names that users try, and what stands here for them."""

    if not TYPE_CHECKING:  # to a type checker no other attribute exists

        def __getattr__(self, name: str) -> Any:
            if name in self._instead:
                kind = type(self).__name__
                raise AttributeError(f"{kind} has no attribute {name}; {self._instead[name]}")
            return object.__getattribute__(self, name)

    def __repr__(self) -> str:
        return as_lines(self._rows())

    def _repr_html_(self) -> str:
        texts = ((name, str(value)) for name, value in self._rows())
        rows = (f"<tr><th>{name}<td>{escape(text)}" for name, text in texts if text)
        return f"<table>{''.join(rows)}</table>{self._picture()}"
