"""Where the problem of a cell comes from, and a digest of its data: an edited scene is another."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from sweepopt.errors import InputError, SweepoptError
from sweepopt.io import find_scene, read_bytes, read_toml
from sweepopt.problem import SweepingProcess
from sweepopt.study import problems


class Source(NamedTuple):
    """A problem by name, as plain data that a worker opens.

    Attributes
    ----------
    name : str
        In the table: of a problem of `sweepopt.study.problems`, or of a scene's file.
    path : str
        The file that states it.
    digest : str
        SHA-256 of all files that state the problem.
    refinements : int
        Of the scene's mesh, beyond its own.
    element : str
        In place of the scene's own; "" is that one.
    """

    name: str
    path: str
    digest: str
    refinements: int = 0
    element: str = ""

    def __str__(self) -> str:
        return body_name(self.name, self.refinements, self.element)

    @property
    def small(self) -> bool:
        """Whether it is one of `sweepopt.study.problems`, which have no mesh."""
        return self.path == str(problems.FILE)


def find_source(name: str, folder: str | Path = ".") -> Source:
    """The problem of that name.

    Parameters
    ----------
    name : str
        A name of `sweepopt.study.problems`, of a scene that comes with the library, or the path of
        a scene file.
    folder : str or Path
        Where relative paths start.

    Raises
    ------
    InputError
        If there is none, or its files cannot be read.

    Examples
    --------
    >>> find_source("S03").name, Path(find_source("tube").path).name
    ('S03', 'tube.toml')
    """
    if name in problems.PROBLEMS:
        return Source(name, str(problems.FILE), _digest(problems.FILE))
    path = Path(folder, name)
    if path.suffix != ".toml":
        try:
            path = find_scene(name)
        except InputError as error:
            known = ", ".join(problems.PROBLEMS)
            raise InputError(f"{error}, and for studies {known}") from error
    path = path.resolve()
    return Source(path.stem, str(path), _digest(path))


def body_name(name: str, refinements: int, element: str) -> str:
    """A problem's name with its mesh, such as "square P2 h/4"."""
    return " ".join(filter(None, [name, element, f"h/{2**refinements}" if refinements else ""]))


@lru_cache(maxsize=8)
def open_source(source: Source) -> tuple[SweepingProcess, float, Any]:
    """The process, how long it runs, and a scene's discretisation, built once in each worker.

    Raises
    ------
    SweepoptError
        If the files are not those the digest was taken of.
    """
    path = Path(source.path)
    if _digest(path) != source.digest:
        raise SweepoptError(f"{path} is not as it was when the study started; start it again")
    if source.small:
        small = problems.PROBLEMS[source.name]
        return small.process(), small.t_end, None
    from sweepopt.fem import read_scene

    data = read_toml(path)
    if source.refinements or source.element:
        domain = data["domain"]
        domain["refinements"] = domain.get("refinements", 0) + source.refinements
        domain["element"] = source.element or domain.get("element", "P1")
    scene = read_scene(data, folder=path.parent)
    assert scene.t_end is not None  # a file has it
    return scene.problem.as_sweeping(), scene.t_end, scene.discretisation


@lru_cache(maxsize=8)
def from_coarser(source: Source, coarse: Source) -> Any:
    """The matrix that turns states on a coarser mesh of a scene into states on a finer one."""
    return open_source(source)[2].from_coarser(open_source(coarse)[2])


def _digest(path: Path) -> str:
    """Of a file, of its mesh and of its tables."""
    files = [path, *(path.parent / name for name in _file_names(read_toml(path)))]
    parts = [hashlib.sha256(read_bytes(file)).digest() for file in files]
    return hashlib.sha256(b"".join(parts)).hexdigest()


def _file_names(data: Any) -> Iterator[str]:
    """The values of the keys mesh, csv and run, wherever they are."""
    if isinstance(data, dict):
        yield from (data[key] for key in ("mesh", "csv", "run") if isinstance(data.get(key), str))
        data = list(data.values())
    if isinstance(data, list):
        for entry in data:
            yield from _file_names(entry)
