"""Hard cases: families of programs on which solvers alone fail, their exact answers, one table.

Each family makes a case from a seed; nothing is tuned to a seed. `sweepopt study hard` runs them
through every path and solver, and judges each step by its exact velocity.
"""

from sweepopt.study.hard import runs, single_steps
from sweepopt.study.hard.bodies import Family, Hard
from sweepopt.study.hard.judge import Exact, Program

FAMILIES: dict[str, Family] = {
    name: made
    for module in (single_steps, runs)
    for name, made in vars(module).items()
    if getattr(made, "__module__", "") == module.__name__ and not name.startswith("_")
}
"""Families by name; what a family is its docstring says."""

__all__ = ["FAMILIES", "Exact", "Family", "Hard", "Program"]
