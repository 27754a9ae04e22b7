"""Gmsh files of the formats 2.2 and 4.1, ASCII and binary: nodes, lines, triangles and groups.

Nothing that a file announces is believed: no array is made before the file is known to have its
numbers, whatever a damaged count or tag says (general readers make arrays as long as the largest
tag, and a flipped bit takes all memory). Sections that are not needed are skipped.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from sweepopt.errors import InputError, shown

FORMATS = ("2.2", "4.1")
Floats: TypeAlias = NDArray[np.float64]
Integers: TypeAlias = NDArray[np.int64]
INT, SIZE, FLOAT = np.dtype("<i4"), np.dtype("<u8"), np.dtype("<f8")


class Kind(NamedTuple):
    """A shape of elements and how many nodes it has."""

    name: str
    nodes: int


KINDS = {
    1: Kind("line", 2),
    2: Kind("triangle", 3),
    8: Kind("line3", 3),
    9: Kind("triangle6", 6),
    15: Kind("vertex", 1),
}
FOREIGN = {3: "quad", 4: "tetra", 5: "hexahedron", 6: "wedge", 7: "pyramid", 10: "quad9"}


class Block(NamedTuple):
    """Elements of one kind.

    Attributes
    ----------
    kind : str
    nodes : ndarray of int, shape (k, nodes of an element)
        Indices into the points.
    groups : ndarray of int, shape (k, m)
        Numbers of the physical groups of each element; 0 is none.
    """

    kind: str
    nodes: NDArray[np.int64]
    groups: NDArray[np.int64]


class Gmsh(NamedTuple):
    """What a file holds; `names` are those of the groups by their dimension and number."""

    points: NDArray[np.float64]
    blocks: list[Block]
    names: dict[tuple[int, int], str]


class _Section:
    """The numbers of a section, one after the other."""

    def __init__(self, text: bytes, binary: bool) -> None:
        self.text, self.binary = text, binary
        self._at = 0

    @cached_property
    def _values(self) -> Floats:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # older numpy only warns of what is no number
                return np.fromstring(self.text, sep=" ")
        except (ValueError, DeprecationWarning) as error:
            raise InputError("is damaged: there is a word among its numbers") from error

    def take(self, dtype: np.dtype, count: int) -> Any:
        """The next numbers; whole ones as int64."""
        if self.binary:
            found = self.records(dtype, count)
        else:
            found = self._values[self._at : self._at + count]
            self._at += count
            _require(found.size == count)
        return found.astype(float) if dtype is FLOAT else _whole(found)

    def one(self, dtype: np.dtype) -> int:
        return int(self.take(dtype, 1)[0])

    def records(self, dtype: np.dtype, count: int) -> np.ndarray:
        """The next numbers of a binary section as they are."""
        _require(count * dtype.itemsize <= len(self.text) - self._at)
        found = np.frombuffer(self.text, dtype, count, self._at)
        self._at += count * dtype.itemsize
        return found

    def count_line(self) -> int:
        """The count in front of a binary section of format 2.2: a line of text."""
        line = self.text[: self.text.find(b"\n") + 1]
        _require(line.strip().isdigit() and len(line) < 20)
        self._at = len(line)
        return int(line)

    def rest(self) -> Floats:
        """All that is left of an ASCII section."""
        return self._values[self._at :]


def _require(enough: bool) -> None:
    if not enough:
        raise InputError("is damaged: a section has fewer numbers than it announces")


def read_gmsh(content: bytes) -> Gmsh:
    """The nodes, elements and groups of a file.

    Raises
    ------
    InputError
        Naming the fault.
    """
    if not content.startswith(b"$MeshFormat"):
        raise InputError("is not a Gmsh .msh file (it does not start with $MeshFormat)")
    if b"$EndElements" not in content:
        raise InputError("is cut short ($EndElements is missing); save it again")
    version, form, size = (content[:100].split()[1:4] + 3 * [b""])[:3]
    if version.decode(errors="replace") not in FORMATS:
        raise InputError(
            f"MSH version {shown(version.decode(errors='replace'))} is not among "
            f"{', '.join(FORMATS)}; save it as version 4.1 (Mesh.MshFileVersion)"
        )
    if form not in (b"0", b"1") or size != b"8":
        raise InputError("is damaged: its second line must be like '4.1 0 8'")
    sections = _sections(content, form == b"1")
    for name in ("Nodes", "Elements"):
        if name not in sections:
            raise InputError(f"is damaged: it has no section ${name}")
    if form == b"1" and sections["MeshFormat"].text.split(b"\n", 1)[1][:4] != b"\x01\0\0\0":
        raise InputError("is written in another order of bytes; save it as ASCII")
    names = _names(sections["PhysicalNames"].text) if "PhysicalNames" in sections else {}
    points, blocks = (_read_2 if version == b"2.2" else _read_4)(sections)
    return Gmsh(points, blocks, names)


def _sections(content: bytes, binary: bool) -> dict[str, _Section]:
    """The sections by name; those that are unknown are never looked into."""
    found: dict[str, _Section] = {}
    at = 0
    while (at := content.find(b"$", at)) >= 0:
        line = content[at + 1 : content.find(b"\n", at) + 1]
        name, begin = line.strip(), at + 1 + len(line)
        end = content.find(b"$End" + name, begin)
        if not name or end < 0:
            raise InputError(f"is damaged: section {shown(name)} has no end")
        found[name.decode(errors="replace")] = _Section(content[begin:end], binary)
        at = end + 4 + len(name)
    return found


def _read_2(sections: dict[str, _Section]) -> tuple[Floats, list[Block]]:
    """Format 2.2: each node with its tag, each element with its tags."""
    nodes = sections["Nodes"]
    if nodes.binary:
        count = nodes.count_line()
        rows = nodes.records(np.dtype([("tag", INT), ("x", FLOAT, 3)]), count)
        tags, points = rows["tag"].astype(np.int64), rows["x"].astype(float)
    else:
        table = nodes.take(FLOAT, 4 * nodes.one(SIZE)).reshape(-1, 4)
        tags, points = _whole(table[:, 0]), table[:, 1:]
    find = _finder(tags)
    elements = sections["Elements"]
    runs = _binary_runs(elements) if elements.binary else _ascii_runs(elements)
    # the first tag is the physical group; 0 is none
    blocks = [
        Block(kind.name, find(rows[:, -kind.nodes :]), rows[:, :1] if marks else rows[:, :0])
        for kind, marks, rows in runs
    ]
    return points, blocks


def _binary_runs(section: _Section) -> Iterator[tuple[Kind, int, Integers]]:
    left = section.count_line()
    while left > 0:
        number, count, marks = section.take(INT, 3).tolist()
        kind = _kind(number)
        if marks < 0 or not 0 < count <= left:
            raise InputError("is damaged: $Elements announces what it does not have")
        rows = section.take(INT, count * (1 + marks + kind.nodes)).reshape(count, -1)
        yield kind, marks, rows[:, 1:]
        left -= count


def _ascii_runs(section: _Section) -> Iterator[tuple[Kind, int, Integers]]:
    """Rows of one length at a time: number, kind, count of marks, marks, nodes."""
    left = section.one(SIZE)
    rest = _whole(section.rest())
    width = 1
    while left > 0:
        if rest.size < 3:
            raise InputError("is damaged: $Elements has fewer elements than it announces")
        kind, marks = _kind(int(rest[1])), int(rest[2])
        length = 3 + marks + kind.nodes
        if marks < 0 or rest.size < length:
            raise InputError("is damaged: $Elements ends within an element")
        count = min(width, left, rest.size // length)
        rows = rest[: count * length].reshape(count, length)
        alike = (rows[:, 1:3] == rest[1:3]).all(axis=1)
        same = count if alike.all() else int(np.argmin(alike))
        yield kind, marks, rows[:same, 3:]
        rest, left = rest[same * length :], left - same
        width = 2 * width if same == count else 1  # never looks far for little


def _read_4(sections: dict[str, _Section]) -> tuple[Floats, list[Block]]:
    """Format 4.1: nodes and elements in blocks, one for each entity of the geometry."""
    groups = _entities(sections["Entities"]) if "Entities" in sections else {}
    nodes, tags, points = sections["Nodes"], [], []
    for _ in range(int(nodes.take(SIZE, 4)[0])):
        dimension, _, parametric = nodes.take(INT, 3).tolist()
        count = nodes.one(SIZE)
        columns = 3 + (dimension if parametric == 1 else 0)
        if not 0 <= dimension <= 3 or parametric not in (0, 1):
            raise InputError("is damaged: a block of $Nodes has a wrong head")
        tags.append(nodes.take(SIZE, count))
        points.append(nodes.take(FLOAT, columns * count).reshape(count, columns)[:, :3])
    find = _finder(np.concatenate([np.empty(0, np.int64), *tags]))
    elements, blocks = sections["Elements"], []
    for _ in range(int(elements.take(SIZE, 4)[0])):
        dimension, entity, number = elements.take(INT, 3).tolist()
        kind, count = _kind(number), elements.one(SIZE)
        rows = elements.take(SIZE, count * (1 + kind.nodes)).reshape(count, 1 + kind.nodes)
        marks = groups.get((dimension, entity), np.empty(0, np.int64))
        blocks.append(Block(kind.name, find(rows[:, 1:]), np.tile(marks, (count, 1))))
    return np.concatenate([np.empty((0, 3)), *points]), blocks


def _entities(section: _Section) -> dict[tuple[int, int], Integers]:
    """The physical groups of each entity, by its dimension and tag."""
    found = {}
    for dimension, count in enumerate(section.take(SIZE, 4).tolist()):
        for _ in range(count):
            tag = section.one(INT)
            section.take(FLOAT, 6 if dimension else 3)  # where it is
            # a negative number is a group whose elements are turned round
            found[dimension, tag] = np.abs(section.take(INT, section.one(SIZE)))
            if dimension:
                section.take(INT, section.one(SIZE))  # what bounds it
    return found


def _names(text: bytes) -> dict[tuple[int, int], str]:
    """Names of groups: lines of dimension, number and name in quotes, after their count."""
    found = {}
    for line in text.split(b"\n")[1:]:
        if not line.strip():
            continue
        try:
            dimension, number, name = line.decode().split(maxsplit=2)
            found[int(dimension), int(number)] = name.strip().strip('"')
        except ValueError as error:
            raise InputError(f"is damaged: the name of a group is {shown(line)}") from error
    return found


def _kind(number: int) -> Kind:
    if number not in KINDS:
        what = FOREIGN.get(number, f"elements of Gmsh's type {number}")
        raise InputError(f"only triangles are supported, not {what}")
    return KINDS[number]


def _finder(tags: Integers) -> Callable[[Integers], Integers]:
    """From tags of nodes to their places; tags may be any numbers, they size nothing."""
    order = np.argsort(tags, kind="stable")
    ordered = tags[order]
    if (np.diff(ordered) == 0).any():
        raise InputError("is damaged: two nodes have one tag")

    def find(wanted: Integers) -> Integers:
        at = np.minimum(np.searchsorted(ordered, wanted), max(len(tags) - 1, 0))
        if not len(tags) or (ordered[at] != wanted).any():
            raise InputError("is damaged: an element names a node that is not in the file")
        return np.asarray(order[at], dtype=np.int64)

    return find


def _whole(values: np.ndarray) -> Integers:
    """Numbers that must be whole as integers."""
    if values.dtype.kind == "f" and not (np.abs(values) < 2.0**53).all():
        raise InputError("is damaged: a number of a node or an element is out of range")
    whole = values.astype(np.int64)
    if (whole != values).any():
        raise InputError("is damaged: a number of a node or an element is not whole")
    return whole
