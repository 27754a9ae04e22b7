"""Scene files: TOML whose values are data (numbers, tables, columns, named waveforms), never code.

A table is a call: its keys are the arguments of a function, or the fields of a record such as those
of `EFFECTS`, which check their values. Every error starts with the path of the key at fault, such
as ``effects.friction.g``.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from inspect import signature
from numbers import Integral, Real
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple
from warnings import catch_warnings, simplefilter

import numpy as np

from sweepopt.checks import at_path, choice, count, from_table, listed, meaning, number, step_count
from sweepopt.errors import (
    InputError,
    StabilityWarning,
    SweepoptError,
    brought_by,
    shown,
    suggestion,
)
from sweepopt.fem import effects
from sweepopt.fem.fields import Profile, SlipWeakening
from sweepopt.fem.mesh import chain, grid
from sweepopt.fem.pictures import PICTURES
from sweepopt.fem.plasticity import Plasticity
from sweepopt.fem.scene import Initial, Scene, build, method
from sweepopt.fem.spaces import Discretisation
from sweepopt.io import as_path, find_scene, parse_toml, read_toml
from sweepopt.loads import Constant, Modulated, Sine, Table, Triangle, check_points

if TYPE_CHECKING:
    from pandas import DataFrame

EFFECTS: dict[str, type] = {
    "viscosity": effects.Viscosity,
    "elasticity": effects.Elasticity,
    "dashpot": effects.Dashpot,
    "foundation": effects.Foundation,
    "friction": effects.Friction,
    "plasticity": Plasticity,
    "body_force": effects.BodyForce,
    "traction": effects.Traction,
    "point_force": effects.PointForce,
    "prescribed_displacement": effects.PrescribedDisplacement,
    "eigenstrain": effects.Eigenstrain,
    "yield_stress": effects.YieldStress,
    "one_way": effects.OneWay,
    "maxwell": effects.MaxwellBranch,
}
"""Effects by the name of their table in a scene file."""
MEANT = {
    "contact": "; did you mean friction? held = { boundary = 'n' } keeps it in place",
    "damping": "; did you mean viscosity, or dashpot on a boundary?",
    "gravity": "; did you mean body_force?",
    "mass": "; there is no inertia: bodies move slowly",
    "pressure": "; did you mean traction?",
    "spring": "; did you mean foundation?",
    "temperature": "; did you mean eigenstrain?",
}
"""Hints for names under which users look for effects."""
MISSING = {
    "domain": "; write [domain], with mesh and clamped",
    "time": "; write [time], with end and steps",
    "effects": "; write [effects.viscosity] with eta, for example",
    "history": "; a constant one is { waveform = 'constant' }",
}
"""Ends of messages that a key is missing."""

WAVEFORMS = {"constant": Constant, "sine": Sine, "triangle": Triangle}
"""Histories by the name of their waveform in a scene file."""
PLAIN = {
    "float": (Real, "a number without quotes"),
    "int": (Integral, "a whole number without quotes"),
    "str": (str, "text in quotes"),
    "bool": (bool, "true or false"),
}
"""Annotations of fields of a user's effect that values are checked by."""

WORD = re.compile(r"[A-Za-z][\w -]*")
"""Text that stands without quotes in a change, as a shell takes them away."""
STEP = re.compile(r"([^.\[\]]+)|\[(\d+)\]")
"""Of a path of a value: a key, or an index."""
PATH = re.compile(r"[^.\[\]]+(\.[^.\[\]]+|\[\d+\])*")


class _File(NamedTuple):
    """The top level of a scene file."""

    domain: Any
    time: Any
    effects: Any
    initial: Any = {}  # noqa: RUF012
    solve: Any = {}  # noqa: RUF012
    title: str = ""
    units: str = "dimensionless"
    pictures: Any = None


@meaning(
    steps='; give changes={"time.steps": steps}',
    t_end='; give changes={"time.end": t_end}',
    set='; give changes={"effects.friction.g": 0.5}, for example',
)
def read_scene(
    source: str | Path | Mapping[str, Any],
    *,
    folder: str | Path = ".",
    changes: Mapping[str, Any] | None = None,
    without: Sequence[str] = (),
) -> Scene:
    """Read a scene and assemble it.

    Parameters
    ----------
    source : str, Path or mapping
        A path of a TOML file, the name of a problem of the library (see `sweepopt list`), TOML
        text (anything with a line break), or the mapping that such text stands for.
    folder : str or Path
        Where relative paths of meshes and tables start; a file's own folder for a file.
    changes : mapping, optional
        Other values by their path, ``{"effects.friction.g": 0.5, "effects.traction[0].f2": 2.0}``.
        The last key may be new, a value may be a whole table.
    without : sequence of str
        Effects to leave out: a kind (``"traction"``) or one of it (``"traction[0]"``). Nothing of
        them is assembled.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        Naming the file and the key at fault by its path in it.

    Notes
    -----
    ::

        title = "..."                   # optional; units = "SI" or "dimensionless" (default)
        pictures = ["contact"]          # of a run, [] for none; all that fit if not given
        [domain]
        mesh = "tube.msh"               # Gmsh, VTU, Abaqus; groups by name
        # mesh = { sizes = [2.0, 1.0], cells = [20, 10] }: one size is an interval, three are a box;
        # its sides are left, right (along x), bottom, top (y), front, back (z); points =
        # ["x**2", "y"] moves its points
        # mesh = { nodes = 50 }: a chain with nodes at x = 0, 1, ..., for kind = "lumped"
        kind = "antiplane"              # or "plane strain", "plane stress", "solid", "lumped"
        clamped = "bonded"              # a name or a list; "clamped" if not given
        held = { foot = "y" }           # components: letters of x, y, z and n
        element = "P1"                  # or "P2"
        refinements = 0                 # of the mesh: each divides a triangle into four
        [time]
        end = 10.0
        steps = 400
        [initial]                       # optional: the displacement at t = 0
        u = "0.1 * x"                   # or run = "../results/tube/solution.nc": its end
        [solve]                         # optional: scheme, solver, tol, path of sweepopt.solve
        [effects.viscosity]
        eta = { core = 1.0, sleeve = 0.2 }
        [effects.elasticity]
        kappa = { along = "radius", at = [1.0, 2.0], values = [1.0, 3.0] }
        [effects.friction]
        on = "contact"
        g = 0.3
        slip = { distance = 0.01, residual = 0.4 }    # optional
        [[effects.traction]]            # a table, or several
        on = "outer"
        history = { csv = "loads.csv", column = "f2" }
        [effects.body_force]
        f0 = 2.0
        history = { waveform = "sine", amplitude = 1.0, period = 4.0 }

    Data in space are numbers, tables by group or along a line, or formulas such as
    ``"0.3 * (1 + x**2)"`` in x, y, z, radius, angle, and t where a load or a bound moves. In the
    plane and in solids forces and displacements are lists, one for each of x, y and z; if ``f2`` of
    a traction is one number it acts along the outward normal (a pressure is negative). Other
    histories: ``{ waveform = "triangle", amplitude, period }``,
    ``{ waveform = "constant", value }``, ``{ table = { t = [...], values = [...] } }``. Each may
    have an ``envelope``, one more history by which it is multiplied.

    All effects with their keys, those in brackets may be left out; `sweepopt.fem` has a class of
    each, whose help says what they mean::

        EFFECTS_AND_KEYS

    With prescribed_displacement there is no yield_stress, one_way, plasticity or maxwell.

    Examples
    --------
    >>> scene = read_scene("tube")
    >>> scene.t_end, scene.steps, scene.units
    (120.0, 480, 'SI')
    >>> read_scene("square", changes={"effects.friction.g": 0.5}, without=["traction"]).left_out
    ('no load: f = 0',)
    """
    folder, where = as_path("folder", folder), ""
    if isinstance(source, Mapping):
        data = source
    elif isinstance(source, str) and "\n" in source:
        data = parse_toml("the scene", source)
    else:
        path = find_scene(source) if isinstance(source, str) else as_path("source", source)
        data, folder, where = read_toml(path), path.parent, f"{source}: "
    with at_path(where):
        return _scene_of(changed(data, changes or {}), folder, changes or {}, without)


def keys_of(effect: type) -> str:
    """The keys of an effect's table; those in brackets may be left out."""
    given = signature(effect).parameters.values()
    return ", ".join(p.name if p.default is p.empty else f"[{p.name}]" for p in given)


read_scene.__doc__ = str(read_scene.__doc__).replace(
    "EFFECTS_AND_KEYS",
    "\n        ".join(f"{name:<24} {keys_of(kind)}" for name, kind in EFFECTS.items()),
)


def _scene_of(
    data: Mapping[str, Any], folder: Path, changes: Mapping[str, Any], without: Sequence[str]
) -> Scene:
    """The scene of its tables."""
    _require_places("", data)
    file = _construct(_File, data, "", folder, MISSING)
    for name in ("domain", "time", "solve"):
        _require_places(name, getattr(file, name))
    pictures = file.pictures
    if pictures not in (None, []):
        pictures = listed("pictures", pictures, choice, PICTURES)
    tables = effect_tables(file.effects, without)
    body = _construct(Discretisation, file.domain, "domain", folder)
    there = sorted(body.mesh.boundaries or {})
    missing = MISSING | {"on": f"; the boundaries are: {', '.join(there) or 'none'}"}
    chosen = {label: _construct(*tables[label], label, folder, missing) for label in tables}
    settings = {"title": file.title, "units": file.units, "pictures": pictures}
    settings["changes"] = (
        *(f"{path} = {value!r}" for path, value in changes.items()),
        *(f"without {name}" for name in names_of(without)),
    )
    for kind, table, path in ((_time, file.time, "time"), (method, file.solve, "solve")):
        settings |= _construct(kind, table, path, folder)
    return build(body, chosen, _construct(Initial, file.initial, "initial", folder), settings)


def _require_places(name: str, table: Any) -> None:
    """Refuse a key that has its place in another table than the one of this name."""
    places = dict.fromkeys(EFFECTS, "effects.")
    kinds: dict[str, Any] = {"domain.": Discretisation, "time.": _time, "solve.": method, "": _File}
    if not name:  # a change of a key of an effect, without its table
        named = table["effects"] if isinstance(table.get("effects"), Mapping) else ()
        kinds = {
            f"effects.{one}.": EFFECTS[one] for one in named if isinstance(EFFECTS.get(one), type)
        } | kinds
    for path, kind in kinds.items():
        places |= dict.fromkeys(signature(kind).parameters, path)
    here = f"{name}." if name else ""
    for key in table if isinstance(table, Mapping) else ():
        if (place := places.get(key, here)) != here:
            raise InputError(f"{here}{key}: unknown key; did you mean {place}{key}?")


def _construct(
    kind: Callable[..., Any],
    table: Any,
    path: str,
    folder: Path,
    missing: Mapping[str, str] = MappingProxyType({}),
) -> Any:
    """What a function or a record makes of a table whose keys are its arguments."""
    where = f"{path}." if path else ""

    def read(key: str, value: Any) -> Any:
        if not kind.__module__.startswith("sweepopt."):  # ours say more
            annotation = signature(kind).parameters[key].annotation
            name = getattr(annotation, "__name__", str(annotation)).removesuffix(" | None")
            plain, words = PLAIN.get(name, (object, ""))
            if not isinstance(value, plain) or (type(value) is bool and name in ("float", "int")):
                raise InputError(f"{where}{key} must be {words}, got {shown(value)}")
        return _value(key, value, where + key, folder)

    return from_table(where, kind, table, read, missing)


def _value(key: str, value: Any, path: str, folder: Path) -> Any:
    """A value of a table: files are relative to the folder, tables become records."""
    if key == "mesh" and isinstance(value, Mapping):
        return _construct(chain if "nodes" in value else grid, value, path, folder)
    if key in ("mesh", "csv", "run"):
        return folder / as_path(path, value)
    if key == "history":
        return _history(value, path, folder)
    if key == "slip":
        return _construct(SlipWeakening, value, path, folder)
    if isinstance(value, Mapping) and "along" in value:
        return _construct(Profile, value, path, folder)
    if isinstance(value, list):  # of x, y and z
        return [_value(key, one, f"{path}[{k}]", folder) for k, one in enumerate(value)]
    return value


def effect_tables(tables: Any, without: Sequence[str]) -> dict[str, tuple[type, Any]]:
    """Kinds and tables by their path of the effects that are not left out."""
    if not isinstance(tables, Mapping):
        raise InputError(f"effects: must be a table, got {shown(tables)}")
    named: dict[str, tuple[str, Any]] = {}
    for name, table in tables.items():
        if isinstance(table, list):
            named |= {f"effects.{name}[{k}]": (name, one) for k, one in enumerate(table)}
        else:
            named[f"effects.{name}"] = name, table
    kinds = {}
    for label in remaining(list(named), without):
        name, table = named[label]
        if name not in EFFECTS:
            own = "; an effect of your own must be in sweepopt.fem.EFFECTS first"
            begin = next((one for one in EFFECTS if name.startswith(f"{one}_")), "")
            more = f"; write [[effects.{begin}]] above each of several" if begin else ""
            hint = MEANT.get(name) or more or suggestion(name, EFFECTS) or own
            raise InputError(f"effects.{name}: unknown key; there are: {', '.join(EFFECTS)}{hint}")
        kind = EFFECTS[name]
        if not callable(kind) or (table and not signature(kind).parameters):
            raise InputError(
                f"effects.{name}: EFFECTS[{name!r}] must be a class whose fields are the keys, "
                f"with @dataclass(frozen=True) above it, got {shown(kind)}"
            )
        kinds[label] = kind, table
    return kinds


def _history(table: Any, path: str, folder: Path) -> Any:
    """The history that a table states."""
    match table:
        case {"envelope": envelope, **others}:
            wave = _history(others, path, folder)
            with at_path(f"{path}."):
                return Modulated(wave, _history(envelope, "envelope", folder))
        case {"csv": _}:
            return _construct(_column, table, path, folder)
        case {"waveform": name, **keys}:
            kind = WAVEFORMS[choice(f"{path}.waveform", name, WAVEFORMS)]
            return _construct(kind, keys, path, folder)
        case {"table": points, **others} if not others:
            return _construct(_points, points, f"{path}.table", folder)
    given = ", ".join(map(str, table)) if isinstance(table, Mapping) else shown(table)
    raise InputError(
        f'{path}: must have one of csv, waveform or table, such as {{ waveform = "sine", amplitude '
        f"= 1.0, period = 4.0 }} or {{ table = {{ t = [0, 1], values = [0, 2] }} }}; got {given}"
    )


@meaning(dt="; give steps, end / dt")
def _time(end: float, steps: int) -> dict[str, Any]:
    return {"t_end": number("end", end, 0.0, strict=True), "steps": step_count(steps)}


def _column(csv: Path, column: str, time: str | None = None, scale: float = 1.0) -> Table:
    number("scale", scale)  # the key, before what is in the file
    with at_path("csv: "):
        return Table.from_csv(csv, column, time=time, scale=scale)


def _points(t: Any, values: Any) -> Table:
    return Table(*check_points("t", t, values))


# ---- changes of a scene's data before anything is assembled: values by path, effects left out ----


def parse_changes(texts: Iterable[str]) -> dict[str, Any]:
    """The changes that texts such as ``effects.friction.g=0.5`` state; values are TOML or words.

    Raises
    ------
    InputError
        If there is no ``=`` or the value is no TOML.

    Examples
    --------
    >>> parse_changes(["effects.friction.g=0.5", "solve.scheme='midpoint'"])
    {'effects.friction.g': 0.5, 'solve.scheme': 'midpoint'}
    """
    changes = {}
    for text in texts:
        path, equals, value = text.partition("=")
        if not equals:
            raise InputError(
                f"{shown(text)} is no change; write PATH=VALUE, such as time.steps=100"
            )
        if WORD.fullmatch(value) and value not in ("true", "false", "inf", "nan"):
            value = f"'{value}'"
        path = path.strip()
        where = f"""{path}={value} (of text a shell takes quotes away: "{path}='2 * x'")"""
        table = parse_toml(where, f"value = {value}")
        if table.keys() != {"value"}:
            raise InputError(f"{where}: must be one value")
        changes[path] = table["value"]
    return changes


def changed(data: Mapping[str, Any], changes: Mapping[str, Any]) -> Mapping[str, Any]:
    """The data with other values at paths such as ``effects.traction[0].f2``.

    The last key of a path may be new; the tables before it may not.

    Raises
    ------
    InputError
        Naming the path, where it ends and what is there.

    Examples
    --------
    >>> changed({"time": {"end": 1.0}}, {"time.end": 2.0, "time.steps": 4})
    {'time': {'end': 2.0, 'steps': 4}}
    """
    if not isinstance(changes, Mapping):
        raise InputError(f"changes must be a mapping of paths to values, got {shown(changes)}")
    result = deepcopy(dict(data))
    for path, value in changes.items():
        if not (isinstance(path, str) and PATH.fullmatch(path)):
            raise InputError(
                f"{shown(path)} is no path of a value; write keys with dots between them and "
                "indices in brackets, such as effects.traction[0].f2"
            )
        table: Any = result
        *before, last = STEP.finditer(path)
        if before and before[0].group() in ("initial", "solve"):  # which a scene may do without
            result.setdefault(before[0].group(), {})
        for step in before:
            table = table[_key(path, step, table)]
        table[_key(path, last, table, may_be_new=True)] = value
    return result


def _key(path: str, step: re.Match[str], table: Any, may_be_new: bool = False) -> str | int:
    """The key or the index that a step of a path takes in a table, where it leads somewhere."""
    before, (key, index) = path[: step.start()], step.groups()
    where = before.rstrip(".") or "the scene"
    if index:
        if not isinstance(table, list):
            raise InputError(f"{path}: {where} is no list, but {shown(table)}; leave [{index}] out")
        if int(index) >= len(table):
            raise InputError(
                f"{path}: {where} has {len(table)} entries; use [0] to [{len(table) - 1}]"
            )
        return int(index)
    if not isinstance(table, Mapping):
        remedy = f"name an entry, such as {where}[0]" if isinstance(table, list) else "set it whole"
        raise InputError(f"{path}: {where} is no table, but {shown(table)}; {remedy}")
    if key not in table and not may_be_new:
        remedy = suggestion(key, table) or f"; set it whole to add it, {before}{key}={{...}}"
        if key in EFFECTS and not before:
            remedy = f"; did you mean effects.{path}?"
        raise InputError(f"{path}: {where} has no table {key!r}, but {', '.join(table)}{remedy}")
    return key


def names_of(without: Sequence[str]) -> list[str]:
    """Effects to leave out, by name; one may stand alone."""
    if not isinstance(without, (str, list, tuple)):
        raise InputError(f"without must be a list of names of effects, got {shown(without)}")
    return [without] if isinstance(without, str) else list(without)


def remaining(labels: list[str], without: Sequence[str]) -> list[str]:
    """Labels of effects without those named: all of a kind (``traction``) or one of it.

    Raises
    ------
    InputError
        If there is no such effect; the message names those there are.

    Examples
    --------
    >>> remaining(["effects.friction", "effects.traction[0]"], ["traction"])
    ['effects.friction']
    """
    rest = labels
    for name in names_of(without):
        wanted = f"effects.{str(name).removeprefix('effects.')}"
        matches = [one for one in labels if one == wanted or one.startswith(f"{wanted}[")]
        if not matches:
            names = [one.removeprefix("effects.") for one in labels]
            raise InputError(
                f"without: there is no effect {shown(name)}; there are: {', '.join(names)}"
                f"{suggestion(name, names)}"
            )
        rest = [one for one in rest if one not in matches]
    return rest


# ---- what the effects of a scene cost: the scene beside itself without each of them ----


def compare_effects(
    source: str | Path | Mapping[str, Any],
    *,
    changes: Mapping[str, Any] | None = None,
    without: Sequence[str] = (),
    steps: int = 5,
) -> DataFrame:
    """The scene, and the scene without each of its effects that it can be without, as a table.

    Parameters
    ----------
    source, changes, without
        As for `read_scene`.
    steps : int
        How many steps of the scene's length are timed, at even times of the run. The median time
        is shown.

    Returns
    -------
    pandas DataFrame
        A row "all effects", then one "without ..." for each effect, with the columns ``unknowns``,
        ``nonsmooth_unknowns``, ``sets`` (how many bound forces, and their shapes), ``nonzeros_A``
        and ``nonzeros_B`` (0 where there is no matrix), ``path`` (how a step is solved,
        `Plan.path`), ``solvers`` (which ones took the steps; none where the path is linear),
        ``seconds`` (of a step, the median) and ``certificate`` (the worst relative one).

    Raises
    ------
    InputError
        As `read_scene` does.

    Examples
    --------
    >>> table = compare_effects("square", steps=5)
    >>> table.path["all effects"], table.path["without friction"]
    ('proportional', 'linear')
    """
    with brought_by("study"):
        import pandas as pd
    costs = effect_costs(source, changes=changes, without=without, steps=steps)
    return pd.DataFrame.from_dict(costs, orient="index")


def effect_costs(
    source: str | Path | Mapping[str, Any],
    changes: Mapping[str, Any] | None,
    without: Sequence[str],
    steps: int,
) -> dict[str, dict[str, Any]]:
    """The rows of `compare_effects`."""
    whole = read_scene(source, changes=changes, without=without)
    costs = {"all effects": _cost(whole, count("steps", steps))}
    for name in whole.tables:
        with suppress(InputError):  # the scene cannot be without it
            scene = read_scene(source, changes=changes, without=[*names_of(without), name])
            costs[f"without {name}"] = _cost(scene, steps)
    return costs


def _cost(scene: Scene, steps: int) -> dict[str, Any]:
    """The cost of single steps that end at even times of the run.

    Long steps lead from each to the next. Two of the scene's own length follow each long one, of
    which the second is timed: the first has to factorise. Where long steps are refused, the
    first steps of the run are timed.
    """
    h, ends = scene.t_end / scene.steps, np.linspace(scene.steps, 0, steps, False, dtype=int)
    nodes = np.unique(np.maximum(np.subtract.outer(ends, [scene.steps, 2, 1, 0]), 0))
    with catch_warnings():
        simplefilter("ignore", StabilityWarning)  # of the long ones
        try:
            solution = scene.solve(t_end=None, steps=h * nodes)
        except SweepoptError:
            nodes = ends = np.arange(min(steps, scene.steps) + 1)
            solution = scene.solve(t_end=None, steps=h * nodes)
    plan, process = solution.plan, solution.process
    stats = solution.stats[np.isin(solution.t[1:], h * ends)]
    A, B = (0 if M is None else int(M.count_nonzero()) for M in (process.A, process.B))
    solvers = sorted({one for one in stats["solver"] if not one.startswith("linear")})
    return {
        "unknowns": plan.unknowns,
        "nonsmooth_unknowns": plan.nonsmooth_unknowns,
        "sets": _sets(scene),
        "nonzeros_A": A,
        "nonzeros_B": B,
        "path": plan.path,
        "solvers": ", ".join(solvers),
        "seconds": float(np.median(stats["seconds"])),
        "certificate": float(stats["relative"].max()),
    }


def _sets(scene: Scene) -> str:
    """How many sets of each shape."""
    counts: Counter[str] = Counter()
    for one in scene.yields:
        size, cone = one.rows.block, one.slopes is not None
        name = f"{'cones' if cone else 'balls' if one.metric is None else 'ellipses'} in R^{size}"
        if size == 1:
            name = "intervals" if one.shape == "ball" else "half-lines"
        counts[name] += len(one.rows.weight)
    return ", ".join(f"{m} {name}" for name, m in counts.items())
