"""Imports point downwards only, heavy packages stay where they belong, the import stays light."""

from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "sweepopt"

# a module may import from its own level (inside one package) and from levels below
LEVELS = [
    {"errors", "files"},
    {"alone", "archive", "checks", "grids", "records", "statistics", "texts", "versions"},
    {"csvtable"},
    {"precise"},
    {"linalg", "loads", "secular"},
    {"sets"},
    {"interval", "states", "multigrid"},
    {"blocks", "interpolant", "process"},
    {"energy", "fingerprint", "program", "responses", "schemes"},
    {"reduction", "solvers"},
    {"checkpoint", "substitution", "control"},
    {"polish"},
    {"ladder"},
    {"velocity"},
    {"plan"},
    {"nodes", "unrounded"},
    {"field", "motion", "solution"},
    {"norms"},
    {"flow", "kinks", "stepping"},
    {"course"},
    {"mend"},
    {"overshoot", "watch"},
    {"march"},
    {"exact"},
    {"adaptive", "lifting", "defects", "refinement"},
    {"certificate", "marks", "observers", "passes"},
    {"evolve"},
    {"resume"},
    {"library"},
    {"fem"},
    {"slip"},
    {"store", "plot"},
    {"study"},
    {"cli"},
    {"__main__"},
]
# conveniences of Solution that call upward by a local import
UPWARD = {("solution", above) for above in ("store", "plot", "certificate")}
HOMES = {
    "cvxpy": {"program", "sets", "solvers/reference"},
    "clarabel": {"solvers/clarabel"},
    "osqp": {"solvers/osqp"},
    "daqp": {"solvers/daqp"},
    "cvxopt": {"linalg/cholesky"},
    "pyamg": {"multigrid"},
    "skfem": {"fem"},
    "meshio": {"store/vtu"},
    "pydantic": {"fem"},
    "matplotlib": {"plot"},
    "xarray": {"store/netcdf"},
    "h5netcdf": {"blocks"},
    "tqdm": {"observers"},
    "pandas": {"study"},
    "threadpoolctl": {"study/machine"},
    "mpmath": {"study/hard"},
    "distributed": {"study/executors"},
    "plotly": {"study/report"},
}


@cache
def modules() -> dict[str, ast.Module]:
    files = [path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py"]
    return {
        path.relative_to(PACKAGE).with_suffix("").as_posix(): ast.parse(path.read_text())
        for path in files
    }


def imported(tree: ast.Module) -> set[str]:
    """What a module imports when it runs; imports for annotations do not count."""
    names: set[str] = set()
    annotations = {
        child
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"
        for child in ast.walk(node)
    }
    for node in set(ast.walk(tree)) - annotations:
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def level(module: str) -> int:
    for height, names in enumerate(LEVELS):
        if module in names:
            return height
    raise AssertionError(f"{module} has no level yet: give it one in tests/test_layers.py")


@pytest.mark.parametrize("module", sorted(modules()))
def test_imports_point_downwards_only(module: str) -> None:
    top = module.split("/")[0]
    for name in imported(modules()[module]):
        parts = name.split(".")
        if parts[0] != "sweepopt" or len(parts) < 2:
            continue
        target = parts[1]
        if (
            target == top
            or not (PACKAGE / target).with_suffix(".py").exists() | (PACKAGE / target).is_dir()
        ):
            continue
        assert level(target) < level(top) or (top, target) in UPWARD, f"{module} imports {name}"


@pytest.mark.parametrize("module", sorted(modules()))
def test_outside_packages_are_imported_only_where_they_live(module: str) -> None:
    for name in imported(modules()[module]):
        homes = HOMES.get(name.split(".")[0])
        if homes is not None:
            assert any(module == home or module.startswith(home + "/") for home in homes), (
                f"{module} imports {name}"
            )


def test_importing_the_library_loads_no_heavy_package() -> None:
    heavy = ["cvxpy", "skfem", "matplotlib", "xarray", "pydantic", "pandas", "tqdm", "meshio"]
    heavy += ["distributed", "threadpoolctl", "mpmath", "plotly"]
    code = f"import sys, sweepopt; print([name for name in {heavy} if name in sys.modules])"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "[]"
