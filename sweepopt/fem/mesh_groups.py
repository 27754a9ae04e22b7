"""Sets and groups of mesh files that meshio would lose, or give to other elements.

Abaqus files of which it reads sets in part are refused. Of Gmsh 4 it loses groups of an entity that
are not its first and have no name, and entities that a group takes turned round: here they are read
from the file.
"""

import io
from collections.abc import Iterator
from itertools import dropwhile

import meshio
import numpy as np

from sweepopt.errors import InputError

MOVED = {"ELGEN", "ELCOPY", "NGEN", "NCOPY", "NFILL", "NMAP", "INCLUDE", "INPUT", "SYSTEM"}
"""Keywords of Abaqus, and what is given with them, that make or move nodes and elements."""


def read_abaqus(content: bytes) -> meshio.Mesh:
    """The mesh of an Abaqus file whose sets meshio reads as they are."""
    lines = content.decode(errors="replace").splitlines()
    text = "\n".join(line for line in lines if not line.startswith("**"))  # they end its sections
    sections = [_section(part) for part in text.split("\n*")]
    keywords = [keyword for keyword, _, _ in sections]
    sets = [one for one in sections if one[0] in ("NSET", "ELSET")]
    blocks = [given.get("ELSET") for keyword, given, _ in sections if keyword == "ELEMENT"]
    names = [(keyword, given.get(keyword)) for keyword, given, _ in sets]
    names += [("ELSET", name) for name in blocks if name]
    faults = {
        "nodes or elements that a keyword makes or moves": any(
            keyword in MOVED
            or (keyword in ("NODE", "ELEMENT") and given.keys() & MOVED)
            or (keyword == "INSTANCE" and rows)
            for keyword, given, rows in sections
        ),
        "several blocks of nodes": keywords.count("NODE") > 1,
        "elements with a set and others without one": None in blocks and any(blocks),
        "elements behind sets": "ELEMENT" in dropwhile("ELSET".__ne__, keywords),
        "parts of a set in several places": len(set(names)) < len(names),
        "sets of sets": not all(row[:1].isdecimal() for _, _, rows in sets for row in rows),
    }
    for fault, present in faults.items():
        if present:
            raise InputError(
                f"has {fault}, which would be mixed up; write one part with one "
                "*NODE, and behind all elements each set once, as numbers"
            )
    return meshio.read(io.StringIO(text), "abaqus")


def _section(text: str) -> tuple[str, dict[str, str], list[str]]:
    """A keyword in capitals, what is given in its line, and the lines of data behind it."""
    head, *rows = text.strip("*").splitlines() or [""]
    keyword, *given = (word.replace(" ", "") for word in head.upper().split(","))
    pairs = (word.partition("=") for word in given)
    return (
        keyword,
        {name: value for name, _, value in pairs},
        [row.strip() for row in rows if row.strip()],
    )


def group_entities(raw: meshio.Mesh, content: bytes) -> None:
    """Make sets of the physical groups of a Gmsh 4 file, from the entities that are in each."""
    names = {tuple(value): name for name, value in raw.field_data.items()}
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
