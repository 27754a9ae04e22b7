"""Columns of numbers from CSV files, refused with file, column and row (the file's line number)."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sweepopt.errors import InputError, shown
from sweepopt.texts import read_text

Array = NDArray[np.float64]


def read_columns(path: str | Path, *names: str) -> tuple[Array, list[int]]:
    """Named columns of a CSV file with decimal points and commas between the cells.

    Parameters
    ----------
    path : str or Path
        First line that is neither empty nor a ``#`` comment: the column names.

    Returns
    -------
    columns : ndarray, shape (len(names), m)
    rows : list of int
        Line number of each row in the file.

    Raises
    ------
    InputError
        Naming the file, the column and the row at fault.
    """
    lines = _rows(path, _text(path))
    header = [name.strip() for name in next(lines, (0, []))[1]]
    for name in names:
        if header.count(name) != 1:
            fault = "is there twice" if name in header else "is missing"
            raise InputError(
                f"{path}: column {name!r} {fault}; there are: {', '.join(header) or 'none'}"
            )
    picked = [header.index(name) for name in names]
    rows: list[int] = []
    data: list[list[float]] = []
    for row, cells in lines:
        if len(cells) > len(header):
            raise InputError(
                f"{path}, row {row}: {len(cells)} cells under {len(header)} column names; "
                "write decimals with a point (1.5, not 1,5)"
            )
        cells += [""] * (len(header) - len(cells))
        rows.append(row)
        data.append(
            [
                _number(f"{path}, column {name!r}, row {row}", cells[k].strip())
                for name, k in zip(names, picked, strict=True)
            ]
        )
    return np.array(data, dtype=float).reshape(-1, len(names)).T, rows


def _text(path: str | Path) -> str:
    if not isinstance(path, (str, os.PathLike)):
        raise InputError(f"path must be the path of a CSV file, got {shown(path)}")
    return read_text(Path(path), "; export it as CSV", "utf-8-sig")


def _rows(path: str | Path, text: str) -> Iterator[tuple[int, list[str]]]:
    for row, line in enumerate(text.splitlines(), start=1):
        if line.strip() and not line.lstrip().startswith("#"):
            try:
                yield row, next(csv.reader([line]))
            except csv.Error as error:  # a cell beyond the reader's limit
                raise InputError(f"{path}, row {row}: {error}; is it a table?") from error


def _number(where: str, cell: str) -> float:
    try:
        value = math.nan if "_" in cell else float(cell)  # Python reads 1_0 as 10
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where}: {shown(cell)} is not a finite number")
    return value
