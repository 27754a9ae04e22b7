"""What a study has finished, kept so that kill -9 at any moment loses none of it.

A folder with study.json (what was asked), rows.jsonl (a line of JSON for each finished cell, forced
to the disk before the next one starts) and references/NAME.npz. Lines and files carry checksums:
what is not whole is not there, and is computed again.
"""

from __future__ import annotations

import json
import math
import os
import zlib
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from sweepopt.errors import DamagedFileError
from sweepopt.io import put, read_npz, write_npz
from sweepopt.study.cell import Cell, CellRow
from sweepopt.study.reference_states import Reference

COLUMNS: dict[str, Any] = get_type_hints(CellRow)


class Ledger:
    """The results folder of a study.

    Parameters
    ----------
    folder : Path
        Made if it is not there.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self._path = folder, folder / "rows.jsonl"
        (folder / "references").mkdir(parents=True, exist_ok=True)
        content = self._path.read_bytes() if self._path.exists() else b""
        # a line that a kill cut short must not spoil the next one
        self._start = b"" if content.endswith(b"\n") or not content else b"\n"
        rows = [_row(line) for line in content.splitlines()]
        self._rows = {row.cell: row for row in rows if row is not None}

    def describe(self, study: dict[str, Any]) -> None:
        """Keep what was asked."""
        put(self.folder / "study.json", json.dumps(study, indent=2).encode())

    def row(self, cell: Cell) -> CellRow | None:
        """The row of a finished cell, None if it is not finished."""
        return self._rows.get(cell.id)

    def keep(self, row: CellRow) -> None:
        """Add the row of a finished cell."""
        content = {name: _plain(value) for name, value in row._asdict().items()}
        line = json.dumps({"row": content, "crc32": _checksum(content)}, allow_nan=False)
        with self._path.open("ab") as file:
            file.write(self._start + line.encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())
        self._start = b""
        self._rows[row.cell] = row

    def reference(self, cell: Cell) -> Reference | None:
        """The reference of a cell, None if it is not finished."""
        try:
            record, arrays = read_npz(self._reference(cell))
        except (OSError, DamagedFileError):
            return None
        return Reference(arrays["u"], **record)

    def keep_reference(self, cell: Cell, reference: Reference) -> None:
        """Keep the reference of a cell; a zip has a checksum for each of its entries."""
        record = reference._asdict()
        arrays = {"u": record.pop("u")}
        write_npz(self._reference(cell), record, arrays)

    def _reference(self, cell: Cell) -> Path:
        name = f"{cell.problem.name}-{cell.problem.digest[:16]}-{cell.steps}.npz"
        return self.folder / "references" / name


def _row(line: bytes) -> CellRow | None:
    """The row in a line, None if the line is not whole or has other columns."""
    try:
        record = json.loads(line)
        row, whole = record["row"], record["crc32"] == _checksum(record["row"])
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    if not whole or set(row) != set(COLUMNS):
        return None
    return CellRow(**{name: kind(row[name]) for name, kind in COLUMNS.items()})


def _plain(value: Any) -> Any:
    """A value that JSON has; numbers that are not finite as words, which `float` reads."""
    if isinstance(value, float) and not math.isfinite(value):
        return repr(float(value))
    return value.item() if isinstance(value, np.generic) else value


def _checksum(row: dict[str, Any]) -> int:
    return zlib.crc32(json.dumps(row, sort_keys=True).encode())
