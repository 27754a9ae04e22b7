"""Files of hard cases: which families, seeds, solvers and paths a table is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

from sweepopt.checks import count, listed, number
from sweepopt.errors import InputError, shown
from sweepopt.study.hard import FAMILIES
from sweepopt.study.hard.table import PATHS, SOLVERS

NAMES = {"families": tuple(FAMILIES), "solvers": tuple(SOLVERS), "paths": PATHS}


@dataclass(frozen=True)
class HardStudy:
    """What `sweepopt study hard` runs; all there is by default.

    Parameters
    ----------
    seeds : sequence of int
        Whole numbers >= 0; each makes every family anew.
    families, solvers, paths : sequence of str
    combinations : int
        How many cases are drawn by chance for each seed.
    tol : float
        What `solve` is asked for.

    Raises
    ------
    InputError
        Naming the key and the entry.

    Examples
    --------
    >>> HardStudy(seeds=[0, 1], families=["threshold"]).families
    ['threshold']
    """

    seeds: Sequence[int] = (0,)
    families: Sequence[str] = NAMES["families"]
    solvers: Sequence[str] = NAMES["solvers"]
    paths: Sequence[str] = NAMES["paths"]
    combinations: int = 8
    tol: float = 1e-6

    def __post_init__(self) -> None:
        for key in ("seeds", *NAMES):
            listed(key, getattr(self, key))
        for i, seed in enumerate(self.seeds):
            count(f"seeds[{i}]", seed, least=0)
        count("combinations", self.combinations, least=0)
        number("tol", self.tol, minimum=0.0, strict=True)
        for key, known in NAMES.items():
            for i, name in enumerate(getattr(self, key)):
                if name not in known:
                    words = f"{key}[{i}]: {shown(name)} is not known; there are: "
                    raise InputError(words + ", ".join(known))


def hard_study(data: Any) -> HardStudy:
    """The table [hard] of a study file.

    Raises
    ------
    InputError
        Naming the key at fault.
    """
    if not isinstance(data, dict):
        raise InputError(f"hard must be a table, got {shown(data)}")
    known = [field.name for field in fields(HardStudy)]
    for key in data:
        if key not in known:
            raise InputError(f"hard.{key}: unknown key; there are: {', '.join(known)}")
    try:
        return HardStudy(**data)
    except InputError as error:
        raise InputError(f"hard.{error}") from error
