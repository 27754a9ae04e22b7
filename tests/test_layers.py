"""The order of the rooms: imports point downwards, by public names, through the rooms' faces."""

import ast
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from typing import NamedTuple

from processes import python

PACKAGE = Path(__file__).parent.parent / "sweepopt"
# from the ground up; a room imports from those before it
ROOMS = (
    ["errors", "checks", "display", "io", "loads", "linalg", "sets", "problem", "velocity"]
    + ["integrate", "results", "plot", "driver", "fem", "study", "cli", "__main__"]
)  # fmt: skip
# a convenience of Solution: plot()
UPWARD = {("results", "plot")}
HOMES = {
    "cvxpy": ("sets", "velocity"),
    "clarabel": ("velocity/solvers/conic",),
    "osqp": ("velocity/solvers/conic",),
    "daqp": ("velocity/solvers/active_set",),
    "cvxopt": ("linalg/cholesky", "linalg/ordering"),
    "pyamg": ("linalg",),
    "skfem": ("fem", "study"),
    "meshio": ("fem",),
    "matplotlib": ("fem", "plot", "study"),
    "mpl_toolkits": ("fem",),
    "pyvista": ("fem",),
    "xarray": ("results",),
    "h5netcdf": ("results",),
    "tqdm": ("integrate",),
    "pandas": ("fem", "study"),
    "plotly": ("study",),
    "threadpoolctl": ("study",),
    "distributed": ("study",),
}


class Import(NamedTuple):
    """`name` from `source`, as module `module` (a path in the package) asks for it."""

    module: str
    source: str
    name: str


@cache
def imports():
    """All imports of the package but those for annotations; the package's own face is left out."""
    found = []
    for path in PACKAGE.rglob("*.py"):
        module, tree = (
            path.relative_to(PACKAGE).with_suffix("").as_posix(),
            ast.parse(path.read_text()),
        )
        typing = {
            id(child)
            for node in ast.walk(tree)
            if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"
            for child in ast.walk(node)
        }
        for node in ast.walk(tree):
            if id(node) in typing or module == "__init__":
                continue
            if isinstance(node, ast.Import):
                found += [Import(module, alias.name, "") for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                found += [Import(module, node.module, alias.name) for alias in node.names]
    return found


def between_rooms():
    for one in imports():
        above, parts = one.module.split("/")[0], [*one.source.split("."), one.name]
        if parts[0] == "sweepopt" and parts[1] not in (above, "__version__", ""):
            yield above, parts[1], one


def test_imports_point_downwards_only():
    for above, below, one in between_rooms():
        assert ROOMS.index(below) < ROOMS.index(above) or (above, below) in UPWARD, one


def test_no_name_with_an_underscore_passes_between_rooms():
    assert not [one for *_, one in between_rooms() if one.name.startswith("_")]


def test_rooms_are_entered_by_their_faces():
    lazy = ("fem", "study")  # their parts need packages that not everybody has
    assert not [
        one for _, below, one in between_rooms() if one.source.count(".") > 1 and below not in lazy
    ]


def test_no_modules_import_each_other_in_a_circle():
    graph = {}
    for one in imports():
        target = "/".join([*one.source.split(".")[1:], one.name])
        found = target if (PACKAGE / f"{target}.py").exists() else target.rpartition("/")[0]
        rooms = one.module.split("/")[0], found.split("/")[0]
        if one.source.startswith("sweepopt") and rooms not in UPWARD:
            graph.setdefault(one.module, set()).add(found)
    TopologicalSorter(graph).prepare()


def test_outside_packages_are_imported_only_where_they_live():
    for one in imports():
        homes = HOMES.get(one.source.split(".")[0], (one.module,))
        assert any(one.module == home or one.module.startswith(f"{home}/") for home in homes), one


def test_importing_the_library_loads_no_heavy_package_and_absent_effects_no_solver():
    heavy = [name for name in HOMES if name not in ("daqp", "cvxopt")]
    code = (
        f"import sys, sweepopt; print([name for name in {heavy} if name in sys.modules]);"
        "sweepopt.scene('square', without=['friction']).solve(steps=2);"
        "print([m for m in ('cvxpy', 'clarabel', 'osqp', 'daqp', 'scs') if m in sys.modules])"
    )
    assert python(code).stdout == "[]\n[]\n"
