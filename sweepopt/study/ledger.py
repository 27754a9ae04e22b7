"""What a study has finished, kept so that kill -9 at any moment loses none of it.

A folder with study.json (what was asked), cells/ID.json and references/ID.npy + ID.json. A file is
written beside its place, forced to the disk and moved there, and carries a checksum: what is not
whole is not there, and is computed again.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from sweepopt.io import put, sealed, unsealed
from sweepopt.study.measure import Cell, CellRow
from sweepopt.study.reference import Reference

KINDS: dict[str, Any] = get_type_hints(CellRow)


class Ledger:
    """The results folder of a study.

    Parameters
    ----------
    folder : Path
        Made if it is not there.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for part in ("cells", "references"):
            (folder / part).mkdir(parents=True, exist_ok=True)

    def describe(self, study: dict[str, Any]) -> None:
        """Keep what was asked."""
        put(self.folder / "study.json", json.dumps(study, indent=2).encode())

    def row(self, cell: Cell) -> CellRow | None:
        """The row of a finished cell, None if it is not finished."""
        found = _read(self._cell(cell.id))
        if found is None or set(found) != set(KINDS):
            return None
        return CellRow(**{name: KINDS[name](found[name]) for name in CellRow._fields})

    def keep(self, row: CellRow) -> None:
        """Keep a finished cell."""
        content = {name: _plain(value) for name, value in row._asdict().items()}
        put(self._cell(row.cell), sealed(content))

    def reference(self, cell: Cell) -> Reference | None:
        """The reference of a cell, None if it is not finished."""
        path = self._reference(cell)
        found = _read(path)
        try:
            content = path.with_suffix(".npy").read_bytes()
        except OSError:
            return None
        if found is None or found["states"] != hashlib.sha256(content).hexdigest():
            return None
        u = np.load(io.BytesIO(content), allow_pickle=False)
        return Reference(u, float(found["uncertainty"]), found["kind"], found["message"])

    def keep_reference(self, cell: Cell, reference: Reference) -> None:
        """Keep the reference of a cell."""
        buffer = io.BytesIO()
        np.save(buffer, reference.u, allow_pickle=False)
        content = buffer.getvalue()
        path = self._reference(cell)
        put(path.with_suffix(".npy"), content)
        about = {
            "problem": cell.problem.name,
            "steps": cell.steps,
            "uncertainty": _plain(reference.uncertainty),
            "kind": reference.kind,
            "message": reference.message,
            "states": hashlib.sha256(content).hexdigest(),
        }
        put(path, sealed(about))

    def _cell(self, name: str) -> Path:
        return self.folder / "cells" / f"{name}.json"

    def _reference(self, cell: Cell) -> Path:
        name = f"{cell.problem.name}-{cell.problem.digest[:16]}-{cell.steps}"
        return self.folder / "references" / f"{name}.json"


def _plain(value: Any) -> Any:
    """A value that JSON has; numbers that are not finite as words."""
    if isinstance(value, float) and not math.isfinite(value):
        return repr(float(value))
    return value.item() if isinstance(value, np.generic) else value


def _read(path: Path) -> Any:
    """The content of a file, None if it is not there or not whole."""
    try:
        return unsealed(path.read_bytes())
    except (OSError, ValueError):
        return None
