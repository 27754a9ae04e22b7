"""A study as one HTML file that works without a network: table, diagram, trajectories, versions.

The page's parts lie in `page/`. Its data are JSON, which scripts insert as text only, and its
policy lets nothing run or load that this module did not put there.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.resources import files
from math import inf, isnan
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

import numpy as np

from sweepopt.checks import count, vector
from sweepopt.errors import InputError, Status
from sweepopt.io import replacing
from sweepopt.study.cells import ACCURACIES, COSTS, VERSIONS, distinct, read_cells
from sweepopt.study.hard.page import hard_page
from sweepopt.study.rows import processor, versions

if TYPE_CHECKING:
    from pandas import DataFrame

    from sweepopt.study.hard.table import HardRow

SCRIPTS = tuple(
    f"{name}.js"
    for name in ("helpers", "filters", "table", "diagram", "trajectory", "hard", "main")
)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One component of a run over time, with the band that surely holds the solution.

    Attributes
    ----------
    problem, scheme : str
    steps : int
    t, u : ndarray, shape (k,)
        Times, strictly increasing, and the component there.
    band : ndarray, shape (k,), or None
        Half-width of the band: a bound of the component's error at each time.
    component : str
        What u is, for example "displacement of the block (mm)".

    Raises
    ------
    InputError
        If shapes disagree, a number is not finite, times do not increase or a half-width is below
        zero.

    Examples
    --------
    >>> run = Trajectory("block", "midpoint", 2, [0, 1, 2], [0.0, 0.5, 0.5], [0.0, 0.1, 0.1], "mm")
    >>> run.u - run.band
    array([0. , 0.4, 0.4])
    """

    problem: str
    scheme: str
    steps: int
    t: np.ndarray
    u: np.ndarray
    band: np.ndarray | None = None
    component: str = "u"

    def __post_init__(self) -> None:
        count("steps", self.steps)
        t = vector("t", self.t)
        if t.size < 2 or not (np.diff(t) > 0.0).all():
            raise InputError("t must hold two times or more, each later than the one before")
        checked = {"t": t, "u": vector("u", self.u, t.size)}
        if self.band is not None:
            checked["band"] = band = vector("band", self.band, t.size)
            if (band < 0.0).any():
                k = int(np.flatnonzero(band < 0.0)[0])
                raise InputError(f"band[{k}] is {band[k]:g}; give half-widths >= 0")
        for name, value in checked.items():
            object.__setattr__(self, name, value)


def write_report(
    table: DataFrame | None,
    path: str | os.PathLike[str],
    *,
    trajectories: Sequence[Trajectory] = (),
    hard: Sequence[HardRow] = (),
    title: str = "Accuracy and what it costs",
) -> Path:
    """Write a study as one HTML file; nothing is fetched when it is opened.

    Parameters
    ----------
    table : pandas DataFrame or None
        Of a study, one row a cell; None if there are hard cases only.
    path : path
        The file to write; one that is there is replaced.
    trajectories : sequence of Trajectory
        Drawn below the table; those of one problem and component share a picture.
    hard : sequence of HardRow
        Runs of hard cases of this session, a page of their own.
    title : str
        The report's heading.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If the table is not a study's, a trajectory is not a Trajectory or the path no place for a
        file.

    Examples
    --------
    >>> import pandas as pd, tempfile
    >>> from sweepopt.study.cells import COLUMNS
    >>> cell = {"problem": "block", "scheme": "midpoint", "status": "SUCCESS", "success": True}
    >>> table = pd.DataFrame([cell | {"wall": 0.1, "error": 1e-5}], columns=list(COLUMNS))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = write_report(table, f"{folder}/study.html", title="One cell")
    ...     "<title>One cell</title>" in path.read_text(encoding="utf-8")
    True
    """
    if table is None and not hard:
        raise InputError("table is None and there are no hard cases: nothing to report")
    cells = [] if table is None else read_cells(table)
    for k, trajectory in enumerate(trajectories):
        if not isinstance(trajectory, Trajectory):
            raise InputError(
                f"trajectories[{k}] must be a Trajectory, got {type(trajectory).__name__}"
            )
    target = Path(path)
    if not target.absolute().parent.is_dir():
        raise InputError(f"path {str(target)!r} lies in a folder that does not exist; make it")
    if target.is_dir():
        raise InputError(f"path {str(target)!r} is a folder; name a file in it")
    data = {
        "title": title,
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "machines": _seen(distinct(cells, "machine"), f"{processor()}, {platform.system()}", hard),
        "versions": {
            name: _seen(distinct(cells, name), versions()[name], hard) for name in VERSIONS
        },
        "costs": COSTS,
        "accuracies": ACCURACIES,
        "usual": Status.SUCCESS.value,  # the one message that need not be shown
        "cells": cells,
        "trajectories": [vars(trajectory) for trajectory in trajectories],
        "hard": hard_page(hard) if hard else None,
    }
    with replacing(target) as part:
        part.write_text(_page(title, data), encoding="utf-8")
    return target


def _seen(of_cells: list[Any], here: str, hard: Sequence[HardRow]) -> list[Any]:
    """With those of this process, where hard cases were run in it."""
    return list(dict.fromkeys([*of_cells, here])) if hard else of_cells


def _page(title: str, data: dict[str, Any]) -> str:
    page = files("sweepopt.study") / "page"
    style = page.joinpath("report.css").read_text(encoding="utf-8")
    parts = [page.joinpath(name).read_text(encoding="utf-8") for name in SCRIPTS]
    script = "\n".join(['"use strict";', *parts])
    policy = (
        f"default-src 'none'; img-src data:; style-src {_digest(style)}; "
        f"script-src {_digest(script)}; base-uri 'none'; form-action 'none'"
    )
    return Template(page.joinpath("report.html").read_text(encoding="utf-8")).substitute(
        title=html.escape(title), policy=policy, style=style, script=script, data=_json(data)
    )


def _digest(text: str) -> str:
    """What a policy calls an inline script or style that may be used."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _json(data: Any) -> str:
    """Valid JSON inside of an HTML script element: no text can close the element."""
    text = json.dumps(_plain(data), allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _plain(value: Any) -> Any:
    """Lists, dicts and finite numbers; nan is null, infinity the word "inf"."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and isnan(value):
        return None
    if isinstance(value, float) and abs(value) == inf:
        return "inf" if value > 0.0 else "-inf"
    return value
