"""Scene files: TOML whose values are data (numbers, tables, columns, named waveforms), never code.

The shape of a file is checked by the pydantic models below; the tables under ``[effects]`` are
read into the records of `EFFECTS`, whose fields are their keys and which check themselves. Every
error starts with the path of the key at fault, such as ``effects.friction.g``.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from sweepopt.errors import InputError, shown
from sweepopt.fem.effects import (
    BodyForce,
    Effect,
    Elasticity,
    Friction,
    Traction,
    Viscosity,
    boundary_names,
)
from sweepopt.fem.fields import Profile
from sweepopt.fem.mesh import read_mesh
from sweepopt.fem.scene import Scene, at_path, build, check_choices
from sweepopt.fem.spaces import Discretisation
from sweepopt.io import as_path, find_scene, parse_toml, read_toml
from sweepopt.loads import Constant, History, Sine, Table, Triangle, check_points

EFFECTS: dict[str, type] = {
    "viscosity": Viscosity,
    "elasticity": Elasticity,
    "friction": Friction,
    "body_force": BodyForce,
    "traction": Traction,
}
"""Effects by the name of their table in a scene file."""

WAVEFORMS: dict[str, type] = {"constant": Constant, "sine": Sine, "triangle": Triangle}
"""Histories by the name of their waveform in a scene file."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class _Domain(_Part):
    mesh: str
    clamped: str | list[str] = "clamped"
    element: Literal["P1", "P2"] = "P1"


class _Time(_Part):
    end: Annotated[float, Field(gt=0)]
    steps: Annotated[int, Field(ge=1)]


class _Solve(_Part):
    scheme: str = "auto"
    solver: str = "auto"
    tol: Annotated[float, Field(gt=0)] = 1e-6


class _File(_Part):
    domain: _Domain
    time: _Time
    effects: dict[str, Any]
    solve: _Solve = _Solve()
    title: str = ""
    units: Literal["dimensionless", "SI"] = "dimensionless"


@dataclass(frozen=True)
class _CsvColumn:
    """``history = { csv = "loads.csv", column = "f2", time = "t", scale = 1.0 }``."""

    csv: str
    column: str
    time: str = "t"
    scale: float = 1.0


@dataclass(frozen=True)
class _Rows:
    """``history = { table = { t = [...], values = [...] } }``."""

    t: list[float]
    values: list[float]

    def __post_init__(self) -> None:
        check_points("t", self.t, self.values)


def read_scene(source: str | Path | Mapping[str, Any], *, folder: str | Path = ".") -> Scene:
    """Read a scene and assemble it.

    Parameters
    ----------
    source : str, Path or mapping
        A path of a TOML file, the name of a problem of the library (see `sweepopt list`), TOML
        text (anything with a line break), or the mapping that such text stands for.
    folder : str or Path
        Where relative paths of meshes and tables start; a file's own folder for a file.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        Naming the key at fault by its path in the file.

    Notes
    -----
    ::

        title = "..."                   # optional; units = "SI" or "dimensionless" (default)
        [domain]
        mesh = "tube.msh"               # Gmsh, physical groups by name
        clamped = "bonded"              # a name or a list; "clamped" if not given
        element = "P1"                  # or "P2"
        [time]
        end = 10.0
        steps = 400
        [solve]                         # optional: scheme, solver, tol of sweepopt.solve
        [effects.viscosity]
        eta = { core = 1.0, sleeve = 0.2 }
        [effects.elasticity]
        kappa = { along = "radius", at = [1.0, 2.0], values = [1.0, 3.0] }
        [effects.friction]
        on = "contact"
        g = 0.3
        [[effects.traction]]            # a table, or several
        on = "outer"
        history = { csv = "loads.csv", column = "f2" }
        [effects.body_force]
        f0 = 2.0
        history = { waveform = "sine", amplitude = 1.0, period = 4.0 }

    Other histories: ``{ waveform = "triangle", amplitude, period }``,
    ``{ waveform = "constant", value }``, ``{ table = { t = [...], values = [...] } }``.

    Examples
    --------
    >>> scene = read_scene("tube")
    >>> scene.t_end, scene.steps, scene.units
    (120.0, 480, 'SI')
    """
    data, folder = _load(source, as_path("folder", folder))
    file = _validate(data)
    effects = _effects(file.effects, folder)
    with at_path("domain"):
        try:
            mesh = read_mesh(folder / file.domain.mesh)
        except InputError as error:
            raise InputError(f"mesh: {error}") from error
        clamped = boundary_names("clamped", file.domain.clamped)
        body = Discretisation(mesh, clamped, file.domain.element)
    settings = {
        "t_end": file.time.end,
        "steps": file.time.steps,
        "units": file.units,
        "title": file.title,
        **file.solve.model_dump(),
    }
    scene = build(body, effects, None, settings)
    with at_path("solve"):
        check_choices(scene)
    return scene


def _load(source: str | Path | Mapping[str, Any], folder: Path) -> tuple[Mapping[str, Any], Path]:
    if isinstance(source, Mapping):
        return source, folder
    if not isinstance(source, (str, os.PathLike)):
        raise InputError(
            "source must be a path, the name of a problem, TOML text or a mapping, "
            f"got {shown(source)}"
        )
    if isinstance(source, str) and "\n" in source:
        return parse_toml("the scene", source), folder
    path = find_scene(source) if isinstance(source, str) else Path(source)
    return read_toml(path), path.parent


def _validate(data: Mapping[str, Any]) -> _File:
    try:
        return _File.model_validate(data)
    except ValidationError as error:
        faults = []
        for fault in error.errors():
            # a union repeats the key with the name of the branch it tried
            path = ".".join(str(key) for key in fault["loc"] if key not in ("str", "list[str]"))
            asked = fault["msg"].replace("Input should be", "must be")
            message = {"extra_forbidden": "unknown key", "missing": "is missing"}.get(
                fault["type"], f"{asked}, got {shown(fault['input'])}"
            )
            faults.append(f"{path}: {message}")
        raise InputError("; ".join(dict.fromkeys(faults))) from error


def _effects(tables: Mapping[str, Any], folder: Path) -> dict[str, Effect]:
    found: dict[str, Effect] = {}
    for name, table in tables.items():
        if name not in EFFECTS:
            raise InputError(f"effects.{name}: unknown key; there are: {', '.join(EFFECTS)}")
        several = table if isinstance(table, list) else [table]
        for k, one in enumerate(several):
            label = f"effects.{name}[{k}]" if isinstance(table, list) else f"effects.{name}"
            found[label] = _record(EFFECTS[name], one, label, folder)
    return found


def _record(kind: Callable[..., Any], table: Any, path: str, folder: Path) -> Any:
    """A record from a table whose keys are the record's fields."""
    if not isinstance(table, Mapping):
        raise InputError(f"{path}: must be a table, got {shown(table)}")
    known = {field.name: field for field in fields(kind)}  # type: ignore[arg-type]
    for key in table:
        if key not in known:
            raise InputError(f"{path}.{key}: unknown key; there are: {', '.join(known)}")
    for key, field in known.items():
        if field.default is MISSING and key not in table:
            raise InputError(f"{path}.{key}: is missing")
    values = {key: _value(key, value, f"{path}.{key}", folder) for key, value in table.items()}
    for key, value in values.items():
        wanted = {"float": (int, float), "str": (str,)}.get(str(known[key].type))
        if wanted and (not isinstance(value, wanted) or isinstance(value, bool)):
            kinds = "a number" if float in wanted else "a string"
            raise InputError(f"{path}.{key}: must be {kinds}, got {shown(value)}")
    with at_path(path):
        return kind(**values)


def _value(key: str, value: Any, path: str, folder: Path) -> Any:
    if key == "history":
        return _history(value, path, folder)
    if isinstance(value, Mapping) and "along" in value:
        return _record(Profile, value, path, folder)
    return value


def _history(table: Any, path: str, folder: Path) -> History:
    if not isinstance(table, Mapping):
        raise InputError(f"{path}: must be a table with csv, waveform or table; got {shown(table)}")
    if "csv" in table:
        source: _CsvColumn = _record(_CsvColumn, table, path, folder)
        with at_path(path):
            return Table.from_csv(
                folder / source.csv, source.column, time=source.time, scale=source.scale
            )
    if "waveform" in table:
        rest = dict(table)
        name = rest.pop("waveform")
        if name not in tuple(WAVEFORMS):
            raise InputError(f"{path}.waveform: {shown(name)} is not among {', '.join(WAVEFORMS)}")
        return _record(WAVEFORMS[name], rest, path, folder)
    if set(table) == {"table"}:
        rows: _Rows = _record(_Rows, table["table"], f"{path}.table", folder)
        return Table(rows.t, rows.values)
    raise InputError(f"{path}: must have one of csv, waveform or table; got {', '.join(table)}")
