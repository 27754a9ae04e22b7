"""A study's table made by hand, where nothing is run, and hard cases whose runs have faults."""

from math import inf, nan
from types import SimpleNamespace

import pandas as pd

import sweepopt as so
from sweepopt.errors import Status
from sweepopt.study.hard import suite

STEPS = (50, 100, 200, 400)
SCHEMES = {"catching-up": 1, "implicit-euler": 1, "midpoint": 2}
NASTY = "a step missed tol </script><script>window.hacked = true</script> & 'more' \u2028 \"text\""
WARNED = Status.SUCCESS.value + " StabilityWarning: step * Lam = 1.2"


def study_table():
    """49 cells: 2 problems, 3 schemes, 2 solvers, 4 numbers of steps, and one exact run."""
    cells = [
        cell(problem, scheme, solver, steps)
        for problem in ("block", "pipe")
        for scheme in SCHEMES
        for solver in ("clarabel", "osqp")
        for steps in STEPS
    ]
    exact = cell("block", "midpoint", "clarabel", 4) | {"scheme": "exact", "error": 0.0}
    rows = [*cells, exact | {"bound": nan}]
    return pd.DataFrame(rows).assign(run=[f"{k:08x}" for k in range(len(rows))])


def cell(problem, scheme, solver, steps):
    error = (2.0 if problem == "pipe" else 0.3) * steps ** -float(SCHEMES[scheme])
    wall = (3e-4 if solver == "osqp" else 2e-4) * steps
    row = {
        "problem": problem,
        "refinements": 0,
        "element": "",
        "scheme": scheme,
        "solver": solver,
        "steps": steps,
        "tol": 1e-8,
        "status": "SUCCESS",
        "success": True,
        "message": Status.SUCCESS.value,
        "error": error,
        "reference_error": 0.0,
        "size": 1.0,
        "bound": 1.7 * error if problem == "block" else nan,
        "certificate": 3e-11,
        "wall": wall,
        "cpu": 1.1 * wall,
        "repeats": 3,
        "steps_done": steps,
        "solver_calls": steps + 2,
        "unknowns": 100,
        "path": "eliminated",
        "machine": "A processor, 2 cores, Linux; sweepopt 0.1.0, clarabel 0.11.1",
    }
    nothing = {"success": False, "error": nan, "bound": nan}
    if problem == "block" and solver == "osqp" and steps == 400:
        row |= nothing | {"status": "INEXACT", "message": NASTY, "steps_done": 17}
    if problem == "pipe" and scheme == "catching-up" and steps == 50:
        text = "step * Lam = 2.4 > 2: take more steps"
        row |= nothing | {"status": "UnstableStepError", "message": text, "steps_done": 0}
        row |= {"solver_calls": nan, "wall": nan, "cpu": nan, "bound": inf}
    if problem == "pipe" and scheme == "midpoint" and steps == 400:
        row |= {"error": nan, "message": WARNED}
    return row


def lie(monkeypatch, **changes):
    """From now on hard cases have runs of which something, a function of them, is wrong."""
    names = ("t", "u", "velocity", "energy", "error_bound", "plan", "stats", "success", "message")

    def lying(*process, **settings):
        sol = so.solve(*process, **settings)
        said = {name: getattr(sol, name) for name in names}
        return SimpleNamespace(**said | {name: f(sol) for name, f in changes.items()})

    monkeypatch.setattr(suite, "solve", lying)
