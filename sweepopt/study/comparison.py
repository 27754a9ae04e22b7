"""Solvers compared: a study of one scene whose axis is the solver, at three tolerances.

Every step is certified, whichever solver it came from. What counts for a solver is the time of the
run and how many calls a step takes: where it takes more than one, the solver's answer was above tol
and others repaired it. What a solver says of itself does not count.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from sweepopt.study.cell import THROUGH_CVXPY, run_cell
from sweepopt.study.study import Study
from sweepopt.velocity import REGISTRY, installed

if TYPE_CHECKING:
    from pandas import DataFrame

TOLS = (1e-3, 1e-6, 1e-9)
OF_CVXPY = ("CLARABEL", "DAQP", "MOSEK", "OSQP", "PIQP", "PROXQP", "QOCO", "SCS")
"""Those of cvxpy's solvers that treat quadratic programs, if they are installed."""
LEGEND = """\
ms a step    wall time of the run over its steps, repairs included
x best       of those at that tol
calls        of solvers, a step: above 1 some answers missed tol and other solvers repaired them
certificate  the worst one of the run, relative"""


def compare(
    scene: str, *, steps: int = 50, progress: Callable[[str], object] = lambda words: None
) -> DataFrame:
    """Run a problem with every solver that is installed and treats its set.

    Parameters
    ----------
    scene : str
        A scene, its file, or a problem of the studies.
    steps : int
    progress : callable, optional
        Called with a line of text when a run is finished, for example `print`.

    Returns
    -------
    pandas DataFrame
        A row a solver ("cvxpy:..." through cvxpy's interface, the others are the library's own) and
        tolerance, with the columns of `CellRow` but no errors, and with ``ms`` (a step), ``ratio``
        (to the fastest at that tolerance) and ``calls`` (of solvers, a step).

    Raises
    ------
    InputError
        If there is no such problem.

    Examples
    --------
    >>> table = compare("S03", steps=5)
    >>> bool((table.certificate <= table.tol).all())
    True
    """
    import pandas as pd

    through = [THROUGH_CVXPY + name.lower() for name in installed() if name in OF_CVXPY]
    solvers = ("auto", *(name for name in REGISTRY if name != "cvxpy"), *through)
    study = Study((scene,), ("auto",), solvers, (steps,), TOLS, repeats=1)
    rows = []
    for cell in study.cells():
        row = run_cell(cell)
        if row.status != "SolverRefusedError":
            rows.append(row)
            progress(f"{cell}: {row.status}")
    table = pd.DataFrame(rows)
    best = table[table.success].groupby("tol").wall.min()
    table["ms"] = 1e3 * table.wall / steps
    table["ratio"] = table.wall / table.tol.map(best)
    table["calls"] = table.solver_calls / table.steps_done
    order = ["tol", "success", "wall"]
    return table.sort_values(order, ascending=[False, False, True], ignore_index=True)


def comparison_text(table: DataFrame) -> str:
    """The comparison as text."""
    names = {"ms": "ms a step", "ratio": "x best"}
    shown = table[["tol", "solver", "status", "ms", "ratio", "calls", "certificate"]]
    text = shown.rename(columns=names).to_string(index=False, float_format="{:.3g}".format)
    return f"{text}\n{LEGEND}"
