"""Scene files: TOML whose values are data (numbers, tables, columns, named waveforms), never code.

The keys of each table are checked by pydantic; the tables under ``[effects]`` are read into the
records of `EFFECTS`, whose fields are their keys and which check their values. Every error starts
with the path of the key at fault, such as ``effects.friction.g``.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model

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


Model = TypeVar("Model", bound=BaseModel)


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


class _CsvColumn(_Part):
    """``history = { csv = "loads.csv", column = "f2", time = "t", scale = 1.0 }``."""

    csv: str
    column: str
    time: str = "t"
    scale: float = 1.0


class _Rows(_Part):
    """``history = { table = { t = [...], values = [...] } }``."""

    t: Any
    values: Any


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
    file = _checked(_File, data)
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


def _checked(model: type[Model], table: Any, path: str = "") -> Model:
    """The model of a table; one below a path says which keys it has."""
    try:
        return model.model_validate(table)
    except ValidationError as error:
        known = f"; there are: {', '.join(model.model_fields)}" if path else ""
        faults = []
        for fault in error.errors():
            # a union repeats the key with the name of the branch it tried
            keys = [str(key) for key in fault["loc"] if key not in ("str", "list[str]")]
            asked = fault["msg"].replace("Input should be", "must be")
            message = {
                "extra_forbidden": f"unknown key{known}",
                "missing": "is missing",
                "model_type": f"must be a table, got {shown(fault['input'])}",
            }.get(fault["type"], f"{asked}, got {shown(fault['input'])}")
            faults.append(f"{'.'.join(filter(None, [path, *keys]))}: {message}")
        raise InputError("; ".join(dict.fromkeys(faults))) from error


def _effects(tables: Mapping[str, Any], folder: Path) -> dict[str, Effect]:
    effects: dict[str, Effect] = {}
    for name, table in tables.items():
        path = f"effects.{name}"
        if name not in EFFECTS:
            raise InputError(f"{path}: unknown key; there are: {', '.join(EFFECTS)}")
        several = table if isinstance(table, list) else [table]
        for k, one in enumerate(several):
            label = f"{path}[{k}]" if several is table else path
            effects[label] = _record(EFFECTS[name], one, label, folder)
    return effects


def _record(kind: type, table: Any, path: str, folder: Path) -> Any:
    """A record from a table whose keys are the record's fields."""
    keys: dict[str, Any] = {
        field.name: (
            float if field.type == "float" else Any,
            ... if field.default is MISSING else field.default,
        )
        for field in fields(kind)
    }
    _checked(create_model(kind.__name__, __base__=_Part, **keys), table, path)
    values = dict(table)
    for key, value in table.items():
        if key == "history":
            values[key] = _history(value, f"{path}.{key}", folder)
        elif isinstance(value, Mapping) and "along" in value:
            values[key] = _record(Profile, value, f"{path}.{key}", folder)
    with at_path(path):
        return kind(**values)


def _history(table: Any, path: str, folder: Path) -> History:
    match table:
        case {"csv": _}:
            source = _checked(_CsvColumn, table, path)
            with at_path(path):
                return Table.from_csv(
                    folder / source.csv, source.column, time=source.time, scale=source.scale
                )
        case {"waveform": str(name), **keys} if name in WAVEFORMS:
            waveform: History = _record(WAVEFORMS[name], keys, path, folder)
            return waveform
        case {"waveform": name}:
            known = ", ".join(WAVEFORMS)
            raise InputError(f"{path}.waveform: {shown(name)} is not among {known}")
        case {"table": columns, **others} if not others:
            rows = _checked(_Rows, columns, f"{path}.table")
            with at_path(f"{path}.table"):
                return Table(*check_points("t", rows.t, rows.values))
        case {**keys}:
            raise InputError(
                f"{path}: must have one of csv, waveform or table; got {', '.join(map(str, keys))}"
            )
    raise InputError(f"{path}: must be a table with csv, waveform or table; got {shown(table)}")
