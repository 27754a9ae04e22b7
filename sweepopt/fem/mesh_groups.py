"""Sets and groups of mesh files that meshio reads in part, or gives to other elements.

Of an Abaqus file it keeps the last part of a set that has several, the first name of a line of
names, and gives the sets of *ELEMENT to wrong blocks if one has none. Of Gmsh 4 it loses groups of
an entity that are not its first and have no name, and entities that a group takes turned round.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from itertools import chain

import meshio
import numpy as np

from sweepopt.errors import InputError

MOVED = {"ELGEN", "ELCOPY", "NGEN", "NCOPY", "NFILL", "NMAP", "INCLUDE", "SYSTEM"}
"""Keywords of Abaqus that make or move nodes and elements."""
SETS = {"NODE": "NSET", "ELEMENT": "ELSET", "NSET": "NSET", "ELSET": "ELSET"}
"""Which sets the keywords have, or are."""

Section = tuple[str, dict[str, str], list[list[str]]]


def read_abaqus(content: bytes) -> meshio.Mesh:
    """Nodes and elements of an Abaqus file as meshio reads them, with all parts of its sets."""
    sections = list(_sections(content.decode(errors="replace")))
    for keyword, given, rows in sections:
        if keyword in MOVED or "SYSTEM" in given or (keyword == "INSTANCE" and rows):
            raise InputError(f"has *{keyword}, which makes or moves nodes; save it without")
    nodes = [row for keyword, _, rows in sections if keyword == "NODE" for row in rows]
    lines = ["*NODE", *map(",".join, nodes)]
    for keyword, given, rows in sections:
        if keyword == "ELEMENT":
            lines += [f"*ELEMENT, TYPE={given['TYPE'].upper()}", *map(",".join, rows)]
    raw = meshio.read(io.StringIO("\n".join(lines)), "abaqus")
    counts = iter([len(block.data) for block in raw.cells])
    blocks, sets = [], dict[str, dict[str, list[int]]](NSET={}, ELSET={})
    names = dict[tuple[str, str], str]()  # as they are first written: capitals are the same
    for keyword, given, rows in sections:
        if (kind := SETS.get(keyword)) is None:
            continue
        members = _members(keyword, "GENERATE" in given, rows, sets[kind])
        if keyword == "ELEMENT":  # after each number are those of its nodes
            members = members[:: len(members) // next(counts)]
            blocks.append(members)
        if kind in given:
            names.setdefault((kind, given[kind].upper()), given[kind])
            sets[kind].setdefault(given[kind].upper(), []).extend(members)
    numbers = [int(row[0]) for row in nodes]
    for what, every in (("nodes", numbers), ("elements", list(chain(*blocks)))):
        if len(set(every)) < len(every):
            raise InputError(f"has two {what} of one number, as files of several parts do")
    raw.point_sets = {
        names["NSET", key]: _positions(own, numbers) for key, own in sets["NSET"].items()
    }
    raw.cell_sets = {
        names["ELSET", key]: [_positions(own, block) for block in blocks]
        for key, own in sets["ELSET"].items()
    }
    return raw


def group_entities(raw: meshio.Mesh, content: bytes) -> None:
    """Make sets of the physical groups of a Gmsh 4 file, from the entities that are in each."""
    names = {tuple(np.ravel(value)): name for name, value in raw.field_data.items()}
    groups = dict[str, list[np.ndarray]]()
    numbers = raw.cell_data["gmsh:geometrical"]  # one in each block
    places = [(block.dim, *own[:1]) for block, own in zip(raw.cells, numbers, strict=True)]
    for (dimension, entity), tags in _physical(content):
        for tag in dict.fromkeys(map(abs, tags)):  # turned round where it is negative
            members = groups.setdefault(
                names.get((tag, dimension), str(tag)), [np.arange(0) for _ in raw.cells]
            )
            for k, place in enumerate(places):
                if place == (dimension, entity):
                    members[k] = np.arange(len(numbers[k]))
    raw.cell_data.pop("gmsh:physical", None)
    raw.cell_sets = groups


def _physical(content: bytes) -> Iterator[tuple[tuple[int, int], list[int]]]:
    """Dimension and number of each entity of a Gmsh 4 file, with the numbers of its groups."""
    header = content.split(b"\n", 2)[1].split()
    body = content.partition(b"\n$Entities")[2].partition(b"\n")[2]
    words, at = body.partition(b"$")[0].split() if header[1] == b"0" else None, 0

    def take(kind: str, count: int = 1) -> list[int]:
        nonlocal at
        if words is None:
            values = np.frombuffer(body, kind, count, at)
            at += values.nbytes
            return values.tolist()
        at += count
        return [int(float(word)) for word in words[at - count : at]]

    size = f"u{header[2].decode()}"
    for dimension, count in enumerate(take(size, 4)):
        for _ in range(count):
            (entity,) = take("i4")
            take("f8", 3 if dimension == 0 and header[0] != b"4.0" else 6)
            yield (dimension, entity), take("i4", *take(size))
            if dimension:
                take("i4", *take(size))


def _positions(members: list[int], numbers: list[int]) -> np.ndarray:
    return np.flatnonzero(np.isin(numbers, members))


def _sections(text: str) -> Iterator[Section]:
    """Each keyword with what is given in its line, and the lines of data behind it."""
    lines = ["", *(line for line in text.splitlines() if not line.startswith("**"))]
    for section in "\n".join(lines).split("\n*")[1:]:
        head, *lines = section.splitlines()
        while head.rstrip().endswith(",") and "=" in "".join(lines[:1]):
            head += lines.pop(0)
        keyword, *given = (part.strip() for part in head.split(","))
        ends = (line.strip().rstrip(",") for line in lines)
        rows = [[part.strip() for part in line.split(",")] for line in ends if line]
        pairs = (part.partition("=") for part in given)
        yield (
            keyword.upper(),
            {name.strip().upper(): value.strip() for name, _, value in pairs},
            rows,
        )


def _members(
    keyword: str, steps: bool, rows: list[list[str]], sets: dict[str, list[int]]
) -> list[int]:
    """Numbers of the nodes or elements in the lines of a keyword."""
    if keyword == "NODE":
        return [int(row[0]) for row in rows]
    if steps:
        bounds = ([*map(int, row), 1][:3] for row in rows)
        return [k for first, last, step in bounds for k in range(first, last + 1, step)]
    return [
        k for one in chain(*rows) for k in ([int(one)] if one.isdecimal() else sets[one.upper()])
    ]
