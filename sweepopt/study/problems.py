"""Problems of studies: scenes by their files, and small problems, stated in problems.toml.

Letters of the small ones' names: S scalar, V and B on a disc or with B = 0, P polyhedral, L linear,
M Moreau's (A = 0), E elastoplastic, H a hold. All are dimensionless; the exact solution of each is
known. A problem has a digest of its data: an edited scene is another one.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sweepopt import loads, sets
from sweepopt.checks import choice, number
from sweepopt.errors import InputError
from sweepopt.integrate import fingerprint
from sweepopt.io import as_path, find_scene, read_bytes, read_toml
from sweepopt.problem import EvolutionVI, SweepingProcess, sweeping

FILE = Path(__file__).with_suffix(".toml")


@dataclass(frozen=True)
class Problem:
    """A process and how long it runs, as they stand in the file.

    Attributes
    ----------
    name, title : str
    t_end : float
    A, B, u0 : lists of numbers
    set, load : dict, list of dict
        Names of `sweepopt.sets` and of `sweepopt.loads`, with what these are called with.
    """

    name: str
    title: str
    t_end: float
    A: Any
    B: Any
    u0: Any
    set: dict[str, Any]
    load: list[dict[str, Any]]

    def process(self) -> SweepingProcess:
        """The process, built anew."""
        terms = []
        for term in self.load:
            (history, arguments), (_, direction) = term.items()
            terms.append((construct(loads, {history: arguments}), direction))
        load = loads.Separable(terms)
        if "Polyhedron" in self.set:
            C = construct(sets, {"Polyhedron": [*self.set["Polyhedron"], load]})
        else:
            C = sets.Moving(construct(sets, self.set), load)
        return SweepingProcess(self.A, self.B, C, self.u0)


def construct(room: Any, entry: dict[str, Any], *given: Any) -> Any:
    """What a room's function of that name makes of what is given and of its arguments in a file."""
    ((name, arguments),) = entry.items()
    return getattr(room, name)(*given, *arguments)


PROBLEMS = {name: Problem(name, **data) for name, data in read_toml(FILE).items()}


def problem(name: str) -> Problem:
    """The problem of that name.

    Raises
    ------
    InputError
        If there is none.

    Examples
    --------
    >>> problem("S03").process().dim
    1
    """
    return PROBLEMS[choice("problem", name, PROBLEMS)]


# ---- what a study names ----


class Source(NamedTuple):
    """A problem by name, as plain data that a worker opens.

    Attributes
    ----------
    name : str
        In the table: of a problem of PROBLEMS, or of a scene's file.
    path : str
        The file that states it.
    digest : str
        Twelve digits of SHA-256 of all files that state the problem.
    refinements : int
        Of the scene's mesh, beyond its own.
    element : str
        In place of the scene's own; "" is that one.
    own : tuple of SweepingProcess and float, or None
        A process of one's own and how long it runs; it has no path.
    """

    name: str
    path: str
    digest: str
    refinements: int = 0
    element: str = ""
    own: tuple[SweepingProcess, float] | None = None

    def __str__(self) -> str:
        return body_name(self.name, self.refinements, self.element)

    def __repr__(self) -> str:
        return f"Source({self})"

    @property
    def small(self) -> bool:
        """Whether it has no mesh: one of PROBLEMS, or one's own."""
        return self.path in (str(FILE), "")


def find_source(name: str | Path | Source, folder: str | Path = ".") -> Source:
    """The problem of that name.

    Parameters
    ----------
    name : str, Path or Source
        A name of PROBLEMS, of a scene that comes with the library, the path of a scene file, or
        what is found already.
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
    if isinstance(name, Source):
        return name
    if isinstance(name, SweepingProcess):
        raise InputError("a process is given as own_source(name, process, t_end)")
    name = str(as_path("the problem", name))
    if name in PROBLEMS:
        return Source(name, str(FILE), digest_of(FILE))
    path = Path(folder, name)
    if path.suffix != ".toml":
        try:
            path = find_scene(name)
        except InputError as error:
            known = ", ".join(PROBLEMS)
            raise InputError(f"{error}, and for studies {known}") from None
    path = path.resolve()
    return Source(path.stem, str(path), digest_of(path))


def own_source(name: str, process: SweepingProcess | EvolutionVI, t_end: float) -> Source:
    """A process of one's own, for the problems of a `Study` or for `compare`.

    Finished runs of a study are taken from its folder where the process is the same: its data, and
    the values of its functions at 257 times, with u = u0. Give another name to a process that
    differs elsewhere.

    Parameters
    ----------
    name : str
        What tables call it.
    process : SweepingProcess or EvolutionVI
    t_end : float
        How long it runs.

    Raises
    ------
    InputError
        If process is none, or t_end not positive.

    Examples
    --------
    >>> import sweepopt as so
    >>> block = so.EvolutionVI(0.5, 2.0, load=so.Sine(3.0, period=np.pi),
    ...                        dissipation=so.Box(-1.0, 1.0), u0=0.0)
    >>> source = own_source("my block", block, t_end=8.0)
    >>> str(source), source.small
    ('my block', True)
    """
    t_end = number("t_end", t_end, 0.0, strict=True)
    parts = fingerprint(sweeping(process), np.linspace(0.0, t_end, 257))
    digest = hashlib.sha256(repr((t_end, parts)).encode()).hexdigest()[:12]
    return Source(str(name), "", digest, own=(process, t_end))


def body_name(name: str, refinements: int, element: str) -> str:
    """A problem's name with its mesh, such as "square P2 h/4"."""
    return " ".join(filter(None, [name, element, f"h/{2**refinements}" if refinements else ""]))


def digest_of(path: Path) -> str:
    """Of a file, of its mesh, of its tables and of the run it starts from."""
    files = [path, *(path.parent / name for name in _file_names(read_toml(path)))]
    parts = [hashlib.sha256(read_bytes(file)).digest() for file in files]
    return hashlib.sha256(b"".join(parts)).hexdigest()[:12]


def _file_names(data: Any) -> Iterator[str]:
    """The values of the keys mesh, csv and run, wherever they are."""
    entries = data.items() if isinstance(data, dict) else enumerate(data)
    for key, value in entries:
        if isinstance(value, (dict, list)):
            yield from _file_names(value)
        elif key in ("mesh", "csv", "run") and isinstance(value, str):
            yield value
